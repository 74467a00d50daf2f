"""``python -m zendsp.proof.untouched RECORDING GIVEN CALIBRATED IMPROVED``: prints the two models'
errors as JSON.

The recording is one that the diagnosis never saw, of the same machine. The error is the RMS
position error of short free simulations, as in the report, rad or m.
"""

from __future__ import annotations

import json
import math
import sys
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

    # the calibrated model prepares the motion for both: a wrong improvement must not smooth it to
    # its liking
    models = [kernel_model(load_model(path)) for path in (calibrated, improved)]
    data = prepare([read_signals(recording, kernel_model(load_model(given)))], models[0], 64.0)
    one, two = (float(model_error(data, m)) for m in models)
    return one, two


if __name__ == "__main__":
    found = errors(*map(Path, sys.argv[1:5]))
    print(json.dumps([x if math.isfinite(x) else 1e300 for x in found]))
