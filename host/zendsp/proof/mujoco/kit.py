"""What the makers of concealed effects share: the table of makers, and how a truth is written down.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zendsp.proof.draft import Concealed, Scale
from zendsp.proof.mujoco.machines import Bench

Rng = np.random.Generator
Maker = Callable[[Bench, int, Scale, float, Rng], Concealed]
MAKERS: dict[str, Maker] = {}


def maker(name: str) -> Callable[[Maker], Maker]:
    """Enter the function below as the maker of `name`."""

    def keep(function: Maker) -> Maker:
        MAKERS[name] = function
        return function

    return keep


def unit(b: Bench, per: str = "") -> str:
    """Unit of a torque or force at the joints, with ``per`` behind it, written with rad."""
    force, length = ("N", "m") if b.kind == "linear" else ("N m", "rad")
    return f"{force}{per.replace('rad', length)}"


def truth(
    b: Bench,
    effect: str,
    joint: int,
    size: float,
    parameters: dict[str, tuple[float, str]],
    accepted: tuple[str, ...] = (),
    mechanisms: tuple[str, ...] = (),
    unscored: tuple[str, ...] = (),
    note: str = "",
    body: str = "",
    joints: tuple[int, ...] = (),
) -> Concealed:
    """What is concealed, for the case's truth; ``joint`` and ``joints`` count from 0."""
    return Concealed(
        effect, joint + 1, parameters, size, accepted=list(accepted), unscored=list(unscored),
        note=note, mechanisms=list(mechanisms), body=body, accepted_joints=[j + 1 for j in joints],
    )
