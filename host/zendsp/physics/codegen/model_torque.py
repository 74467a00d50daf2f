"""The torque of a motion by a model: rigid bodies, and its effects by the C that the ISR gets."""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from typing import Any

import cffi
import numpy as np
import numpy.typing as npt

from zendsp.physics.codegen.terms import Line, lines, sign_function
from zendsp.physics.kernel.native import build
from zendsp.physics.model import Model, per_joint
from zendsp.physics.simulation.native import simulator_library
from zendsp.physics.simulation.plant import aside_of, joint_count, tree_of, with_bodies
from zendsp.physics.term_numbers import kernel_model

Array = npt.NDArray[np.float64]


def inverse_dynamics(
    model: Model,
    q: npt.ArrayLike,
    qd: npt.ArrayLike,
    qdd: npt.ArrayLike,
    *,
    sign_speed: float = 0.0,
) -> Array:
    """Joint torque of a motion: rigid bodies and every effect of the model that is a torque of q,
    qd and qdd, your own effects too.

    Parameters
    ----------
    model : Model
    q, qd, qdd : array_like, shape (N, joints) or (joints,)
        rad or m, and per s, per s^2.
    sign_speed : float
        Dry friction is level · tanh(qd / sign_speed); 0: level · sign(qd).

    Returns
    -------
    ndarray, of the shape of q
        N m or N. Effects of actuator and sensor, and those with states of their own, are not in it;
        nor is load friction.

    Examples
    --------
    >>> from zendsp.physics import parse_model
    >>> bench = parse_model({"mechanism": {"kind": "rotary", "parameters": {"inertia": 0.01}}})
    >>> float(inverse_dynamics(bench, [0.0], [1.0], [2.0])[0])
    0.02
    """
    shape = np.shape(q)
    n = joint_count(model)
    q2, qd2, qdd2 = (
        np.ascontiguousarray(np.asarray(x, dtype=np.float64).reshape(-1, n)) for x in (q, qd, qdd)
    )
    torque = np.ascontiguousarray(_rigid(with_bodies(model), q2, qd2, qdd2))
    _add_effects(model, sign_speed, q2, qd2, qdd2, torque)
    return torque.reshape(shape)


def _add_effects(
    model: Model, sign_speed: float, q: Array, qd: Array, qdd: Array, torque: Array
) -> None:
    """Add what the effects take, by the expressions that the ISR gets."""
    made = [
        line
        for line in lines(kernel_model(model).terms, "model")
        # one that acts on a torque is none of the motion
        if not line.inverse and not re.search(r"\btorque\b", line.expression)
    ]
    if not made:
        return
    ffi, lib = _opened(_source(made))
    numbers = np.array([v.value for line in made for v in line.variables])

    def at(values: Array) -> Any:
        return ffi.cast("double *", ffi.from_buffer(values))

    lib.add_effects(*q.shape, sign_speed, *map(at, (numbers, q, qd, qdd, torque)))


def _source(made: Sequence[Line]) -> str:
    names = [v.name for line in made for v in line.variables]
    defined = "".join(f"#define {name} numbers[{k}]\n" for k, name in enumerate(names))
    added = "".join(f"        torque[{line.joint}] += {line.expression};\n" for line in made)
    return f"#include <math.h>\n{defined}{_SOURCE.format(sign=sign_function('model'), added=added)}"


_CDEF = """void add_effects(int rows, int joints, double sign_speed, const double *numbers,
    const double *q, const double *qd, const double *qdd, double *tau);"""
_SOURCE = """
static _Thread_local double model_sign_speed;
{sign}
void add_effects(int rows, int joints, double sign_speed, const double *numbers,
                 const double *q, const double *qd, const double *qdd, double *tau) {{
    model_sign_speed = sign_speed;
    for (int i = 0; i < rows; i++) {{
        const double *pos = q + i * joints, *vel = qd + i * joints, *acc = qdd + i * joints;
        double *torque = tau + i * joints;
        (void)pos, (void)vel, (void)acc;
{added}    }}
}}
"""


@functools.lru_cache(maxsize=32)
def _opened(source: str) -> tuple[Any, Any]:
    """The compiled expressions; the numbers are arguments, so that a model's next fit finds it."""
    ffi: Any = cffi.FFI()
    ffi.cdef(_CDEF)
    return ffi, ffi.dlopen(str(build(source)))


def _rigid(model: Model, q: Array, qd: Array, qdd: Array) -> Array:
    if model.kind == "planar2r":
        p1, p2, p3 = (model.mechanism[k][0].value for k in ("p1", "p2", "p3"))
        turned = q[:, 1] + aside_of(model)
        c, s = p3 * np.cos(turned), p3 * np.sin(turned)
        first = (
            (p1 + 2 * c) * qdd[:, 0]
            + (p2 + c) * qdd[:, 1]
            - s * qd[:, 1] * (2 * qd[:, 0] + qd[:, 1])
        )
        return np.stack([first, (p2 + c) * qdd[:, 0] + p2 * qdd[:, 1] + s * qd[:, 0] ** 2], axis=1)
    if model.kind in ("rotary", "linear"):
        masses = [x.value for x in model.mechanism["inertia" if model.kind == "rotary" else "mass"]]
        weights = (
            [x.value for x in model.mechanism.get("gravity", ())] if model.kind == "rotary" else []
        )
        out = np.zeros_like(q)
        for j in range(q.shape[1]):
            out[:, j] = per_joint(tuple(masses), j + 1, 0.0) * qdd[:, j] + per_joint(
                tuple(weights), j + 1, 0.0
            ) * np.sin(q[:, j])
        return out
    rows, gravity = tree_of(model)
    native, n = simulator_library(), q.shape[1]
    d, tau, mass = native.doubles, np.empty_like(q), np.empty((n, n))
    for k in range(len(q)):
        native.lib.sim_tree(
            n, d(rows), d(gravity), d(q[k]), d(qd[k]), d(qdd[k]), d(tau[k]), d(mass)
        )
    return tau
