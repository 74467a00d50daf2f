"""Chooses the terms that describe a transmission: spring, gap, step, eccentric disc."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zendsp.diagnosis.data.series import repeats
from zendsp.diagnosis.transmission.motor_side import Motor, with_motor_torque
from zendsp.diagnosis.transmission.sets import Sets, clear_of_a_gap, loaded, torque_scale
from zendsp.diagnosis.transmission.torsion import Array, Twist
from zendsp.diagnosis.transmission.torsion_fit import (
    Linear,
    columns_of,
    evidence,
    numbers_of,
    regress,
)

# deviance: an eccentric encoder disc that gains less is not assumed, since beside it a spring's
# torque, which follows the angle closely, is hardly determined. Nor is a gap assumed that gains
# less over a spring: any transmission yields
CLEARLY = 10.0
# whether some of the torsion yields late, which changes the motor's torque
HYSTERESIS = (False, True)
# simpler ones first; a spring may stand beside an eccentric encoder disc
CHOICES: tuple[tuple[str, ...], ...] = (
    (),
    ("step",),
    ("spring",),
    ("spring", "step"),
    ("gap",),
    ("spring", "gap"),
    ("spring", "cubic"),
    ("spring", "loop"),
)
INSTEAD = {"spring": "gap", "gap": "spring"}


@dataclass(frozen=True)
class Chosen:
    """The terms of a transmission, and whether an eccentric disc stands beside them. ``unsure``:
    terms that their ``INSTEAD`` may replace.
    """

    terms: tuple[str, ...]
    off_centre: bool
    fit: Linear
    deviance: float
    unsure: tuple[str, ...] = ()


def may_be_off(slow: Sets) -> bool:
    """Whether an eccentric encoder disc is a slow error here; over a full turn it is recognised."""
    return all(float(np.ptp(t.q[t.kept])) < 2 * math.pi for t in slow.fit if t.kept.any())


def fitted(twists: Sequence[Twist], terms: Sequence[str], off: bool, scale: float) -> Linear:
    """The torsion regressed on some terms, and on an eccentric disc where ``off``, whose
    coefficients are the last two; ``scale`` is `torque_scale`.
    """
    return _regressed(twists, terms, off, scale)


def applied(
    twists: Sequence[Twist], terms: Sequence[str], off: bool, scale: float, x: Array
) -> list[Array]:
    """The torsion that coefficients ``x`` of such a fit leave, rad, one array for each twist."""
    return _regressed(twists, terms, off, scale, x).residual


def _regressed(
    twists: Sequence[Twist], terms: Sequence[str], off: bool, scale: float, x: Array | None = None
) -> Linear:
    """The disc is the same in every recording."""
    listed = (*terms, "disc") if off else terms
    return regress(twists, [columns_of(t, listed, scale) for t in twists], False, x)


def physical(terms: Sequence[str], fit: Linear, scale: float) -> bool:
    """Whether the coefficients are physical: a spring yields, a gap opens, a step opposes the
    motion, and what yields late yields with the torque.
    """
    values = {term: value for term, (value, _) in numbers_of(terms, fit, scale).items()}
    return all(value > 0 if term == "cubic" else value < 0 for term, value in values.items())


def choose(slow: Sets, inertia: float, known: Motor | None) -> tuple[Chosen, Sets, Motor]:
    """The terms that describe the fit recordings best for their number and hold on those to choose
    by, with the transmitted torque that belongs to them, which is unknown where the motor is not
    ``known``. Without a gap all loaded rows count.
    """
    ways = []
    discs = (False, True) if may_be_off(slow) else (False,)
    for off, late in itertools.product(discs, HYSTERESIS):
        here, motor = slow, known or Motor()
        if known is None:
            fit, others, motor = with_motor_torque(
                slow.fit, (slow.choose, slow.test), inertia, off, late
            )
            here = Sets(fit, others[0], others[1])
        ways.append(_Way(off, late, here, motor))
    pressed = _likeliest([replace(w, sets=clear_of_a_gap(w.sets)) for w in ways], CHOICES)
    if "gap" in pressed[0].terms:
        return pressed
    rigid = [terms for terms in CHOICES if "gap" not in terms]
    first, sets, motor = _likeliest([replace(w, sets=w.sets.each(loaded)) for w in ways], rigid)
    unsure = tuple(t for t in pressed[0].unsure if t in first.terms)
    return replace(first, unsure=unsure), sets, motor


@dataclass(frozen=True)
class _Way:
    """A possible transmitted torque: with or without an eccentric disc and late yielding."""

    off: bool
    late: bool
    sets: Sets
    motor: Motor


def _likeliest(
    ways: Sequence[_Way], choices: Sequence[tuple[str, ...]]
) -> tuple[Chosen, Sets, Motor]:
    """The best way and choice by Schwarz's criterion, of as many samples as `evidence` counts. With
    all rows for the price, and the disc settled by rows that may show a gap, the spring of axis 2
    of a KUKA KR300 was none, which halves the torsion on an untouched recording.
    """
    best: tuple[Chosen, Sets, Motor] | None = None
    tried: dict[tuple[str, ...], float] = {}
    for way, terms in itertools.product(ways, choices):
        off, here = way.off, way.sets
        scale = torque_scale(here.fit)
        found = fitted(here.fit, terms, off, scale)
        if ("loop" in terms) != way.late or not physical(terms, found, scale):
            continue
        left = zip(found.residual, here.fit, strict=True)
        alike = max(repeats(r, t.sample_time) for r, t in left)
        n = max(sum(len(r) for r in found.residual) / alike, 2.0)
        _, log_e = evidence(fitted(here.fit, (), False, scale).residual, found.residual, here.fit)
        kept = applied(here.choose, terms, off, scale, found.x)
        _, held = evidence(fitted(here.choose, (), False, scale).residual, kept, here.choose)
        deviance = -2.0 * (log_e + held) + len(found.x) * math.log(n)
        deviance += CLEARLY * (off + ("gap" in terms))
        tried[terms] = min(deviance, tried.get(terms, math.inf))
        if best is None or deviance < best[0].deviance:
            best = Chosen(terms, off, found, deviance), here, way.motor
    assert best is not None
    first = best[0]
    other = {t: tried.get((INSTEAD[t],), math.inf) for t in first.terms if t in INSTEAD}
    unsure = tuple(t for t, d in other.items() if d < first.deviance + CLEARLY)
    return replace(first, unsure=unsure), best[1], best[2]
