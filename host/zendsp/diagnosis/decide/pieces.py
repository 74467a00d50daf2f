"""Which mechanisms are claimed, by the cost of taking each away and fitting the rest again."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.series import repeats
from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Piece, needed
from zendsp.diagnosis.decide.contract import is_stepped
from zendsp.diagnosis.decide.findings import new_terms
from zendsp.diagnosis.decide.law_torque import (
    has,
    kept_laws,
    kind_of,
    known_discrepancy,
    may_leave,
    rubs,
    torque_of,
)
from zendsp.diagnosis.decide.near import why_apart
from zendsp.diagnosis.decide.thresholds import (
    A_PART,
    CLAIMED,
    EXPLAINS,
    FALSE_DISCOVERIES,
    FINEST,
    FINEST_BESIDE_BODIES,
    HANGING,
    LACKED,
    LAW_ERROR,
    OTHER_NUMBERS,
    PLAIN,
    PREDICTED,
    RUN_AWAY,
    STEPPED,
    SURE,
    TOLERANCE,
)
from zendsp.diagnosis.measure.curve import DRY, FRICTION
from zendsp.diagnosis.measure.discrepancy import (
    BANDS,
    as_seen,
    at_reversals,
    beyond,
    difference,
    discrepancy,
    falls,
    kept,
    resisting,
    unseen_commands,
)
from zendsp.diagnosis.measure.evidence import Evidence, compare, heard_slowly
from zendsp.diagnosis.measure.likelihood import Scored, fit_scored, informative
from zendsp.diagnosis.measure.significance import counterpart, essence_of
from zendsp.diagnosis.measure.structure import STRUCTURED, structure
from zendsp.diagnosis.search.hypothesis import JointSearch
from zendsp.diagnosis.search.simplify import SIMPLER_COST, hopeless
from zendsp.physics.calibration.fit import Data, joint_handles
from zendsp.physics.calibration.joint import own_weight
from zendsp.physics.calibration.observed import trace
from zendsp.physics.calibration.predict import run
from zendsp.physics.effects import get_effect, mechanism_of, stands_on
from zendsp.physics.model import TREES, Model, Term

Array = npt.NDArray[np.float64]


def grouped(
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
            int(term.value("from_joint")) if get_effect(term.effect).coupled else 0,
        )
        out[key] = (*out.get(key, ()), term)
    return out


def weight_of_payload(given: Model, final: Model, term: Term) -> bool:
    """Whether a gravity term is the weight of an inertia found with it, since a payload is one
    finding.
    """
    found = {t.effect for t in new_terms(given, final, term.joint)}
    if term.effect != "gravity" or "inertia" not in found:
        return False
    own = own_weight(given, term.joint)
    return own is not None and abs(math.sin(term.value("angle") - own[1])) < HANGING


def taken_away(given: Model, final: Model, joint: int, terms: Sequence[Term]) -> Model:
    """The final model without some terms, and with the given terms restored that they had replaced.
    """
    gone = {id(t) for t in terms}
    kept = tuple(t for t in final.terms if id(t) not in gone)
    wanted = {m for t in terms for m in kind_of(mechanism_of(t.effect))}
    have = [t.effect for t in kept if t.joint == joint]
    back = []
    for term in given.at(joint):
        if term.effect in have:
            have.remove(term.effect)
        elif mechanism_of(term.effect) in wanted:
            back.append(term)
    return final.with_terms((*kept, *back))


def beside_unknown(
    given: Model, improved: Model, joint: int, mechanism: str, named: Collection[str]
) -> Model:
    """The improved model without the refinements of a mechanism that has no law; laws that are
    ``named`` stay. Its missing torque is that of the mechanism alone.
    """
    nameless = [
        t
        for t in new_terms(given, improved, joint)
        if mechanism_of(t.effect) in kind_of(mechanism) and t.effect not in named
    ]
    return taken_away(given, improved, joint, nameless)


def _without(given: Model, final: Scored, joint: int, terms: Sequence[Term], jobs: int) -> Scored:
    """The final model without some terms, fitted again. The same law as a coupling from another
    joint keeps its numbers: where both joints move at once it would explain this one's friction. So
    does a term that would run to its bounds, such as an actuator with hardly any output.
    """
    model = taken_away(given, final.model, joint, terms)
    handles = joint_handles(final.data, model, joint)
    found = {id(t): t for t in new_terms(given, final.model, joint)}
    of = {
        h: found[id(model.terms[h.index])]
        for h in handles
        if h.place == "term" and id(model.terms[h.index]) in found
    }
    gone = {t.effect for t in terms}
    held = {h for h, term in of.items() if _law_of_another(term) in gone}
    while True:
        free = tuple(h for h in handles if h not in held)
        out = fit_scored(final.data, model, free, (joint,), jobs=jobs, rounds=3)
        bounds = zip(out.fit.handles, out.fit.at_bound, strict=True)
        run_off = {h for h, bound in bounds if bound and h in of}
        if not run_off:
            return out
        held |= run_off


def _law_of_another(term: Term) -> str:
    """The law of a coupling from another joint, empty for other terms."""
    effect = get_effect(term.effect)
    choices = effect.parameter("law").choices if effect.coupled else ()
    return choices[int(term.value("law"))] if choices else ""


def worth_choosing(parts: Parts, given: Model, search: JointSearch, jobs: int) -> Scored:
    """The proposed model without terms that do not help on the recordings to choose by. Friction
    that every machine has goes only where it surely does not.
    """
    joint, final = search.joint, search.final
    sure_gain = SIMPLER_COST * informative(parts.choose, joint)
    while True:
        new = new_terms(given, final.model, joint)
        if len(new) < 2:
            return final
        worst: tuple[float, Scored] | None = None
        for term in new:
            if any(
                stands_on(get_effect(t.effect), term.effect)
                for t in final.model.at(joint)
                if t is not term
            ):
                continue
            short = hopeless(final, taken_away(given, final.model, joint, (term,)), joint, jobs)
            if short is not None and compare(short, final, parts.choose, joint).gain > sure_gain:
                continue  # a long fit would not change this
            without = _without(given, final, joint, (term,), jobs)
            held = compare(without, final, parts.choose, joint)
            if held.gain >= 0 or (held.z > -PLAIN and _expected(given, new, term)):
                continue
            if worst is None or held.gain < worst[0]:
                worst = held.gain, without
        if worst is None:
            return final
        final = worst[1]


def _expected(given: Model, new: Sequence[Term], term: Term) -> bool:
    """Whether a term is friction that every machine has, of which neither the given model nor
    another new term has any.
    """
    own = mechanism_of(term.effect)
    others = (t for t in new if t is not term)
    return (
        get_effect(term.effect).common
        and not has(given, own, term.joint)
        and all(mechanism_of(t.effect) != own for t in others)
    )


def piece_of(
    test: Data,
    given: Model,
    final: Scored,
    mechanism: str,
    terms: tuple[Term, ...],
    known: Sequence[Scored],
    jobs: int,
) -> Piece:
    """The piece of some terms of a joint: the cost of taking them away, on untouched recordings.
    ``known``: the calibrated model, and others from the way to the final one. What contains one of
    them cannot fit worse. Nor is a piece worth more than all of them: terms that cancel each other
    diverge when one is taken away. (Among the laws of one mechanism the one that the others need
    most comes first.)
    """
    joint, base = terms[0].joint, known[0]
    without = _without(given, final, joint, terms, jobs)
    within = [k for k in known if _contains(without, k, given, joint)]
    without = min((without, *within), key=lambda scored: scored.deviance)
    size = difference(test, without.model, final.model, joint)
    if size > RUN_AWAY and not _has_kin(given, final.model, mechanism, terms):
        whole = difference(test, base.model, final.model, joint)
        without, size = (base, whole) if whole < size else (without, size)
    held = compare(without, final, test, joint)
    size *= _unseen(test, final.model, terms, joint)
    log_e = log_e_value(held, without, final, test, joint)
    lacks = _lacks(test, without.model, final.model, terms, size)
    expected = mechanism in FRICTION and not has(given, mechanism, joint)
    piece = Piece(mechanism, terms, without, size, held, log_e, lacks, expected)
    if not _likely(test, piece) or _even(piece):
        return piece
    return replace(piece, slowly=heard_slowly(without, final, test, joint))


def _contains(larger: Scored, smaller: Scored, given: Model, joint: int) -> bool:
    """Whether a model has all laws of another one, heard by the same observer."""
    heard = larger.data.bandwidth[joint - 1] == smaller.data.bandwidth[joint - 1]
    has, needs = (
        [t.effect for t in new_terms(given, s.model, joint)] for s in (larger, smaller)
    )
    return heard and not Counter(needs) - Counter(has)


def _has_kin(given: Model, model: Model, mechanism: str, terms: Sequence[Term]) -> bool:
    """Whether further terms of the same mechanism at the joint are new."""
    new = new_terms(given, model, terms[0].joint)
    return any(mechanism_of(t.effect) == mechanism and not any(t is x for x in terms) for t in new)


def _unseen(test: Data, model: Model, terms: Sequence[Term], joint: int) -> float:
    """The ratio of the torque of some terms to the torque that the observer sees. Waves along the
    travel may pass faster than it can follow. 1 where one of the terms is no such wave.
    """
    effects = [get_effect(t.effect) for t in terms]
    if not all("order" in e.names and e.site == "torque" for e in effects):
        return 1.0
    whole = seen = 0.0
    for rec in test.records:
        record = rec[joint - 1]
        use = kept(record, BANDS[0])
        torque = trace(record, model, tuple(terms), 0.0)
        as_it_is = as_seen(record, model, BANDS[0], torque[None])[0]
        whole += float(np.sum(torque[use] ** 2))
        seen += float(np.sum(as_it_is[use] ** 2))
    return max(1.0, math.sqrt(whole / seen)) if seen > 0.0 else 1.0


def _lacks(test: Data, without: Model, final: Model, terms: Sequence[Term], size: float) -> bool:
    """Whether the torque of some terms is missing without them. A term that raises the likelihood
    but adds no missing torque only models coloured sensor noise; or commands between rows that
    nobody saw, where it is a delay, filter or spring no larger than these may make one.
    """
    joint, stepped = terms[0].joint, any(is_stepped(t.effect) for t in terms)
    if stepped and size <= unseen_commands(test, without, joint):
        return False
    if discrepancy(test, without, joint).high > LACKED * size:
        return True
    return not stepped and falls(test, without, final, joint, LACKED**2)


def log_e_value(
    held: Evidence, without: Scored, final: Scored, test: Data, joint: int
) -> float:
    """Logarithm of the e-value of a gain: half of it, divided by the samples that count as one
    independent sample.

    That is taken from the model with the less correlated innovations: a wrong model's innovations
    are correlated by the missing physics itself.
    """
    alike = min(dependence(s, test, joint) for s in (without, final))
    return 0.5 * held.gain / alike


def dependence(scored: Scored, test: Data, joint: int) -> float:
    """The number of samples that count as one independent sample, 1 or more, from the
    autocorrelation of the innovations.
    """
    worst = 1.0
    bandwidth = scored.data.bandwidth[joint - 1]
    for rec in test.records:
        record = rec[joint - 1]
        known = resisting(record, scored.model).known
        key = "repeats", bandwidth, test.inner
        if key not in known:
            r = run(record, scored.model, bandwidth, inner=test.inner, begun=True).innovations
            r = np.clip(r[record.counted], -1e3, 1e3)
            known[key] = repeats(r, record.sample_time)
        worst = max(worst, known[key])
    return worst


def held_apart(
    parts: Parts, given: Model, search: JointSearch, final: Scored, pieces: Sequence[Piece]
) -> tuple[list[Piece], list[Piece]]:
    """The mechanisms that are claimed, and those that only refine the fit; pieces come in the order
    of their size.

    A mechanism must be larger than what stays unexplained over its own variables, and larger than
    the possible error of larger laws of its kind, found or given.
    """
    joint = search.joint
    after = discrepancy(parts.test, final.model, joint).value
    known = known_discrepancy(given, parts.test, joint)
    unknown = beyond(after, known.all)
    claimed: list[Piece] = []
    rest: list[Piece] = []
    for piece in pieces:
        left = after
        part = 0.0  # of the machine's known discrepancy, as for an unknown below
        if piece.mechanism in STRUCTURED:
            left = min(after, structure(parts.each, final.model, joint, [piece.mechanism]).size)
            part = known.of_state / A_PART
        larger = max((p.size for p in claimed), default=0.0)
        beside = kept_laws(given, final.model, joint, piece.mechanism)
        # what a known dry friction does at reversals is an error of its own law
        second = bool(beside) and turns_round(parts, given, final, piece)
        if piece.mechanism not in kind_of(DRY):
            beside += _rubbing(parts, search, final, piece)
        larger = max(larger, torque_of(parts.test, beside, final.model, joint))
        # neither the law of something else nor a law over time absorbs the whole error of a larger
        # law; where it is friction, what stays depends on the variables of both
        timed = all(get_effect(e).over == "time" for e in piece.effects)
        whole = left if piece.mechanism in FRICTION else unknown
        own = timed or (whole <= may_leave(piece) and not second)
        error = 0.0 if own else LAW_ERROR * larger
        least = max(*(finest(e, given) for e in piece.effects), part, math.hypot(left, error))
        if sure(parts.test, piece) and piece.size > least:
            claimed.append(piece)
        else:
            rest.append(replace(piece, why=why_apart(piece.size, left, error, larger)))
    return claimed, rest


def sure(test: Data, piece: Piece) -> bool:
    """Whether untouched recordings are surely less likely without a mechanism, and miss its torque.
    The test accounts for all mechanisms of all joints, so that false alarms are rare.
    """
    return _likely(test, piece) and (_even(piece) or piece.slowly > SURE)


def _likely(test: Data, piece: Piece) -> bool:
    """Whether untouched recordings are less likely without a mechanism, and miss its torque."""
    least = -math.log(FALSE_DISCOVERIES) if piece.expected else needed(test.joints)
    return piece.log_e > least and piece.lacks


def _even(piece: Piece) -> bool:
    """Whether a mechanism gains all along the recordings."""
    surely = PLAIN if piece.expected else CLAIMED
    return piece.evidence.z > surely or _often(piece.evidence.blocks) > SURE


def _often(gains: Array) -> float:
    """The standard deviations by which more blocks gain than by chance. A real effect that acts
    mostly in a few blocks still gains in most; a few lucky blocks do not.
    """
    return float(np.sum(np.sign(gains)) / math.sqrt(len(gains)))


def finest(effect: str, model: Model) -> float:
    """The least size of an effect beside a model for a finding, as a part of the RMS torque."""
    least = FINEST_BESIDE_BODIES if model.kind in TREES else FINEST
    return STEPPED if is_stepped(effect) else least


def _rubbing(parts: Parts, search: JointSearch, final: Scored, piece: Piece) -> list[Term]:
    """The dry friction beside a mechanism that acts at reversals, where the error of its law (a
    soft simulator, bristles) shows too. Not where the laws of dry friction that were tried hardly
    explain the mechanism.
    """
    joint = search.joint
    dry = [t for t in final.model.at(joint) if mechanism_of(t.effect) == DRY]
    if not dry or not _turning(parts, final, piece):
        return []
    laws = [search.base.deviance - r.value for r in search.tried if mechanism_of(r.effect) == DRY]
    if laws and max(laws) < EXPLAINS * (piece.without.deviance - final.deviance):
        return []
    return dry


def turns_round(parts: Parts, given: Model, final: Scored, piece: Piece) -> bool:
    """Whether a mechanism only changes the model's own dry friction at reversals: bristles or
    softness, neither a curve over the speed nor a friction beside it.
    """
    if piece.mechanism != DRY or not any(get_effect(e).hidden for e in piece.effects):
        return False
    beside = _keeps_its_numbers(given, final.model, piece)
    return not beside and _turning(parts, final, piece)


def only_at_turns(parts: Parts, given: Model, final: Scored, piece: Piece) -> bool:
    """Whether a law of dry friction that acts always, in place of the model's own, is seen where
    the joint reverses only: an uneven friction and a constant torque together are the friction and
    the constant of the model, but for how they turn round.
    """
    joint = piece.terms[0].joint
    laws = [get_effect(e) for e in piece.effects]
    # of one number it is the friction itself
    always = all(len(e.names) > 1 and set(e.names) == set(e.linear) for e in laws)
    if piece.mechanism != DRY or not always or not rubs(given, joint):
        return False
    turning = at_reversals(parts.test, piece.without.model, final.model, joint)
    return PREDICTED <= turning < 1.0  # where the joint does more than reverse


def _keeps_its_numbers(given: Model, final: Model, piece: Piece) -> bool:
    """Whether the model's own dry friction is as stated with a mechanism, and only without it
    calibrated to other numbers. Then it had absorbed what is missing.
    """
    joint = piece.terms[0].joint

    def off(model: Model) -> float:
        """The largest change of a number, as a part of it."""
        changes = [0.0]
        for term in kept_laws(given, model, joint, DRY):
            if mechanism_of(term.effect) == DRY:
                stated = counterpart(given.terms, term)
                numbers = [(stated.value(k), term.value(k)) for k in essence_of(term.effect)]
                changes += [abs(now - was) / abs(was) for was, now in numbers if was]
        return max(changes)

    return off(final) < TOLERANCE and off(piece.without.model) > OTHER_NUMBERS * TOLERANCE


def _turning(parts: Parts, final: Scored, piece: Piece) -> bool:
    """Whether a piece acts mostly at reversals."""
    joint = piece.terms[0].joint
    return at_reversals(parts.test, piece.without.model, final.model, joint) >= PREDICTED
