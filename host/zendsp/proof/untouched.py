"""``python -m zendsp.proof.untouched RECORDING GIVEN CALIBRATED IMPROVED``: prints the two models'
errors as JSON.

The recording is one that the diagnosis never saw, of the same machine. The error is the RMS
position error of short free simulations, as in the report, rad or m.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zendsp.physics.calibration.joint import JointRecord


def errors(recording: Path, given: Path, calibrated: Path, improved: Path) -> tuple[float, float]:
    """Error of the calibrated and of the improved model on `recording`; the given model says how to
    read it.
    """
    from zendsp.diagnosis.data.prepare import prepare
    from zendsp.diagnosis.data.reading import read_signals
    from zendsp.diagnosis.measure.windows import model_error
    from zendsp.physics.files.model_file import load_model
    from zendsp.physics.term_numbers import kernel_model

    signals = [read_signals(recording, kernel_model(load_model(given)))]
    before, after = (kernel_model(load_model(path)) for path in (calibrated, improved))
    # the calibrated model prepares the motion for both: a wrong improvement must not smooth it to
    # its liking
    data = own = prepare(signals, before, 64.0)
    if after.file != before.file:  # a report's model.mjcf holds the bodies that were found
        own = prepare(signals, after, 64.0)
        pairs = zip(own.records, data.records, strict=True)
        own = replace(own, records=tuple(_with_motion(mine, theirs) for mine, theirs in pairs))
    return float(model_error(data, before)), float(model_error(own, after))


def _with_motion(
    record: Sequence[JointRecord], other: Sequence[JointRecord]
) -> tuple[JointRecord, ...]:
    """A recording with the motion that was found with another model."""
    return tuple(
        replace(mine, motion=theirs.motion, measurement=theirs.measurement)
        for mine, theirs in zip(record, other, strict=True)
    )


if __name__ == "__main__":
    found = errors(*map(Path, sys.argv[1:5]))
    print(json.dumps([x if math.isfinite(x) else 1e300 for x in found]))
