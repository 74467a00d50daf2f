"""Recordings whose columns stand apart in time from those of the others.

Where two loggers are put together by hand, each recording has a shift of its own, and one model
cannot have them all.
"""

from __future__ import annotations

import math

import numpy as np

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.search.rounds import SETTLED
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.calibration.predict import ran_away, run
from zendsp.physics.effects.column_shift import ROW
from zendsp.physics.model import Model, Quantity, Term

SURE = 6.0  # standard deviations
ALL_BUT = 0.98  # of the samples count as they are
BLOCK = 0.5  # s: longer than a slow observer remembers


def apart_in_time(parts: Parts, model: Model) -> list[str]:
    """Sentences about joints whose command is late in some recordings and not in others.

    Parameters
    ----------
    parts : Parts
    model : Model
        The best there is, in kernel form.
    """
    said = []
    for joint in range(1, model.joints + 1):
        shifts: dict[str, list[tuple[float, float]]] = {}
        for data in parts.each:
            for rec in data.records:
                record = rec[joint - 1]
                shifts.setdefault(record.recording, []).append(_shift(record, model))
        found = {
            name: (float(np.average(at, weights=1 / var)), float(1 / np.sum(1 / var)))
            for name, known in shifts.items()
            for at, var in [np.array([k for k in known if 0.0 < k[1] < np.inf]).reshape(-1, 2).T]
            if len(at)
        }
        said += _said(joint, found, ROW * parts.fit.records[0][joint - 1].sample_time)
    return said


def _said(joint: int, found: dict[str, tuple[float, float]], least: float) -> list[str]:
    if len(found) < 2:
        return []

    def away(one: tuple[float, float]) -> float:
        return sum((abs(one[0] - at) / math.sqrt(var + 1e-30) for at, var in found.values()), 0.0)

    usual = min(found.values(), key=away)
    late = {
        name: at - usual[0]
        for name, (at, var) in found.items()
        if abs(at - usual[0]) > max(least, SURE * math.sqrt(var + usual[1]))
    }
    others = ", ".join(name for name in found if name not in late)
    return [
        f"joint {joint}: in {name} the command column stands {abs(1e3 * at):.2g} ms"
        f" {'later' if at > 0 else 'earlier'} against the position than in {others}. Write command"
        " and position of one sample into one row, in all recordings alike, and diagnose again"
        for name, at in late.items()
    ]


def _shift(record: JointRecord, model: Model) -> tuple[float, float]:
    """By how much the command is late, s, to first order, and its variance; inf: unknown."""
    step = 0.1 * record.sample_time
    late = Term("column_shift", record.joint, {"time": Quantity(step)})
    left, moved = (
        run(record, m, SETTLED).innovations[record.counted]
        for m in (model, model.with_terms((*model.terms, late)))
    )
    if ran_away(left) or ran_away(moved) or len(left) < 2:
        return 0.0, np.inf
    slope = (moved - left) / step
    most = float(np.quantile(np.abs(slope), ALL_BUT))  # where a joint lets go, it jumps
    slope = np.clip(slope, -most, most)
    size = max(1, round(BLOCK / record.sample_time))
    whole = float(slope @ slope)
    if whole <= 0.0:
        return 0.0, np.inf
    at = -float(slope @ left) / whole
    pulls = np.add.reduceat(slope * (left + at * slope), np.arange(0, len(left), size))
    return at, float(pulls @ pulls) / whole**2
