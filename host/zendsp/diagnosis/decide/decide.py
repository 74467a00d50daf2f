"""The decision: which mechanisms are claimed, by which law, and what is said of the rest.

The principle (docs/diagnosis.md, "How it decides"): a recording is the sum of named physics, an
unnamed discrepancy, and the sensor's error. A finding is a mechanism without which the discrepancy
grows, on recordings that neither the fit nor any choice has touched. The search proposes
mechanisms. Here each is taken away, everything else is fitted again, and the cost decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.believed import believed
from zendsp.diagnosis.decide.claims import Claim, Decision, Piece, not_likelier
from zendsp.diagnosis.decide.contract import NOT_SURELY, Reason, Rejected, Verdict, contradicted
from zendsp.diagnosis.decide.findings import estimates, new_terms, percent
from zendsp.diagnosis.decide.laws import named
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
from zendsp.diagnosis.decide.thresholds import (
    AMISS,
    BEYOND_SENSOR,
    CLAIMED,
    LAWFUL,
    MACHINE,
    OF_STATE,
    PREDICTED,
    RUN_AWAY,
    SIMULATORS_DIFFER,
    SURE,
    THROWN,
)
from zendsp.diagnosis.measure.bursts import periodic
from zendsp.diagnosis.measure.discrepancy import Size, beyond, discrepancy, surely_beyond
from zendsp.diagnosis.measure.likelihood import Scored, informative
from zendsp.diagnosis.measure.significance import essence_of
from zendsp.diagnosis.measure.structure import MEMORY, STRUCTURED, structure
from zendsp.diagnosis.measure.windows import noise_floor, rms, window_error
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.search.hypothesis import JointSearch, Rival
from zendsp.diagnosis.search.short_fits import WAIT
from zendsp.diagnosis.search.simplify import simplify
from zendsp.physics.calibration.fit import Data, Fit
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Quantity, Term

Array = npt.NDArray[np.float64]
LIKELIEST = 6  # so many of the likeliest hypotheses of the first round


def decide(parts: Parts, given: Model, search: JointSearch, jobs: int, tell: Progress) -> Decision:
    """The decision about one joint: its claims, and what they leave.

    Parameters
    ----------
    parts : Parts
        Recordings to fit to, to choose by, and to test on.
    search : JointSearch
        The search, with its proposed model.
    jobs : int
        Threads.
    tell : callable
        Receives a sentence at each stage.
    """
    out = _decided(parts, given, search, jobs, tell)
    if out.kind == Verdict.COMPLETE:
        out = _beside_the_fit(out, parts)
    turning = not rubs(search.base.model, search.joint)
    if lost(parts, search.base.model, search.joint):
        return out
    if out.kind == Verdict.MISSING and not any(c.effect == "unknown" for c in out.claims):
        models = [out.final]
    # missing friction and pushes hide each other
    elif out.kind == Verdict.UNEXPLAINED and not out.loads:
        models = [r.scored for r in search.tried if get_effect(r.effect).common]
        if parts.fit.joints == 1:  # of several joints, a wrong body is as likely as a law of one
            models += [r.scored for r in search.tried[:1]]  # refused for a push to choose by
        models += [search.best] if search.best is not None else []
    else:
        return replace(out, beside=felt(out, parts, turning))
    out = replace(out, bursts=pushed_beside(out, models, parts, turning, jobs))
    small = out.kind == Verdict.UNEXPLAINED and beyond(out.before.value, out.known.all) < LAWFUL
    if small and out.bursts is None:
        push = felt(out, parts, turning)
        # something surely lacks, and no state explains it
        own = push is None or by_own_numbers(out, parts, jobs, push.recordings)
        if not own and not out.doubted:
            return replace(out, kind=Verdict.DISTURBANCE, bursts=push)
        return replace(out, beside=push)
    return out


def _beside_the_fit(out: Decision, parts: Parts) -> Decision:
    """A complete decision; open where the recordings of the fit surely lack something. Held-out
    ones with larger torques may have too little of it.
    """
    lacks, doubted = discrepancy(parts.fit, out.base.model, out.joint), contradicted(out.lost)
    # otherwise it is likelier as correlated noise is, not for a torque that only those lack
    if doubted and lacks.high > SIMULATORS_DIFFER and lacks.low > out.before.high:
        return replace(out, kind=Verdict.UNEXPLAINED, doubted=doubted)
    if beyond(lacks.low, out.known.all) > LAWFUL and _throws(parts.fit, out, lacks.value):
        return replace(out, kind=Verdict.UNEXPLAINED, after=lacks)
    return out


def _decided(
    parts: Parts, given: Model, search: JointSearch, jobs: int, tell: Progress
) -> Decision:
    joint, base = search.joint, search.base
    tell(Step.SEARCHING.says(f"joint {joint}: what each mechanism is worth"))
    final = worth_choosing(parts, given, search, jobs)
    before = discrepancy(parts.test, base.model, joint)
    asked: list[Piece] = []
    if new_terms(given, final.model, joint):
        final, claimed, rest = _surely_shown(parts, given, search, final, jobs)
        asked = with_reasons(claimed, rest, None, None)
        if not claimed:
            sounder = find_sounder(parts, search, final, rest, jobs)
            if sounder is not None:
                return _decided(parts, given, sounder, jobs, tell)
        if claimed:
            first = named(parts, given, search, final, claimed, rest, before, jobs, tell)
            other = _exchanged(parts, search, final, first, jobs)
            if other is not None:
                exchanged = _decided(parts, given, other, jobs, tell)
                # a likelier law has to stand on untouched recordings, too
                if exchanged.claims or not first.claims:
                    return exchanged
            decision = believed(first, parts, given, jobs)
            better = _makes_better(decision, parts.test)
            refined = decision.claims and decision.alone is not decision.final
            if refined and (not better or _blurred(decision, given)):
                decision = _unrefined_by(decision)
                better = _makes_better(decision, parts.test)
            asked = with_reasons(claimed, rest, first, decision)
            if decision.claims and better:
                if any(c.effect != "unknown" for c in decision.claims):
                    return replace(decision, beside=beside(decision, parts))
                # the missing torque itself has to show which mechanism, if any
                plain = _nothing_named(parts, given, search, before, asked, jobs)
                most = decision.after.value**2 < (1.0 - PREDICTED) * before.value**2
                kind = kind_of(decision.claims[0].mechanism)
                same = any(c.mechanism in kind for c in plain.claims)
                stands = plain.kind == Verdict.COMPLETE or (most and not plain.claims) or same
                if len(decision.claims) == 1:
                    return decision if stands else plain
                # several mechanisms without any law are one unknown torque
                unnamed = plain.kind == Verdict.COMPLETE
                return replace(plain, kind=Verdict.UNEXPLAINED) if unnamed else plain
    nothing = _nothing_named(parts, given, search, before, asked, jobs)
    several = len({rec[0].recording for part in parts.each for rec in part.records}) > 1
    if nothing.kind != Verdict.UNEXPLAINED or not several:
        return nothing
    return replace(nothing, loads=by_own_numbers(nothing, parts, jobs))


def _surely_shown(
    parts: Parts, given: Model, search: JointSearch, final: Scored, jobs: int
) -> tuple[Scored, list[Piece], list[Piece]]:
    """The proposed model with what it claims, and what only refines it: without terms that the
    untouched recordings do not surely show, one mechanism after the other, the least sure first.

    Beside a claim such a term is bent to what no law describes, and hides it; on other motions it
    may do anything. Friction that every machine has stays.
    """
    joint, base = search.joint, search.base
    last: tuple[Scored, list[Piece], list[Piece]] | None = None
    while True:
        new = grouped(given, final.model, new_terms(given, final.model, joint))
        pieces = [
            piece_of(parts.test, given, final, key[0], terms, base, jobs)
            for key, terms in new.items()
        ]
        pieces.sort(key=lambda p: -p.size)
        claimed, rest = held_apart(parts, given, search, final, pieces)
        # friction that every machine has is not given up for an unsure refinement
        held = last is not None and any(p.expected for p in last[1])
        if last is not None and (not claimed or (held and not any(p.expected for p in claimed))):
            return last
        last = final, claimed, rest
        unsure = [
            p
            for p in rest
            if not sure(parts.test, p) and not any(get_effect(e).common for e in p.effects)
        ]
        if not claimed or not unsure:
            return last
        final = min(unsure, key=lambda p: p.log_e).without


def _makes_better(decision: Decision, test: Data) -> bool:
    """Whether a decision predicts untouched recordings no worse, and leaves no more torque
    unexplained than before, nor more than the whole torque (as a spring that holds a joint at its
    place). Only such a decision can be a finding.
    """
    models = (decision.base.model, decision.final.model)
    errors = [rms(window_error(test, m, decision.joint)) for m in models]
    return errors[1] <= errors[0] and decision.after.value <= min(decision.before.value, 1.0)


def _unrefined_by(decision: Decision) -> Decision:
    """The decision without the refinements that its claims do not need. They may be likelier and
    yet far off, as a falling friction is where a slowing joint may or may not stick.
    """
    needed = {t.effect for t in decision.alone.model.at(decision.joint)}
    kept = tuple(c for c in decision.refinements if c.term.effect in needed)
    return replace(decision, final=decision.alone, after=decision.bare, refinements=kept)


def _blurred(decision: Decision, given: Model) -> bool:
    """Whether a claimed law has an uncertain number beside the refinements, and a certain one
    without them.
    """
    kind = given.joint_kind(decision.joint)
    units = given.actuator.command_unit, given.torque_unit(decision.joint)

    def certain(fit: Fit, claim: Claim) -> bool:
        values = estimates(fit, claim.term, kind, *units)
        own = [values[key] for key in essence_of(claim.effect) if key in values]
        return all(abs(v.value) > SURE * v.std for v in own)

    laws = [c for c in decision.claims if c.effect != "unknown"]
    return any(
        certain(decision.alone.fit, c) and not certain(decision.final.fit, c) for c in laws
    )


def _exchanged(
    parts: Parts, search: JointSearch, final: Scored, first: Decision, jobs: int
) -> JointSearch | None:
    """The search with a likelier law in place of a claimed one; None where there is none, or where
    its simplified form is no likelier. Each exchange is a gain, so the exchanges end.
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
    """The next search to decide upon where nothing proposed can be claimed; None where nothing is
    left to try.

    If the proposed model diverges on recordings that it was not fitted to: the next hypothesis of
    the first step, alone. Otherwise the first step without those that followed: they may have
    absorbed some discrepancy between machine and model, which costs the first its evidence.
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
    """The search with one hypothesis alone as its best model, simplified."""
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
    """The decision without a named law: complete, a disturbance, a mechanism without a law, or
    unexplained. It depends on the calibrated model's discrepancy alone. ``pieces`` are the tested
    mechanisms, for the report.
    """
    joint, base = search.joint, search.base
    # how a known dry friction acts at reversals is no missing physics: bristles, a soft simulator
    turning = not rubs(base.model, joint)
    state = structure(parts.each, base.model, joint, STRUCTURED, turning)
    beside = discrepancy(parts.test, search.final.model, joint) if pieces else before
    least = search.final.deviance
    tried = {e: p.without.deviance - least for p in pieces for e in p.effects}
    tried |= {r.effect: base.deviance - r.value for r in search.tried[:LIKELIEST]}
    lost = tuple(_lost(e, joint, gain, pieces, before, beside) for e, gain in tried.items())
    out = Decision(
        joint,
        Verdict.COMPLETE,
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
    # something surely acts there, but is smaller than what stays unexplained
    drowned = any(sure(parts.test, p) and beyond(p.size, out.known.all) > OF_STATE for p in pieces)
    if drowned and asked.kind == Verdict.COMPLETE and not _half_a_row(out, parts, jobs):
        return replace(out, kind=Verdict.UNEXPLAINED)
    if drowned or asked.kind == Verdict.COMPLETE:
        return asked
    # numbers fitted to slow motion may be off by this much in fast motion
    whole = fitted_to(parts.all, base, joint, jobs)
    size = discrepancy(parts.test, whole.model, joint)
    state = structure(parts.each, whole.model, joint, STRUCTURED, turning)
    fitted = replace(out, base=whole, final=whole, before=size, after=size, state=state)
    again = _asked(fitted, parts, given, turning)
    if again.kind != Verdict.COMPLETE or _contradicted(parts.fit, base, whole, joint):
        return asked
    return replace(out, final=whole, after=size, state=state)


def _half_a_row(out: Decision, parts: Parts, jobs: int) -> bool:
    """Whether a shift of half a row between position and command removes most of the missing
    torque, as in a simulator of first order.
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
    """Whether the recordings of the fit surely lack more torque with numbers fitted to all
    recordings. Then they determine these numbers, and the others need different ones: something is
    missing.
    """
    own, others = (discrepancy(fit, s.model, joint) for s in (base, whole))
    return others.low > own.high and beyond(others.value, own.value) > LAWFUL


def _asked(out: Decision, parts: Parts, given: Model, turning: bool) -> Decision:
    """The decision from the missing torque of the calibrated model: as a function of the state, of
    the motion before, of time, or of nothing.
    """
    lacks = beyond(out.before.value, out.known.all)
    of_state = beyond(out.state.size, out.known.of_state)
    if of_state > OF_STATE and predicts(out.state):
        claim = only_mechanism(parts, given, out, turning)
        if claim is not None:
            return replace(out, kind=Verdict.MISSING, claims=(claim,))
        return replace(out, kind=Verdict.UNEXPLAINED)
    lawful = lacks > LAWFUL and _lawful(parts, out.base, out.joint, turning)
    off = _off(parts.test, out) > BEYOND_SENSOR
    surely = beyond(out.before.low, out.known.all) > LAWFUL
    thrown = lacks > OF_STATE and _throws(parts.test, out, lacks)
    if lawful or surely or thrown or surely_beyond(out.before, out.known.all) > MACHINE:
        return replace(out, kind=Verdict.UNEXPLAINED)
    if off and out.before.high > AMISS:  # a recording too short to say how much torque that is
        return replace(out, kind=Verdict.UNEXPLAINED)
    if parts.choose is not parts.test:  # these are held out too, and count as well
        chosen = discrepancy(parts.choose, out.base.model, out.joint)
        if beyond(chosen.value, out.known.all) > AMISS:
            return replace(out, kind=Verdict.UNEXPLAINED, after=chosen)
    return out


def _off(data: Data, out: Decision) -> float:
    """The position error of the calibrated model as a multiple of the sensor's."""
    error = rms(window_error(data, out.base.model, out.joint))
    return error / max(noise_floor(data, out.joint), 1e-300)


def _throws(data: Data, out: Decision, lacks: float) -> bool:
    """Whether a missing torque throws the joint off: an error n times the sensor's counts as much
    with an nth of the torque.
    """
    off = _off(data, out)
    return off > BEYOND_SENSOR and lacks * off > THROWN


def _lawful(parts: Parts, base: Scored, joint: int, turning: bool) -> bool:
    """Whether the missing torque is more than noise: it follows from earlier motion, or repeats in
    time.
    """
    memory = structure(parts.each, base.model, joint, [MEMORY], turning)
    if memory.size > LAWFUL and memory.z > SURE:
        return True
    return periodic(parts.held, base.model, joint) > LAWFUL


def _lost(
    effect: str, joint: int, gain: float, pieces: Sequence[Piece], before: Size, beside: Size
) -> Rejected:
    """The entry of an effect that is not claimed: its gain in deviance and the reason."""
    seen = next((p for p in pieces if effect in p.effects), None)
    reason = Reason.OTHER
    if seen is not None and seen.log_e > 0 and seen.evidence.z > CLAIMED:
        size = f"{percent(seen.size)} % of the torque"
        if seen.size < finest(effect):
            reason = Reason.TOO_SMALL
            least = f"findings have {percent(finest(effect))} % at least"
            why = f"too small to be told: {size}, and {least}"
        elif beside.value**2 > (1.0 - PREDICTED) * before.value**2:
            # above 1 the model does not follow the recording at all
            part = f"{percent(beside.value)} %" if beside.value < 1.0 else "more than all of it"
            left = f"{part} stays unexplained beside it"
            why = f"not what is missing: {size}, and {left}"
        else:
            reason = Reason.NEAR
            left = f"up to {percent(min(1.0, beside.high))} % may stay unexplained beside it"
            because = f"; {seen.why}" if seen.why else ""
            why = f"{NOT_SURELY}: {size}, and {left}{because}"
    elif gain < WAIT:
        why = not_likelier(0.5 * gain, 0.5 * WAIT)
    else:
        why = "is not what is missing, on the recordings held out"
    return Rejected(effect, joint, why, 0.5 * gain, reason)
