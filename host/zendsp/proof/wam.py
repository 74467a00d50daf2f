"""A seven-joint arm: figures of the Barrett WAM, its chain for the simulator and its URDF for the
given model.

Source: Barrett Technology, "WAM Inertial Specifications" AC-02 (no hand): standard
Denavit-Hartenberg frames, frame k fixed to link k; mass, centre of mass and inertia about it in
frame k. Friction and torque limits: "Dynamic Model of a 7-DOF Whole Arm Manipulator and Validation
from Experimental Data"; its viscous figures come from a narrow range of speed (some are negative),
so that here only their size is taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zendsp.proof.draft import Array, Draft
from zendsp.proof.reality import LinkTruth

Rng = np.random.Generator


@dataclass(frozen=True)
class Row:
    """One link of the table: DH a, alpha, d; body in frame k; Coulomb N m, viscous N m s/rad,
    torque limit N m.
    """

    a: float
    alpha_deg: float
    d: float
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]  # xx yy zz xy xz yz
    coulomb: float
    viscous: float
    limit: float


TABLE = (
    Row(
        0, -90, 0, 10.768, (-0.0044342, 0.12189, -0.00066489),
        (0.134873, 0.113284, 0.0904562, 0.00213026, 0.000124857, -0.000685566), 4.42, 1.08, 77.3,
    ),
    Row(
        0,
        90,
        0,
        3.8749,
        (-0.0023698, 0.031056, 0.015421),
        (0.0214093, 0.0137788, 0.015589, -0.000271719, -2.4597e-05, 0.00181916),
        3.10,
        0.60,
        160.6,
    ),
    Row(
        0.045,
        -90,
        0.55,
        1.8023,
        (-0.038259, 0.20751, 3.309e-05),
        (0.0591122, 0.00324538, 0.0592641, 0.00249531, -7.38169e-06, 1.76755e-05),
        2.05,
        0.80,
        95.6,
    ),
    Row(
        -0.045,
        90,
        0,
        2.4007,
        (0.0049851, -0.00022942, 0.13272),
        (0.0149055, 0.014818, 0.00294461, -1.74156e-05, 0.00150643, 2.1072e-05),
        1.14,
        0.50,
        29.4,
    ),
    Row(
        0,
        -90,
        0.3,
        0.12376,
        (8.921e-05, 0.0051122, 0.0043582),
        (5.02849e-05, 7.58183e-05, 6.27046e-05, -2.03558e-07, 4.81173e-08, 3.58737e-06),
        0.20,
        0.10,
        11.6,
    ),
    Row(
        0,
        90,
        0,
        0.41797,
        (0.00012262, -0.017032, 0.024683),
        (0.000555163, 0.000243675, 0.000453575, -2.35292e-06, 3.27504e-06, 4.59051e-05),
        0.20,
        0.08,
        11.6,
    ),
    Row(
        0,
        0,
        0.06,
        0.068648,
        (-7.974e-05, 0.00016313, -0.0032355),
        (3.77295e-05, 3.80609e-05, 7.40777e-05, 1.89107e-07, -2.2889e-09, 3.7671e-09),
        0.05,
        0.02,
        2.7,
    ),
)
CENTRE = (0.0, 0.4, 0.0, 1.3, 0.0, 0.0, 0.0)  # rad, the pose that motions go around


def frame(row: Row) -> tuple[Array, Array]:
    """Tz(d) Tx(a) Rx(alpha): from the frame after the joint's turn to frame k; (rotation, place).
    """
    c, s = np.cos(np.deg2rad(row.alpha_deg)), np.sin(np.deg2rad(row.alpha_deg))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), np.array([row.a, 0.0, row.d])


def _matrix(row: Row) -> Array:
    xx, yy, zz, xy, xz, yz = row.inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _triple(x: Array) -> tuple[float, float, float]:
    return float(x[0]), float(x[1]), float(x[2])


def chain() -> tuple[LinkTruth, ...]:
    """The links for the simulator: joint k's frame in link k-1's, bodies in the frame after the
    joint's turn.
    """
    links = []
    rotation, place = np.eye(3), np.zeros(3)
    for row in TABLE:
        turn, shift = frame(row)
        com = turn @ np.array(row.com) + shift
        inertia = turn @ _matrix(row) @ turn.T
        links.append(
            LinkTruth(
                tuple(rotation.ravel()),
                _triple(place),
                row.mass,
                _triple(com),
                tuple(inertia.ravel()),
            )
        )
        rotation, place = turn, shift
    return tuple(links)


def urdf() -> str:
    """The same arm as URDF; link k's frame is the one after joint k's turn."""
    lines = ['<?xml version="1.0"?>', '<robot name="wam7">', '  <link name="base"/>']
    parent, place, alpha = "base", np.zeros(3), 0.0
    for k, row in enumerate(TABLE, 1):
        turn, shift = frame(row)
        com, m = turn @ np.array(row.com) + shift, turn @ _matrix(row) @ turn.T
        xyz = " ".join(repr(float(x)) for x in com)
        ixx = ["ixx", "iyy", "izz", "ixy", "ixz", "iyz"]
        values = (m[0, 0], m[1, 1], m[2, 2], m[0, 1], m[0, 2], m[1, 2])
        tensor = " ".join(f'{n}="{float(v)!r}"' for n, v in zip(ixx, values, strict=True))
        origin = " ".join(repr(float(x)) for x in place)
        lines += [
            f'  <link name="link{k}"><inertial>',
            f'    <origin xyz="{xyz}" rpy="0 0 0"/><mass value="{row.mass}"/><inertia {tensor}/>',
            "  </inertial></link>", f'  <joint name="joint{k}" type="revolute">',
            f'    <parent link="{parent}"/><child link="link{k}"/><axis xyz="0 0 1"/>',
            f'    <origin xyz="{origin}" rpy="{float(np.deg2rad(alpha))!r} 0 0"/>',
            f'    <limit lower="-4" upper="4" effort="{row.limit}" velocity="10"/>', "  </joint>",
        ]
        parent, place, alpha = f"link{k}", shift, row.alpha_deg
    return "\n".join([*lines, "</robot>"]) + "\n"


def wam(rng: Rng) -> Draft:
    """PD with gravity compensation along the reference, 1 kHz, motions around an elbow-bent pose.
    """
    shapes = ("multisine", "sines", "mixed", "moves")
    joints = []
    for row in TABLE:
        c, b = row.coulomb * rng.uniform(0.7, 1.3), row.viscous * rng.uniform(0.7, 1.3)
        joints.append(
            {
                "coulomb_pos": c,
                "coulomb_neg": c,
                "viscous_pos": b,
                "viscous_neg": b,
                "limit": row.limit,
                "resolution": 2 * np.pi / 4096 / 20,
                "delay": 1e-3,
            }
        )
    # the wrist is light and rough: gains against its friction
    kp = (300.0, 500.0, 60.0, 50.0, 4.0, 4.0, 0.8)
    kd = (15.0, 30.0, 3.0, 2.5, 0.02, 0.02, 0.002)
    return Draft(
        "urdf",
        "urdf",
        {},
        joints,
        [{"viscous", "coulomb"} for _ in TABLE],
        1e-3,
        20.0,
        [float(x) for x in rng.uniform(0.4, 0.8, 7)],
        [float(x) for x in rng.uniform(1.0, 2.0, 7)],
        list(kp),
        list(kd),
        velocity_filter=0.004,
        known_delay=1e-3,
        links=chain(),
        centre=list(CENTRE),
        train_shape=str(rng.choice(shapes)),
        heldout_shape=str(rng.choice(shapes)),
    )
