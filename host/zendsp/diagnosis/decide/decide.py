"""The decision: which mechanisms are claimed, by which law, and what is said of the rest.

One principle (docs/diagnosis.md, "How it decides"): a recording is the named physics, a discrepancy
that nobody has named, and the sensor. A finding is a mechanism without which the discrepancy must
grow, on recordings that neither the fit nor any choice has touched. The search proposes; here every
mechanism that it wrote down is taken away, everything else is fitted again, and what that costs
decides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Claim, Decision, Piece
from zendsp.diagnosis.decide.findings import new_terms, percent
from zendsp.diagnosis.decide.laws import believed, by_its_variables, named
from zendsp.diagnosis.decide.pieces import (
    dry_torque,
    finest,
    grouped,
    held_apart,
    kind_of,
    known_discrepancy,
    piece_of,
    rms_torque,
    rubs,
    sure,
    worth_choosing,
)
from zendsp.diagnosis.decide.thresholds import (
    AMISS,
    BEYOND_SENSOR,
    BY_CHANCE,
    CLAIMED,
    LAWFUL,
    MACHINE,
    OF_STATE,
    PLAIN,
    PREDICTED,
    RIVAL,
    RUN_AWAY,
    SURE,
)
from zendsp.diagnosis.measure.bursts import FEW, MANY, OFTEN, Bursts, bursts, everywhere, periodic
from zendsp.diagnosis.measure.discrepancy import Size, beyond, discrepancy
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.likelihood import Scored, fit_scored, informative
from zendsp.diagnosis.measure.structure import MEMORY, STRUCTURED, Structure, structure
from zendsp.diagnosis.measure.windows import noise_floor, rms, window_error
from zendsp.diagnosis.search.hypothesis import JointSearch, Rival
from zendsp.diagnosis.search.rounds import WAIT
from zendsp.diagnosis.search.simplify import simplify
from zendsp.physics.calibration.fit import Data, joint_handles
from zendsp.physics.model import Model, Quantity, Term

Array = npt.NDArray[np.float64]
Progress = Callable[[str], None]


def decide(parts: Parts, given: Model, search: JointSearch, jobs: int, tell: Progress) -> Decision:
    """Decide what is claimed at one joint.

    Parameters
    ----------
    parts : Parts
        Recordings to fit to, to choose by, and to test on.
    search : JointSearch
        What the search proposes.
    jobs : int
        Threads.
    tell : callable
        Receives a sentence at each stage.
    """
    joint, base = search.joint, search.base
    tell(f"joint {joint}: what each mechanism is worth")
    final = worth_choosing(parts, given, search, jobs)
    before = discrepancy(parts.test, base.model, joint)
    new = new_terms(given, final.model, joint)
    pieces: list[Piece] = []
    if new:
        pieces = [
            piece_of(parts.test, given, final, key[0], terms, base, jobs)
            for key, terms in grouped(given, final.model, new).items()
        ]
        pieces.sort(key=lambda p: -p.size)
        claimed, rest = held_apart(parts, given, search, final, pieces)
        if not claimed:
            sounder = find_sounder(parts, search, final, pieces, jobs)
            if sounder is not None:
                return decide(parts, given, sounder, jobs, tell)
        if claimed:
            first = named(parts, given, search, final, claimed, rest, before, jobs, tell)
            other = _exchanged(parts, search, final, first, jobs)
            if other is not None:
                return decide(parts, given, other, jobs, tell)
            decision = believed(first, parts, given, jobs)
            errors = [
                rms(window_error(parts.test, m, joint)) for m in (base.model, decision.final.model)
            ]
            # what makes an untouched recording worse is no finding, ever; nor what leaves more
            # torque unexplained than there was, or than there is (a spring that holds a joint)
            least = min(before.value, 1.0)
            better = errors[1] <= errors[0] and decision.after.value <= least
            if decision.claims and better:
                if any(c.effect != "unknown" for c in decision.claims):
                    return replace(decision, beside=_beside(decision, parts))
                # which mechanism, if any, is for the lacking torque itself to say
                plain = _nothing_named(parts, given, search, before, pieces, jobs)
                most = decision.after.value**2 < (1.0 - PREDICTED) * before.value**2
                kind = kind_of(decision.claims[0].mechanism)
                same = any(c.mechanism in kind for c in plain.claims)
                stands = plain.kind == "complete" or (most and not plain.claims) or same
                if len(decision.claims) == 1:
                    return decision if stands else plain
                # several mechanisms, and no law of any: it is one torque that nobody knows
                return replace(plain, kind="unexplained") if plain.kind == "complete" else plain
    nothing = _nothing_named(parts, given, search, before, pieces, jobs)
    several = len({rec[0].recording for part in parts.each for rec in part.records}) > 1
    if nothing.kind != "unexplained" or not several:
        return nothing
    return replace(nothing, loads=_by_own_numbers(nothing, parts, jobs))


def _exchanged(
    parts: Parts, search: JointSearch, final: Scored, first: Decision, jobs: int
) -> JointSearch | None:
    """The search with a likelier law in the place of a claimed one; None where there is none, or
    where in its simplest words it is no likelier: each exchange is a gain, so that they end.
    """
    for claim in first.claims:
        if claim.instead is not None:
            other = replace(search, best=claim.instead)
            other.best, _ = simplify(other, informative(parts.fit, search.joint), jobs)
            if other.best.deviance < final.deviance - WAIT:
                return other
    return None


def find_sounder(
    parts: Parts, search: JointSearch, final: Scored, pieces: Sequence[Piece], jobs: int
) -> JointSearch | None:
    """The search to decide upon where nothing that it proposed can be claimed; None where nothing
    is left to try.

    Where it ended in what runs away on recordings that it was not fitted to, its next first step
    alone. Else its first step, where others followed: what they take up of the discrepancy between
    machine and model bends them, and costs the first its evidence.
    """
    if any(p.size > RUN_AWAY for p in pieces):
        there = {t.effect for t in final.model.at(search.joint)}
        for k, rival in enumerate(search.tried):
            gain = search.base.deviance - rival.scored.deviance
            if rival.effect not in there and gain > WAIT:
                return _with_best(replace(search, tried=search.tried[k + 1 :]), rival, parts, jobs)
        return None
    if len(search.steps) < 2:
        return None
    first = search.steps[0]
    return _with_best(replace(search, steps=[first]), first.chosen, parts, jobs)


def _with_best(search: JointSearch, rival: Rival, parts: Parts, jobs: int) -> JointSearch:
    """The search with one hypothesis alone as its best model, in its simplest words."""
    other = replace(search, best=rival.scored)
    other.best, _ = simplify(other, informative(parts.fit, search.joint), jobs)
    return other


def _beside(decision: Decision, parts: Parts) -> Bursts | None:
    """A push in the recordings of the fit, beside what is claimed."""
    model, joint = decision.final.model, decision.joint
    if discrepancy(parts.fit, model, joint).value < LAWFUL:
        return None
    return _in_fit(parts, model, joint)


def _in_held(parts: Parts, model: Model, joint: int, often: float) -> Bursts | None:
    """A push in the recordings that were held out."""
    dry = dry_torque(parts.held, model, joint)
    return bursts(parts.held, model, joint, parts.fit, dry=dry, often=often)


def _in_fit(parts: Parts, model: Model, joint: int, many: int = FEW) -> Bursts | None:
    """A push in the recordings of the fit."""
    dry = dry_torque(parts.fit, model, joint)
    return bursts(parts.fit, model, joint, parts.held, many=many, dry=dry, often=0.0)


# --- nothing is named


def _nothing_named(
    parts: Parts,
    given: Model,
    search: JointSearch,
    before: Size,
    pieces: Sequence[Piece],
    jobs: int,
) -> Decision:
    """Complete, a disturbance, a mechanism without a law, or unexplained: decided by the calibrated
    model's discrepancy alone. ``pieces`` are the mechanisms that were asked, for what is said of
    them.
    """
    joint, base = search.joint, search.base
    # how a known dry friction turns round is no missing physics: bristles, a simulator's softness
    turning = not rubs(base.model, joint)
    state = structure(parts.each, base.model, joint, STRUCTURED, turning)
    out = Decision(
        joint,
        "complete",
        (),
        (),
        base,
        base,
        before,
        before,
        state,
        before,
        base,
        rms_torque(parts.test, joint),
        known=known_discrepancy(given, parts.test, joint),
        lost=tuple(_why(r, base, pieces, before) for r in search.tried[:6]),
    )
    pushed = _pushed(out, parts, jobs)
    if pushed is not None and not _of_the_motion(pushed, parts, turning):
        return pushed
    asked = _asked(out, parts, turning)
    # something acts there surely, though what it is drowns in what stays unexplained
    drowned = any(sure(parts.test, p) and beyond(p.size, out.known.all) > OF_STATE for p in pieces)
    if drowned and asked.kind == "complete" and not _half_a_row(out, parts, jobs):
        return replace(out, kind="unexplained")
    if drowned or asked.kind == "complete":
        return asked
    # numbers that were fitted to slow motion may be off by so much in a fast one
    whole = _fitted_to(parts.all, base, joint, jobs)
    size = discrepancy(parts.test, whole.model, joint)
    state = structure(parts.each, whole.model, joint, STRUCTURED, turning)
    again = _asked(
        replace(out, base=whole, final=whole, before=size, after=size, state=state), parts, turning
    )
    if again.kind != "complete" or _contradicted(parts.fit, base, whole, joint):
        return asked
    return replace(out, final=whole, after=size, state=state)


def _half_a_row(out: Decision, parts: Parts, jobs: int) -> bool:
    """Whether most of what lacks is gone where position and command are half a row apart: so they
    are in a simulator of first order.
    """
    joint, model = out.joint, out.base.model
    for way in (0.5, -0.5):
        by = Quantity(way * parts.fit.records[0][joint - 1].sample_time, free=False)
        shift = Term("column_shift", joint, {"time": by})
        shifted = replace(
            out.base, fit=replace(out.base.fit, model=model.with_terms((*model.terms, shift)))
        )
        fitted = _fitted_to(parts.fit, shifted, joint, jobs)
        left = discrepancy(parts.test, fitted.model, joint)
        if left.value**2 < (1.0 - PREDICTED) * out.before.value**2:
            return True
    return False


def _contradicted(fit: Data, base: Scored, whole: Scored, joint: int) -> bool:
    """Whether the recordings of the fit surely lack more with the numbers fitted to all: then they
    do determine them, and what has other numbers in other recordings is no physics.
    """
    own, others = (discrepancy(fit, s.model, joint) for s in (base, whole))
    return others.low > own.high and beyond(others.value, own.value) > LAWFUL


def _asked(out: Decision, parts: Parts, turning: bool) -> Decision:
    """The decision by what the calibrated model lacks as a function of the state, of the motion
    before, of time, or of nothing.
    """
    lacks = beyond(out.before.value, out.known.all)
    of_state = beyond(out.state.size, out.known.of_state)
    if of_state > OF_STATE and _predicts(out.state):
        claim = _without_law(parts, out, turning)
        if claim is not None:
            return replace(out, kind="missing", claims=(claim,))
        return replace(out, kind="unexplained")
    lawful = lacks > LAWFUL and _lawful(parts, out.base, out.joint, turning)
    off = _off(out, parts.test)
    if lawful or (lacks > MACHINE and (out.before.low > 0.0 or off)):
        return replace(out, kind="unexplained")
    if off and out.before.high > AMISS:  # a recording too short to say how much torque that is
        return replace(out, kind="unexplained")
    if parts.choose is not parts.test:  # held out too: what acts there only is no less missing
        chosen = discrepancy(parts.choose, out.base.model, out.joint)
        if beyond(chosen.value, out.known.all) > AMISS:
            return replace(out, kind="unexplained", after=chosen)
    return out


def _off(out: Decision, test: Data) -> bool:
    """Whether the position is off by far more than the sensor errs by."""
    error = rms(window_error(test, out.base.model, out.joint))
    return error > BEYOND_SENSOR * noise_floor(test, out.joint)


def _pushed(out: Decision, parts: Parts, jobs: int) -> Decision | None:
    """The decision with a disturbance, where one explains what lacks. It may come in any part of
    the data; one in the recordings of the fit alone bends the calibration, so that it may lack a
    function of the state, and is then that of the recordings to choose by.
    """
    joint, base, known = out.joint, out.base.model, out.known.all
    others = (discrepancy(part, base, joint).value for part in (parts.fit, parts.choose))
    somewhere = beyond(max(out.before.value, *others), known)
    if somewhere < LAWFUL:
        return None
    # a push may lie where the held-out recording was cut, or in the recordings of the fit alone:
    # there what comes when the joint turns round may be its friction, however seldom
    often = OFTEN if beyond(out.before.value, known) > LAWFUL else 0.0
    held = here = None
    if out.state.share < PREDICTED:
        held = _in_held(parts, base, joint, often)
        here = held or _in_fit(parts, base, joint)
    bent = held is None or bool(
        everywhere(held, (parts.fit,), base, joint).intervals
        and not everywhere(held, (parts.choose,), base, joint).intervals
    )
    if bent:
        other = _fitted_to(parts.choose, out.base, joint, jobs)
        after = discrepancy(parts.test, other.model, joint)
        if held is None and beyond(after.value, known) < LAWFUL:
            here = _in_fit(parts, other.model, joint, MANY) or here
        elif here is None and out.state.share < PREDICTED:
            here = _in_held(parts, other.model, joint, often)
        if here is not None and after.value <= out.before.value:
            out = replace(out, final=other, after=after)
    if here is None:
        return None
    both = everywhere(here, (parts.fit, parts.held), out.final.model, joint)
    if both.spread > FEW * sum(len(part.records) for part in (parts.fit, parts.held)):
        return None  # what comes so often comes with the motion
    if both.share < PREDICTED:
        return None
    if _by_own_numbers(out, parts, jobs, both.recordings):
        return None
    return replace(out, kind="disturbance", bursts=both)


def unpushed(decision: Decision) -> Decision:
    """The decision without a disturbance: of what comes and goes beside a load that swings unseen
    at another joint nobody can say that no state explains it.
    """
    lacks = beyond(decision.before.value, decision.known.all)
    surely = lacks > MACHINE and decision.before.low > 0.0
    return replace(
        decision,
        kind="unexplained" if surely else "complete",
        bursts=None,
        final=decision.base,
        after=decision.before,
    )


def _by_own_numbers(
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
                own = discrepancy(alone, _fitted_to(alone, out.final, joint, jobs).model, joint)
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


def _fitted_to(data: Data, base: Scored, joint: int, jobs: int) -> Scored:
    """The model calibrated on other recordings."""
    data = data.at_bandwidth(joint, base.data.bandwidth[joint - 1])
    handles = joint_handles(data, base.model, joint)
    return fit_scored(data, base.model, handles, (joint,), jobs=jobs, rounds=2)


def _lawful(parts: Parts, base: Scored, joint: int, turning: bool) -> bool:
    """Whether what lacks is no noise of a machine: it follows from how the joint moved before, or
    repeats itself with time.
    """
    memory = structure(parts.each, base.model, joint, [MEMORY], turning)
    if memory.size > LAWFUL and memory.z > SURE:
        return True
    return periodic(parts.held, base.model, joint) > LAWFUL


def _predicts(found: Structure) -> bool:
    """Whether what was learned on other recordings predicts what lacks, and not by chance."""
    return found.z > SURE or found.apart > BY_CHANCE


def _of_the_motion(pushed: Decision, parts: Parts, turning: bool) -> bool:
    """Whether the state predicts a part of what lacks, or the motion before most of it: of a push
    from outside neither knows anything.
    """
    model, state = pushed.final.model, pushed.state
    if pushed.final is not pushed.base:
        state = structure(parts.each, model, pushed.joint, STRUCTURED, turning)
    if state.size > OF_STATE and _predicts(state):
        return True
    memory = structure(parts.each, model, pushed.joint, [MEMORY], turning)
    return memory.share > PREDICTED and memory.z > PLAIN


def _why(
    rival: Rival, base: Scored, pieces: Sequence[Piece], before: Size
) -> tuple[str, str, float]:
    gain = base.deviance - rival.value
    seen = next((p for p in pieces if rival.effect in p.effects), None)
    if seen is not None and seen.log_e > 0 and seen.evidence.z > CLAIMED:
        if seen.size < finest(rival.effect):
            least = f"findings have {percent(finest(rival.effect))} % at least"
            small = f"{percent(seen.size)} % of the torque, and {least}"
            return rival.effect, f"too small to be told: {small}", 0.5 * gain
        sizes = f"{percent(seen.size)} % of the torque beside {percent(before.value)} %"
        return rival.effect, f"not clearly more than what stays unexplained: {sizes}", 0.5 * gain
    why = (
        "no more likely than the calibrated model"
        if gain < WAIT
        else "is not what is missing, on the recordings held out"
    )
    return rival.effect, why, 0.5 * gain


def _without_law(parts: Parts, out: Decision, turning: bool) -> Claim | None:
    """The one mechanism whose own variables predict most of what lacks, and of what any function of
    state does; None where several do, or none.
    """
    joint, base = out.joint, out.base
    alone = {m: structure(parts.each, base.model, joint, [m], turning) for m in STRUCTURED}
    order = sorted(alone, key=lambda m: -alone[m].size)
    best = alone[order[0]]
    least = PREDICTED * max(out.state.size, out.before.value) ** 2
    if best.z < SURE or best.size**2 < least or best.share < PREDICTED:
        return None
    # in a loop the command follows what the joint has to bear: of any torque, so large a part
    if order[0] == "actuator" and out.before.value**2 > PREDICTED:
        return None
    other = next(alone[m] for m in order[1:] if m not in kind_of(order[0]))
    if other.size**2 > RIVAL * best.size**2:
        return None
    evidence = Evidence(0.0, best.z, np.zeros(1))
    term = Term("unknown", joint, {})
    claim = Claim(
        "unknown", order[0], term, best.size, evidence, 0.0, {"unknown": 1.0}, (), (), (), best
    )
    return by_its_variables(claim, out, parts)
