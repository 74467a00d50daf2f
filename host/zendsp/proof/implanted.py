"""Known forces along a recorded motion, and recordings with such a force in them.

If M qdd + ... = K u holds on the real machine, then M qdd + ... + e = K (u + e / K) holds for a
machine with the force e too: exact truth, real sensor, real noise. Valid where joints are rigid. A
law of the actuator is put in the same way: the command that such an actuator would have needed for
the recorded torque. What a sensor does is put into its column. The laws stand here in formulas of
their own; nothing of the diagnosis is used.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zendsp.proof.draft import Array

CUTOFF_HZ = 40.0
OF_RATE = 0.2  # the cutoff at most
SOFT = 0.02  # of the top speed: where dry friction turns
Numbers = Mapping[str, float]


@dataclass(frozen=True)
class Motion:
    """The motion of one joint in the middle of each hold interval, and the torque that moves it."""

    t: Array  # s, from the first row
    q: Array
    v: Array
    a: Array
    torque: Array  # of the actuator, N m or N
    slow: float  # speed within which dry friction turns
    gain: float  # torque per unit of command

    @property
    def turn(self) -> Array:
        """The direction of motion, soft at reversals; zero at rest, where friction has no law."""
        out: Array = np.tanh(self.v / self.slow)
        return out


def middle_motion(t: Array, q: Array) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration in the middle of each hold interval, without phase."""
    from scipy.signal import butter, sosfiltfilt  # takes two seconds, here where it is used

    dt = float(np.median(np.diff(t)))
    even = np.arange(t[0], t[-1] + dt, dt)
    sos = butter(4, min(CUTOFF_HZ, OF_RATE / dt), fs=1 / dt, output="sos")
    smooth = sosfiltfilt(sos, np.interp(even, t, q))
    v = np.gradient(smooth, dt)
    middle = t + 0.5 * np.diff(t, append=t[-1] + dt)
    a = np.gradient(v, dt)
    return np.interp(middle, even, smooth), np.interp(middle, even, v), np.interp(middle, even, a)


def _settled(m: Motion, time_constant: float) -> Array:
    out: Array = 1.0 - np.exp(-m.t / time_constant)
    return out


def _bouc_wen(m: Motion, force: float, stiffness: float) -> Array:
    """Exact along each row, where the direction does not change: dz/dq = A (1 - sign(q̇) z), the
    same law on either side of z = 0 where z has the sign of the motion, and A where it has not.
    """
    z, out, rate = 0.0, np.zeros(len(m.q)), stiffness / force
    for k, dx in enumerate(np.diff(m.q, prepend=m.q[0])):
        steps = max(1, int(abs(dx) * rate / 0.02))
        for _ in range(steps):
            against = z * dx < 0.0
            z += rate * dx / steps * (1.0 if against else 1.0 - abs(z))
        out[k] = force * z
    return out


FORCES: dict[str, Callable[[Motion, Numbers], Array]] = {
    "viscous": lambda m, p: p["coefficient"] * m.v,
    "quadratic_drag": lambda m, p: p["coefficient"] * m.v * np.abs(m.v),
    "stribeck": lambda m, p: (
        p["breakaway"] * np.exp(-((m.v / p["velocity"]) ** 2)) * np.tanh(5 * m.v / p["velocity"])
    ),
    "position_friction": lambda m, p: (
        p["amplitude"] * np.sin(2 * np.pi * m.q / p["period"] + p["phase"]) * m.turn
    ),
    "friction_drift": lambda m, p: (
        p["ratio"] * _settled(m, p["time_constant"]) * (p["dry"] * m.turn + p["fluid"] * m.v)
    ),
    "hysteresis": lambda m, p: _bouc_wen(m, p["force"], p["stiffness"]),
    "load_friction": lambda m, p: p["coefficient"] * np.abs(m.torque) * m.turn,
    "gravity": lambda m, p: p["torque"] * np.sin(m.q - p["angle"]),
    "stiffness": lambda m, p: p["coefficient"] * (m.q - p["neutral"]),
    "cubic_stiffness": lambda m, p: p["coefficient"] * (m.q - p["neutral"]) ** 3,
    "ripple": lambda m, p: p["amplitude"] * np.sin(p["order"] * m.q + p["phase"]),
    "inertia": lambda m, p: p["amount"] * m.a,
    "torque_offset": lambda m, p: np.full(len(m.q), p["level"]),
    "disturbance": lambda m, p: np.where(
        np.abs(m.t - p["middle"]) < 0.5 * p["length"], -p["peak"], 0.0
    ),
}
# the command, as a torque, that an actuator with the law needs for the recorded torque; a width is
# in units of the command
ACTUATORS: dict[str, Callable[[Motion, Numbers], Array]] = {
    "torque_gain": lambda m, p: m.torque / (1.0 + p["ratio"]),
    "gain_drift": lambda m, p: m.torque / (1.0 + p["ratio"] * _settled(m, p["time_constant"])),
    "dead_zone": lambda m, p: m.torque + m.gain * p["width"] * np.sign(m.torque),
    # whole rows; the last ones are cut off
    "delay": lambda m, p: np.append(m.torque[int(p["rows"]) :], np.zeros(int(p["rows"]))),
}
SENSORS: dict[str, Callable[[Array, Numbers], Array]] = {
    "encoder_eccentricity": lambda q, p: q + p["amplitude"] * np.sin(q + p["phase"]),
}
LAWS = (*FORCES, *ACTUATORS, *SENSORS)


@dataclass(frozen=True)
class Columns:
    """The columns of a recording that a model names, in joint coordinates."""

    table: dict[str, Array]
    model: Mapping[str, Any]

    @staticmethod
    def read(path: Path, model: Path) -> Columns:
        """A recording (.mat or .npz) as the model reads it."""
        if path.suffix == ".mat":
            from scipy.io import loadmat

            table = {k: v for k, v in loadmat(path, squeeze_me=True).items() if k[0] != "_"}
        else:
            with np.load(path) as file:
                table = dict(file)
        with model.open("rb") as opened:
            return Columns(table, tomllib.load(opened))

    @property
    def positions(self) -> Array:
        """As measured, in rad or m of the sensor."""
        return np.asarray(self.table[self.model["columns"]["position"]], float)

    @property
    def torques(self) -> Array:
        """Torque of each joint, (n, joints) or (n,)."""
        u = np.asarray(self.table[self.model["columns"]["command"]], float)
        out: Array = u @ self._actuator().T if u.ndim > 1 else u * self._actuator()[0, 0]
        return out

    def _actuator(self) -> Array:
        actuator = self.model["actuator"]
        gain = np.atleast_1d(np.asarray(actuator["gain"]["value"], float))
        matrix = np.asarray(actuator.get("matrix", np.eye(len(gain))), float)
        out: Array = matrix * gain  # joint torque = matrix @ (gain · command)
        return out

    def _sensor(self) -> tuple[Array, Array]:
        joints = self.positions.shape[1] if self.positions.ndim > 1 else 1
        sensor = self.model.get("sensor", {})
        offset = np.asarray(sensor.get("offset", np.zeros(joints)), float)
        return np.asarray(sensor.get("matrix", np.eye(joints)), float), offset

    def motion(self, joint: int) -> Motion:
        """The motion of a joint."""
        matrix, offset = self._sensor()
        measured = self.positions.reshape(len(self.positions), -1)
        q = measured @ matrix.T + offset
        t = np.asarray(self.table[self.model["columns"]["time"]], float)
        q, v, a = middle_motion(t - t[0], q[:, joint - 1])
        torque = self.torques.reshape(len(q), -1)[:, joint - 1]
        gains = np.atleast_1d(self.model["actuator"]["gain"]["value"])
        gain = float(gains[min(joint, len(gains)) - 1])
        return Motion(t - t[0], q, v, a, torque, SOFT * float(np.abs(v).max()), gain)

    def with_law(self, effect: str, joint: int, p: Numbers) -> dict[str, Array]:
        """The table of a machine that has the law at a joint, moved as recorded."""
        columns, m = self.model["columns"], self.motion(joint)
        if effect in SENSORS:
            measured = self.positions.copy()
            flat = measured.reshape(len(measured), -1)
            flat[:, joint - 1] = SENSORS[effect](flat[:, joint - 1], p)
            return {**self.table, columns["position"]: measured}
        torques = self.torques.reshape(len(m.q), -1).copy()
        if effect in ACTUATORS:
            torques[:, joint - 1] = ACTUATORS[effect](m, p)
        else:
            torques[:, joint - 1] += FORCES[effect](m, p)
        u = torques @ np.linalg.inv(self._actuator()).T
        before = np.asarray(self.table[columns["command"]], float)
        changed = {**self.table, columns["command"]: u.reshape(before.shape)}
        cut = int(p.get("rows", 0))
        return {k: v[: len(m.q) - cut] for k, v in changed.items() if np.size(v) >= len(m.q)}
