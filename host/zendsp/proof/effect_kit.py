"""What the makers of concealed effects share: sizes, units, friction of a draft, and how a maker
enters a table.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zendsp.proof.draft import Concealed, Draft, Scale
from zendsp.proof.truth import Place

Rng = np.random.Generator
Maker = Callable[[Draft, int, Scale, float, Rng], Concealed]


def effect(table: dict[str, Maker], name: str) -> Callable[[Maker], Maker]:
    """Enter the function below into a table as the maker of effect `name`."""

    def keep(maker: Maker) -> Maker:
        table[name] = maker
        return maker

    return keep


def share(scale: Scale, size: float, rng: Rng) -> float:
    """Torque of an effect: a fifth of the torque's RMS times the knob, spread by 30 % either way.
    """
    return float(0.2 * size * scale.torque * rng.uniform(0.7, 1.3))


def unit(d: Draft, *, per: str = "", prefix: str = "") -> str:
    """Unit of a torque of this machine (N m or N), per rad or m to some power."""
    force, length = ("N", "m") if d.kind == "linear" else ("N m", "rad")
    return f"{prefix}{force}{per.replace('rad', length)}"


def length(d: Draft) -> str:
    """Unit of a position of this machine."""
    return "m" if d.kind == "linear" else "rad"


def either(rng: Rng) -> float:
    """1 or -1 by chance."""
    return float(rng.choice([-1.0, 1.0]))


def friction(d: Draft, joint: int) -> float:
    """Mean Coulomb level of a joint's truth."""
    j = d.joints[joint]
    return float(0.5 * (j.get("coulomb_pos", 0.0) + j.get("coulomb_neg", 0.0)))


def at_rest(joint: int) -> list[Place]:
    """The place of what acts at low speed."""
    return [{"variable": "velocity", "joint": joint + 1, "value": 0.0}]


def set_friction(
    d: Draft, joint: int, *, coulomb: float | None = None, viscous: float | None = None
) -> None:
    """Give a joint the same friction in both directions, N m and N m s/rad."""
    if coulomb is not None:
        d.joints[joint].update(coulomb_pos=coulomb, coulomb_neg=coulomb)
    if viscous is not None:
        d.joints[joint].update(viscous_pos=viscous, viscous_neg=viscous)


def inertia_of(d: Draft, joint: int) -> float:
    """Typical inertia that joint's motor feels."""
    if d.kind in ("rotary", "linear"):
        return next(iter(d.parameters.values()))
    if d.kind == "planar2r":
        return d.parameters["p1"] if joint == 0 else d.parameters["p2"]
    return float([1.2, 1.2, 0.3, 0.3, 0.02, 0.02, 0.002][joint])
