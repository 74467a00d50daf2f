"""The decision: which mechanisms are claimed, by which law, and what is said of the rest.

One principle (docs/diagnosis.md, "How it decides"): a recording is the named physics, a discrepancy
that nobody has named, and the sensor. A finding is a mechanism without which the discrepancy must
grow, on recordings that neither the fit nor any choice has touched. The search proposes; here every
mechanism that it wrote down is taken away, everything else is fitted again, and what that costs
decides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.series import repeats
from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import LAWS_OF, Claim, Decision, Piece
from zendsp.diagnosis.decide.confidence import STATED, confidence
from zendsp.diagnosis.decide.findings import new_terms
from zendsp.diagnosis.measure.discrepancy import (
    FEW,
    STRUCTURED,
    Size,
    Structure,
    bursts,
    difference,
    discrepancy,
    mean_square,
    structure,
)
from zendsp.diagnosis.measure.evidence import Evidence, block_scores, compare, settling
from zendsp.diagnosis.measure.likelihood import Scored, fit_scored, informative
from zendsp.diagnosis.measure.windows import rms, window_error
from zendsp.diagnosis.search.forward import Searcher
from zendsp.diagnosis.search.hypothesis import JointSearch, Rival, price
from zendsp.physics.effects import get_effect, library, mechanism_of
from zendsp.physics.fit import Data, joint_handles
from zendsp.physics.model import Model, Term
from zendsp.physics.predict import run

Array = npt.NDArray[np.float64]
Progress = Callable[[str], None]

# Every number that decides stands here; docs/diagnosis.md has the measurement behind each.
# of what is claimed, at most so much is nothing: e-values, over joints and mechanisms
FALSE_DISCOVERIES = 0.05
LAW_ERROR = 0.03  # no law describes its own mechanism better than to so much of its size
# of a mechanism's size, as a function of its own variables: a law of one number that leaves more is
# none
LEFT_BY_A_LAW = 0.2
NUMERIC = 0.001  # of the RMS torque: where two simulators differ by so much, it is no lack of a law
FINEST = 0.0003  # of the RMS torque: what is less is never a finding, however likely
OWN_SHARE = 0.1  # of the explainable mismatch: a second law of one mechanism below is a refinement
MACHINE = 0.03  # of the RMS torque: below, slow random torques that every machine has
# of the RMS torque: a function of state above is missing physics, whatever its name
OF_STATE = 0.01
TIED = 0.05  # probability above which a law is still in the race
DRAWS = 400  # of the Bayesian bootstrap
SURE = 3.0  # standard deviations over blocks of time
CLAIMED = 2.5  # the same, of a claim, beside its e-value; right ones had 2.8 and more
PLAIN = 2.0  # the same, of what has another measure beside it
MOST = 0.5  # of a lacking torque's energy: a mechanism whose variables predict less is not claimed
RIVAL = 0.5  # of that again: where another mechanism's variables predict so much, neither is
# of the size of a mechanism without a law: what is not larger beside it may be a part of it;
# chosen on one case (docs/diagnosis.md)
A_PART = 0.5
CURVE = 3  # so many laws of one mechanism at one joint draw a curve
HARMONIC = 0.05  # of a whole number: a ripple's order over the lowest


def decide(parts: Parts, given: Model, search: JointSearch, jobs: int, tell: Progress) -> Decision:
    """Decide what is claimed at one joint.

    Parameters
    ----------
    parts : Parts
        Recordings to fit to, to choose by, and to test on.
    given : Model
    search : JointSearch
        What the search proposes.
    jobs : int
        Threads.
    tell : callable
        Receives a sentence at each stage.

    Returns
    -------
    Decision
    """
    joint, base = search.joint, search.base
    tell(f"joint {joint}: what each mechanism is worth")
    final = _worth_choosing(parts, given, search, jobs)
    before = discrepancy(parts.test, base.model, joint)
    new = new_terms(given, final.model, joint)
    if new:
        pieces = [
            _piece(parts.test, given, final, joint, key, terms, jobs)
            for key, terms in _grouped(given, final.model, new).items()
        ]
        pieces.sort(key=lambda p: -p.size)
        claimed, rest = _claimed(parts, given, final, joint, pieces)
        if claimed:
            decision = _believed(
                _named(parts, given, search, final, claimed, rest, before, jobs, tell)
            )
            errors = [
                rms(window_error(parts.test, m, joint)) for m in (base.model, decision.final.model)
            ]
            # what makes an untouched recording worse is no finding, ever
            if decision.claims and errors[1] <= errors[0]:
                if any(c.effect != "unknown" for c in decision.claims):
                    return decision
                # which mechanism, if any, is for the lacking torque itself to say
                plain = _nothing_named(parts, search, before)
                most = decision.after.value**2 < (1.0 - MOST) * before.value**2
                stands = plain.kind == "complete" or (most and not plain.claims)
                return decision if stands else plain
    return _nothing_named(parts, search, before)


# --- which mechanisms


def _grouped(
    given: Model, final: Model, terms: Sequence[Term]
) -> dict[tuple[str, int], tuple[Term, ...]]:
    """Terms by mechanism; couplings by the joint that they come from."""
    out: dict[tuple[str, int], tuple[Term, ...]] = {}
    for term in terms:
        if weight_of_payload(given, final, term):
            out["inertia", 0] = (*out.get(("inertia", 0), ()), term)
            continue
        key = (
            mechanism_of(term.effect),
            int(term.value("from_joint")) if term.effect == "coupling" else 0,
        )
        out[key] = (*out.get(key, ()), term)
    return out


def weight_of_payload(given: Model, final: Model, term: Term) -> bool:
    """Whether a gravity term is the weight of an inertia that was found with it: a payload is one
    finding, not two.
    """
    found = {t.effect for t in new_terms(given, final, term.joint)}
    hangs = any(q.value for q in given.mechanism.get("gravity", ()))
    return (
        term.effect == "gravity"
        and "inertia" in found
        and hangs
        and abs(math.sin(term.value("angle"))) < 0.2
    )


def _without(given: Model, final: Scored, joint: int, terms: Sequence[Term], jobs: int) -> Scored:
    """The model without some terms, with those of the given model that they had replaced, fitted
    again.
    """
    gone = {id(t) for t in terms}
    kept = tuple(t for t in final.model.terms if id(t) not in gone)
    wanted = {m for t in terms for m in _kind(mechanism_of(t.effect))}
    have = [t.effect for t in kept if t.joint == joint]
    back = []
    for term in given.at(joint):
        if term.effect in have:
            have.remove(term.effect)
        elif mechanism_of(term.effect) in wanted:
            back.append(term)
    model = final.model.with_terms((*kept, *back))
    return fit_scored(
        final.data, model, joint_handles(final.data, model, joint), (joint,), jobs=jobs, rounds=3
    )


def _worth_choosing(parts: Parts, given: Model, search: JointSearch, jobs: int) -> Scored:
    """The proposed model without the terms that do not help on the recordings to choose by."""
    joint, final = search.joint, search.final
    while True:
        new = new_terms(given, final.model, joint)
        if len(new) < 2:
            return final
        worst: tuple[float, Scored] | None = None
        for term in new:
            if any(
                term.effect in get_effect(t.effect).needs
                for t in final.model.at(joint)
                if t is not term
            ):
                continue
            without = _without(given, final, joint, (term,), jobs)
            held = compare(without, final, parts.choose, joint)
            if held.gain < 0 and (worst is None or held.gain < worst[0]):
                worst = held.gain, without
        if worst is None:
            return final
        final = worst[1]


def _piece(
    test: Data,
    given: Model,
    final: Scored,
    joint: int,
    key: tuple[str, int],
    terms: tuple[Term, ...],
    jobs: int,
) -> Piece:
    without = _without(given, final, joint, terms, jobs)
    held = compare(without, final, test, joint)
    size = difference(test, without.model, final.model, joint)
    return Piece(
        key[0], terms, without, size, held, 0.5 * held.gain / dependence(without, test, joint)
    )


def dependence(scored: Scored, test: Data, joint: int) -> float:
    """By how much fewer independent samples a recording has than samples, from the innovations'
    correlation in time; 1 or more.
    """
    worst = 1.0
    for rec in test.records:
        record = rec[joint - 1]
        r = run(
            record, scored.model, scored.data.bandwidth[joint - 1], inner=test.inner
        ).innovations
        r = np.clip(r[record.counted], -1e3, 1e3)
        worst = max(worst, repeats(r, record.sample_time))
    return worst


def _claimed(
    parts: Parts, given: Model, final: Scored, joint: int, pieces: Sequence[Piece]
) -> tuple[list[Piece], list[Piece]]:
    """Mechanisms that are claimed, and those that only refine the fit: pieces come in the order of
    their size.

    What a mechanism gives must be more than what stays unexplained in its own variables, and more
    than the laws of the larger ones of its kind, found or given, may be wrong by.
    """
    needed = math.log(parts.test.joints * len(LAWS_OF) / FALSE_DISCOVERIES)
    after = discrepancy(parts.test, final.model, joint).value
    claimed: list[Piece] = []
    rest: list[Piece] = []
    for piece in pieces:
        left = after
        if piece.mechanism in STRUCTURED:
            left = min(after, structure(parts.each, final.model, joint, [piece.mechanism]).size)
        larger = max((p.size for p in claimed), default=0.0)
        kept_laws = _kept_laws(given, final.model, joint, piece.mechanism)
        if kept_laws:
            apart = final.model.with_terms(
                tuple(t for t in final.model.terms if t not in kept_laws)
            )
            larger = max(larger, difference(parts.test, apart, final.model, joint))
        # an error of a larger law is not taken up whole by the law of something else, and not with
        # time
        own = after <= _may_leave(piece) or all(get_effect(e).over == "time" for e in piece.effects)
        error = 0.0 if own else LAW_ERROR * larger
        sure = piece.log_e > needed and piece.evidence.z > CLAIMED
        (
            claimed if sure and piece.size > max(FINEST, math.hypot(left, error)) else rest
        ).append(piece)
    return claimed, rest


def _kept_laws(given: Model, final: Model, joint: int, mechanism: str) -> list[Term]:
    """Terms of the given model at a joint that are of a mechanism's kind and still stand in the
    final one.
    """
    new = new_terms(given, final, joint)
    return [
        t
        for t in final.at(joint)
        if not any(t is n for n in new) and mechanism_of(t.effect) in _kind(mechanism)
    ]


def _kind(mechanism: str) -> frozenset[str]:
    """Mechanisms that are functions of the same variables."""
    friction = frozenset({"dry_friction", "fluid_friction"})
    return friction if mechanism in friction else frozenset({mechanism})


# --- by which law


def _named(
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
    joint = search.joint
    searcher = Searcher(parts.fit, joint, lambda *_: True, jobs, tell)
    after = discrepancy(parts.test, final.model, joint)
    state = structure(parts.each, final.model, joint, STRUCTURED)
    claims: list[Claim] = []
    refinements: list[Claim] = []
    for piece in claimed:
        ranked = _ranked(parts.test, given, final, piece, joint, jobs)
        first = ranked[0]
        law = _law(parts, given, search, searcher, final, piece, first, jobs, tell)
        left = (
            structure(parts.each, final.model, joint, [piece.mechanism])
            if piece.mechanism in STRUCTURED
            else None
        )
        own = [first]
        for other in ranked[1:]:
            second = other.size**2 >= OWN_SHARE * piece.size**2 and other.size > math.hypot(
                after.value, LAW_ERROR * first.size
            )
            if second and other.log_e > 0 and other.evidence.z > PLAIN:
                own.append(other)
            else:
                refinements.append(_plain(other))
        kind = [p for p in claimed if p.mechanism in _kind(piece.mechanism)]
        allowed = max(_may_leave(p) for p in kind)  # a larger law's error is no lack of this one
        # what the law by itself leaves to itself
        again = [p.size for p in ranked[1:] if _repeats(p, first)]
        poor = math.hypot(*again) > allowed or (
            left is not None and _surely_more(left, max(allowed, NUMERIC))
        )
        # a constant beside several laws of the position is a part of the curve that they draw
        level = sum(all(get_effect(t.effect).constant for t in p.terms) for p in claimed) * (
            len(own) > 1 and piece.mechanism == "position_torque"
        )
        drawn = piece.mechanism == "position_torque" and _is_curve(ranked)
        if poor or drawn or len(own) + level >= CURVE:
            refinements += [_plain(p) for p in own[1:]]
            claims.append(
                replace(law, effect="unknown", left=left, laws={**law.laws, "unknown": 1.0})
            )
            continue
        claims.append(replace(law, left=left, size=first.size if len(own) > 1 else piece.size))
        claims += [_law(parts, given, search, searcher, final, p, p, jobs, tell) for p in own[1:]]
    refinements += [_plain(p) for p in rest]
    claims.sort(key=lambda c: -c.evidence.gain)
    claims, more = _beside_unknown(claims)
    refinements += more
    best = claims[0].size
    # more is left that depends on the state than anything claimed explains
    if state.size > best and state.z > SURE:
        claims = []
    return Decision(
        joint,
        "missing",
        tuple(claims),
        tuple(refinements),
        search.base,
        final,
        before,
        after,
        state,
        rms_torque(parts.test, joint),
    )


def _believed(decision: Decision) -> Decision:
    """The decision without the laws that are too likely wrong; of what is first, the mechanism
    stays where functions of its variables can be told, the rest refines the fit.
    """
    keep, more = [], list(decision.refinements)
    for claim in decision.claims:
        if claim.effect == "unknown" or confidence(claim, decision) > STATED:
            keep.append(claim)
        elif claim is decision.claims[0] and claim.mechanism in STRUCTURED:
            keep.append(replace(claim, effect="unknown", laws={**claim.laws, "unknown": 1.0}))
        else:
            more.append(claim)
    return replace(decision, claims=tuple(keep), refinements=tuple(more))


def _beside_unknown(claims: Sequence[Claim]) -> tuple[list[Claim], list[Claim]]:
    """Claims, and those that become refinements: beside a mechanism without a law, what is not
    larger than half of it may be a part of it, and a constant is a part of any curve over position.
    """
    unknown = max((c.size for c in claims if c.effect == "unknown"), default=0.0)
    curve = any(draws_a_curve(c) for c in claims)
    keep = [
        c
        for c in claims
        if c.effect == "unknown"
        or (c.size > A_PART * unknown and not (curve and get_effect(c.effect).constant))
    ]
    return keep, [c for c in claims if not any(c is k for k in keep)]


def draws_a_curve(claim: Claim) -> bool:
    """Whether a claim is of a torque over position without a law, of whatever shape."""
    return claim.effect == "unknown" and claim.mechanism == "position_torque"


def _surely_more(left: Structure, allowed: float) -> bool:
    """Whether what is left has more than the energy that is allowed, by two standard deviations."""
    return left.size > allowed and left.z * (1.0 - (allowed / left.size) ** 2) > PLAIN


def _repeats(other: Piece, first: Piece) -> bool:
    """Whether a law had to be taken once more: two of one shape draw a curve, where the law is not
    a sum of such shapes by itself.
    """
    effect = get_effect(first.terms[0].effect)
    # a sum of harmonics is one law; settings choose one
    several = "order" in effect.names or not all(p.fitted for p in effect.parameters)
    return (
        other.effects == first.effects
        and not several
        and other.log_e > 0
        and other.evidence.z > PLAIN
    )


def _is_curve(ranked: Sequence[Piece]) -> bool:
    """Whether laws of the position, none of which can be left out, are the pieces of a curve: more
    than one of them, and ripples that are no harmonics of one.
    """
    held = [p for p in ranked if p.log_e > 0 and p.evidence.z > PLAIN]
    if len(held) < CURVE:
        return False
    orders = [p.terms[0].value("order") for p in held if "order" in p.terms[0].parameters]
    if len(orders) < len(held):
        return True
    ratios = np.array(orders) / min(orders)
    return bool(np.any(np.abs(ratios - np.round(ratios)) > HARMONIC))


def _may_leave(piece: Piece) -> float:
    """What a mechanism's laws may leave in its own variables, as a part of the RMS torque.

    A law of several free numbers can be bent to resemble what it is not, and leaves the less for
    it.
    """
    laws = [t for t in piece.terms if mechanism_of(t.effect) == piece.mechanism] or list(
        piece.terms
    )
    freedom = min(sum(q.free for q in t.parameters.values()) for t in laws)
    return LEFT_BY_A_LAW * piece.size / max(freedom, 1) ** 2


def together(*data: Data) -> Data:
    """Recordings of several parts as one."""
    return replace(data[0], records=tuple(r for d in data for r in d.records))


def _ranked(
    test: Data, given: Model, final: Scored, piece: Piece, joint: int, jobs: int
) -> list[Piece]:
    """Each law of a mechanism by itself, the one whose removal costs most first."""
    laws = [t for t in piece.terms if mechanism_of(t.effect) == piece.mechanism]
    if len(laws) == 1:
        return [replace(piece, terms=tuple(laws))]
    each = [_piece(test, given, final, joint, (piece.mechanism, 0), (t,), jobs) for t in laws]
    return sorted(each, key=lambda p: -p.size)


def _plain(piece: Piece) -> Claim:
    term = piece.terms[0]
    return Claim(
        term.effect, piece.mechanism, term, piece.size, piece.evidence, piece.log_e, {}, (), (), ()
    )


def _law(
    parts: Parts,
    given: Model,
    search: JointSearch,
    searcher: Searcher,
    final: Scored,
    piece: Piece,
    first: Piece,
    jobs: int,
    tell: Progress,
) -> Claim:
    """The law of a mechanism with its probability: laws that could stand in its place are fitted,
    and compete block by block.
    """
    joint, term = search.joint, first.terms[0]
    tell(f"joint {joint}: what could stand in for {term.effect}")
    known = library()
    mates = {e for e in LAWS_OF.get(piece.mechanism, ()) if e in known}
    names = frozenset(mates | set(get_effect(term.effect).rivals)) - {"coupling"} | {term.effect}
    rivals = [
        r
        for r in searcher.stand_ins(first.without, names)
        if r.effect != term.effect and not contains(r, term)
    ]
    learn = together(parts.fit, parts.choose)
    settle = max(settling(x, joint) for x in (final, *[r.scored for r in rivals]))
    scores = np.stack(
        [block_scores(x, learn, joint, settle) for x in (final, *[r.scored for r in rivals])]
    )
    own = price((term,), informative(parts.fit, joint))
    scores += np.array([own, *[r.price for r in rivals]])[:, None] / scores.shape[1]
    weights = _weights(scores)
    after = discrepancy(parts.choose, final.model, joint).value
    same, lost = [], []
    for rival, weight, score in zip(rivals, weights[1:], scores[1:], strict=True):
        behind = float(score.sum() - scores[0].sum())
        near = (
            behind < 0.5 * first.evidence.gain
            and difference(parts.choose, rival.scored.model, final.model, joint) < after
        )
        if weight > TIED or near or rival.effect in get_effect(term.effect).aliases:
            same.append(rival.effect)
        else:
            share = 1.0 - behind / max(rival_gain(first, final), 1e-9)
            why = (
                f"explains {100 * max(0.0, min(share, 0.99)):.0f} % of it"
                if share > 0.1
                else "does not explain the mismatch"
            )
            lost.append((rival.effect, why, -0.5 * behind))
    laws: dict[str, float] = {}
    for name, weight in zip([term.effect, *[r.effect for r in rivals]], weights, strict=True):
        if mechanism_of(name) == piece.mechanism:
            laws[name] = laws.get(name, 0.0) + float(weight)
    total = sum(laws.values())
    laws = (
        {n: w / total for n, w in laws.items() if w / total > 1e-3}
        if total > 0
        else {term.effect: 1.0}
    )
    gone = replaced(given, final.model, term)
    return Claim(
        term.effect,
        piece.mechanism,
        term,
        piece.size,
        piece.evidence,
        piece.log_e,
        laws,
        tuple(dict.fromkeys(same)),
        gone,
        tuple(lost[:6]),
    )


def rival_gain(piece: Piece, final: Scored) -> float:
    """Deviance that a law gains on the recordings of the fit."""
    return piece.without.deviance - final.deviance


def _weights(scores: Array) -> Array:
    """Probability of each law (a row of scores of blocks) to predict best, by the Bayesian
    bootstrap (pseudo-BMA+, Yao et al. 2018).
    """
    n = scores.shape[1]
    draws = np.random.default_rng(0).dirichlet(np.ones(n), DRAWS) * n
    totals = -0.5 * draws @ scores.T
    totals -= totals.max(axis=1, keepdims=True)
    weight = np.exp(totals)
    weight /= weight.sum(axis=1, keepdims=True)
    return np.asarray(weight.mean(axis=0))


def contains(rival: Rival, term: Term) -> bool:
    """Whether the rival is the same effect with more freedom: a special case of it, or with a
    parameter at its bound.
    """
    if term.effect in get_effect(rival.effect).replaces:
        return True
    own = sum(p.fitted for p in get_effect(term.effect).parameters)
    more = sum(p.fitted for p in get_effect(rival.effect).parameters) > own
    fitted = rival.scored.fit

    def is_row(index: int) -> bool:
        t = rival.scored.model.terms[index]
        return t.joint == rival.joint and t.effect == rival.effect

    bounded = (
        fitted.at_bound[i]
        for i, h in enumerate(fitted.handles)
        if h.place == "term" and is_row(h.index)
    )
    return more and any(bounded)


def replaced(given: Model, final: Model, term: Term) -> tuple[str, ...]:
    """Effects of the given model that are gone, and that this term stands for: laws of its own kind
    of friction, or of its mechanism.
    """
    joint = term.joint
    have = [t.effect for t in final.at(joint)]
    gone = []
    for old in given.at(joint):
        if old.effect in have:
            have.remove(old.effect)
        else:
            gone.append(old.effect)
    own = mechanism_of(term.effect)
    kind = _kind(own)
    rubs = [t for t in new_terms(given, final, joint) if mechanism_of(t.effect) in kind]
    mine = [e for e in gone if mechanism_of(e) in kind]
    if len(kind) > 1 and len(rubs) > 1:  # each stands for its own kind where both are new
        exact = [e for e in mine if mechanism_of(e) == own]
        others = {mechanism_of(t.effect) for t in rubs if t is not term}
        mine = exact + [e for e in mine if mechanism_of(e) not in others and e not in exact]
    return tuple(sorted(set(mine)))


# --- nothing is named


def _nothing_named(parts: Parts, search: JointSearch, before: Size) -> Decision:
    """Complete, a disturbance, a mechanism without a law, or unexplained: decided by the calibrated
    model's discrepancy alone.
    """
    joint, base = search.joint, search.base
    state = structure(parts.each, base.model, joint, STRUCTURED)
    lost = tuple(_why(r, base) for r in search.tried[:6])
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
        rms_torque(parts.test, joint),
        lost=lost,
    )
    of_state = state.size > OF_STATE and state.z > SURE
    if before.value > OF_STATE and state.share < MOST:
        # a push may lie where the held-out recording was cut, or in the recordings of the fit alone
        here = bursts(parts.held, base.model, joint) or bursts(
            parts.fit, base.model, joint, many=FEW
        )
        if here is not None:
            return replace(out, kind="disturbance", bursts=here)
    if of_state:
        claim = _without_law(parts, search, state)
        if claim is not None:
            return replace(out, kind="missing", claims=(claim,))
    if of_state or before.value > MACHINE:
        return replace(out, kind="unexplained")
    return out


def _why(rival: Rival, base: Scored) -> tuple[str, str, float]:
    gain = base.deviance - rival.value
    why = (
        "no more likely than the calibrated model"
        if gain < 40
        else "is not what is missing, on the recordings held out"
    )
    return rival.effect, why, 0.5 * gain


def rms_torque(data: Data, joint: int) -> float:
    """RMS torque at a joint over recordings, N m or N."""
    return float(np.sqrt(mean_square(data, joint)))


def _without_law(parts: Parts, search: JointSearch, state: Structure) -> Claim | None:
    """The one mechanism whose own variables predict most of what any function of state does; None
    where several do, or none.
    """
    joint, base = search.joint, search.base
    alone = {m: structure(parts.each, base.model, joint, [m]) for m in STRUCTURED}
    order = sorted(alone, key=lambda m: -alone[m].size)
    best = alone[order[0]]
    if best.z < SURE or best.size**2 < MOST * state.size**2 or best.share < MOST:
        return None
    other = next(alone[m] for m in order[1:] if m not in _kind(order[0]))
    if other.size**2 > RIVAL * best.size**2:
        return None
    evidence = Evidence(0.0, best.z, np.zeros(1))
    term = Term("unknown", joint, {})
    return Claim(
        "unknown", order[0], term, best.size, evidence, 0.0, {"unknown": 1.0}, (), (), (), best
    )
