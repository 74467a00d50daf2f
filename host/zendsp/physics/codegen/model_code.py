"""A whole model as C for the ISR."""

from __future__ import annotations

import re

from zendsp.physics.calibration.joint import own_terms
from zendsp.physics.codegen.rigid import rigid_code
from zendsp.physics.codegen.terms import (
    SIGN_SPEED,
    Line,
    c_comment,
    compensable,
    declare,
    lines,
    sign_function,
    sign_width,
    why_not,
)
from zendsp.physics.model import Model
from zendsp.physics.simulation.plant import joint_count, with_bodies
from zendsp.physics.term_numbers import kernel_model


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
        Initial value of ``model_sign_speed``, rad/s (m/s): dry friction is level · tanh(qd /
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
    model = with_bodies(model)
    n = joint_count(model)
    kinds = [model.joint_kind(j + 1) for j in range(n)]
    numbers, rigid, arrays, note = rigid_code(model)
    made = lines(kernel_model(model).terms, "model", kinds=kinds, actuator=model.actuator)
    numbers.append(sign_width("model", sign_speed, kinds))
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
        f"    {{\n"
        f"        const double wanted = torque[{line.joint}];\n"
        f"        torque[{line.joint}] = {line.expression}; /* {line.comment} */\n"
        "    }\n"
        for line in made
        if line.inverse
    )
    return _MODEL.format(
        about=c_comment(about),
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
