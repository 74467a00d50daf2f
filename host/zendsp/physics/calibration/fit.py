"""Calibration: the parameters that minimise the observer's innovations (prediction error method,
Ljung 1999, ch. 7).

``Descent`` finds them. The covariance is block-wise robust, so that correlated innovations do not
give too small uncertainties.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.bounds import parameter_bounds
from zendsp.physics.calibration.covariance import robust_covariance
from zendsp.physics.calibration.descent import Descent
from zendsp.physics.calibration.handles import (
    Handle,
    Tie,
    free_handles,
    get_values,
    set_values,
    tied,
)
from zendsp.physics.calibration.joint import JointRecord, facts
from zendsp.physics.calibration.predict import run, run_many
from zendsp.physics.effects import get_effect
from zendsp.physics.kernel.native import LANES
from zendsp.physics.kernel.threads import Each, threads
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

# factor within which inertial numbers are calibrated where the recordings give no range
TOO_FAR = 3.0
BLOCK_S = 0.25
NEAR = 0.02  # of a bound: a number this near counts as at it
# rad: best setting of a position sensor's zero; the prior standard deviation is 0.3 of it
ZERO_ERROR = 2e-3
# s between the samples of a first fit: sixteen per radian of the fastest observer
FIRST_LOOK = 4e-3
REMEMBERED = 32  # fits kept for a recording, since a search repeats some


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
    return tied(model, out, data.ties)


@dataclass(frozen=True)
class Data:
    """Recordings ready to be fitted. ``records[r][j]``: joint j + 1 of recording r.
    ``bandwidth[j]``: that of its observer, rad/s.
    """

    records: tuple[tuple[JointRecord, ...], ...]
    bandwidth: tuple[float, ...]
    inner: int = 2
    ranges: Mapping[tuple[str, int], tuple[float, float]] = field(
        default_factory=dict
    )  # of inertial figures: see diagnosis/data/inertia.py
    # of loads on springs, by joint: see diagnosis/transmission/load_side.py
    ties: Mapping[int, tuple[Tie, ...]] = field(default_factory=dict)

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.records[0])

    def thinned(self) -> Data:
        """The same recordings, thinned for a first fit of a hypothesis."""
        return replace(
            self,
            records=tuple(
                tuple(r.thinned(int(FIRST_LOOK / r.sample_time + 1e-6)) for r in rec)
                for rec in self.records
            ),
        )

    def liveliest(self, joint: int, seconds: float) -> Data:
        """The recordings reduced to the part in which a joint (1-based) is accelerated most: this
        long, or a quarter.
        """
        records = [list(rec) for rec in self.records]
        for rec in records:
            record = rec[joint - 1]
            long = max(seconds, record.n * record.sample_time / 4)
            rec[joint - 1] = record.liveliest(long)
        return replace(self, records=tuple(map(tuple, records)))

    def within_limits_of(self, other: Data) -> Data:
        """The recordings with the limits of numbers from other recordings. A shorter travel does
        not show a wave with few periods, which a fit would then bend to one with many.
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

    def forget(self) -> None:
        """Let go of what was computed along the recordings and can be computed again."""
        for rec in self.records:
            for record in rec:
                record.forget()

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
    """``residual`` for models that differ in numbers only, (N, models)."""
    works = [
        partial(run_many, rec[j - 1], bandwidth=data.bandwidth[j - 1], inner=data.inner)
        for rec in data.records
        for j in joints
    ]
    # in groups of as many models as the kernel takes
    groups = [models[i : i + LANES] for i in range(0, len(models), LANES)]
    tasks = [(work, group) for work in works for group in groups]
    done = list((map if len(tasks) == 1 else each)(lambda task: task[0](task[1]), tasks))
    beside = [done[i : i + len(groups)] for i in range(0, len(done), len(groups))]
    return np.concatenate([np.concatenate(parts, axis=1) for parts in beside])


def within_basin(order: float, low: float, high: float, travel: float) -> tuple[float, float]:
    """The bounds of a wave's order. One with fewer periods in the ``travel`` than can be searched
    for is a given one: it stays within half a period over the travel, since beyond it is another
    wave.
    """
    half = math.pi / travel
    return (low, high) if order >= low else (max(0.0, order - half), order + half)


def bounds_and_steps(
    data: Data, model: Model, handles: Sequence[Handle]
) -> tuple[Array, Array, Array]:
    """Lower and upper bounds and the natural size of each number, (p,) each."""
    low, high, size = [], [], []
    for h in handles:
        if h.tie is not None:
            low.append(h.tie.within[0])
            high.append(h.tie.within[1])
            size.append(h.tie.ratio)
        elif h.place == "term":
            term = model.terms[h.index]
            parameter = get_effect(term.effect).parameter(h.key)
            # parts of the data prepared apart have ranges of their own
            records = {id(facts(r)): r for r in (rec[term.joint - 1] for rec in data.records)}
            s = max(facts(r).scale.of(parameter.size) for r in records.values())
            pairs = [parameter_bounds(term.effect, h.key, r) for r in records.values()]
            lower, upper = min(pairs)[0], max(b for _, b in pairs)
            if parameter.size == "order":
                travel = max(facts(r).scale.position for r in records.values())
                lower, upper = within_basin(term.value(h.key), lower, upper, travel)
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
            # Data.ranges assumes that the command accelerates the joint
            free = any(get_effect(t.effect).loosens_inertia for t in model.terms)
            known = wide if free else data.ranges.get((h.key, h.index), wide)
            lower, upper = (-np.inf, np.inf) if signed else known
            low.append(lower)
            high.append(upper)
            size.append(abs(value))
    return np.array(low), np.array(high), np.array(size)


def at_bounds(x: Array, low: Array, high: Array, handles: Sequence[Handle]) -> tuple[bool, ...]:
    """Whether each number has come to one of its bounds, (p,)."""
    near = np.isclose(x, low, rtol=NEAR, atol=1e-12) | np.isclose(x, high, rtol=NEAR, atol=1e-12)
    return tuple(bool(v) and h.tie is None for v, h in zip(near, handles, strict=True))


def block_count(data: Data) -> int:
    """Samples in one block of the robust statistics."""
    return max(10, round(BLOCK_S / data.records[0][0].sample_time))


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
    goal: float = math.inf,
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
        Most Levenberg-Marquardt steps.
    tolerance : float
        Stop when the relative decrease of the cost falls below.
    jobs : int
        Threads.
    start : ndarray or None, shape (p,)
        Other start values.
    central : bool
        Central instead of one-sided differences: twice the work, for the last steps on a rough
        cost.
    brief : bool
        An intermediate fit: the Jacobian, and so the covariance, may be that of the step before.
    goal : float
        The cost below which the fit is of any use: it ends where no step promises that.
    """
    handles = tuple(handles)
    wanted = tuple(joints or range(1, data.joints + 1))
    begin = None if start is None else start.tobytes()
    key = (
        *(record.number for rec in data.records for record in rec),
        (data.bandwidth, data.inner, tuple(data.ranges.items())),
        (_content(model), handles, wanted, iterations, tolerance, begin, central, brief, goal),
    )
    known = data.records[0][wanted[0] - 1].fits
    if key in known:  # with the caller's own terms, as after a new fit
        found: Fit = known[key]
        return replace(found, model=set_values(model, handles, found.x))
    with threads(jobs) as each:
        records = [(rec[j - 1], data.bandwidth[j - 1]) for rec in data.records for j in wanted]
        bounds = bounds_and_steps(data, model, handles)
        problem = Descent(records, data.inner, model, handles, bounds, each, central)
        x = get_values(model, handles) if start is None else start
        x, r, jac = problem.descend(x, iterations, tolerance, brief, goal)
    rows = len(r) - np.count_nonzero(problem.prior)  # of the recordings
    covariance = robust_covariance(jac[:rows], r[:rows], block_count(data), problem.prior)
    at_bound = at_bounds(x, problem.low, problem.high, handles)
    found = Fit(
        set_values(model, handles, x), handles, x, covariance, float(r @ r), at_bound, jac, r,
    )
    known[key] = found
    while len(known) > REMEMBERED:
        known.pop(list(known)[0], None)  # noqa: RUF015  in one step: other threads add to it
    return found


def _content(model: Model) -> tuple[object, ...]:
    """The content of a model on which a fit depends, for comparison."""
    return (
        tuple(model.mechanism.items()),
        tuple((t.effect, t.joint, tuple(t.parameters.items())) for t in model.terms),
        model.actuator,
        model.sensor,
    )
