"""``python -m zendsp.proof.untouched RECORDING GIVEN CALIBRATED IMPROVED``: prints the two models'
errors as JSON.

The recording is one that the diagnosis never saw, of the same machine. The error is the RMS
position error of short free simulations, as in the report, rad or m.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path


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
    models = [kernel_model(load_model(path)) for path in (calibrated, improved)]
    first, second = (prepare(signals, m, 64.0) for m in models)
    # the calibrated model prepares the motion for both: a wrong improvement must not smooth it to
    # its liking; bodies are each model's own, and a report's model.mjcf holds others
    records = tuple(
        tuple(
            replace(mine, motion=r.motion, measurement=r.measurement)
            for mine, r in zip(ours, theirs, strict=True)
        )
        for ours, theirs in zip(second.records, first.records, strict=True)
    )
    return (
        float(model_error(first, models[0])),
        float(model_error(replace(second, records=records), models[1])),
    )


if __name__ == "__main__":
    found = errors(*map(Path, sys.argv[1:5]))
    print(json.dumps([x if math.isfinite(x) else 1e300 for x in found]))
