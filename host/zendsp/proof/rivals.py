"""Which other effects this very recording cannot tell from the concealed one, by the truth and
physics alone.

Every rival is refitted together with all free parameters of the given model to the true motion. A
rival that leaves less than a detectable remainder explains the recording as well as the truth does,
and naming it is no error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from zendsp.proof.draft import Array, Draft, Scale
from zendsp.proof.mechanisms import NEEDLESS
from zendsp.proof.oracle import DETECTABLE, Judge


@dataclass(frozen=True)
class Rival:
    """Columns to add to the refit, or another torque of the actuator, for one value of a shape
    parameter.
    """

    columns: Callable[[float], Array] | None = None
    drive: Callable[[float], Array] | None = None
    grid: tuple[float, ...] = (0.0,)


def stack(*columns: Array) -> Array:
    """Columns side by side, (rows, columns)."""
    return np.stack(columns, 1)


def _spaced(low: float, high: float, count: int) -> tuple[float, ...]:
    return tuple(float(x) for x in np.geomspace(low, high, count))


def bristle(q: Array, bend: float) -> Array:
    """Dahl's deflection over its saturation along the true motion, -1..1."""
    step = np.diff(q, prepend=q[0])
    out, z = [], 0.0
    decays = np.exp(-np.abs(step) / bend).tolist()
    for rest, decay in zip(np.sign(step).tolist(), decays, strict=True):
        if rest:
            z = rest + (z - rest) * decay
        out.append(z)
    return np.array(out)


def bouc_wen(q: Array, bend: float) -> Array:
    """Bouc-Wen z with n = 1 and beta = gamma: stiff when loading, linear when unloading."""
    out, z = [], 0.0
    for dx in (np.diff(q, prepend=q[0]) / bend).tolist():
        z = max(-1.0, min(1.0, z + dx - 0.5 * (abs(dx) * z + dx * abs(z))))
        out.append(z)
    return np.array(out)


def rivals(d: Draft, joint: int, scales: list[Scale], judge: Judge) -> Iterator[tuple[str, Rival]]:
    """Every rival that has a torque along the recorded motion; springs and gaps behind the sensor
    have none.
    """
    s = scales[joint]
    q, v, a, sign, one = s.q, s.v, s.a, np.sign(s.v), np.ones_like(s.q)
    t = np.arange(q.size) * d.sample_time
    reach, dt = max(s.reach, 1e-9), d.sample_time
    turns = _spaced(2 * np.pi / reach, 60 * np.pi / reach, 140)
    yield "viscous", Rival(lambda _: stack(v))
    yield "coulomb", Rival(lambda _: stack(sign))
    yield "coulomb_asymmetry", Rival(lambda _: stack(sign, one))
    yield "viscous_asymmetry", Rival(lambda _: stack(v, np.abs(v)))
    yield "quadratic_drag", Rival(lambda _: stack(v * np.abs(v)))
    yield "load_friction", Rival(lambda _: stack(sign * np.abs(s.drive)))
    yield "gravity", Rival(lambda _: stack(np.sin(q), np.cos(q)))
    yield "stiffness", Rival(lambda _: stack(q, one))
    yield "cubic_stiffness", Rival(lambda _: stack(q**3, q**2, q, one))
    yield "torque_offset", Rival(lambda _: stack(one))
    yield (
        "stribeck",
        Rival(
            lambda x: stack(sign, sign * np.exp(-((v / x) ** 2))),
            grid=_spaced(0.02 * s.v_rms, s.v_rms, 10),
        ),
    )
    yield "presliding", Rival(
        lambda x: stack(sign, bristle(q, x)), grid=_spaced(1e-3 * reach, 0.1 * reach, 8)
    )
    yield "hysteresis", Rival(
        lambda x: stack(bouc_wen(q, x)), grid=_spaced(3e-3 * reach, 0.2 * reach, 7)
    )
    yield (
        "position_friction",
        Rival(lambda x: stack(sign, sign * np.sin(x * q), sign * np.cos(x * q)), grid=turns),
    )
    yield "ripple", Rival(lambda x: stack(np.sin(x * q), np.cos(x * q)), grid=turns)
    yield (
        "friction_drift",
        Rival(
            lambda x: stack(sign, v, sign * np.exp(-t / x), v * np.exp(-t / x)),
            grid=_spaced(0.05 * t[-1], t[-1], 7),
        ),
    )
    if d.fixed & set(d.parameters):
        yield "inertia", Rival(lambda _: stack(a))
        yield "torque_gain", Rival(lambda _: stack(judge.fixed))
    if d.kind != "linear":
        yield (
            "encoder_eccentricity",
            Rival(
                lambda _: stack(np.cos(q) * a - np.sin(q) * v**2, np.sin(q) * a + np.cos(q) * v**2)
            ),
        )
    yield (
        "delay",
        Rival(
            drive=lambda x: np.asarray(np.interp(t - x, t, s.drive)),
            grid=(0.0, *_spaced(0.1 * dt, 20 * dt, 9)),
        ),
    )
    yield "lag", Rival(drive=lambda x: lagged(s.drive, x, dt), grid=_spaced(0.1 * dt, 20 * dt, 9))
    peak = float(np.max(np.abs(s.drive)))
    yield (
        "dead_zone",
        Rival(
            drive=lambda x: s.drive - np.clip(s.drive, -x, x),
            grid=_spaced(1e-3 * peak, 0.3 * peak, 9),
        ),
    )
    yield "saturation", Rival(
        drive=lambda x: np.clip(s.drive, -x, x), grid=_spaced(0.2 * peak, peak, 9)
    )


def lagged(drive: Array, seconds: float, dt: float) -> Array:
    """Mean torque of each hold interval after a first-order lag."""
    from scipy.signal import lfilter

    decay = float(np.exp(-dt / seconds))
    end = lfilter([1 - decay], [1, -decay], drive)
    begin = np.concatenate([[0.0], end[:-1]])
    return np.asarray(drive + (begin - drive) * (1 - decay) * seconds / dt)


def remainder(judge: Judge, rival: Rival) -> float:
    """Log-likelihood that is still missing with the best shape of a rival; smaller is a better
    rival.
    """

    def at(x: float) -> float:
        extra = rival.columns(x) if rival.columns else None
        drive = rival.drive(x) if rival.drive else judge.scale.drive
        return judge.measure(judge.rest(drive, extra)).log_likelihood

    scores = [at(x) for x in rival.grid]
    best = int(np.argmin(scores))
    if len(rival.grid) < 3 or scores[best] < DETECTABLE:
        return scores[best]
    low, high = rival.grid[max(best - 1, 0)], rival.grid[min(best + 1, len(rival.grid) - 1)]
    from scipy.optimize import minimize_scalar  # takes a second, here where it is used

    found = minimize_scalar(at, bounds=(low, high), method="bounded", options={"maxiter": 12})
    return float(min(scores[best], found.fun))


def inseparable(
    d: Draft, joint: int, scales: list[Scale], judge: Judge, truth: str
) -> dict[str, float]:
    """Names of the rivals that leave nothing detectable, with the log-likelihood that each leaves.
    """
    out = {}
    for name, rival in rivals(d, joint, scales, judge):
        if name == truth or name in NEEDLESS.get(truth, ()):
            continue
        left = remainder(judge, rival)
        if left < DETECTABLE:
            out[name] = round(left, 2)
    needless = {more for name in out for more in NEEDLESS.get(name, ())}
    return {name: left for name, left in out.items() if name not in needless}
