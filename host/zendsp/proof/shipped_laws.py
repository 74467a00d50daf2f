"""What the machines that ship with zendsp as C can conceal, and at which sizes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from zendsp.proof.draft import Array, Scale
from zendsp.proof.truth import Effect

Rng = np.random.Generator
# first members of every simulated machine (plant.h): the truth that only the proof reads
TRUTH = "typedef struct { int joints; double substep, t, q[8], qd[8], z[8]; } truth;"
TORQUE = 1  # mode of the drives
PERIOD = 1e-3  # s


@dataclass
class Rig:
    """A machine as its model describes it, its controller, and what is concealed."""

    name: str  # of the machine's C file
    kind: str  # of [mechanism]
    figures: dict[str, float]
    lengths: dict[str, float]
    viscous: tuple[float, ...]  # N m s/rad, of the machine's plain friction
    coulomb: tuple[float, ...]  # N m
    limit: tuple[float, ...]  # N m
    counts: float  # a turn
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    cutoff: float  # Hz, of the controller's speed
    amplitude: tuple[float, ...]  # rad
    speed: tuple[float, ...]  # rad/s
    also_true: tuple[str, ...] = ()
    loop: float = 0.0  # s, current loop of the drives: the given model knows of it as delay
    ideal: bool = False  # without noise, steps and current loop of the drives
    seconds: float = 20.0
    lines: list[str] = field(default_factory=list)  # of what is concealed, in the machine's words
    hidden: set[tuple[str, int]] = field(default_factory=set)  # friction that the given model lacks
    fixed: bool = False
    faults: list[str] = field(default_factory=list)
    truths: list[Effect] = field(default_factory=list)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.kp)

    @property
    def resolution(self) -> float:
        """Of the encoders, rad."""
        return 2 * np.pi / self.counts

    def inertia(self, joint: int) -> float:
        """What a motor feels of its joint, kg m²."""
        # the first figure of each model is its first joint's
        return list(self.figures.values())[joint]


def planar() -> Rig:
    """Two links in a plane."""
    return Rig(
        "imi_planar", "planar2r", {"p1": 3.473, "p2": 0.196, "p3": 0.242}, {"l1": 0.36, "l2": 0.34},
        (5.3, 1.1), (8.45, 2.35), (245.0, 39.2), 153600.0, (2000.0, 300.0), (120.0, 12.0), 80.0,
        (0.9, 0.9), (1.8, 2.4), loop=1.6e-4,
    )  # fmt: skip


def pendulum() -> Rig:
    """A bar on a motor whose current loop takes two samples, which its model does not have."""
    return Rig(
        "pendulum",
        "rotary",
        {"inertia": 2.07e-3, "gravity": 0.16677},
        {},
        (0.005,),
        (0.1,),
        (0.8,),
        4096.0,
        (1.2,),
        (0.02,),
        30.0,
        (2.0,),
        (7.0,),
        ("lag", "delay"),
    )


RIGS: dict[str, Callable[[], Rig]] = {"c_planar": planar, "c_pendulum": pendulum}
Values = dict[str, float]
Law = Callable[[Rig, int, Scale, float, Rng], Values]


def _share_of_speed(power: int) -> Law:
    return lambda r, j, s, x, rng: {
        "coefficient": x * s.torque / float(np.sqrt(np.mean(s.v ** (2 * power))))
    }


def _middle(s: Scale) -> float:
    return float(np.mean(s.q))


def _elastic(r: Rig, j: int, s: Scale, x: float, rng: Rng) -> Values:
    load = 0.4 * r.inertia(j)
    stiffness = load * (2 * np.pi * rng.uniform(4.0, 8.0)) ** 2
    return {
        "stiffness": stiffness,
        "damping": 0.06 * float(np.sqrt(stiffness * load)),
        "load_inertia": load,
    }


def _gap(r: Rig, j: int, s: Scale, x: float, rng: Rng) -> Values:
    load = 0.4 * r.inertia(j)
    return {
        "gap": 0.1 * x * s.reach,
        "stiffness": load * (2 * np.pi * 25.0) ** 2,
        "load_inertia": load,
    }


# parameters in the machine's order, by effect; sizes are shares of the RMS torque
LAWS: dict[str, Law] = {
    "quadratic_drag": _share_of_speed(2),
    "load_friction": lambda r, j, s, x, rng: {"coefficient": x},
    "position_friction": lambda r, j, s, x, rng: {
        "amplitude": 1.4 * x * s.torque,
        "period": s.reach * rng.uniform(0.3, 0.7),
        "phase": rng.uniform(-3, 3),
    },
    "stribeck": lambda r, j, s, x, rng: {
        "breakaway": r.coulomb[j] + 2 * x * s.torque,
        "velocity": rng.uniform(0.1, 0.3) * s.v_rms,
    },
    "friction_drift": lambda r, j, s, x, rng: {
        "ratio": rng.uniform(0.5, 1.0),
        "time_constant": rng.uniform(3.0, 8.0),
    },
    "stiffness": lambda r, j, s, x, rng: {
        "coefficient": x * s.torque / float(np.std(s.q)),
        "neutral": _middle(s) + rng.uniform(-0.3, 0.3) * s.reach,
    },
    "cubic_stiffness": lambda r, j, s, x, rng: {
        "coefficient": x * s.torque / float(np.sqrt(np.mean((s.q - _middle(s)) ** 6))),
        "neutral": _middle(s),
    },
    "hysteresis": lambda r, j, s, x, rng: {
        "force": 1.4 * x * s.torque,
        "stiffness": 1.4 * x * s.torque / (rng.uniform(0.05, 0.12) * s.reach),
        "exponent": 1.0,
    },
    "ripple": lambda r, j, s, x, rng: {
        "order": float(rng.integers(5, 25)),
        "amplitude": 1.4 * x * s.torque,
        "phase": rng.uniform(-3, 3),
    },
    "inertia": lambda r, j, s, x, rng: {"amount": x * s.torque / float(np.std(s.a))},
    "torque_gain": lambda r, j, s, x, rng: {"ratio": -0.07},
    "torque_offset": lambda r, j, s, x, rng: {
        "level": x * s.torque * float(rng.choice([-1.0, 1.0]))
    },
    "dead_zone": lambda r, j, s, x, rng: {"width": x * s.torque},
    "saturation": lambda r, j, s, x, rng: {
        "level": float(np.quantile(np.abs(s.command), 1 - 0.2 * x))
    },
    "lag": lambda r, j, s, x, rng: {"time_constant": rng.uniform(0.005, 0.012)},
    "delay": lambda r, j, s, x, rng: {"time": float(rng.integers(3, 8)) * PERIOD},
    "elasticity": _elastic,
    "backlash": _gap,
    "disturbance": lambda r, j, s, x, rng: {
        "level": 2 * x * s.torque,
        "begin": rng.uniform(5.0, 10.0),
        "duration": rng.uniform(1.5, 3.0),
    },
}
# a friction term of the machine that the given model is not told of
LEFT_OUT = ("viscous", "coulomb")
EFFECTS = (*LEFT_OUT, *LAWS)
# the pendulum's 24 V give 0.76 N m at rest and less at speed; its given model says 0.8
ALSO_TRUE = {"c_pendulum": ("saturation", "voltage_limit")}
FOREIGN = ("strap", "parametric", "breathing")  # the machine's laws 0, 1, 2
FOREIGN_MECHANISMS = (
    ["dry_friction", "fluid_friction"], ["position_torque", "fluid_friction"],
    ["dry_friction", "disturbance"],
)
ACCEPTED = {
    "torque_offset": ["coulomb_asymmetry"],
    "elasticity": ["stiffening"],
    "saturation": ["voltage_limit"],
    "hysteresis": ["presliding"],
}
FAULTS = ("plain", "jitter", "repeat", "stale", "float32", "filtered", "origin")
FIXING = ("inertia", "torque_gain")  # refitted inertial figures would absorb them


def foreign_shape(law: int, s: Scale) -> Array:
    """The machine's foreign law with amplitude 1 along a motion that begins at t = 0."""
    t = np.arange(s.q.size) * PERIOD
    if law == 0:
        return np.where(s.q > 0, s.v * np.cos(7 * s.q), 0.0)
    if law == 1:
        return np.asarray(np.tanh(3 * s.v**2 * s.q) * np.cos(3 * s.q))
    return np.asarray(np.tanh(s.v / 0.05) * np.sin(2 * s.q) * np.sin(1.7 * t))


def left_by_refit(torque: Array, s: Scale) -> float:
    """What a refit of inertia, friction and gravity leaves of a torque along the motion, as a share
    of the RMS torque.
    """
    columns = np.stack([s.a, s.v, np.sign(s.v), np.sin(s.q)], 1)
    rest = torque - columns @ np.linalg.lstsq(columns, torque, rcond=None)[0]
    return float(np.sqrt(np.mean(rest**2))) / s.torque
