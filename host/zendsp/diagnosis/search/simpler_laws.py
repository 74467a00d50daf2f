"""Laws that stand for simpler ones: where another law explains as much, or two laws one, the model
has that.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.measure.likelihood import Scored, deviance, fit_scored
from zendsp.diagnosis.measure.significance import INTEGRATION_ERROR, SIGNIFICANT, vanishes
from zendsp.diagnosis.search.hypothesis import SUFFICIENT, JointSearch, price
from zendsp.physics.calibration.convergence import with_step_error
from zendsp.physics.calibration.fit import Data, fit, joint_handles
from zendsp.physics.calibration.joint import facts, off_counts, own_weight
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect, is_supported, library
from zendsp.physics.effects.column_shift import least_shift
from zendsp.physics.model import Model, Term

NO_WORSE = 10.0  # deviance that a simpler law may cost
# Part of what a law of timing explains: where a filter after the counts colours the noise, the
# noise alone may tell it from another law by as much. A true filter fell 0.017 behind a delay (seed
# 902, case 84). So may a second law below the least shift: a filter of 0.2 to 0.6 rows beside a
# delay of 1 to 6 cost 0.001 to 0.007 to leave out, one that was the sampling alone 0.001
COLOURED = 0.03
# share of the common gain of two laws that one in their place must have; a true spring of a
# pendulum with a coarse encoder had 98 % (seed 144, case 28), and did better on untouched data
AS_MUCH = 0.95
BENDS = 0.02  # of the travel: hysteresis that slides after less is dry friction with a soft onset
STRAIGHT = 2.0  # force of a hysteresis over its spring's largest torque: above, it is a spring


def refitted(
    data: Data, model: Model, joint: int, jobs: int, rounds: int, goal: float = math.inf
) -> Scored:
    """The fit of all free numbers that a joint feels, with its bandwidth."""
    handles = joint_handles(data, model, joint)
    return fit_scored(data, model, handles, (joint,), jobs=jobs, rounds=rounds, goal=goal)


def split_asymmetry(found: JointSearch, current: Scored, jobs: int) -> Scored:
    """The model with an asymmetric Coulomb friction split into Coulomb friction and an offset,
    where the model had no such friction. An offset that the model holds changes accordingly.
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
    least = current.deviance + NO_WORSE
    other = refitted(current.data, model, found.joint, jobs, 1, least)
    return other if other.deviance < least else current


def straightened(found: JointSearch, current: Scored, jobs: int) -> Scored:
    """The model with a hysteresis replaced by a spring, where its force is far from being reached
    and the spring explains as much. The hysteresis was found for a spring and a dry friction
    together, when both were missing.
    """
    had = {t.effect for t in found.base.model.at(found.joint)}
    here = current.model.at(found.joint)
    term = next((t for t in here if t.effect == "hysteresis"), None)
    if term is None or had & {"hysteresis", "stiffness"}:
        return current
    record = max((rec[found.joint - 1] for rec in current.data.records), key=lambda r: r.n)
    if term.value("force") < STRAIGHT * term.value("stiffness") * facts(record).scale.position:
        return current
    begin = float(record.motion.states[0][0])  # where its bristle is unbent
    numbers = {"coefficient": term.value("stiffness"), "neutral": begin}
    spring = make_term(get_effect("stiffness"), found.joint, numbers)
    others = (t for t in current.model.terms if t is not term)
    model, least = current.model.with_terms((*others, spring)), current.deviance + NO_WORSE
    other = refitted(current.data, model, found.joint, jobs, 3, least)
    return other if other.deviance < least else current


def in_simpler_laws(found: JointSearch, best: Scored, n: int, jobs: int) -> Scored:
    """The model of a search with each law that a simpler one replaces, or that was found for two.

    Parameters
    ----------
    found : JointSearch
        What the search began with.
    best : Scored
        Its last model, or one near it.
    n : int
        Samples that say something, for the price of a law.
    jobs : int
        Threads.
    """
    best = _as_bristles(found, _as_coulomb(best, found.joint, jobs), n, jobs)
    best = _as_payload(found, _as_inertia(found, best, n, jobs), n, jobs)
    best = _as_spring(found, best, jobs)
    best = _as_one_time(found, _as_symmetric(found, best, n, jobs), jobs)
    best = _as_saturation(found, _as_delay(found, best, jobs), n, jobs)
    return _as_two_times(found, best, n, jobs)


def _as_coulomb(best: Scored, joint: int, jobs: int) -> Scored:
    """The model with a hysteresis that slides after a small part of the travel replaced by Coulomb
    friction, where that explains as much.
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
    least = best.deviance + (1.0 - SUFFICIENT) * loss
    other = refitted(best.data, model, joint, jobs, 1, least)
    return other if other.deviance < least else best


def _as_bristles(found: JointSearch, best: Scored, n: int, jobs: int) -> Scored:
    """The model with a hysteresis replaced by Coulomb friction and bristles, where the model had no
    dry friction and that is surely likelier. No search finds the two one by one: in motion that
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
    model = best.model.with_terms((*rest, friction, soft))
    least = best.deviance - price((soft,), n) - NO_WORSE
    both = refitted(best.data, model, found.joint, jobs, 3, least)
    return both if both.deviance < least else best


def _as_symmetric(found: JointSearch, best: Scored, n: int, jobs: int) -> Scored:
    """The model with a found asymmetry replaced by the symmetric effect, where both directions are
    nearly equal.
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
        least = best.deviance + price((term,), n, (name,))
        other = refitted(best.data, model, found.joint, jobs, 1, least)
        best = other if other.deviance < least else best
    return best


def _as_payload(found: JointSearch, best: Scored, n: int, jobs: int) -> Scored:
    """The model with more inertia and a weaker actuator replaced by a payload (inertia and
    gravity), where that explains as much and the actuator alone does not.
    """
    had = {t.effect for t in found.base.model.at(found.joint)}
    new = {t.effect: t for t in best.model.at(found.joint) if t.effect not in had}
    own = own_weight(best.model, found.joint)
    if not {"torque_gain", "inertia"} <= set(new) or own is None:
        return best
    # what two simulators differ by is no body: gain and body exchange exactly, but for this inertia
    record = best.data.records[0][found.joint - 1]
    least = SIGNIFICANT * INTEGRATION_ERROR * facts(record).inertia
    if abs(new["inertia"].value("amount")) < least:
        return best
    rest = tuple(t for t in best.model.terms if t is not new["inertia"])
    alone = refitted(best.data, best.model.with_terms(rest), found.joint, jobs, 2)
    if alone.deviance < best.deviance + price((new["inertia"],), n):
        return best
    torque = own[0] * max(abs(new["torque_gain"].value("ratio")), 0.01)
    load = make_term(get_effect("gravity"), found.joint, {"torque": torque, "angle": own[1]})
    model = best.model.with_terms(
        (*(t for t in best.model.terms if t is not new["torque_gain"]), load)
    )
    other = refitted(best.data, model, found.joint, jobs, 2)
    return other if other.deviance < best.deviance + NO_WORSE else best


def _as_inertia(found: JointSearch, best: Scored, n: int, jobs: int) -> Scored:
    """The model with a wrong gain, and given friction of other numbers beside it, replaced by an
    inertia and the friction as given, where that explains as much: a weaker drive is a heavier body
    with more friction of every kind, exactly.
    """
    here = {t.effect: t for t in best.model.at(found.joint)}
    given = {t.effect: t for t in found.base.model.at(found.joint)}
    freed = [t for e, t in given.items() if e in here and _freed(t, here[e])]
    gain = here.get("torque_gain")
    if gain is None or not freed or {"torque_gain", "inertia"} & set(given) or "inertia" in here:
        return best
    factor = 1.0 / (1.0 + gain.value("ratio"))
    own = facts(best.data.records[0][found.joint - 1]).inertia
    instead = {id(here[t.effect]): t for t in freed}
    amount = {"amount": own * (factor - 1.0)}
    instead[id(gain)] = make_term(get_effect("inertia"), found.joint, amount)
    if "gravity" in here and "gravity" not in given:
        weight = {name: q.value for name, q in here["gravity"].parameters.items()}
        weight["torque"] *= factor
        load = make_term(get_effect("gravity"), found.joint, weight)
        instead[id(here["gravity"])] = load
    model = best.model.with_terms(tuple(instead.get(id(t), t) for t in best.model.terms))
    least = best.deviance + price(freed, n) + NO_WORSE
    other = refitted(best.data, model, found.joint, jobs, 2, least)
    return other if other.deviance < least else best


def _freed(given: Term, here: Term) -> bool:
    """Whether a term has numbers free that the given one holds."""
    return any(here.parameters[n].free for n, q in given.parameters.items() if not q.free)


def _as_spring(found: JointSearch, best: Scored, jobs: int) -> Scored:
    """The model with a hardening spring and a constant torque replaced by a linear spring with a
    neutral point, where that explains as much.

    On a pendulum the calibrated weight has absorbed the linear part, k q = k sin q + k q³ / 6 + …,
    and returns it.
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
    other = refitted(best.data, model, found.joint, jobs, 3)
    if other.deviance < best.deviance + NO_WORSE:
        return other
    without = refitted(best.data, bare, found.joint, jobs, 2).deviance
    return other if without - other.deviance > AS_MUCH * (without - best.deviance) else best


def _as_two_times(found: JointSearch, best: Scored, n: int, jobs: int) -> Scored:
    """The model with a found delay joined by a lag, or a lag by a delay. To first order they are
    equal, so no search finds the second beside the first.
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
    least = best.deviance - price((beside,), n) - NO_WORSE
    both = refitted(best.data, model, found.joint, jobs, 3, least)
    return both if both.deviance < least else best


def _as_one_time(found: JointSearch, best: Scored, jobs: int) -> Scored:
    """The model with two laws of timing replaced by one, a delay or a column that is late, where
    one of the two is so short that it may only be how rows are sampled, and the one explains nearly
    as much. Split over two mechanisms a delay would be claimed of neither.
    """
    had = {t.effect for t in found.base.model.at(found.joint)}
    new = [t for t in best.model.at(found.joint) if t.effect not in had]
    times = {t.effect: _lateness(t) for t in new if get_effect(t.effect).family == "timing"}
    record = best.data.records[0][found.joint - 1]
    least = least_shift(record.sample_time, record.between > 0.0)
    if len(times) != 2 or not min(map(abs, times.values())) < least:
        return best
    total = sum(times.values())
    name = "delay" if total > 0.0 else "column_shift"
    one = make_term(get_effect(name), found.joint, {"time": abs(total)})
    rest = [t for t in best.model.terms if not (t.joint == found.joint and t.effect in times)]
    most = max(NO_WORSE, COLOURED * (found.base.deviance - best.deviance))
    goal = best.deviance + most
    other = refitted(best.data, best.model.with_terms((*rest, one)), found.joint, jobs, 2, goal)
    return other if other.deviance < goal else best


def _lateness(term: Term) -> float:
    """The time by which a law of timing makes the motion late, s."""
    time = term.value(get_effect(term.effect).parameters[0].name)
    return -time if term.effect == "column_shift" else time


def _as_saturation(found: JointSearch, best: Scored, n: int, jobs: int) -> Scored:
    """The model with a voltage limit that does not fall with the speed replaced by a saturation,
    where that explains as much. Beside a friction that was still missing it was the likelier one:
    the fall imitated the friction.
    """
    had = {t.effect for t in found.base.model.at(found.joint)}
    here = {t.effect: t for t in best.model.at(found.joint)}
    term = here.get("voltage_limit")
    if term is None or {"voltage_limit", "saturation"} & had or "saturation" in here:
        return best
    if not vanishes(with_step_error(best.data, best.fit, (found.joint,)), term):
        return best
    gain = abs(facts(best.data.records[0][found.joint - 1]).gain) or 1.0
    flat = make_term(get_effect("saturation"), found.joint, {"level": term.value("level") / gain})
    model = best.model.with_terms(tuple(flat if t is term else t for t in best.model.terms))
    least = best.deviance + price((term,), n) - price((flat,), n)
    other = refitted(best.data, model, found.joint, jobs, 2, least)
    return other if other.deviance < least else best


def _as_delay(found: JointSearch, best: Scored, jobs: int) -> Scored:
    """The model with a filter of the position replaced by a late command, where that explains as
    much, but for the noise. Every loop has some delay, and to first order the two are equal.
    """
    had = {t.effect for t in found.base.model.at(found.joint)}
    here = {t.effect: t for t in best.model.at(found.joint)}
    term = here.get("position_filter")
    if term is None or had & {"position_filter", "delay"} or "delay" in here:
        return best
    late = make_term(get_effect("delay"), found.joint, {"time": term.value("time_constant")})
    model = best.model.with_terms(tuple(late if t is term else t for t in best.model.terms))
    coloured = off_counts(best.data.records[0][found.joint - 1], model)
    noise = COLOURED * (found.base.deviance - best.deviance) if coloured else 0.0
    least = best.deviance + max(NO_WORSE, noise)
    other = refitted(best.data, model, found.joint, jobs, 1, least)
    return other if other.deviance < least else best
