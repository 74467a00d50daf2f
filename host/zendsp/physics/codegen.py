"""From model to C: what the ISR needs to use a model, with every number as a variable that can be
tuned live.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from zendsp.physics.codegen_terms import (
    Line,
    Variable,
    compensable,
    declare,
    lines,
    why_not,
)
from zendsp.physics.model import Actuator, Model, Term
from zendsp.physics.term_numbers import kernel_model

# rad/s or m/s: measured speed is never exactly zero, a hard sign would chatter about it
SIGN_SPEED = 0.02


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
        Initial value of ``comp_sign_speed``, rad/s: dry friction is compensated by tanh(qd /
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
    made = _compensating(terms, kinds, actuator, model)
    variables = [*_settings(sign_speed), *(v for line in made for v in line.variables)]
    defined, declared = declare(variables)
    notes = [f"   {text}" for text in sentences]
    notes += [
        f"   Not compensated: {t.effect} of joint {t.joint} ({why_not(t.effect)})."
        for t in terms
        if not compensable(t)
    ]
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
        about=_comment(about), defined=defined, declared=declared, sign=sign_function("comp"),
        cases=_cases(made), inverse=_inverse(made),
    )  # fmt: skip


def compensation_values(terms: Sequence[Term], model: Model) -> dict[str, float]:
    """The numbers of a compensation by the names that :func:`compensation` gives them.

    A running program that was built with the same effects takes them by one synchronous update.

    Parameters
    ----------
    terms : sequence of Term
    model : Model
        The whole model that the terms are part of.

    Returns
    -------
    dict of str to float

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
SETTINGS = ("comp_share", "comp_fade", "comp_limit", "comp_sign_speed")


def _settings(sign_speed: float) -> list[Variable]:
    return [
        Variable("comp_share", 1.0, "", "part of the compensation that is added", 0.0, 1.0),
        Variable("comp_fade", 0.5, "s", "time in which it fades in or out", 0.0, 60.0),
        Variable("comp_limit", 0.5, "", "most that is added, part of the torque limit", 0.0, 1.0),
        Variable(
            "comp_sign_speed",
            sign_speed,
            "rad/s",
            "speed over which dry friction changes its sign; 0: at once",
        ),
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
{inverse}    const double most = TORQUE_MAX(joint) > 0.0 ? comp_limit * TORQUE_MAX(joint) : INFINITY;
    return fmax(-most, fmin(most, wanted - torque));
}}
"""  # noqa: E501


def sign_function(prefix: str) -> str:
    """C function ``{prefix}_sign``: smooth over ``{prefix}_sign_speed``, hard where that is 0."""
    return (
        f"static inline double {prefix}_sign(double x) {{\n    return {prefix}_sign_speed > 0.0 ?"
        f" tanh(x / {prefix}_sign_speed) : (double)((x > 0.0) - (x < 0.0));\n}}"
    )


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
        f"    if (joint == {line.joint})\n        wanted += comp_now * ({line.expression} -"
        f" wanted); /* {line.comment} */\n"
        for line in made
        if line.inverse
    )


def _comment(text: str) -> str:
    """The first lines of a C comment, left open; nothing in them can end it."""
    safe = text.replace("*/", "* /").replace("/*", "/ *").split("\n")
    return "\n".join(["/* " + safe[0], *(f" * {line}".rstrip() for line in safe[1:])])


def model_code(model: Model, *, sign_speed: float = SIGN_SPEED) -> str:
    """A whole model as C functions for the ISR: inverse dynamics, gravity, friction, and every
    effect that a torque can cancel.

    The text defines ``ModelInit()``, to be called in ``UserInit``; ``ModelTorque(q, qd, qdd,
    tau)``, the torque of a motion; ``ModelGravity(q, tau)``; ``ModelEffects(q, qd, qdd, tau,
    extra)``, what friction and the other effects take while ``tau`` acts; and ``MODEL_JOINTS``.
    Every number is a parameter that can be changed while the program runs.

    Parameters
    ----------
    model : Model
    sign_speed : float
        Initial value of ``model_sign_speed``, rad/s: dry friction is level · tanh(qd /
        model_sign_speed); 0 is a hard sign.

    Returns
    -------
    str
        C source to be included after ``isr.h``.

    Raises
    ------
    ModelError
        A model of kind "python".

    Examples
    --------
    >>> from zendsp.physics import parse_model
    >>> bench = parse_model({"name": "bench", "mechanism": {"kind": "rotary", "parameters": {"inertia": 0.01}}})
    >>> "torque[0] = model_inertia1 * acc[0] + 0.0;" in model_code(bench)
    True
    """  # noqa: E501
    from zendsp.physics.codegen_model import rigid_code
    from zendsp.physics.joint import own_terms
    from zendsp.physics.simulate_plant import joint_count, with_bodies

    model = with_bodies(model)
    n = joint_count(model)
    kinds = [model.joint_kind(j + 1) for j in range(n)]
    numbers, rigid, arrays, note = rigid_code(model)
    made = lines(kernel_model(model).terms, "model", kinds=kinds, actuator=model.actuator)
    numbers += [
        Variable(
            "model_sign_speed",
            sign_speed,
            "rad/s",
            "speed over which dry friction changes its sign; 0: at once",
        )
    ]
    numbers += [v for line in made for v in line.variables]
    defined, declared = declare(numbers)
    terms = own_terms(model.terms)  # bodies have entered the rigid body
    left_out = [
        f"   Not in it: {t.effect} of joint {t.joint} ({why_not(t.effect)})."
        for t in terms
        if not compensable(t)
    ]
    about = "\n".join([f"The model {model.name!r} for the ISR: {note}.", *left_out])
    effects = "".join(_extra(line) for line in made if not line.inverse)
    inverse = "".join(
        f"    {{\n        const double wanted = torque[{line.joint}];\n        torque[{line.joint}]"
        f" = {line.expression}; /* {line.comment} */\n    }}\n"
        for line in made
        if line.inverse
    )
    return _MODEL.format(
        about=_comment(about),
        joints=n,
        defined=defined,
        sign=sign_function("model"),
        rigid=rigid,
        declared="\n".join(part for part in (declared, arrays) if part),
        effects=effects,
        inverse=inverse,
    )


_MODEL = """{about}
 *
 *     #include "isr.h"
 *     #include "model.c"
 *     … UserInit:      ModelInit();
 *     … UserISR_INT2:  ModelTorque(q, qd, a, tau);     computed torque for the accelerations a
 */
#include "isr.h"

enum {{ MODEL_JOINTS = {joints} }};

{defined}

{sign}

{rigid}
static inline void ModelInit(void) {{
{declared}
}}

/* Friction and the other effects, N m (N), while `torque` acts. */
static inline void ModelEffects(const double *pos, const double *vel, const double *acc, const double *torque, double *extra) {{
    (void)pos, (void)vel, (void)acc, (void)torque;
    for (int j = 0; j < MODEL_JOINTS; j++)
        extra[j] = 0.0;
{effects}}}

/* Gravity alone, N m (N). */
static inline void ModelGravity(const double *pos, double *torque) {{ model_gravity(pos, pos, pos, torque); }}

/* Inverse dynamics: the command, as torque, that gives the accelerations `acc`. */
static inline void ModelTorque(const double *pos, const double *vel, const double *acc, double *torque) {{
    double extra[MODEL_JOINTS];
    model_rigid(pos, vel, acc, torque);
    ModelEffects(pos, vel, acc, torque, extra);
    for (int j = 0; j < MODEL_JOINTS; j++)
        torque[j] += extra[j];
{inverse}}}
"""  # noqa: E501


def _extra(line: Line) -> str:
    expression = re.sub(r"\btorque\b", f"torque[{line.joint}]", line.expression)
    return f"    extra[{line.joint}] += {expression}; /* {line.comment} */\n"
