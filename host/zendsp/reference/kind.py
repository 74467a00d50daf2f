"""What a generator of references is: its parameters with units and bounds, from which forms and
options are built.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Array, Reference
from zendsp.reference.machine import Machine
from zendsp_protocol.texts import number_hint

# joints: one number, or one per joint. list: any count of numbers.
ROOM = 0.1  # of a joint's travel: so far a default keeps from either end
CALM = 0.65  # of a joint's largest speed, which a default may reach: below the usual headroom
ParameterType = Literal["float", "int", "bool", "choice", "joints", "list", "path"]


@dataclass(frozen=True)
class Parameter:
    """One input of a generator.

    Parameters
    ----------
    name : str
        Keyword of the generator; ``--name`` on the command line.
    type : str
        "float", "int", "bool", "choice", "joints" (one number, or one per joint), "list" or "path".
    unit : str
        "" where none.
    default : object
        Used where ``by_machine`` has no entry; None: the generator's own.
    description : str
        One line for forms and ``--help``.
    minimum, maximum : float
        Bounds of every number.
    choices : tuple of str
        Of a "choice".
    by_machine : mapping of str to object
        Defaults of particular machines.
    keeps : {"", "goal", "swing"}
        A default that stays within the limits of the machine: a position, or how far a joint swings
        about its home.
    fastest : float
        rad/s: of a swing, its largest frequency.

    Examples
    --------
    >>> Parameter("radius", "float", "m", 0.1, "Radius.", minimum=0.0).describe_bounds()
    '>= 0'
    """

    name: str
    type: ParameterType
    unit: str
    default: Any
    description: str
    minimum: float = -math.inf
    maximum: float = math.inf
    choices: tuple[str, ...] = ()
    by_machine: Mapping[str, Any] = field(default_factory=dict)
    keeps: Literal["", "goal", "swing"] = ""
    fastest: float = 0.0

    def default_for(self, machine: Machine) -> Any:
        """Default on a machine, within its limits; a "joints" default of None is the machine's home
        position.
        """
        value = self.by_machine.get(machine.name, self.default)
        if value is None and self.type == "joints":
            return machine.home.tolist()
        if not self.keeps or machine.name in self.by_machine:
            return value
        each = self._kept(machine)
        if self.type == "float":  # of joint 1, which moves unless another is named
            return each[0]
        return value if all(x == value for x in each) else each

    def _kept(self, machine: Machine) -> list[float]:
        """The default of each joint, smaller where the machine has less room."""
        out, of, value = [], machine.limits, float(self.default)
        rows = zip(machine.home, of.position_min, of.position_max, of.speed, strict=True)
        for home, low, high, speed in rows:
            room = ROOM * (high - low) if math.isfinite(high - low) else 0.0
            if self.keeps == "goal":
                kept = min(max(value, low + room), high - room)
            else:
                most = max(0.0, min(home - low, high - home) - room)
                kept = min(value, most, CALM * speed / self.fastest if self.fastest else math.inf)
            out.append(value if kept == value else float(f"{kept:.3g}"))
        return out

    def describe_bounds(self) -> str:
        """Bounds in words, "" where there are none."""
        if self.choices:
            return " | ".join(self.choices)
        low, high = math.isfinite(self.minimum), math.isfinite(self.maximum)
        if low and high:
            return f"{self.minimum:g} … {self.maximum:g}"
        return f">= {self.minimum:g}" if low else f"<= {self.maximum:g}" if high else ""

    def parse(self, value: Any, machine: Machine) -> Any:
        """Value of the right Python type, from a number, a list or the text of a form.

        Raises
        ------
        ReferenceError_
            Not a number, outside the bounds, no such choice, wrong count of joints.
        """
        if self.type == "bool":
            return _parse_bool(self.name, value)
        if self.type == "path":
            return str(value)
        if self.type == "choice":
            if value not in self.choices:
                raise ReferenceError_(
                    f'{self.name} is "{value}"; expected one of {", ".join(self.choices)}'
                )
            return value
        one = self.type in ("int", "float") or (self.type == "joints" and machine.joints == 1)
        if one and (point := number_hint(str(value))):
            raise ReferenceError_(f'{self.name} is "{value}"{point}')
        numbers = self._numbers(value)
        if self.type == "joints":
            return spread(machine, self.name, numbers)
        if self.type == "list":
            return numbers
        if len(numbers) != 1:
            raise ReferenceError_(f"{self.name} takes one number, got {len(numbers)}")
        if self.type == "int":
            if numbers[0] != int(numbers[0]):
                raise ReferenceError_(f"{self.name} is {numbers[0]:g}; expected a whole number")
            return int(numbers[0])
        return float(numbers[0])

    def _numbers(self, value: Any) -> Array:
        try:
            items = value.replace(",", " ").split() if isinstance(value, str) else np.ravel(value)
            numbers = np.array([float(item) for item in items])
        except (TypeError, ValueError) as error:
            raise ReferenceError_(
                f'{self.name} is "{value}"; expected a number or a list like 0.1,0.2'
            ) from error
        unit = f" {self.unit}" if self.unit else ""
        for number in numbers:
            if not (math.isfinite(number) and self.minimum <= number <= self.maximum):
                raise ReferenceError_(
                    f"{self.name} is {number:g}{unit}; expected"
                    f" {self.describe_bounds() or 'a finite number'}"
                )
        if len(numbers) == 0:
            raise ReferenceError_(f"{self.name} is empty; expected a number")
        return numbers


def _parse_bool(name: str, value: Any) -> bool:
    text = str(value).lower()
    if text in ("true", "yes", "1", "on"):
        return True
    if text in ("false", "no", "0", "off"):
        return False
    raise ReferenceError_(f'{name} is "{value}"; expected yes or no')


@dataclass(frozen=True)
class Kind:
    """One generator of references.

    Parameters
    ----------
    name, title, description : str
        Identifier, heading of the form, one or two sentences.
    parameters : tuple of Parameter
        Everything that ``make`` takes beside the machine and sample_time.
    make : callable
        ``make(machine, *, sample_time, **parameters) -> Reference``.
    machine_kinds : tuple of str
        Kinds of machine it can be planned for; empty for all.
    takes : str
        How long the planning takes; empty where it is at once.

    Examples
    --------
    >>> from zendsp.reference import KINDS
    >>> [p.name for p in KINDS["lspb"].parameters]
    ['start', 'goal', 'duration', 'blend_time', 'hold', 'back']
    """

    name: str
    title: str
    description: str
    parameters: tuple[Parameter, ...]
    make: Callable[..., Reference]
    machine_kinds: tuple[str, ...] = ()
    takes: str = ""

    def fits(self, machine: Machine) -> bool:
        """Whether this kind can be planned for a machine."""
        return not self.machine_kinds or machine.kind in self.machine_kinds


def spread(machine: Machine, name: str, value: Any) -> Array:
    """One number for all joints, or one per joint, as an array of shape (joints,).

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> spread(load_machine("imi_planar"), "start", 0.5).tolist()
    [0.5, 0.5]
    """
    x = np.atleast_1d(np.asarray(value, dtype=np.float64))
    if x.size == 1:
        x = np.repeat(x, machine.joints)
    if x.shape != (machine.joints,):
        raise ReferenceError_(
            f"{name} has {x.size} numbers; {machine.name} has {machine.joints} joint(s): give 1 or"
            f" {machine.joints}"
        )
    return x


def on_joints(machine: Machine, joint: int, x: Array) -> Array:
    """A scalar signal (N,) on one joint (1-based) or on all (0), shape (N, joints).

    Examples
    --------
    >>> import numpy as np
    >>> from zendsp.reference import load_machine
    >>> on_joints(load_machine("imi_planar"), 1, np.ones(1)).tolist()
    [[1.0, 0.0]]
    """
    if not 0 <= joint <= machine.joints:
        raise ReferenceError_(
            f"joint is {joint}; {machine.name} has joints 1 to {machine.joints} (0 moves all of"
            " them)"
        )
    out = np.zeros((len(x), machine.joints))
    out[:, slice(joint - 1, joint) if joint else slice(None)] = x[:, None]
    return out


CALM_S = 2.0  # of a move whose time nobody gave; the shortest takes 0.1 to 0.7 s
# what several kinds ask for
ELBOW = Parameter(
    "elbow", "choice", "", "positive", "Sign of q2.", choices=("positive", "negative")
)
MOVE_TIME = Parameter(
    "duration", "float", "s", None,
    "Time of the move; without: 2 s, or as long as the limits need; 0: the shortest.", 0.0, 3600.0,
)
TIME_LAW = Parameter(
    "law", "choice", "", "quintic", "Time law along the way.", choices=("quintic", "trapezoid")
)
BLEND = Parameter("blend", "float", "", 0.25, "Share of each ramp (trapezoid).", 0.01, 0.5)
