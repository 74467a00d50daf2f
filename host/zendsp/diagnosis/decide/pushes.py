"""Torque that comes and goes with time: pushes, alone or beside a friction that lacks too; and
recordings of a machine with another load.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import replace

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.pieces import dry_torque
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
)
from zendsp.diagnosis.measure.bursts import (
    FEW,
    MANY,
    OFTEN,
    STEADY,
    Bursts,
    apart,
    bursts,
    everywhere,
)
from zendsp.diagnosis.measure.discrepancy import beyond, discrepancy
from zendsp.diagnosis.measure.likelihood import Scored, fit_scored
from zendsp.diagnosis.measure.structure import MEMORY, STRUCTURED, Structure, structure
from zendsp.physics.calibration.fit import Data, joint_handles
from zendsp.physics.model import Model


def pushed(out: Decision, parts: Parts, jobs: int) -> Decision | None:
    """The decision with a disturbance, where one explains what lacks. It may come in any part of
    the data; one in the recordings of the fit alone bends the calibration, so that it may lack a
    function of the state, and is then that of the recordings to choose by.
    """
    joint, base, known = out.joint, out.base.model, out.known.all
    others = (discrepancy(part, base, joint).value for part in (parts.fit, parts.choose))
    somewhere = beyond(max(out.before.value, *others), known)
    if somewhere < LAWFUL or lost(parts, base, joint):
        return None
    # a push may lie where the held-out recording was cut, or in the recordings of the fit alone:
    # there what comes when the joint turns round may be its friction, however seldom
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
            # a push that bends numbers spoils them for all other times
            if without.beside < apart(without, each, base, joint)[1]:
                out = replace(out, final=other, after=after)
            else:
                here = own
    if here is None:
        return None
    both = everywhere(here, each, out.final.model, joint)
    if not comes_and_goes(both, parts) or by_own_numbers(out, parts, jobs, both.recordings):
        return None
    return replace(out, kind="disturbance", bursts=both)


def pushed_beside(
    out: Decision, models: Sequence[Scored], parts: Parts, turning: bool
) -> Bursts | None:
    """Pushes beside a friction that lacks too, and hides them: those that explain most beside one
    of the ``models``; None where there are none.
    """
    joint, best = out.joint, None
    for scored in models:
        model = scored.model
        if lost(parts, model, joint) or discrepancy(parts.fit, model, joint).value < LAWFUL:
            continue
        for found in (in_held(parts, model, joint, OFTEN), in_fit(parts, model, joint, MANY)):
            if found is None:
                continue
            both = everywhere(found, (parts.fit, parts.held), model, joint)
            if (
                comes_and_goes(both, parts)
                and (best is None or both.share > best.share)
                and not of_the_motion(replace(out, final=scored, bursts=both), parts, turning)
            ):
                best = both
    return best


def lost(parts: Parts, model: Model, joint: int) -> bool:
    """Whether a model runs away somewhere: what it lacks there nobody pushes with."""
    return any(not discrepancy(part, model, joint).value < ASTRAY for part in parts.each)


def comes_and_goes(found: Bursts, parts: Parts) -> bool:
    """Whether pushes hold most of what lacks, and are few: what comes often comes with the motion;
    and whether they do not ring, as a joint on its own spring does.
    """
    each = {rec[0].recording for part in (parts.fit, parts.held) for rec in part.records}
    few = found.spread <= FEW * len(each)
    return few and found.share >= PREDICTED and found.steady > STEADY


def of_the_motion(pushed: Decision, parts: Parts, turning: bool) -> bool:
    """Whether the state predicts a part of what lacks, or the motion before most of it: of a push
    from outside neither knows anything.
    """
    model, state = pushed.final.model, pushed.state
    if pushed.final is not pushed.base:
        state = structure(parts.each, model, pushed.joint, STRUCTURED, turning)
    if state.size > OF_STATE and predicts(state):
        return True
    memory = structure(parts.each, model, pushed.joint, [MEMORY], turning)
    return memory.share > PREDICTED and memory.z > PLAIN


def of_a_law(pushed: Decision, laws: Sequence[Model], parts: Parts) -> bool:
    """Whether one of some fitted laws takes up most of what acts in the times of a push, and lacks
    no more at other times: that law acts, or what resembles it, however little of it the recordings
    to judge on show. A law that is bent to a push spoils the other times.
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
    """A push in the recordings of the fit, beside what is claimed."""
    model, joint = decision.final.model, decision.joint
    if discrepancy(parts.fit, model, joint).value < LAWFUL:
        return None
    return in_fit(parts, model, joint)


def felt(out: Decision, parts: Parts, turning: bool) -> Bursts | None:
    """A push that is too small for a finding, where nothing else lacks: it is told all the same."""
    model, joint = out.base.model, out.joint
    lacks = max(out.before.value, discrepancy(parts.fit, model, joint).value)
    if out.kind != "complete" or beyond(lacks, out.known.all) < FELT:
        return None
    found = in_held(parts, model, joint, OFTEN) or in_fit(parts, model, joint)
    if found is None:
        return None
    both = everywhere(found, (parts.fit, parts.held), model, joint)
    alone = comes_and_goes(both, parts) and not of_the_motion(
        replace(out, bursts=both), parts, turning
    )
    if not alone:
        return None
    longest = max(b - a for a, b in both.intervals)
    long = [(b - a) > A_PART * longest for a, b in both.intervals]  # the others are their edges
    return replace(
        both,
        intervals=tuple(itertools.compress(both.intervals, long)),
        recordings=tuple(itertools.compress(both.recordings, long)),
    )


def in_held(parts: Parts, model: Model, joint: int, often: float) -> Bursts | None:
    """A push in the recordings that were held out."""
    dry = dry_torque(parts.held, model, joint)
    return bursts(parts.held, model, joint, parts.fit, dry=dry, often=often)


def in_fit(parts: Parts, model: Model, joint: int, many: int = FEW) -> Bursts | None:
    """A push in the recordings of the fit."""
    dry = dry_torque(parts.fit, model, joint)
    return bursts(parts.fit, model, joint, parts.held, many=many, dry=dry, often=0.0)


# --- nothing is named


def unpushed(decision: Decision) -> Decision:
    """The decision without a disturbance: of what comes and goes beside a load that swings unseen
    at another joint nobody can say that no state explains it.
    """
    if decision.kind != "disturbance":
        return replace(decision, bursts=None)
    lacks = beyond(decision.before.value, decision.known.all)
    surely = lacks > MACHINE and decision.before.low > 0.0
    return replace(
        decision,
        kind="unexplained" if surely else "complete",
        bursts=None,
        final=decision.base,
        after=decision.before,
    )


def by_own_numbers(
    out: Decision, parts: Parts, jobs: int, among: Collection[str] = ()
) -> tuple[str, ...]:
    """The recordings that lack something, where each is explained by numbers of its own: they are
    of a machine with another load. ``among``: of these alone; else of all.
    """
    joint, rows, usual = out.joint, [], math.inf
    for part in (parts.fit, parts.held):
        for rec in part.records:
            alone, name = replace(part, records=(rec,)), rec[joint - 1].recording
            lacks, left = discrepancy(alone, out.final.model, joint).value, 0.0
            if lacks > LAWFUL and (name in among or not among):
                own = discrepancy(alone, fitted_to(alone, out.final, joint, jobs).model, joint)
                left = own.value
                rows.append((name, lacks, left))
            if part is parts.fit:  # what the machine leaves with any numbers is no load
                usual = min(usual, own.high if left else LAWFUL)
    found = [row for row in rows if row[1] > max(LAWFUL, usual)]
    if any(
        left > max(LAWFUL, usual) or left**2 > (1.0 - PREDICTED) * lacks**2
        for _, lacks, left in found
    ):
        return ()
    return tuple(dict.fromkeys(name for name, _, _ in found))


def fitted_to(data: Data, base: Scored, joint: int, jobs: int) -> Scored:
    """The model calibrated on other recordings."""
    data = data.at_bandwidth(joint, base.data.bandwidth[joint - 1])
    handles = joint_handles(data, base.model, joint)
    return fit_scored(data, base.model, handles, (joint,), jobs=jobs, rounds=2)


def predicts(found: Structure) -> bool:
    """Whether what was learned on other recordings predicts what lacks, and not by chance."""
    return found.z > SURE or found.apart > BY_CHANCE
