"""Every effect of the library, tried to first order at the cost of one least squares.

The torque of an effect along the measured motion, passed through the observer's error dynamics, is
its trace in the innovations. What the calibrated parameters can imitate is projected out first: the
baseline of every claim is the refitted model.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.search.orders import between, outstanding
from zendsp.physics.calibration.bounds import parameter_bounds
from zendsp.physics.calibration.fit import Data, Fit, residuals
from zendsp.physics.calibration.handles import Handle
from zendsp.physics.calibration.joint import JointRecord, along, effective_inertia, facts
from zendsp.physics.calibration.observed import (
    damping_along,
    matched,
    response,
    sensed,
    trace,
    traces,
)
from zendsp.physics.calibration.terms import grid_of, make_term, usable
from zendsp.physics.effects import Effect, get_effect, is_supported, library
from zendsp.physics.effects.base import Parameter
from zendsp.physics.kernel.threads import threads
from zendsp.physics.model import Model, Term, per_joint

Array = npt.NDArray[np.float64]

TOGETHER = 8  # grid points whose columns are computed at once
# sites of effects whose torque does not depend on other terms
ADDED = ("torque", "load", "viscous", "dry", "sensor")
SCALES = ("scale", "dry_scale")
# of a column's energy: less is rounding, where calibrated parameters imitate the column
IMITATED = 1e-8
# bytes of traces of a recording at most: of 25 s, thinned, all. With half of it a screen computed
# a third of them again
REMEMBERED = 6e7
FIRST_ORDER = 0.05  # s: largest shift in time that is nearly of first order; no fit starts beyond


@dataclass(frozen=True)
class Candidate:
    """A hypothesis with start values: terms to add at one joint, and what they replace."""

    effect: str
    joint: int
    terms: tuple[Term, ...]
    replaces: tuple[str, ...]
    # promised decrease of the cost; for a transmission, of the deviance per sample; nan where only
    # a fit can show it
    gain: float
    beneath: Model | None = None  # numbers to start from instead of the calibrated ones

    @property
    def key(self) -> tuple[str, int]:
        """Effect and joint."""
        return self.effect, self.joint


def phase_of(effect: Effect) -> str:
    """The name of the phase of a sine with a linear amplitude, empty where there is none."""
    return next((n for n in effect.names if n in ("phase", "angle")), "") if effect.linear else ""


def _neutral_of(effect: Effect, point: dict[str, float]) -> bool:
    """Whether an effect is a spring whose neutral point is not in the grid, but a constant torque
    beside it.
    """
    return "neutral" in effect.names and "neutral" not in point


def _first_order(value: float, parameter: Parameter) -> float:
    """A time limited to the range of first order; other numbers unchanged."""
    return float(np.clip(value, -FIRST_ORDER, FIRST_ORDER)) if parameter.size == "time" else value


def _unit_values(effect: Effect, values: dict[str, float], linear: str) -> dict[str, float]:
    return {**values, **{name: (1.0 if name == linear else 0.0) for name in effect.linear}}


class Screen:
    """One joint's screen around a calibrated fit."""

    def __init__(self, data: Data, fit: Fit, joint: int, joints_fitted: tuple[int, ...]) -> None:
        self.data, self.model, self.joint = data, fit.model, joint
        self.records = [rec[joint - 1] for rec in data.records]
        self.bandwidth = data.bandwidth[joint - 1]
        rows = self._rows(data, joint, joints_fitted)
        self.r = fit.residual[: sum(r.n * len(joints_fitted) for r in self.records)][rows]
        jac = fit.jacobian[: len(fit.residual)][
            : sum(r.n * len(joints_fitted) for r in self.records)
        ][rows]
        self.q = _imitable(fit, jac)
        self.left = self.r - self.q @ (self.q.T @ self.r)
        self.floors = [self._floor(rec) for rec in self.records]
        self.base = [
            trace(rec, self.model, self.model.at(joint), floor)
            for rec, floor in zip(self.records, self.floors, strict=True)
        ]
        self.inertias = [effective_inertia(rec, self.model) for rec in self.records]
        self.dampings = [damping_along(rec, self.model) for rec in self.records]
        self.motions = [along(rec, self.model) for rec in self.records]
        self.free = [
            self._free(rec, floor) for rec, floor in zip(self.records, self.floors, strict=True)
        ]
        self.cost = float(self.left @ self.left)
        known = [get_effect(t.effect) for t in self.model.at(joint)]
        self.scaled = any(effect.site in SCALES for effect in known)
        self.hidden = any(effect.scan is not None for effect in known)  # states that no trace knows

    @staticmethod
    def _rows(data: Data, joint: int, joints: tuple[int, ...]) -> npt.NDArray[np.bool_]:
        parts = [np.full(rec[j - 1].n, j == joint) for rec in data.records for j in joints]
        return np.concatenate(parts)

    @staticmethod
    def _floor(record: JointRecord) -> float:
        return max(
            3.0 * float(np.sqrt(np.median(record.motion.variances[1]))), 0.01 * record.scale.speed
        )

    def _free(self, record: JointRecord, floor: float) -> Array:
        """Per sample, 1 where the joint can follow an added torque, (n,); less where it almost
        stands and the model's dry friction balances the torque.
        """
        if not any(get_effect(t.effect).site == "dry" for t in self.model.at(self.joint)):
            return np.ones(record.n)
        free: Array = np.tanh(np.abs(record.motion.states[1]) / floor)
        return free

    def series(self, columns: Sequence[tuple[Term, ...]], *, alone: bool = False) -> Array:
        """Weighted responses to the torques of some added terms, a row a column, (columns, n of all
        recordings).

        ``alone``: without the model's other terms, for a term that replaces some of them.
        """
        on_sensor = get_effect(columns[0][0].effect).at_sensor
        parts = []
        for i, rec in enumerate(self.records):
            torques = np.empty((len(columns), rec.n))
            follows = 1.0 if on_sensor else self.free[i]
            for row, torque in zip(torques, self._torques(i, columns, alone), strict=True):
                np.multiply(torque, follows, out=row)
            parts.append(self._respond(i, torques, on_sensor=on_sensor))
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def _torques(
        self, i: int, columns: Sequence[tuple[Term, ...]], alone: bool
    ) -> Iterable[Array]:
        """The torques with which added terms of one effect resist along the measured motion, (n,)
        each; for effects on the sensor, the positions that they add.
        """
        effect, rec, floor = get_effect(columns[0][0].effect), self.records[i], self.floors[i]
        if (column := effect.column) is not None:
            motion = self.motions[i]
            numbers = ({n: q.value for n, q in t.parameters.items()} for (t, *_) in columns)
            return (np.asarray(column(motion, values)) for values in numbers)
        if effect.at_sensor:
            return (-sensed(rec, terms) for terms in columns)
        if alone or (not self.scaled and effect.site in ADDED):
            return self._alone(rec, columns, floor)
        known = self.model.at(self.joint)
        return traces(rec, self.model, [(*known, *t) for t in columns], floor) - self.base[i]

    def _alone(
        self, rec: JointRecord, columns: Sequence[tuple[Term, ...]], floor: float
    ) -> list[Array]:
        """The traces of added terms, each computed once per recording, since nothing else of the
        model enters.
        """
        gain = per_joint(self.model.actuator.gain, self.joint, 1.0)
        keys = [(floor, gain, *((t.effect, *t.parameters.items()) for t in c)) for c in columns]
        known = {key: rec.traces[key] for key in keys if key in rec.traces}
        wanted = {k: terms for k, terms in zip(keys, columns, strict=True) if k not in known}
        if wanted:
            made = traces(rec, self.model, list(wanted.values()), floor)
            for key, torque in zip(wanted, made, strict=True):
                known[key] = torque
                if len(rec.traces) * torque.nbytes < REMEMBERED:
                    rec.traces[key] = torque.copy()  # not a view that holds all
        return [known[key] for key in keys]

    def _respond(self, i: int, columns: Array, *, on_sensor: bool = False) -> Array:
        rec = self.records[i]
        return response(
            rec,
            self.bandwidth,
            self.inertias[i],
            self.dampings[i],
            columns,
            on_sensor=on_sensor,
            unseen=True,
        )

    def groups(self, columns: Array, each: int) -> Iterator[tuple[float, Array]]:
        """The decrease of the cost by each group of ``each`` columns, and their coefficients."""
        known, moments = columns @ self.q, (columns @ self.left).reshape(-1, each)
        some = columns.reshape(-1, each, 1, columns.shape[1])
        # only columns of the same group: products of single rows
        grams = (some[:, :, None] @ some[:, None].swapaxes(-1, -2))[..., 0, 0]
        whole = grams.diagonal(axis1=1, axis2=2).copy()
        beside = known.reshape(len(grams), each, known.shape[1])
        grams -= beside @ beside.swapaxes(1, 2)
        for i in np.flatnonzero((grams.diagonal(axis1=1, axis2=2) < IMITATED * whole).any(axis=1)):
            b = some[i, :, 0] - beside[i] @ self.q.T  # almost equal numbers
            grams[i], moments[i] = b @ b.T, b @ self.left
        norms = np.sqrt(grams.diagonal(axis1=1, axis2=2))
        norms[norms == 0] = 1.0
        for gram, moment, norm in zip(grams, moments, norms, strict=True):
            if not np.isfinite(norm).all():  # numbers at which the effect vanishes
                yield 0.0, np.zeros(each)
                continue
            outer = moment / norm
            theta = -_least_squares(gram / (norm * norm[:, None]), outer)
            yield float(-theta @ outer), theta / norm

    def candidates(self, only: frozenset[str] = frozenset(), jobs: int = 1) -> list[Candidate]:
        """The effects of the library (or some of them) at their best grid points, best first."""
        present = {t.effect for t in self.model.at(self.joint)}
        effects = [
            e
            for e in library().values()
            if self._applies(e, present) and (not only or e.name in only)
        ]
        with threads(jobs) as each:
            found = each(self._best, effects)
            return sorted(itertools.chain.from_iterable(found), key=lambda c: -c.gain)

    def _applies(self, effect: Effect, present: set[str]) -> bool:
        """Whether an effect can be screened here at all."""
        if effect.site == "body":  # decided by all joints: see bodies.py
            return False
        if effect.site == "setup" and effect.column is None:
            return False
        if effect.name in present and not effect.repeatable:
            return False
        return is_supported(effect, present) and usable(effect, self.records)

    def best_of(self, name: str, points: Sequence[dict[str, float]]) -> Candidate:
        """The candidate of an effect at the best of some points of its grid."""
        effect = get_effect(name)
        return self._candidate(effect, *max(self._at(effect, points), key=lambda found: found[0]))

    def gain_of(self, candidate: Candidate) -> float:
        """The decrease of the cost that a candidate of one term promises at its grid point. Where
        the model has hidden states, which no trace knows, by a simulation of the candidate's size.
        """
        effect = get_effect(candidate.effect)
        free = {*effect.linear, phase_of(effect), "neutral"}
        numbers = candidate.terms[0].parameters.items()
        point = {name: q.value for name, q in numbers if name not in free}
        if not self.hidden:
            return max(gain for gain, _ in self._at(effect, [point]))
        sizes = {n: abs(candidate.terms[0].value(n)) or 1.0 for n in effect.linear}
        columns = self.simulated(
            [
                make_term(effect, self.joint, {n: v * sizes.get(n, 1.0) for n, v in way.items()})
                for way in self._directions(effect, point)
            ]
        )
        return next(self.groups(columns, len(columns)))[0]

    def simulated(self, terms: Sequence[Term]) -> Array:
        """What some terms of one effect change in the innovations, each alone, (terms, n of all
        recordings).
        """
        trials = [replace(self.model, terms=(*self.model.terms, term)) for term in terms]
        return np.ascontiguousarray(residuals(self.data, trials, (self.joint,)).T - self.r)

    def _best(self, effect: Effect) -> list[Candidate]:
        """The candidates of an effect at its best grid point, one for each choice of the numbers
        that no fit moves (a coupling's law).
        """
        chosen = [p.name for p in effect.parameters if not p.fitted]
        points: dict[tuple[float | None, ...], list[dict[str, float]]] = {}
        for point in (*grid_of(effect, self.records[0], self.model), *self._beyond(effect)):
            points.setdefault(tuple(point.get(name) for name in chosen), []).append(point)
        best = (
            max(self._at(effect, group), key=lambda found: found[0]) for group in points.values()
        )
        return [
            self._candidate(effect, gain, self._searched_for(effect, values))
            for gain, values in best
        ]

    def _beyond(self, effect: Effect) -> list[dict[str, float]]:
        """Grid points of a wave over the position between those of its grid and beyond, at the
        ``orders``.
        """
        if "order" in effect.grid:
            return [{"order": n} for n in self.orders]
        if "period" not in effect.grid:
            return []
        least, _ = parameter_bounds(effect.name, "period", self.records[0])
        periods = [2.0 * math.pi / n for n in self.orders]
        return [{"period": p} for p in periods if p >= least]

    @cached_property
    def orders(self) -> list[float]:
        """The orders at which what is left repeats with the position: as a torque, as a friction,
        or as an error of the position, which takes torque with the square of the speed.
        """
        if self.records[0].slides:
            return []
        ends = np.cumsum([r.n for r in self.records])[:-1]
        seen = [
            free * matched(rec, self.bandwidth, inertia, damping, left)
            for rec, free, inertia, damping, left in zip(
                self.records, self.free, self.inertias, self.dampings,
                np.split(self.left, ends), strict=True,
            )
        ]  # fmt: skip
        found: list[float] = []
        for way in (np.ones_like, np.sign, np.square):
            ways = [way(rec.motion.states[1]) for rec in self.records]
            series = [g * w for g, w in zip(seen, ways, strict=True)]
            found += between(self.records, series) + outstanding(self.records, series)
        return list(dict.fromkeys(found))

    def _searched_for(self, effect: Effect, values: dict[str, float]) -> dict[str, float]:
        """The values, of a wave with an order within the limits of a search: only a given one may
        have fewer periods in the travel.
        """
        for name in effect.names:
            if effect.parameter(name).size == "order":
                low, high = parameter_bounds(effect.name, name, self.records[0])
                return {**values, name: min(max(values[name], low), high)}
        return values

    def _at(
        self, effect: Effect, points: Sequence[dict[str, float]]
    ) -> Iterator[tuple[float, dict[str, float]]]:
        """The decrease of the cost and all values, at each grid point."""
        wanted = [
            [(make_term(effect, self.joint, values),) for values in self._directions(effect, point)]
            for point in points
        ]
        each = len(wanted[0])
        for begin in range(0, len(points), TOGETHER):
            some = slice(begin, begin + TOGETHER)
            rows = self.series(
                list(itertools.chain.from_iterable(wanted[some])), alone=bool(effect.replaces)
            )
            for point, found in zip(points[some], self.groups(rows, each), strict=True):
                yield self._judge(effect, point, *found)

    def _directions(self, effect: Effect, point: dict[str, float]) -> list[dict[str, float]]:
        """The values whose torques span all torques that the effect can make at a grid point."""
        if _neutral_of(effect, point):
            s = facts(self.records[0])
            return [
                {**point, effect.linear[0]: 1.0, "neutral": s.centre + way * s.scale.position}
                for way in (0.0, 0.5)
            ]
        phase = phase_of(effect)
        if phase:
            second = -np.pi / 2 if phase == "angle" else np.pi / 2
            return [{**point, effect.linear[0]: 1.0, phase: angle} for angle in (0.0, second)]
        return [_unit_values(effect, point, name) for name in effect.linear] or [point]

    def mixed(self, effect: Effect, point: dict[str, float], theta: Array) -> dict[str, float]:
        """The values of an effect with a phase or a neutral position, from the coefficients of its
        directions.
        """
        phase = phase_of(effect)
        if phase:
            angle = float(np.arctan2(theta[1], theta[0])) * (-1 if phase == "angle" else 1)
            return {**point, effect.linear[0]: float(np.hypot(*theta)), phase: angle}
        s = facts(self.records[0])
        k = max(
            float(theta[0] + theta[1]), 1e-3 * s.scale.of(effect.parameter(effect.linear[0]).size)
        )
        neutral = s.centre + 0.5 * s.scale.position * float(theta[1]) / k
        return {**point, effect.linear[0]: k, "neutral": neutral}

    def least_seen(
        self, effect: Effect, point: dict[str, float], trace: Callable[[Term], Array]
    ) -> tuple[dict[str, float], Array]:
        """The values at a grid point with the smallest trace for their size, and the trace: the
        worst phase, or the worst neutral position within the travel.
        """
        listed = self._directions(effect, point)
        one = trace(make_term(effect, self.joint, listed[0]))
        phase = bool(phase_of(effect))
        if not phase and not _neutral_of(effect, point):
            return listed[0], one
        other = trace(make_term(effect, self.joint, listed[1]))
        if phase:
            pair = np.array([one, other])
            mixture = np.linalg.eigh(pair @ pair.T)[1][:, 0]
            return self.mixed(effect, point, mixture), mixture @ pair
        way = other - one
        along = float(np.clip(-(one @ way) / max(float(way @ way), 1e-300), -1.0, 1.0))
        s = facts(self.records[0])
        neutral = s.centre + 0.5 * s.scale.position * along
        return {**listed[0], "neutral": neutral}, one + along * way

    def _judge(
        self, effect: Effect, point: dict[str, float], gain: float, theta: Array
    ) -> tuple[float, dict[str, float]]:
        if _neutral_of(effect, point) or phase_of(effect):
            return gain, self.mixed(effect, point, theta)
        if not effect.linear:
            return (gain if theta[0] > 0 else 0.0), point
        values = {**point, **{name: float(v) for name, v in zip(effect.linear, theta, strict=True)}}
        if effect.replaces:
            return gain, self._add_replaced(effect, values)
        if effect.column is not None:
            values = {n: _first_order(v, effect.parameter(n)) for n, v in values.items()}
        if all(values[n] >= effect.parameter(n).lower for n in effect.linear):
            return gain, values
        return 0.0, {
            n: max(v, self._least(effect, n)) if n in effect.linear else v
            for n, v in values.items()
        }

    def _least(self, effect: Effect, name: str) -> float:
        """The value of an effect so small that it hardly acts."""
        size, known = effect.parameter(name).size, facts(self.records[0])
        return known.sample_time if size == "time" else 1e-3 * known.scale.of(size)

    def _add_replaced(self, effect: Effect, values: dict[str, float]) -> dict[str, float]:
        size = facts(self.records[0]).scale
        for term in self.model.at(self.joint):
            if term.effect in effect.replaces:
                base = next(iter(term.parameters.values())).value
                values = {n: v + base for n, v in values.items()}
        return {n: max(v, 1e-3 * size.of(effect.parameter(n).size)) for n, v in values.items()}

    def _candidate(self, effect: Effect, gain: float, values: dict[str, float]) -> Candidate:
        replaces = tuple(t.effect for t in self.model.at(self.joint) if t.effect in effect.replaces)
        return Candidate(
            effect.name, self.joint, (make_term(effect, self.joint, values),), replaces, gain
        )


def _imitable(fit: Fit, jac: Array) -> Array:
    """Orthonormal columns that span all that the calibrated numbers can imitate, (rows, up to p).
    """
    # a prior holds the sensor's zero within a count: it must not absorb more than that
    jac = jac[:, [h.place != "offset" for h in fit.handles]]
    norms = np.linalg.norm(jac, axis=0)
    jac = jac[:, norms > 0] / norms[norms > 0]
    return np.linalg.qr(jac)[0] if jac.shape[1] else np.zeros((len(jac), 0))


def promised(base: Fit, others: Array) -> Array:
    """The decrease of the deviance per sample between a fit and each of some other innovations,
    (m, n), to first order: with the calibrated numbers and the size of the change fitted, (m,).
    """
    n = others.shape[1]
    r, q = base.residual[:n], _imitable(base, base.jacobian[:n])
    left, ways = r - q @ (q.T @ r), others - r
    ways -= (ways @ q) @ q.T
    along, size = ways @ left, np.einsum("mn,mn->m", ways, ways)
    ahead = (along < 0) & (size > 0)
    share = np.zeros(len(others))
    share[ahead] = along[ahead] ** 2 / size[ahead] / max(float(r @ r), 1e-300)
    return np.asarray(-np.log(np.maximum(1.0 - share, 1e-9)))


def _least_squares(gram: Array, moment: Array) -> Array:
    """Least-squares coefficients of a few columns of length 1."""
    beside = float(gram[0, -1])
    if len(gram) == 1 and beside == 1.0:
        return moment
    if len(gram) == 2 and 1.0 - abs(beside) > IMITATED:
        return np.asarray((moment - beside * moment[::-1]) / (1.0 - beside * beside))
    return np.asarray(np.linalg.lstsq(gram, moment, rcond=1e-9)[0])


def with_candidate(model: Model, candidate: Candidate) -> Model:
    """The model with the candidate's terms added and the replaced terms removed."""
    model = candidate.beneath or model
    kept = tuple(
        t
        for t in model.terms
        if not (t.joint == candidate.joint and t.effect in candidate.replaces)
    )
    return replace(model, terms=(*kept, *candidate.terms))


def touched(handles: tuple[Handle, ...], model: Model, joint: int) -> tuple[int, ...]:
    """The joints whose innovations depend on parameters shared with this joint (1-based)."""
    shared = any(h.place == "mechanism" for h in handles) and model.joints > 1
    return tuple(range(1, model.joints + 1)) if shared else (joint,)
