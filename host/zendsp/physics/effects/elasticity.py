"""A spring and damper between motor and load (flexible joint; Spong 1987)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from zendsp.physics.effects.axes import (
    DAMPING,
    LINKS,
    load_limits,
    resonance,
    swings,
    transmission_damping_limits,
    transmission_limits,
)
from zendsp.physics.effects.base import Effect, Facts, Numbers, Parameter

# Hz: where a lightly damped load swings for many periods, a basin spans a tenth of the frequency to
# either side, nearly any share of the inertia, and the more the better the start is damped
RESONANCES = tuple(2.0 * 2 ** (i / 4) for i in range(21))
SHARES = (0.2, 0.45, 0.75)  # of the inertia, on the load


def _starts(facts: Facts) -> Sequence[Numbers]:
    starts = []
    for hertz, share in itertools.product(RESONANCES, SHARES):
        stiffness, load = resonance(facts, hertz, share), share * facts.inertia
        starts.append(
            {
                "stiffness": stiffness,
                "load_inertia": load,
                "damping": DAMPING * math.sqrt(stiffness * load),
                "links_inertia": facts.links,
            }
        )
    return starts


EFFECT = Effect(
    name="elasticity",
    site="setup",
    mechanism="transmission",
    parameters=(
        Parameter(
            "stiffness", "torque/position", lower=1e-09, limits=transmission_limits,
            meaning="k",
        ),
        Parameter(
            "damping", "torque/speed", lower=0, limits=transmission_damping_limits,
            meaning="c",
        ),
        Parameter(
            "load_inertia", "inertia", lower=1e-12, limits=load_limits,
            meaning="part of the joint's inertia that is behind the spring",
        ),
        Parameter(
            "load_dry", "torque", lower=0, default=0.0, fitted=False,
            meaning="dry friction of the load, which two position sensors show",
        ),
        LINKS,
    ),
    c=(
        "two_mass = 1; k_spring = p[0]; c_spring = p[1]; j_load = p[2]; dry_load = p[3]; "
        "j_links = p[4];"
    ),
    sentence=(
        "Joint {joint} is elastic: stiffness {stiffness} between motor and load of {load_inertia},"
        " which rings at {rings} while the motor is held."
    ),
    experiment=(
        "Chirp or multisine around the resonance; steps and listen to the ringing. A base that"
        " rocks looks the same: brace it and record again."
    ),
    equation="k (qm - ql) + c (q̇m - q̇l)",
    over="acceleration",
    scan=_starts,
    tries=({"damping": 0.0},),  # a spring that rings for long is an optimum of its own
    hidden=True,
    essence=("stiffness", "load_inertia"),  # of infinite stiffness it does nothing
    possible=swings,
    loosens_inertia=True,
    family="transmission",
    sole=True,
    shown_by=("position_load",),
    why_not="its motion is not that of the motor: control both sides, or filter the resonance",
    rivals=("backlash", "delay"),
)
