"""The definition of a physical effect, used alike by simulator, screen, fit, report and C code."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from zendsp.errors import ModelError

Array = npt.NDArray[np.float64]
Numbers = Mapping[str, float]
REMEMBERED = 3e7  # bytes of waves of a recording at most

MECHANISMS = (
    "dry_friction", "fluid_friction", "transmission", "position_torque", "inertia", "actuator",
    "measurement", "disturbance",
)


@dataclass(frozen=True)
class Scale:
    """Typical sizes along a recording, SI, from which steps, starts and bounds of parameters
    follow.
    """

    torque: float
    speed: float
    position: float
    inertia: float
    command: float
    seconds: float
    turn: float = 1.0  # rad or m per turn of the ripple search: 1 for rotary joints

    def of(self, size: str) -> float:
        """Typical value of a parameter that measures ``size`` (see ``Parameter.size``)."""
        table = {
            "torque": self.torque,
            "torque/speed": self.torque / self.speed,
            "torque/speed2": self.torque / self.speed**2,
            "torque/position": self.torque / self.position,
            "torque/position3": self.torque / self.position**3,
            "speed": self.speed,
            "position": self.position,
            "time": self.seconds,
            "inertia": self.inertia,
            "command": self.command,
            "order": 1.0 / self.turn,
            "temperature": 10.0,
            "1/temperature": 0.1,
        }
        return table.get(size, 1.0)


@dataclass(frozen=True)
class Facts:
    """Facts of one joint's recording and model, SI, from which an effect's grids, starts and bounds
    follow.

    Attributes
    ----------
    scale : Scale
        Typical sizes.
    centre : float
        Middle of the positions, rad or m; ``scale.position`` is their range.
    fast, fastest : float
        Speeds that 5 % and 1 % of the samples exceed, rad/s or m/s.
    weak, strong, strongest : float
        Command that 95 and 0.1 % of the samples exceed, and the largest, command units.
    sample_time : float
        s.
    slides : bool
        A linear joint, whose positions have no whole turn.
    joint, joints : int
        Number of the joint (1-based), and of joints.
    gain : float
        Torque per unit of command.
    inertia : float
        Mean inertia that the joint's torque accelerates, kg m² or kg.
    friction : float
        Dry friction level of the model; 0: none.
    temperature : float
        At the beginning, °C; nan where no column says.
    replaced : mapping
        Numbers of the term that the effect would replace; empty where there is none.
    links : float
        Mean inertia of an arm's links along the recordings, kg m² or kg, without bodies that an
        effect adds; 0 for a joint alone.
    sensor : float
        Standard deviation of the position sensor, rad or m.
    lines : bool
        Rows are samples of a faster loop, and lines stand for its command between them.
    """

    scale: Scale
    centre: float
    fast: float
    fastest: float
    weak: float
    strong: float
    strongest: float
    sample_time: float
    slides: bool
    joint: int
    joints: int
    gain: float
    inertia: float
    friction: float = 0.0
    temperature: float = float("nan")
    replaced: Numbers = field(default_factory=dict)
    links: float = 0.0
    sensor: float = 0.0
    lines: bool = False


@dataclass(frozen=True)
class Along:
    """A joint's measured motion and what drives it, for an effect's column. Arrays (n,), SI.

    Attributes
    ----------
    q, qd, qdd, t : ndarray
        Smoothed motion, and time.
    torque : ndarray
        What the command asks for.
    sample_time : float
        s.
    inertia : ndarray
        Inertia along the record.
    gravity : float
        The model's torque gravity · sin(q).
    waves : dict
        What ``wave`` has worked out: the recording keeps it.
    spring : tuple of float
        Stiffness, damping and load inertia of a model's transmission; empty where it is rigid.
    swung : callable
        ``swung`` of the kernel, which stands above the effects.
    """

    q: Array
    qd: Array
    qdd: Array
    t: Array
    torque: Array
    sample_time: float
    inertia: Array
    gravity: float
    swung: Callable[[Array, float, float, float], Array]
    waves: dict[float, tuple[Array, Array]] = field(default_factory=dict)
    spring: tuple[float, ...] = ()

    def wave(self, order: float, phase: float) -> tuple[Array, Array]:
        """Sine and cosine of ``order`` times the position and a phase, (n,) each."""
        found = self.waves.get(order)
        if found is None:
            angle = order * self.q
            found = np.sin(angle), np.cos(angle)
            if 2 * self.q.nbytes * len(self.waves) < REMEMBERED:
                self.waves[order] = found
        (sine, cosine), c, s = found, math.cos(phase), math.sin(phase)
        return c * sine + s * cosine, c * cosine - s * sine


Axis = Sequence[float] | Callable[[Facts], Sequence[float]]


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Attributes
    ----------
    name : str
        Key in model and report files.
    size : str
        What the number measures, from which its unit, its scale in a given recording and its step
        follow: a key of ``UNITS``.
    lower, upper : float
        Bounds in SI units.
    default : float or None
        Value where a model file leaves the key out; None: the key is required.
    fitted : bool
        False for numbers that are chosen, not estimated (a joint index).
    meaning : str
        Its symbol in the equation, and further explanation, for docs/effects.md.
    limits : callable or None
        Bounds in a given recording: physics outside them cannot be seen in it. None: ``lower`` and
        ``upper``.
    choices : tuple of str
        Words of a model file for 0, 1, …: a law, not a number.
    sizes : tuple of str
        For a coefficient: what it measures under each choice of the parameter ``law``.
    above : str
        Effect whose size a model file's number includes; the C function takes the excess.
    """

    name: str
    size: str
    lower: float = -float("inf")
    upper: float = float("inf")
    default: float | None = None
    fitted: bool = True
    meaning: str = ""
    limits: Callable[[Facts], tuple[float, float]] | None = None
    choices: tuple[str, ...] = ()
    sizes: tuple[str, ...] = ()
    above: str = ""


UNITS = {
    "torque": "{F}",
    "torque/speed": "{F} s/{q}",
    "torque/speed2": "{F} s²/{q}²",
    "torque/position": "{F}/{q}",
    "torque/position3": "{F}/{q}³",
    "speed": "{q}/s",
    "position": "{q}",
    "time": "s",
    "ratio": "1",
    "angle": "rad",
    "order": "1/{q}",
    "inertia": "{J}",
    "command": "{u}",
    "temperature": "°C",
    "1/temperature": "1/K",
    "joint": "1",
    "number": "1",
    "mass": "kg",
    "length": "m",
    "body_inertia": "kg m²",
}


def unit_of(size: str, kind: str, command_unit: str = "", torque_unit: str = "") -> str:
    """Unit of a parameter for a rotary or a linear joint.

    Parameters
    ----------
    size : str
        Key of ``UNITS``.
    kind : {"rotary", "linear"}
        Kind of the joint.
    command_unit : str
        Unit of the command; torque or force where empty.
    torque_unit : str
        Unit of what moves the joint where it is neither N m nor N: A where a motor's current is
        taken as its torque.

    Returns
    -------
    str
        For example ``"N m s/rad"``.
    """
    linear = kind == "linear"
    mechanical = "N" if linear else "N m"
    force = torque_unit or mechanical
    angle = "m" if linear else "rad"
    inertia = "kg" if linear else "kg m²"
    words = {
        "F": force,
        "q": angle,
        "J": inertia if force == mechanical else f"{force} s²/{angle}",
        "u": command_unit or force,
    }
    text = UNITS[size].format(**words)
    return "1" if text == "1/rad" else text


@dataclass(frozen=True)
class Effect:
    """A hypothesis about physics, with its own states and parameters.

    Attributes
    ----------
    name : str
        Name in model files and reports.
    site : str
        Where it acts. ``torque``: a resisting torque. ``load``: the same, on what the joint moves,
        beyond a spring in its transmission. ``viscous``: the same, also scaled by a
        friction drift. ``dry``: a friction level, per direction. ``scale``: a factor on all
        friction; ``dry_scale``: on dry friction. ``actuator``: a map of the command. ``drive``: a
        map of the actuator's torque that knows the speed. ``sensor``: added to the measured
        position. ``setup``: a state of the kernel itself (springs, gaps, bristles, delays).
        ``body``: bodies or gravity of the whole machine (``physics/robots/bodies.py``), without C.
    mechanism : str
        The mechanism of which it is a law: one of ``MECHANISMS``; empty: a mechanism of its own,
        under its own name.
    c : str
        Body of the C function; ``p`` are the parameters in order, ``s`` the state (see
        kernel/effects.c), ``dir`` the direction for ``dry``.
    over : str
        Variable over which it is best drawn: velocity, position, acceleration, command or time.
    linear : tuple of str
        Parameters in which the torque is linear: screened by one least squares.
    grid : mapping
        For each nonlinear parameter, values to screen: in units of its scale, or a function of the
        recording's facts. Parameters that are not fitted distinguish hypotheses.
    column : callable or None
        Resisting torque along the measured motion, N m or N, where no C function gives it
        (``setup``).
    on_position : bool
        ``column`` is a missing part of the measured position, rad or m, instead.
    retime : callable or None
        For effects on the command's timing: the command that acts in each sample, from the column,
        the sample time and the numbers.
    scan : callable or None
        Start values for the fit of effects that no column can screen, each tried by one simulation.
    apart : str
        Among starts with the same value of this parameter only the likeliest is fitted.
    restart : callable or None
        A second start value, from the first.
    tries : tuple of mapping
        Numbers that a full fit tries too: other starts, or numbers that are chosen while laws
        compete. In the end these are fitted, where the recording tells them.
    hidden : bool
        Has a state, or acts on the timing, and counts as one more parameter.
    essence : tuple of str
        Essential parameters: with one at zero or at a bound the effect vanishes. Where empty: the
        one in which it is linear.
    shape : str
        Parameter held fixed when the essential ones are judged, as it is undefined at size zero.
    least : callable or None
        Sizes below which it may only come from the sampling of a recording.
    possible : callable or None
        Whether these numbers are possible, where their limits depend on each other.
    odds : float
        Penalty (below 0: bonus) in parameters, so that among hypotheses that explain a recording
        alike the commoner goes first.
    common : bool
        Every machine has some of it: it is tried whatever a screen promises, and the evidence for
        its mechanism is enough to name it.
    hides : bool
        A first-order screen hardly shows it, because a joint almost stands or the sensor's zero
        absorbs it: it is tried whatever a screen promises.
    sized : bool
        Reports state its smallest detectable size.
    slow : bool
        A fast observer follows it: it is fitted under a slow one.
    drops : callable or None
        The steepest fall of its friction with the speed, N m s/rad or N s/m.
    rough : bool
        Impacts make the cost rough on a fine scale.
    loosens_inertia : bool
        With it, the command does not accelerate the whole inertia.
    same_as : tuple of str
        Free parameters of the mechanism with the same effect.
    sole : bool
        At most one effect of its family at a joint.
    reads : tuple of str
        Optional columns of a recording without which it cannot be used.
    shown_by : tuple of str
        Optional columns that show it directly. A joint that has one gets it measured or excluded,
        not guessed by the search.
    turns : bool
        Depends on a joint's angle, once a turn; not for joints that slide.
    replaces : tuple of str
        Terms of a given model that this effect contains as a special case.
    instead_of : tuple of str
        Found effects that imitate this one, in whose place and from whose numbers it is tried.
    needs : tuple of str
        Terms without which it has no meaning: names of effects, ``"dry"`` for any dry friction
        level, ``"friction"`` also for viscous.
    aliases : tuple of str
        Effects that can be exactly the same to any recording: no fit tells them apart.
    symmetric : str
        The effect that it becomes where both directions are equal.
    bare : str
        The effect that remains without its essence.
    sums : tuple of str
        Effects that together are this one, by algebra.
    family : str
        Effects of one family explain the same traces; few recordings separate them.
    sentence : str
        Explanation, with parameter names in braces, ``{joint}`` included.
    experiment : str
        The experiment that would confirm it.
    compensable : str
        C expression of the compensating torque for the ISR, empty where it cannot be compensated by
        a torque.
    across : tuple of str
        The same for an effect of another joint's motion, one expression for each ``law``, over
        ``vel`` and ``acc`` of ``{joint}`` and of the ``{other}`` one.
    inverse : str
        C expression of what to send so that the torque ``wanted`` comes out (``gain``: torque per
        unit of command).
    why_not : str
        The reason that no torque can compensate it.
    """

    name: str
    site: str
    parameters: tuple[Parameter, ...]
    c: str
    sentence: str
    experiment: str
    mechanism: str = ""
    equation: str = ""
    over: str = "velocity"
    linear: tuple[str, ...] = ()
    grid: Mapping[str, Axis] = field(default_factory=dict)
    column: Callable[[Along, Numbers], Array] | None = None
    on_position: bool = False
    retime: Callable[[Array, float, Numbers], Array] | None = None
    scan: Callable[[Facts], Sequence[Numbers]] | None = None
    apart: str = ""
    restart: Callable[[Facts, Numbers], Numbers] | None = None
    tries: tuple[Numbers, ...] = ()
    hidden: bool = False
    essence: tuple[str, ...] = ()
    shape: str = ""
    least: Callable[[Facts], Numbers] | None = None
    possible: Callable[[Numbers], bool] | None = None
    odds: float = 0.0
    common: bool = False
    hides: bool = False
    sized: bool = False
    slow: bool = False
    drops: Callable[[Numbers], float] | None = None
    rough: bool = False
    loosens_inertia: bool = False
    same_as: tuple[str, ...] = ()
    sole: bool = False
    reads: tuple[str, ...] = ()
    shown_by: tuple[str, ...] = ()
    turns: bool = False
    replaces: tuple[str, ...] = ()
    instead_of: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    aliases: tuple[str, ...] = ()
    symmetric: str = ""
    bare: str = ""
    sums: tuple[str, ...] = ()
    family: str = ""
    rivals: tuple[str, ...] = ()
    repeatable: bool = False
    compensable: str = ""
    across: tuple[str, ...] = ()
    inverse: str = ""
    why_not: str = ""

    @property
    def constant(self) -> bool:
        """Whether its torque is constant."""
        return self.site == "torque" and "s->" not in self.c

    @property
    def coupled(self) -> bool:
        """Whether it depends on another joint's motion, which a parameter names."""
        return any(p.size == "joint" for p in self.parameters)

    def __post_init__(self) -> None:
        if self.mechanism and self.mechanism not in MECHANISMS:
            expected = " | ".join(MECHANISMS)
            raise ModelError(
                f"effect {self.name!r}: mechanism = {self.mechanism!r}: expected {expected}"
            )

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name; KeyError where there is none."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the C function."""
        return tuple(p.name for p in self.parameters)

    @property
    def at_sensor(self) -> bool:
        """Whether it acts on the reading of the position sensor, not on the joint."""
        return self.site == "sensor" or self.on_position
