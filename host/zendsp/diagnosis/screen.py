"""Every effect of the library, tried to first order for the price of one least squares.

The torque of an effect along the measured motion, passed through the observer's error dynamics, is what the effect would leave in
the innovations. What the calibrated parameters can imitate is projected out first: the baseline of every claim is the refitted model.
"""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.physics.effects import Effect, library
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


@dataclass(frozen=True)
class Candidate:
    """A hypothesis with start values: terms to add at one joint, and what they replace."""

    effect: str
    joint: int
    terms: tuple[Term, ...]
    replaces: tuple[str, ...]
    gain: float  # decrease of the cost that the screen promises; nan where only a fit can tell

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


def _unit_values(effect: Effect, values: dict[str, float], linear: str) -> dict[str, float]:
    return {**values, **{name: (1.0 if name == linear else 0.0) for name in effect.linear}}


@dataclass(frozen=True)
class _Column:
    values: dict[str, float]
    linear: str
    series: Array  # (n of all recordings,)
    sensor: bool = False


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

    @staticmethod
    def _rows(data: Data, joint: int, joints: tuple[int, ...]) -> npt.NDArray[np.bool_]:
        parts = [np.full(rec[j - 1].n, j == joint) for rec in data.records for j in joints]
        return np.concatenate(parts)

    @staticmethod
    def _floor(record: JointRecord) -> float:
        return max(3.0 * float(np.sqrt(np.median(record.motion.variances[1]))), 0.01 * record.scale.speed)

    def series(self, terms: tuple[Term, ...]) -> Array:
        """Weighted response to the torque of some added terms, (n of all recordings,)."""
        parts = []
        for rec, base in zip(self.records, self.base, strict=True):
            if any(t.effect == "inertia" for t in terms):
                column = rec.motion.states[2] * terms[0].value("amount")
            elif any(t.effect in ("delay", "lag") for t in terms):
                t = terms[0]
                late = t.value("time") or t.value("time_constant")
                column = (
                    np.diff(rec.command, prepend=rec.command[0]) * (late / rec.sample_time) * self._gain(rec)
                )
            elif any(t.effect == "encoder_eccentricity" for t in terms):
                t = terms[0]
                column = -t.value("amplitude") * np.sin(rec.motion.states[0] + t.value("phase"))
                parts.append(self._respond(rec, column, on_sensor=True))
                continue
            else:
                column = trace(rec, self.model, (*self.model.at(self.joint), *terms), self._floor(rec)) - base
            parts.append(self._respond(rec, column))
        return np.concatenate(parts)

    def _gain(self, rec: JointRecord) -> float:
        gain = self.model.actuator.gain
        return gain[self.joint - 1] if self.joint - 1 < len(gain) else gain[0]

    def _respond(self, rec: JointRecord, column: Array, *, on_sensor: bool = False) -> Array:
        inertia = effective_inertia(rec, self.model)
        b = sum(t.value("coefficient") for t in self.model.at(self.joint) if t.effect == "viscous")
        found: Array = response(rec, self.bandwidth, inertia, np.full(rec.n, b), column, on_sensor=on_sensor)[
            0
        ]
        return found

    def group(self, columns: list[Array]) -> tuple[float, Array]:
        """Decrease of the cost by some columns, and their coefficients."""
        b = np.stack(columns)
        b = b - (b @ self.q) @ self.q.T
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
        best: tuple[float, dict[str, float]] | None = None
        keep: list[tuple[float, dict[str, float]]] = []
        for point in grid_of(effect, self.records[0], self.model):
            gain, values = self._at(effect, point)
            keep.append((gain, values))
            if best is None or gain > best[0]:
                best = (gain, values)
        if best is None:
            return []
        needs = tuple(
            n
            for n in effect.needs
            if n != "friction" and n not in {t.effect for t in self.model.at(self.joint)}
        )
        if needs:
            return []
        return [self._candidate(effect, *best)]

    def _at(self, effect: Effect, point: dict[str, float]) -> tuple[float, dict[str, float]]:
        if effect.name in ("delay", "lag"):
            name = effect.parameters[0].name
            unit = self.records[0].sample_time
            gain, theta = self.group([self.series((make_term(effect, self.joint, {name: unit}),))])
            return gain, {name: float(np.clip(theta[0] * unit, 0.2 * unit, 0.05))}
        amplitude = effect.linear[0] if effect.linear else ""
        phase = next((n for n in effect.names if n in ("phase", "angle")), "")
        if phase and amplitude:
            second = -np.pi / 2 if phase == "angle" else np.pi / 2
            columns = [
                self.series((make_term(effect, self.joint, {**point, amplitude: 1.0, phase: a}),))
                for a in (0.0, second)
            ]
            gain, (a, b) = self.group(columns)
            size = float(np.hypot(a, b))
            angle = float(np.arctan2(b, a)) * (-1 if phase == "angle" else 1)
            return gain, {**point, amplitude: size, phase: angle}
        if effect.name == "stiffness":
            one = [np.concatenate([self._respond(rec, np.ones(rec.n)) for rec in self.records])]
            gain, (k, c) = self.group(
                [self.series((make_term(effect, self.joint, {"coefficient": 1.0}),)), *one]
            )
            only, _ = self.group(one)
            k = k if k > 0 else 1e-3 * self.records[0].scale.of("torque/position")
            return (
                (gain, {"coefficient": float(k), "neutral": float(-c / k)})
                if gain > only
                else (gain, {"coefficient": float(k)})
            )
        if not effect.linear:
            gain, theta = self.group([self.series((make_term(effect, self.joint, point),))])
            return (gain if theta[0] > 0 else 0.0), point
        columns = [
            self.series((make_term(effect, self.joint, _unit_values(effect, point, name)),))
            for name in effect.linear
        ]
        if effect.replaces:
            columns = [
                self.series_without(effect, _unit_values(effect, point, name)) for name in effect.linear
            ]
        gain, theta = self.group(columns)
        values = {**point, **{name: float(v) for name, v in zip(effect.linear, theta, strict=True)}}
        if effect.replaces:
            values = self._add_replaced(effect, values)
        elif any(values[n] < effect.parameter(n).lower for n in effect.linear):
            gain, values = (
                0.0,
                {
                    n: max(v, 1e-3 * self.records[0].scale.of(effect.parameter(n).size))
                    if n in effect.linear
                    else v
                    for n, v in values.items()
                },
            )
        return gain, values

    def series_without(self, effect: Effect, values: dict[str, float]) -> Array:
        """As ``series``, for a term that would replace one of the model's: evaluated beside it."""
        parts = []
        for rec in self.records:
            column = trace(rec, self.model, (make_term(effect, self.joint, values),), self._floor(rec))
            parts.append(self._respond(rec, column))
        return np.concatenate(parts)

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
                gain, values = self._at(effect, point)
                found.append(self._candidate(effect, gain, values))
        return found


def with_candidate(model: Model, candidate: Candidate) -> Model:
    """The model with the candidate's terms added and what they replace removed."""
    kept = tuple(
        t for t in model.terms if not (t.joint == candidate.joint and t.effect in candidate.replaces)
    )
    return replace(model, terms=(*kept, *candidate.terms))


def touched(handles: tuple[Handle, ...], model: Model, joint: int) -> tuple[int, ...]:
    """Joints whose innovations depend on parameters shared with this joint (1-based)."""
    shared = any(h.place == "mechanism" for h in handles) and model.joints > 1
    return tuple(range(1, model.joints + 1)) if shared else (joint,)
