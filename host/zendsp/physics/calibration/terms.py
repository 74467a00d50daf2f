"""Terms of effects to try on a recording: whether it can show them, and their start values."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from zendsp.physics.calibration.joint import JointRecord, facts
from zendsp.physics.effects.base import Effect
from zendsp.physics.model import Model, Quantity, Term


def make_term(effect: Effect, joint: int, values: dict[str, float]) -> Term:
    """A term with every fitted parameter free; missing ones at their defaults."""
    out = {}
    for p in effect.parameters:
        value = values.get(p.name, p.default if p.default is not None else 0.0)
        out[p.name] = Quantity(float(value), p.fitted)
    return Term(effect.name, joint, out)


def grid_of(effect: Effect, record: JointRecord, model: Model) -> list[dict[str, float]]:
    """Values of the nonlinear parameters of an effect to screen; phases are left out (screened as
    sine and cosine).
    """
    known = facts(record, model)
    axes: dict[str, list[float]] = {}
    for name, axis in effect.grid.items():
        if name not in ("phase", "angle"):
            unit = known.scale.of(effect.parameter(name).size)
            axes[name] = list(axis(known)) if callable(axis) else [value * unit for value in axis]
    return [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]


def usable(effect: Effect, records: Sequence[JointRecord]) -> bool:
    """Whether an effect can be tried: every recording has the optional columns that it reads, none
    shows it directly, and it suits the joint.
    """
    return all(
        all(column in record.columns for column in effect.reads)
        and not any(column in record.columns for column in effect.shown_by)
        and not (effect.turns and record.slides)
        for record in records
    )
