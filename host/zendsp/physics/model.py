"""The model of a machine as docs/models.md describes it: mechanism, effects, actuator, sensor,
controller, columns.

A parameter that has several joints is a tuple of one number per joint. All SI.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NotRequired, TypedDict
from xml.etree import ElementTree

KINDS = ("rotary", "linear", "planar2r", "urdf", "mjcf", "fmu", "python")
FORCES = ("N", "N m")  # of a joint that slides, and of one that turns
TREES = ("urdf", "mjcf")  # rigid bodies from a file of their own
CALLED = ("python", "fmu")  # simulators that can only be called
REQUIRED = {
    "rotary": ("inertia",),
    "linear": ("mass",),
    "planar2r": ("p1", "p2", "p3"),
    "urdf": (),
    "mjcf": (),
    "fmu": (),
    "python": (),
}
# that a model file may give; None: any, they are the simulator's own
PARAMETERS: dict[str, tuple[str, ...] | None] = {
    "rotary": ("inertia", "gravity"),
    "linear": ("mass", "gravity"),
    "planar2r": ("p1", "p2", "p3", "l1", "l2"),
    "urdf": (),
    "mjcf": (),
    "fmu": None,
    "python": None,
}


def _movable(path: Path) -> int:
    """Number of joints that move in a URDF; 1 where it cannot be read (whoever needs the file says
    so).
    """
    path = path.absolute()  # a notebook may go to another folder, or write the file again
    return _moving_in(path, path.stat().st_mtime_ns) if path.is_file() else 1


@cache
def _moving_in(path: Path, _changed: int) -> int:
    """The same of one state of a file."""
    try:
        root = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError):
        return 1
    moving = [
        j
        for j in root.findall("joint")
        if j.get("type") in ("revolute", "continuous", "prismatic") and j.find("mimic") is None
    ]
    return max(1, len(moving))


@dataclass(frozen=True)
class Quantity:
    """A parameter: its value, whether it may be calibrated, its unit (may be empty)."""

    value: float
    free: bool = True
    unit: str = ""
    std: float = 0.0  # where a fit has found it


@dataclass(frozen=True)
class Term:
    """One physical effect of a model, at one joint (1-based)."""

    effect: str
    joint: int
    parameters: Mapping[str, Quantity]

    def value(self, name: str, default: float = 0.0) -> float:
        """Value of one parameter, ``default`` where the term has none of that name."""
        return self.parameters[name].value if name in self.parameters else default

    def held(self) -> Term:
        """The term with no free parameter."""
        held = {name: replace(q, free=False) for name, q in self.parameters.items()}
        return replace(self, parameters=held)


@dataclass(frozen=True)
class Actuator:
    """Command to torque: gain per joint and its standard deviation where one is stated, limits in
    command units (0: none), hold and delay in s.
    """

    gain: tuple[float, ...] = (1.0,)
    gain_std: tuple[float, ...] = ()
    gain_free: bool = False
    limit: tuple[float, ...] = ()
    hold: float | None = None
    delay: float = 0.0
    matrix: tuple[tuple[float, ...], ...] = ()
    unit: str = ""

    @property
    def gain_known(self) -> float:
        """Relative standard deviation that the model states of its gains, the largest; 0: none."""
        many = self.gain_std * (len(self.gain) if len(self.gain_std) == 1 else 1)
        return max((s / abs(g) for s, g in zip(many, self.gain, strict=False)), default=0.0)

    @property
    def command_unit(self) -> str:
        """Unit of a command in words; empty where it is that of the torque."""
        scaled = any(abs(gain) != 1.0 for gain in self.gain)
        return self.unit or ("command units" if scaled else "")


@dataclass(frozen=True)
class Sensor:
    """Position sensor: joint = matrix @ measured + offset; resolution in rad or m per count of the
    measured column.
    """

    resolution: tuple[float, ...] = ()
    matrix: tuple[tuple[float, ...], ...] = ()
    offset: tuple[float, ...] = ()
    side: str = "motor"


@dataclass(frozen=True)
class Discrepancy:
    """Torque that a diagnosis of the machine left unexplained, N m or N RMS, one number per joint:
    the whole ``torque``, and the part that any function of the joint's ``state`` predicts.
    """

    torque: tuple[float, ...] = ()
    state: tuple[float, ...] = ()


@dataclass(frozen=True)
class Robot:
    """How a URDF or an MJCF is taken over; from a URDF only the bodies are.

    Attributes
    ----------
    joints : tuple of str
        Names of the joints that the recording has, all others are held; empty: every joint.
    take : str
        ``"all"``: bodies, what the joints state, and the actuators; ``"bodies"``: bodies and
        gravity alone, the model file has the rest; ``"servos"``: with them what servos do.
    commands : bool
        The model file says what a command means (``[actuator] gain``), the actuators do not count.
    servos : tuple
        A drive for each joint whose command is the set value of a servo, else None; empty where
        there is none.
    """

    joints: tuple[str, ...] = ()
    take: str = "all"
    commands: bool = False
    servos: tuple[Any, ...] = ()


@dataclass(frozen=True)
class FmuPorts:
    """Names of an FMU's variables by role, one a joint (empty: named like the columns, or not
    stated), and the longest that one simulation may take, s (0: not stated).
    """

    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    start_position: tuple[str, ...] = ()
    start_velocity: tuple[str, ...] = ()
    time_limit: float = 0.0


class ControllerTable(TypedDict, total=False):
    """``[controller]`` of a model file: the loop that made the recordings; a number, or one a
    joint.
    """

    kind: str
    kp: float | list[float]
    kd: float | list[float]
    ki: float | list[float]
    cutoff: float | list[float]  # Hz, of the speed filter


class ParameterTable(TypedDict):
    """A parameter of ``[mechanism.parameters]``."""

    value: float
    free: NotRequired[bool]


class MechanismTable(TypedDict):
    """``[mechanism]`` of a model file."""

    kind: str
    parameters: NotRequired[dict[str, ParameterTable]]
    file: NotRequired[str]


class LimitsTable(TypedDict, total=False):
    """``[limits]`` of a model file: ``position`` is [low, high], or such a pair a joint."""

    position: list[float] | list[list[float]]


@dataclass(frozen=True)
class Model:
    """A model file; docs/models.md describes each key.

    Attributes
    ----------
    name : str
    sample_time : float or None
        s; None where each recording's own counts.
    kind : str
        Of the mechanism: rotary, linear, planar2r, urdf, mjcf, fmu or python.
    mechanism : mapping of str to tuple of Quantity
        Each parameter: a number a joint, or one.
    terms : tuple of Term
        Its effects.
    actuator, sensor, controller, columns, limits, discrepancy, robot, fmu
        The tables of the file.
    file, entry : str
        Of a URDF, MJCF or FMU; of a simulator in Python, ``module:function``.
    joint_kinds : tuple of str
        "rotary" or "linear" a joint; empty where ``kind`` says it.
    folder : Path
        From which ``file`` and ``entry`` are looked for.
    called : object
        Of a simulator that is a rigid body: what answers for it (``diagnosis/external/rigid.py``).
    """

    name: str
    sample_time: float | None
    kind: str
    mechanism: Mapping[str, tuple[Quantity, ...]]
    terms: tuple[Term, ...] = ()
    actuator: Actuator = Actuator()
    sensor: Sensor = Sensor()
    controller: ControllerTable = field(default_factory=ControllerTable)
    columns: Mapping[str, str | list[str]] = field(default_factory=dict)
    file: str = ""
    entry: str = ""
    joint_kinds: tuple[str, ...] = ()
    limits: LimitsTable = field(default_factory=LimitsTable)
    discrepancy: Discrepancy = Discrepancy()
    folder: Path = Path(".")
    robot: Robot = Robot()
    fmu: FmuPorts = FmuPorts()
    called: Any = field(default=None, compare=False, repr=False)

    def __repr__(self) -> str:
        """One line; `zendsp.physics.model_text` writes the whole file."""
        terms = ", ".join(
            f"{t.effect} {t.joint} ("
            + ", ".join(f"{n} {q.value:.4g}" for n, q in t.parameters.items())
            + ")"
            for t in self.terms
        )
        return f"<Model {self.name}: {self.kind}; terms: {terms or 'none'}>"

    @property
    def joints(self) -> int:
        """Number of joints, from the columns, the kind or the parameters."""
        position = self.columns.get("position")
        if self.kind == "planar2r":
            return 2
        if isinstance(position, list):
            return len(position)
        moving = (
            _movable(self.folder / self.file)
            if self.kind == "urdf" and not self.robot.joints
            else max(1, len(self.robot.joints))
        )  # the column may be one 2-D array
        return max(
            [
                moving,
                len(self.joint_kinds),
                len(self.fmu.outputs),
                len(self.sensor.matrix),
                len(self.actuator.matrix),
                len(self.actuator.gain),
                *(len(v) for v in self.mechanism.values()),
                *(t.joint for t in self.terms),
            ]
        )

    @property
    def of_bodies(self) -> bool:
        """Whether bodies couple its joints: an arm's from a file, or those inside a simulator."""
        return self.kind in TREES or self.called is not None

    def joint_kind(self, joint: int) -> str:
        """``"rotary"`` or ``"linear"`` for joint 1, 2, …"""
        if self.joint_kinds:
            return self.joint_kinds[min(joint, len(self.joint_kinds)) - 1]
        return "linear" if self.kind == "linear" else "rotary"

    def position_unit(self, joint: int) -> str:
        """``"rad"``, or ``"m"`` where joint 1, 2, … slides."""
        return "m" if self.joint_kind(joint) == "linear" else "rad"

    def with_terms(self, terms: tuple[Term, ...]) -> Model:
        """The same model with other effects."""
        return replace(self, terms=terms)

    def torque_unit(self, joint: int) -> str:
        """Unit of what moves a joint: N m, N for a linear one, or that of the command where its
        gain is one (A of a motor current).
        """
        own = "N" if self.joint_kind(joint) == "linear" else "N m"
        of_gain_one = self.actuator.unit and abs(per_joint(self.actuator.gain, joint, 1.0)) == 1.0
        # one unit stands for joints that slide and joints that turn
        return self.actuator.unit if of_gain_one and self.actuator.unit not in FORCES else own

    def at(self, joint: int) -> tuple[Term, ...]:
        """Effects of one joint (1-based)."""
        return self._by_joint.get(joint, ())

    @cached_property
    def _by_joint(self) -> dict[int, tuple[Term, ...]]:
        joints = dict.fromkeys(term.joint for term in self.terms)
        return {j: tuple([term for term in self.terms if term.joint == j]) for j in joints}


def position_limits(model: Model, joint: int) -> tuple[float, float]:
    """Lowest and highest position of joint 1, 2, … that ``[limits]`` allows, rad or m: infinite
    where it says nothing.
    """
    pairs = model.limits.get("position") or (-math.inf, math.inf)
    if isinstance(pairs[0], list | tuple):
        pairs = pairs[joint - 1] if joint - 1 < len(pairs) else pairs[0]
    return float(pairs[0]), float(pairs[1])


def per_joint(values: tuple[float, ...], joint: int, default: float) -> float:
    """The number for joint 1, 2, …: one of a tuple, the only one, or the default."""
    if not values:
        return default
    return values[joint - 1] if joint - 1 < len(values) else values[0]
