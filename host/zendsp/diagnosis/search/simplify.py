"""What a search found, in its simplest words: special cases by their own names, and nothing that
the recording does not need.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.measure.likelihood import (
    Scored,
    deviance,
    fit_scored,
    informative,
    tune_bandwidth,
)
from zendsp.diagnosis.measure.significance import INTEGRATION_ERROR, SIGNIFICANT, vanishes, whole
from zendsp.diagnosis.search.hypothesis import SUFFICIENT, JointSearch, price
from zendsp.physics.calibration.convergence import step_error, with_step_error
from zendsp.physics.calibration.fit import Data, fit, joint_handles, residual
from zendsp.physics.calibration.joint import facts
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect, is_supported, library
from zendsp.physics.model import Model, Term

# deviance a sample, a tenth of the innovations' energy: a term whose absence costs so much is not
# fitted away any more
SIMPLER_COST = 0.1
NO_WORSE = 10.0  # deviance that a simpler law may cost
# share of what two laws gain together that one in their place has to gain; a true spring of a
# pendulum gained 98 % with a coarse encoder (seed 144, case 28), and did better on untouched data
AS_MUCH = 0.95
BENDS = 0.02  # of the travel: hysteresis that slides after less has a soft onset only
STRAIGHT = 2.0  # times the torque that a hysteresis would reach unbent: of more it is a spring
HALVINGS = 2  # of the integration's step at most, in the last fit of a joint


def _refitted(data: Data, model: Model, joint: int, jobs: int, rounds: int) -> Scored:
    return fit_scored(
        data, model, joint_handles(data, model, joint), (joint,), jobs=jobs, rounds=rounds
    )


def split_asymmetry(found: JointSearch, current: Scored, jobs: int) -> Scored:
    """Asymmetric Coulomb friction is Coulomb friction and an offset: where the model had no such
    friction, they stand for themselves. An offset that the model holds is then another.
    """
    had = {t.effect for t in found.base.model.at(found.joint)}
    here = {t.effect: t for t in current.model.at(found.joint)}
    term, offset = here.get("coulomb_asymmetry"), here.get("torque_offset")
    if term is None or had & {"coulomb", "coulomb_asymmetry"}:
        return current
    if offset is not None and offset.parameters["level"].free:
        return current
    up, down = term.value("level_pos"), term.value("level_neg")
    level = 0.5 * (up - down) + (offset.value("level") if offset else 0.0)
    parts = (
        make_term(get_effect("coulomb"), found.joint, {"level": 0.5 * (up + down)}),
        make_term(get_effect("torque_offset"), found.joint, {"level": level}),
    )
    rest = (t for t in current.model.terms if t is not term and t is not offset)
    model = current.model.with_terms((*rest, *parts))
    other = _refitted(current.data, model, found.joint, jobs, 1)
    return other if other.deviance < current.deviance + NO_WORSE else current


def straightened(found: JointSearch, current: Scored, jobs: int) -> Scored:
    """Hysteresis of a force that the motion is far from reaching is a spring: name it so where that
    explains as much. It was found for a spring and dry friction together, as long as one of them
    was missing.
    """
    had = {t.effect for t in found.base.model.at(found.joint)}
    here = current.model.at(found.joint)
    term = next((t for t in here if t.effect == "hysteresis"), None)
    if term is None or had & {"hysteresis", "stiffness"}:
        return current
    record = max((rec[found.joint - 1] for rec in current.data.records), key=lambda r: r.n)
    if term.value("force") < STRAIGHT * term.value("stiffness") * facts(record).scale.position:
        return current
    begin = float(record.motion.states[0][0])  # where its bristle is straight
    numbers = {"coefficient": term.value("stiffness"), "neutral": begin}
    spring = make_term(get_effect("stiffness"), found.joint, numbers)
    others = (t for t in current.model.terms if t is not term)
    other = _refitted(
        current.data, current.model.with_terms((*others, spring)), found.joint, jobs, 3
    )
    return other if other.deviance < current.deviance + NO_WORSE else current


def _resolved(best: Scored, joint: int, jobs: int) -> Scored:
    """The same model refitted at ever smaller steps, until halving them moves its numbers less than
    the recording leaves open, or any two simulators.

    Otherwise an effect may be found that is only what the integration gets wrong.
    """
    if len(best.fit.residual) != len(residual(best.data, best.model, (joint,))):
        # what only a first look fitted, on thinned recordings
        best = _refitted(best.data, best.model, joint, jobs, 1)
    travel = max(rec[joint - 1].scale.position for rec in best.data.records)
    for _ in range(HALVINGS):
        error, fitted = step_error(best.data, best.fit, (joint,)), best.fit
        least = [
            INTEGRATION_ERROR * whole(h.key, float(x), travel)
            for h, x in zip(fitted.handles, fitted.x, strict=True)
        ]
        ours = np.array([h.place == "term" for h in fitted.handles], bool)
        if not np.any(ours & (np.abs(error) > SIGNIFICANT * np.hypot(fitted.std, least))):
            break
        data = replace(best.data, inner=2 * best.data.inner)
        best = fit_scored(data, best.model, best.fit.handles, (joint,), jobs=jobs, rounds=1)
    return best


def _as_coulomb(best: Scored, joint: int, jobs: int) -> Scored:
    """Hysteresis that slides after a small part of the travel is Coulomb friction with a soft
    onset: name it so where that explains as much.
    """
    term = next((t for t in best.model.at(joint) if t.effect == "hysteresis"), None)
    record = best.data.records[0][joint - 1]
    if term is None:
        return best
    if term.value("force") > BENDS * term.value("stiffness") * facts(record).scale.position:
        return best
    others = tuple(t for t in best.model.terms if t is not term)
    handles = joint_handles(best.data, best.model.with_terms(others), joint)
    without = fit(best.data, best.model.with_terms(others), handles, joints=(joint,), jobs=jobs)
    loss = deviance(best.data, without.model, (joint,)) - best.deviance
    if any(t.effect == "coulomb" for t in others if t.joint == joint):
        named = make_term(get_effect("presliding"), joint, {"stiffness": term.value("stiffness")})
    else:
        named = make_term(get_effect("coulomb"), joint, {"level": term.value("force")})
    model = best.model.with_terms((*others, named))
    other = _refitted(best.data, model, joint, jobs, 1)
    return other if other.deviance - best.deviance < (1.0 - SUFFICIENT) * loss else best


def _as_bristles(found: JointSearch, best: Scored, n: int, jobs: int) -> Scored:
    """Hysteresis where the model had no dry friction is Coulomb friction and the bristles that it
    acts through, where that is surely likelier. No search sees the two one by one: in motion that
    never slides for long Coulomb friction alone is worse than nothing, and bristles need it.
    """
    new = best.model.at(found.joint)
    term = next((t for t in new if t.effect == "hysteresis"), None)
    names = {t.effect for t in (*new, *found.base.model.at(found.joint))}
    if term is None or is_supported(get_effect("presliding"), names - {"hysteresis"}):
        return best
    level, stiffness = term.value("force"), term.value("stiffness")
    record = best.data.records[0][found.joint - 1]
    damping = 0.1 * math.sqrt(stiffness * facts(record).inertia)
    friction = make_term(get_effect("coulomb"), found.joint, {"level": level})
    bristles = {"stiffness": stiffness, "damping": damping}
    soft = make_term(get_effect("presliding"), found.joint, bristles)
    rest = tuple(t for t in best.model.terms if t is not term)
    both = _refitted(
        best.data, best.model.with_terms((*rest, friction, soft)), found.joint, jobs, 3
    )
    return both if both.deviance < best.deviance - price((soft,), n) - NO_WORSE else best


def _as_symmetric(found: JointSearch, best: Scored, n: int, jobs: int) -> Scored:
    """An asymmetry that was found whose two directions are as good as equal is the symmetric effect
    in whose place it stands.
    """
    for name, effect in library().items():
        if not effect.symmetric:
            continue
        term = next((t for t in best.model.at(found.joint) if t.effect == name), None)
        if term is None or name in {t.effect for t in found.base.model.at(found.joint)}:
            continue
        mean = 0.5 * sum(q.value for q in term.parameters.values())
        plain = get_effect(effect.symmetric)
        one = make_term(plain, found.joint, {plain.linear[0]: mean})
        model = best.model.with_terms(tuple(one if t is term else t for t in best.model.terms))
        other = _refitted(best.data, model, found.joint, jobs, 1)
        if other.deviance < best.deviance + price((term,), n, (name,)):
            best = other
    return best


def _as_payload(found: JointSearch, best: Scored, n: int, jobs: int) -> Scored:
    """More inertia and a weaker actuator together are a payload, which adds inertia and gravity:
    name it so where that explains as much, and the actuator alone does not.
    """
    had = {t.effect for t in found.base.model.at(found.joint)}
    new = {t.effect: t for t in best.model.at(found.joint) if t.effect not in had}
    gravity = best.model.mechanism.get("gravity", ())
    if not {"torque_gain", "inertia"} <= set(new) or not any(q.value for q in gravity):
        return best
    rest = tuple(t for t in best.model.terms if t is not new["inertia"])
    alone = _refitted(best.data, best.model.with_terms(rest), found.joint, jobs, 2)
    if alone.deviance < best.deviance + price((new["inertia"],), n):
        return best
    weight = max(abs(q.value) for q in gravity) * max(abs(new["torque_gain"].value("ratio")), 0.01)
    load = make_term(get_effect("gravity"), found.joint, {"torque": weight, "angle": 0.0})
    model = best.model.with_terms(
        (*(t for t in best.model.terms if t is not new["torque_gain"]), load)
    )
    other = _refitted(best.data, model, found.joint, jobs, 2)
    return other if other.deviance < best.deviance + NO_WORSE else best


def _as_spring(found: JointSearch, best: Scored, jobs: int) -> Scored:
    """A hardening spring and a constant torque together imitate a linear spring off its neutral
    point: name it so where that explains as much.

    On a pendulum the weight that is calibrated takes the linear part, k q = k sin q + k q³ / 6 + …:
    it is given back.
    """
    had = {t.effect for t in found.base.model.at(found.joint)}
    new = {t.effect: t for t in best.model.at(found.joint) if t.effect not in had}
    if not {"cubic_stiffness", "torque_offset"} <= set(new):
        return best
    record = max((rec[found.joint - 1] for rec in best.data.records), key=lambda r: r.n)
    position = record.motion.states[0]
    hard, push = new["cubic_stiffness"], new["torque_offset"]
    slope = 3 * hard.value("coefficient") * float(np.mean((position - hard.value("neutral")) ** 2))
    if not slope > 0:
        return best
    centre = float(np.mean(position))
    mechanism = dict(best.model.mechanism)
    weight = mechanism.get("gravity", ())
    if any(q.free and q.value for q in weight):
        slope = 6 * hard.value("coefficient")
        mechanism["gravity"] = tuple(replace(q, value=q.value - slope) for q in weight)
    spring = make_term(
        get_effect("stiffness"),
        found.joint,
        {"coefficient": slope, "neutral": centre - push.value("level") / slope},
    )
    bare = best.model.with_terms(tuple(t for t in best.model.terms if t not in (hard, push)))
    model = replace(bare.with_terms((*bare.terms, spring)), mechanism=mechanism)
    other = _refitted(best.data, model, found.joint, jobs, 3)
    if other.deviance < best.deviance + NO_WORSE:
        return other
    without = _refitted(best.data, bare, found.joint, jobs, 2).deviance
    return other if without - other.deviance > AS_MUCH * (without - best.deviance) else best


def _as_two_times(found: JointSearch, best: Scored, n: int, jobs: int) -> Scored:
    """A delay that was found with the lag that it hides, or a lag with the delay: to first order
    they are one, so that no search beside the first sees the second.
    """
    had = {t.effect for t in found.base.model.at(found.joint)}
    new = {t.effect: t for t in best.model.at(found.joint) if t.effect not in had}
    names = {"delay": "time", "lag": "time_constant"}
    if len(names.keys() & (new.keys() | had)) != 1 or not names.keys() & new.keys():
        return best
    (here,) = names.keys() & new.keys()
    (other,) = names.keys() - {here}
    half = 0.5 * new[here].value(names[here])
    shorter = make_term(get_effect(here), found.joint, {names[here]: half})
    beside = make_term(get_effect(other), found.joint, {names[other]: half})
    rest = tuple(t for t in best.model.terms if t is not new[here])
    model = best.model.with_terms((*rest, shorter, beside))
    both = _refitted(best.data, model, found.joint, jobs, 3)
    return both if both.deviance < best.deviance - price((beside,), n) - NO_WORSE else best


def _as_delay(found: JointSearch, best: Scored, jobs: int) -> Scored:
    """A filtered position that a late command explains as well is one: every loop has some delay,
    and to first order the two are the same.
    """
    had = {t.effect for t in found.base.model.at(found.joint)}
    here = {t.effect: t for t in best.model.at(found.joint)}
    term = here.get("position_filter")
    if term is None or had & {"position_filter", "delay"} or "delay" in here:
        return best
    late = make_term(get_effect("delay"), found.joint, {"time": term.value("time_constant")})
    model = best.model.with_terms(tuple(late if t is term else t for t in best.model.terms))
    other = _refitted(best.data, model, found.joint, jobs, 1)
    return other if other.deviance < best.deviance + NO_WORSE else best


def simplify(found: JointSearch, n: int, jobs: int) -> tuple[Scored, tuple[str, ...]]:
    """Drop every term, given or found, that the recording does not need any more."""
    best = _resolved(straightened(found, found.final, jobs), found.joint, jobs)
    best = _as_bristles(found, _as_coulomb(best, found.joint, jobs), n, jobs)
    best = _as_spring(found, _as_payload(found, best, n, jobs), jobs)
    best = _as_delay(found, _as_symmetric(found, best, n, jobs), jobs)
    best = _as_two_times(found, best, n, jobs)
    dropped: list[str] = []
    added = {t.effect for s in found.steps for t in s.chosen.terms}
    while True:
        certain = with_step_error(best.data, best.fit, (found.joint,))
        for i, term in enumerate(best.model.terms):
            of_all = get_effect(term.effect).site == "body"  # every joint that moves it feels it
            known = not any(q.free for q in term.parameters.values())  # whoever holds it knows it
            if term.joint != found.joint or of_all or known or _needed_by(best.model, term):
                continue
            model = best.model.with_terms(
                tuple(t for k, t in enumerate(best.model.terms) if k != i)
            )
            if hopeless(best, model, found.joint, jobs) is not None:
                continue
            trial = _refitted(best.data, model, found.joint, jobs, 2)
            idle = term.effect in added and vanishes(certain, term)
            if idle or trial.deviance < best.deviance + price((term,), n):
                best = trial
                if term.effect not in added or term.effect in {
                    t.effect for t in found.base.model.at(found.joint)
                }:
                    dropped.append(term.effect)
                break
        else:
            return _released(found, best, n, jobs), tuple(dropped)


def _released(found: JointSearch, best: Scored, n: int, jobs: int) -> Scored:
    """The same with numbers fitted that the search only chose among, a curve's exponent, where the
    recording tells them: the others are as uncertain as these make them.
    """
    had = {t.effect for t in found.base.model.at(found.joint)}
    free = {
        id(t): {
            key
            for numbers in get_effect(t.effect).tries
            for key in numbers
            if not t.parameters[key].free
        }
        for t in best.model.at(found.joint)
        if t.effect not in had
    }
    if not any(free.values()):
        return best
    terms = tuple(
        replace(
            t,
            parameters={
                key: replace(q, free=q.free or key in free.get(id(t), ()))
                for key, q in t.parameters.items()
            },
        )
        for t in best.model.terms
    )
    other = _refitted(best.data, best.model.with_terms(terms), found.joint, jobs, 2)
    names = set().union(*free.values())
    at_bound = any(
        bound and h.key in names
        for h, bound in zip(other.fit.handles, other.fit.at_bound, strict=True)
    )
    told = other.deviance < best.deviance - math.log(max(n, 10))
    return other if told and not at_bound else best


def upon(first: JointSearch, base: Scored, jobs: int, both: Scored | None = None) -> JointSearch:
    """What a search found, upon a base that has terms of another source by now: fitted again, where
    ``both`` are not yet, and without what is not needed any more.
    """
    joint, found = first.joint, first.final
    more = base.model.terms[len(first.base.model.terms) :]
    model = found.model.with_terms((*found.model.terms, *more))
    best = both or _refitted(found.data, model, joint, jobs, 4)
    again = replace(first, base=base, best=best)
    again.best, dropped = simplify(again, informative(best.data, joint), jobs)
    return replace(again, dropped=(*first.dropped, *dropped))


def hopeless(best: Scored, model: Model, joint: int, jobs: int) -> Scored | None:
    """A model after a short fit, where that leaves it so much less likely that a long one would not
    make up for it.
    """
    handles = joint_handles(best.data, model, joint)
    short = fit(
        best.data,
        model,
        handles,
        joints=(joint,),
        iterations=4,
        tolerance=1e-2,
        jobs=jobs,
        brief=True,
    )
    data, value = tune_bandwidth(best.data, short.model, (joint,))
    if value <= best.deviance + SIMPLER_COST * informative(best.data, joint):
        return None
    return Scored(short, data, value, (joint,))


def _needed_by(model: Model, term: Term) -> bool:
    return any(
        term.effect in get_effect(t.effect).needs for t in model.at(term.joint) if t is not term
    )
