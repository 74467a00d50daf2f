"""The meaning of a recorded command by MuJoCo's actuators: a torque, or the set value of a servo.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import ModelError
from zendsp.physics.robots.mjcf import Mjcf, actuators_of, library, name_of, place_of
from zendsp_protocol.texts import enumerated

Array = npt.NDArray[np.float64]
Range = tuple[float, float]
OPEN: Range = (-math.inf, math.inf)


@dataclass(frozen=True)
class Drive:
    """One actuator of MuJoCo on one joint.

    The command u is clipped to ``control``, passes the lag, and becomes the force

        f = gain u + bias[0] + bias[1] gear q + bias[2] gear qd

    which is clipped to ``force``; the joint gets gear f, clipped to ``torque``.
    """

    gain: float
    gear: float
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lag: float = 0.0  # s, 0: none
    delay: float = 0.0  # s
    control: Range = OPEN
    force: Range = OPEN
    torque: Range = OPEN

    @property
    def servo(self) -> bool:
        """Whether the command is no torque: the force depends on the motion, or on nothing."""
        return any(self.bias)

    @property
    def scale(self) -> float:
        """Torque per unit of command."""
        return self.gain * self.gear

    @property
    def limit(self) -> float:
        """Largest command that still acts; 0 where there is none, or not the same both ways."""
        ranges = (
            self.control,
            (self.force[0] / self.gain, self.force[1] / self.gain),
            (self.torque[0] / self.scale, self.torque[1] / self.scale),
        )
        low, high = max(min(r) for r in ranges), min(max(r) for r in ranges)
        same = math.isfinite(high) and abs(low + high) < 1e-9 * max(abs(low), abs(high))
        return high if same and high > 0.0 else 0.0

    def applied(self, command: Array, q: Array, qd: Array, sample_time: float) -> Array:
        """Mean torque over each sample of a servo that was told ``command``, all (n,)."""
        u = np.clip(command, *self.control)
        if self.lag > 0.0:
            u = _lagged(u, self.lag, sample_time)
        q, qd = (np.append(0.5 * (x[1:] + x[:-1]), x[-1]) for x in (q, qd))
        force = self.gain * u + self.bias[0] + self.gear * (self.bias[1] * q + self.bias[2] * qd)
        return np.clip(self.gear * np.clip(force, *self.force), *self.torque)


def _lagged(u: Array, lag: float, sample_time: float) -> Array:
    """Mean over each sample of a held command behind a first-order lag."""
    from scipy.signal import lfilter

    keep = math.exp(-sample_time / lag)
    after = lfilter([1 - keep], [1, -keep], u, zi=[keep * u[0]])[0]  # at the end of each sample
    before = np.concatenate([u[:1], after[:-1]])
    return np.asarray(u + (before - u) * lag / sample_time * (1 - keep))


def read_drives(taken: Mjcf, path: str) -> tuple[Drive | None, ...]:
    """The drive of each joint; None where it has no actuator, and its command is its torque.

    Raises
    ------
    ModelError
        Several actuators on one joint, or one whose command is no known function of torque.
    """
    return tuple(_drive(taken.model, k, path) for k in taken.joints)


def _drive(m: Any, joint: int, path: str) -> Drive | None:
    found = actuators_of(m, joint)
    if not found:
        return None
    way_out = "or state [actuator] gain: the command column is then gain times a torque"
    if len(found) > 1:
        names = enumerated(name_of(m, "actuator", a) for a in found)
        raise ModelError(
            f"{path}: {names} drive {place_of(m, joint)}: a recording has one command for each"
            f" joint; leave one of them, {way_out}"
        )
    a, mj = found[0], library()
    where = f"{path}: {name_of(m, 'actuator', a)} at {place_of(m, joint)}"
    gains, biases = np.array(m.actuator_gainprm[a]), np.array(m.actuator_biasprm[a])
    kinds = (
        ("gaintype", int(m.actuator_gaintype[a]), (mj.mjtGain.mjGAIN_FIXED,
                                                   mj.mjtGain.mjGAIN_AFFINE)),
        ("biastype", int(m.actuator_biastype[a]), (mj.mjtBias.mjBIAS_NONE,
                                                   mj.mjtBias.mjBIAS_AFFINE)),
        ("dyntype", int(m.actuator_dyntype[a]), (mj.mjtDyn.mjDYN_NONE, mj.mjtDyn.mjDYN_FILTER,
                                                 mj.mjtDyn.mjDYN_FILTEREXACT)),
    )  # fmt: skip
    for key, kind, known in kinds:
        if kind not in [int(k) for k in known]:
            raise ModelError(
                f"{where}: its {key} cannot be taken over (motors, position and velocity servos,"
                f" affine actuators and first-order filters can); replace it, {way_out}"
            )
    affine = int(m.actuator_gaintype[a]) == int(mj.mjtGain.mjGAIN_AFFINE)
    if (affine and np.any(gains[1:3])) or not gains[0] or not m.actuator_gear[a, 0]:
        raise ModelError(
            f"{where}: its gain is {'none' if not affine else 'a function of the motion'}: expected"
            f" a number that is not 0; change it, {way_out}"
        )
    biased = int(m.actuator_biastype[a]) == int(mj.mjtBias.mjBIAS_AFFINE)
    lagged = int(m.actuator_dyntype[a]) != int(mj.mjtDyn.mjDYN_NONE)
    return Drive(
        gain=float(gains[0]),
        gear=float(m.actuator_gear[a, 0]),
        bias=(float(biases[0]), float(biases[1]), float(biases[2])) if biased else (0.0, 0.0, 0.0),
        lag=float(m.actuator_dynprm[a, 0]) if lagged else 0.0,
        delay=float(m.actuator_delay[a]),
        control=_range(m.actuator_ctrllimited[a], m.actuator_ctrlrange[a]),
        force=_range(m.actuator_forcelimited[a], m.actuator_forcerange[a]),
        torque=_range(m.jnt_actfrclimited[joint], m.jnt_actfrcrange[joint]),
    )


def _range(limited: Any, values: Sequence[float]) -> Range:
    return (float(values[0]), float(values[1])) if limited else OPEN
