"""Calibration: the parameters that minimise the observer's innovations (prediction error method,
Ljung 1999, ch. 7).

Levenberg-Marquardt on the normal equations with box bounds; sensitivities by finite differences,
one simulation a parameter, on all threads (the kernel runs outside the interpreter's lock). The
covariance is block-wise robust, so that innovations that are not white do not pretend to know more
than they do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.bounds import parameter_bounds
from zendsp.physics.calibration.handles import (
    Handle,
    free_handles,
    get_values,
    pairs_of,
    set_values,
    straight,
)
from zendsp.physics.calibration.joint import JointRecord, facts
from zendsp.physics.calibration.points import Points
from zendsp.physics.calibration.predict import ran_away, run, run_many
from zendsp.physics.effects import get_effect
from zendsp.physics.kernel.native import LANES
from zendsp.physics.kernel.threads import Each, threads
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]
T = TypeVar("T")

# factor within which an inertial figure is calibrated where the recordings give no range of their
# own
TOO_FAR = 3.0
TRIES = 8  # ever shorter steps before a fit ends
# of the tolerance: what a step has to promise, to first order, to be tried; of a look, and of a fit
# whose numbers are stated
WORTH_A_STEP = 0.1, 1e-3
FEW_BLOCKS = 20  # as many blocks as the classical variance counts for
BLOCK_S = 0.25
UNKNOWN = 1e30  # variance of a number of which nothing is known
NEAR = 0.02  # of a bound, and a number counts as lying at it
# rad: no position sensor's zero is set better; prior standard deviation 0.3 of it
ZERO_ERROR = 2e-3
# s between the samples of a first look: sixteen a radian at the fastest observer that is tried
FIRST_LOOK = 4e-3
REMEMBERED = 32  # fits of a recording: a search asks for some of them again


def joint_handles(data: Data, model: Model, joint: int) -> tuple[Handle, ...]:
    """The free numbers that act on one joint (1-based): its terms, its sensor's zero, the mechanism
    parameters in its equation.
    """
    keys = set(data.records[0][joint - 1].basis) | {"gravity"}
    out = []
    for h in free_handles(model, joints=(joint,)):
        if h.place == "mechanism" and (
            h.key not in keys or (h.index != joint - 1 and len(model.mechanism[h.key]) > 1)
        ):
            continue
        out.append(h)
    return tuple(out)


@dataclass(frozen=True)
class Data:
    """Recordings ready to be fitted: ``records[r][j]`` is joint j + 1 of recording r;
    ``bandwidth[j]`` of its observer, rad/s.
    """

    records: tuple[tuple[JointRecord, ...], ...]
    bandwidth: tuple[float, ...]
    inner: int = 2
    ranges: Mapping[tuple[str, int], tuple[float, float]] = field(
        default_factory=dict
    )  # of inertial figures: see diagnosis/data/inertia.py

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.records[0])

    def thinned(self) -> Data:
        """The same recordings with samples as rare as a first look at a hypothesis needs them."""
        return replace(
            self,
            records=tuple(
                tuple(r.thinned(int(FIRST_LOOK / r.sample_time + 1e-6)) for r in rec)
                for rec in self.records
            ),
        )

    def liveliest(self, joint: int, seconds: float) -> Data:
        """The same recordings with the part of each in which a joint (1-based) is accelerated most:
        so long, or a quarter.
        """
        records = [list(rec) for rec in self.records]
        for rec in records:
            record = rec[joint - 1]
            long = max(seconds, record.n * record.sample_time / 4)
            rec[joint - 1] = record.liveliest(long)
        return replace(self, records=tuple(map(tuple, records)))

    def within_limits_of(self, other: Data) -> Data:
        """The same recordings, with the limits that a number has in others: a shorter travel shows
        no wave of few turns, which a fit would bend to one of many.
        """
        known = other.records[0]
        records = tuple(
            tuple(
                replace(one, _facts=facts(first), fits={}, runs={})
                for one, first in zip(rec, known, strict=True)
            )
            for rec in self.records
        )
        return replace(self, records=records)

    def at_bandwidth(self, joint: int, value: float) -> Data:
        """The same recordings with another observer on one joint (1-based)."""
        return replace(
            self,
            bandwidth=tuple(value if j + 1 == joint else b for j, b in enumerate(self.bandwidth)),
        )


@dataclass(frozen=True)
class Fit:
    """A fitted model: numbers (p,), covariance (p, p), residual (N,) of the joints fitted, cost =
    sum of squares.
    """

    model: Model
    handles: tuple[Handle, ...]
    x: Array
    covariance: Array
    cost: float
    at_bound: tuple[bool, ...]
    jacobian: Array
    residual: Array

    @property
    def std(self) -> Array:
        """Standard deviations (p,)."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))


def residual(data: Data, model: Model, joints: Sequence[int]) -> Array:
    """Weighted innovations of some joints over all recordings, (N,)."""
    parts = [
        run(rec[j - 1], model, data.bandwidth[j - 1], inner=data.inner).innovations
        for rec in data.records
        for j in joints
    ]
    return np.concatenate(parts)


def residuals(
    data: Data,
    models: Sequence[Model],
    joints: Sequence[int],
    each: Each = map,
) -> Array:
    """As ``residual`` for models that differ in numbers only, (N, models)."""
    works = [
        partial(run_many, rec[j - 1], bandwidth=data.bandwidth[j - 1], inner=data.inner)
        for rec in data.records
        for j in joints
    ]
    return _side_by_side(works, models, each)


def _side_by_side(
    works: Sequence[Callable[[Sequence[T]], Array]], items: Sequence[T], each: Each
) -> Array:
    """Columns of some items, as many at a time as the kernel takes, below one another by who works
    them out.
    """
    groups = [items[i : i + LANES] for i in range(0, len(items), LANES)]
    tasks = [(work, group) for work in works for group in groups]
    done = list((map if len(tasks) == 1 else each)(lambda task: task[0](task[1]), tasks))
    if len(groups) > 1:
        done = [
            np.concatenate(done[i : i + len(groups)], axis=1)
            for i in range(0, len(done), len(groups))
        ]
    return np.concatenate(done) if len(done) > 1 else done[0]


def bounds_and_steps(
    data: Data, model: Model, handles: Sequence[Handle]
) -> tuple[Array, Array, Array]:
    """Lower and upper bounds and the natural size of each number, (p,) each."""
    low, high, size = [], [], []
    for h in handles:
        if h.place == "term":
            term = model.terms[h.index]
            parameter = get_effect(term.effect).parameter(h.key)
            # parts of the data that were prepared apart say each its own
            records = {id(facts(r)): r for r in (rec[term.joint - 1] for rec in data.records)}
            s = max(facts(r).scale.of(parameter.size) for r in records.values())
            pairs = [parameter_bounds(term.effect, h.key, r) for r in records.values()]
            lower, upper = min(pairs)[0], max(b for _, b in pairs)
            if get_effect(term.effect).same_as:
                lower, upper = data.ranges.get((f"inertia {term.joint}", 0), (lower, upper))
            low.append(lower)
            high.append(upper)
            size.append(
                max(abs(term.parameters[h.key].value), 0.02 * s)
                if parameter.size not in ("angle", "number", "ratio")
                else 1.0
            )
            if parameter.size == "ratio":
                size[-1] = 0.1
        elif h.place == "offset":
            record = data.records[0][h.index]
            width = max(record.measurement.resolution, ZERO_ERROR)
            low.append(record.base_offset - width)
            high.append(record.base_offset + width)
            size.append(width)
        else:
            value = float(get_values(model, [h])[0])
            signed = h.place == "mechanism" and h.key in ("p3", "gravity")
            wide = (value / TOO_FAR, value * TOO_FAR)
            # Data.ranges takes the command for what accelerates
            free = any(get_effect(t.effect).loosens_inertia for t in model.terms)
            known = wide if free else data.ranges.get((h.key, h.index), wide)
            lower, upper = (-np.inf, np.inf) if signed else known
            low.append(lower)
            high.append(upper)
            size.append(abs(value))
    return np.array(low), np.array(high), np.array(size)


def block_count(data: Data) -> int:
    """Samples in one block of the robust statistics."""
    return max(10, round(BLOCK_S / data.records[0][0].sample_time))


class _Problem:
    """What is minimised: the residuals of some joints over some numbers, within their bounds."""

    def __init__(
        self,
        data: Data,
        model: Model,
        handles: Sequence[Handle],
        joints: Sequence[int],
        each: Each,
        central: bool,
    ) -> None:
        self.each, self.central = each, central
        records = [(rec[j - 1], data.bandwidth[j - 1]) for rec in data.records for j in joints]
        self.works = [
            Points(record, model, handles, bandwidth, data.inner) for record, bandwidth in records
        ]
        ends = np.cumsum([record.n for record, _ in records]).tolist()
        self.rows = [slice(a, b) for a, b in zip([0, *ends], ends, strict=False)]
        self.low, self.high, self.size = bounds_and_steps(data, model, handles)
        self.prior = np.array(
            [
                1.0 / (0.3 * size) if h.place == "offset" else 0.0
                for h, size in zip(handles, self.size, strict=True)
            ]
        )
        self.held = np.flatnonzero(self.prior)
        self.pairs = pairs_of(model, handles)
        self.centre = get_values(model, handles)
        # arrays written to again and again: the system takes long to give new ones
        self._columns: dict[int, Array] = {}
        self._spare: list[Array] = []
        # impacts make the cost rough on a fine scale: differences over a tenth of a percent look
        # past it
        self.rough = any(get_effect(t.effect).rough for t in model.terms)
        self.coarse = 2e-3 if self.rough else 1e-4

    def evaluate(self, points: Sequence[Array]) -> Array:
        """Residuals at some points, the prior's included, (N, points); to be copied, since the next
        ones are written to the same place.
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

    def remember(self, found: Fit) -> None:
        """Keep the predictions that a fit ended with: they are asked for again."""
        for work, rows in zip(self.works, self.rows, strict=True):
            work.remember(found.model, found.residual[rows])

    def _place(self, group: int, points: int) -> Array:
        """Where the residuals of a group of points are written, a row each."""
        rows = self.rows[-1].stop + len(self.held)
        if points == 1:
            return np.empty((rows, 1))
        if group not in self._columns:
            self._columns[group] = np.empty((rows, LANES))
        return self._columns[group]

    def jacobian(self, at: Array, base: Array | None = None) -> tuple[Array, Array]:
        """Residual and Jacobian at a point; without ``base``, its residual, one pass of the
        kernel takes the point beside its neighbours.
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
        """Where Levenberg-Marquardt goes from a point, by its damping; and by how much the cost
        would fall without any, were the residual linear.
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
        self, x: Array, r: Array, jac: Array, damping: float, last: bool, least: float
    ) -> tuple[float, Array, Array, Array | None] | None:
        """A point whose cost is smaller: damping, point, residual, and its Jacobian where that came
        with it, as it does but for the ``last`` step. None where no step helps, or none promises
        so much as the ``least`` part of the cost.
        """
        cost = float(r @ r)
        shorter = [max(damping, 1e-6 / 6.0) * 6.0**i for i in range(1, TRIES)]
        ways, promised = self.ways(x, r, jac)
        if promised < least * cost and not self.rough:
            return None
        for dampings in ([damping], shorter):  # then shorter steps, all of them at once
            trials = ways(dampings)
            slope: Array | None = None
            if len(trials) == 1 and not last:  # most first steps are taken, idle lanes cost nothing
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
        self, x: Array, iterations: int, tolerance: float, brief: bool
    ) -> tuple[Array, Array, Array]:
        """From a point to a minimum: where it is, and residual and Jacobian there."""
        x = np.clip(x, self.low, self.high)
        r, jac = self.jacobian(x)
        cost, damping, done, count = float(r @ r), 1e-3, not len(x), 0
        least = WORTH_A_STEP[0 if brief else 1] * tolerance
        while not done and count < iterations:
            count += 1
            better = self.better(x, r, jac, damping, brief and count == iterations, least)
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
            elif not brief or not (done or count == iterations):
                jac = self.jacobian(x, r)[1]
        return x, r, jac


def fit(
    data: Data,
    model: Model,
    handles: Sequence[Handle],
    *,
    joints: Sequence[int] = (),
    iterations: int = 12,
    tolerance: float = 1e-4,
    jobs: int = 2,
    start: Array | None = None,
    central: bool = False,
    brief: bool = False,
) -> Fit:
    """Fit the free numbers of a model to recordings.

    Parameters
    ----------
    model : Model
        Start values; terms in kernel form.
    handles : sequence of Handle
        What is free.
    joints : sequence of int
        Joints whose innovations count (1-based); all where empty.
    iterations : int
        At most so many Levenberg-Marquardt steps.
    tolerance : float
        Stop when the relative decrease of the cost falls below.
    jobs : int
        Threads.
    start : ndarray or None, shape (p,)
        Other start values.
    central : bool
        Central differences in place of one-sided ones: twice the work, for the last steps of a
        rough cost.
    brief : bool
        A step on the way: the Jacobian, and with it the covariance, may be that of the step before.
    """
    handles = tuple(handles)
    wanted = tuple(joints or range(1, data.joints + 1))
    begin = None if start is None else start.tobytes()
    key = (
        *(id(record) for rec in data.records for record in rec),
        (data.bandwidth, data.inner, tuple(data.ranges.items())),
        (_content(model), handles, wanted, iterations, tolerance, begin, central, brief),
    )
    known = data.records[0][wanted[0] - 1].fits
    if key in known:  # the terms are the caller's own, as if it had been fitted again
        found: Fit = known[key][0]
        return replace(found, model=set_values(model, handles, found.x))
    with threads(jobs) as each:
        problem = _Problem(data, model, handles, wanted, each, central)
        x = get_values(model, handles) if start is None else start
        x, r, jac = problem.descend(x, iterations, tolerance, brief)
    rows = len(r) - np.count_nonzero(problem.prior)  # of the recordings
    covariance = robust_covariance(jac[:rows], r[:rows], block_count(data), problem.prior)
    low, high = problem.low, problem.high
    near = np.isclose(x, low, rtol=NEAR, atol=1e-12) | np.isclose(x, high, rtol=NEAR, atol=1e-12)
    at_bound = tuple(bool(v) for v in near)
    found = Fit(
        set_values(model, handles, x), handles, x, covariance, float(r @ r), at_bound, jac, r,
    )
    problem.remember(found)
    known[key] = found, data.records  # kept alive, so that no other record gets its id
    while len(known) > REMEMBERED:
        known.pop(list(known)[0], None)  # noqa: RUF015  in one step: other threads add to it
    return found


def _content(model: Model) -> tuple[object, ...]:
    """All of a model that a fit depends on, to compare."""
    return (
        tuple(model.mechanism.items()),
        tuple((t.effect, t.joint, tuple(t.parameters.items())) for t in model.terms),
        model.actuator,
        model.sensor,
    )


def robust_covariance(jac: Array, r: Array, block: int, prior: Array | None = None) -> Array:
    """Covariance of least squares that holds when residuals are correlated within blocks
    (sandwich), (p, p).

    Where the blocks vary more than white innovations would, their variance counts. They may vary
    less: what a fast observer gets wrong in one sample it makes good in the next. Then their
    variance counts as much as there are blocks, beside the classical one.

    ``prior``: 1 over the standard deviation that a number has without any recording, 0 where it has
    none, (p,). What a model lacks makes residuals larger, but not a sensor's zero more uncertain.
    """
    n, p = jac.shape
    if not p:
        return np.zeros((0, 0))
    normal, noise = jac.T @ jac, float(r @ r) / max(1, n - p)
    known = np.diag(noise * prior**2) if prior is not None else np.zeros((p, p))
    normal = normal + known
    if not np.all(np.isfinite(jac)) or ran_away(r):
        return np.diag(np.full(p, UNKNOWN))  # the prediction has diverged
    strength = np.diag(normal)
    idle = strength <= float(r @ r) / UNKNOWN  # numbers that nothing depends on
    scale = np.where(idle, 1.0, np.sqrt(strength))
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-13) / np.outer(scale, scale)
    classic = inverse * noise
    starts = np.arange(0, n, block)
    scores = np.add.reduceat(jac * r[:, None], starts, axis=0)
    count = len(scores)
    spread = scores.T @ scores * count / max(1, count - p) + noise * known
    sandwich = inverse @ spread @ inverse
    white = np.maximum(np.diag(classic), 1e-300)
    blocks = np.maximum(np.diag(sandwich), 1e-6 * white)
    grow = np.sqrt(
        np.where(
            blocks < white, (count * blocks + FEW_BLOCKS * white) / (count + FEW_BLOCKS), blocks
        )
        / blocks
    )
    covariance: Array = sandwich * np.outer(grow, grow)
    covariance[idle, :], covariance[:, idle] = 0.0, 0.0
    covariance[idle, idle] = UNKNOWN
    return covariance
