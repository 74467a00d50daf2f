"""Torque that comes and goes with time: pushes, alone or beside missing friction; and recordings of
a machine with another load.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import replace

from zendsp.diagnosis.data.inertia import inertia_ranges
from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.law_torque import dry_torque, rubs
from zendsp.diagnosis.decide.thresholds import (
    A_PART,
    ASTRAY,
    BY_CHANCE,
    FELT,
    LAWFUL,
    MACHINE,
    OF_STATE,
    PLAIN,
    PREDICTED,
    SURE,
    VISITED,
)
from zendsp.diagnosis.measure.bursts import (
    BRIEF,
    FEW,
    MANY,
    OFTEN,
    STEADY,
    Bursts,
    apart,
    bursts,
    everywhere,
    part_of_the_time,
)
from zendsp.diagnosis.measure.discrepancy import beyond, discrepancy, surely_beyond
from zendsp.diagnosis.measure.likelihood import Scored, fit_scored
from zendsp.diagnosis.measure.structure import MEMORY, STRUCTURED, Structure, structure
from zendsp.diagnosis.measure.touched import other_visits
from zendsp.physics.calibration.fit import Data, joint_handles
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.model import Model


def pushed(out: Decision, parts: Parts, jobs: int) -> Decision | None:
    """The decision with a disturbance, where one explains the missing torque. It may lie in any
    part of the data. One in the recordings of the fit alone bends the calibration, which then seems
    to lack a function of the state; so the model calibrated on the recordings to choose by is tried
    too.
    """
    joint, base, known = out.joint, out.base.model, out.known.all
    others = (discrepancy(part, base, joint).value for part in (parts.fit, parts.choose))
    somewhere = beyond(max(out.before.value, *others), known)
    if somewhere < LAWFUL or lost(parts, base, joint):
        return None
    # a push may lie at the cut of the held-out recording, or in the recordings of the fit alone:
    # there a torque at reversals may be friction, however seldom it comes
    often = OFTEN if beyond(out.before.value, known) > LAWFUL else 0.0
    held = here = None
    if out.state.share < PREDICTED:
        held = in_held(parts, base, joint, often)
        here = held or in_fit(parts, base, joint)
    bent = held is None or bool(
        everywhere(held, (parts.fit,), base, joint).intervals
        and not everywhere(held, (parts.choose,), base, joint).intervals
    )
    each, own = (parts.fit, parts.held), here
    if bent:
        other = fitted_to(parts.choose, out.base, joint, jobs)
        after = discrepancy(parts.test, other.model, joint)
        if held is None and beyond(after.value, known) < LAWFUL:
            here = in_fit(parts, other.model, joint, MANY) or here
        elif here is None and out.state.share < PREDICTED:
            here = in_held(parts, other.model, joint, often)
        if here is not None and after.value <= out.before.value:
            without = everywhere(here, each, other.model, joint)
            # a push that bends numbers makes them wrong at all other times
            if without.beside < apart(without, each, base, joint)[1]:
                out = replace(out, final=other, after=after)
            else:
                here = own
    if here is None:
        return None
    both = everywhere(here, each, out.final.model, joint)
    if not comes_and_goes(both, parts, joint) or by_own_numbers(out, parts, jobs, both.recordings):
        return None
    return replace(out, kind=Verdict.DISTURBANCE, bursts=both)


def pushed_beside(
    out: Decision, models: Sequence[Scored], parts: Parts, turning: bool, jobs: int
) -> Bursts | None:
    """The pushes beside a missing friction, which hides them: those that explain most beside one of
    the ``models``; None where there are none.

    Of a machine of several joints only pushes in the recordings of the fit count: a torque that the
    held-out ones lack, or lack otherwise, may be a wrong body. A KUKA without its load had been
    called pushed.
    """
    joint, best, alone = out.joint, None, parts.fit.joints == 1
    where = parts.each if alone else (parts.fit,)
    for scored in _with_numbers_of_the_held(models, parts, joint, jobs) if alone else models:
        model = scored.model
        # a push in held-out recordings takes the evidence of what is missing, or stands beside it
        lacks = max(discrepancy(part, model, joint).value for part in where)
        if lost(parts, model, joint) or lacks < LAWFUL:
            continue
        held = in_held(parts, model, joint, OFTEN) if alone else None
        for found in (held, in_fit(parts, model, joint, MANY)):
            if found is None:
                continue
            both = everywhere(found, (parts.fit, parts.held), model, joint)
            if (
                comes_and_goes(both, parts, joint)
                and (best is None or both.share > best.share)
                and not of_the_motion(replace(out, final=scored, bursts=both), parts, turning)
            ):
                best = both
    return best


def _with_numbers_of_the_held(
    models: Sequence[Scored], parts: Parts, joint: int, jobs: int
) -> list[Scored]:
    """The models, and more: each that lacks torque in the recordings of the fit is also fitted to
    the recordings to choose by, and kept where this explains the test recordings better. A push in
    the recordings of the fit bends all numbers, and a bent model lacks something everywhere.
    """
    each = list(models)
    for scored in models:
        if lost(parts, scored.model, joint):
            continue
        lacks = [discrepancy(part, scored.model, joint).value for part in (parts.fit, parts.test)]
        if lacks[0] >= LAWFUL:
            other = fitted_to(parts.choose, scored, joint, jobs)
            if discrepancy(parts.test, other.model, joint).value < lacks[1]:
                each.append(other)
    return each


def lost(parts: Parts, model: Model, joint: int) -> bool:
    """Whether a model diverges somewhere, where its missing torque is no push."""
    return any(not discrepancy(part, model, joint).value < ASTRAY for part in parts.each)


def comes_and_goes(found: Bursts, parts: Parts, joint: int) -> bool:
    """Whether pushes hold most of the missing torque, are few (what comes often belongs to the
    motion) and brief, and do not ring as a joint on a spring does. (A pendulum that swings in a
    carriage was a push of 11 s in 20, and of 2 s in 20 more.)
    """
    if any(part_of_the_time(found, part, joint) > BRIEF for part in (parts.fit, parts.held)):
        return False
    each = {rec[0].recording for part in (parts.fit, parts.held) for rec in part.records}
    few = found.spread <= FEW * len(each)
    return few and found.share >= PREDICTED and found.steady > STEADY


def of_the_motion(pushed: Decision, parts: Parts, turning: bool) -> bool:
    """Whether the state predicts a part of the missing torque, or the earlier motion most of it.
    Neither can predict a push from outside.
    """
    model, state = pushed.final.model, pushed.state
    if pushed.final is not pushed.base:
        state = structure(parts.each, model, pushed.joint, STRUCTURED, turning)
    if state.size > OF_STATE and predicts(state):
        return True
    memory = structure(parts.each, model, pushed.joint, [MEMORY], turning)
    return (memory.share > PREDICTED and memory.z > PLAIN) or of_the_place(pushed, parts)


def of_the_place(pushed: Decision, parts: Parts) -> bool:
    """Whether a push may as well be something that the joint touches: other visits to its places,
    however light, predict most of it, or the joint hardly was there otherwise. A law beside the
    push may be bent to that, so the calibrated model is asked too.
    """
    if pushed.bursts is None:
        return False
    models = {id(s.model): s.model for s in (pushed.final, pushed.base)}.values()
    each = (parts.fit, parts.held)
    own, *others = (other_visits(pushed.bursts, each, m, pushed.joint) for m in models)
    return own.share < VISITED or any(v.predicted > PREDICTED for v in (own, *others))


def of_a_law(pushed: Decision, laws: Sequence[Model], parts: Parts) -> bool:
    """Whether a fitted law explains most of the torque at the times of a push without making other
    times worse. Then that law acts, or one that resembles it, however little the test recordings
    show of it. A law bent to a real push makes the other times worse.
    """
    if pushed.bursts is None:
        return False
    each = (parts.fit, parts.held)
    (acts, beside), *left = (
        apart(pushed.bursts, each, m, pushed.joint) for m in (pushed.final.model, *laws)
    )
    most = (1.0 - PREDICTED) * acts**2
    return any(within**2 < most and outside <= beside for within, outside in left)


def beside(decision: Decision, parts: Parts) -> Bursts | None:
    """The push in the recordings of the fit, or a small one anywhere, beside what is claimed."""
    model, joint = decision.final.model, decision.joint
    if discrepancy(parts.fit, model, joint).value < LAWFUL:
        return felt(decision, parts, not rubs(model, joint))
    return in_fit(parts, model, joint)


def felt(out: Decision, parts: Parts, turning: bool) -> Bursts | None:
    """The push that is too small for a finding; it is noted."""
    model, joint = out.final.model, out.joint
    others = (discrepancy(part, model, joint).value for part in (parts.fit, parts.choose))
    lacks = max(out.after.value, *others)
    if out.kind == Verdict.DISTURBANCE or beyond(lacks, out.known.all) < FELT:
        return None
    found = in_held(parts, model, joint, OFTEN) or in_fit(parts, model, joint)
    if found is None:
        return None
    both = everywhere(found, (parts.fit, parts.held), model, joint)
    alone = comes_and_goes(both, parts, joint) and not of_the_motion(
        replace(out, bursts=both), parts, turning
    )
    if not alone:
        return None
    longest = max(b - a for a, b in both.intervals)
    long = [(b - a) > A_PART * longest for a, b in both.intervals]  # shorter ones are their edges
    return replace(
        both,
        intervals=tuple(itertools.compress(both.intervals, long)),
        recordings=tuple(itertools.compress(both.recordings, long)),
    )


def in_held(parts: Parts, model: Model, joint: int, often: float) -> Bursts | None:
    """The push in the held-out recordings."""
    dry = dry_torque(parts.held, model, joint)
    return bursts(parts.held, model, joint, parts.fit, dry=dry, often=often)


def in_fit(parts: Parts, model: Model, joint: int, many: int = FEW) -> Bursts | None:
    """The push in the recordings of the fit."""
    dry = dry_torque(parts.fit, model, joint)
    return bursts(parts.fit, model, joint, parts.held, many=many, dry=dry, often=0.0)


# --- nothing is named


def unpushed(decision: Decision) -> Decision:
    """The decision without its disturbance. Beside an unseen swinging load at another joint, a
    torque that comes and goes may depend on that load's state.
    """
    if decision.kind != Verdict.DISTURBANCE:
        return replace(decision, bursts=None)
    surely = surely_beyond(decision.before, decision.known.all) > MACHINE
    return replace(
        decision,
        kind=Verdict.UNEXPLAINED if surely else Verdict.COMPLETE,
        bursts=None,
        final=decision.base,
        after=decision.before,
    )


def by_own_numbers(
    out: Decision, parts: Parts, jobs: int, among: Collection[str] = ()
) -> tuple[str, ...]:
    """The recordings that lack torque with the model's numbers, where each is explained by its own:
    they are of a machine with another load. ``among``: only these are considered, otherwise all.
    """
    joint, rows, usual = out.joint, [], math.inf
    for part in (parts.fit, parts.held):
        for rec in part.records:
            alone, name = these_alone(part, (rec,), out.final.model), rec[joint - 1].recording
            lacks, left = discrepancy(alone, out.final.model, joint).value, 0.0
            if lacks > LAWFUL and (name in among or not among):
                own = discrepancy(alone, fitted_to(alone, out.final, joint, jobs).model, joint)
                left = own.value
                rows.append((name, lacks, left))
            if part is parts.fit:  # what stays with any numbers is no load
                usual = min(usual, own.high if left else LAWFUL)
    found = [row for row in rows if row[1] > max(LAWFUL, usual)]
    if any(
        left > max(LAWFUL, usual) or left**2 > (1.0 - PREDICTED) * lacks**2
        for _, lacks, left in found
    ):
        return ()
    return tuple(dict.fromkeys(name for name, _, _ in found))


def these_alone(
    data: Data, records: tuple[tuple[JointRecord, ...], ...], model: Model
) -> Data:
    """Some recordings, within whose own inertia a fit has to stay: that of all together held a load
    25 % heavier at half of the difference.
    """
    return replace(data, records=records, ranges=inertia_ranges(records, model))


def fitted_to(data: Data, base: Scored, joint: int, jobs: int) -> Scored:
    """The fit of the model calibrated on other recordings."""
    data = data.at_bandwidth(joint, base.data.bandwidth[joint - 1])
    handles = joint_handles(data, base.model, joint)
    return fit_scored(data, base.model, handles, (joint,), jobs=jobs, rounds=2)


def predicts(found: Structure) -> bool:
    """Whether a function learned on other recordings predicts the missing torque, and not by
    chance.
    """
    return found.z > SURE or found.apart > BY_CHANCE
