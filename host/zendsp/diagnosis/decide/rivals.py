"""The laws that could describe a claimed mechanism, and how likely each of them is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import LAWS_OF, Claim, Piece, shared
from zendsp.diagnosis.decide.contract import Rejected
from zendsp.diagnosis.decide.findings import new_terms
from zendsp.diagnosis.decide.law_torque import kind_of
from zendsp.diagnosis.decide.thresholds import (
    BOOTSTRAP_DRAWS,
    EXPLAINS,
    INSEPARABLE,
    LAW_ERROR,
    STATED_LAW,
    STEPPED,
    TIED,
)
from zendsp.diagnosis.measure.discrepancy import difference, discrepancy
from zendsp.diagnosis.measure.evidence import block_scores, settling
from zendsp.diagnosis.measure.likelihood import Scored, informative
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.search.hypothesis import SUFFICIENT, JointSearch, Rival, price
from zendsp.diagnosis.search.rounds import Rounds
from zendsp.diagnosis.search.short_fits import WAIT
from zendsp.diagnosis.search.simpler_laws import COLOURED
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import off_counts
from zendsp.physics.effects import get_effect, library, mechanism_of
from zendsp.physics.model import Model, Term

Array = npt.NDArray[np.float64]


def together(*data: Data) -> Data:
    """Recordings of several parts as one."""
    return replace(data[0], records=tuple(r for d in data for r in d.records))


def law_of(
    parts: Parts,
    given: Model,
    search: JointSearch,
    rounds: Rounds,
    final: Scored,
    piece: Piece,
    first: Piece,
    tell: Progress,
) -> Claim:
    """The law of a mechanism with its probability. Laws that could replace it are fitted, and
    compete block by block.
    """
    joint, term = search.joint, first.terms[0]
    tell(Step.SEARCHING.says(f"joint {joint}: what could stand in for {term.effect}"))
    known = library()
    beside = (*LAWS_OF.get(piece.mechanism, ()), *get_effect(term.effect).rivals)
    names = frozenset(e for e in beside if e in known and not known[e].coupled) | {term.effect}
    every = [
        r
        for r in rounds.stand_ins(first.without, names)
        if r.effect == term.effect
        or not (contains(r, term) or _beside_a_number(given, final, first, r))
    ]
    scores = _scores(parts, joint, final, term, every)
    # a gain too small for a search may be the truth, but takes no other law's place
    large = [all(not rounds.too_small(r, t) for t in r.terms) for r in every]
    instead = _likelier(final, [*compress(every, large)], scores[[True, *large]])
    other = [r.effect != term.effect for r in every]
    rivals, scores = [r for r, o in zip(every, other, strict=True) if o], scores[[True, *other]]
    weights = _weights(scores)
    same, lost, late, alike = [], [], 0, [False]
    for rival, weight, score in zip(rivals, weights[1:], scores[1:], strict=True):
        behind = float(score.sum() - scores[0].sum())
        stepped = _by_other_steps(parts, final, piece, first, rival, behind)
        late += stepped
        near = stepped or _near(parts, final, piece, first, rival, behind)
        alike.append(near)
        near |= _late_alike(parts, given, term, rival.effect, behind, first.evidence.gain)
        if weight > TIED or near or rival.effect in get_effect(term.effect).aliases:
            same.append(rival.effect)
        else:
            share = 1.0 - behind / max(rival_gain(first, final), 1e-9)
            why = (
                f"explains {100 * max(0.0, min(share, 0.99)):.0f} % of it"
                if share > EXPLAINS
                else "does not explain the mismatch"
            )
            lost.append(Rejected(rival.effect, joint, why, -0.5 * behind))
    if _ripples(parts, rounds, final, piece, first):
        same.append("ripple")
    same += sums(term.effect, joint, final.model)
    weights = _of_alike(weights, alike)
    laws = _shared([term.effect, *[r.effect for r in rivals]], weights, piece.mechanism)
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
        instead=instead,
        most=shared(late),
    )


def _near(
    parts: Parts, final: Scored, piece: Piece, first: Piece, rival: Rival, behind: float
) -> bool:
    """Whether a rival's torque differs from that of a law by less than what stays unexplained; that
    of another mechanism by less than any law may be wrong, so that it may be the true one.
    """
    if not behind < INSEPARABLE * first.evidence.gain:
        return False
    least = discrepancy(parts.choose, final.model, rival.joint).value
    if mechanism_of(rival.effect) != piece.mechanism:
        least = max(least, LAW_ERROR * first.size)
    return difference(parts.choose, rival.scored.model, final.model, rival.joint) < least


def _by_other_steps(
    parts: Parts, final: Scored, piece: Piece, first: Piece, rival: Rival, behind: float
) -> bool:
    """Whether a law that makes something late and a rival of another mechanism, which is not the
    same by algebra, differ by no more than simulators with other steps.
    """
    law, other = get_effect(first.terms[0].effect), get_effect(rival.effect)
    if mechanism_of(other.name) == piece.mechanism or {law.family, other.family} != {"timing"}:
        return False
    if other.name in law.aliases or law.name in other.aliases:
        return False
    apart = difference(parts.choose, rival.scored.model, final.model, rival.joint)
    return behind < INSEPARABLE * first.evidence.gain and apart < STEPPED


def _ripples(
    parts: Parts, rounds: Rounds, final: Scored, piece: Piece, first: Piece
) -> bool:
    """Whether a ripple with too few periods in the travel to be searched for is the same to these
    recordings as a law over the position that is no wave.
    """
    term = first.terms[0]
    if piece.mechanism != "position_torque" or "order" in term.parameters:
        return False
    rival = rounds.few_periods(first.without)
    if rival is None:
        return False
    joint = term.joint
    scores = _scores(parts, joint, final, term, [rival])
    after = discrepancy(parts.choose, final.model, joint).value
    close = difference(parts.choose, rival.scored.model, final.model, joint) < after
    behind = float(scores[1].sum() - scores[0].sum())
    return bool(_weights(scores)[1] > TIED) or (
        behind < INSEPARABLE * first.evidence.gain and close
    )


def _late_alike(
    parts: Parts, given: Model, term: Term, rival: str, behind: float, gain: float
) -> bool:
    """Whether a law and its rival both make something late, explain nearly the same (``COLOURED``),
    and positions lie beside the counts. The noise of such positions tells these laws apart more
    than the motion does.
    """
    coloured = off_counts(parts.choose.records[0][term.joint - 1], given)
    late = {get_effect(term.effect).family, get_effect(rival).family} == {"timing"}
    return coloured and late and behind < COLOURED * gain


def _shared(names: Sequence[str], weights: Array, mechanism: str) -> dict[str, float]:
    """The probabilities of the laws of a mechanism among all, of the first, which is named, also
    where it is small; the first law alone where none has any.
    """
    laws: dict[str, float] = {}
    for name, weight in zip(names, weights, strict=True):
        if mechanism_of(name) == mechanism:
            laws[name] = laws.get(name, 0.0) + float(weight)
    total = sum(laws.values())
    if total <= 0:
        return {names[0]: 1.0}
    return {n: w / total for n, w in laws.items() if w / total > STATED_LAW or n == names[0]}


def _beside_a_number(given: Model, final: Scored, first: Piece, rival: Rival) -> bool:
    """Whether the claimed law is the given model's own with another number, and a rival beside the
    given number has more numbers and gains hardly more.
    """
    term = first.terms[0]
    law, other = (get_effect(name).parameters for name in (term.effect, rival.effect))
    more = sum(p.fitted for p in other) > sum(p.fitted for p in law)
    own = more and any(t.effect == term.effect for t in given.at(term.joint))
    return own and SUFFICIENT * (first.without.deviance - rival.value) < rival_gain(first, final)


def _scores(parts: Parts, joint: int, final: Scored, term: Term, every: Sequence[Rival]) -> Array:
    """Deviance of each block, with the price shared among blocks: of the term in the final model,
    then of each rival, (rivals + 1, blocks).
    """
    learn = together(parts.fit, parts.choose)
    models = [final, *[r.scored for r in every]]
    settle = max(settling(x, joint) for x in models)
    scores = np.stack([block_scores(x, learn, joint, settle) for x in models])
    prices = [price((term,), informative(parts.fit, joint)), *[r.price for r in every]]
    return np.asarray(scores + np.array(prices)[:, None] / scores.shape[1])


def _likelier(final: Scored, every: Sequence[Rival], scores: Array) -> Scored | None:
    """A law of this mechanism or another, or the same law with other numbers, that is clearly
    likelier than the one in the final model, also on the recordings to choose by.
    """
    behind = scores[1:].sum(axis=1) - scores[0].sum()
    better = [
        (float(d), r.scored)
        for d, r in zip(behind, every, strict=True)
        if d < -WAIT and r.scored.deviance < final.deviance - WAIT
    ]
    return min(better, key=lambda b: b[0])[1] if better else None


def sums(effect: str, joint: int, model: Model) -> list[str]:
    """The effects to which one and others beside it are together equal by algebra."""
    there = {t.effect for t in model.at(joint)}
    return [n for n, e in library().items() if effect in e.sums and there.issuperset(e.sums)]


def rival_gain(piece: Piece, final: Scored) -> float:
    """The deviance that a law gains on the recordings of the fit."""
    return piece.without.deviance - final.deviance


def _weights(scores: Array) -> Array:
    """Probability of each law (a row of scores of blocks) to predict best, by the Bayesian
    bootstrap (pseudo-BMA+, Yao et al. 2018).
    """
    n = scores.shape[1]
    draws = np.random.default_rng(0).dirichlet(np.ones(n), BOOTSTRAP_DRAWS) * n
    totals = -0.5 * draws @ scores.T
    totals -= totals.max(axis=1, keepdims=True)
    weight = np.exp(totals)
    weight /= weight.sum(axis=1, keepdims=True)
    return np.asarray(weight.mean(axis=0))


def _of_alike(weights: Array, alike: Sequence[bool]) -> Array:
    """The probabilities with those of laws that predict better than the first, which is named, by
    torques ``alike`` (they differ by less than what stays unexplained, which may be all that they
    predict) shared with it.
    """
    ahead = np.asarray(alike) & (weights > weights[0])
    ahead[0] = True
    return np.where(ahead, np.mean(weights[ahead]), weights)


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
    """The effects of the given model that this term has replaced: laws of its own kind of friction,
    or of its mechanism.
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
    kind = kind_of(own)
    rubs = [t for t in new_terms(given, final, joint) if mechanism_of(t.effect) in kind]
    mine = [e for e in gone if mechanism_of(e) in kind]
    if len(kind) > 1 and len(rubs) > 1:  # where both are new, each replaces its own kind
        exact = [e for e in mine if mechanism_of(e) == own]
        others = {mechanism_of(t.effect) for t in rubs if t is not term}
        mine = exact + [e for e in mine if mechanism_of(e) not in others and e not in exact]
    return tuple(sorted(set(mine)))
