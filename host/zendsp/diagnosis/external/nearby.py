"""Predicts, to first order, the output of a simulator near a model without calling it.

A small push of each joint is simulated once. Within a window of a quarter of a second the response
depends almost only on the time since the push. So its step response gives the response to any small
torque by convolution. The simulator's own parameters act through the Jacobian of the last fit. The
library of effects is then screened at the cost of one simulation per joint, and a fit starts near
its end. Claims are simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.external.output_error import (
    BLOCK,
    Line,
    Output,
    errors,
    fit_output,
    guess_output,
    weights,
)
from zendsp.diagnosis.external.simulator import Bench
from zendsp.physics.calibration.covariance import robust_covariance
from zendsp.physics.calibration.handles import Handle, free_handles, get_values, set_values
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, per_joint

Array = npt.NDArray[np.float64]

PUSH = 0.01  # of the RMS torque
PARAMETER_STEP = 1e-4  # of a parameter of the simulator
KEPT = 0.5  # of a guess's promise: least gain of a fit, if the guess holds
SMALL = 0.02  # of an effect: start of a fit in short steps
# of the cost: least gain of such a step. A fit that ends too early would leave some tens of
# evidence to the next effect, merely for fitting further
SHORT_WAY_GAIN = 1e-3
FEW, MANY = 5, 12  # simulations of a fit that starts from a guess, and of any other


class Pushed(Bench):
    """A bench near a model, whose simulator is the response of the true one to small pushes."""

    def __init__(self, b: Bench, base: Model) -> None:
        super().__init__(b.signals, b.records, b.simulator, b.given, b.size)
        self.base, self.before = base, b.command(base)
        self.answer = b.run(self.before, base)
        # (joints pushed, windows, frequencies, joints)
        self.response = np.stack([self._pushed(b, i) for i in range(len(b.records))])

    def _pushed(self, b: Bench, i: int) -> npt.NDArray[np.complex128]:
        """The spectra of the response to a push of joint i (0-based), from the second row of each
        window on.
        """
        gain = abs(per_joint(self.base.actuator.gain, i + 1, 1.0))
        push = PUSH * b.records[i].scale.torque / gain
        told, joints = self.before.copy(), self.before.shape[1]
        told[np.arange(b.n) % b.size > 0, i] += push
        step = np.zeros((-(-b.n // b.size) * b.size, joints))
        step[: b.n] = (b.run(told, self.base) - self.answer) / push
        # one row later: a simulator may hold a command from its row on, or until it
        rows = np.diff(step.reshape(-1, b.size, joints), axis=1)
        rows = np.concatenate([rows, 2 * rows[:, -1:] - rows[:, -2:-1]], axis=1)
        if short := b.n % b.size:  # the last window ends before the others
            rows[-1, short - 1 :] = rows[-1, max(short - 2, 0)]
        return np.fft.rfft(rows, 2 * b.size, axis=1)

    def run(self, command: Array, model: Model) -> Array:
        """The answer to a command, (n, joints), by convolution."""
        change = command - self.before
        count = self.response.shape[1]
        out = np.zeros((count, self.response.shape[2], self.answer.shape[1]), dtype=complex)
        for i in np.flatnonzero(np.any(change != 0.0, axis=0)):
            rows = np.zeros(count * self.size)
            rows[: self.n] = change[:, i]
            there = np.fft.rfft(rows.reshape(count, self.size), 2 * self.size, axis=1)
            out += there[:, :, None] * self.response[i]
        moved = np.fft.irfft(out, 2 * self.size, axis=1)[:, : self.size]
        return self.answer + moved.reshape(-1, self.answer.shape[1])[: self.n]

    def command_of(self, i: int, model: Model) -> Array:
        """The joint's command with the terms of the model."""
        same = model.at(i + 1) == self.base.at(i + 1) and model.actuator == self.base.actuator
        return self.before[:, i] if same else super().command_of(i, model)


def spread_over(final: Output, others: Sequence[Bench]) -> Output:
    """A fit with standard deviations increased by how much its numbers differ on other recordings.

    Unexplained torque recurs with the motion and biases the numbers by more than the scatter of the
    windows shows. Other recordings have another motion.
    """
    fit = final.fit
    if not fit.handles:
        return final
    near = Near(others, fit_output(others, fit.model, (), errors(others, fit.model), 1))
    at, weight = near.current.error, weights(others, near.current.error)
    steps = PARAMETER_STEP * np.maximum(np.abs(fit.x), fit.std)
    moved = (set_values(fit.model, fit.handles, fit.x + row) for row in np.diag(steps))
    slopes = weight[:, None] * np.stack([near.errors(m) - at for m in moved], axis=1) / steps
    off = np.linalg.lstsq(slopes * steps, weight * at, rcond=1e-9)[0] * steps
    block = max(10, round(BLOCK / others[0].signals.sample_time))
    there = np.diag(robust_covariance(slopes, weight * at, block))
    apart = float(np.mean(off**2 / np.maximum(fit.std**2 + there, 1e-300)))
    return replace(final, fit=replace(fit, covariance=fit.covariance * max(1.0, apart)))


class Near:
    """The errors of models near a fitted one.

    Parameters
    ----------
    current : Output
        The fitted model about which errors are predicted.
    """

    def __init__(self, benches: Sequence[Bench], current: Output) -> None:
        self.current, self.true = current, benches
        # over whole recordings errors accumulate, and responses differ from place to place
        self.linear = all(b.size for b in benches)
        if not self.linear:
            return
        self.benches = [Pushed(b, current.model) for b in benches]
        handles = free_handles(current.model, offsets=False)
        self.columns = {h: self._column(h) for h in handles}

    def _column(self, handle: Handle) -> Array:
        """The derivative of the errors by a free number; for one of the simulator's own it is
        simulated.
        """
        model = self.current.model
        value = float(get_values(model, [handle])[0])
        step = PARAMETER_STEP * (abs(value) or 1.0)
        moved = set_values(model, [handle], np.array([value + step]))
        if handle.place == "mechanism":
            return (errors(self.true, moved) - self.current.error) / step
        return np.asarray((errors(self.benches, moved) - self.current.error) / step)

    def errors(self, model: Model) -> Array:
        """Measured minus simulated position over its noise, (N,), of the current model with other
        terms, to first order; simulated where that does not hold.
        """
        return errors(self.benches if self.linear else self.true, model)

    def line(self, model: Model) -> Line | None:
        """The linear prediction for a model with other terms: its old numbers move the errors by
        their columns, the new ones by the torque of their terms.
        """
        if not self.linear:
            return None
        places = {id(t): k for k, t in enumerate(self.current.model.terms)}
        handles = free_handles(model, offsets=False)
        slopes: dict[int, Array] = {}
        for i, h in enumerate(handles):
            if h.place != "term":
                slopes[i] = self.columns[h]
            elif (place := places.get(id(model.terms[h.index]))) is not None:
                slopes[i] = self.columns[Handle("term", place, h.key)]
        old = [handles[i] for i in slopes]
        at = get_values(model, old)
        columns = np.stack([*slopes.values(), np.zeros(len(self.current.error))], axis=1)

        def guess(other: Model) -> Array:
            moved = np.append(get_values(other, old) - at, 0.0)
            return np.asarray(self.errors(set_values(other, old, at)) + columns @ moved)

        return Line(guess, slopes)

    def begin(self, model: Model) -> tuple[Model, Array]:
        """A model with other terms, fitted to first order, and its predicted errors."""
        line = self.line(model)
        if line is None:
            return model, errors(self.true, model)
        handles = free_handles(model, offsets=False)
        return guess_output(self.true, model, handles, self.current.error, line)

    def fit(
        self, model: Model, begin: tuple[Model, Array] | None = None, rounds: int = 0
    ) -> Output:
        """A model with other terms, fitted from its first-order fit with these slopes. Where it
        gains much less than promised, it is fitted in some short steps.
        """
        handles, before = free_handles(model, offsets=False), self.current.error
        line = self.line(model)
        if line is None:
            return fit_output(self.true, model, handles, before, MANY)
        start, guessed = begin or self.begin(model)
        out = fit_output(self.true, start, handles, before, FEW, line)
        weight = weights(self.true, before)
        nothing, promised = (float(np.sum((weight * e) ** 2)) for e in (before, guessed))
        if not rounds or nothing - out.fit.cost > KEPT * (nothing - promised):
            return out
        slow = fit_output(self.true, self._small(model), handles, before, FEW, line)
        slow = settled(self.true, slow, rounds, before)
        return min(out, slow, key=lambda o: o.fit.cost)

    def _small(self, model: Model) -> Model:
        """A model with its new terms almost zero."""
        old = {id(t) for t in self.current.model.terms}
        handles = [
            h
            for h in free_handles(model, offsets=False)
            if h.place == "term"
            and id(model.terms[h.index]) not in old
            and h.key in get_effect(model.terms[h.index].effect).linear
        ]
        return set_values(model, handles, SMALL * get_values(model, handles))

    def bumps(self, k: int, joint: int, shapes: Array) -> Array:
        """The response of a joint's error (0-based) on recording k to torques over time, (n,
        shapes), rad or m per N m or N.
        """
        b, model = (self.benches if self.linear else self.true)[k], self.current.model
        e, before = b.error(model)[:, joint], b.command(model)
        gain = per_joint(model.actuator.gain, joint + 1, 1.0)
        size = PUSH * b.records[joint].scale.torque
        columns = []
        for shape in shapes:
            command = before.copy()
            command[:, joint] -= size * shape / gain
            moved = b.signals.position - b.sensed(b.run(command, model), model)
            columns.append((e - b.told(moved)[:, joint]) / size)
        return np.stack(columns, axis=1)


def settled(benches: Sequence[Bench], output: Output, rounds: int, before: Array) -> Output:
    """A fit continued to convergence with new slopes each time, since the response to a push
    depends on the simulator's own numbers, which a new effect moves. ``before`` is as for
    ``fit_output``.
    """
    handles = free_handles(output.model, offsets=False)
    cost = float(np.sum((weights(benches, before) * output.error) ** 2))
    for _ in range(rounds):
        line = Near(benches, output).line(output.model)
        further = fit_output(benches, output.model, handles, before, FEW, line)
        gained = cost - further.fit.cost
        if gained > 0:
            output, cost = further, further.fit.cost
        if gained < SHORT_WAY_GAIN * cost:
            break
    return output
