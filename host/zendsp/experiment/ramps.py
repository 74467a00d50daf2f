"""What a joint turns, from the ramps of its moves: there it accelerates most. At constant speed
what is left of acceleration is alike at each place, as friction is that varies with place.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from zendsp.diagnosis.data.series import stretches
from zendsp.experiment.estimates import NORMAL, Array, bump_means, least_squares
from zendsp.experiment.lab import playing
from zendsp.experiment.sliding import ACTS, STEADY, Friction, Sliding
from zendsp.recording import Recording
from zendsp.reference import Reference

BEFORE = 0.1  # s, before a ramp, that belong to it: a mean weighs its middle most
FEWEST = 41  # rows, that a mean over a ramp is made of
# of the friction, that it may be off by in a ramp that ends at rest: it falls or rises there, by a
# third on the planar arm, in the last of 250 ms (docs/measurements/experiments.md)
AT_REST = 0.1
GAVE = 1e-3  # of its acceleration, that a held joint is accelerated by at least to be told of
NO_CHANCE = 0.99  # of the F distribution: what chance explains once in a hundred


@dataclass(frozen=True)
class Turned:
    """What accelerations take of a joint's torque: its own inertia, and that by which it is coupled
    to each held joint that gave way; with standard deviations, kg m^2 (kg).
    """

    inertia: float
    inertia_std: float
    coupled: dict[int, tuple[float, float]] = field(default_factory=dict)


def ramped(rec: Recording, reference: Reference, joint: int, found: Friction) -> Turned | None:
    """The inertia that the ramps of a joint's moves show beside the weight and the viscous friction
    that its pieces at constant speed show; None where it is not told from nothing.

    Only ramps down to rest: there the joint slides all the time, and friction is what it was. From
    rest on bristles bend first, the longer the slower the ramp, which looks like inertia.
    """
    table = _ramps(rec, reference, joint)
    if table is None:
        return None
    place, speed, gain, torque, turns = table
    up = speed > 0
    torque = torque - found.cosine[0] * np.cos(place) - found.sine[0] * np.sin(place)
    torque = torque - np.where(up, found.value["+"][1], found.value["-"][1]) * speed
    A = np.stack([gain, 1.0 * up, 1.0 * ~up], axis=1)
    x, half, squares = _solved(A, torque)
    n = A.shape[1]
    taken: tuple[int, ...] = ()
    left = [k for k, turn in turns.items() if np.std(turn) > GAVE * np.std(gain)]
    while left:
        each = {k: _solved(np.column_stack([A, turns[k]]), torque) for k in left}
        best = min(each, key=lambda k: each[k][2])
        if not _more(squares, each[best][2], len(torque) - A.shape[1] - 1):
            break
        A, taken = np.column_stack([A, turns[best]]), (*taken, best)
        x, half, squares = each[best]
        left.remove(best)
    hard = float(np.abs(gain).max())
    viscous = found.mean[3] * float(np.abs(speed).max())  # of which the line is unsure
    off = np.hypot(AT_REST * found.mean[0], viscous / NORMAL) / hard
    std = np.hypot(half / NORMAL, off)
    if not NORMAL * std[0] < x[0]:
        return None
    coupled = {k: (float(x[n + i]), float(std[n + i])) for i, k in enumerate(taken)}
    return Turned(float(x[0]), float(std[0]), coupled)


def without(sliding: Sliding, found: Turned) -> Sliding:
    """The pieces without the torque that accelerates, and what is unsure of that."""
    off = found.inertia * sliding.acceleration
    unsure = [found.inertia_std * sliding.acceleration]
    for k, (share, std) in found.coupled.items():
        off = off + share * sliding.turns[k]
        unsure.append(std * sliding.turns[k])
    turns = {k: turn for k, turn in sliding.turns.items() if k not in found.coupled}
    return replace(
        sliding, torque=sliding.torque - off, turns=turns, unsure=tuple(unsure),
        inertia=(found.inertia, NORMAL * found.inertia_std),
    )


def _ramps(
    rec: Recording, reference: Reference, joint: int
) -> tuple[Array, Array, Array, Array, dict[int, Array]] | None:
    """Mean position, speed, acceleration and torque of each ramp to rest, and the acceleration of
    each joint that was held; None where the recording is too coarse.
    """
    ratio = round(rec.sample_time / reference.sample_time)
    rows = playing(rec, reference.samples // ratio)
    q = np.atleast_2d(rec["q"].T).T[rows]
    tau = np.atleast_2d(rec["tau"].T).T[rows][:, joint - 1]
    dt, n = rec.sample_time, len(q)
    at = np.arange(n)
    acting = np.interp(at - ACTS / rec.decimation, at, tau)
    pace, gain = (x[::ratio, joint - 1][:n] for x in (reference.qd, reference.qdd))
    beside, out, others = round(BEFORE / dt), [], []
    for first, last in stretches(np.abs(gain) > STEADY):
        if float(gain[first:last].mean() * pace[first:last].mean()) > 0.0:
            continue
        a, b = max(first - beside, 0), last
        if b - a < FEWEST:
            return None
        place, speed, turn = bump_means(q[a:b, joint - 1], dt)
        out.append((place, speed, turn, bump_means(acting[a:b], dt)[0]))
        others.append([bump_means(x, dt)[2] for x in q[a:b].T])
    if not out:
        return None
    place, speed, turn, torque = np.array(out).T
    each = {k: x for k, x in enumerate(np.array(others).T, 1) if k != joint}
    return place, speed, turn, torque, each


def _solved(A: Array, torque: Array) -> tuple[Array, Array, float]:
    """Solution, half widths, and the sum of the squares that are left."""
    x, half, _ = least_squares(A, torque)
    return x, half, float(np.sum((torque - A @ x) ** 2))


def _more(before: float, after: float, free: int) -> bool:
    """Whether one number more explains what chance would only once in a hundred times."""
    from scipy.special import fdtri

    return free > 0 and bool(before - after > fdtri(1, free, NO_CHANCE) * after / free)
