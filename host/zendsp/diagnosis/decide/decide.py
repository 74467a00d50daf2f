"""The decision: which mechanisms are claimed, by which law, and what is said of the rest.

One principle (docs/diagnosis.md, "How it decides"): a recording is the named physics, a discrepancy
that nobody has named, and the sensor. A finding is a mechanism without which the discrepancy must
grow, on recordings that neither the fit nor any choice has touched. The search proposes; here every
mechanism that it wrote down is taken away, everything else is fitted again, and what that costs
decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision, Piece
from zendsp.diagnosis.decide.contract import NOT_SURELY, Reason, Rejected, contradicted
from zendsp.diagnosis.decide.findings import new_terms, percent
from zendsp.diagnosis.decide.laws import believed, named
from zendsp.diagnosis.decide.nameless import only_mechanism
from zendsp.diagnosis.decide.near import nearest_law, with_reasons
from zendsp.diagnosis.decide.pieces import (
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
from zendsp.diagnosis.decide.pushes import (
    beside,
    by_own_numbers,
    felt,
    fitted_to,
    lost,
    of_a_law,
    of_the_motion,
    predicts,
    pushed,
    pushed_beside,
)
from zendsp.diagnosis.decide.result import not_likelier
from zendsp.diagnosis.decide.thresholds import (
    AMISS,
    BEYOND_SENSOR,
    CLAIMED,
    LAWFUL,
    MACHINE,
    OF_STATE,
    PREDICTED,
    RUN_AWAY,
    SURE,
    THROWN,
)
from zendsp.diagnosis.measure.bursts import periodic
from zendsp.diagnosis.measure.discrepancy import Size, beyond, discrepancy
from zendsp.diagnosis.measure.likelihood import Scored, informative
from zendsp.diagnosis.measure.structure import MEMORY, STRUCTURED, structure
from zendsp.diagnosis.measure.windows import noise_floor, rms, window_error
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.search.hypothesis import JointSearch, Rival
from zendsp.diagnosis.search.short_fits import WAIT
from zendsp.diagnosis.search.simplify import simplify
from zendsp.physics.calibration.fit import Data
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Quantity, Term

Array = npt.NDArray[np.float64]
LIKELIEST = 6  # of the first round's hypotheses, the likeliest


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
    out = _decided(parts, given, search, jobs, tell)
    if out.kind == "complete" and (doubted := contradicted(out.lost)):
        out = replace(out, kind="unexplained", doubted=doubted)
    turning = not rubs(search.base.model, search.joint)
    if lost(parts, search.base.model, search.joint):
        return out
    if out.kind == "missing" and not any(c.effect == "unknown" for c in out.claims):
        models = [out.final]
    # a friction that is missing hides pushes, and they hide it
    elif out.kind == "unexplained" and not out.loads:
        models = [r.scored for r in search.tried if get_effect(r.effect).common]
        models += [search.best] if search.best is not None else []
    else:
        return replace(out, beside=felt(out, parts, turning))
    out = replace(out, bursts=pushed_beside(out, models, parts, turning))
    small = out.kind == "unexplained" and beyond(out.before.value, out.known.all) < LAWFUL
    if small and out.bursts is None:
        return replace(out, beside=felt(out, parts, turning))
    return out


def _decided(
    parts: Parts, given: Model, search: JointSearch, jobs: int, tell: Progress
) -> Decision:
    joint, base = search.joint, search.base
    tell(Step.SEARCHING.says(f"joint {joint}: what each mechanism is worth"))
    final = worth_choosing(parts, given, search, jobs)
    before = discrepancy(parts.test, base.model, joint)
    new = new_terms(given, final.model, joint)
    pieces: list[Piece] = []
    asked: list[Piece] = []
    if new:
        pieces = [
            piece_of(parts.test, given, final, key[0], terms, base, jobs)
            for key, terms in grouped(given, final.model, new).items()
        ]
        pieces.sort(key=lambda p: -p.size)
        claimed, rest = held_apart(parts, given, search, final, pieces)
        asked = with_reasons(claimed, rest, None, None)
        if not claimed:
            sounder = find_sounder(parts, search, final, pieces, jobs)
            if sounder is not None:
                return _decided(parts, given, sounder, jobs, tell)
        if claimed:
            first = named(parts, given, search, final, claimed, rest, before, jobs, tell)
            other = _exchanged(parts, search, final, first, jobs)
            if other is not None:
                return _decided(parts, given, other, jobs, tell)
            decision = believed(first, parts, given, jobs)
            better = _makes_better(decision, parts.test)
            if decision.claims and not better and decision.alone is not decision.final:
                decision = _unrefined_by(decision)
                better = _makes_better(decision, parts.test)
            asked = with_reasons(claimed, rest, first, decision)
            if decision.claims and better:
                if any(c.effect != "unknown" for c in decision.claims):
                    return replace(decision, beside=beside(decision, parts))
                # which mechanism, if any, is for the lacking torque itself to say
                plain = _nothing_named(parts, given, search, before, asked, jobs)
                most = decision.after.value**2 < (1.0 - PREDICTED) * before.value**2
                kind = kind_of(decision.claims[0].mechanism)
                same = any(c.mechanism in kind for c in plain.claims)
                stands = plain.kind == "complete" or (most and not plain.claims) or same
                if len(decision.claims) == 1:
                    return decision if stands else plain
                # several mechanisms, and no law of any: it is one torque that nobody knows
                return replace(plain, kind="unexplained") if plain.kind == "complete" else plain
    nothing = _nothing_named(parts, given, search, before, asked, jobs)
    several = len({rec[0].recording for part in parts.each for rec in part.records}) > 1
    if nothing.kind != "unexplained" or not several:
        return nothing
    return replace(nothing, loads=by_own_numbers(nothing, parts, jobs))


def _makes_better(decision: Decision, test: Data) -> bool:
    """Whether untouched recordings are no worse for a decision. What makes them worse is no
    finding, ever; nor what leaves more torque unexplained than there was, or than there is (a
    spring that holds a joint).
    """
    models = (decision.base.model, decision.final.model)
    errors = [rms(window_error(test, m, decision.joint)) for m in models]
    return errors[1] <= errors[0] and decision.after.value <= min(decision.before.value, 1.0)


def _unrefined_by(decision: Decision) -> Decision:
    """The decision without what only refines its fit: likelier, and yet far off where a joint that
    slows down may stick or not (a falling friction).
    """
    return replace(decision, final=decision.alone, after=decision.bare, refinements=())


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
    beside = discrepancy(parts.test, search.final.model, joint) if pieces else before
    least = search.final.deviance
    tried = {e: p.without.deviance - least for p in pieces for e in p.effects}
    tried |= {r.effect: base.deviance - r.value for r in search.tried[:LIKELIEST]}
    lost = tuple(_lost(e, joint, gain, pieces, before, beside) for e, gain in tried.items())
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
        lost=lost,
        near=nearest_law(lost, pieces, before, beside),
    )
    push = pushed(out, parts, jobs)
    laws = [r.scored.model for r in search.tried[:LIKELIEST] if get_effect(r.effect).over != "time"]
    if not (push is None or of_the_motion(push, parts, turning) or of_a_law(push, laws, parts)):
        return push
    asked = _asked(out, parts, given, turning)
    # something acts there surely, though what it is drowns in what stays unexplained
    drowned = any(sure(parts.test, p) and beyond(p.size, out.known.all) > OF_STATE for p in pieces)
    if drowned and asked.kind == "complete" and not _half_a_row(out, parts, jobs):
        return replace(out, kind="unexplained")
    if drowned or asked.kind == "complete":
        return asked
    # numbers that were fitted to slow motion may be off by so much in a fast one
    whole = fitted_to(parts.all, base, joint, jobs)
    size = discrepancy(parts.test, whole.model, joint)
    state = structure(parts.each, whole.model, joint, STRUCTURED, turning)
    fitted = replace(out, base=whole, final=whole, before=size, after=size, state=state)
    again = _asked(fitted, parts, given, turning)
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
        fitted = fitted_to(parts.fit, shifted, joint, jobs)
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


def _asked(out: Decision, parts: Parts, given: Model, turning: bool) -> Decision:
    """The decision by what the calibrated model lacks as a function of the state, of the motion
    before, of time, or of nothing.
    """
    lacks = beyond(out.before.value, out.known.all)
    of_state = beyond(out.state.size, out.known.of_state)
    if of_state > OF_STATE and predicts(out.state):
        claim = only_mechanism(parts, given, out, turning)
        if claim is not None:
            return replace(out, kind="missing", claims=(claim,))
        return replace(out, kind="unexplained")
    lawful = lacks > LAWFUL and _lawful(parts, out.base, out.joint, turning)
    error = rms(window_error(parts.test, out.base.model, out.joint))
    sensor = noise_floor(parts.test, out.joint)
    off = error > BEYOND_SENSOR * sensor
    surely = off and beyond(out.before.low, out.known.all) > LAWFUL
    # what throws the position off by n times the sensor's error is as much at an nth of the torque
    thrown = off and lacks > OF_STATE and lacks * error > THROWN * sensor
    if lawful or surely or thrown or (lacks > MACHINE and out.before.low > 0.0):
        return replace(out, kind="unexplained")
    if off and out.before.high > AMISS:  # a recording too short to say how much torque that is
        return replace(out, kind="unexplained")
    if parts.choose is not parts.test:  # held out too: what acts there only is no less missing
        chosen = discrepancy(parts.choose, out.base.model, out.joint)
        if beyond(chosen.value, out.known.all) > AMISS:
            return replace(out, kind="unexplained", after=chosen)
    return out


def _lawful(parts: Parts, base: Scored, joint: int, turning: bool) -> bool:
    """Whether what lacks is no noise of a machine: it follows from how the joint moved before, or
    repeats itself with time.
    """
    memory = structure(parts.each, base.model, joint, [MEMORY], turning)
    if memory.size > LAWFUL and memory.z > SURE:
        return True
    return periodic(parts.held, base.model, joint) > LAWFUL


def _lost(
    effect: str, joint: int, gain: float, pieces: Sequence[Piece], before: Size, beside: Size
) -> Rejected:
    """An effect that gains so much deviance, and why it is not claimed."""
    seen = next((p for p in pieces if effect in p.effects), None)
    reason = Reason.OTHER
    if seen is not None and seen.log_e > 0 and seen.evidence.z > CLAIMED:
        size = f"{percent(seen.size)} % of the torque"
        if seen.size < finest(effect):
            reason = Reason.TOO_SMALL
            least = f"findings have {percent(finest(effect))} % at least"
            why = f"too small to be told: {size}, and {least}"
        elif beside.value**2 > (1.0 - PREDICTED) * before.value**2:
            left = f"{percent(beside.value)} % stays unexplained beside it"
            why = f"not what is missing: {size}, and {left}"
        else:
            reason = Reason.NEAR
            left = f"up to {percent(beside.high)} % may stay unexplained beside it"
            because = f"; {seen.why}" if seen.why else ""
            why = f"{NOT_SURELY}: {size}, and {left}{because}"
    elif gain < WAIT:
        why = not_likelier(0.5 * gain, 0.5 * WAIT)
    else:
        why = "is not what is missing, on the recordings held out"
    return Rejected(effect, joint, why, 0.5 * gain, reason)
