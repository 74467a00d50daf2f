"""The machines that references are planned for: their limits and their nominal rigid-body model,
from package data.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import ReferenceError_, did_you_mean
from zendsp.reference.core import Array, Reference
from zendsp.reference.dynamics import Dynamics, make_dynamics
from zendsp.reference.fits import check_fits
from zendsp.reference.limits import Limits, Violation, find_violations, raise_violations
from zendsp_protocol import written
from zendsp_protocol.spelling import unknown_keys
from zendsp_protocol.texts import counted
from zendsp_protocol.views import html_table, sentence

MACHINES = ("imi_planar", "pendulum", "wam7")
OTHERS = (
    "'zendsp reference KIND --target NAME' takes the limits of a running target, --machine"
    " arm.urdf (or .xml) those of a robot's file"
)
LIMITS_ONLY = "limits"  # kind of a machine without a model
UNPREDICTED = "torque is not predicted: of this machine only the limits are known"
JUMPS = "only positions are checked: a step has no speed, and how a loop answers it is not known"
CAREFUL_SPEED = 1.0  # rad/s or m/s, of moves where no limit is known
CAREFUL_ACCELERATION = 10.0  # rad/s^2 or m/s^2


@dataclass(frozen=True, eq=False)
class Machine:
    """Limits, geometry and nominal model of one machine.

    Parameters
    ----------
    name, title : str
        Identifier, and the words for a person.
    kind : str
        "planar2r", "pendulum", "dh" or "tree" (bodies of a URDF): which rigid-body model the
        parameters are for; "limits": there is no model, only the limits are known.
    joints : int
        Number of joints.
    sample_time : float
        Period of its control loop, s.
    home : ndarray, shape (joints,)
        Position after homing, rad (m).
    limits : Limits
        What a reference may ask.
    parameters : mapping
        Numbers of the model, SI units.
    headroom : float
        Share of the speed, acceleration and torque limits that motions planned for it may use.
    unit : str
        Of its positions: "rad", "m", or "rad or m" where both occur.
    joint_units : tuple of str
        Of the position of each joint, where both occur and it is known which has which.

    Examples
    --------
    >>> machine = load_machine("imi_planar")
    >>> machine.joints, float(machine.limits.torque[0])
    (2, 245.0)
    """

    name: str
    title: str
    kind: str
    joints: int
    sample_time: float
    home: Array
    limits: Limits
    parameters: Mapping[str, Any]
    headroom: float = 1.0
    unit: str = "rad"
    joint_units: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Machine {self.name}: {self.title}, {counted(self.joints, 'joint')}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: the limits of each joint."""
        own = self.limits
        rows = [
            (j + 1, f"{a:g} … {b:g}", f"{v:g}", f"{c:g}", f"{f:g}")
            for j, (a, b, v, c, f) in enumerate(
                zip(
                    own.position_min, own.position_max, own.speed, own.acceleration, own.torque,
                    strict=True,
                )
            )
        ]
        at = self.unit.split(" or ")
        speed, acceleration = (" or ".join(u + per for u in at) for per in ("/s", "/s²"))
        torque = " or ".join("N m" if u == "rad" else "N" for u in at)
        units = (f"position [{self.unit}]", f"speed [{speed}]", f"acceleration [{acceleration}]",
                 f"torque [{torque}]")  # fmt: skip
        return sentence(repr(self)[1:-1]) + html_table(("joint", *units), rows)

    @property
    def units(self) -> list[str]:
        """Of its joints' positions; of a machine where both occur and nothing says which joint has
        which, each at least once.

        Examples
        --------
        >>> load_machine("imi_planar").units
        ['rad', 'rad']
        """
        if self.joint_units:
            return list(self.joint_units)
        own = self.unit.split(" or ")
        return [own[min(joint, len(own) - 1)] for joint in range(self.joints)]

    @property
    def allowed(self) -> Limits:
        """Limits that motions are planned within: those of the machine times ``headroom``."""
        return self.limits.scaled(self.headroom)

    @property
    def modelled(self) -> bool:
        """Whether a model says which torque a motion needs.

        Examples
        --------
        >>> load_machine("wam7").modelled
        True
        """
        return self.kind != LIMITS_ONLY

    @property
    def pace(self) -> Limits:
        """Limits that moves of no given duration are planned within: where a speed or acceleration
        is not limited, 1 rad/s or 10 rad/s² (m for slides) are taken.

        Examples
        --------
        >>> unknown = make_limited("arm", 0.001, [0.0], Limits([-1], [1], [6.0], [np.inf], [2.0]))
        >>> float(unknown.pace.speed[0]), float(unknown.pace.acceleration[0])
        (6.0, 10.0)
        """
        own = self.limits
        speed = np.where(np.isfinite(own.speed), own.speed, CAREFUL_SPEED)
        turn = np.where(np.isfinite(own.acceleration), own.acceleration, CAREFUL_ACCELERATION)
        careful = replace(own, speed=speed, acceleration=turn)
        return careful.scaled(self.headroom)

    def with_headroom(self, headroom: float) -> Machine:
        """Return the same machine, for motions that use this share of its limits.

        Examples
        --------
        >>> float(load_machine("imi_planar").with_headroom(0.5).allowed.torque[0])
        122.5
        """
        return replace(self, headroom=headroom)

    @property
    def dynamics(self) -> Dynamics:
        """Inverse and forward dynamics of the nominal model, friction included; ReferenceError_
        where there is no model.
        """
        if not self.modelled:
            raise ReferenceError_(f"{self.name}: {UNPREDICTED}; plan a position instead")
        return make_dynamics(self.kind, self.parameters)

    def torque(self, reference: Reference) -> Array | None:
        """Torque that the reference needs, N m, shape (N, joints): its own in mode "torque", else
        inverse dynamics; of a machine without a model, and of a step, what the reference feeds
        forward, None where it says nothing.

        Examples
        --------
        >>> import numpy as np
        >>> machine = load_machine("pendulum")
        >>> bool(abs(machine.torque(Reference(np.zeros((5, 1)), 0.001))).max() < 1e-12)
        True
        """
        if reference.mode == "torque" and reference.tau is not None:
            return reference.tau
        if not self.modelled or reference.jumps:
            return reference.tau
        return self.dynamics.inverse(reference.q, reference.qd, reference.qdd)

    def current(self, torque: Array) -> Array | None:
        """The motor's current for a torque in N m, A, of the same shape; None where the machine
        states no torque constant.

        Examples
        --------
        >>> load_machine("pendulum").current(np.array([0.3524]))
        array([2.])
        """
        k_a = self.parameters.get("k_a")
        return None if k_a is None else np.asarray(torque, dtype=np.float64) / float(k_a)

    def find_violations(self, reference: Reference) -> list[Violation]:
        """Limits of this machine that a reference breaks, torque included where it is known; of
        each limit the share ``reference.headroom`` counts.

        Examples
        --------
        >>> import numpy as np
        >>> load_machine("pendulum").find_violations(Reference(np.zeros((5, 1)), 0.001))
        []
        """
        check_fits(reference, self.name, self.units)
        share = reference.headroom
        found = find_violations(reference, self.limits.scaled(share), self.torque(reference))
        return [replace(one, headroom=share, unit=self._unit_of(one)) for one in found]

    def _unit_of(self, found: Violation) -> str:
        """Of its joint, where that is known."""
        if not self.joint_units:
            return found.unit
        unit = self.joint_units[found.joint - 1]
        torque = "N m" if unit == "rad" else "N"
        return torque if found.quantity == "torque" else unit + PER[found.quantity]

    def check(self, reference: Reference) -> None:
        """Raise ReferenceError_ naming limit, value, time and joint unless this machine may play
        the reference.

        Examples
        --------
        >>> import numpy as np
        >>> load_machine("pendulum").check(Reference(np.zeros((5, 1)), 0.001))
        """
        raise_violations(self.find_violations(reference), self.name, reference.kind)


def make_limited(
    name: str,
    sample_time: float,
    home: npt.ArrayLike,
    limits: Limits,
    unit: str = "rad",
    joint_units: Sequence[str] = (),
) -> Machine:
    """A machine of which only the limits are known, as a target tells them; no torque is predicted.

    Parameters
    ----------
    name : str
        Goes into the references that are planned for it.
    sample_time : float
        s.
    home : array_like, shape (joints,)
        rad (m for slides).
    limits : Limits
        +inf where there is none or it is not known.
    unit : str
        Of its positions.
    joint_units : sequence of str
        Of the position of each joint, where both rad and m occur.

    Returns
    -------
    Machine
        Of kind "limits".

    Examples
    --------
    >>> arm = make_limited("arm", 0.001, [0.0], Limits([-1.0], [1.0], [2.0], [np.inf], [5.0]))
    >>> arm.modelled, arm.torque(Reference(np.zeros(5), 0.001)) is None
    (False, True)
    """
    at = np.array(home, dtype=np.float64)
    title = f"{name}, of which only the limits are known"
    return Machine(
        name, title, LIMITS_ONLY, len(at), sample_time, at, limits, {}, unit=unit,
        joint_units=tuple(joint_units),
    )


_KEYS = ("name", "title", "kind", "joints", "sample_time", "home", "unit", "limits", "parameters")
_UNITS = ("rad", "m", "rad or m")
PER = {"position": "", "speed": "/s", "acceleration": "/s^2"}  # of a quantity's unit
_LIMITS = ("position_min", "position_max", "speed", "acceleration", "torque")
_WHOLE = ("name", "kind", "joints", "sample_time", "home")  # none does without; and [limits]
_LINK = ("a", "alpha_deg", "d", "mass", "com", "inertia")
_PARAMETERS = {
    "planar2r": ("p1", "p2", "p3", "l1", "l2", "viscous", "coulomb", "current_loop"),
    "pendulum": ("theta1", "theta2", "theta3", "beta", "viscous", "k_a", "R_a", "supply"),
    "dh": ("gravity", "coulomb", "viscous", "current_loop", "link"),
}


def _refuse_unknown(data: Mapping[str, Any], origin: str) -> None:
    parameters = data.get("parameters", {})
    kind = data["kind"]
    if kind not in (*_PARAMETERS, LIMITS_ONLY):
        known = did_you_mean(str(kind), (*_PARAMETERS, LIMITS_ONLY))
        raise ReferenceError_(f"{origin}: kind {kind!r}; {known}")
    keys = [key for key in _KEYS if (key == "unit") <= (kind == LIMITS_ONLY)
            and (key == "parameters") <= (kind in _PARAMETERS)]
    unit = data.get("unit", "rad")
    if unit not in _UNITS:
        raise ReferenceError_(f"{origin}: unit {unit!r}; {did_you_mean(str(unit), _UNITS)}")
    tables = [(data, keys, "the file"), (data.get("limits", {}), _LIMITS, "[limits]")]
    if kind in _PARAMETERS:
        tables.append((parameters, _PARAMETERS[kind], f"[parameters] of kind {kind!r}"))
        tables += [(link, _LINK, "[[parameters.link]]") for link in parameters.get("link", [])]
    said = [
        line
        for table, allowed, where in tables
        if (line := unknown_keys(table, allowed, f"{origin}: {where}"))
    ]
    if said:
        raise ReferenceError_("\n".join(said))


EXAMPLE = """\
name = "my_arm"
kind = "limits"
unit = "rad"                   # of positions; "m" where joints slide
joints = 2
sample_time = 0.001            # s
home = [0.0, 0.0]
[limits]                       # inf where there is none
position_min = [-1.5, -1.5]    # rad
position_max = [1.5, 1.5]
speed = [2.0, 2.0]             # rad/s
acceleration = [10.0, 10.0]    # rad/s^2
torque = [50.0, 20.0]          # N m"""


def _refuse_incomplete(data: Mapping[str, Any], origin: str) -> None:
    """Refuse a description with all that it lacks, and a whole one beside it."""
    if "mechanism" in data:
        raise ReferenceError_(
            f"{origin} is the model of a diagnosis, which states no limits: {OTHERS}"
        )
    limits = data.get("limits", {})
    lacks = [key for key in _WHOLE if key not in data]
    lacks += [f"[limits] {key}" for key in _LIMITS if key not in limits]
    if lacks:
        raise ReferenceError_(
            f"{origin} lacks {', '.join(lacks)}. Of a machine without a model all of it is:\n"
            f"{EXAMPLE}\nOr {OTHERS}"
        )


def _parse(data: Mapping[str, Any], origin: str) -> Machine:
    try:
        _refuse_incomplete(data, origin)
        _refuse_unknown(data, origin)
        return Machine(
            name=data["name"],
            title=data.get("title", data["name"]),
            kind=data["kind"],
            joints=data["joints"],
            sample_time=data["sample_time"],
            home=np.array(data["home"], dtype=np.float64),
            limits=Limits(**data["limits"]),
            parameters={} if data["kind"] == LIMITS_ONLY else data["parameters"],
            unit=data.get("unit", "rad"),
        )
    except (KeyError, TypeError) as error:
        raise ReferenceError_(
            f"{origin}: machine description lacks or misnames {error}; compare with a shipped one"
        ) from error


@cache
def load_machine(name: str) -> Machine:
    """One of the shipped machines by name, or any other from a TOML file of the same form.

    Parameters
    ----------
    name : str
        "imi_planar", "pendulum", "wam7", or the path of a ``.toml`` file.

    Returns
    -------
    Machine
        Limits and nominal model.

    Raises
    ------
    ReferenceError_
        No such machine or file, or a key is missing.

    Examples
    --------
    >>> load_machine("wam7").joints
    7
    """
    if name in MACHINES:
        text = resources.files("zendsp.reference").joinpath("machines", f"{name}.toml").read_text()
        return _parse(written.toml(text), name)
    path = Path(name)
    if path.suffix != ".toml" or not path.is_file():
        raise ReferenceError_(
            f'no machine "{name}": expected {", ".join(MACHINES)} or the path of a .toml'
            f" description. For any other: {OTHERS}, and the terminal plans for the target that it"
            " shows (zendsp tui, F4)"
        )
    try:
        return _parse(written.toml(path.read_text()), str(path))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ReferenceError_(f"{path}: not TOML: {error}") from error
