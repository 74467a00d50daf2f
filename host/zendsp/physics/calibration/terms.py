"""Terms of effects to try on a recording: whether it can show them, and where to begin."""

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
    """Nonlinear parameter values to screen for one effect, phases left out (they are screened as
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
    """Whether every recording has the optional columns that an effect reads, none that shows the
    effect directly, and a joint of which it can be an effect.
    """
    return all(
        all(column in record.columns for column in effect.reads)
        and not any(column in record.columns for column in effect.shown_by)
        and not (effect.turns and record.slides)
        for record in records
    )
