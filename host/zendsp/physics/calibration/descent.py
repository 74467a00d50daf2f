"""Levenberg-Marquardt on the normal equations with box bounds; sensitivities by finite differences,
one simulation a number, on all threads (the kernel runs outside the interpreter's lock).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.handles import Handle, get_values, pairs_of, straight
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.calibration.points import Points
from zendsp.physics.effects import get_effect
from zendsp.physics.kernel.native import LANES
from zendsp.physics.kernel.threads import Each
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

TRIES = 8  # ever shorter steps that are tried before a fit ends
# of the tolerance: least first-order gain of a step to be tried; in a brief fit, and in one whose
# numbers are reported
WORTH_A_STEP = 0.1, 1e-3
# times what a step promises to first order: a fit that would need more to be of any use ends.
# Effects that counted gained up to 9.4 times their promise (a voltage limit), others up to 5.5
BEYOND_PROMISE = 10.0


class Descent:
    """The least-squares problem of a fit: residuals of some joints over some numbers, within
    bounds.

    Parameters
    ----------
    records : sequence of (JointRecord, float)
        Each with its observer's bandwidth, rad/s.
    inner : int
        Integration steps a sample.
    bounds : tuple of ndarray, shape (p,)
        Lower, upper, and the natural size of each number.
    each : callable
        As ``map``, on threads.
    central : bool
        Central differences in place of one-sided ones.
    """

    def __init__(
        self,
        records: Sequence[tuple[JointRecord, float]],
        inner: int,
        model: Model,
        handles: Sequence[Handle],
        bounds: tuple[Array, Array, Array],
        each: Each,
        central: bool,
    ) -> None:
        self.each, self.central = each, central
        self.works = [
            Points(record, model, handles, bandwidth, inner) for record, bandwidth in records
        ]
        ends = np.cumsum([record.n for record, _ in records]).tolist()
        self.rows = [slice(a, b) for a, b in zip([0, *ends], ends, strict=False)]
        self.low, self.high, self.size = bounds
        self.prior = np.array(
            [
                1.0 / (0.3 * size) if h.place == "offset" else 0.0
                for h, size in zip(handles, self.size, strict=True)
            ]
        )
        self.held = np.flatnonzero(self.prior)
        self.pairs = pairs_of(model, handles)
        self.centre = get_values(model, handles)
        # reused arrays, since new ones take the system long
        self._columns: dict[int, Array] = {}
        self._spare: list[Array] = []
        # impacts make the cost rough on a fine scale, which differences over 0.1 % smooth
        self.rough = any(get_effect(t.effect).rough for t in model.terms)
        self.coarse = 2e-3 if self.rough else 1e-4

    def evaluate(self, points: Sequence[Array]) -> Array:
        """Residuals at some points, including the prior's, (N, points). Copy them: the next ones
        are written to the same place.
        """
        groups = [points[i : i + LANES] for i in range(0, len(points), LANES)]
        out = [self._place(i, len(group)) for i, group in enumerate(groups)]
        tasks = [
            (work, group, place[rows] if len(group) > 1 else place[rows, 0])
            for work, rows in zip(self.works, self.rows, strict=True)
            for group, place in zip(groups, out, strict=True)
        ]
        list((map if len(tasks) == 1 else self.each)(lambda t: t[0].innovations(*t[1:]), tasks))
        last = self.rows[-1].stop
        for group, place in zip(groups, out, strict=True):
            for column, at in enumerate(group if len(self.held) else ()):
                place[last:, column] = (self.prior * (at - self.centre))[self.held]
        columns = [place[:, : len(group)] for group, place in zip(groups, out, strict=True)]
        return columns[0] if len(columns) == 1 else np.concatenate(columns, axis=1)

    def _place(self, group: int, points: int) -> Array:
        """The buffer for the residuals of a group of points, a row each."""
        rows = self.rows[-1].stop + len(self.held)
        if points == 1:
            return np.empty((rows, 1))
        if group not in self._columns:
            self._columns[group] = np.empty((rows, LANES))
        return self._columns[group]

    def jacobian(self, at: Array, base: Array | None = None) -> tuple[Array, Array]:
        """Residual and Jacobian at a point. Without ``base`` (its residual), the point is evaluated
        together with its neighbours.
        """
        step = self.coarse * np.maximum(np.abs(at), self.size)
        step = np.where(at + step > self.high, -step, step)
        moves = np.diag(step)
        ahead = [at + move for move in moves]
        back = []
        if self.central:
            moved = [at - move for move in moves]
            back = [np.clip(point, self.low, self.high) for point in moved]
        here = [at] if base is None else []
        points = [*here, *ahead, *back]
        columns = self.evaluate(points) if points else np.zeros((0, 0))
        if base is None:
            base, columns = columns[:, 0].copy(), columns[:, 1:]
        if not ahead:
            return base, np.zeros((len(base), 0))
        out = self._spare.pop() if self._spare else np.empty((len(base), len(at)))
        behind = columns[:, len(at) :] if self.central else base[:, None]
        widths = np.array(
            [(p - q)[i] for i, (p, q) in enumerate(zip(ahead, back or [at] * len(at), strict=True))]
        )
        np.subtract(columns[:, : len(at)], behind, out=out)
        out /= widths
        return base, out

    def ways(
        self, x: Array, r: Array, jac: Array
    ) -> tuple[Callable[[Sequence[float]], list[Array]], float]:
        """The Levenberg-Marquardt steps from a point for each damping; and the decrease of the cost
        by an undamped step, if the residual were linear.
        """
        # of each number: a gap in mm and a stiffness in MN/m meet in one matrix
        unit = np.maximum(np.abs(x), self.size)
        gradient, normal = unit * (jac.T @ r), unit[:, None] * (jac.T @ jac) * unit
        diagonal = normal.diagonal()
        diagonal = np.maximum(diagonal, 1e-12 * max(float(diagonal.max()), 1e-300))
        use = ~(((x <= self.low) & (gradient > 0)) | ((x >= self.high) & (gradient < 0)))

        def step(damping: float) -> Array:
            out = np.zeros_like(x)
            if use.any():
                a = normal[np.ix_(use, use)]
                a.flat[:: len(a) + 1] += damping * diagonal[use]
                out[use] = -np.linalg.lstsq(a, gradient[use], rcond=1e-14)[0]
            return out

        def ways(dampings: Sequence[float]) -> list[Array]:
            bent = (straight(x, unit * step(d), self.pairs) for d in dampings)
            return [np.clip(way, self.low, self.high) for way in bent]

        return ways, -float(gradient @ step(0.0))

    def better(
        self, x: Array, r: Array, jac: Array, damping: float, ends: float, least: float
    ) -> tuple[float, Array, Array, Array | None] | None:
        """A point with a smaller cost: damping, point, residual, and its Jacobian (not of a last
        step, which promises less than ``ends``). None where no step helps, or none promises the
        ``least`` decrease.
        """
        cost = float(r @ r)
        shorter = [max(damping, 1e-6 / 6.0) * 6.0**i for i in range(1, TRIES)]
        ways, promised = self.ways(x, r, jac)
        if promised < least:
            return None
        for dampings in ([damping], shorter):  # then all shorter steps at once
            trials = ways(dampings)
            slope: Array | None = None
            if len(trials) == 1 and promised > ends:  # most first steps are accepted
                first, slope = self.jacobian(trials[0])
                rows = first[None]
            else:
                rows = np.ascontiguousarray(self.evaluate(trials).T)
            for value, at, row in zip(dampings, trials, rows, strict=True):
                if float(row @ row) < cost:
                    return value, at, row, slope
            if slope is not None:
                self._spare.append(slope)
        return None

    def descend(
        self, x: Array, iterations: int, tolerance: float, brief: bool, goal: float = math.inf
    ) -> tuple[Array, Array, Array]:
        """The minimum reached from a point, with residual and Jacobian there; or a point from which
        it does not get near a cost of ``goal``.
        """
        x = np.clip(x, self.low, self.high)
        r, jac = self.jacobian(x)
        cost, damping, done, count = float(r @ r), 1e-3, not len(x), 0
        # on what is rough a step may gain where nothing is promised
        worth = 0.0 if self.rough else WORTH_A_STEP[0 if brief else 1] * tolerance
        while not done and count < iterations:
            count += 1
            least = max(worth * cost, (cost - goal) / BEYOND_PROMISE)
            last = brief and count == iterations
            ends = math.inf if last else tolerance * cost if brief and not self.rough else -math.inf
            better = self.better(x, r, jac, damping, ends, least)
            if not better:
                done = True
                break
            before = cost
            damping, x, r, slope = better
            cost, damping = float(r @ r), max(damping / 8, 1e-9)
            done = (before - cost) / max(before, 1e-300) < tolerance
            if slope is not None:
                self._spare.append(jac)
                jac = slope
            elif not brief or not (done or last):
                jac = self.jacobian(x, r)[1]
        return x, r, jac
