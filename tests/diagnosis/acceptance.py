"""All checks that come before any physics is blamed."""

from __future__ import annotations

from pathlib import Path

from zendsp.diagnosis.data.checks import check_excitation, check_motion, check_signals
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.physics.files.model_file import load_model
from zendsp.physics.term_numbers import kernel_model


def accepted(file: Path, model: Path) -> list[str]:
    """The notes on a recording that passes the checks against a model file."""
    given = kernel_model(load_model(model))
    signals = [read_signals(file, given)]
    notes = check_signals(signals, given)
    data = prepare(signals, given, 64.0)
    return [*notes, *check_motion(data, given, [str(file)]), *check_excitation(data)]
