"""The most compliant transmission and the widest gap that a joint alone could have hidden.

A load behind a spring rings, and one behind a gap is not felt within it; both depend on how much of
the inertia is there. The figures are of a load that is half of it. Of arms the compliance comes
from how slowly bending joints lag (`transmission/one_sensor.py`), and no gap is stated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.confidence import least_stated
from zendsp.diagnosis.decide.implants import NOT_SEEN, NOT_SMALL, Implant, size_of
from zendsp.diagnosis.decide.pieces import finest
from zendsp.diagnosis.decide.result import Detectable
from zendsp.diagnosis.transmission.sets import compliance_unit
from zendsp.physics.calibration.joint import facts
from zendsp.physics.calibration.terms import make_term, usable
from zendsp.physics.effects import Effect, get_effect, unit_of
from zendsp.physics.effects.axes import DAMPING, transmission_limits
from zendsp.physics.effects.base import Facts
from zendsp.physics.model import Model, Term

HALF = 0.5  # of the inertia, on the load
ASKED = ("elasticity", "backlash")
OF_A_START = 0.3  # of a starting gap: one as small is found from it
# the stiffest start over the stiffest spring that is stated: at its edge of the search one of 61 Hz
# was not named
SOFTER = 2.0
# standard deviations of the sensor, of a gap: of four of 1 to 4, 0.3 to 1.2 counts, two were
# "complete"
ABOVE_SENSOR = 6.0


def detectable_transmissions(
    parts: Parts, given: Model, decisions: Sequence[Decision], jobs: int
) -> tuple[Detectable, ...]:
    """The smallest compliance, rad/(N m), and gap, rad, of a joint alone that would have been
    found, where it has neither; of infinite size where not even a large one would have been.
    """
    out: list[Detectable] = []
    for decision in decisions if parts.test.joints == 1 and given.called is None else ():
        if decision.joint in parts.undriven:
            continue
        if any(get_effect(t.effect).sole for t in decision.final.model.at(decision.joint)):
            continue
        records = [rec[decision.joint - 1] for rec in parts.test.records]
        implant = Implant(parts, given, decision, jobs)
        known = facts(records[0], decision.final.model)
        for effect in map(get_effect, ASKED):
            if usable(effect, records):
                out.append(_smallest(implant, effect, known, decision, given))
    return tuple(out)


def _smallest(
    implant: Implant, effect: Effect, known: Facts, decision: Decision, given: Model
) -> Detectable:
    after = max(decision.after.value, decision.after.often)
    beyond = max(after, least_stated(effect.name, decision), finest(effect.name, given))
    start, largest = _span(effect, decision.joint, known)
    size, torque = implant.seen(start, beyond)
    at = {"load_inertia": start.value("load_inertia")}
    if effect.name == "backlash":
        size, torque = (size, torque) if size <= largest else NOT_SEEN
        unit = unit_of(effect.parameter(size_of(effect)).size, given.joint_kind(decision.joint))
    else:
        seen = math.isfinite(size) and size >= largest
        size, torque = (1.0 / size, torque) if seen else NOT_SEEN
        unit = compliance_unit(given, decision.joint)
    return Detectable(decision.joint, "transmission", effect.name, size, unit, torque, at)


def _span(effect: Effect, joint: int, known: Facts) -> tuple[Term, float]:
    """The smallest one that the search finds, with half of the inertia on the load, and the number
    of the largest.
    """
    assert effect.scan is not None
    starts, key = effect.scan(known), size_of(effect)
    sizes = [s[key] for s in starts]
    load = HALF * known.inertia
    numbers = {"load_inertia": load, "links_inertia": known.links}
    if effect.name == "backlash":
        _, contact = transmission_limits(known)
        least = max(OF_A_START * min(sizes), ABOVE_SENSOR * known.sensor)
        numbers |= {"gap": least, "stiffness": contact}
        largest = NOT_SMALL * known.scale.position
    else:
        numbers["stiffness"], largest = max(sizes) / SOFTER, min(sizes)
    damping = 0.8 if effect.name == "backlash" else DAMPING
    numbers["damping"] = damping * math.sqrt(numbers["stiffness"] * load)
    return make_term(effect, joint, numbers), largest
