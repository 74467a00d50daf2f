"""Where the mismatch lives: in time, and in the space of velocity, position, acceleration and
command.

The torque that a model lacks is what corrects an observer that keeps the model on the motion
(discrepancy.py); its energy above that of the sensor's noise is the mismatch.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.measure.discrepancy import BANDS, band_of, kept, lacking, noise
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import effective_inertia
from zendsp.physics.calibration.predict import damping_along
from zendsp.physics.kernel.smooth import moving_mean
from zendsp.physics.model import Model, per_joint

Array = npt.NDArray[np.float64]

VARIABLES = ("velocity", "position", "acceleration", "command")
SAMPLES = 20  # fewer have no intervals
EDGES = 5  # different ones: a variable with fewer is as good as constant
CONCENTRATED = 3.0  # times the mean of the energy: there the mismatch concentrates


@dataclass(frozen=True)
class Region:
    """An interval of one variable at one joint that holds ``share`` of the mismatch in
    ``time_share`` of the time.
    """

    joint: int
    variable: str
    interval: tuple[float, float]
    share: float
    time_share: float
    unit: str = ""  # of the interval

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.variable} {low:.3g} … {high:.3g} {self.unit}".rstrip()


@dataclass(frozen=True)
class Missing:
    """The torque that a model lacks along a recording, (n,), N m or N, and the standard deviation
    of the estimate.
    """

    time: Array
    torque: Array
    std: Array
    variables: dict[str, Array]
    units: dict[str, str] = field(default_factory=dict)
    others: Array | None = None  # (joints, 3, n): position, velocity, acceleration of all joints


def mismatch(data: Data, model: Model, joint: int) -> list[Missing]:
    """Torque that a model lacks at one joint, along each recording: how an observer that keeps it
    on the motion corrects it, with what the model's own damping takes of a correction.
    """
    found = lacking(data, model, joint, BANDS[0])
    out = []
    for torque, rec in zip(found, data.records, strict=True):
        record = rec[joint - 1]
        q, qd, qdd = record.motion.states
        use = kept(record, BANDS[0])
        time = record.t0 + np.arange(record.n, dtype=np.float64) * record.sample_time
        stiff = effective_inertia(record, model) * band_of(record, BANDS[0])
        taken = 1.0 + np.sqrt(2.0) * damping_along(record, model) / stiff
        torque, std = torque * taken, taken * np.sqrt(noise(record, model, BANDS[0]))
        variables = {"velocity": qd, "position": q, "acceleration": qdd, "command": record.command}
        within = {n: v[use] for n, v in variables.items()}
        named = units(model, joint)
        all_joints = record.others[:, :, use]
        out.append(Missing(time[use], torque[use], std[use], within, named, all_joints))
    return out


def units(model: Model, joint: int) -> dict[str, str]:
    """Return the unit of each variable at one joint."""
    length = "m" if model.joint_kind(joint) == "linear" else "rad"
    plain = abs(per_joint(model.actuator.gain, joint, 1.0)) == 1.0 and not model.actuator.matrix
    command = model.actuator.unit or (model.torque_unit(joint) if plain else "")
    return {
        "position": length,
        "velocity": f"{length}/s",
        "acceleration": f"{length}/s²",
        "command": command,
    }


def energy(missing: Missing) -> Array:
    """Square of the missing torque above the variance of its estimate, (n,)."""
    value: Array = np.maximum(missing.torque**2 - missing.std**2, 0.0)
    return value


def regions(missing: Missing, joint: int) -> list[Region]:
    """For each variable, the interval in which the mismatch is most concentrated, most telling
    first.
    """
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
        if len(edges) < EDGES:
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
                missing.units.get(name, ""),
            )
        )
    return sorted(found, key=lambda r: r.time_share - r.share)


def intervals(missing: Missing, most: int = 5) -> list[tuple[float, float, float]]:
    """Time intervals where the mismatch concentrates: (start s, end s, share), largest share first.
    """
    e = energy(missing)
    total = float(e.sum())
    if total <= 0 or len(e) < SAMPLES:
        return []
    period = float(missing.time[1] - missing.time[0])
    width = max(3, round(0.1 / period))
    level = moving_mean(e, width)
    high = level > CONCENTRATED * float(np.mean(e))
    change = np.flatnonzero(np.diff(np.r_[0, high.astype(int), 0]))
    spans: list[tuple[int, int]] = []
    for a, b in zip(change[::2].tolist(), change[1::2].tolist(), strict=True):
        if spans and a - spans[-1][1] < 2 * width:
            spans[-1] = (spans[-1][0], b)
        else:
            spans.append((a, b))
    out = [
        (
            float(missing.time[a]),
            float(missing.time[min(b, len(e)) - 1]),
            float(e[a:b].sum()) / total,
        )
        for a, b in spans
    ]
    return sorted(out, key=lambda s: -s[2])[:most]
