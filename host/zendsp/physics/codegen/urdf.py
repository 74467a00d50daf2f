"""URDF text of a serial arm given by standard Denavit-Hartenberg frames."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any


def dh_urdf(
    name: str, links: Sequence[Mapping[str, Any]], limits: Mapping[str, Sequence[float]]
) -> str:
    """A URDF whose joints turn about the same axes as the frames of a Denavit-Hartenberg table
    (distal convention).

    Joint k turns about z of frame k - 1; the constant part Trans(0, 0, d) Trans(a, 0, 0) Rot(x,
    alpha) of link k - 1 places it.

    Parameters
    ----------
    name : str
        Of the robot.
    links : sequence of mapping
        a, d (m), alpha_deg, mass (kg), com (m, in frame k), inertia (kg m^2 about the centre of
        mass: xx yy zz xy xz yz).
    limits : mapping
        position_min, position_max (rad), torque (N m), speed (rad/s): one number a joint.

    Examples
    --------
    >>> bar = dict(a=0.0, alpha_deg=0.0, d=0.1, mass=1.0, com=[0, 0, 0], inertia=[1, 1, 1, 0, 0, 0])
    >>> text = dh_urdf("bar", [bar], dict(position_min=[-1], position_max=[1], torque=[1], speed=[1]))
    >>> text.count("<joint ")
    1
    """  # noqa: E501
    out = ['<?xml version="1.0"?>', f'<robot name="{name}">', '  <link name="base"/>']
    place, parent = (0.0, 0.0, 0.0), "base"
    for k, link in enumerate(links, start=1):
        a, d, alpha = float(link["a"]), float(link["d"]), math.radians(float(link["alpha_deg"]))
        c, s = round(math.cos(alpha), 15), round(math.sin(alpha), 15)
        x, y, z = (float(v) for v in link["com"])
        com = (x + a, c * y - s * z, s * y + c * z + d)
        names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        inertia = " ".join(
            f'{key}="{value!r}"' for key, value in zip(names, link["inertia"], strict=True)
        )
        low, high, effort, speed = (
            float(limits[key][k - 1]) for key in ("position_min", "position_max", "torque", "speed")
        )
        out += [
            f'  <link name="link{k}">',
            "    <inertial>",
            f'      <origin xyz="{_words(com)}" rpy="{_words((alpha, 0.0, 0.0))}"/>',
            f'      <mass value="{float(link["mass"])!r}"/>',
            f"      <inertia {inertia}/>",
            "    </inertial>",
            "  </link>",
            f'  <joint name="joint{k}" type="revolute">',
            f'    <parent link="{parent}"/>',
            f'    <child link="link{k}"/>',
            (
                f'    <origin xyz="{_words((place[0], 0.0, place[1]))}"'
                f' rpy="{_words((place[2], 0.0, 0.0))}"/>'
            ),
            '    <axis xyz="0 0 1"/>',
            (
                f'    <limit lower="{low!r}" upper="{high!r}" effort="{effort!r}"'
                f' velocity="{speed!r}"/>'
            ),
            "  </joint>",
        ]
        place, parent = (a, d, alpha), f"link{k}"
    return "\n".join([*out, "</robot>", ""])


def _words(values: Sequence[float]) -> str:
    return " ".join(repr(float(v)) for v in values)
