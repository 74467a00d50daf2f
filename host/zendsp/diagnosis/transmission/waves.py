"""Errors over the angle of a transmission, each an order with its amplitude and phase."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.decide.claims import needed
from zendsp.diagnosis.decide.thresholds import PLAIN, SURE
from zendsp.diagnosis.transmission.claims import ENOUGH, Claim, apart, unexplained
from zendsp.diagnosis.transmission.sets import Sets
from zendsp.diagnosis.transmission.torsion import Array, Twist
from zendsp.diagnosis.transmission.torsion_fit import Linear, evidence, nuisance, regress, rms, wave
from zendsp.physics.model import Model

WAVES = 2  # errors over the angle, at most
ORDERS = 4000  # of an error over the angle that are tried, at most
STRIDES = 8  # grid steps of an order around the estimate from bins of the angle
DISC = 1.0  # the order of a disc off centre, which is taken out before
AT_BOUND = 0.9  # of half a period over the travel: a minimum there lies outside the searched range


def waves_of(raw: Sets, model: Model) -> tuple[list[Claim], Sets]:
    """The errors over the angle, up to the recordings' own rate, and the torsion without them.

    They are fitted beside everything slow: torque, acceleration, direction, an eccentric disc.
    After another homing a gear may mesh with other teeth, so each recording may have a phase of its
    own.
    """
    out: list[Claim] = []
    while len(out) < WAVES:
        order = _strongest_order(raw.fit, _beneath(raw.fit).residual)
        claim = _wave(raw, model, order) if order else None
        if claim is None:
            break
        out.append(claim)
        known = _beneath(raw.fit, claim.order).x
        raw = raw.each(lambda t, c=claim, x=known: _straight(t, c, x))  # type: ignore[misc]
    return out, raw


def _beneath(twists: Sequence[Twist], order: float = 0.0, known: Array | None = None) -> Linear:
    """Torsion regressed on everything slow and, if not 0, on one order."""
    columns = []
    for t in twists:
        slow = np.stack([t.torque, t.drive, t.qdd, np.sign(t.qd)], axis=1)[t.kept]
        columns.append(np.concatenate([slow, wave(t, order)], axis=1) if order else slow)
    return regress(twists, columns, True, known)


def _spreads(
    twists: Sequence[Twist], order: float, sine: float, cosine: float
) -> tuple[float, float]:
    """Standard deviations of a wave's amplitude and of its order, with all else unknown: over one
    period and less, an order's amplitude goes with the order.
    """
    columns = []
    for t in twists:
        slow = np.stack([t.torque, t.drive, t.qdd, np.sign(t.qd)], axis=1)[t.kept]
        angle = order * t.q[t.kept]
        turned = t.q[t.kept] * (sine * np.cos(angle) - cosine * np.sin(angle))
        columns.append(np.column_stack([slow, wave(t, order), turned]))
    spread = regress(twists, columns, True).covariance[-3:, -3:]
    along = np.array([sine, cosine, 0.0]) / math.hypot(sine, cosine)
    return math.sqrt(float(along @ spread @ along)), math.sqrt(float(spread[2, 2]))


def _own_phase(twist: Twist, order: float, slow: Array) -> float:
    """The phase of an order in one recording."""
    (residual,) = _beneath([twist], known=slow).residual
    columns, own = wave(twist, order), nuisance(twist, True)  # which the residual is without
    seen = columns - own @ (own.T @ columns)
    sine, cosine = np.linalg.lstsq(seen, residual, rcond=None)[0]
    return math.atan2(cosine, sine)


def _straight(twist: Twist, claim: Claim, x: Array) -> Twist:
    """The torsion without an error over the angle, with its phase in this recording."""
    phase = _own_phase(twist, claim.order, x[:-2])
    error = claim.value * np.sin(claim.order * twist.q + phase)
    return replace(twist, torsion=twist.torsion - error)


def _wave(raw: Sets, model: Model, order: float) -> Claim | None:
    from scipy.optimize import minimize_scalar  # takes half a second

    span = max(float(np.ptp(t.q[t.kept])) for t in raw.fit)
    width = math.pi / span

    def cost(n: float) -> float:
        return rms(_beneath(raw.fit, n).residual)

    for _ in range(STRIDES):
        around = max(order - width, DISC), order + width
        before, order = order, float(minimize_scalar(cost, bounds=around, method="bounded").x)
        if abs(order - before) < AT_BOUND * width:
            break
    found, again = _beneath(raw.fit, order), _beneath(raw.fit)
    sine, cosine = float(found.x[-2]), float(found.x[-1])
    amplitude, phase = math.hypot(sine, cosine), math.atan2(cosine, sine)
    if amplitude == 0.0:  # of the disc's own order nothing is left
        return None
    std, order_std = _spreads(raw.fit, order, sine, cosine)
    without, with_it = [], []
    for twist in raw.test:
        here = _own_phase(twist, order, found.x[:-2])
        known = np.r_[found.x[:-2], amplitude * math.cos(here), amplitude * math.sin(here)]
        with_it += _beneath([twist], order, known).residual
        without += _beneath([twist], known=again.x).residual
    held, log_e = evidence(without, with_it, raw.test)
    log_e -= 0.5 * len(raw.test) * math.log(sum(len(r) for r in with_it))  # price of the phases
    size, left = apart(raw.test, without, with_it), unexplained(with_it, raw.test)
    sure = log_e > needed(model.joints) and held.z > PLAIN and amplitude > SURE * std
    if not sure or size <= ENOUGH * left:
        return None
    return Claim("wave", amplitude, std, held, log_e, size, left, order, phase, order_std)


def _strongest_order(twists: Sequence[Twist], residual: Sequence[Array]) -> float:
    """The strongest order of a residual over the angle, with at least one period within the
    recordings; 0 where there is none.

    Rows are summed into bins of the angle and transformed at once.
    """
    q = np.concatenate([t.q[t.kept] for t in twists])
    r = np.concatenate(residual)
    span = float(np.ptp(q))
    fast = max(float(np.quantile(np.abs(t.qd[t.kept]), 0.9)) for t in twists)
    lowest = 2 * np.pi / span
    highest = min(0.8 * np.pi / (max(t.sample_time for t in twists) * fast), ORDERS * lowest / 8)
    if not highest > 3 * lowest:
        return 0.0
    places = int(4 * highest * span / (2 * np.pi)) + 1
    place = np.minimum((places * (q - q.min()) / span).astype(int), places - 1)
    total = np.bincount(place, r, places)
    size = 8 * places
    power = np.abs(np.fft.rfft(total, size)) ** 2
    orders = 2 * np.pi * np.arange(len(power)) / (size * span / places)
    use = (orders >= 2 * lowest) & (orders <= highest)
    if not use.any():
        return 0.0
    return float(orders[use][np.argmax(power[use])])
