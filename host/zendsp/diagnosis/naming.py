"""From the search to findings: names, numbers, what cannot be told apart, what was rejected and why."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from zendsp.diagnosis.assemble import Assembled
from zendsp.diagnosis.confidence import confidence
from zendsp.diagnosis.evidence import compare, torque_share
from zendsp.diagnosis.findings import estimates, new_terms, sentence
from zendsp.diagnosis.hypothesis import JointSearch, Rival
from zendsp.diagnosis.result import Estimate, Finding, Rejected
from zendsp.diagnosis.score import Scored, fit_scored
from zendsp.diagnosis.screen import FRICTION
from zendsp.diagnosis.search import Searcher
from zendsp.diagnosis.shift import shifted
from zendsp.diagnosis.verdict import STATE, JointOutcome, Outcome
from zendsp.physics.effects import get_effect
from zendsp.physics.fit import Data, joint_handles
from zendsp.physics.model import Model, Term

CLOSE = 10.0  # deviance: a rival this close explains as well
TIE_Z = 2.0  # paired z over blocks below which two hypotheses predict equally well


@dataclass(frozen=True)
class _Named:
    """One new term with its evidence."""

    term: Term
    loss: float  # deviance lost without it
    rivals: tuple[Rival, ...]
    own: float  # deviance with it
    rank: float  # its own gain in the order of its rivals
    without: Scored


def name_findings(
    train: Data,
    test: Data,
    given: Model,
    searches: Sequence[JointSearch],
    whole: Assembled,
    outcome: Outcome,
    jobs: int,
    tell: Callable[[str], None],
) -> tuple[tuple[Finding, ...], tuple[Rejected, ...]]:
    """Name what the search found.

    Returns
    -------
    findings, rejected
        Findings sorted by what they explain, the largest first.
    """
    ranked: list[tuple[float, Finding]] = []
    rejected: list[Rejected] = []
    for search, result in zip(searches, outcome.joints, strict=True):
        if result.kind == "unexplained":
            rejected += [
                Rejected(
                    r.effect,
                    r.joint,
                    "explains a part, but leaves a torque that depends on the state" if result.after.state_share > STATE else "explains too little of what is missing",
                    -0.5 * (r.value - search.base.deviance),
                )
                for r in search.tried[:4]
            ]
            continue
        if result.kind == "disturbance":
            ranked.append((1e9, _disturbance(result, given)))
            continue
        named = _evidence(train, test, given, search, jobs, tell)
        total = sum(n.loss for n in named) or 1.0
        explained = max(0.0, 1.0 - (result.after.size / max(result.before.size, 1e-300)) ** 2)
        for item in named:
            finding, lost = _finding(given, search, whole, item, result, item.loss / total * explained, test)
            ranked.append((item.loss, finding))
            rejected += lost
        if not named:
            rejected += [_why(r, search.base, test) for r in search.tried[:6]]
        ranked += [
            (0.5 * abs(z), finding)
            for z, finding in shifted(given, search, whole, {n.term.effect for n in named}, test)
        ]
    ranked.sort(key=lambda item: -item[0])
    unique = {(r.effect, r.joint): r for r in sorted(rejected, key=lambda r: r.score)}
    return tuple(f for _, f in ranked), tuple(sorted(unique.values(), key=lambda r: -r.score)[:12])


def _evidence(
    train: Data, test: Data, given: Model, search: JointSearch, jobs: int, tell: Callable[[str], None]
) -> list[_Named]:
    final, joint = search.final, search.joint
    terms = [t for t in new_terms(given, final.model, joint) if not _weight_of_payload(given, final.model, t)]
    searcher = Searcher(train, joint, lambda *_: True, jobs, tell)
    out = []
    for term in terms:
        if len(search.steps) == 1 and len(terms) == 1:
            without, rivals, rank = search.base, search.steps[0].rivals, search.steps[0].chosen.rank
        else:
            tell(f"joint {joint}: what could stand in for {term.effect}")
            without = _without(final, term, joint, jobs)
            names = frozenset(get_effect(term.effect).rivals) | _close_in_steps(search, term.effect)
            beside = searcher.stand_ins(without, names | {term.effect}) if names else []
            rivals = tuple(r for r in beside if r.effect != term.effect)
            rank = max(
                [r.rank for r in beside if r.effect == term.effect], default=without.deviance - final.deviance
            )
        out.append(_Named(term, without.deviance - final.deviance, rivals, final.deviance, rank, without))
    return out


def _weight_of_payload(given: Model, final: Model, term: Term) -> bool:
    """Whether a gravity term is the weight of an inertia that was found with it: a payload is one finding, not two."""
    found = {t.effect for t in new_terms(given, final, term.joint)}
    upright = abs(math.sin(term.value("angle"))) < 0.2 and any(
        q.value for q in given.mechanism.get("gravity", ())
    )
    return term.effect == "gravity" and "inertia" in found and upright


def _close_in_steps(search: JointSearch, effect: str) -> frozenset[str]:
    for step in search.steps:
        if step.chosen.effect == effect:
            gain = step.before.deviance - step.chosen.value
            return frozenset(r.effect for r in step.rivals[:3] if step.before.deviance - r.value > 0.5 * gain)
    return frozenset()


def _without(final: Scored, term: Term, joint: int, jobs: int) -> Scored:
    model = final.model.with_terms(tuple(t for t in final.model.terms if t is not term))
    return fit_scored(
        final.data, model, joint_handles(final.data, model, joint), (joint,), jobs=jobs, rounds=3
    )


def _finding(
    given: Model,
    search: JointSearch,
    whole: Assembled,
    item: _Named,
    result: JointOutcome,
    share: float,
    test: Data,
) -> tuple[Finding, list[Rejected]]:
    term, joint = item.term, search.joint
    fit = whole.fits[joint]
    kind = given.joint_kind(joint)
    values = estimates(fit, term, kind, given.actuator.unit)
    same, lost, margin = [], [], math.inf
    for r in item.rivals:
        if r.effect == term.effect or _contains(r, term):
            continue
        behind = (item.rank - r.rank) if math.isfinite(r.rank) else r.scored.deviance - item.own
        if _tied(r, search.final, behind, max(item.loss, item.rank), test):
            if r.effect not in same:
                same.append(r.effect)
        else:
            margin = min(margin, behind)
            lost.append(Rejected(r.effect, joint, _reason(behind, item.loss), -0.5 * behind))
    if (
        term.effect == "coulomb"
        and "torque_offset" in {t.effect for t in new_terms(given, search.final.model, joint)}
        and "coulomb_asymmetry" not in same
    ):
        same.append("coulomb_asymmetry")  # Coulomb friction and an offset are asymmetric Coulomb friction
    held = compare(item.without, search.final, test, joint)
    replaces = _replaced(given, search.final.model, term)
    sure = confidence(
        item.loss,
        held.z,
        margin,
        result,
        search.final.data.bandwidth[joint - 1],
        len(new_terms(given, search.final.model, joint)) - 1,
    )
    text = sentence(term, values)
    if term.effect == "inertia":
        weight = [
            t
            for t in new_terms(given, search.final.model, joint)
            if _weight_of_payload(given, search.final.model, t)
        ]
        if weight:
            text += f" It weighs: gravity grows by {weight[0].value('torque') * math.cos(weight[0].value('angle')):.3g} N m with it."
    if replaces:
        text += f" It makes {', '.join(replaces)} unnecessary."
    if same:
        text += f" This recording cannot tell it from {', '.join(same)}."
    numbers: dict[str, int | str] = {}
    if term.effect == "coupling":
        numbers = {
            "from_joint": int(term.value("from_joint")),
            "law": ("inertia", "coriolis", "viscous", "coulomb")[int(term.value("law"))],
        }
    finding = Finding(term.effect, joint, values, sure, share, tuple(same), replaces, text, numbers)
    return finding, lost[:6]


def _replaced(given: Model, final: Model, term: Term) -> tuple[str, ...]:
    """Effects of the given model that are gone, and that this term stands for: friction for friction, where there is any."""
    joint = term.joint
    gone = {t.effect for t in given.at(joint)} - {t.effect for t in final.at(joint)}
    rubs = {t.effect for t in new_terms(given, final, joint)} & set(FRICTION)
    if rubs and term.effect not in rubs:
        gone -= set(FRICTION)
    return tuple(sorted(gone))


def _contains(rival: Rival, term: Term) -> bool:
    """Whether the rival is the same effect with more freedom: a special case of it, or with a parameter at its bound."""
    if term.effect in get_effect(rival.effect).replaces:
        return True
    own = sum(p.fitted for p in get_effect(term.effect).parameters)
    more = sum(p.fitted for p in get_effect(rival.effect).parameters) > own
    return more and any(
        rival.scored.fit.at_bound[i]
        for i, h in enumerate(rival.scored.fit.handles)
        if h.place == "term" and _is_row(rival, h.index)
    )


def _is_row(rival: Rival, index: int) -> bool:
    t = rival.scored.model.terms[index]
    return t.joint == rival.joint and t.effect == rival.effect


def _tied(rival: Rival, best: Scored, behind: float, gain: float, test: Data) -> bool:
    if behind < CLOSE:
        return True
    if behind > 0.15 * gain:
        return False
    z = compare(rival.scored, best, test, rival.joint).z
    z_train = compare(rival.scored, best, best.data, rival.joint).z
    return z < TIE_Z and z_train < TIE_Z


def _reason(behind: float, gain: float) -> str:
    if behind > 0.9 * gain:
        return "does not explain the mismatch"
    return f"explains {100 * (1 - behind / gain):.0f} % of it"


def _why(rival: Rival, base: Scored, test: Data) -> Rejected:
    gain = base.deviance - rival.value
    held = compare(base, rival.scored, test, rival.joint)
    if gain < 40:
        why = "no more likely than the calibrated model"
    elif held.gain < 20 or held.z < 2.5:
        why = f"does not hold on the held-out recording (z = {held.z:.1f})"
    else:
        why = (
            f"too small to matter ({100 * torque_share(base, rival.scored, rival.joint):.2f} % of the torque)"
        )
    return Rejected(rival.effect, rival.joint, why, 0.5 * gain)


def _disturbance(result: JointOutcome, given: Model) -> Finding:
    joint = result.joint
    spans = ", ".join(f"{a:.2f}–{b:.2f} s" for a, b in result.spans[:4])
    unit = "N" if given.joint_kind(joint) == "linear" else "N m"
    text = f"A torque over time that no state explains acts on joint {joint} at {spans}."
    values = {"rms": Estimate(result.before.size, 0.0, unit)}
    return Finding("disturbance", joint, values, 0.9, result.before.time_peak, (), (), text)
