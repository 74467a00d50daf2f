"""The findings and refinements of the decisions, with their numbers, sentences and confidence."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import cast

from zendsp.diagnosis.data.checks import never_reverses
from zendsp.diagnosis.decide.absorbed import shifted
from zendsp.diagnosis.decide.assemble import Assembled
from zendsp.diagnosis.decide.claims import Claim, Decision, shared
from zendsp.diagnosis.decide.confidence import confidence
from zendsp.diagnosis.decide.contract import WORDS, Further, Rejected, listed, spans
from zendsp.diagnosis.decide.decide_bodies import BodyClaim, body_finding
from zendsp.diagnosis.decide.findings import (
    Estimate,
    Finding,
    estimates,
    new_terms,
    number,
    percent,
    sentence,
    waves,
)
from zendsp.diagnosis.decide.moved import G, undone, weight_gone
from zendsp.diagnosis.decide.patchwork import draws_a_curve
from zendsp.diagnosis.decide.pieces import beside_unknown, weight_of_payload
from zendsp.diagnosis.decide.stated_numbers import agreed_on, at_ends, is_no_law, numbers_of
from zendsp.diagnosis.decide.thresholds import PLAIN, PREDICTED, STEEP, TOLERANCE
from zendsp.diagnosis.measure.bursts import Bursts
from zendsp.diagnosis.measure.curve import DRY, FLUID, curve_of
from zendsp.diagnosis.measure.where import Missing, mismatch, units
from zendsp.physics.calibration.fit import Data, Fit
from zendsp.physics.calibration.joint import mechanism_value, own_weight
from zendsp.physics.effects import get_effect, library, mechanism_of
from zendsp.physics.model import TREES, Model, Term
from zendsp.physics.term_numbers import chosen

# the same torque where a joint moves one way
ALIKE_ONE_WAY = ("coulomb", "torque_offset", "coulomb_asymmetry")
# stated of a disturbance; not learned: the cases have too few of them
IN_TIME = 0.85


def name_findings(
    test: Data,
    given: Model,
    decisions: Sequence[Decision],
    whole: Assembled,
    bodies: Sequence[BodyClaim] = (),
) -> tuple[tuple[Finding, ...], tuple[Finding, ...], tuple[Rejected, ...]]:
    """The decisions of all joints in words.

    Returns
    -------
    findings, refinements, rejected
        Findings in the order of what their removal costs on the recordings to test on: pushes and
        bodies before the joints' laws, whose cost is counted beside them.
    """
    ranked: list[tuple[tuple[int, float], Finding]] = []
    refinements: list[Finding] = []
    rejected: list[Rejected] = []
    lacks = (min(1.0, d.before.value) for d in decisions)  # above 1 it does not follow at all
    everything = sum(x**2 for x in lacks) + sum(b.square for b in bodies) or 1.0
    ranked += [((1, b.gain), body_finding(b, everything, given)) for b in bodies]
    ranked += [((2, 0.0), _disturbance(pushed, given)) for pushed in at_once(decisions)]
    for decision in decisions:
        joint = decision.joint
        for claim in decision.claims:
            share = min(1.0, claim.size**2 / everything)
            if claim.effect == "unknown":
                stated = {c.effect for c in decision.claims}
                beside = beside_unknown(
                    whole.calibrated, whole.improved, joint, claim.mechanism, stated
                )
                left = mismatch(test, beside, joint)
                finding = _unknown(given, decision, whole, claim, share, left)
                drawn = _drawn(given, decision, whole, claim)
                finding = replace(finding, sentence=finding.sentence + drawn)
            else:
                finding = _finding(given, decision, whole, claim, share)
            # from these recordings alone: on another day a machine's friction may be half as large,
            # but not more different between the directions
            if claim.effect != "unknown" and is_no_law(
                claim.effect,
                numbers_of(given, decision, whole, claim, not get_effect(claim.effect).symmetric),
                agreed_on(whole, claim, joint, finding.parameters),
            ):
                refinements.append(finding)
            else:
                ranked.append(((0, claim.evidence.gain), finding))
            rejected += claim.lost
        refinements += [
            _finding(given, decision, whole, c, min(1.0, c.size**2 / everything))
            for c in decision.refinements
        ]
        rejected += decision.lost
        named = {c.term.effect for c in decision.claims}
        if not any(draws_a_curve(c) for c in decision.claims):  # it may have moved gravity
            ranked += [
                ((0, 0.5 * abs(z)), replace(f, share=min(1.0, size**2 / everything)))
                for z, size, f in shifted(given, decision, whole, named, test)
            ]
    ranked.sort(key=lambda item: item[0], reverse=True)
    unique = {(r.effect, r.joint): r for r in sorted(rejected, key=lambda r: r.score)}
    worst_first = sorted(unique.values(), key=lambda r: -r.score)
    return tuple(f for _, f in ranked), tuple(refinements), tuple(worst_first[:12])


def _unknown(
    given: Model,
    decision: Decision,
    whole: Assembled,
    claim: Claim,
    share: float,
    lacks: Sequence[Missing],
) -> Finding:
    """The finding of a mechanism without a law: its size, and a curve over its variable of the
    torque that ``lacks`` on untouched recordings beside everything named.
    """
    joint = decision.joint
    found = curve_of(lacks, claim.mechanism)
    numbers: Further = {}
    what, besides = "state", ""
    if found is not None:
        what = "speed" if found.axis.variable == "velocity" else found.axis.variable
        if claim.mechanism == DRY:
            what = f"direction of motion and {what}"
        elif claim.mechanism == FLUID and found.against:
            what = f"speed and {what}"
        place = claim.mechanism == "position_torque"
        if place and given.joints > 1 and found.explained < PREDICTED:
            besides = ", or of joints beside it,"  # whose places ``structure`` counts in
        numbers["curve"] = {
            "variable": found.axis.variable,
            "unit": units(given, joint)[found.axis.variable],
            "at": [float(f"{x:.5g}") for x in found.at],
            "torque": [float(f"{y:.4g}") for y in found.mean],
            "std": [float(f"{s:.2g}") for s in found.spread],
            "against_motion": found.against,
        }
    # an energy sure to z standard deviations: its root to 2 z
    std = claim.size / (2.0 * max(claim.evidence.z, 1.0))
    size = Estimate(claim.size * decision.scale, std * decision.scale, given.torque_unit(joint))
    text = (
        f"A torque that depends on the {what} of joint {joint}{besides} is missing,"
        f" {percent(claim.size)} % of its torque; {_nearest(claim, decision)}."
    )
    if claim.mechanism == DRY and claim.most <= STEEP:
        text += " It is dry friction, or a fluid friction that rises as steeply from standstill."
    if decision.strap and claim.mechanism == "position_torque":
        text = _pulled(decision, claim)
    return Finding(
        "unknown",
        joint,
        {"size": size},
        confidence(claim, decision),
        share,
        (),
        _replaced(given, whole, claim, joint),
        text,
        numbers,
        claim.mechanism,
        claim.laws,
    )


def _pulled(decision: Decision, claim: Claim) -> str:
    """The sentence of a force between links."""
    joints = listed(decision.strap)
    return (
        f"One force pulls at {joints}, as a hose, a strap or a spring between links does:"
        f" {percent(claim.size)} % of the torque of joint {decision.joint}. One potential of"
        " their positions predicts it surely better than any body does, and none of the"
        " known laws describes it."
    )


def _finding(
    given: Model, decision: Decision, whole: Assembled, claim: Claim, share: float
) -> Finding:
    joint, term = decision.joint, claim.term
    values = numbers_of(given, decision, whole, claim)
    sure = min(confidence(claim, decision), agreed_on(whole, claim, joint, values))
    text = _held_otherwise(given, term, values) or sentence(term, values)
    text += _falls_to(whole.agreed[joint].model, term, given.torque_unit(joint))
    text += _turned(whole.agreed[joint].model, term, values)
    text += lifted(given, term, values)
    text += at_ends(term.effect, values, whole.data.records[0][joint - 1])
    numbers = cast(Further, chosen(term))  # as its effect's file names them
    if term.effect == "inertia":
        weight = [
            t
            for t in new_terms(given, decision.final.model, joint)
            if weight_of_payload(given, decision.final.model, t)
        ]
        if weight:
            grown = _grown(whole.agreed[joint], weight[0], given)
            if abs(grown.value) > grown.std:
                text += f" It weighs: gravity grows by {number(grown)} with it."
                numbers["details"] = {"weight": grown.value}
    replaced = _replaced(given, whole, claim, joint)
    if replaced:
        named = ", ".join(f"{e} ({WORDS.get(get_effect(e).mechanism, e)})" for e in replaced)
        several = "terms" if len(replaced) > 1 else "term"
        text += f" It stands in the place of the given model's {several} {named}."
    same = (*_same(given, claim, whole.data), *undone(given, whole.improved, claim, values))
    sure = min(sure, _beside_rivals(given, claim, same))
    if same:
        text += f" This recording cannot tell it from {', '.join(same)}."
    return Finding(
        term.effect,
        joint,
        values,
        sure,
        share,
        same,
        replaced,
        text,
        numbers,
        claim.mechanism,
        claim.laws,
    )


def _falls_to(model: Model, term: Term, torque_unit: str) -> str:
    """The sentence on the level above which a law's size is counted, as Stribeck's; else empty."""
    below = {p.above for p in get_effect(term.effect).parameters if p.above}
    return "".join(
        f" It falls to {t.value(get_effect(t.effect).linear[0]):.3g} {torque_unit} ({t.effect})."
        for t in model.at(term.joint)
        if t.effect in below
    )


def lifted(given: Model, term: Term, values: Mapping[str, Estimate]) -> str:
    """The sentence on a constant force that may be the weight of what a sliding joint lifts; else
    empty.
    """
    if term.effect != "torque_offset" or given.joint_kind(term.joint) != "linear":
        return ""
    level = values["level"]
    mass = number(Estimate(abs(level.value) / G, level.std / G, "kg"))
    return (
        f" Where the joint slides up and down, {mass} more to lift than the model says, or less,"
        " is the same force."
    )


def _turned(model: Model, term: Term, values: Mapping[str, Estimate]) -> str:
    """The sentence on a gravity that turns the model's by an angle and adds nothing to it, as where
    a position has another zero; else empty.
    """
    own = mechanism_value(model, "gravity", term.joint) if model.kind == "rotary" else 0.0
    if term.effect != "gravity" or not own:
        return ""
    torque = values["torque"]
    both = own + torque.value * cmath.rect(1.0, values["angle"].value)
    if abs(abs(both) - abs(own)) > math.hypot(PLAIN * torque.std, TOLERANCE * own):
        return ""
    angle = cmath.phase(both / own)
    return (
        f" With the model's it is the same weight, hanging at {angle:.3g} rad: the zero of the"
        f" position may lie elsewhere ([sensor] offset = {-angle:.3g})."
    )


def _replaced(given: Model, whole: Assembled, claim: Claim, joint: int) -> tuple[str, ...]:
    """The terms of the given model that a claim replaces, its mechanism's weight among them. The
    search may have replaced others in between.
    """
    terms = tuple(e for e in claim.replaces if any(t.effect == e for t in given.at(joint)))
    weight = claim.mechanism == mechanism_of("gravity") and claim.effect != "gravity"
    return (*terms, "gravity") if weight and weight_gone(given, whole.improved, joint) else terms


def _grown(fit: Fit, gravity: Term, given: Model) -> Estimate:
    """The growth of gravity by a body, N m."""
    unit, own = given.torque_unit(gravity.joint), own_weight(given, gravity.joint)
    torque = estimates(fit, gravity, "rotary", "", unit)["torque"]
    hangs = math.cos(gravity.value("angle") - (own[1] if own else 0.0))
    return Estimate(torque.value * hangs, torque.std * abs(hangs), unit)


def _same(given: Model, claim: Claim, data: Data) -> tuple[str, ...]:
    """The effects that these recordings cannot tell from a law: those tied in the choice among
    laws; a displaced centre of mass, for gravity at one joint of an arm; a body, for a coupling by
    acceleration or speed, and for a gain as small as masses of a file may be wrong by; and any
    constant, where a joint moves only one way.
    """
    law, more = claim.effect, []
    if law == "gravity" and given.kind in TREES:
        more = ["body"]
    if law == "torque_gain" and given.kind in TREES and abs(claim.term.value("ratio")) < TOLERANCE:
        more = ["body"]
    if given.kind in TREES and claim.is_rigid_coupling:
        more = ["body", "payload"]
    if law in ALIKE_ONE_WAY and never_reverses(data, claim.term.joint):
        more += [name for name in ALIKE_ONE_WAY if name != law]
    return tuple(dict.fromkeys([*claim.same, *more]))


def _beside_rivals(given: Model, claim: Claim, same: Sequence[str]) -> float:
    """The highest confidence of a law beside those that it cannot be told from, where these are as
    likely: the coupling of an arm is that of its bodies.
    """
    rigid = given.kind in TREES and claim.is_rigid_coupling
    return shared(len(same)) if rigid or "coupling" in same else 1.0


def _held_otherwise(given: Model, term: Term, values: Mapping[str, Estimate]) -> str:
    """A clause on the same law in the given model, with its fixed numbers; empty where it has none.
    """
    held = [
        f"{key} {old.value(key):.4g} there, {number(values[key])} here"
        for old in given.at(term.joint)
        for key, q in old.parameters.items()
        if old.effect == term.effect and key in values and not q.free
    ]
    name = term.effect.replace("_", " ")
    return (
        f"The {name} of joint {term.joint} is not what the given model holds: {'; '.join(held)}."
        if held
        else ""
    )


def _nearest(claim: Claim, decision: Decision) -> str:
    """A sentence on the nearest laws of a mechanism that is claimed without one."""
    # by itself: refinements are no part of the law
    law, left, why = claim.term.effect, decision.bare.value, claim.why
    if law == "unknown":
        if decision.near is None:
            return "none of the known laws describes it"
        law, left, why = decision.near.effect, decision.near.after, decision.near.why
    because = f": {why}" if why else ""
    leaves = f", with which {percent(left)} % of the torque stays unexplained," if left else ""
    return f"it is most like {law}{leaves} and is not called that{because}"


def _drawn(given: Model, decision: Decision, whole: Assembled, claim: Claim) -> str:
    """A sentence on the terms of the improved model that describe a mechanism without a law: waves
    with their numbers.
    """
    law = claim.term.effect
    if law not in library():
        return ""
    names = get_effect(law).names
    if not {"order", "amplitude"} <= set(names):
        return f" The improved model draws it with {law}."
    same = [c for c in decision.refinements if c.term.effect == law]
    laws = (replace(claim, effect=law), *same)
    each = [numbers_of(given, decision, whole, c) for c in laws]
    record = whole.data.records[0][decision.joint - 1]
    ends = dict.fromkeys(at_ends(law, values, record) for values in each)
    return f" The improved model describes it by {waves(each)}.{''.join(ends)}"


def at_once(decisions: Sequence[Decision]) -> list[list[Decision]]:
    """Groups of joints pushed at the same times: their pushes overlap for half of the shorter one
    or more. In each group first the joint with the largest part of its own torque.
    """
    groups: list[list[Decision]] = []
    for d in sorted(decisions, key=lambda d: -d.before.value):
        if d.bursts is not None:
            mine = next((g for g in groups if _overlap(g[0].bursts, d.bursts) >= PREDICTED), [])
            if not mine:
                groups.append(mine)
            mine.append(d)
    return groups


def _overlap(one: Bursts | None, other: Bursts | None) -> float:
    """The overlap of two pushes as a part of the shorter one's time."""
    assert one is not None and other is not None
    both = sum(
        max(0.0, min(b, d) - max(a, c))
        for (a, b), name in zip(one.intervals, one.recordings, strict=True)
        for (c, d), of in zip(other.intervals, other.recordings, strict=True)
        if name == of
    )
    return both / max(min(sum(b - a for a, b in x.intervals) for x in (one, other)), 1e-300)


def _limits(given: Model, joint: int) -> tuple[str, ...]:
    """The laws by which a drive gives less than a large command asks for."""
    had = {t.effect for t in given.at(joint)}
    of_drive = (e for e in library().values() if e.mechanism == "actuator" and e.loosens_inertia)
    return tuple(e.name for e in of_drive if e.over != "time" and e.name not in had)


def _disturbance(pushed: Sequence[Decision], given: Model) -> Finding:
    """The finding of a push at one joint, or at several at once."""
    joint, found = pushed[0].joint, pushed[0].bursts
    assert found is not None
    unit = given.torque_unit(joint)
    text = (
        f"A torque over time that no state explains acts on joint {joint} at"
        f" {spans(found.intervals, found.recordings)}, up to {found.peak:.3g} {unit}."
    )
    if others := pushed[1:]:
        text += (
            f" It acts on {listed(d.joint for d in others)} at the same times: something pushes the"
            " machine, or its base moves."
        )
    same = _limits(given, joint) if found.driven else ()
    if same:
        text += (
            " The command is larger then than at any other time, so the drive may be at its limit."
            f" This recording cannot tell it from {', '.join(same)}."
        )
    values = {
        "rms": Estimate(found.rms, found.beside, unit),
        # the largest twentieth of an interval is left out, since an observer rings at its edges;
        # for a push of half a second the size was then a seventh too small
        "peak": Estimate(found.peak, math.hypot(found.beside, 0.1 * found.peak), unit),
    }
    numbers: Further = {
        "intervals": [[round(a, 4), round(b, 4)] for a, b in found.intervals],
        "recordings": list(found.recordings),
    }
    if others:
        numbers["details"] = {
            "also_on": [
                {"joint": d.joint, "rms": d.bursts.rms, "peak": d.bursts.peak}
                for d in others
                if d.bursts is not None
            ]
        }
    return Finding(
        "disturbance",
        joint,
        values,
        IN_TIME,
        found.share,
        same,
        (),
        text,
        numbers,
        "disturbance",
        {"disturbance": 1.0},
    )
