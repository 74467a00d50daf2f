"""What the experiments know of a joint: its limits as the machine states them, and the inertia, the
weight and the friction that a first gentle motion, or a model, gives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.physics.codegen.model_torque import inverse_dynamics
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model
from zendsp_protocol.messages import JointInfo

Array = npt.NDArray[np.float64]
Rigid = Callable[[Array, Array, Array], Array]  # q, qd, qdd (N, joints) to N m (N, joints)

FRICTION = ("dry_friction", "fluid_friction")  # mechanisms of effects that are measured here
REACH = 1.5  # rad or m, of start positions from the middle, at most …
SHARE = 0.7  # … and of the range
TRAVEL = 1.0  # rad or m, of the low-speed motion, at most …
PART = 0.25  # … and of the range
PACE = 0.2  # of the largest speed, the peak of the low-speed motion
RISE = 1.0  # s, to that peak, at least
STIFF = 25.0  # rad/s, of the loop that holds a joint
BRAKED = 0.05  # s, in which a brake takes a joint's speed
USED = 0.8  # of a declared limit, the most that is asked for


@dataclass(frozen=True)
class Load:
    """What a joint moves while the others stand, with standard deviations.

    Attributes
    ----------
    inertia : float
        kg m^2 or kg.
    flat, cos, sin : float
        Its weight, N m or N: the same everywhere, and by the cosine and sine of its position. A
        joint that turns has the latter two, one that slides has the first; both are exact.
    inertia_std, weight_std : float
        Of the inertia, and of the weight along the way; 0: a model's.
    cos_std, sin_std : float
        Of these two alone: beyond the way that was measured, the weight is less sure.
    level_std, slope_std : float
        Of the line of friction, by what inertia and weight may be off together.
    uneven : float
        Half of what friction differs by in the two directions, where it is told from the weight.
    """

    inertia: float
    flat: float = 0.0
    cos: float = 0.0
    sin: float = 0.0
    inertia_std: float = 0.0
    weight_std: float = 0.0
    uneven: float = 0.0
    cos_std: float = 0.0
    sin_std: float = 0.0
    level_std: float = 0.0
    slope_std: float = 0.0

    def weight(self, q: Array) -> Array:
        """Torque that carries the weight at these positions."""
        return np.asarray(self.flat + self.cos * np.cos(q) + self.sin * np.sin(q))

    @property
    def weighs(self) -> bool:
        """Whether it carries any."""
        return bool(self.flat or self.cos or self.sin)

    @property
    def most(self) -> float:
        """The largest weight."""
        return abs(self.flat) + float(np.hypot(self.cos, self.sin))


@dataclass(frozen=True)
class Axis:
    """A joint with all that an experiment chooses its motion by; rad, N m (m, N of a slide), s.

    Attributes
    ----------
    number : int
        1-based.
    unit, force : str
    low, high, speed, torque : float
        As the machine declares them; infinite where it does not.
    count : float
        One count of the encoder.
    load : Load
    level, viscous : float
        Friction about as it is, to choose torques by.
    kp, kd, brake : float
        Gains that hold the joint, and that stop it after a push.
    travel, pace : float
        Way and largest speed of the low-speed motion.
    middle : float
        About which it moves at low speed.
    places : tuple of float
        Lowest and highest start of a torque staircase.
    slow, fast : float
        Rates of the torque of a slow and of a fast staircase, N m/s.
    enough : float
        The friction at which a staircase ends, N m.
    way : tuple of float
        Start and end of a push at constant torque in positive direction.
    speeds : tuple of float
        That those shall reach.
    """

    number: int
    unit: str
    low: float
    high: float
    speed: float
    torque: float
    count: float
    load: Load
    level: float
    viscous: float
    kp: float
    kd: float
    brake: float
    travel: float
    pace: float
    middle: float
    places: tuple[float, float]
    slow: float
    fast: float
    enough: float
    way: tuple[float, float] = (0.0, 0.0)
    speeds: tuple[float, ...] = ()

    @property
    def force(self) -> str:
        """Unit of what moves it."""
        return "N m" if self.unit == "rad" else "N"

    def word(self, direction: int) -> str:
        """Name of a direction: of a joint that turns it is the sense."""
        names = ("ccw", "cw") if self.unit == "rad" else ("pos", "neg")
        return names[direction < 0]


@dataclass(frozen=True)
class Known:
    """A machine as the experiments know it.

    Attributes
    ----------
    machine : str
    axes : mapping of int to Axis
        By the joint's number.
    pose : ndarray
        Where the joints stand that are not measured.
    stands : ndarray, optional
        Where the machine stands now; default: in its pose.
    rigid : callable, optional
        Torque of a motion of all joints, friction aside, by a model.
    program, values : str, dict
        That follows a reference, and its parameters.
    apart : bool
        Whether what the directions differ by is friction's: no joint carries a weight, or a model
        states it.
    """

    machine: str
    axes: Mapping[int, Axis]
    pose: Array
    rigid: Rigid | None = None
    program: str = "joint_pd.c"
    values: Mapping[str, Any] = field(default_factory=dict)
    apart: bool = False
    stands: Array | None = None

    def other(self, joint: int, q: Array, qd: Array, qdd: Array) -> Array:
        """Torque of a joint that is none of friction, for a motion of all joints (N, joints)."""
        if self.rigid is not None:
            return self.rigid(q, qd, qdd)[:, joint - 1]
        load = self.axes[joint].load
        return load.inertia * qdd[:, joint - 1] + load.weight(q[:, joint - 1])

    def gain(self, name: str) -> list[float]:
        """One number of every joint, for an array of a program; 0 where there is no drive."""
        numbers = range(1, len(self.pose) + 1)
        return [float(getattr(self.axes[j], name)) if j in self.axes else 0.0 for j in numbers]

    def weights(self) -> dict[str, list[float]]:
        """What holds the weight of every joint, as parameters of push.c."""
        numbers = range(1, len(self.pose) + 1)
        loads = [self.axes[j].load if j in self.axes else Load(0.0) for j in numbers]
        return {
            "flat": [x.flat for x in loads],
            "cosine": [x.cos for x in loads],
            "sine": [x.sin for x in loads],
        }

    def at(self, joint: int, place: float) -> list[float]:
        """The pose with one joint elsewhere."""
        start: list[float] = self.pose.tolist()
        start[joint - 1] = place
        return start


def bare(model: Model) -> Model:
    """A model without its friction."""
    kept = tuple(t for t in model.terms if get_effect(t.effect).mechanism not in FRICTION)
    return model.with_terms(kept)


def rigid_of(model: Model) -> Rigid:
    """The torque of a motion by a model without its friction."""
    rest = bare(model)
    return lambda q, qd, qdd: inverse_dynamics(rest, q, qd, qdd)


def load_of(rigid: Rigid, pose: Array, joint: int, slides: bool) -> Load:
    """What a joint moves in a pose by a model.

    Examples
    --------
    >>> load = load_of(lambda q, qd, qdd: 2.0 * qdd + np.sin(q), np.zeros(1), 1, False)
    >>> load.inertia, load.flat, load.cos, load.sin
    (2.0, 0.0, 0.0, 1.0)
    """
    q, push = np.tile(pose, (4, 1)), np.zeros((4, len(pose)))
    q[:3, joint - 1] = 0.0, 0.5 * np.pi, np.pi
    push[3, joint - 1] = 1.0
    still = np.zeros_like(q)
    rest = rigid(q, still, still)[:, joint - 1]
    inertia = float(rigid(q[3:], still[3:], push[3:])[0, joint - 1] - rest[3])
    if slides:
        return Load(inertia, flat=round(float(rest[3]), 12) + 0.0)
    flat = 0.5 * (rest[0] + rest[2])
    parts = np.round([flat, rest[0] - flat, rest[1] - flat], 12) + 0.0
    return Load(inertia, *parts.tolist())


def axis_of(
    number: int, info: JointInfo, place: float, load: Load, level: float, viscous: float = 0.0
) -> Axis:
    """A joint with motions within what the machine declares of it.

    Parameters
    ----------
    number : int
        1-based.
    info : JointInfo
        What the machine says of it.
    place : float
        Where it stands, rad or m.
    load : Load
    level, viscous : float
        Friction as it is known, N m and N m s/rad.
    """
    low, high = info.position_min, info.position_max
    room = high - low
    travel = min(TRAVEL, PART * room)
    pace = min(PACE * info.speed_max, travel / RISE)
    middle = float(np.clip(place, low + 0.75 * travel, high - 0.75 * travel))
    centre = 0.5 * (low + high) if np.isfinite(room) and 0.5 * room <= 2 * REACH else middle
    reach = min(REACH, 0.5 * SHARE * room)
    inertia = load.inertia
    most = USED * info.torque_max
    return Axis(
        number, info.unit, low, high, info.speed_max, info.torque_max, 1.0 / info.counts_per_unit,
        load, level, viscous,
        kp=inertia * STIFF**2, kd=2.0 * inertia * STIFF, brake=inertia / BRAKED,
        travel=travel, pace=pace, middle=middle, places=(centre - reach, centre + reach),
        slow=level / 10.0, fast=level / 2.0, enough=min(2.0 * level, max(0.0, most - load.most)),
    )  # fmt: skip
