"""A simulated machine in this process: its shared object opened through cffi, stepped as the
runtime steps it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cffi
import numpy as np

from zendsp_isr.build import source_root
from zendsp_isr.parts import build_machine

# The first members of `plant` (plant.h), which is the first member of every simulated machine.
TRUTH = (
    "typedef struct { int joints; double substep, t, q[8], qd[8], z[8], integral[8], command[8];"
    " int mode; double current[8]; } truth;"
)
OFF, TORQUE, VELOCITY = 0, 1, 2
MODELS = Path(__file__).parent / "models"  # MuJoCo's


def declarations() -> str:
    """machine.h without what only a preprocessor reads."""
    text = (source_root() / "include" / "machine.h").read_text()
    return (
        re.sub(r"^#.*$", "", text, flags=re.MULTILINE)
        + "extern machine_ops zendsp_machine;"
        + TRUTH
    )


class Plant:
    """One open machine."""

    def __init__(self, name: str, config: str = "", period: float = 0.001) -> None:
        self.ffi = cffi.FFI()
        self.ffi.cdef(declarations())
        self.library: Any = self.ffi.dlopen(str(build_machine(name)))
        self.ops = self.library.zendsp_machine
        self.period = period
        self.info = self.ffi.new("machine_info *")
        handle, error = self.ffi.new("void **"), self.ffi.new("char[256]")
        if self.ops.open(handle, config.encode(), period, self.info, error, 256) != 0:
            raise ValueError(self.ffi.string(error).decode())
        self.handle = handle[0]
        self.joints = int(self.info.joints)
        self.truth = self.ffi.cast("truth *", self.handle)
        self.sensors = self.ffi.new("machine_sensors *")
        self.actuators = self.ffi.new("machine_actuators *")
        self.scale = np.array([self.info.joint[j].mv_per_torque for j in range(self.joints)])
        self.counts = np.array([self.info.joint[j].counts_per_unit for j in range(self.joints)])

    def __enter__(self) -> Plant:
        return self

    def __exit__(self, *_: object) -> None:
        self.ops.close(self.handle)

    @property
    def q(self) -> np.ndarray:  # type: ignore[type-arg]
        """True positions, rad."""
        return np.array(self.ffi.unpack(self.truth.q, self.joints))

    @property
    def qd(self) -> np.ndarray:  # type: ignore[type-arg]
        """True velocities, rad/s."""
        return np.array(self.ffi.unpack(self.truth.qd, self.joints))

    def truth_current(self, joint: int) -> float:
        """Torque that the drive of a joint gives, N m."""
        return float(self.truth.current[joint])

    def sample(self, aout: Any, mode: int = TORQUE) -> np.ndarray:  # type: ignore[type-arg]
        """One sample: outputs in mV, conversion, time passes; the encoder positions, rad."""
        self.actuators.mode = mode
        self.actuators.aout[0 : self.joints] = np.asarray(aout, float).tolist()
        self.ops.write(self.handle, self.actuators)
        self.ops.read(self.handle, self.sensors)
        self.ops.step(self.handle, self.period)
        return np.array(self.ffi.unpack(self.sensors.enc, self.joints)) / self.counts

    def torque(self, tau: Any) -> np.ndarray:  # type: ignore[type-arg]
        """One sample with a torque command, N m."""
        return self.sample(np.asarray(tau, dtype=float) * self.scale)


def robot(model: Path, *lines: str, ideal: bool = True, clock: str = "fast") -> Plant:
    """The machine of a model, opened as the runner opens it."""
    config = [f"model = {model}", f"clock = {clock}", *(["ideal = 1"] if ideal else []), *lines]
    return Plant(str(model), "\n".join(config) + "\n")


def edited(tmp_path: Path, model: Path, *changes: tuple[str, str]) -> Path:
    """A model with words replaced."""
    text = model.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / model.name
    path.write_text(text)
    return path


def follow(plant: Plant, q_ref: Callable[[float], Any], kp: Any, kd: Any, seconds: float,
    feed: Callable[[np.ndarray], Any] | None = None) -> Any:  # type: ignore[type-arg]
    """PD on the true state (a test of the machine, not of quantisation); rows of t, q, qd, tau."""
    rows = []
    h = 1e-5
    for k in range(round(seconds / plant.period)):
        t = k * plant.period
        r = np.asarray(q_ref(t))
        rd = (np.asarray(q_ref(t + h)) - np.asarray(q_ref(t - h))) / (2 * h)
        q, qd = plant.q, plant.qd
        tau = (
            np.asarray(kp) * (r - q)
            + np.asarray(kd) * (rd - qd)
            + (0.0 if feed is None else feed(q))
        )
        rows.append(np.concatenate([[t], q, qd, np.broadcast_to(tau, (plant.joints,))]))
        plant.torque(tau)
    return np.array(rows)
