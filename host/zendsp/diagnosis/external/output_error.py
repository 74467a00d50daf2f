"""Output error of black-box simulators: fit, evidence, and a screen of the library by finite
differences.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.external.simulator import Bench, on_input, on_timing
from zendsp.diagnosis.progress import Progress, Step
from zendsp.physics.calibration.bounds import parameter_bounds
from zendsp.physics.calibration.covariance import robust_covariance
from zendsp.physics.calibration.fit import NEAR, TOO_FAR, Fit
from zendsp.physics.calibration.handles import Handle, get_values, set_values
from zendsp.physics.calibration.terms import grid_of, make_term, usable
from zendsp.physics.effects import Effect, get_effect, is_supported, library
from zendsp.physics.model import Model, Term

Array = npt.NDArray[np.float64]
Guess = Callable[[Model], Array]  # errors of a model near another

BLOCK = 0.25  # s
DIFFERENCE = 1e-4  # of a number's size: the step of a finite difference
LONGEST = 10  # times two samples: longest start value of a delay in a screen
# of a number: error from windows that start at the smoothed instead of the true state. Inertia,
# gravity and friction of a simulated pendulum were up to 0.5 % off, whatever the noise
BEGINS = 0.005
BLURRED = 2.0  # times the speed below which the direction is not known: an alternative for it
GUESSED_FIRST = 25  # guesses before the first simulation of a fit
FEWEST = 4  # least blocks for a scatter
SCREENED = 400  # most trials of a screen


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
    """Standard deviation of a measured position, rad or m: noise and resolution; ``i`` is the
    joint, from 0.
    """
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
            signed = float(get_values(benches[0].given, [h])[0])
            ends = signed / TOO_FAR, signed * TOO_FAR
            low.append(min(ends))
            high.append(max(ends))
            size.append(value)
    return np.array(low), np.array(high), np.array(size)


def _unmoved(benches: Sequence[Bench], model: Model) -> Output:
    """The output of a model without a fit."""
    error = errors(benches, model)
    none = np.zeros((len(error), 0))
    cost = float(error @ error)
    fit = Fit(model, (), np.zeros(0), np.zeros((0, 0)), cost, (), none, error)
    return Output(fit, error)


@dataclass(frozen=True)
class Line:
    """A prediction near a model without simulation: the errors, and the slopes of those free
    numbers (by their place among the handles) that need no simulation.
    """

    errors: Guess
    slopes: Mapping[int, Array]


class _Problem:
    """Least squares over the free numbers of a model, each in units of its size; joints are
    weighted by their scatter in ``before``.
    """

    def __init__(
        self, benches: Sequence[Bench], model: Model, handles: Sequence[Handle], before: Array
    ) -> None:
        self.model, self.handles = model, tuple(handles)
        self.low, self.high, self.size = _bounds(benches, model, handles)
        self.weight = weights(benches, before)
        start = get_values(model, handles)
        self.start = np.clip(start, self.low + 1e-9 * self.size, self.high - 1e-9 * self.size)

    def at(self, z: Array) -> Model:
        """The model with its free numbers at z sizes."""
        return set_values(self.model, self.handles, z * self.size)

    def solve(self, ask: Guess, most: int, line: Line | None) -> Any:
        """The least-squares minimum, with the slopes of a line where there is one."""
        from scipy.optimize import least_squares

        def slopes(z: Array) -> Array:
            assert line is not None
            here, out = line.errors(self.at(z)), []
            for i, unit in enumerate(self.size):
                if i in line.slopes:
                    out.append(unit * line.slopes[i])
                else:
                    moved = z + DIFFERENCE * np.eye(len(z))[i]
                    out.append((line.errors(self.at(moved)) - here) / DIFFERENCE)
            return np.asarray(self.weight[:, None] * np.stack(out, axis=1), dtype=np.float64)

        def evaluate(z: Array) -> Array:
            return self.weight * ask(self.at(z))

        return least_squares(
            evaluate,
            self.start / self.size,
            jac="2-point" if line is None else slopes,
            bounds=(self.low / self.size, self.high / self.size),
            diff_step=np.full(len(self.size), DIFFERENCE),
            max_nfev=most,
            ftol=1e-5,
            xtol=1e-6,
        )


def guess_output(
    benches: Sequence[Bench], model: Model, handles: Sequence[Handle], before: Array, line: Line
) -> tuple[Model, Array]:
    """The best model by a line, and its errors by that line, without simulation."""
    if not handles:
        return model, line.errors(model)
    problem = _Problem(benches, model, handles, before)
    done = problem.solve(line.errors, GUESSED_FIRST, line)
    return problem.at(done.x), np.asarray(done.fun / problem.weight, dtype=np.float64)


def fit_output(
    benches: Sequence[Bench],
    model: Model,
    handles: Sequence[Handle],
    before: Array,
    evaluations: int,
    line: Line | None = None,
) -> Output:
    """The least-squares fit to the position, all free numbers together, starting from those of the
    model. Joints are weighted by their scatter in ``before``. The slopes are those of a line where
    there is one.
    """
    handles = tuple(handles)
    if not handles:
        return _unmoved(benches, model)
    problem = _Problem(benches, model, handles, before)
    done = problem.solve(partial(errors, benches), evaluations, line)
    size, weight, x = problem.size, problem.weight, done.x * problem.size
    jacobian = np.asarray(done.jac, dtype=np.float64) / size
    fitted = set_values(model, handles, x)
    block = max(10, round(BLOCK / benches[0].signals.sample_time))
    moved = _turning(benches, fitted, weight, done.fun, jacobian * size) * size
    covariance = robust_covariance(jacobian, done.fun, block)
    covariance += np.diag((BEGINS * x) ** 2 + moved**2)
    ends = np.isclose(x, problem.low, rtol=NEAR) | np.isclose(x, problem.high, rtol=NEAR)
    bound = tuple(bool(v) for v in ends)
    result = Fit(
        fitted, handles, x, covariance, float(done.fun @ done.fun), bound,
        jacobian / weight[:, None], done.fun / weight,
    )
    return Output(result, done.fun / weight)


def _turning(
    benches: Sequence[Bench], model: Model, weight: Array, error: Array, jacobian: Array
) -> Array:
    """The change of fitted numbers with another assumption on friction at reversals, where the
    speed is known only smoothed. ``error`` and ``jacobian`` are weighted.
    """
    if not model.terms:
        return np.zeros(jacobian.shape[1])
    other = weight * errors([replace(b, blur=BLURRED) for b in benches], model)
    return np.asarray(np.linalg.lstsq(jacobian, other - error, rcond=1e-9)[0], dtype=np.float64)


def weights(benches: Sequence[Bench], error: Array) -> Array:
    """One over the scatter of each joint, (N,), at the places of ``errors``."""
    out = np.ones(len(error))
    for part in by_joint(benches):
        out[part] = 1.0 / max(float(np.sqrt(np.mean(error[part] ** 2))), 1e-12)
    return out


def effective(error: Array) -> float:
    """The number of independent samples in a correlated series: n (1 - rho) / (1 + rho) with the
    lag-one correlation of an AR(1).
    """
    e = error - error.mean()
    power = float(e @ e)
    rho = float(e[1:] @ e[:-1]) / power if power > 0 else 0.0
    return max(10.0, len(e) * (1 - rho) / (1 + rho))


def gain(
    benches: Sequence[Bench], before: Array, after: Array, parameters: int, best: Array
) -> float:
    """The log-likelihood ratio of two output errors, less the price of the parameters.

    Each joint has its own scatter, so that a badly simulated one does not hide another. The
    effective number of samples is that of the ``best`` rival's error, for all rivals.
    """
    total, samples = 0.0, 0.0
    for part in by_joint(benches):
        n = max(effective(best[part]), len(part) / 100.0)
        power = [max(float(e[part] @ e[part]), 1e-300) for e in (before, after)]
        total += 0.5 * n * math.log(power[0] / power[1])
        samples += n
    return total - 0.5 * parameters * math.log(samples)


def by_joint(benches: Sequence[Bench]) -> list[npt.NDArray[np.int64]]:
    """The indices of each joint in the result of ``errors``."""
    joint = np.concatenate([np.repeat(np.arange(len(b.records)), b.n) for b in benches])
    return [np.flatnonzero(joint == j) for j in range(len(benches[0].records))]


def held_z(before: Array, after: Array, block: int) -> float:
    """The paired z over blocks of the held-out recording, of the logarithm of the error's power
    before over after.
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
    benches: Sequence[Bench], current: Output, joint: int, guess: Guess, tell: Progress
) -> list[tuple[float, Term]]:
    """The effects at their best grid points, by finite differences of a guess, with the share of
    the squared error that each promises to remove, best first.
    """
    weight, left, basis = _projected(benches, current)
    cost = float(left @ left)
    record = benches[0].records[joint - 1]
    found, calls = [], 0
    present = {t.effect for t in current.model.at(joint)}
    every, told = list(library().values()), 0
    for done, effect in enumerate(every):
        if (tenth := 10 * done // len(every)) > told:
            told = tenth
            bar = "█" * tenth + "░" * (10 - tenth)
            tell(Step.SEARCHING.says(f"joint {joint}: screening the library {bar} {calls} trials"))
        if (
            not on_input(effect)
            or effect.retime is not None
            or any(q.free for key in effect.same_as for q in current.model.mechanism.get(key, ()))
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
                columns.append(guess(with_term(current.model, trial)) - current.error)
                calls += 1
            b = weight * np.stack(columns)
            b = b - (b @ basis) @ basis.T
            gram, moment = b @ b.T, b @ left
            theta: Array = np.asarray(
                -np.linalg.lstsq(gram, moment, rcond=1e-9)[0], dtype=np.float64
            )
            promise = float(-2 * theta @ moment - theta @ gram @ theta) / cost
            start = _start(effect, record, values, theta)
            if start is not None and (best is None or promise > best[0]):
                best = (promise, make_term(effect, joint, start))
        if best is not None:
            found.append(best)
    tell(Step.SEARCHING.says(f"joint {joint}: {calls} trials screened the library"))
    return sorted(found, key=lambda item: -item[0])


def _projected(benches: Sequence[Bench], current: Output) -> tuple[Array, Array, Array]:
    """The weights of the errors; the weighted errors that no free number explains; an orthonormal
    basis of what these explain.
    """
    weight = weights(benches, current.error)
    # a parameter at the end of its range cannot move
    jac = weight[:, None] * current.fit.jacobian[:, ~np.array(current.fit.at_bound, dtype=bool)]
    norms = np.linalg.norm(jac, axis=0)
    jac = jac[:, norms > 0] / norms[norms > 0]
    basis = np.linalg.qr(jac)[0] if jac.shape[1] else np.zeros((len(current.error), 0))
    error = weight * current.error
    return weight, error - basis @ (basis.T @ error), basis


def with_term(model: Model, term: Term) -> Model:
    """The model with one more term, without the terms of the joint that it replaces."""
    gone = get_effect(term.effect).replaces
    kept = tuple(t for t in model.terms if not (t.joint == term.joint and t.effect in gone))
    return model.with_terms((*kept, term))


def _points(
    effect: Effect, record: Any, model: Model
) -> list[tuple[dict[str, float], list[dict[str, float]]]]:
    """Grid points, each with the directions to try: one per linear parameter, two for a phase."""
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
    effect: Effect, record: Any, values: dict[str, float], theta: Array
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
    benches: Sequence[Bench], current: Output, joint: int, guess: Guess
) -> list[tuple[float, Term]]:
    """The candidates that act on the command's timing."""
    weight, left, basis = _projected(benches, current)
    out = []
    for effect in on_timing():
        if effect.name not in {t.effect for t in current.model.at(joint)}:
            step = 2 * benches[0].signals.sample_time
            term = make_term(effect, joint, dict.fromkeys(effect.linear, step))
            change = weight * (guess(with_term(current.model, term)) - current.error)
            change = change - basis @ (basis.T @ change)
            times = -float(change @ left) / max(float(change @ change), 1e-300)
            if times > 0:
                promise = times**2 * float(change @ change) / float(left @ left)
                start = dict.fromkeys(effect.linear, min(times, LONGEST) * step)
                out.append((promise, make_term(effect, joint, start)))
    return out
