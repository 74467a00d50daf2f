"""What a joint moves, inertia and weight, from a motion at several accelerations and places, beside
a friction of unknown shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from zendsp.experiment.estimates import NORMAL, widest
from zendsp.experiment.joints import Array, Axis, Load

KNOTS = 5  # of the shape of friction over speed
LATER = 0.6  # of the peak: gaining speed, bristles have surely bent; what these rows alone say
# deviations that a model is off by where the motion contradicts it, and share of what it states. Of
# ten joints of five right models those off by more than 0.7 % had at most 2.1 deviations; three
# that are 4 to 43 % wrong had 29 and more (docs/measurements/experiments.md)
SURELY, LEAST = 4.0, 0.01
NO_CHANCE = 0.99  # of the F distribution: what chance explains once in a hundred


class Moved(NamedTuple):
    """Rows of a joint's motion: position, speed, acceleration, torque, the number of the stretch
    that a row is of, and the acceleration that was planned.
    """

    q: Array
    qd: Array
    qdd: Array
    tau: Array
    stretch: Array
    planned: Array


def measured_load(parts: Sequence[Moved], axis: Axis) -> Load:
    """Inertia and weight that explain the torque of a motion, beside friction.

    Friction is any function of speed that is straight between five speeds, of both directions
    alike. A joint that turns carries a cos q + b sin q; or it carries nothing, and the directions
    differ; or both. What is more is kept where chance would explain as much only once in a hundred
    times, and a weight also where friction would otherwise have to drive the joint. What one that
    slides carries is the same everywhere: it is all that the directions differ by, where that is
    told from zero.

    In slow motion the encoder's noise is a large part of the measured acceleration, and the loop
    answers it with torque, which looks like inertia. The acceleration is therefore what the planned
    one explains of it (two-stage least squares): noise is in no plan.

    Parameters
    ----------
    parts : sequence of Moved
        At different accelerations; the first is the one that friction is read from.
    axis : Axis

    Returns
    -------
    Load
    """
    offset = np.cumsum([0, *(part.stretch.max(initial=0) + 1 for part in parts)])
    q, qd, qdd, tau = (np.concatenate([p[k] for p in parts]) for k in range(4))
    planned = np.concatenate([p.planned for p in parts])
    stretch = np.concatenate([p.stretch + k for p, k in zip(parts, offset, strict=False)])
    place = np.digitize(q, np.linspace(q.min(), q.max(), 11)[1:-1])
    pace = np.concatenate([np.abs(p.qd) / np.abs(p.qd).max(initial=1e-12) for p in parts])
    later = (qd * qdd < 0) | (pace > LATER)
    even = np.stack([*_shape(qd), qdd], axis=1)
    one, turning = np.ones((len(q), 1)), np.stack([np.cos(q), np.sin(q)], axis=1)
    free = len(np.unique(stretch))
    slows = _as_line(parts[0], len(q))

    def solved(more: Array, weight: slice) -> tuple[Array, Array, float]:
        """Solution; deviations of the inertia, of the weight (the largest of the way), of level and
        slope of friction, and of each column that is a weight; squares.
        """
        A = np.hstack([even, more])
        groups = [(stretch, free - A.shape[1]), (place, 9)]
        carried = np.arange(KNOTS + 1, A.shape[1])[weight]
        ways = np.zeros((6 + len(carried), A.shape[1]))
        ways[0, KNOTS] = 1.0
        ends = [int(np.argmin(q)), int(np.argmin(np.abs(q - q.mean()))), int(np.argmax(q))]
        ways[1:4, carried] = A[ends][:, carried]
        load = [KNOTS, *carried]
        ways[4:6, load] = slows @ A[:, load]
        ways[6:] = np.eye(A.shape[1])[carried]
        x, half, left = _fitted(A, tau, planned, ways, groups)
        # friction that lags behind the speed looks like inertia and weight: by how much others do
        some = [(group[later], n) for group, n in groups]
        other = _fitted(A[later], tau[later], planned[later], ways, some)[0]
        half = np.hypot(half, ways @ (x - other))
        return x, np.array([half[0], half[1:4].max(), *half[4:]]), float(left @ left)

    x, std, squares = solved(one, slice(0, 1))
    drives = abs(x[-1]) > float(np.min(x[:KNOTS]))
    if axis.unit != "rad":
        flat = float(x[-1]) if drives or abs(x[-1]) > 2.0 * std[1] else 0.0
        return Load(float(x[KNOTS]), flat=flat, **_stds(std))
    y, std_y, squares_y = solved(turning, slice(0, 2))
    if not drives and not _more(squares, squares_y, free - KNOTS - 3):  # and it is not excluded
        weight = y[KNOTS + 1 :]
        most = float(np.abs(turning @ weight).max())
        held = np.hypot(std_y, [y[KNOTS] - x[KNOTS], most, 0.0, 0.0, *weight])
        return Load(float(x[KNOTS]), **_stds(np.array([*np.maximum(std[:4], held[:4]), *held[4:]])))
    z, std_z, squares_z = solved(np.hstack([turning, one]), slice(0, 2))
    uneven = abs(z[-1]) < float(np.min(z[:KNOTS])) and _more(squares_y, squares_z, free - KNOTS - 4)
    best, half = (z, std_z) if uneven else (y, std_y)
    return Load(
        float(best[KNOTS]), cos=float(best[KNOTS + 1]), sin=float(best[KNOTS + 2]),
        uneven=float(z[-1]) if uneven else 0.0, **_stds(half),
    )  # fmt: skip


def contradicting(left: Sequence[Moved], axis: Axis) -> Load | None:
    """What a joint moves where its motion surely shows other than the model's load, which
    ``axis`` has; None where it does not.

    What the model leaves of the torque is explained as if nothing were known. A friction that is
    larger in one direction is no load that the model lacks. Of a slide the two are the same: there
    only a friction that would drive the joint contradicts the model.

    Parameters
    ----------
    left : sequence of Moved
        At different accelerations; with the torque that the model leaves.
    axis : Axis
    """
    model = axis.load
    more = measured_load(left, axis)
    heavier = abs(more.inertia) > max(SURELY * more.inertia_std, LEAST * model.inertia)
    if axis.unit != "rad" and not heavier:
        qd, tau = (np.concatenate([p[k] for p in left]) for k in (1, 3))
        level = 0.5 * float(np.median(tau[qd > 0]) - np.median(tau[qd < 0]))
        more = more if abs(more.flat) > level else replace(more, flat=0.0)
    weight = max(float(np.abs(more.weight(p.q)).max(initial=0.0)) for p in left)
    if not heavier and weight <= max(SURELY * more.weight_std, LEAST * model.most):
        return None
    return replace(
        more, inertia=model.inertia + more.inertia, flat=model.flat + more.flat,
        cos=model.cos + more.cos, sin=model.sin + more.sin, uneven=model.uneven,
    )


def _stds(half: Array) -> dict[str, float]:
    """The deviations that `measured_load` found, by their names in a load."""
    names = ("inertia_std", "weight_std", "level_std", "slope_std", "cos_std", "sin_std")
    return dict(zip(names if len(half) > 5 else names[:4], half.tolist(), strict=False))


def _as_line(slow: Moved, rows: int) -> Array:
    """What takes a torque along the motion to level and slope of the line of friction, which is
    fitted to the first part where it loses speed. ``rows``: of all parts.
    """
    slows = np.flatnonzero(slow.qd * slow.planned < 0)
    up = np.sign(slow.qd[slows])
    line = np.stack([np.ones(len(slows)), np.abs(slow.qd[slows]), up], axis=1)
    out = np.zeros((2, rows))
    out[:, slows] = np.linalg.pinv(line)[:2] * up
    return out


def _fitted(
    A: Array, tau: Array, planned: Array, ways: Array,
    groups: Sequence[tuple[npt.NDArray[np.int64], int]],
) -> tuple[Array, Array, Array]:
    """Solution of A x = tau, with the acceleration as the planned one and the other columns explain
    it; deviations of combinations of it (rows of ``ways``); and what is left of the torque.
    """  # fmt: skip
    Z, P = A.copy(), A.copy()
    Z[:, KNOTS] = planned
    P[:, KNOTS] = Z @ np.linalg.lstsq(Z, A[:, KNOTS], rcond=None)[0]
    x = np.asarray(np.linalg.lstsq(P, tau, rcond=None)[0], np.float64)
    left = tau - A @ x
    inverse = np.asarray(np.linalg.pinv(P.T @ P), np.float64)
    return x, widest(P, left, inverse, ways, groups) / NORMAL, left


def _more(without: float, within: float, free: int) -> bool:
    """Whether one number more explains what chance would only once in a hundred times."""
    from scipy.special import fdtri

    return bool(without - within > fdtri(1, free, NO_CHANCE) * within / free)


def _shape(qd: Array) -> list[Array]:
    """Columns of friction: a hat at each knot of the speed, with the sign of the speed."""
    pace = np.abs(qd)
    knots = np.geomspace(np.percentile(pace, 1), pace.max(), KNOTS)
    return [np.sign(qd) * np.interp(pace, knots, row) for row in np.eye(KNOTS)]
