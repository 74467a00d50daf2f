"""What several joints lack at once: one common cause is likelier than a law at each."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Claim, Decision, needed
from zendsp.diagnosis.decide.nameless import without_law
from zendsp.diagnosis.decide.pieces import piece_of
from zendsp.diagnosis.decide.pushes import unpushed
from zendsp.diagnosis.decide.thresholds import (
    A_PART,
    AMISS,
    OF_STATE,
    PREDICTED,
    SURE,
)
from zendsp.diagnosis.measure.curve import FRICTION
from zendsp.diagnosis.measure.discrepancy import discrepancy
from zendsp.diagnosis.measure.likelihood import Scored, fit_scored
from zendsp.diagnosis.measure.significance import counterpart
from zendsp.diagnosis.measure.windows import rms, window_error
from zendsp.diagnosis.search.hypothesis import JointSearch, Rival
from zendsp.diagnosis.search.short_fits import WAIT
from zendsp.physics.calibration.fit import joint_handles
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect, library, mechanism_of
from zendsp.physics.effects.column_shift import least_shift
from zendsp.physics.model import Model, Term

PLACE = "position_torque"
# ratio of the times of two joints, at most, that may be one: one filter of six joints was found as
# times within 1.3; not measured further
ALIKE = 1.5
# joints at least that have to be late together, where none says so alone. Chosen: seen on one arm
LATE_TOGETHER = 3


def across_joints(decisions: Sequence[Decision]) -> list[Decision]:
    """The decisions, without laws where several joints lack a torque over position.

    What pulls at several joints (a hose, a strap, a spring between links) has a potential over all
    of them, of which a law at each joint is a section. A ripple is its own motor's, and a body has
    been asked for before. At one of the joints it may depend on the state and be none of the laws.

    Parameters
    ----------
    decisions : sequence of Decision
        One a joint.

    Returns
    -------
    list of Decision
        With the mechanism alone where two joints or more are pulled at; a constant torque at
        another joint is a part of it.
    """
    claimed = sum(any(_pulls(c) for c in d.claims) for d in decisions)
    several = claimed > 0 and claimed + sum(_is_pulled(d) for d in decisions) > 1
    beside = _of_state(decisions) / A_PART

    def section(c: Claim, d: Decision) -> bool:
        return _may_be_one(c) and (several or (_pulls(c) and c.size * d.scale < beside))

    return [
        replace(d, claims=tuple(_section(c, d) if section(c, d) else c for c in d.claims))
        for d in decisions
    ]


def overshadowed(square: float, decisions: Sequence[Decision]) -> bool:
    """Whether two joints or more lack a torque of their state that no law explains, and more of it
    than bodies explain at all joints: what pulls at them resembles a little of a body.

    Parameters
    ----------
    square : float
        Of what the bodies explain, as parts of the joints' RMS torques.
    decisions : sequence of Decision
        Beside the bodies, one a joint.
    """
    left = [d.state.size for d in decisions if _lacks_of_state(d) and d.state.size > AMISS]
    return len(left) > 1 and square < A_PART * sum(size**2 for size in left)


def _of_state(decisions: Sequence[Decision]) -> float:
    """The largest torque, RMS, that depends on the state of its joint and that nothing explains."""
    return max((d.state.size * d.scale for d in decisions if _lacks_of_state(d)), default=0.0)


def _lacks_of_state(d: Decision) -> bool:
    return d.kind == "unexplained" and d.state.size > OF_STATE and d.state.z > SURE


def _is_pulled(d: Decision) -> bool:
    """Whether what a joint lacks without a law is most like a torque over position."""
    return _lacks_of_state(d) and d.near is not None and _is_place(d.near.effect)


def _is_place(effect: str) -> bool:
    law = get_effect(effect)
    return law.mechanism == PLACE and "order" not in law.names


def _pulls(claim: Claim) -> bool:
    if claim.effect == "unknown":
        return claim.mechanism == PLACE
    return _is_place(claim.term.effect)


def _may_be_one(claim: Claim) -> bool:
    return claim.effect != "unknown" and (_pulls(claim) or claim.is_constant)


def _section(claim: Claim, decision: Decision) -> Claim:
    return replace(without_law(claim, decision), mechanism=PLACE)


def pushed_alone(decisions: Sequence[Decision]) -> list[Decision]:
    """The decisions, without pushes at joints beside one at which as much depends on the state and
    nothing explains it: of what pulls at both the one joint may show the states, the other only
    that they come and go.

    Parameters
    ----------
    decisions : sequence of Decision
        One a joint.
    """
    most = _of_state(decisions) / PREDICTED
    return [
        unpushed(d) if d.kind == "disturbance" and d.before.value * d.scale < most else d
        for d in decisions
    ]


def same_timing(parts: Parts, decisions: Sequence[Decision], jobs: int) -> list[Decision]:
    """The decisions, with one law where several joints come late by as much.

    A filter of all position columns, a current loop, a bus act on every joint alike; which of them
    it is, each joint can hardly tell. All together decide, also for a joint that by itself would
    claim no law; but where each names the same law, the other side of the loop is as likely: behind
    a filter of all position columns every joint feels where the others were some time ago, which a
    command that comes as late explains.

    Parameters
    ----------
    decisions : sequence of Decision
        One a joint.
    jobs : int
        Threads.
    """
    late = {d.joint: c for d in decisions for c in d.claims if _is_late(c)}
    times = [_time(c) for c in late.values()]
    names = sorted({c.effect for c in late.values()})
    if len(late) < 2 or max(times) > ALIKE * min(times):
        return list(decisions)
    nearby = (max(times) / ALIKE, min(times) * ALIKE)
    decisions = [_with_law(d, names, nearby) for d in decisions]
    late = {d.joint: c for d in decisions for c in d.claims if _is_late(c)}
    if len(names) == 1:
        alike = _alike({names[0], *(n for c in late.values() for n in c.same)}) - {names[0]}
        return [_either(d, late[d.joint], alike) if d.joint in late else d for d in decisions]
    tried = {
        name: {
            d.joint: _in_place(d, late[d.joint], name, jobs) for d in decisions if d.joint in late
        }
        for name in names
    }
    best = min(names, key=lambda name: sum(s.deviance for s in tried[name].values()))
    others = tuple(name for name in names if name != best)
    return [
        _renamed(d, late[d.joint], best, others, tried[best][d.joint], parts)
        if d.joint in late
        else d
        for d in decisions
    ]


def all_late(
    parts: Parts,
    given: Model,
    searches: Sequence[JointSearch],
    decisions: Sequence[Decision],
    jobs: int,
) -> list[Decision]:
    """The decisions, with one law of timing where most joints come late by as much, and by more
    than simulators differ in: what it is may be less at each joint than what stays unexplained
    there, and all together say what none says alone.

    Parameters
    ----------
    given : Model
        What the joints were searched upon.
    searches, decisions : sequence
        One a joint, in their order.
    jobs : int
        Threads.
    """
    first = parts.fit.records[0][0]
    least = least_shift(first.sample_time, first.between > 0.0)
    by_name: dict[str, list[Rival]] = {}
    for search, decision in zip(searches, decisions, strict=True):
        free = all(c.effect == "unknown" and _comes_late(c.term) for c in decision.claims)
        if free and not any(rec[search.joint - 1].between for rec in parts.fit.records):
            for r in search.tried:
                if _comes_late(r.terms[0]) and r.value < search.base.deviance - WAIT:
                    by_name.setdefault(r.effect, []).append(r)
    alike = [found for found in by_name.values() if _may_be_one_time(found, least, len(searches))]
    if not alike:
        return list(decisions)

    def gain(found: Sequence[Rival]) -> float:
        return sum(searches[r.joint - 1].base.deviance - r.value for r in found)

    best = max(alike, key=gain)
    claims = {r.joint: _of_many(parts, given, searches[r.joint - 1], r, jobs) for r in best}
    shown = [c.log_e for c in claims.values()]
    if sum(shown) < needed(len(searches)) or sum(x > 0.0 for x in shown) < LATE_TOGETHER:
        return list(decisions)
    same = _alike({best[0].effect}) - {best[0].effect}
    late = {r.joint: r.scored for r in best}
    return [
        _late_as_all(d, replace(claims[d.joint], same=tuple(sorted(same))), late[d.joint], parts)
        if d.joint in late and claims[d.joint].log_e > 0.0
        else d
        for d in decisions
    ]


def _comes_late(term: Term) -> bool:
    """Whether a term is a time by which the joint comes late; it may be no law at all."""
    effect = library().get(term.effect)
    if effect is None:
        return False
    return effect.family == "timing" and (effect.parameters[0].lower or 0.0) >= 0.0


def _may_be_one_time(found: Sequence[Rival], least: float, joints: int) -> bool:
    """Whether enough joints come late, by more than ``least`` s and all by about as much."""
    if len(found) < max(LATE_TOGETHER, joints / 2):
        return False
    terms = [counterpart(r.scored.model.at(r.joint), r.terms[0]) for r in found]
    times = [next(iter(t.parameters.values())).value for t in terms]
    return least < min(times) >= max(times) / ALIKE


def _of_many(parts: Parts, given: Model, search: JointSearch, rival: Rival, jobs: int) -> Claim:
    """What a law of timing is worth at one joint, on untouched recordings."""
    mechanism = mechanism_of(rival.effect)
    term = counterpart(rival.scored.model.at(rival.joint), rival.terms[0])
    piece = piece_of(parts.test, given, rival.scored, mechanism, (term,), search.base, jobs)
    at = (piece.size, piece.evidence, piece.log_e)
    return Claim(rival.effect, mechanism, term, *at, {rival.effect: 1.0}, (), (), ())


def _late_as_all(decision: Decision, claim: Claim, scored: Scored, parts: Parts) -> Decision:
    """The decision with the time by which all joints are late, and nothing else."""
    after = discrepancy(parts.test, scored.model, decision.joint)
    return replace(
        decision, kind="missing", claims=(claim,), refinements=(), bursts=None,
        final=scored, alone=scored, after=after, bare=after,
    )  # fmt: skip


def timing(decisions: Sequence[Decision]) -> tuple[Term, ...]:
    """The terms by which command and position are apart in time, where they are at two joints or
    more; at a joint where that does not show, as at another one.
    """
    terms = {
        d.joint: c.term
        for d in decisions
        for c in d.claims
        if c.effect != "unknown" and get_effect(c.effect).family == "timing"
    }
    if len(terms) < 2:
        return ()
    like = next(iter(terms.values()))
    return tuple(terms.get(d.joint, replace(like, joint=d.joint)) for d in decisions)


def friction_beside_weight(decisions: Sequence[Decision]) -> tuple[Term, ...]:
    """The friction that joints lack, where one claims what a body may be: a torque over position,
    an inertia, a constant. Before it was known, such a body was small beside it.
    """
    claims = [c for d in decisions for c in d.claims if c.effect != "unknown"]
    if not any(c.mechanism in (PLACE, "inertia") or c.is_constant for c in claims):
        return ()
    return tuple(c.term for c in claims if c.mechanism in FRICTION)


def _is_late(claim: Claim) -> bool:
    """Whether a claim is of a time by which the joint comes late, and nothing else."""
    return claim.effect != "unknown" and _comes_late(claim.term)


def _with_law(
    decision: Decision, names: Collection[str], times: tuple[float, float]
) -> Decision:
    """The decision with the law that it was likeliest of, where that is one of ``names`` and its
    time lies between ``times``.
    """
    claims = tuple(
        replace(c, effect=c.term.effect)
        if c.effect == "unknown"
        and c.term.effect in names
        and times[0] <= _time(c) <= times[1]
        and any(t.effect == c.term.effect for t in decision.final.model.at(decision.joint))
        else c
        for c in decision.claims
    )
    return replace(decision, claims=claims)


def _alike(names: Collection[str]) -> set[str]:
    """Laws of timing, with those that have the same numbers."""
    family = {get_effect(name).family for name in names}
    shapes = {get_effect(name).names for name in names}
    return {e.name for e in library().values() if e.family in family and e.names in shapes}


def _either(decision: Decision, claim: Claim, others: Collection[str]) -> Decision:
    """The decision, with what cannot be told from a claim where several joints come late alike."""
    one = replace(claim, same=tuple(dict.fromkeys((*claim.same, *sorted(others)))))
    return replace(decision, claims=tuple(one if c is claim else c for c in decision.claims))


def _time(claim: Claim) -> float:
    (quantity,) = claim.term.parameters.values()
    return quantity.value


def _in_place(decision: Decision, claim: Claim, name: str, jobs: int) -> Scored:
    """The final model with another timing law in place of the claimed one, fitted again."""
    final, joint = decision.final, decision.joint
    old = counterpart(final.model.at(joint), claim.term)
    if name == old.effect:
        return final
    effect = get_effect(name)
    term = make_term(effect, joint, {effect.parameters[0].name: _time(claim)})
    model = final.model.with_terms(tuple(term if t is old else t for t in final.model.terms))
    handles = joint_handles(final.data, model, joint)
    return fit_scored(final.data, model, handles, (joint,), jobs=jobs, rounds=2)


def _renamed(
    decision: Decision,
    claim: Claim,
    name: str,
    others: tuple[str, ...],
    scored: Scored,
    parts: Parts,
) -> Decision:
    """The decision with one claim by the law of all joints, which cannot be told from the
    ``others`` that some of them had; its own law, where untouched recordings are worse for the
    change than without any.
    """
    joint = decision.joint
    errors = [rms(window_error(parts.test, m, joint)) for m in (decision.base.model, scored.model)]
    if errors[1] > errors[0]:
        return decision
    term = counterpart(scored.model.at(joint), replace(claim.term, effect=name))
    same = tuple(dict.fromkeys((*claim.same, *others)))
    one = replace(
        claim,
        effect=name,
        mechanism=mechanism_of(name),
        term=term,
        laws={name: 1.0},
        same=tuple(n for n in same if n != name),
    )
    claims = tuple(one if c is claim else c for c in decision.claims)
    return replace(decision, claims=claims, final=scored, alone=scored)
