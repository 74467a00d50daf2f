"""Every effect of the library, tried to first order for the price of one least squares.

The torque of an effect along the measured motion, passed through the observer's error dynamics, is what the effect would leave in
the innovations. What the calibrated parameters can imitate is projected out first: the baseline of every claim is the refitted model.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.physics.effects import Effect, get_effect, library
from zendsp.physics.fit import Data, Fit, Handle
from zendsp.physics.joint import JointRecord, effective_inertia, response, trace
from zendsp.physics.model import Model, Quantity, Term

Array = npt.NDArray[np.float64]

FRICTION = (
    "coulomb",
    "viscous",
    "coulomb_asymmetry",
    "viscous_asymmetry",
    "stribeck",
    "quadratic_drag",
    "load_friction",
)
HARMONICS = 60
TOGETHER = 8  # grid points whose columns are computed at once
ADDED = ("torque", "viscous", "dry")  # where an effect acts whose torque is the same beside others


@dataclass(frozen=True)
class Candidate:
    """A hypothesis with start values: terms to add at one joint, and what they replace."""

    effect: str
    joint: int
    terms: tuple[Term, ...]
    replaces: tuple[str, ...]
    gain: float  # decrease of the cost that the screen promises; nan where only a fit can tell
    beneath: Model | None = None  # numbers to begin from in place of the calibrated ones

    @property
    def key(self) -> tuple[str, int]:
        """Effect and joint."""
        return self.effect, self.joint


def make_term(effect: Effect, joint: int, values: dict[str, float]) -> Term:
    """A term with every fitted parameter free; missing ones at their defaults."""
    out = {}
    for p in effect.parameters:
        value = values.get(p.name, p.default if p.default is not None else 0.0)
        out[p.name] = Quantity(float(value), p.fitted)
    return Term(effect.name, joint, out)


def _phase_of(effect: Effect) -> str:
    """Name of the parameter that is a phase of a sine with a linear amplitude, empty where there is none."""
    return next((n for n in effect.names if n in ("phase", "angle")), "") if effect.linear else ""


def _unit_values(effect: Effect, values: dict[str, float], linear: str) -> dict[str, float]:
    return {**values, **{name: (1.0 if name == linear else 0.0) for name in effect.linear}}


def grid_of(effect: Effect, record: JointRecord, model: Model) -> list[dict[str, float]]:
    """Nonlinear parameter values to screen for one effect, phases left out (they are screened as sine and cosine)."""
    s = record.scale
    linear_axis = model.joint_kind(record.joint) == "linear"
    q = record.motion.states[0]
    centre, span = 0.5 * (q.max() + q.min()), s.position
    speed_top = float(np.quantile(np.abs(record.motion.states[1]), 0.95))
    axes: dict[str, list[float]] = {}
    for name, units in effect.grid.items():
        if name in ("phase", "angle"):
            continue
        if name == "order":
            if linear_axis:
                axes[name] = (2 * np.pi / span * np.arange(1.0, 160.0, 0.5)).tolist()
            else:
                axes[name] = [float(i) for i in range(2, HARMONICS + 1)]  # once per turn is gravity
        elif name == "period":
            whole = (
                [] if linear_axis else [2 * np.pi / m for m in range(1, 25) if 2 * np.pi / m > 0.03 * span]
            )
            axes[name] = whole or [u * span for u in units]
        elif name == "neutral":
            axes[name] = [centre + u * span for u in units]
        elif name == "velocity":
            axes[name] = [u * speed_top for u in (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)]
        elif name in ("width", "level") and effect.site == "actuator":
            top = float(np.quantile(np.abs(record.command), 0.999))
            axes[name] = (
                [u * s.command for u in units]
                if name == "width"
                else [u * top for u in (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)]
            )
        else:
            axes[name] = [u * s.of(effect.parameter(name).size) for u in units]
    return [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]


class Screen:
    """One joint's screen around a calibrated fit."""

    def __init__(self, data: Data, fit: Fit, joint: int, joints_fitted: tuple[int, ...]) -> None:
        self.data, self.model, self.joint = data, fit.model, joint
        self.records = [rec[joint - 1] for rec in data.records]
        self.bandwidth = data.bandwidth[joint - 1]
        rows = self._rows(data, joint, joints_fitted)
        self.r = fit.residual[: sum(r.n * len(joints_fitted) for r in self.records)][rows]
        jac = fit.jacobian[: len(fit.residual)][: sum(r.n * len(joints_fitted) for r in self.records)][rows]
        # the sensor's zero is held within a count by its prior: it must not absorb what only a larger shift could
        jac = jac[:, [h.place != "offset" for h in fit.handles]]
        norms = np.linalg.norm(jac, axis=0)
        jac = jac[:, norms > 0] / norms[norms > 0]
        self.q = np.linalg.qr(jac)[0] if jac.shape[1] else np.zeros((len(self.r), 0))
        self.left = self.r - self.q @ (self.q.T @ self.r)
        self.base = [trace(rec, self.model, self.model.at(joint), self._floor(rec)) for rec in self.records]
        self.cost = float(self.left @ self.left)
        self.scaled = any(get_effect(t.effect).site == "scale" for t in self.model.at(joint))

    @staticmethod
    def _rows(data: Data, joint: int, joints: tuple[int, ...]) -> npt.NDArray[np.bool_]:
        parts = [np.full(rec[j - 1].n, j == joint) for rec in data.records for j in joints]
        return np.concatenate(parts)

    @staticmethod
    def _floor(record: JointRecord) -> float:
        return max(3.0 * float(np.sqrt(np.median(record.motion.variances[1]))), 0.01 * record.scale.speed)

    def series(self, columns: Sequence[tuple[Term, ...]], *, alone: bool = False) -> Array:
        """Weighted responses to the torques of some added terms, a row a column, (columns, n of all recordings).

        ``alone``: as if the model had no other terms, for one that would replace some of them.
        """
        on_sensor = columns[0][0].effect == "encoder_eccentricity"
        parts = []
        for rec, base in zip(self.records, self.base, strict=True):
            torques = np.stack([self._torque(rec, base, terms, alone) for terms in columns])
            parts.append(self._respond(rec, torques, on_sensor=on_sensor))
        return np.concatenate(parts, axis=1)

    def _torque(self, rec: JointRecord, base: Array, terms: tuple[Term, ...], alone: bool) -> Array:
        """What some added terms resist along the measured motion, (n,); of what acts on the sensor, what it shifts."""
        first = terms[0]
        if first.effect == "inertia":
            return np.asarray(rec.motion.states[2] * first.value("amount"))
        if first.effect in ("delay", "lag"):
            late = first.value("time") or first.value("time_constant")
            return np.diff(rec.command, prepend=rec.command[0]) * (late / rec.sample_time) * self._gain(rec)
        if first.effect == "encoder_eccentricity":
            return np.asarray(-first.value("amplitude") * np.sin(rec.motion.states[0] + first.value("phase")))
        if alone or (not self.scaled and get_effect(first.effect).site in ADDED):
            return trace(rec, self.model, terms, self._floor(rec))
        return np.asarray(trace(rec, self.model, (*self.model.at(self.joint), *terms), self._floor(rec)) - base)

    def _gain(self, rec: JointRecord) -> float:
        gain = self.model.actuator.gain
        return gain[self.joint - 1] if self.joint - 1 < len(gain) else gain[0]

    def _respond(self, rec: JointRecord, columns: Array, *, on_sensor: bool = False) -> Array:
        inertia = effective_inertia(rec, self.model)
        b = sum(t.value("coefficient") for t in self.model.at(self.joint) if t.effect == "viscous")
        return response(rec, self.bandwidth, inertia, np.full(rec.n, b), columns, on_sensor=on_sensor)

    def group(self, columns: Array) -> tuple[float, Array]:
        """Decrease of the cost by some columns, a row each, and their coefficients."""
        b = columns - (columns @ self.q) @ self.q.T
        norm = np.linalg.norm(b, axis=1)
        norm[norm == 0] = 1.0
        b /= norm[:, None]
        gram, moment = b @ b.T, b @ self.left
        theta = -np.linalg.lstsq(gram, moment, rcond=1e-9)[0]
        return float(-2 * theta @ moment - theta @ gram @ theta), theta / norm

    def candidates(self, only: frozenset[str] = frozenset(), jobs: int = 1) -> list[Candidate]:
        """Each effect of the library (or only the named ones) at its best grid point, best first."""
        effects: list[Effect] = []
        present = {t.effect for t in self.model.at(self.joint)}
        for effect in library().values():
            if effect.starts and effect.name not in ("lag", "delay"):
                continue
            if effect.site == "body":  # all joints decide: see bodies.py
                continue
            if only and effect.name not in only:
                continue
            if effect.name in present and not effect.repeatable:
                continue
            if effect.needs == ("friction",) and not present & set(FRICTION):
                continue
            effects.append(effect)
        with ThreadPoolExecutor(jobs) as pool:
            found = pool.map(lambda e: self._best_coupling(e) if e.name == "coupling" else self._best(e), effects)
            return sorted(itertools.chain.from_iterable(found), key=lambda c: -c.gain)

    def _best(self, effect: Effect) -> list[Candidate]:
        points = grid_of(effect, self.records[0], self.model)
        needs = set(effect.needs) - {"friction"} - {t.effect for t in self.model.at(self.joint)}
        if not points or needs:
            return []
        return [self._candidate(effect, *max(self._at(effect, points), key=lambda found: found[0]))]

    def _at(self, effect: Effect, points: Sequence[dict[str, float]]) -> Iterator[tuple[float, dict[str, float]]]:
        """At each grid point, the decrease of the cost and all values."""
        wanted = [[(make_term(effect, self.joint, values),) for values in self._directions(effect, point)] for point in points]
        if effect.name == "stiffness":  # its neutral point is a constant torque
            wanted = [[*columns, (make_term(get_effect("torque_offset"), self.joint, {"level": 1.0}),)] for columns in wanted]
        each = len(wanted[0])
        for begin in range(0, len(points), TOGETHER):
            some = slice(begin, begin + TOGETHER)
            rows = self.series(list(itertools.chain.from_iterable(wanted[some])), alone=bool(effect.replaces))
            for k, point in enumerate(points[some]):
                yield self._judge(effect, point, rows[k * each : (k + 1) * each])

    def _directions(self, effect: Effect, point: dict[str, float]) -> list[dict[str, float]]:
        """The values whose torques, together, are all that the effect can be at a grid point."""
        if effect.name in ("delay", "lag"):
            return [{effect.parameters[0].name: self.records[0].sample_time}]
        if effect.name == "stiffness":
            return [{"coefficient": 1.0}]
        phase = _phase_of(effect)
        if phase:
            second = -np.pi / 2 if phase == "angle" else np.pi / 2
            return [{**point, effect.linear[0]: 1.0, phase: angle} for angle in (0.0, second)]
        return [_unit_values(effect, point, name) for name in effect.linear] or [point]

    def _judge(self, effect: Effect, point: dict[str, float], columns: Array) -> tuple[float, dict[str, float]]:
        gain, theta = self.group(columns)
        if effect.name in ("delay", "lag"):
            unit = self.records[0].sample_time
            return gain, {effect.parameters[0].name: float(np.clip(theta[0] * unit, 0.2 * unit, 0.05))}
        if effect.name == "stiffness":
            k = float(theta[0]) if theta[0] > 0 else 1e-3 * self.records[0].scale.of("torque/position")
            better = gain > self.group(columns[1:])[0]
            return gain, {"coefficient": k, "neutral": float(-theta[1] / k)} if better else {"coefficient": k}
        phase = _phase_of(effect)
        if phase:
            angle = float(np.arctan2(theta[1], theta[0])) * (-1 if phase == "angle" else 1)
            return gain, {**point, effect.linear[0]: float(np.hypot(*theta)), phase: angle}
        if not effect.linear:
            return (gain if theta[0] > 0 else 0.0), point
        values = {**point, **{name: float(v) for name, v in zip(effect.linear, theta, strict=True)}}
        if effect.replaces:
            return gain, self._add_replaced(effect, values)
        if all(values[n] >= effect.parameter(n).lower for n in effect.linear):
            return gain, values
        least = {n: 1e-3 * self.records[0].scale.of(effect.parameter(n).size) for n in effect.linear}
        return 0.0, {n: max(v, least.get(n, v)) for n, v in values.items()}

    def _add_replaced(self, effect: Effect, values: dict[str, float]) -> dict[str, float]:
        size = self.records[0].scale
        for term in self.model.at(self.joint):
            if term.effect in effect.replaces:
                base = next(iter(term.parameters.values())).value
                values = {n: v + base for n, v in values.items()}
        return {n: max(v, 1e-3 * size.of(effect.parameter(n).size)) for n, v in values.items()}

    def _candidate(self, effect: Effect, gain: float, values: dict[str, float]) -> Candidate:
        replaces = tuple(t.effect for t in self.model.at(self.joint) if t.effect in effect.replaces)
        return Candidate(effect.name, self.joint, (make_term(effect, self.joint, values),), replaces, gain)

    def _best_coupling(self, effect: Effect) -> list[Candidate]:
        found: list[Candidate] = []
        for other in range(1, self.data.joints + 1):
            if other == self.joint:
                continue
            for law in range(4):
                smooth = 0.05 * self.records[0].scale.speed
                point = {"from_joint": float(other), "law": float(law), "smooth": smooth}
                found += [self._candidate(effect, *at) for at in self._at(effect, [point])]
        return found


def with_candidate(model: Model, candidate: Candidate) -> Model:
    """The model with the candidate's terms added and what they replace removed."""
    model = candidate.beneath or model
    kept = tuple(
        t for t in model.terms if not (t.joint == candidate.joint and t.effect in candidate.replaces)
    )
    return replace(model, terms=(*kept, *candidate.terms))


def touched(handles: tuple[Handle, ...], model: Model, joint: int) -> tuple[int, ...]:
    """Joints whose innovations depend on parameters shared with this joint (1-based)."""
    shared = any(h.place == "mechanism" for h in handles) and model.joints > 1
    return tuple(range(1, model.joints + 1)) if shared else (joint,)
