"""Likelihood of a fitted hypothesis, with the process noise chosen by the data.

A hypothesis that leaves physics out needs strong process noise, that is a fast observer, to follow
the recording; the right one predicts with a slow observer. The likelihood of the innovations,
maximised over the observer's bandwidth, sees both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.chord import fit_near
from zendsp.physics.calibration.fit import Data, Fit, fit, joint_handles, residual, residuals
from zendsp.physics.calibration.handles import Handle
from zendsp.physics.calibration.predict import ran_away
from zendsp.physics.kernel.threads import threads
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

# rad/s: 10 Hz; a faster observer follows noise and structural vibration
SLOWEST, FASTEST = 4.0, 64.0
BETTER = 2.0  # deviance: another bandwidth that gains less is not taken


@dataclass(frozen=True)
class Scored:
    """A hypothesis after its fit.

    Attributes
    ----------
    fit : Fit
    data : Data
        Recordings with the bandwidths that maximise the likelihood.
    deviance : float
        -2 log-likelihood of the fitted joints.
    joints : tuple of int
        Joints that count (1-based).
    """

    fit: Fit
    data: Data
    deviance: float
    joints: tuple[int, ...]

    @property
    def model(self) -> Model:
        """The fitted model."""
        return self.fit.model


def log_weights(data: Data, joint: int) -> float:
    """Sum of log S over the samples that count."""
    return sum(rec[joint - 1].log_weights(data.bandwidth[joint - 1]) for rec in data.records)


def informative(data: Data, joint: int) -> int:
    """Number of samples that count."""
    return sum(rec[joint - 1].informative for rec in data.records)


def deviance(data: Data, model: Model, joints: Sequence[int]) -> float:
    """-2 log-likelihood with the noise scale profiled per joint; infinite where the prediction
    diverged.
    """
    total = 0.0
    for j in joints:
        r = residual(data, model, (j,))
        total += deviance_of(data, j, r)
    return total


def deviances(data: Data, models: Sequence[Model], joint: int, jobs: int = 1) -> list[float]:
    """The ``deviance`` of one joint for each of some models that differ in numbers only; ``jobs``
    threads.
    """
    with threads(jobs) as each:
        columns = np.ascontiguousarray(residuals(data, models, (joint,), each).T)
    return [deviance_of(data, joint, r) for r in columns]


def deviance_of(data: Data, joint: int, r: Array) -> float:
    """The ``deviance`` from the innovations of one joint."""
    n = informative(data, joint)
    if ran_away(r):
        return float("inf")
    mean = float(r @ r) / max(n, 1)
    return n * float(np.log(max(mean, 1e-12))) + log_weights(data, joint)


def cost_of(data: Data, joint: int, value: float) -> float:
    """The sum of squares of one joint's innovations at which ``deviance`` has a value."""
    n = max(informative(data, joint), 1)
    return n * float(np.exp(min((value - log_weights(data, joint)) / n, 500.0)))


def fastest(data: Data, most: float = FASTEST) -> float:
    """Fastest observer that the sample time allows, rad/s, up to ``most``."""
    return min(most, 0.5 / data.records[0][0].sample_time)


def fitted_deviance(data: Data, fitted: Fit, joints: Sequence[int]) -> float:
    """The ``deviance`` of a fit to these data, from its final innovations."""
    parts: dict[int, list[Array]] = {j: [] for j in joints}
    at = 0
    for rec in data.records:
        for j in joints:
            parts[j].append(fitted.residual[at : at + rec[j - 1].n])
            at += rec[j - 1].n
    return sum(deviance_of(data, j, np.concatenate(parts[j])) for j in joints)


def tune_bandwidth(
    data: Data,
    model: Model,
    joints: Sequence[int],
    *,
    down_only: bool = False,
    known: float | None = None,
) -> tuple[Data, float]:
    """The data with the bandwidth of each joint's observer that maximises the likelihood of a
    model, found by doubling and halving. For one joint, ``known`` may give the deviance at the
    start.
    """
    total = 0.0
    for j in joints:
        best = known if known is not None and len(joints) == 1 else deviance(data, model, (j,))
        for factor in (0.5,) if down_only else (0.5, 2.0):
            moved = False
            while SLOWEST <= data.bandwidth[j - 1] * factor <= fastest(data):
                trial = data.at_bandwidth(j, data.bandwidth[j - 1] * factor)
                value = deviance(trial, model, (j,))
                if not value < best - BETTER:
                    break
                data, best, moved = trial, value, True
            if moved:
                break
        total += best
    return data, total


def fit_scored(
    data: Data,
    model: Model,
    handles: Sequence[Handle],
    joints: Sequence[int],
    *,
    iterations: int = 12,
    jobs: int = 2,
    rounds: int = 4,
    goal: float = math.inf,
    near: Callable[[Data], Fit] | None = None,
) -> Scored:
    """The fit of a model and its tuned observer, repeated until the bandwidth converges.

    Parameters
    ----------
    data : Data
        Recordings with the initial bandwidths.
    model, handles, joints
        As for ``fit``.
    iterations : int
        Of each fit.
    jobs : int
        Threads.
    rounds : int
        Most changes of bandwidth.
    goal : float
        The deviance of the joint below which the fit is of any use, see ``fit``.
    near : callable or None
        The fit to some recordings of a model near that of one joint, see ``fit_near``.
    """
    best: Scored | None = None
    for left in reversed(range(rounds)):
        most = cost_of(data, joints[0], goal) if goal < math.inf else goal
        result = near and fit_near(data, model, near(data), joints[0])
        result = result or fit(
            data, model, handles, joints=joints, iterations=iterations, jobs=jobs, goal=most
        )
        value = fitted_deviance(data, result, joints)
        if best is None or value < best.deviance:
            best = Scored(result, data, value, tuple(joints))
        if not left:
            break
        tuned, tuned_value = tune_bandwidth(data, result.model, joints, known=value)
        if tuned.bandwidth == data.bandwidth or not tuned_value < value - BETTER:
            break
        data, model = tuned, result.model
    assert best is not None
    return best


def calibrate_joint(data: Data, model: Model, joint: int, jobs: int = 1) -> Scored:
    """The given model with the free parameters that act on one joint refitted."""
    handles, joints = joint_handles(data, model, joint), (joint,)
    return slower(fit_scored(data, model, handles, joints, jobs=jobs), joint, jobs)


def slower(best: Scored, joint: int, jobs: int = 1) -> Scored:
    """A fit of one joint, or the same under a slower observer where that is likelier. The slower
    one is tried with numbers fitted for it, since those of a faster one, bent by a small
    discrepancy, hide how well it does.
    """
    while (half := 0.5 * best.data.bandwidth[joint - 1]) >= SLOWEST:
        data, handles = best.data.at_bandwidth(joint, half), best.fit.handles
        least = best.deviance - BETTER
        other = fit_scored(data, best.model, handles, (joint,), jobs=jobs, rounds=1, goal=least)
        if not other.deviance < least:
            break
        best = other
    return best
