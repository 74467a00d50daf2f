"""How visible a concealed effect is, measured from the truth alone and before any diagnosis runs.

The given structure is refitted by least squares to the true motion (no sensor noise, no
differentiation of counts). What the refit leaves, as a torque, is passed through the error dynamics
of the steady Kalman observer that the sensor deserves; the variance that it adds to the
innovations, over the variance that noise gives them, says what any method could see.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zendsp.proof.draft import Array, Draft, Scale
from zendsp.proof.given import TRUTH, feature, inertial_torque

# torque that no method can expect to model: hold, sampling, rounding; share of the torque's RMS per
# sample
PROCESS = 0.003
# log-likelihood ratio above which an effect counts as detectable: 60 leaves room for two
# parameters, the refit, a held-out test at z = 4 (8) and innovations that are correlated over some
# samples
DETECTABLE = 60.0


@dataclass(frozen=True)
class Visibility:
    """What the best refit of the incomplete model leaves."""

    torque_share: float  # RMS of what is left / RMS of the torque
    innovation_ratio: float  # variance of innovations with the effect / without
    log_likelihood: float  # of the whole recording, natural logarithm

    @property
    def detectable(self) -> bool:
        """Whether a method could see it: its log-likelihood is `DETECTABLE` at least."""
        return self.log_likelihood >= DETECTABLE


def free_columns(d: Draft, joint: int, scales: list[Scale]) -> Array:
    """Torque per unit of every free parameter of the given model that is linear, (rows,
    parameters).
    """
    s = scales[joint]
    columns = []
    for name in d.parameters:
        if name in d.fixed or name in d.absent or (name == "gravity" and d.parameters[name] == 0.0):
            continue
        one = {key: float(key == name) for key in d.parameters}
        columns.append(inertial_torque(d, one, scales)[joint])
    if not d.fixed_terms:
        columns += [feature(name, s.v) for name in sorted(d.terms[joint])]
    for term in d.known:
        if term.joint != joint + 1:
            continue
        if term.kind == "stiffness":
            columns += [s.q, np.ones_like(s.q)]
        elif term.kind == "ripple":
            columns += [np.sin(term.values["order"] * s.q), np.cos(term.values["order"] * s.q)]
        elif term.kind == "quadratic_drag":
            columns.append(s.v * np.abs(s.v))
        elif term.kind == "torque_offset":
            columns.append(np.ones_like(s.q))
    return np.stack(columns, 1) if columns else np.zeros((s.q.size, 0))


def fixed_torque(d: Draft, joint: int, scales: list[Scale]) -> Array:
    """Torque of what the given model holds fixed, at its stated value."""
    held = {k: (v if k in d.fixed and k not in d.absent else 0.0) for k, v in d.parameters.items()}
    total = inertial_torque(d, held, scales)[joint]
    if d.fixed_terms:
        for name in d.terms[joint]:
            total = total + d.joints[joint].get(TRUTH[name], 0.0) * feature(name, scales[joint].v)
    return total


class Judge:
    """Measures what torques are left over on one joint, after the refit of the given model's free
    parameters.
    """

    def __init__(self, d: Draft, joint: int, scales: list[Scale], inertia: float) -> None:
        self.scale = scales[joint]
        self.slides = self.scale.slides
        self.fixed = fixed_torque(d, joint, scales)
        free = free_columns(d, joint, scales)[self.slides]
        q, r = np.linalg.qr(free / (np.sqrt(np.mean(free**2, 0)) + 1e-300))
        self.basis = q[:, np.abs(np.diag(r)) > 1e-9 * np.sqrt(len(q))]
        self.numerator, self.denominator, self.variance = observer(
            d, joint, inertia, self.scale.torque
        )

    def rest(self, drive: Array, extra: Array | None = None) -> Array:
        """`drive` less what the fixed part, the free parameters and the columns `extra` explain;
        zero where at rest.
        """
        target = self.project((drive - self.fixed)[self.slides, None])
        if extra is not None:
            extra = extra[self.slides]
            columns = self.project(extra) / (np.sqrt(np.mean(extra**2, 0)) + 1e-300)
            gram = columns.T @ columns
            target = target - columns @ (
                np.linalg.pinv(gram, rcond=1e-11, hermitian=True) @ (columns.T @ target)
            )
        out = np.zeros(self.slides.size)
        out[self.slides] = target[:, 0]
        return out

    def project(self, columns: Array) -> Array:
        """Columns without what the free parameters of the given model can imitate."""
        return np.asarray(columns - self.basis @ (self.basis.T @ columns))

    def measure(self, rest: Array) -> Visibility:
        """Visibility of a torque that is left over."""
        from scipy.signal import lfilter  # takes two seconds, here where a case is made

        e = lfilter(self.numerator, self.denominator, rest)
        ratio = 1.0 + float(np.mean(e**2)) / self.variance
        share = float(np.sqrt(np.mean(rest**2))) / self.scale.torque
        return Visibility(share, ratio, 0.5 * rest.size * float(np.log(ratio)))


def observer(d: Draft, joint: int, inertia: float, rms: float) -> tuple[Array, Array, float]:
    """The steady Kalman observer as a filter from torque to innovation, and the innovation's
    variance from noise.
    """
    noise = d.joints[joint]["resolution"] ** 2 * (1 / 12 + d.noise**2)
    return steady_observer(
        d.sample_time, inertia, noise, rms * float(np.hypot(PROCESS, d.nuisance))
    )


def steady_observer(
    dt: float, inertia: float, noise: float, sigma: float
) -> tuple[Array, Array, float]:
    """The same for a position noise of variance `noise` and a torque noise of deviation `sigma` per
    sample.
    """
    from scipy.linalg import solve_discrete_are

    a = np.array([[1.0, dt], [0.0, 1.0]])
    b = np.array([[0.5 * dt**2], [dt]]) / inertia
    c = np.array([[1.0, 0.0]])
    p = solve_discrete_are(a.T, c.T, b @ b.T * sigma**2, np.array([[noise]]))
    variance = float(p[0, 0]) + noise
    gain = a @ p @ c.T / variance
    error = a - gain @ c  # x' = error x + b torque, innovation = x[0]
    denominator = np.array([1.0, -np.trace(error), np.linalg.det(error)])
    numerator = np.array([0.0, b[0, 0], (error[0, 1] * b[1, 0] - error[1, 1] * b[0, 0])])
    return numerator, denominator, variance
