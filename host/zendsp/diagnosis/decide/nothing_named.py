"""The decision where no law is named: nothing is missing, something pushes the joint, a mechanism
acts that has no law here, or what is missing stays unexplained.

It depends on what the calibrated model lacks, alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision, Piece, not_likelier
from zendsp.diagnosis.decide.contract import NOT_SURELY, Reason, Rejected, Verdict
from zendsp.diagnosis.decide.findings import percent
from zendsp.diagnosis.decide.law_torque import known_discrepancy, rms_torque, rubs
from zendsp.diagnosis.decide.nameless import only_mechanism
from zendsp.diagnosis.decide.near import nearest_law
from zendsp.diagnosis.decide.pieces import finest, sure
from zendsp.diagnosis.decide.pushes import fitted_to, of_a_law, of_the_motion, predicts, pushed
from zendsp.diagnosis.decide.thresholds import (
    AMISS,
    BEYOND_SENSOR,
    CLAIMED,
    LAWFUL,
    MACHINE,
    OF_STATE,
    PREDICTED,
    SURE,
    THROWN,
)
from zendsp.diagnosis.measure.bursts import periodic
from zendsp.diagnosis.measure.discrepancy import Size, beyond, discrepancy, surely_beyond
from zendsp.diagnosis.measure.likelihood import Scored
from zendsp.diagnosis.measure.structure import MEMORY, STRUCTURED, structure
from zendsp.diagnosis.measure.windows import least_error, rms, window_error
from zendsp.diagnosis.search.hypothesis import JointSearch
from zendsp.diagnosis.search.short_fits import WAIT
from zendsp.physics.calibration.fit import Data
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Quantity, Term

LIKELIEST = 6  # so many of the likeliest hypotheses of the first round


def nothing_named(
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
    lost = tuple(_lost(e, search, gain, pieces, before, beside) for e, gain in tried.items())
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
    thrown = lacks > OF_STATE and throws(parts.test, out, lacks)
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
    """The position error of the calibrated model as a multiple of a perfect one's."""
    error = rms(window_error(data, out.base.model, out.joint))
    return error / max(least_error(data, out.base.model, out.joint), 1e-300)


def throws(data: Data, out: Decision, lacks: float) -> bool:
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
    effect: str,
    search: JointSearch,
    gain: float,
    pieces: Sequence[Piece],
    before: Size,
    beside: Size,
) -> Rejected:
    """The entry of an effect that is not claimed: its gain in deviance and the reason."""
    seen = next((p for p in pieces if effect in p.effects), None)
    reason = Reason.OTHER
    if seen is not None and seen.lacks and seen.log_e > 0 and seen.evidence.z > CLAIMED:
        size = f"{percent(seen.size)} % of the torque"
        if seen.size < (allowed := finest(effect, search.base.model)):
            reason = Reason.TOO_SMALL
            least = f"findings have {percent(allowed)} % at least"
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
    return Rejected(effect, search.joint, why, 0.5 * gain, reason)
