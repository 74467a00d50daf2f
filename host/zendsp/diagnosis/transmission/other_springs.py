"""A spring of another joint, beside one that was found: each hides the other from the search of a
joint by itself, since each takes up a part of the other's motion.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.transmission.arm_chain import (
    Records,
    chain_along,
    springs_of,
    strongest,
)
from zendsp.diagnosis.transmission.arm_motion import ArmMotion, arm_motion, with_springs_at
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import facts
from zendsp.physics.effects.elasticity import RESONANCES
from zendsp.physics.kernel.signals import Array
from zendsp.physics.model import Model, Quantity, Term
from zendsp.physics.term_numbers import added_inertia

# deviance that a spring has to gain along the motion without it: true ones gained 297 to 994, the
# best ones of rigid joints lost 377 to 9574
LEAST_GAIN = 50.0
WEAKER = (1.0, 0.1, 0.01)  # without the spring, unknown torques had to do its work
LEAST_ROTOR = 0.03  # of the load: where a file has no rotor
DAMPING_RATIO = 0.15  # damping ratio of both masses on a spring that is tried
PER_ROW = 0.15  # oscillations: more are no states of a recording
OF_SPRING = ("stiffness", "damping")
AT_FIRST_BY = np.array([0.15, 0.7])  # logarithms by which they are changed at first
FINER_BY, PASSES = 0.4, 3


def with_other_spring(
    data: Data, model: Model, joints: Collection[int], among: Collection[int]
) -> Model | None:
    """The model with the likeliest spring of one more joint, and with the stiffness and damping of
    all springs as all encoders together have them; None where no further spring pays.

    Parameters
    ----------
    model : Model
        Its springs at ``joints`` (1-based) are known.
    among : collection of int
        The joints that may have another one.
    """
    rec = data.records[0]
    known = with_springs_at(model, joints)
    arm = arm_motion(rec, data, known)
    if arm is None:
        return None
    value = arm.chain.smoothed(arm.strength)[0]
    tried = [
        (_value(rec, data, other, arm, WEAKER), term)
        for joint in sorted(set(among) - set(joints))
        for term in _springs(rec, known, joint)
        if (other := known.with_terms((*known.terms, term)))
    ]
    best = min(tried, key=lambda t: t[0], default=None)
    if best is None or not best[0] < value - LEAST_GAIN:
        return None
    return _likeliest(rec, data, known.with_terms((*known.terms, best[1])), arm)


def _springs(rec: Records, model: Model, joint: int) -> list[Term]:
    """Springs between a joint's rotor and its link, from soft to stiff."""
    record = rec[joint - 1]
    inertia = record.inertia_and_bias(model)[0]
    load = facts(record).links or record.reference_inertia(model, inertia)
    rotor = max(added_inertia(model, joint), LEAST_ROTOR * load)
    both = 1.0 / (1.0 / rotor + 1.0 / load)
    out = []
    for hertz in RESONANCES:
        if hertz * record.sample_time > PER_ROW:
            break
        stiffness = (2 * math.pi * hertz) ** 2 * both
        numbers = {
            "stiffness": Quantity(stiffness),
            "damping": Quantity(2.0 * DAMPING_RATIO * math.sqrt(stiffness * both)),
            "load_inertia": Quantity(load),
            "load_dry": Quantity(0.0, False),
            "links_inertia": Quantity(load, False),
        }
        out.append(Term("elasticity", joint, numbers))
    return out


def _strength(model: Model, arm: ArmMotion) -> Array:
    """The strengths of unknown torques for a model with springs that an arm's motion has not: at a
    new link as at its motor.
    """
    had = arm.chain.links
    places = [int(had[joint - 1]) for joint in springs_of(model)]
    return arm.strength[[*range(len(had)), *places]]


def _value(
    rec: Records, data: Data, model: Model, arm: ArmMotion, weaker: Sequence[float] = (1.0,)
) -> float:
    """-2 log-likelihood of a model along a motion, the least with unknown torques ``weaker`` by
    some factors; infinite where it is no body's.
    """
    chain = chain_along(rec, data, model, arm.links)
    if chain is None:
        return math.inf
    values = (chain.smoothed(by * _strength(model, arm))[0] for by in weaker)
    return min((v for v in values if math.isfinite(v)), default=math.inf)


def _likeliest(rec: Records, data: Data, model: Model, arm: ArmMotion) -> Model:
    """The model with the likeliest numbers of its springs."""
    for turn in range(PASSES):
        chain = chain_along(rec, data, model, arm.links)
        assert chain is not None
        begin = np.outer(WEAKER, _strength(model, arm))
        strength = strongest(chain, begin, (10.0, 3.0))
        arm = ArmMotion(chain.link_motion(chain.smoothed(strength)[1]), chain, strength)
        best = _value(rec, data, model, arm)
        for joint in springs_of(model):
            for name, factor in zip(OF_SPRING, AT_FIRST_BY * FINER_BY**turn, strict=True):
                for by in (math.exp(factor), math.exp(-factor)):
                    other = _scaled(model, joint, name, by)
                    while (value := _value(rec, data, other, arm)) < best - 0.5:
                        model, best = other, value
                        other = _scaled(model, joint, name, by)
    return model


def _scaled(model: Model, joint: int, name: str, by: float) -> Model:
    """The model with a number of a joint's spring larger by a factor."""
    spring = springs_of(model)[joint]
    number = spring.parameters[name]
    scaled = replace(number, value=max(by * number.value, 1e-9))
    changed = replace(spring, parameters={**spring.parameters, name: scaled})
    return model.with_terms(tuple(changed if t is spring else t for t in model.terms))
