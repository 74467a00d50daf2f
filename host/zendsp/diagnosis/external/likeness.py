"""What the torque of a number of a simulator is like: its coefficients at a joint, and the effects
of the library that do the same.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.external.asked import State
from zendsp.physics.robots.rigid import Basis

Array = npt.NDArray[np.float64]

# cosine of the torques of a number and of an effect: a viscosity's was 0.9995 in the impacts of a
# backlash, beside which it had gone to 0, and a viscous friction was claimed in its place
SAME_SHAPE = 0.999


def basis_of(
    qdd: Array,
    mass: Array,
    torque: Array,
    changes: Mapping[str, tuple[Array, Array]],
    values: Mapping[str, float],
) -> dict[str, Basis]:
    """The coefficients of one joint: what is left of inertia and torque where all free numbers are
    0, and how they change with each.
    """
    inertia, bias, out = mass.copy(), torque - mass * qdd, {}
    for key, (dm, dt) in changes.items():
        rest = dt - dm * qdd
        inertia -= values[key] * dm
        bias -= values[key] * rest
        out[key] = Basis(np.ascontiguousarray(dm), np.ascontiguousarray(rest))
    return {"fixed": Basis(inertia, bias), **out}


def alike_to(motion: State, j: int, mass: Array, torque: Array) -> list[str]:
    """The effects that have the torque (n,) of a number at a joint (from 0), by their names."""
    qdd = motion.qdd[:, j]
    # not of position: a spring and gravity are alike in small motions, and can be told apart
    name, shape = ("inertia", qdd) if np.any(mass) else ("torque_offset", np.ones_like(qdd))
    return [name] if same_shape(shape, torque) else []


def same_shape(one: Array, other: Array) -> bool:
    """Whether two series are alike but for a factor."""
    size = float(np.linalg.norm(one)) * float(np.linalg.norm(other))
    return abs(float(one @ other)) > SAME_SHAPE * size
