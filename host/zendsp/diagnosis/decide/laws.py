"""The law by which a claimed mechanism is named, or none; and what only refines the fit."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Claim, Decision, Piece
from zendsp.diagnosis.decide.confidence import confidence, likely_enough, stated
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.nameless import by_its_variables, told_apart, without_law
from zendsp.diagnosis.decide.near import ANOTHER, LEAVES_MORE, doubt, why_curve
from zendsp.diagnosis.decide.patchwork import (
    bends,
    both_needed,
    draws_a_curve,
    is_curve,
    makes_another_grow,
    part_of_a_wave,
    stand_on_nothing,
    twins,
)
from zendsp.diagnosis.decide.pieces import (
    kept_laws,
    kind_of,
    known_discrepancy,
    law_leaves,
    may_leave,
    piece_of,
    rms_torque,
    rubs,
    sure,
    taken_away,
    turns_round,
)
from zendsp.diagnosis.decide.rivals import law_of, together
from zendsp.diagnosis.decide.thresholds import (
    A_PART,
    BY_CHANCE,
    CURVE,
    LAW_ERROR,
    LEFT_BY_A_LAW,
    OF_STATE,
    OWN_SHARE,
    PLAIN,
    PREDICTED,
    SIMULATORS_DIFFER,
    STATED_ALONE,
    STATED_BESIDE,
    SURE,
)
from zendsp.diagnosis.measure.bursts import periodic
from zendsp.diagnosis.measure.curve import DRY, FLUID, FRICTION
from zendsp.diagnosis.measure.discrepancy import Size, discrepancy
from zendsp.diagnosis.measure.likelihood import Scored, fit_scored
from zendsp.diagnosis.measure.neighbours import against_neighbours
from zendsp.diagnosis.measure.significance import counterpart, deviation
from zendsp.diagnosis.measure.structure import STRUCTURED, Structure, structure
from zendsp.diagnosis.measure.wandering import wanders
from zendsp.diagnosis.progress import Progress
from zendsp.diagnosis.search.hypothesis import JointSearch
from zendsp.diagnosis.search.rounds import Rounds
from zendsp.physics.calibration.fit import Data, joint_handles
from zendsp.physics.effects import get_effect, mechanism_of
from zendsp.physics.model import Model, Term

Array = npt.NDArray[np.float64]


def named(
    parts: Parts,
    given: Model,
    search: JointSearch,
    final: Scored,
    claimed: Sequence[Piece],
    rest: Sequence[Piece],
    before: Size,
    jobs: int,
    tell: Progress,
) -> Decision:
    """The claims and refinements of a joint: each mechanism by its law, or by none where no law
    describes it.

    Parameters
    ----------
    final : Scored
        The model of the search with its claims, against which every law is compared.
    claimed, rest : sequence of Piece
        Mechanisms that the untouched recordings show, and those that only improve the fit.
    before : Size
        The missing torque without them.
    """
    joint = search.joint
    rounds = Rounds(parts.fit, joint, jobs, tell, given)
    after = discrepancy(parts.test, final.model, joint)
    state = structure(parts.each, final.model, joint, STRUCTURED)
    known = known_discrepancy(given, parts.test, joint)
    scale = rms_torque(parts.test, joint)
    bent = stand_on_nothing(final, joint, scale)
    judge = _Judge(parts, given, final, claimed, joint, after, known.of_state, bent)
    claims: list[Claim] = []
    refinements: list[Claim] = []
    for piece in claimed:
        only_bends = all(any(t is x for x in bent) for t in piece.terms)
        if only_bends or _turns_a_known_one(parts, given, final, piece, before):
            rest = [*rest, piece]
            continue
        ranked = _ranked(parts.test, given, final, piece, search.base, jobs)
        ranked = _upon(ranked, after.value)
        first = ranked[0]
        law = law_of(parts, given, search, rounds, final, piece, first, tell)
        own, beside = judge.findings_among(ranked, piece)
        refinements += [c for p in beside for c in _plain(p)]
        left = judge.left_by(piece)
        why = judge.why_no_law(piece, ranked, own, left)
        if why:
            refinements += [c for p in own[1:] for c in _plain(p)]
            claims.append(replace(law, effect="unknown", left=left, why=why))
            continue
        claims.append(replace(law, left=left, size=first.size if len(own) > 1 else piece.size))
        claims += [law_of(parts, given, search, rounds, final, p, p, tell) for p in own[1:]]
    refinements += [c for p in rest for c in _plain(p)]
    claims.sort(key=lambda c: -c.evidence.gain)
    claims, more = _beside_unknown(claims, after.value)
    refinements += more
    best = claims[0].size if claims else 0.0
    # more torque over the state is left than any claim explains
    if state.size > best and state.z > SURE:
        claims = []
    alone = _alone(given, final, joint, claims, refinements, jobs)
    return Decision(
        joint,
        Verdict.MISSING,
        tuple(claims),
        tuple(refinements),
        search.base,
        final,
        before,
        after,
        state,
        after if alone is final else discrepancy(parts.test, alone.model, joint),
        alone,
        scale,
        known=known,
    )


@dataclass(frozen=True)
class _Judge:
    """Judges whether a law describes its mechanism at a joint.

    ``after``: torque left with all that is ``claimed``. ``known``: the part over the state that
    this machine is known to leave. ``bent``: terms whose base law has vanished.
    """

    parts: Parts
    given: Model
    final: Scored
    claimed: Sequence[Piece]
    joint: int
    after: Size
    known: float
    bent: Sequence[Term]

    def findings_among(
        self, ranked: Sequence[Piece], piece: Piece
    ) -> tuple[list[Piece], list[Piece]]:
        """The laws of a mechanism that are findings of their own, the first always among them; and
        the others, which only refine.
        """
        own: list[Piece] = [ranked[0]]
        beside: list[Piece] = []
        for other in ranked[1:]:
            large = other.size**2 >= OWN_SHARE * piece.size**2
            counts = _counts(other, ranked[0], self.after.value)
            apart = large and not _one_with(ranked[0], other) and counts
            (own if apart else beside).append(other)
        return own, beside

    def left_by(self, piece: Piece) -> Structure | None:
        """The remaining torque that the mechanism's variables predict; None where it has no
        variables.
        """
        if piece.mechanism not in STRUCTURED:
            return None
        # how dry friction acts at reversals (bristles, a soft simulator) refines its law
        turning = piece.mechanism != DRY
        return structure(self.parts.each, self.final.model, self.joint, [piece.mechanism], turning)

    def why_no_law(
        self, piece: Piece, ranked: Sequence[Piece], own: Sequence[Piece], left: Structure | None
    ) -> str:
        """The reason that no law describes a mechanism; empty where its first one does."""
        first, of_position = ranked[0], piece.mechanism == "position_torque"
        travel = max(rec[self.joint - 1].scale.position for rec in self.parts.fit.records)
        # a constant beside several laws over the position is a part of the curve that they form
        level = sum(all(get_effect(t.effect).constant for t in p.terms) for p in self.claimed)
        pieces = len(own) + (level if of_position and len(own) > 1 else 0)
        return why_curve(
            {
                LEAVES_MORE: self._leaves_more(piece, ranked, own, left),
                "laws that are no harmonics of one, or not told apart, draw a curve": (
                    of_position and is_curve(ranked, travel)
                ),
                "the level of its friction changes with time otherwise than it says": (
                    self._wanders(first)
                ),
                "the travel shows no whole period of it": (
                    part_of_a_wave(
                        first.terms[0], level + len(own) - 1, travel, self._of_a_turn(first)
                    )
                ),
                "it stands upon what it bends": self._bends_what_it_stands_on(first),
                f"{pieces} laws of one mechanism draw any curve": pieces >= CURVE,
            }
        )

    def _leaves_more(
        self,
        piece: Piece,
        ranked: Sequence[Piece],
        own: Sequence[Piece],
        left: Structure | None,
    ) -> bool:
        kind = [p for p in self.claimed if p.mechanism in kind_of(piece.mechanism)]
        # neither a larger law's error nor the known discrepancy speaks against this law
        allowed = math.hypot(max(may_leave(p) for p in kind), self.known)
        least = max(allowed, SIMULATORS_DIFFER)  # untouched recordings have to show this much
        # torque over its own variables that the law leaves when it is alone
        law = _plain(ranked[0])[0]
        beside = [
            p.size
            for p in ranked[1:]
            if bends(self.final, _plain(p)[0], law, any(p is o for o in own))
            and sure(self.parts.test, p)
        ]
        return math.hypot(*beside) > least or (
            left is not None and self.after.high > least and _surely_more(left, least)
        )

    def _of_a_turn(self, first: Piece) -> float:
        """How well the period of a law is known, rad; infinite where the joint slides."""
        turns = self.given.joint_kind(self.joint) != "linear"
        return deviation(self.final.fit, first.terms[0], "period") if turns else math.inf

    def _wanders(self, first: Piece) -> bool:
        """Whether a law over time leaves a friction that changes with time in each recording by
        itself. (Its other variables do not show that: the friction's sum over time is right.)
        """
        law = get_effect(first.terms[0].effect)
        if law.over != "time" or first.mechanism not in FRICTION:
            return False
        left = wanders(self.parts.test, self.final.model, self.joint)
        # however many its numbers: the same in all recordings, they imitate nothing that differs
        return _surely_more(left, max(LEFT_BY_A_LAW * first.size, SIMULATORS_DIFFER))

    def _bends_what_it_stands_on(self, first: Piece) -> bool:
        return (bool(self.bent) and first.mechanism in FRICTION) or (
            first.mechanism == FLUID and makes_another_grow(self.given, self.final, first.terms[0])
        )


def _turns_a_known_one(
    parts: Parts, given: Model, final: Scored, piece: Piece, before: Size
) -> bool:
    """Whether a mechanism only changes a known dry friction at reversals and explains little of the
    missing torque. It is then a second law of that friction. Softness, as of bristles, makes
    friction smaller at reversals; a mechanism that makes it larger does not count.
    """
    joint = piece.terms[0].joint
    return (
        piece.size**2 < OWN_SHARE * before.value**2
        and bool(kept_laws(given, final.model, joint, DRY))
        and turns_round(parts, final, piece)
    )


def _alone(
    given: Model,
    final: Scored,
    joint: int,
    claims: Sequence[Claim],
    more: Sequence[Claim],
    jobs: int,
) -> Scored:
    """The claims alone, fitted again, with the terms restored that the refinements had replaced.
    Refinements could be bent to what no claimed law describes.
    """
    needed = any(get_effect(c.term.effect).needs for c in claims)
    rubs = any(c.mechanism == DRY and c.effect != "unknown" for c in claims)

    def stays(c: Claim) -> bool:  # as Coulomb friction, which every machine has, beside its law
        rubs_as_any = c.mechanism == DRY and (needed or (rubs and get_effect(c.term.effect).common))
        return rubs_as_any or any(both_needed(final, k, c) for k in claims)

    terms = [c.term for c in more if not stays(c)]
    terms = [t for t in final.model.terms if any(t is x for x in terms)]
    if not claims or not terms:
        return final
    model = taken_away(given, final.model, joint, terms)
    handles = joint_handles(final.data, model, joint)
    return fit_scored(final.data, model, handles, (joint,), jobs=jobs, rounds=1)


def believed(decision: Decision, parts: Parts, given: Model, jobs: int) -> Decision:
    """The decision without laws that are likely wrong and not surely better than their neighbours.
    The first of them stays as a mechanism without a law, where its variables can be told from
    others' and it explains more than it leaves. The others become refinements.
    """
    decision = _upon_common(decision, parts, given, jobs)
    twin = twins(decision.claims)
    likely = [
        c
        for c in decision.claims
        if not any(c is t for t in twin) and _is_likely(c, decision, parts)
    ]
    likely, alone, ahead, fell = _standing(likely, decision, parts, given, jobs)
    laws = {c.effect for c in likely if c.effect != "unknown"}
    most = _beside_doubted(likely, fell, alone, decision, parts, given, jobs)
    keep, more = [], list(decision.refinements)
    doubted: set[str] = set()  # mechanisms: a law beside a doubted one may be a part of it
    for claim in decision.claims:
        key = id(claim)
        why = fell.get(key) or doubt(confidence(claim, decision))
        if claim.effect == "unknown":
            if told_apart(claim, decision, parts, given, laws):
                keep.append(without_law(claim, decision))
        elif claim.mechanism not in doubted and key in ahead:
            keep.append(replace(claim, ahead=ahead[key], most=most.get(key, 1.0)))
        elif (
            claim is decision.claims[0]
            and claim.mechanism in STRUCTURED
            and not claim.is_constant  # which is a function of any variable
            and claim.size > decision.after.value
            and not _turns_otherwise(claim, decision, parts)
            and told_apart(claim, decision, parts, given, laws - {claim.effect})
        ):
            keep.append(replace(without_law(claim, decision), why=why))
            doubted.add(claim.mechanism)
        else:
            more.append(replace(claim, why=why))
            doubted.add(claim.mechanism)
    keep, parts_of_it = _beside_unknown(keep, decision.after.value)
    # beside a law of the one friction, what lacks of the other has its own name
    rubbing = {c.mechanism for c in keep if c.effect != "unknown"} & set(FRICTION)
    keep = [c if rubbing else by_its_variables(c, decision, parts, given) for c in keep]
    return replace(decision, claims=tuple(keep), refinements=tuple(more + parts_of_it))


def _standing(
    likely: Sequence[Claim], decision: Decision, parts: Parts, given: Model, jobs: int
) -> tuple[list[Claim], Scored, dict[int, float], dict[int, str]]:
    """The claims whose laws stand beside one another alone, without the terms of those that fell;
    the model with them alone; by ``id`` how far each is ahead of its neighbours; and, of those that
    fell, the reason.
    """
    fell: dict[int, str] = {}
    while True:
        stand = [c for c in likely if id(c) not in fell]
        alone = _without_others(stand, decision, given, jobs)
        ahead: dict[int, float] = {}
        for claim in (c for c in stand if c.effect != "unknown"):
            by = _goes_on(claim, alone, decision, parts)
            if _hid(claim, alone, decision, parts):
                fell[id(claim)] = LEAVES_MORE
            elif by is None:
                fell[id(claim)] = ANOTHER
            else:
                ahead[id(claim)] = by
        if len(ahead) == sum(c.effect != "unknown" for c in stand):
            return stand, alone, ahead, fell


def _upon_common(decision: Decision, parts: Parts, given: Model, jobs: int) -> Decision:
    """The decision with a doubted dry friction, where the given model has none, as the law that
    every machine has and upon which the doubted one stands. That one becomes a refinement.
    """
    claims, refinements = list(decision.claims), list(decision.refinements)
    for k, claim in enumerate(decision.claims):
        needs = get_effect(claim.term.effect).needs
        base = next((r for r in refinements if r.effect in needs), None)
        if claim.effect == "unknown" or base is None or rubs(given, decision.joint):
            continue
        if not _is_likely(claim, decision, parts):
            right = confidence(claim, decision)
            laws = {base.effect: 1.0 - right, **{n: right * p for n, p in claim.laws.items()}}
            claims[k] = replace(
                claim, effect=base.effect, term=base.term, laws=laws, same=base.same
            )
            refinements[refinements.index(base)] = claim
    if all(a is b for a, b in zip(claims, decision.claims, strict=True)):
        return decision
    joint = decision.joint
    alone = _alone(given, decision.final, joint, claims, refinements, jobs)
    bare = discrepancy(parts.test, alone.model, joint)
    return replace(
        decision, claims=tuple(claims), refinements=tuple(refinements), alone=alone, bare=bare
    )


def _beside_doubted(
    likely: Sequence[Claim],
    fell: Collection[int],
    alone: Scored,
    decision: Decision,
    parts: Parts,
    given: Model,
    jobs: int,
) -> dict[int, float]:
    """The confidence of laws, by ``id``, that stand beside doubted ones: the confidence with and
    without the doubted law, weighed by how likely that law is (not at all if it ``fell``).
    """
    sure = {
        id(c): 0.0 if id(c) in fell else confidence(c, decision)
        for c in decision.claims
        if c.effect != "unknown"
    }
    firm = [c for c in likely if sure.get(id(c), 1.0) > STATED_BESIDE]
    doubted = [sure.get(id(c), 1.0) for c in decision.claims if not any(c is f for f in firm)]
    laws = [c for c in firm if id(c) in sure]
    if not laws or not doubted:
        return {}
    whole = len(firm) == len(likely)
    firmly = alone if whole else _without_others(firm, decision, given, jobs)
    left = discrepancy(parts.test, firmly.model, decision.joint)
    harder = replace(decision, bare=max(left, decision.bare, key=lambda size: size.low))
    right = min(doubted)
    return {id(c): right * sure[id(c)] + (1.0 - right) * confidence(c, harder) for c in laws}


def _is_likely(claim: Claim, decision: Decision, parts: Parts) -> bool:
    """Whether a law is likely enough to be named."""
    return (
        claim.effect == "unknown"
        or stated(claim, decision)
        or (
            confidence(claim, decision) > STATED_ALONE
            and SURE < _ahead(claim, decision.alone, parts) < math.inf
        )
        or _behind_a_transmission(claim, decision, parts)
    )


def _without_others(claims: Sequence[Claim], decision: Decision, given: Model, jobs: int) -> Scored:
    """Some of the claims by themselves."""
    rest = [c for c in decision.claims if not any(c is k for k in claims)]
    if not claims or not rest:
        return decision.alone
    others = [*decision.refinements, *rest]
    return _alone(given, decision.final, decision.joint, claims, others, jobs)


def _behind_a_transmission(claim: Claim, decision: Decision, parts: Parts) -> bool:
    """Whether a load behind a transmission explains most of the missing torque, and that is no
    function of the state. Only a load with motion of its own does this, however freely its numbers
    can be bent; or a sine in time, on which the observer keeps a load that hardly damps.
    """
    if get_effect(claim.effect).family != "transmission":
        return False
    model, joint = decision.base.model, decision.joint
    least = PREDICTED * decision.before.value**2
    if not decision.after.value**2 < (1.0 - PREDICTED) * decision.before.value**2:
        return False
    state = structure(parts.each, model, joint, STRUCTURED)
    return state.share < PREDICTED and periodic(parts.held, model, joint) ** 2 < least


def _hid(claim: Claim, alone: Scored, decision: Decision, parts: Parts) -> bool:
    """Whether terms that are not stated hid what a law leaves over its own variables; not where one
    of them stands upon it, as a doubted Stribeck curve does upon Coulomb friction.
    """
    others = (*decision.refinements, *decision.claims)
    upon = any(claim.effect in get_effect(c.term.effect).needs for c in others)
    if claim.mechanism not in STRUCTURED or upon or alone is decision.final:
        return False
    bare = structure(
        parts.each, alone.model, decision.joint, [claim.mechanism], claim.mechanism != DRY
    )
    allowed = math.hypot(law_leaves(claim.size, [claim.term]), decision.known.of_state)
    return _surely_more(bare, max(allowed, SIMULATORS_DIFFER))


def _goes_on(claim: Claim, alone: Scored, decision: Decision, parts: Parts) -> float | None:
    """The standard deviations by which a law predicts better than its neighbours. None where that
    is less sure than a law has to be; for one that every machine has, or a constant, where a
    neighbour surely predicts better.
    """
    effect = get_effect(claim.effect)
    if claim.mechanism not in STRUCTURED:
        return math.inf
    ahead = _ahead(claim, alone, parts)
    plain = effect.common or effect.constant
    if ahead <= -PLAIN or not (plain or likely_enough(claim.effect, ahead, decision)):
        return None
    return math.inf if plain else ahead


def _ahead(claim: Claim, alone: Scored, parts: Parts) -> float:
    """The standard deviations by which a function of the state predicts better than its neighbours;
    -inf for a mechanism that is no function of the state.
    """
    if claim.mechanism not in STRUCTURED:
        return -math.inf
    joint = claim.term.joint
    term = counterpart(alone.model.at(joint), claim.term)
    turning = claim.mechanism != DRY
    return against_neighbours(together(*parts.each), alone, term, joint, LAW_ERROR, turning)


def _turns_otherwise(claim: Claim, decision: Decision, parts: Parts) -> bool:
    """Whether a known dry friction only acts differently at reversals: nothing is missing while the
    joint moves.
    """
    if claim.mechanism != DRY or not rubs(decision.base.model, decision.joint):
        return False
    model = decision.base.model
    moving = structure(parts.each, model, decision.joint, [DRY], turning=False)
    return moving.size < OF_STATE or moving.z < SURE


def _beside_unknown(claims: Sequence[Claim], left: float) -> tuple[list[Claim], list[Claim]]:
    """The claims, and those that become refinements beside a mechanism without a law. A claim no
    larger than half of it may be a part of it. A constant, or what repeats along the position, is
    always a part of a curve over position. Where nothing is ``left``, only claims over the same
    variables are a part of it.
    """
    without = [c for c in claims if c.effect == "unknown"]
    unknown = max((c.size for c in without), default=0.0)
    kinds = {m for c in without for m in kind_of(c.mechanism)}
    curve = any(draws_a_curve(c) for c in claims)

    def large(claim: Claim) -> bool:
        tells = claim.mechanism in STRUCTURED and claim.mechanism not in kinds
        apart = left < SIMULATORS_DIFFER and tells
        return claim.size > (LAW_ERROR if apart else A_PART) * unknown

    def of_position(claim: Claim) -> bool:
        effect = get_effect(claim.effect)
        return effect.constant or "order" in effect.names

    keep = [
        c for c in claims if c.effect == "unknown" or (large(c) and not (curve and of_position(c)))
    ]
    return keep, [c for c in claims if not any(c is k for k in keep)]


def _surely_more(left: Structure, allowed: float) -> bool:
    """Whether the remaining torque has more energy than allowed, by two standard deviations. One
    that acts seldom gains in few blocks, but not by chance.
    """
    if left.size <= allowed:
        return False
    more = 1.0 - (allowed / left.size) ** 2
    return left.z * more > PLAIN or left.apart * more > BY_CHANCE


def _ranked(
    test: Data, given: Model, final: Scored, piece: Piece, base: Scored, jobs: int
) -> list[Piece]:
    """The laws of a mechanism as single pieces, the one whose removal costs most first. Where they
    replace one another, so that no removal costs much, the one found first.
    """
    laws = [t for t in piece.terms if mechanism_of(t.effect) == piece.mechanism]
    if len(laws) == 1:
        return [replace(piece, terms=tuple(laws))]
    each = [piece_of(test, given, final, piece.mechanism, (t,), base, jobs) for t in laws]
    ranked = sorted(each, key=lambda p: -p.size)
    if ranked[0].size ** 2 < OWN_SHARE * piece.size**2:
        ranked.sort(key=lambda p: p is not each[0])
    return ranked


def _upon(ranked: Sequence[Piece], after: float) -> list[Piece]:
    """The laws in order, first the one that stands upon the largest, as a Stribeck curve does upon
    Coulomb friction: the two are one law. Bristles and other laws with a state of their own do not
    count.
    """
    largest = ranked[0]
    for other in ranked[1:]:
        effect = get_effect(other.terms[0].effect)
        if (
            set(largest.effects) & set(effect.needs)
            and not effect.hidden
            and _counts(other, largest, after)
        ):
            whole = replace(other, size=largest.size, evidence=largest.evidence)
            return [whole, *[p for p in ranked if p is not other]]
    return list(ranked)


def _one_with(first: Piece, other: Piece) -> bool:
    """Whether a second law belongs to the first: the first stands upon it, or both are couplings
    from the same other joint.
    """
    effect = get_effect(first.terms[0].effect)
    return effect.coupled or not set(other.effects).isdisjoint(effect.needs)


def _counts(other: Piece, first: Piece, after: float) -> bool:
    """Whether a second law of a mechanism exceeds what is left and the error of the first."""
    more = other.size > math.hypot(after, LAW_ERROR * first.size)
    return more and other.log_e > 0 and other.evidence.z > PLAIN


def _plain(piece: Piece) -> list[Claim]:
    """The refinements of a piece, one for each law, with the size and evidence of the whole piece.
    """
    at = (piece.size, piece.evidence, piece.log_e)
    return [Claim(t.effect, piece.mechanism, t, *at, {}, (), (), ()) for t in piece.terms]
