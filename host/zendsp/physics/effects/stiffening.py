"""A transmission that stiffens as it is loaded: the spring of a harmonic drive."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from zendsp.physics.effects.axes import (
    DAMPING,
    LINKS,
    load_limits,
    resonance,
    stiffening_limits,
    transmission_damping_limits,
    transmission_limits,
)
from zendsp.physics.effects.base import Effect, Facts, Numbers, Parameter

SOFTER = (0.4, 0.7, 1.0)  # of the constant stiffness that was found in its place
# of the cubic term in the torque, at the typical torque of the load; a resonance bends it far more
SHARES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
# where no constant stiffness was found, half as many as it has: the cubic term makes a basin wider
RESONANCES = tuple(2.0 * 2 ** (i / 2) for i in range(11))  # Hz
LOADS = (0.3, 0.65)  # of the inertia, on the load
LARGE = (0.3, 3.0)  # of the cubic term: a spring that bends little is found as a constant one


def _starts(facts: Facts) -> Sequence[Numbers]:
    shares: Sequence[float] = LARGE
    if facts.replaced:
        old, shares = facts.replaced, SHARES
        springs = [{**old, "stiffness": soft * old["stiffness"]} for soft in SOFTER]
    else:
        springs = []
        for hertz, load in itertools.product(RESONANCES, LOADS):
            spring = {
                "stiffness": resonance(facts, hertz, load), "load_inertia": load * facts.inertia
            }
            springs.append({**spring, "damping": DAMPING * math.sqrt(math.prod(spring.values()))})
    starts = []
    for spring, share in itertools.product(springs, shares):
        torque = facts.scale.torque * spring["load_inertia"] / facts.inertia
        spring["links_inertia"] = facts.links
        starts.append({**spring, "stiffness3": share * spring["stiffness"] ** 3 / torque**2})
    return starts


EFFECT = Effect(
    name="stiffening",
    site="setup",
    mechanism="transmission",
    parameters=(
        Parameter(
            "stiffness", "torque/position", lower=1e-9, limits=transmission_limits,
            meaning="k",
        ),
        Parameter(
            "stiffness3", "torque/position3", lower=0, limits=stiffening_limits,
            meaning="k₃",
        ),
        Parameter(
            "load_inertia", "inertia", lower=0, default=0.0, limits=load_limits,
            meaning="part of the joint's inertia that is behind the spring; 0: half of it",
        ),
        Parameter(
            "damping", "torque/speed", lower=0, default=0.0, limits=transmission_damping_limits,
            meaning="0: a twentieth of critical",
        ),
        Parameter(
            "load_dry", "torque", lower=0, default=0.0, fitted=False,
            meaning="dry friction of the load, which two position sensors show",
        ),
        LINKS,
    ),
    c=(
        "two_mass = 1; k_spring = p[0]; k_cubic = p[1]; j_load = p[2]; c_spring = p[3] > 0 ? "
        "p[3] : -1; dry_load = p[4]; j_links = p[5];"
    ),
    sentence=(
        "The transmission of joint {joint} stiffens as it bends: {stiffness} at rest, and "
        "{stiffness3} times the bend cubed."
    ),
    experiment="Chirps of two amplitudes: the resonance rises with the amplitude.",
    equation="k φ + k₃ φ³, φ = qm - ql",
    over="command",
    scan=_starts,
    hidden=True,
    essence=("stiffness3", "load_inertia"),
    bare="elasticity",
    loosens_inertia=True,
    family="transmission",
    sole=True,
    replaces=("elasticity",),
    rivals=("elasticity", "backlash"),
    shown_by=("position_load",),
    why_not="its motion is not that of the motor: control both sides, or filter the resonance",
)
