"""Arms of two, three, six and seven revolute joints, as numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

GRAVITY = (0.0, 0.0, -9.81)  # m/s²
OFF = 0.02  # given rotors and friction are wrong by so much, one standard deviation
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Arm:
    """A chain. The frame of a link stands in its joint; vectors are in that of the link before it
    (``place``) or its own.
    """

    axis: Array  # (n, 3)
    place: Array  # (n, 3) m, of the joint
    mass: Array  # (n,) kg
    com: Array  # (n, 3) m
    inertia: Array  # (n, 3) kg m², principal, about the centre of mass
    rotor: Array  # (n,) kg m², behind the gear
    viscous: Array  # (n,) N m s/rad
    coulomb: Array  # (n,) N m
    reach: Array  # (n,) rad: largest angle of a motion

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.mass)


_TWO = "yy", ((0, 0, 0.5), (0, 0, -0.35)), (2.2, 1.2), ((0, 0, -0.16), (0.01, 0, -0.14))
_THREE = (
    "zyy", ((0, 0, 0.3), (0, 0.08, 0), (0, -0.07, 0.36)), (4.0, 3.1, 1.4),
    ((0, 0.02, -0.04), (0, 0, 0.16), (0.01, 0, 0.15)),
)  # fmt: skip
_SIX = (
    "zyyyzy",
    ((0, 0, 0.09), (0, 0.136, 0), (0, -0.12, 0.425), (0, 0, 0.392), (0, 0.093, 0), (0, 0, 0.095)),
    (3.7, 8.4, 2.3, 1.2, 1.2, 0.25),
    ((0, 0.01, -0.01), (0, 0, 0.21), (0, 0, 0.17), (0, 0.02, 0.01), (0, 0.01, 0.01),
     (0, 0.02, 0.01)),
)  # fmt: skip
_SEVEN = (
    "zyzyzyz",
    ((0, 0, 0.15), (0, 0, 0.19), (0, 0, 0.21), (0, 0, 0.19), (0, 0, 0.21), (0, 0, 0.19),
     (0, 0, 0.08)),
    (3.9, 3.6, 2.9, 2.6, 1.8, 1.5, 0.5),
    ((0, -0.03, 0.12), (0, 0.06, 0.04), (0, 0.03, 0.13), (0, 0.06, 0.03), (0, 0.02, 0.09),
     (0, 0.01, 0.01), (0, 0, 0.03)),
)  # fmt: skip
_ROTORS = {
    2: (0.03, 0.012),
    3: (0.12, 0.15, 0.06),
    6: (0.6, 0.6, 0.4, 0.08, 0.08, 0.08),
    7: (0.4, 0.4, 0.25, 0.25, 0.08, 0.08, 0.05),
}
_DRY = {
    2: (0.5, 0.2),
    3: (1.2, 1.8, 0.8),
    6: (5.0, 7.0, 4.0, 1.2, 1.0, 0.9),
    7: (3.0, 4.0, 2.5, 2.5, 0.9, 0.9, 0.5),
}


def make_arm(joints: int, rng: np.random.Generator) -> Arm:
    """An arm with so many joints; sizes differ from draw to draw."""
    axes, place, mass, com = {2: _TWO, 3: _THREE, 6: _SIX, 7: _SEVEN}[joints]
    kg = np.array(mass) * rng.uniform(0.8, 1.2, joints)
    far = np.abs(np.array(place, float)).max(axis=1)[:, None] * 0.3 + 0.05
    dry = np.array(_DRY[joints]) * rng.uniform(0.7, 1.3, joints)
    return Arm(
        axis=np.array([_AXES[a] for a in axes]),
        place=np.array(place, float),
        mass=kg,
        com=np.array(com, float) + rng.normal(0.0, 0.005, (joints, 3)),
        inertia=kg[:, None] * far**2 * rng.uniform(0.25, 0.4, (joints, 1)) * (1.0, 1.0, 0.6),
        rotor=np.array(_ROTORS[joints]) * rng.uniform(0.8, 1.2, joints),
        viscous=0.4 * dry * rng.uniform(0.6, 1.4, joints),
        coulomb=dry,
        reach=rng.uniform(0.5, 1.1, joints),
    )


def another(arm: Arm, rng: np.random.Generator) -> Arm:
    """An arm of other proportions, with more or less friction."""
    length, heavy, dry, fluid = rng.uniform((0.7, 0.6, 0.5, 0.5), (1.3, 1.5, 1.6, 1.6))
    return replace(
        arm, place=length * arm.place, com=length * arm.com, mass=heavy * arm.mass,
        inertia=heavy * length**2 * arm.inertia, coulomb=dry * arm.coulomb,
        viscous=fluid * arm.viscous,
    )  # fmt: skip


def about(values: Array, rng: np.random.Generator) -> Array:
    """Values as somebody has measured them."""
    return values * (1.0 + OFF * rng.standard_normal(len(values)))
