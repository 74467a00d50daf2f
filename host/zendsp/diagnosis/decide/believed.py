"""Which of the named laws are believed: each is judged again beside the other named laws alone,
without the terms that are not stated.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Claim, Decision, needed
from zendsp.diagnosis.decide.confidence import confidence, likely_enough, stated
from zendsp.diagnosis.decide.law_torque import has, kept_laws, kind_of, law_leaves, rubs
from zendsp.diagnosis.decide.nameless import (
    beside_laws,
    by_its_variables,
    told_apart,
    without_law,
)
from zendsp.diagnosis.decide.near import LEAVES_MORE, TWIN, bent, doubt
from zendsp.diagnosis.decide.patchwork import (
    both_needed,
    draws_a_curve,
    twins,
)
from zendsp.diagnosis.decide.pieces import taken_away
from zendsp.diagnosis.decide.rivals import together
from zendsp.diagnosis.decide.thresholds import (
    A_PART,
    BY_CHANCE,
    CLAIMED,
    LAW_ERROR,
    OF_STATE,
    PLAIN,
    PREDICTED,
    SIMULATORS_DIFFER,
    STATED_ALONE,
    STATED_BESIDE,
    SURE,
)
from zendsp.diagnosis.measure.bursts import periodic
from zendsp.diagnosis.measure.curve import DRY, FRICTION
from zendsp.diagnosis.measure.discrepancy import discrepancy
from zendsp.diagnosis.measure.likelihood import Scored, fit_scored
from zendsp.diagnosis.measure.neighbours import against_neighbours
from zendsp.diagnosis.measure.own_variable import drawn_by_its_variable
from zendsp.diagnosis.measure.significance import counterpart
from zendsp.diagnosis.measure.structure import STRUCTURED, Structure, structure
from zendsp.physics.calibration.fit import joint_handles
from zendsp.physics.effects import get_effect, mechanism_of, stands_on
from zendsp.physics.model import Model


def believed(decision: Decision, parts: Parts, given: Model, jobs: int) -> Decision:
    """The decision without laws that are likely wrong and not surely better than their neighbours.
    The first of them stays as a mechanism without a law, where its variables can be told from
    others' and it explains more than it leaves. The others become refinements.
    """
    decision = _upon_common(decision, parts, given, jobs)
    twin = twins(decision.claims, decision.final)
    likely = [
        c
        for c in decision.claims
        if not any(c is t for t in twin) and _is_likely(c, decision, parts)
    ]
    likely, alone, ahead, fell = _standing(likely, decision, parts, given, jobs)
    first = _may_lack_a_law(ahead, decision, parts, given)
    if first is not None and _new_and_common(first, given):
        drawn = _other_friction(first, likely, decision)
        beside = _standing([first, *likely, *drawn], decision, parts, given, jobs)
        if drawn and id(first) in beside[2]:
            (likely, alone, ahead, fell), first = beside, None
    others = [c for c in decision.claims if c is not first and id(c) in fell]
    lawless = False
    if first is not None and others:  # they may stand beside its mechanism
        more = [replace(first, effect="unknown"), *likely, *others]
        beside = _standing(more, decision, parts, given, jobs)
        laws = {c.effect for c in beside[0] if c.effect != "unknown"}
        lawless = bool(laws) and told_apart(first, decision, parts, given, laws)
        if lawless:
            own = {key: why for key, why in fell.items() if key == id(first)}
            likely, alone, ahead, fell = *beside[:3], {**own, **beside[3]}
    laws = {c.effect for c in likely if c.effect != "unknown"}
    if first is not None and not lawless:
        lawless = told_apart(first, decision, parts, given, laws - {first.effect})
    most = _beside_doubted(likely, fell, alone, decision, parts, given, jobs)
    keep, more = [], list(decision.refinements)
    doubted: set[str] = set()  # mechanisms: a law beside a doubted one may be a part of it
    for claim in decision.claims:
        key = id(claim)
        paired = any(claim is t for t in twin)
        why = fell.get(key) or (TWIN if paired else doubt(confidence(claim, decision)))
        if claim.effect == "unknown":
            if told_apart(claim, decision, parts, given, laws):
                keep.append(without_law(claim, decision))
        elif claim.mechanism not in doubted and key in ahead:
            keep.append(replace(claim, ahead=ahead[key], most=most.get(key, 1.0)))
        elif claim is first and lawless:
            keep.append(replace(without_law(claim, decision), why=why))
            doubted.add(claim.mechanism)
        else:
            more.append(replace(claim, why=why))
            doubted.add(claim.mechanism)
    keep, parts_of_it = without_its_parts(keep, decision.after.value)
    # beside a law of dry or fluid friction, a missing part of the other kind keeps its own name
    rubbing = {c.mechanism for c in keep if c.effect != "unknown"} & set(FRICTION)
    named = {c.effect for c in keep if c.effect != "unknown"}
    keep = [c if rubbing else by_its_variables(c, decision, parts, given, named) for c in keep]
    return replace(decision, claims=tuple(keep), refinements=tuple(more + parts_of_it))


def _new_and_common(claim: Claim, given: Model) -> bool:
    """Whether a claimed friction is one that every machine has, and the given model has none. What
    a friction of the other kind, of which no law is likely, leaves to its variables is not its own.
    """
    if claim.effect == "unknown" or not get_effect(claim.effect).common:
        return False
    return claim.mechanism in FRICTION and not has(given, claim.mechanism, claim.term.joint)


def _other_friction(first: Claim, likely: Sequence[Claim], decision: Decision) -> list[Claim]:
    """The other claims of friction whose laws are unlikely, as mechanisms that they only draw."""
    unlikely = (c for c in decision.claims if c is not first and not any(c is k for k in likely))
    return [replace(c, effect="unknown") for c in unlikely if c.mechanism in FRICTION]


def _may_lack_a_law(
    lawful: Collection[int], decision: Decision, parts: Parts, given: Model
) -> Claim | None:
    """The first claim that is not ``lawful``, by ``id``, where its mechanism may act without a law:
    none of it is named, its variables may tell it from others', and it explains more than it
    leaves.
    """
    named = [c for c in decision.claims if id(c) in lawful]
    claim = next((c for c in decision.claims if id(c) not in lawful), None)
    if (
        claim is None
        or claim.effect == "unknown"
        or claim.mechanism not in STRUCTURED
        or any(claim.mechanism == c.mechanism for c in named)
        or claim.is_constant  # which is a function of any variable
        or claim.size <= max(decision.after.value, OF_STATE)
        or _turns_otherwise(claim, decision, parts, given, {c.effect for c in named})
    ):
        return None
    return claim


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
                fell[id(claim)] = bent(claim.same)
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
    alone = by_themselves(given, decision.final, joint, claims, refinements, jobs)
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
    harder = replace(decision, bare=max(left, decision.bare, key=lambda size: size.value))
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
    rest = [c for c in decision.claims if not any(c.term is k.term for k in claims)]
    if not claims or not rest:
        return decision.alone
    more, joint = decision.refinements, decision.joint
    return by_themselves(given, decision.final, joint, claims, more, jobs, rest)


def by_themselves(
    given: Model,
    final: Scored,
    joint: int,
    claims: Sequence[Claim],
    more: Sequence[Claim],
    jobs: int,
    fell: Sequence[Claim] = (),
) -> Scored:
    """The claims alone, fitted again, with the terms restored that the refinements had replaced, as
    ``more`` of them could be bent to what no claimed law describes; and without claims that
    ``fell``. A small mechanism stays that is surely there, and can hide no more of any larger claim
    than its law may leave.
    """
    rubs = any(c.mechanism == DRY and c.effect != "unknown" for c in claims)
    known = any(mechanism_of(t.effect) == DRY for t in kept_laws(given, final.model, joint, DRY))

    def stays(c: Claim) -> bool:
        effect = get_effect(c.term.effect)
        # Coulomb friction, which every machine has, beside its law; how the model's own turns round
        own = c.mechanism == DRY and (
            effect.common if rubs else known and effect.hidden and c.evidence.z > SURE
        )
        return own or any(both_needed(final, k, c) for k in claims)

    hides = _hiding(final, claims, more)
    gone = [c for c in more if id(c) in hides] + list(fell)
    terms = [c.term for c in gone if not stays(c)]
    terms = [t for t in final.model.terms if any(t is x for x in terms)]
    if not claims or not terms:
        return final
    model = taken_away(given, final.model, joint, terms)
    handles = joint_handles(final.data, model, joint)
    return fit_scored(final.data, model, handles, (joint,), jobs=jobs, rounds=1)


def _hiding(final: Scored, claims: Sequence[Claim], more: Sequence[Claim]) -> set[int]:
    """The refinements, by ``id``, that untouched recordings do not surely show, or that may hide
    more of a larger claim than its law may leave: as much as a function of its own variable draws.
    Of a claim without a law those of its variables.
    """

    def may_hide(claim: Claim, c: Claim) -> bool:
        if claim.effect == "unknown":
            return c.mechanism in kind_of(claim.mechanism)
        if claim.size < c.size:  # a smaller one is judged beside it
            return False
        part = drawn_by_its_variable(final.data, final.model, claim.term, c.term)
        return c.size * math.sqrt(part) > law_leaves(claim.size, [claim.term])

    def is_sure(c: Claim) -> bool:
        return c.log_e > needed(final.model.joints) and c.evidence.z > CLAIMED

    return {id(c) for c in more if not is_sure(c) or any(may_hide(k, c) for k in claims)}


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
    of them stands upon it, as a doubted Stribeck curve does upon Coulomb friction. A time has no
    variables.
    """
    others = (*decision.refinements, *decision.claims)
    upon = any(stands_on(get_effect(c.term.effect), claim.effect) for c in others)
    timing = get_effect(claim.effect).family == "timing"
    if claim.mechanism not in STRUCTURED or timing or upon or alone is decision.final:
        return False
    bare = structure(
        parts.each, alone.model, decision.joint, [claim.mechanism], claim.mechanism != DRY
    )
    allowed = math.hypot(law_leaves(claim.size, [claim.term]), decision.known.of_state)
    return surely_more(bare, max(allowed, SIMULATORS_DIFFER))


def _goes_on(claim: Claim, alone: Scored, decision: Decision, parts: Parts) -> float | None:
    """The standard deviations by which a law predicts better than its neighbours. None where a
    neighbour surely predicts better; and where they are too few for a law to be named, except a
    constant or a law that every machine has.
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


def _turns_otherwise(
    claim: Claim, decision: Decision, parts: Parts, given: Model, laws: Collection[str]
) -> bool:
    """Whether a known dry friction only acts differently at reversals: nothing is missing beside
    the named ``laws`` while the joint moves.
    """
    if claim.mechanism != DRY or not rubs(decision.base.model, decision.joint):
        return False
    model = beside_laws(claim, decision, given, laws)
    moving = structure(parts.each, model, decision.joint, [DRY], turning=False)
    return moving.size < OF_STATE or moving.z < SURE


def without_its_parts(claims: Sequence[Claim], left: float) -> tuple[list[Claim], list[Claim]]:
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


def surely_more(left: Structure, allowed: float) -> bool:
    """Whether the remaining torque has more energy than allowed, by two standard deviations. One
    that acts seldom gains in few blocks, but not by chance.
    """
    if left.size <= allowed:
        return False
    more = 1.0 - (allowed / left.size) ** 2
    return left.z * more > PLAIN or left.apart * more > BY_CHANCE
