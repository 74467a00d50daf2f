"""Output error of simulators that can only be called: fit, evidence, and the library of effects
screened by finite differences.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.external.simulator import Bench, on_input, on_timing
from zendsp.physics.calibration.bounds import parameter_bounds
from zendsp.physics.calibration.fit import Fit, robust_covariance
from zendsp.physics.calibration.handles import Handle, get_values, set_values
from zendsp.physics.calibration.terms import grid_of, make_term, usable
from zendsp.physics.effects import Effect, get_effect, is_supported, library
from zendsp.physics.model import Model, Term

Array = npt.NDArray[np.float64]
Progress = Callable[[str], None]

BLOCK = 0.25  # s
FEWEST = 4  # blocks: of fewer no scatter is known
SCREENED = 400  # simulations that one screen may take


@dataclass(frozen=True)
class Output:
    """A fitted model with its output errors (N,) over all recordings and joints, in units of the
    sensor's noise.
    """

    fit: Fit
    error: Array

    @property
    def model(self) -> Model:
        """The fitted model."""
        return self.fit.model


def errors(benches: Sequence[Bench], model: Model) -> Array:
    """Measured minus simulated position over its noise, (N,)."""
    parts = []
    for b in benches:
        e = b.error(model)
        parts += [e[:, i] / sensor_noise(b, i) for i in range(e.shape[1])]
    return np.concatenate(parts)


def sensor_noise(b: Bench, i: int) -> float:
    m = b.records[i].measurement
    white = math.hypot(m.noise, m.resolution / math.sqrt(12))
    return max(white, 1e-7 * b.records[i].scale.position)


def _bounds(
    benches: Sequence[Bench], model: Model, handles: Sequence[Handle]
) -> tuple[Array, Array, Array]:
    low, high, size = [], [], []
    for h in handles:
        value = abs(float(get_values(model, [h])[0]))
        if h.place == "term":
            term = model.terms[h.index]
            record = benches[0].records[term.joint - 1]
            a, b = parameter_bounds(term.effect, h.key, record)
            unit = record.scale.of(get_effect(term.effect).parameter(h.key).size)
            low.append(a)
            high.append(b)
            size.append(max(value, 0.02 * unit))
        else:  # a simulator's own parameters keep their sign
            signed = float(get_values(model, [h])[0])
            low.append(1e-3 * signed if signed > 0 else 1e3 * signed)
            high.append(1e3 * signed if signed > 0 else 1e-3 * signed)
            size.append(value)
    return np.array(low), np.array(high), np.array(size)


def fit_output(
    benches: Sequence[Bench], model: Model, handles: Sequence[Handle], evaluations: int = 12
) -> Output:
    """Least squares on the simulated position, all free numbers together."""
    from scipy.optimize import least_squares

    handles = tuple(handles)
    if not handles:
        error = errors(benches, model)
        return Output(
            Fit(
                model,
                (),
                np.zeros(0),
                np.zeros((0, 0)),
                float(error @ error),
                (),
                np.zeros((len(error), 0)),
                error,
            ),
            error,
        )
    low, high, size = _bounds(benches, model, handles)
    start = np.clip(get_values(model, handles), low + 1e-9 * size, high - 1e-9 * size)

    def evaluate(z: Array) -> Array:
        return errors(benches, set_values(model, handles, z * size))

    done = least_squares(
        evaluate,
        start / size,
        bounds=(low / size, high / size),
        diff_step=np.full(len(size), 1e-4),
        max_nfev=evaluations,
        ftol=1e-5,
        xtol=1e-6,
    )
    x = done.x * size
    jacobian = np.asarray(done.jac, dtype=np.float64) / size
    block = max(10, round(BLOCK / benches[0].signals.sample_time))
    covariance = robust_covariance(jacobian, done.fun, block)
    bound = tuple(bool(v) for v in (np.isclose(x, low) | np.isclose(x, high)))
    result = Fit(
        set_values(model, handles, x),
        handles,
        x,
        covariance,
        float(done.fun @ done.fun),
        bound,
        jacobian,
        done.fun,
    )
    return Output(result, done.fun)


def effective(error: Array) -> float:
    """Number of independent samples in a correlated series: n (1 - rho) / (1 + rho) with the
    lag-one correlation of an AR(1).
    """
    e = error - error.mean()
    power = float(e @ e)
    rho = float(e[1:] @ e[:-1]) / power if power > 0 else 0.0
    return max(10.0, len(e) * (1 - rho) / (1 + rho))


def gain(before: Array, after: Array, parameters: int) -> float:
    """Log-likelihood ratio of two output errors with the effective number of samples, less the
    price of the parameters.
    """
    n = max(effective(after), len(after) / 100.0)
    return 0.5 * n * math.log(
        max(float(before @ before), 1e-300) / max(float(after @ after), 1e-300)
    ) - 0.5 * parameters * math.log(n)


def held_z(before: Array, after: Array, block: int) -> float:
    """Paired z over blocks of the held-out recording: logarithm of the error's power before over
    after.
    """
    count = len(before) // block
    if count < FEWEST:
        return 0.0
    power = [
        np.mean(e[: count * block].reshape(count, block) ** 2, axis=1) + 1.0
        for e in (before, after)
    ]
    ratio = np.log(power[0] / power[1])
    spread = float(np.std(ratio, ddof=1)) / math.sqrt(count)
    return float(ratio.mean()) / max(spread, 1e-12)


def screen(
    benches: Sequence[Bench], current: Output, joint: int, tell: Progress
) -> list[tuple[float, Term]]:
    """Each effect at its best grid point by finite differences: share of the squared error that it
    promises to remove, best first.
    """
    left, basis = _projected(current)
    cost = float(left @ left)
    record = benches[0].records[joint - 1]
    found, calls = [], 0
    present = {t.effect for t in current.model.at(joint)}
    every, told = list(library().values()), 0
    for done, effect in enumerate(every):
        if (tenth := 10 * done // len(every)) > told:
            told = tenth
            bar = "█" * tenth + "░" * (10 - tenth)
            tell(f"joint {joint}: screening the library {bar} {calls} simulations")
        if (
            not on_input(effect)
            or effect.retime is not None
            or (effect.name in present and not effect.repeatable)
        ):
            continue
        if not is_supported(effect, present) or not usable(
            effect, [b.records[joint - 1] for b in benches]
        ):
            continue
        best: tuple[float, Term] | None = None
        points = _points(effect, record, current.model)
        for values, linear in points[:: max(1, len(points) // 40)]:
            if calls >= SCREENED:
                break
            columns = []
            for name_values in linear:
                step = _step(effect, record, name_values)
                trial = make_term(effect, joint, {**values, **step})
                columns.append(errors(benches, with_term(current.model, trial)) - current.error)
                calls += 1
            b = np.stack(columns)
            b = b - (b @ basis) @ basis.T
            gram, moment = b @ b.T, b @ left
            theta: Array = np.asarray(
                -np.linalg.lstsq(gram, moment, rcond=1e-9)[0], dtype=np.float64
            )
            promise = float(-2 * theta @ moment - theta @ gram @ theta) / cost
            start = _start(effect, record, values, linear, theta)
            if start is not None and (best is None or promise > best[0]):
                best = (promise, make_term(effect, joint, start))
        if best is not None:
            found.append(best)
    tell(f"joint {joint}: {calls} simulations screened the library")
    return sorted(found, key=lambda item: -item[0])


def _projected(current: Output) -> tuple[Array, Array]:
    jac = current.fit.jacobian
    norms = np.linalg.norm(jac, axis=0)
    jac = jac[:, norms > 0] / norms[norms > 0]
    basis = np.linalg.qr(jac)[0] if jac.shape[1] else np.zeros((len(current.error), 0))
    return current.error - basis @ (basis.T @ current.error), basis


def with_term(model: Model, term: Term) -> Model:
    gone = get_effect(term.effect).replaces
    kept = tuple(t for t in model.terms if not (t.joint == term.joint and t.effect in gone))
    return model.with_terms((*kept, term))


def _points(
    effect: Effect, record: Any, model: Model
) -> list[tuple[dict[str, float], list[dict[str, float]]]]:
    """Grid points with, for each, the directions to try: one per linear parameter, two for a phase.
    """
    out: list[tuple[dict[str, float], list[dict[str, float]]]] = []
    phase = next((p for p in effect.names if p in ("phase", "angle")), "")
    for point in grid_of(effect, record, model):
        if not effect.linear:
            out.append((point, [{}]))
        elif phase:
            quarter = -math.pi / 2 if phase == "angle" else math.pi / 2
            out.append(
                (
                    point,
                    [{effect.linear[0]: 1.0, phase: 0.0}, {effect.linear[0]: 1.0, phase: quarter}],
                )
            )
        else:
            out.append(
                (
                    point,
                    [
                        {name: 1.0 if name == one else 0.0 for name in effect.linear}
                        for one in effect.linear
                    ],
                )
            )
    return out


def _step(effect: Effect, record: Any, direction: dict[str, float]) -> dict[str, float]:
    """A small step along a direction: one percent of the effect's natural size."""
    return {
        name: (
            value
            if name in ("phase", "angle")
            else 0.01 * value * record.scale.of(effect.parameter(name).size)
        )
        for name, value in direction.items()
    }


def _start(
    effect: Effect,
    record: Any,
    values: dict[str, float],
    linear: list[dict[str, float]],
    theta: Array,
) -> dict[str, float] | None:
    if not effect.linear:
        return values if theta[0] > 0 else None
    phase = next((p for p in effect.names if p in ("phase", "angle")), "")
    unit = 0.01 * record.scale.of(effect.parameter(effect.linear[0]).size)
    if phase:
        angle = math.atan2(float(theta[1]), float(theta[0])) * (-1 if phase == "angle" else 1)
        return {
            **values,
            effect.linear[0]: unit * math.hypot(float(theta[0]), float(theta[1])),
            phase: angle,
        }
    out = dict(values)
    for name, value in zip(effect.linear, theta, strict=True):
        size = 0.01 * record.scale.of(effect.parameter(name).size)
        out[name] = float(value) * size
        if out[name] < effect.parameter(name).lower:
            if len(effect.linear) == 1:
                return None
            out[name] = size
    return out


def late_candidates(
    benches: Sequence[Bench], current: Output, joint: int
) -> list[tuple[float, Term]]:
    """What acts on the command's timing."""
    out = []
    for effect in on_timing():
        if effect.name not in {t.effect for t in current.model.at(joint)}:
            step = 2 * benches[0].signals.sample_time
            term = make_term(effect, joint, dict.fromkeys(effect.linear, step))
            trial = errors(benches, with_term(current.model, term))
            out.append((1 - float(trial @ trial) / current.fit.cost, term))
    return [item for item in out if item[0] > 0]
