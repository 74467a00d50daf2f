"""The settings of the shipped planar arm: the numbers of its experiments, those of the paper where
it prints them. A target with that machine, and the experiments without a target, use them.
"""

from __future__ import annotations

import numpy as np

from zendsp.experiment.joints import Array, Axis, Known, Load

MACHINE = "imi_planar"
P1, P2, P3 = 3.473, 0.196, 0.242  # kg m^2, of the arm's published model
RESOLUTION = 4.0906154344e-5  # rad, a count of the resolver


def inertia_torque(q: Array, qd: Array, qdd: Array) -> Array:
    """M(q) qdd + C(q, qd) of the published model, N m; arrays (N, 2)."""
    c, s = P3 * np.cos(q[:, 1]), P3 * np.sin(q[:, 1])
    first = (
        (P1 + 2 * c) * qdd[:, 0] + (P2 + c) * qdd[:, 1] - s * qd[:, 1] * (2 * qd[:, 0] + qd[:, 1])
    )
    second = (P2 + c) * qdd[:, 0] + P2 * qdd[:, 1] + s * qd[:, 0] ** 2
    return np.stack([first, second], axis=1)


def _axis(number: int, load: Load, **own: float) -> Axis:
    """A joint with the numbers that both have in common."""
    return Axis(
        number=number, unit="rad", low=-2.15, high=2.15, count=RESOLUTION, load=load, travel=1.0,
        pace=1.0, middle=0.0, places=(-1.5, 1.5), way=(-1.9, 1.6),
        speeds=(2.0, 2.5, 3.0, 4.0, 5.0), **own,
    )  # fmt: skip


ARM = Known(
    MACHINE,
    {
        # level and viscous: only to choose torques that give about these speeds
        1: _axis(
            1, Load(P1 + 2 * P3), torque=245.0, speed=9.0, level=8.45, viscous=5.3, kp=2000.0,
            kd=120.0, brake=30.0, slow=1.0, fast=2.0, enough=14.0,
        ),
        2: _axis(
            2, Load(P2), torque=39.2, speed=15.0, level=2.35, viscous=1.1, kp=300.0, kd=12.0,
            brake=5.0, slow=0.4, fast=2.0, enough=4.2,
        ),
    },
    pose=np.zeros(2),
    rigid=inertia_torque,
    program="inverse_dynamics.c",
    apart=True,
)  # fmt: skip
