"""Physical effects as C for the ISR: one expression of torque for each term, its numbers as
declared variables.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from zendsp.physics.effects import get_effect, unit_of
from zendsp.physics.model import Actuator, Term, per_joint
from zendsp_protocol.texts import shown

# In C the arguments have names of their own: programs have globals q, qd, tau.
_NAMES = {"q": "pos[{}]", "qd": "vel[{}]", "qdd": "acc[{}]", "tau": "torque"}


# rad/s or m/s: measured speed is never exactly zero, a hard sign would chatter about it
SIGN_SPEED = 0.02


@dataclass(frozen=True)
class Variable:
    """A number that becomes a tunable variable of the program."""

    name: str
    value: float
    unit: str
    text: str
    low: float = -math.inf
    high: float = math.inf


def sign_width(prefix: str, value: float, kinds: Sequence[str]) -> Variable:
    """The speed over which dry friction changes its sign, for joints of these kinds."""
    units = ["m/s" if kind == "linear" else "rad/s" for kind in kinds or ["rotary"]]
    return Variable(
        f"{prefix}_sign_speed", value, " or ".join(sorted(set(units), reverse=True)),
        "speed over which dry friction changes its sign; 0: at once",
    )


@dataclass(frozen=True)
class Line:
    """One term in C: ``expression`` of joint ``joint`` (from 0), over pos, vel, acc (arrays) and
    torque; ``inverse`` acts on ``wanted`` at the end.
    """

    joint: int
    expression: str
    inverse: bool
    variables: tuple[Variable, ...]
    comment: str


def why_not(effect: str) -> str:
    """Why an effect has no line in C."""
    return (
        get_effect(effect).why_not
        or "a torque that depends on position, speed and acceleration cannot undo it"
    )


def compensable(term: Term) -> bool:
    """Whether a torque can cancel a term."""
    effect = get_effect(term.effect)
    return bool(effect.inverse or effect.compensable or effect.across)


def number(value: float) -> str:
    """A C literal that gives back the same double.

    Examples
    --------
    >>> number(2.0), number(0.1)
    ('2.0', '0.1')
    """
    text = repr(float(value))
    return text if any(c in text for c in ".en") else text + ".0"


def lines(
    terms: Sequence[Term],
    prefix: str,
    *,
    kinds: Sequence[str] = (),
    actuator: Actuator | None = None,
) -> list[Line]:
    """The terms that a torque can cancel, as C.

    Parameters
    ----------
    terms : sequence of Term
        In kernel form (Stribeck as excess over Coulomb).
    prefix : str
        Of every name that is made.
    kinds : sequence of str
        "rotary" or "linear" for each joint; rotary where absent.
    actuator : Actuator, optional
        Scales widths in command units to torque.

    Returns
    -------
    list of Line
        Those that act on the command come last, in reverse order of the signal path.
    """
    found: list[Line] = []
    seen: dict[str, int] = {}
    for term in terms:
        if compensable(term):
            label = f"{prefix}_{term.effect}{term.joint}"
            seen[label] = seen.get(label, 0) + 1
            found.append(
                _line(
                    term,
                    label if seen[label] == 1 else f"{label}_{seen[label]}",
                    prefix,
                    kinds,
                    actuator or Actuator(),
                )
            )
    return [line for line in found if not line.inverse] + [
        line for line in reversed(found) if line.inverse
    ]


def _line(term: Term, label: str, prefix: str, kinds: Sequence[str], actuator: Actuator) -> Line:
    effect, j = get_effect(term.effect), term.joint - 1
    kind = kinds[j] if j < len(kinds) else "rotary"
    gain = per_joint(actuator.gain, term.joint, 1.0)
    sign = f"{prefix}_sign"
    inverse = bool(effect.inverse)
    if inverse:
        body = re.sub(r"\bgain\b", number(gain), effect.inverse)
    elif effect.across:  # the law is part of the structure, not a number to be tuned
        body = effect.across[int(term.value("law"))].format(
            other=int(term.value("from_joint")) - 1, joint=j
        )
    else:
        body = effect.compensable
        # levels per direction: the size here, the sign once and smooth
        if effect.site == "dry" and "sgn(" not in body:
            body = f"fabs({body}) * sgn(qd)"
        body = re.sub(r"\b(q|qd|qdd|tau)\b", lambda m: _NAMES[m[1]].format(j), body)
    variables: list[Variable] = []
    for k, parameter in enumerate(effect.parameters):
        if f"p[{k}]" not in body:
            continue
        name = f"{label}_{parameter.name}"
        body = body.replace(f"p[{k}]", name)
        unit = unit_of(parameter.size, kind, actuator.command_unit)
        unit = unit.replace("²", "^2").replace("³", "^3")
        value = term.value(parameter.name, parameter.default or 0.0)
        over = f" over {parameter.above.capitalize()}" if parameter.above else ""
        variables.append(
            Variable(
                name,
                value,
                "" if unit == "1" else unit,
                f"{effect.name.replace('_', ' ')} of joint {term.joint}:"
                f" {parameter.name.replace('_', ' ')}{over}",
            )
        )
    comment = f"{effect.name.replace('_', ' ')}: {effect.equation}"
    return Line(j, body.replace("sgn(", f"{sign}("), inverse, tuple(variables), comment)


def _bound(value: float, none: str) -> str:
    return number(value) if math.isfinite(value) else none


def declare(variables: Sequence[Variable]) -> tuple[str, str]:
    """Definitions of the variables, and their PARAMETER lines for UserInit.
    """
    defined = "\n".join(f"static double {v.name};" for v in variables)
    declared = "\n".join(
        f'    PARAMETER({v.name}, {number(v.value)}, "{v.unit}", {_bound(v.low, "NO_MIN")},'
        f' {_bound(v.high, "NO_MAX")}, "{v.text}");'
        for v in variables
    )
    return defined, declared


def sign_function(prefix: str) -> str:
    """C function ``{prefix}_sign``: smooth over ``{prefix}_sign_speed``, hard where that is 0."""
    return (
        f"static inline double {prefix}_sign(double x) {{\n"
        f"    return {prefix}_sign_speed > 0.0 ? tanh(x / {prefix}_sign_speed)"
        " : (double)((x > 0.0) - (x < 0.0));\n}"
    )


def c_comment(text: str) -> str:
    """The first lines of a C comment, left open; nothing in them can end it, and no terminal obeys
    what they hold.
    """
    safe = shown(text).replace("*/", "* /").replace("/*", "/ *").split("\n")
    return "\n".join(["/* " + safe[0], *(f" * {line}".rstrip() for line in safe[1:])])
