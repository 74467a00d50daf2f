"""Torques and delays missing at several joints at once, for which one common cause is likelier than
a law at each joint.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Claim, Decision, needed
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.nameless import without_law
from zendsp.diagnosis.decide.pieces import piece_of
from zendsp.diagnosis.decide.pushes import unpushed
from zendsp.diagnosis.decide.thresholds import (
    A_PART,
    OF_STATE,
    PREDICTED,
    SURE,
)
from zendsp.diagnosis.measure.curve import FRICTION
from zendsp.diagnosis.measure.discrepancy import discrepancy
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.likelihood import Scored, fit_scored
from zendsp.diagnosis.measure.significance import counterpart
from zendsp.diagnosis.measure.windows import rms, window_error
from zendsp.diagnosis.search.hypothesis import JointSearch, Rival
from zendsp.diagnosis.search.short_fits import WAIT
from zendsp.diagnosis.search.straps import Strap
from zendsp.physics.calibration.fit import joint_handles
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect, library, mechanism_of
from zendsp.physics.effects.column_shift import least_shift
from zendsp.physics.model import Model, Term

PLACE = "position_torque"
# largest ratio of the delays of two joints that may be the same delay: one filter over six joints
# was found as delays within 1.3; not measured further
ALIKE = 1.5
# least number of joints that must be late together where no single one is sure. Chosen: seen on one
# arm
LATE_TOGETHER = 3


def across_joints(decisions: Sequence[Decision], strap: Strap | None = None) -> list[Decision]:
    """The decisions, with laws removed where several joints lack a torque over position.

    A hose, a strap or a spring between links pulls at several joints. Its potential depends on all
    their positions, so a law at each joint is only a section through it. Ripples stay, since each
    belongs to its own motor. Bodies were considered before. At one of the joints the torque may
    also depend on the state without any law.

    Parameters
    ----------
    decisions : sequence of Decision
        One a joint.
    strap : Strap, optional
        A force between links that all joints together show.

    Returns
    -------
    list of Decision
        Where two or more joints are pulled, they keep the mechanism without a law. A constant
        torque at another joint counts as a part of it. Of a ``strap`` one joint keeps it, the one
        at which it pulls most.
    """
    pulled = strap.joints if strap is not None else ()
    claimed = sum(any(_pulls(c) for c in d.claims) for d in decisions)
    several = claimed > 0 and claimed + sum(_is_pulled(d) for d in decisions) > 1
    beside = _of_state(decisions) / A_PART

    def placed(c: Claim, d: Decision) -> Claim:
        one = several or d.joint in pulled
        section = _may_be_one(c) and (one or (_pulls(c) and c.size * d.scale < beside))
        return replace(without_law(c, d), mechanism=PLACE) if section else c

    out = [replace(d, claims=tuple(placed(c, d) for c in d.claims)) for d in decisions]
    return out if strap is None else _as_one(out, strap)


def may_be_strapped(decisions: Sequence[Decision]) -> bool:
    """Whether some joint is pushed, or claims a torque over its position or a constant, and another
    joint lacks something, too.
    """
    lacking = [d for d in decisions if d.kind != Verdict.COMPLETE]
    claims = [c for d in lacking for c in d.claims]
    pushed = any(d.kind == Verdict.DISTURBANCE for d in lacking)
    return len(lacking) > 1 and (pushed or any(_pulls(c) or _may_be_one(c) for c in claims))


def _as_one(decisions: Sequence[Decision], strap: Strap) -> list[Decision]:
    """The decisions, with the strap's torque over position claimed once, where it is largest.
    Pushes of its joints, and of the joints next to them, which its potential may leave out, are the
    strap's too.
    """
    reach = {joint + by for joint in strap.joints for by in (-1, 0, 1)}
    decisions = [
        unpushed(d) if d.kind == Verdict.DISTURBANCE and d.joint in reach else d for d in decisions
    ]
    open_ones = [d for d in decisions if d.kind in (Verdict.MISSING, Verdict.UNEXPLAINED)]
    of_it = {d.joint: _over_place(d) for d in open_ones if d.joint in strap.joints}
    most = max(of_it, key=lambda j: of_it[j].size * decisions[j - 1].scale, default=0)
    if not most or of_it[most].size < OF_STATE:
        return list(decisions)
    out = []
    for d in decisions:
        if d.joint in of_it:
            own = tuple(c for c in d.claims if c.effect == "unknown" and _pulls(c))
            others = tuple(c for c in d.claims if not any(c is o for o in own))
            claims = (of_it[d.joint], *others) if d.joint == most else others
            # elsewhere its law stays in the improved model
            drawn = [c for c in own if c.term.effect != "unknown" and d.joint != most]
            laws = (replace(c, effect=c.term.effect) for c in drawn)
            d = replace(
                d,
                kind=Verdict.MISSING if claims else Verdict.UNEXPLAINED,
                claims=claims,
                refinements=(*d.refinements, *laws),
                strap=strap.joints,
            )
        out.append(d)
    return out


def _over_place(d: Decision) -> Claim:
    """The torque over position that a joint lacks, as a claim without a law; where it claims none,
    the torque that any function of its state predicts.
    """
    own = (c for c in d.claims if c.effect == "unknown" and _pulls(c))
    term, seen = Term("unknown", d.joint, {}), Evidence(0.0, d.state.z, np.zeros(1))
    laws = {"unknown": 1.0}
    none = Claim("unknown", PLACE, term, d.state.size, seen, 0.0, laws, (), (), (), d.state)
    return next(own, none)


def _of_state(decisions: Sequence[Decision]) -> float:
    """The largest unexplained RMS torque that depends on the state of its joint."""
    return max((d.state.size * d.scale for d in decisions if _lacks_of_state(d)), default=0.0)


def _lacks_of_state(d: Decision) -> bool:
    return d.kind == Verdict.UNEXPLAINED and d.state.size > OF_STATE and d.state.z > SURE


def _is_pulled(d: Decision) -> bool:
    """Whether a joint's missing torque without a law is most like a torque over position."""
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


def pushed_alone(decisions: Sequence[Decision]) -> list[Decision]:
    """The decisions, with pushes removed beside a joint that lacks as much over its state without a
    law. Something that pulls at both joints may look like a function of the state at the one, and
    like a push that comes and goes at the other.

    Parameters
    ----------
    decisions : sequence of Decision
        One a joint.
    """
    most = _of_state(decisions) / PREDICTED
    return [
        unpushed(d) if d.kind == Verdict.DISTURBANCE and d.before.value * d.scale < most else d
        for d in decisions
    ]


def same_timing(parts: Parts, decisions: Sequence[Decision], jobs: int) -> list[Decision]:
    """The decisions, with one common law where several joints are late by the same time.

    A filter of all position columns, a current loop or a bus delays every joint alike, and a single
    joint can hardly tell which. So all joints decide together, also for a joint that would claim no
    law by itself. Where every joint names the same law, the other side of the loop is equally
    likely: a filter of all position columns looks like a command that is as late.

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
    """The decisions, with one law of timing where most joints are late by the same time, and by
    more than simulators differ. The torque of a delay may be below what stays unexplained at each
    single joint; the joints together can still be sure.

    Parameters
    ----------
    given : Model
        The model from which the search of the joints began.
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
    """Whether a term is a delay of the joint. A term that is no law of the library is none."""
    effect = library().get(term.effect)
    if effect is None:
        return False
    return effect.family == "timing" and (effect.parameters[0].lower or 0.0) >= 0.0


def _may_be_one_time(found: Sequence[Rival], least: float, joints: int) -> bool:
    """Whether enough joints are late by more than ``least`` s and by about the same time."""
    if len(found) < max(LATE_TOGETHER, joints / 2):
        return False
    terms = [counterpart(r.scored.model.at(r.joint), r.terms[0]) for r in found]
    times = [next(iter(t.parameters.values())).value for t in terms]
    return least < min(times) >= max(times) / ALIKE


def _of_many(parts: Parts, given: Model, search: JointSearch, rival: Rival, jobs: int) -> Claim:
    """The evidence for a law of timing at one joint, on untouched recordings."""
    mechanism = mechanism_of(rival.effect)
    term = counterpart(rival.scored.model.at(rival.joint), rival.terms[0])
    piece = piece_of(parts.test, given, rival.scored, mechanism, (term,), (search.base,), jobs)
    at = (piece.size, piece.evidence, piece.log_e)
    return Claim(rival.effect, mechanism, term, *at, {rival.effect: 1.0}, (), (), ())


def _late_as_all(decision: Decision, claim: Claim, scored: Scored, parts: Parts) -> Decision:
    """The decision with the common delay of all joints as its only claim."""
    after = discrepancy(parts.test, scored.model, decision.joint)
    return replace(
        decision, kind=Verdict.MISSING, claims=(claim,), refinements=(), bursts=None,
        final=scored, alone=scored, after=after, bare=after,
    )  # fmt: skip


def timing(decisions: Sequence[Decision]) -> tuple[Term, ...]:
    """The terms of timing for all joints, where command and position are apart in time at two or
    more joints. A joint that does not show it gets the term of another one.
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


def friction_beside(decisions: Sequence[Decision]) -> tuple[Term, ...]:
    """The missing friction that the joints claim. Beside unknown friction a body is too small to be
    found.
    """
    claims = (c for d in decisions for c in d.claims if c.effect != "unknown")
    return tuple(c.term for c in claims if c.mechanism in FRICTION)


def _is_late(claim: Claim) -> bool:
    """Whether a claim is a delay of the joint and nothing else."""
    return claim.effect != "unknown" and _comes_late(claim.term)


def _with_law(
    decision: Decision, names: Collection[str], times: tuple[float, float]
) -> Decision:
    """The decision with its likeliest law claimed, where that is one of ``names`` and its delay
    lies between ``times``.
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
    """The names of a law of timing and of those whose time is of the same kind."""
    family = {get_effect(name).family for name in names}
    times = {get_effect(name).names[0] for name in names}
    return {e.name for e in library().values() if e.family in family and e.names[0] in times}


def _either(decision: Decision, claim: Claim, others: Collection[str]) -> Decision:
    """The decision, its claim with all laws that cannot be told from it where several joints are
    equally late.
    """
    one = replace(claim, same=tuple(dict.fromkeys((*claim.same, *sorted(others)))))
    return replace(decision, claims=tuple(one if c is claim else c for c in decision.claims))


def _time(claim: Claim) -> float:
    return claim.term.value(get_effect(claim.term.effect).names[0])


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
    """The decision with one claim named by the common law of all joints, indistinguishable from the
    ``others`` that some joints had. It keeps its own law where the common one predicts untouched
    recordings worse than none.
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
