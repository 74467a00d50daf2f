"""Recordings whose columns stand apart in time from those of the others.

Where two loggers are put together by hand, each recording has a shift of its own, and one model
cannot have them all.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.thresholds import PREDICTED
from zendsp.diagnosis.measure.discrepancy import discrepancy
from zendsp.diagnosis.search.short_fits import SETTLED
from zendsp.physics.calibration.bounds import parameter_bounds
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.calibration.predict import ran_away, run
from zendsp.physics.effects.column_shift import least_shift
from zendsp.physics.model import Model, Quantity, Term

Shift = tuple[float, float]
"""By how much a command is late, s, and its variance, s²."""

# Measured with 48 recordings of foreign simulators without a shift: none is told.
SHIFT_SURE = 6.0  # standard deviations
ALL_BUT = 0.98  # quantile at which slopes are capped: they peak where a joint breaks loose
CLOCK_BLOCK = 0.5  # s: longer than a slow observer remembers


def apart_in_time(
    parts: Parts, model: Model, explained: Collection[tuple[int, str]] = ()
) -> list[tuple[int, str]]:
    """Joints whose command is late in some recordings and not in others, and a sentence for each.

    Parameters
    ----------
    parts : Parts
    model : Model
        The best there is, in kernel form.
    explained : collection of (joint, name of a recording)
        Recordings that their own numbers explain, since another friction resembles a shift.
    """
    said = []
    for joint in range(1, model.joints + 1):
        shifts: dict[str, list[Shift]] = {}
        periods: set[float] = set()
        for data in parts.each:
            for rec in data.records:
                record = rec[joint - 1]
                periods.add(record.sample_time)
                if (shift := _shift(record, model)) is not None:
                    shifts.setdefault(record.recording, []).append(shift)
        found = {name: _mean(each) for name, each in shifts.items()}
        first = parts.fit.records[0][joint - 1]
        late, others = _late(found, least_shift(first.sample_time, first.between > 0.0))
        said += [
            (
                joint,
                f"joint {joint}: in {name} the command column stands {abs(1e3 * at):.2g} ms"
                f" {'later' if at > 0 else 'earlier'} against the position than in {others}."
                f" {_remedy(periods, model)}",
            )
            for name, at in late.items()
            if (joint, name) not in explained
            and _explains(parts, model, joint, name, found[name][0])
        ]
    return said


def _remedy(periods: Collection[float], model: Model) -> str:
    """What to do about columns that stand apart: where recordings have several sample times, s, and
    nobody said for how long the loop holds a command, its mean over a row is late by half a row.
    """
    if len(periods) > 1 and not model.actuator.hold:
        return (
            "Their rows are not equally far apart: if one loop ran, state its sample time as"
            " [actuator] hold, and diagnose again"
        )
    return (
        "Write command and position of one sample into one row, in all recordings alike, and"
        " diagnose again"
    )


def _explains(parts: Parts, model: Model, joint: int, name: str, at: float) -> bool:
    """Whether a shift of the command removes most of the missing torque of a recording. Otherwise
    something else is missing that only resembles a small shift.
    """
    records = tuple(r for part in parts.each for r in part.records if r[0].recording == name)
    own = replace(parts.test, records=records)
    moved = Term("column_shift", joint, {"time": Quantity(at)})
    before, after = (
        discrepancy(own, m, joint).value for m in (model, model.with_terms((*model.terms, moved)))
    )
    return after**2 < (1.0 - PREDICTED) * before**2


def _shift(record: JointRecord, model: Model) -> Shift | None:
    """The time shift of the command to first order, s, and its variance; None where unknown, as
    beyond the limits of such a shift: a slope tells nothing that far away.
    """
    step = 0.1 * record.sample_time
    late = Term("column_shift", record.joint, {"time": Quantity(step)})
    left, moved = (
        run(record, m, SETTLED).innovations[record.counted]
        for m in (model, model.with_terms((*model.terms, late)))
    )
    if ran_away(left) or ran_away(moved) or len(left) < 2:
        return None
    slope = (moved - left) / step
    most = float(np.quantile(np.abs(slope), ALL_BUT))
    slope = np.clip(slope, -most, most)
    whole = float(slope @ slope)
    if whole <= 0.0:
        return None
    at = -float(slope @ left) / whole
    starts = np.arange(0, len(left), max(1, round(CLOCK_BLOCK / record.sample_time)))
    low, high = parameter_bounds("column_shift", "time", record)
    if not low <= at <= high:
        return None
    pulls = np.add.reduceat(slope * (left + at * slope), starts)
    variance = float(pulls @ pulls) / whole**2
    return (at, variance) if 0.0 < variance < math.inf else None


def _mean(shifts: list[Shift]) -> Shift:
    weights = [1.0 / variance for _, variance in shifts]
    return float(np.average([at for at, _ in shifts], weights=weights)), 1.0 / sum(weights)


def _late(found: dict[str, Shift], least: float) -> tuple[dict[str, float], str]:
    """The recordings that are surely shifted, by ``least`` s or more, against the one nearest to
    all, with their shifts; and the names of the others.
    """
    if len(found) < 2:
        return {}, ""

    def away(one: Shift) -> float:
        return sum(abs(one[0] - at) / math.sqrt(var) for at, var in found.values())

    usual, known = min(found.values(), key=away)
    late = {
        name: at - usual
        for name, (at, var) in found.items()
        if abs(at - usual) > max(least, SHIFT_SURE * math.sqrt(var + known))
    }
    return late, ", ".join(name for name in found if name not in late)
