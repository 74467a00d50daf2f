"""The search upon a given spring in a transmission that calibration has moved away.

Where something is missing beside it, a fit may bend a right spring until it is none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from zendsp.diagnosis.measure.likelihood import calibrate_joint, fit_scored, informative
from zendsp.diagnosis.progress import Step
from zendsp.diagnosis.search.forward import Searcher
from zendsp.diagnosis.search.hypothesis import JointSearch
from zendsp.diagnosis.search.short_fits import WAIT
from zendsp.diagnosis.search.simplify import simplify
from zendsp.diagnosis.search.white import is_white
from zendsp.physics.calibration.fit import joint_handles
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Term

# of the frequency of a load on its spring, as a logarithm: a fit that moved it further has left the
# basin of the given one (``RESONANCES`` in effects/elasticity.py)
BASIN = 0.1


def upon_given_springs(search: JointSearch, given: Model, searcher: Searcher) -> JointSearch:
    """The search, or a likelier one that began with the springs as they are ``given``, calibrated
    at its end.
    """
    joint = search.joint
    springs = _springs_of(given, joint)
    moved = any(_left(t, _springs_of(search.base.model, joint).get(e)) for e, t in springs.items())
    if not moved or is_white(search.final, joint):
        return search
    jobs, data, tell = searcher.jobs, searcher.rounds.data, searcher.rounds.progress
    tell(Step.SEARCHING.says(f"joint {joint}: with its spring as it was given"))
    beneath = _with_springs(given, joint, {e: t.held() for e, t in springs.items()})
    upon = Searcher(data, joint, searcher.accept, jobs, tell, beneath)
    other = upon.search(calibrate_joint(data, beneath, joint, jobs))
    if not other.steps:
        return search
    found = _springs_of(other.final.model, joint)
    free = {e: _freed_as(springs[e], t) for e, t in found.items() if e in springs}
    model = _with_springs(other.final.model, joint, free)
    handles = joint_handles(data, model, joint)
    best = fit_scored(other.final.data, model, handles, (joint,), jobs=jobs)
    other = replace(other, base=search.base, best=best)
    other.best, dropped = simplify(other, informative(data, joint), jobs)
    other.dropped = (*other.dropped, *dropped)
    return other if other.final.deviance < search.final.deviance - WAIT else search


def _springs_of(model: Model, joint: int) -> dict[str, Term]:
    """The terms of a joint with a load on a spring, by effect."""
    return {t.effect: t for t in model.at(joint) if get_effect(t.effect).family == "transmission"}


def _left(given: Term, now: Term | None) -> bool:
    """Whether a fit has left the basin of a given spring."""
    if now is None:
        return True
    ratios = [t.value("stiffness") / t.value("load_inertia") for t in (given, now)]
    return 0.5 * abs(math.log(ratios[1] / ratios[0])) > BASIN


def _with_springs(model: Model, joint: int, springs: Mapping[str, Term]) -> Model:
    """The model with other terms for some springs of a joint."""
    return model.with_terms(
        tuple(springs.get(t.effect, t) if t.joint == joint else t for t in model.terms)
    )


def _freed_as(given: Term, found: Term) -> Term:
    """The term that was found, its numbers as free as the given ones or as it has them."""
    numbers = {
        key: replace(q, free=q.free or given.parameters[key].free)
        for key, q in found.parameters.items()
    }
    return replace(found, parameters=numbers)
