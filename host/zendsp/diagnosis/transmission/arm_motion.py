"""The motion of all links of an arm with springs, as its model and all of its encoders together
say.

One joint's observer has to believe the measured accelerations of the others. Differentiated counts
shake a load that rings, and behind springs of two joints the motors show how neither link moves:
estimated one after the other, the links shake one another ever more. Here all bodies are one
system (``Chain``), and its smoother knows all encoders, before and after.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from zendsp.diagnosis.data.prepare import within_samples
from zendsp.diagnosis.transmission.arm_chain import Chain, chain_of, springs_of, strongest
from zendsp.diagnosis.transmission.arm_path import Records, path_along
from zendsp.physics.calibration.fit import Data
from zendsp.physics.effects import get_effect
from zendsp.physics.kernel.signals import Array
from zendsp.physics.model import TREES, Model

# The motion gives what is not linear, and is smoothed with it. Of an arm of two springs the links'
# accelerations were off by 15 and 8 % after the first round and 8 and 6 % after the second.
SMOOTHINGS = 2
LIVELY = 6.0  # s: as much of the liveliest motion shows how strong unknown torques are
UNKNOWN = 10.0 ** np.arange(-4.0, 0.6, 0.5)  # of the usual torques: unknown ones, to begin with
BY_FACTORS = (10.0, 3.0)  # factors by which each is then changed


@dataclass(frozen=True)
class ArmMotion:
    """Links within samples, (joints, 3, n), the chain along them, its unknown torques, and its
    -2 log-likelihood.
    """

    links: Array
    chain: Chain
    strength: Array
    deviance: float


def may_be_chain(data: Data, model: Model, joints: Collection[int]) -> bool:
    """Whether a machine would be a ``Chain`` with springs at these joints (1-based): of links apart
    from their rotors, with encoders on the motors alone. (The numbers of a ``planar2r`` hold the
    elbow's rotor too, so nobody knows what of it the shoulder feels: a spring of 106 N m/rad came
    out as 99.2.)
    """
    of_bodies = model.called is not None or model.kind in TREES
    if not joints or not of_bodies or model.sensor.side == "load":
        return False
    return not any("position_load" in rec[j - 1].columns for rec in data.records for j in joints)


def is_chain(data: Data, model: Model, joints: Collection[int]) -> bool:
    """Whether a machine with springs at these joints (1-based) is a ``Chain``, without gaps."""
    springs = springs_of(model)
    elastic = all(j in springs and springs[j].effect == "elasticity" for j in joints)
    return elastic and may_be_chain(data, model, joints)


def with_springs_at(model: Model, joints: Collection[int]) -> Model:
    """The model without the transmissions of other joints (1-based)."""
    return model.with_terms(
        tuple(
            t
            for t in model.terms
            if t.joint in joints or get_effect(t.effect).family != "transmission"
        )
    )


def arm_motion(rec: Records, data: Data, model: Model) -> ArmMotion | None:
    """The motion of one recording of an arm with the springs of a model; None where its numbers are
    those of no body.
    """
    links = np.stack([within_samples(r.motion.states, r.sample_time) for r in rec])
    found = None
    for _ in range(SMOOTHINGS):
        path = path_along(rec, data, model, links)
        chain, lively = (chain_of(p, model) for p in (path, path.liveliest(LIVELY)))
        if chain is None or lively is None:
            return None
        begin = UNKNOWN if found is None else found.strength[np.newaxis]
        strength = strongest(lively, begin, BY_FACTORS)
        value, states = chain.smoothed(strength)
        if not np.isfinite(value):
            return None
        links = chain.link_motion(states)
        found = ArmMotion(links, chain, strength, value)
    return found
