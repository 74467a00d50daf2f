"""A gap between motor and load, with contact stiffness beyond it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from zendsp.physics.effects.axes import (
    LINKS,
    load_limits,
    resonance,
    transmission_damping_limits,
    transmission_limits,
)
from zendsp.physics.effects.base import Effect, Facts, Numbers, Parameter

# While the gap is open the motor's inertia alone is moved: a basin spans a factor of three in the
# gap, of sixteen in the stiffness, 12 % in that inertia.
GAPS = (0.001, 0.0025, 0.006, 0.015, 0.04)  # shares of the motion's range
# smaller ones, of a joint alone, where the sensor tells a gap: three gaps of 0.0002 to 0.00025 that
# wide motion hid were unexplained. Of an arm they are not tried: beside them a KUKA's second axis
# got a law more, and lost its dry friction
FINER = (0.00016, 0.0004)
# standard deviations of the sensor: the least gap to start from. One of 27, which was not named,
# was from a start of 18; at 20 it was not
TOLD = 10.0
SHARES = tuple(1.0 - 0.92 * 0.9**i for i in range(16))  # of the inertia, on the load
RESONANCE = 35.0  # Hz
# A spring that stiffens imitates a gap: times its bend at the typical torque, and its stiffness
# there
BENDS = (0.2, 0.35, 0.6, 1.0, 1.6)
STIFFER = (1.0, 3.0, 10.0)


def _starts(facts: Facts) -> Sequence[Numbers]:
    """A gap is found from a lossy contact: a bouncing one has no gradient to follow."""
    if "stiffness3" in facts.replaced:
        return _in_place_of_a_spring(facts)
    starts = []
    least = TOLD * facts.sensor if facts.joints == 1 else math.inf
    told = [g for g in FINER if g * facts.scale.position > least]
    for gap, share in itertools.product((*told, *GAPS), SHARES):
        stiffness, load = resonance(facts, RESONANCE, share), share * facts.inertia
        damping = 0.8 * math.sqrt(stiffness * load)
        starts.append(
            {
                "gap": gap * facts.scale.position,
                "stiffness": stiffness,
                "load_inertia": load,
                "damping": damping,
                "links_inertia": facts.links,
            }
        )
    return starts


def _in_place_of_a_spring(facts: Facts) -> list[Numbers]:
    spring = facts.replaced
    soft, cubic, load = (spring[key] for key in ("stiffness", "stiffness3", "load_inertia"))
    torque = facts.scale.torque * load / facts.inertia
    begins = math.sqrt(soft / (3.0 * max(cubic, 1e-12)))  # the bend at which it is twice as stiff
    bend = 2.0 * begins * math.sinh(math.asinh(1.5 * torque / (soft * begins)) / 3.0)
    there = soft + 3.0 * cubic * bend**2
    return [
        {
            "gap": wide * bend,
            "stiffness": hard * there,
            "load_inertia": load,
            "damping": 0.8 * math.sqrt(hard * there * load),
            "links_inertia": facts.links,
        }
        for wide, hard in itertools.product(BENDS, STIFFER)
    ]


EFFECT = Effect(
    name="backlash",
    site="setup",
    mechanism="transmission",
    parameters=(
        Parameter(
            "gap", "position", lower=1e-09, limits=lambda f: (1e-9, 0.5 * f.scale.position),
            meaning="width of the gap",
        ),
        Parameter(
            "stiffness", "torque/position", lower=1e-09, limits=transmission_limits,
            meaning="k, of the contact",
        ),
        Parameter(
            "load_inertia", "inertia", lower=1e-12, limits=load_limits,
            meaning="part of the joint's inertia that is behind the gap",
        ),
        Parameter(
            "damping", "torque/speed", lower=0, default=0.0, limits=transmission_damping_limits,
            meaning="of the contact; 0: a tenth of critical",
        ),
        LINKS,
    ),
    c=(
        "two_mass = 1; gap = p[0]; k_spring = p[1]; j_load = p[2]; c_spring = p[3] > 0 ? p[3] : 0.1"
        " * sqrt(p[1] * p[2]); j_links = p[4];"
    ),
    sentence="Joint {joint} has backlash of {gap} between motor and load.",
    experiment="Small reversals around zero load torque.",
    equation="k dz(qm - ql, gap)",
    over="position",
    scan=_starts,
    apart="gap",  # of one gap the likeliest: others lead to the same optimum
    hidden=True,
    essence=("gap", "load_inertia"),  # without a gap it is a spring
    bare="elasticity",
    rough=True,
    loosens_inertia=True,
    family="transmission",
    sole=True,
    instead_of=("stiffening",),
    shown_by=("position_load",),
    why_not="within the gap no torque reaches the load",
    rivals=("elasticity", "presliding"),
)
