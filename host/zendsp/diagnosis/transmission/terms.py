"""Which terms describe a transmission: spring, gap, step, a disc off centre."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zendsp.diagnosis.transmission.sets import Sets, torque_scale
from zendsp.diagnosis.transmission.torsion import (
    Array,
    Linear,
    Motor,
    Twist,
    columns_of,
    evidence,
    regress,
    rms,
    with_motor_torque,
)

# of the RMS torque: below, a gap may be open. By the motor's torque alone, a simulated one of 12
# mrad came out at 9.5 of all rows above 0.3, at 11.0 of those above 0.6
OPEN = 0.6
# of deviance: an encoder's disc off centre that gains less is not assumed. Beside it a spring's
# torque, which goes much as the angle does, is hardly determined
CLEARLY = 10.0
# the simpler first; a spring may stand beside an encoder disc that is off centre
CHOICES: tuple[tuple[str, ...], ...] = (
    (),
    ("step",),
    ("spring",),
    ("spring", "step"),
    ("gap",),
    ("spring", "gap"),
    ("spring", "cubic"),
)


@dataclass(frozen=True)
class Chosen:
    """The terms of a transmission and whether a disc off centre stands beside them."""

    terms: tuple[str, ...]
    off_centre: bool
    fit: Linear
    deviance: float


def _loaded(twist: Twist) -> Twist:
    """Without the rows at which a gap may be open: no law says on which side of it the load is."""
    size = rms([twist.torque[twist.kept]])
    return replace(twist, kept=twist.kept & (np.abs(twist.torque) > OPEN * size))


def may_be_off(slow: Sets) -> bool:
    """Whether an encoder's disc off centre is a slow error here: a full turn shows what it is."""
    return all(float(np.ptp(t.q[t.kept])) < 2 * math.pi for t in slow.fit)


def fitted(twists: Sequence[Twist], terms: Sequence[str], off: bool, scale: float) -> Linear:
    return regress(twists, [columns_of(t, terms, scale) for t in twists], off)


def applied(
    twists: Sequence[Twist], terms: Sequence[str], off: bool, scale: float, x: Array
) -> list[Array]:
    return regress(twists, [columns_of(t, terms, scale) for t in twists], off, x).residual


def physical(terms: Sequence[str], x: Array) -> bool:
    """Whether a spring gives way, a gap opens and a step goes against the motion."""
    at, ok = 0, True
    for term in terms:
        ok &= float(x[at]) > 0 if term == "cubic" else float(x[at]) < 0
        at += 2 if term == "spring" else 1
    return ok


def choose(slow: Sets, inertia: float, known: Motor | None) -> tuple[Chosen, Sets, Motor]:
    """The terms that describe the fit recordings best for their number and hold on those to choose
    by; with the transmitted torque that goes with them. Where the motor is not ``known``, neither
    is that torque.
    """
    best: tuple[Chosen, Sets, Motor] | None = None
    for off in (False, True) if may_be_off(slow) else (False,):
        here, motor = slow, known or Motor()
        if known is None:
            fit, others, motor = with_motor_torque(slow.fit, (slow.choose, slow.test), inertia, off)
            here = Sets(fit, others[0], others[1])
        here = here.each(_loaded)
        scale = torque_scale(here.fit)
        for terms in CHOICES:
            found = fitted(here.fit, terms, off, scale)
            if not physical(terms, found.x):
                continue
            n = sum(len(r) for r in found.residual)
            _, log_e = evidence(
                fitted(here.fit, (), False, scale).residual, found.residual, here.fit
            )
            kept = applied(here.choose, terms, off, scale, found.x)
            _, held = evidence(fitted(here.choose, (), False, scale).residual, kept, here.choose)
            count = len(found.x) + 2 * off * len(here.fit)
            deviance = -2.0 * (log_e + held) + count * math.log(n) + CLEARLY * off
            if best is None or deviance < best[0].deviance:
                best = Chosen(terms, off, found, deviance), here, motor
    assert best is not None
    return best
