"""Puts a foreign torque into the own reality, as a table over position and speed."""

from __future__ import annotations

import numpy as np

from zendsp.proof.draft import Concealed, Draft, Scale
from zendsp.proof.forms import FORMS, draw, foreign
from zendsp.proof.reality import ForeignTable

NAMES = tuple(name for name, form in FORMS.items() if form.of_state)
ROWS, COLUMNS = (
    241, 641,
)  # of the table: fine enough for friction that turns around within 5 % of the RMS speed
FASTEST = 8.0  # speeds that it spans, RMS speeds


def add_foreign(
    d: Draft, name: str, joint: int, s: Scale, size: float, rng: np.random.Generator
) -> Concealed:
    """Put one foreign torque of `size` of the torque's RMS into the truth."""
    drawn = draw(name, s, d.sample_time, d.seconds, size, rng)
    frame, shape = drawn.frame, drawn.fresh()
    x, w = np.linspace(-1.5, 1.5, ROWS), np.linspace(-FASTEST, FASTEST, COLUMNS)
    torque = -drawn.factor * np.array(
        [[shape(a, b, 0.0, 0.0) for b in w] for a in x]
    )  # effects oppose
    span = (frame.middle - 1.5 * frame.half, frame.middle + 1.5 * frame.half)
    d.joints[joint]["foreign"] = ForeignTable(torque, span, (-FASTEST * frame.v, FASTEST * frame.v))
    return foreign(joint, size, FORMS[name].words, FORMS[name].mechanisms)
