"""Where the mismatch lives: in time, and in the space of velocity, position, acceleration and command.

The torque that the calibrated model lacks is estimated by the smoother (a random walk beside the known acceleration); its energy
above what the estimate's own variance explains is the mismatch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d

from zendsp.physics.fit import Data
from zendsp.physics.joint import JointRecord, mechanism_value, trace
from zendsp.physics.model import Model, per_joint
from zendsp.physics.signals import smooth

Array = npt.NDArray[np.float64]

VARIABLES = ("velocity", "position", "acceleration", "command")


@dataclass(frozen=True)
class Region:
    """An interval of one variable at one joint that holds ``share`` of the mismatch in ``time_share`` of the time."""

    joint: int
    variable: str
    interval: tuple[float, float]
    share: float
    time_share: float


@dataclass(frozen=True)
class Missing:
    """The torque that a model lacks along a recording, (n,), N m or N, and the standard deviation of the estimate."""

    time: Array
    torque: Array
    std: Array
    variables: dict[str, Array]


def missing_torque(record: JointRecord, model: Model) -> Missing:
    """Estimate the torque that a model without hidden states lacks along the measured motion."""
    q, qd, qdd = record.motion.states
    floor = max(2.0 * float(np.sqrt(np.median(record.motion.variances[1]))), 0.005 * record.scale.speed)
    inertia, bias = record.inertia_and_bias(model)
    extra = sum(t.value("amount") for t in model.at(record.joint) if t.effect == "inertia")
    inertia = inertia + extra
    gravity = mechanism_value(model, "gravity", record.joint) * np.sin(q) if model.kind == "rotary" else 0.0
    resist = trace(record, model, model.at(record.joint), floor)
    applied = per_joint(model.actuator.gain, record.joint, 1.0) * record.command
    known = np.ascontiguousarray((applied - resist - bias - gravity) / inertia)
    motion = smooth(record.measurement, record.sample_time, known)
    torque = -(motion.states[2] - known) * inertia
    std = np.sqrt(motion.variances[2]) * inertia
    time = record.t0 + np.arange(record.n, dtype=np.float64) * record.sample_time
    return Missing(
        time, torque, std, {"velocity": qd, "position": q, "acceleration": qdd, "command": record.command}
    )


def energy(missing: Missing) -> Array:
    """Square of the missing torque above the variance of its estimate, (n,)."""
    value: Array = np.maximum(missing.torque**2 - missing.std**2, 0.0)
    return value


def regions(missing: Missing, joint: int) -> list[Region]:
    """For each variable, the interval in which the mismatch is most concentrated, most telling first."""
    e = energy(missing)
    total = float(e.sum())
    if total <= 0:
        return []
    found = []
    for name in VARIABLES:
        v = missing.variables[name]
        if float(np.ptp(v)) <= 0:
            continue
        edges = np.unique(np.quantile(v, np.linspace(0, 1, 41)))
        if len(edges) < 5:
            continue
        bins = np.clip(np.searchsorted(edges, v, side="right") - 1, 0, len(edges) - 2)
        share = np.bincount(bins, e, len(edges) - 1) / total
        time = np.bincount(bins, minlength=len(edges) - 1) / len(v)
        gain = share - time  # the interval whose share exceeds its time most (maximum subarray)
        best, start, run, at = 0.0, 0, 0.0, (0, 0)
        for i, g in enumerate(gain):
            if run <= 0:
                run, start = 0.0, i
            run += g
            if run > best:
                best, at = run, (start, i)
        a, b = at
        found.append(
            Region(
                joint,
                name,
                (float(edges[a]), float(edges[b + 1])),
                float(share[a : b + 1].sum()),
                float(time[a : b + 1].sum()),
            )
        )
    return sorted(found, key=lambda r: r.time_share - r.share)


def intervals(missing: Missing, most: int = 5) -> list[tuple[float, float, float]]:
    """Time intervals where the mismatch concentrates: (start s, end s, share), largest share first."""
    e = energy(missing)
    total = float(e.sum())
    if total <= 0 or len(e) < 20:
        return []
    period = float(missing.time[1] - missing.time[0])
    width = max(3, round(0.1 / period))
    level = uniform_filter1d(e, width)
    high = level > 3.0 * float(np.mean(e))
    change = np.flatnonzero(np.diff(np.r_[0, high.astype(int), 0]))
    spans: list[tuple[int, int]] = []
    for a, b in zip(change[::2].tolist(), change[1::2].tolist(), strict=True):
        if spans and a - spans[-1][1] < 2 * width:
            spans[-1] = (spans[-1][0], b)
        else:
            spans.append((a, b))
    out = [
        (float(missing.time[a]), float(missing.time[min(b, len(e)) - 1]), float(e[a:b].sum()) / total)
        for a, b in spans
    ]
    return sorted(out, key=lambda s: -s[2])[:most]


def mismatch(data: Data, model: Model, joint: int) -> list[Missing]:
    """Missing torque of each recording at one joint."""
    return [missing_torque(rec[joint - 1], model) for rec in data.records]
