"""All checks that come before any physics is blamed."""

from __future__ import annotations

from pathlib import Path

from zendsp.diagnosis.data.checks import check_excitation, check_motion, check_signals
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.decide.zeros import check_zeros
from zendsp.physics.files.model_file import load_model
from zendsp.physics.term_numbers import kernel_model


def accepted(files: Path | list[Path], model: Path) -> list[str]:
    """The notes on recordings that pass the checks against a model file."""
    given = kernel_model(load_model(model))
    files = [files] if isinstance(files, Path) else files
    signals = [read_signals(file, given) for file in files]
    notes = check_signals(signals, given)
    data = prepare(signals, given, 64.0)
    check_motion(data, given, list(map(str, files)))
    check_zeros(data, given)
    return [*notes, *check_excitation(data)]
