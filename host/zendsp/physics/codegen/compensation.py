"""Found effects as C for the ISR: the torque to add to a command."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from zendsp.physics.codegen.terms import (
    SIGN_SPEED,
    Line,
    Variable,
    c_comment,
    compensable,
    declare,
    lines,
    sign_function,
    sign_width,
    why_not,
)
from zendsp.physics.model import Actuator, Model, Term
from zendsp.physics.term_numbers import kernel_model


def compensation(
    terms: Sequence[Term],
    *,
    title: str = "",
    sentences: Sequence[str] = (),
    kinds: Sequence[str] = (),
    actuator: Actuator | None = None,
    model: Model | None = None,
    sign_speed: float = SIGN_SPEED,
) -> str:
    """Found effects as a C function that gives the torque to add to a command.

    The text defines ``CompensationInit()``, to be called in ``UserInit``, and ``Compensation(joint,
    q, qd, qdd, tau)``: joint from 0, arrays of all joints in SI units, ``tau`` the torque wanted so
    far; the result is to be added to ``tau``.

    Parameters
    ----------
    terms : sequence of Term
        As in a model file (Stribeck with its breakaway level).
    title : str
        Named in the first line.
    sentences : sequence of str
        One comment line each.
    kinds : sequence of str
        "rotary" or "linear" for each joint; rotary where absent.
    actuator : Actuator, optional
        Needed for effects in command units.
    model : Model, optional
        The whole model that the terms are part of: where ``kinds``, ``actuator`` and ``title`` come
        from if they are not given, and the Coulomb level under a Stribeck term whose Coulomb term
        is not among ``terms``.
    sign_speed : float
        Initial value of ``comp_sign_speed``, rad/s (m/s): dry friction is compensated by tanh(qd /
        comp_sign_speed); 0 is a hard sign.

    Returns
    -------
    str
        C source to be included after ``isr.h``. Valid, and of no effect, where nothing can be
        compensated.

    Examples
    --------
    >>> from zendsp.physics.model import Quantity, Term
    >>> text = compensation([Term("coulomb", 1, {"level": Quantity(0.05)})])
    >>> "comp_now * (comp_coulomb1_level * comp_sign(vel[0]))" in text
    True
    """
    if model is not None:
        title = title or model.name
        kinds = kinds or [model.joint_kind(j + 1) for j in range(model.joints)]
    made = _compensating(terms, kinds, actuator, model)
    variables = [*_settings(sign_speed, kinds), *(v for line in made for v in line.variables)]
    defined, declared = declare(variables)
    notes = [f"   {text}" for text in sentences]
    notes += [
        f"   Not compensated: {t.effect} of joint {t.joint} ({why_not(t.effect)})."
        for t in terms
        if not compensable(t)
    ]
    notes += _of_gain(actuator or (model.actuator if model is not None else None))
    about = "\n".join(
        [
            (
                f"compensation.c: physics found{' in ' + title if title else ''}, as torque to add"
                " to a command."
            ),
            *notes,
        ]
    )
    return _COMPENSATION.format(
        about=c_comment(about), defined=defined, declared=declared, sign=sign_function("comp"),
        cases=_cases(made), inverse=_inverse(made),
    )  # fmt: skip


def _of_gain(actuator: Actuator | None) -> list[str]:
    """Comments for a program whose command is no torque."""
    if actuator is None or all(abs(gain) == 1.0 for gain in actuator.gain):
        return []
    gains = " and ".join(dict.fromkeys(f"{gain:.6g}" for gain in actuator.gain))
    of = actuator.unit or "command unit"
    return [
        "   Torques here are in N m (forces in N). A command is that over the actuator's gain,"
        f" {gains} N m (N) per {of}: divide what is added."
    ]


def compensation_values(terms: Sequence[Term], model: Model) -> dict[str, float]:
    """The numbers of a compensation by the names that `compensation` gives them.

    A running program that was built with the same effects takes them by one synchronous update.

    Parameters
    ----------
    model : Model
        The whole model that the terms are part of.

    Examples
    --------
    >>> from zendsp.physics import parse_model
    >>> bench = parse_model({"name": "bench", "mechanism": {"kind": "rotary",
    ...     "parameters": {"inertia": 0.01}},
    ...     "effect": [{"kind": "coulomb", "joint": 1, "level": 0.05}]})
    >>> compensation_values(bench.terms, bench)
    {'comp_coulomb1_level': 0.05}
    """
    made = _compensating(terms, (), None, model)
    return {v.name: v.value for line in made for v in line.variables}


# Settings of every compensation; all its other parameters are numbers of effects.
SHARE = "comp_share"
SETTINGS = (SHARE, "comp_fade", "comp_limit", "comp_sign_speed")


def compensates(variables: Iterable[str]) -> bool:
    """Whether a program with these variables has a compensation with a torque in it."""
    names = set(variables)
    return SHARE in names and any(n.startswith("comp_") for n in names.difference(SETTINGS))


def _settings(sign_speed: float, kinds: Sequence[str]) -> list[Variable]:
    return [
        Variable(SHARE, 1.0, "", "part of the compensation that is added", 0.0, 1.0),
        Variable("comp_fade", 0.5, "s", "time in which it fades in or out", 0.0, 60.0),
        Variable("comp_limit", 0.5, "", "most that is added, part of the torque limit", 0.0, 1.0),
        sign_width("comp", sign_speed, kinds),
    ]


def _compensating(
    terms: Sequence[Term],
    kinds: Sequence[str],
    actuator: Actuator | None,
    model: Model | None,
) -> list[Line]:
    whole = model or Model("found", None, "rotary", {}, terms=tuple(terms))
    if model is not None:
        kinds = kinds or [model.joint_kind(j + 1) for j in range(model.joints)]
        actuator = actuator or model.actuator
    others = tuple(t for t in whole.terms if not any(t is chosen for chosen in terms))
    return lines(
        kernel_model(whole.with_terms((*terms, *others))).terms[: len(terms)],
        "comp",
        kinds=kinds,
        actuator=actuator,
    )


_COMPENSATION = """{about}
 *
 *     #include "isr.h"
 *     #include "compensation.c"
 *     … UserInit:      CompensationInit();
 *     … UserISR_INT2:  tau[j] += Compensation(j, q, qd, qdd, tau[j]);
 */
#include "isr.h"

{defined}

static double comp_now;    /* share that acts: follows comp_share within comp_fade seconds */
static uint64_t comp_tick; /* sample in which it was last moved */

{sign}

static inline void CompensationInit(void) {{
{declared}
}}

/* Once a sample: the share moves towards comp_share. In a program's first sample it is there. */
static inline void comp_step(void) {{
    if (FIRST_SAMPLE)
        comp_now = comp_share;
    if (comp_tick != SAMPLE_TICK) {{
        const double most = comp_fade > 0.0 ? SAMPLE_PERIOD / comp_fade : 1.0;
        comp_now += fmax(-most, fmin(most, comp_share - comp_now));
        comp_tick = SAMPLE_TICK;
    }}
}}

/* Torque to add to the command `torque` of a joint (from 0); position, speed and acceleration of all joints, SI units. */
static inline double Compensation(int32_t joint, const double *pos, const double *vel, const double *acc, double torque) {{
    double wanted = torque;
    (void)pos, (void)vel, (void)acc;
    comp_step();
    switch (joint) {{
{cases}    default:
        break;
    }}
{inverse}    const double most = comp_limit * TORQUE_MAX(joint); /* 0 without a motor */
    return fmax(-most, fmin(most, wanted - torque));
}}
"""  # noqa: E501


def _cases(made: Sequence[Line]) -> str:
    out = ""
    for joint in sorted({line.joint for line in made if not line.inverse}):
        out += f"    case {joint}:\n"
        for line in made:
            if line.joint == joint and not line.inverse:
                out += f"        wanted += comp_now * ({line.expression}); /* {line.comment} */\n"
        out += "        break;\n"
    return out


def _inverse(made: Sequence[Line]) -> str:
    return "".join(
        f"    if (joint == {line.joint})\n"
        f"        wanted += comp_now * ({line.expression} - wanted); /* {line.comment} */\n"
        for line in made
        if line.inverse
    )
