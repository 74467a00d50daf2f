"""What a physical effect is: defined once, used by the simulator, the screen, the fit, the report and the generated C."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Numbers = Mapping[str, float]


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Attributes
    ----------
    name : str
        Key in model and report files.
    size : str
        What the number measures, from which its unit, its scale in a given recording and its step follow: ``"torque"``,
        ``"torque/speed"``, ``"torque/speed2"``, ``"torque/position"``, ``"torque/position3"``, ``"speed"``, ``"position"``,
        ``"time"``, ``"ratio"``, ``"angle"``, ``"order"``, ``"inertia"``, ``"command"``, ``"number"``.
    lower, upper : float
        Bounds in SI units; ``upper`` is also limited by the recording's scales.
    default : float or None
        Value where a model file leaves the key out; None: the key is required.
    fitted : bool
        False for numbers that are chosen, not estimated (a joint index).
    """

    name: str
    size: str
    lower: float = -float("inf")
    upper: float = float("inf")
    default: float | None = None
    fitted: bool = True
    meaning: str = ""


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
    "number": "1",
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
        Unit of what moves the joint where it is neither N m nor N: A where a motor's current is taken as its torque.

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
        Where it acts. ``torque``: a resisting torque. ``viscous``: the same, also scaled by a friction drift. ``dry``: a friction
        level, per direction. ``scale``: a factor on all friction. ``actuator``: a map of the command. ``sensor``: a map of the
        measured position. ``setup``: a state of the kernel itself (springs, gaps, bristles, delays).
    c : str
        Body of the C function; ``p`` are the parameters in order, ``s`` the state (see observer.c), ``dir`` the direction for ``dry``.
    linear : tuple of str
        Parameters in which the torque is linear: screened by one least squares.
    grid : mapping
        For each nonlinear parameter, values to screen, in units of its scale.
    starts : tuple of mapping
        Start values for the fit of effects that no torque along the measured motion can screen, in units of the scales.
    replaces : tuple of str
        Terms of a given model that this effect contains as a special case.
    needs : tuple of str
        Terms without which it has no meaning; added with it where the model lacks them.
    family : str
        Effects of one family explain the same traces; few recordings separate them.
    sentence : str
        Explanation, with parameter names in braces, ``{joint}`` included.
    experiment : str
        The experiment that would confirm it.
    cost : float
        Relative prior reluctance, in units of log-likelihood.
    compensable : str
        C expression body of the compensating torque for the ISR, empty where it cannot be compensated by a torque.
    """

    name: str
    site: str
    parameters: tuple[Parameter, ...]
    c: str
    sentence: str
    experiment: str
    equation: str = ""
    linear: tuple[str, ...] = ()
    grid: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    starts: tuple[Numbers, ...] = ()
    replaces: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    family: str = ""
    rivals: tuple[str, ...] = ()
    repeatable: bool = False
    compensable: str = ""

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name; KeyError where there is none."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the C function."""
        return tuple(p.name for p in self.parameters)
