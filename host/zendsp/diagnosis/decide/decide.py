"""The decision: which mechanisms are claimed, by which law, and what is said of the rest.

The principle (docs/diagnosis.md, "How it decides"): a recording is the sum of named physics, an
unnamed discrepancy, and the sensor's error. A finding is a mechanism without which the discrepancy
grows, on recordings that neither the fit nor any choice has touched. The search proposes
mechanisms. Here each is taken away, everything else is fitted again, and the cost decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.believed import believed
from zendsp.diagnosis.decide.claims import Claim, Decision, Piece
from zendsp.diagnosis.decide.contract import Verdict, contradicted
from zendsp.diagnosis.decide.findings import estimates, new_terms
from zendsp.diagnosis.decide.law_torque import kind_of, rubs
from zendsp.diagnosis.decide.laws import named
from zendsp.diagnosis.decide.near import with_reasons
from zendsp.diagnosis.decide.nothing_named import nothing_named, throws
from zendsp.diagnosis.decide.pieces import grouped, held_apart, piece_of, sure, worth_choosing
from zendsp.diagnosis.decide.pushes import beside, by_own_numbers, felt, lost, pushed_beside
from zendsp.diagnosis.decide.thresholds import LAWFUL, PREDICTED, RUN_AWAY, SIMULATORS_DIFFER, SURE
from zendsp.diagnosis.measure.discrepancy import beyond, discrepancy
from zendsp.diagnosis.measure.likelihood import Scored, informative
from zendsp.diagnosis.measure.significance import essence_of
from zendsp.diagnosis.measure.windows import rms, window_error
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.search.hypothesis import JointSearch, Rival
from zendsp.diagnosis.search.short_fits import WAIT
from zendsp.diagnosis.search.simplify import simplify
from zendsp.physics.calibration.fit import Data, Fit
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]


def decide(parts: Parts, given: Model, search: JointSearch, jobs: int, tell: Progress) -> Decision:
    """The decision about one joint: its claims, and what they leave.

    Parameters
    ----------
    parts : Parts
        Recordings to fit to, to choose by, and to test on.
    search : JointSearch
        The search, with its proposed model.
    jobs : int
        Threads.
    tell : callable
        Receives a sentence at each stage.
    """
    out = _decided(parts, given, search, jobs, tell)
    if out.kind == Verdict.COMPLETE:
        out = _beside_the_fit(out, parts)
    turning = not rubs(search.base.model, search.joint)
    if lost(parts, search.base.model, search.joint):
        return out
    if out.kind == Verdict.MISSING and not any(c.effect == "unknown" for c in out.claims):
        models = [out.final]
    # missing friction and pushes hide each other
    elif out.kind == Verdict.UNEXPLAINED and not out.loads:
        models = [r.scored for r in search.tried if get_effect(r.effect).common]
        if parts.fit.joints == 1:  # of several joints, a wrong body is as likely as a law of one
            models += [r.scored for r in search.tried[:1]]  # refused for a push to choose by
        models += [search.best] if search.best is not None else []
    else:
        return replace(out, beside=felt(out, parts, turning))
    out = replace(out, bursts=pushed_beside(out, models, parts, turning, jobs))
    small = out.kind == Verdict.UNEXPLAINED and beyond(out.before.value, out.known.all) < LAWFUL
    if small and out.bursts is None:
        push = felt(out, parts, turning)
        # something surely lacks, and no state explains it
        own = push is None or by_own_numbers(out, parts, jobs, push.recordings)
        if not own and not out.doubted:
            return replace(out, kind=Verdict.DISTURBANCE, bursts=push)
        return replace(out, beside=push)
    return out


def _beside_the_fit(out: Decision, parts: Parts) -> Decision:
    """A complete decision; open where the recordings of the fit surely lack something. Held-out
    ones with larger torques may have too little of it.
    """
    lacks, doubted = discrepancy(parts.fit, out.base.model, out.joint), contradicted(out.lost)
    # otherwise it is likelier as correlated noise is, not for a torque that only those lack
    if doubted and lacks.high > SIMULATORS_DIFFER and lacks.low > out.before.high:
        return replace(out, kind=Verdict.UNEXPLAINED, doubted=doubted)
    if beyond(lacks.low, out.known.all) > LAWFUL and throws(parts.fit, out, lacks.value):
        return replace(out, kind=Verdict.UNEXPLAINED, after=lacks)
    return out


def _decided(
    parts: Parts, given: Model, search: JointSearch, jobs: int, tell: Progress
) -> Decision:
    joint, base = search.joint, search.base
    tell(Step.SEARCHING.says(f"joint {joint}: what each mechanism is worth"))
    final = worth_choosing(parts, given, search, jobs)
    before = discrepancy(parts.test, base.model, joint)
    asked: list[Piece] = []
    if new_terms(given, final.model, joint):
        final, claimed, rest = _surely_shown(parts, given, search, final, jobs)
        asked = with_reasons(claimed, rest, None, None)
        if not claimed:
            sounder = find_sounder(parts, search, final, rest, jobs)
            if sounder is not None:
                return _decided(parts, given, sounder, jobs, tell)
        if claimed:
            first = named(parts, given, search, final, claimed, rest, before, jobs, tell)
            other = _exchanged(parts, search, final, first, jobs)
            if other is not None:
                exchanged = _decided(parts, given, other, jobs, tell)
                # a likelier law has to stand on untouched recordings, too
                if exchanged.claims or not first.claims:
                    return exchanged
            decision = believed(first, parts, given, jobs)
            better = _makes_better(decision, parts.test)
            refined = decision.claims and decision.alone is not decision.final
            if refined and (not better or _blurred(decision, given)):
                decision = _unrefined_by(decision)
                better = _makes_better(decision, parts.test)
            asked = with_reasons(claimed, rest, first, decision)
            if decision.claims and better:
                if any(c.effect != "unknown" for c in decision.claims):
                    return replace(decision, beside=beside(decision, parts))
                # the missing torque itself has to show which mechanism, if any
                plain = nothing_named(parts, given, search, before, asked, jobs)
                most = decision.after.value**2 < (1.0 - PREDICTED) * before.value**2
                kind = kind_of(decision.claims[0].mechanism)
                same = any(c.mechanism in kind for c in plain.claims)
                stands = plain.kind == Verdict.COMPLETE or (most and not plain.claims) or same
                if len(decision.claims) == 1:
                    return decision if stands else plain
                # several mechanisms without any law are one unknown torque
                unnamed = plain.kind == Verdict.COMPLETE
                return replace(plain, kind=Verdict.UNEXPLAINED) if unnamed else plain
    nothing = nothing_named(parts, given, search, before, asked, jobs)
    several = len({rec[0].recording for part in parts.each for rec in part.records}) > 1
    if nothing.kind != Verdict.UNEXPLAINED or not several:
        return nothing
    return replace(nothing, loads=by_own_numbers(nothing, parts, jobs))


def _surely_shown(
    parts: Parts, given: Model, search: JointSearch, final: Scored, jobs: int
) -> tuple[Scored, list[Piece], list[Piece]]:
    """The proposed model with what it claims, and what only refines it: without terms that the
    untouched recordings do not surely show, one mechanism after the other, the least sure first.

    Beside a claim such a term is bent to what no law describes, and hides it; on other motions it
    may do anything. Friction that every machine has stays.
    """
    joint, known = search.joint, (search.base, *(step.chosen.scored for step in search.steps))
    last: tuple[Scored, list[Piece], list[Piece]] | None = None
    while True:
        new = grouped(given, final.model, new_terms(given, final.model, joint))
        pieces = [
            piece_of(parts.test, given, final, key[0], terms, known, jobs)
            for key, terms in new.items()
        ]
        pieces.sort(key=lambda p: -p.size)
        claimed, rest = held_apart(parts, given, search, final, pieces)
        # friction that every machine has is not given up for an unsure refinement
        held = last is not None and any(p.expected for p in last[1])
        if last is not None and (not claimed or (held and not any(p.expected for p in claimed))):
            return last
        last = final, claimed, rest
        unsure = [
            p
            for p in rest
            if not sure(parts.test, p) and not any(get_effect(e).common for e in p.effects)
        ]
        if not claimed or not unsure:
            return last
        final = min(unsure, key=lambda p: p.log_e).without
        if len(new_terms(given, final.model, joint)) >= sum(map(len, new.values())):
            return last  # what it had replaced is new, too


def _makes_better(decision: Decision, test: Data) -> bool:
    """Whether a decision predicts untouched recordings no worse, and leaves no more torque
    unexplained than before, nor more than the whole torque (as a spring that holds a joint at its
    place). Only such a decision can be a finding.
    """
    models = (decision.base.model, decision.final.model)
    errors = [rms(window_error(test, m, decision.joint)) for m in models]
    return errors[1] <= errors[0] and decision.after.value <= min(decision.before.value, 1.0)


def _unrefined_by(decision: Decision) -> Decision:
    """The decision without the refinements that its claims do not need. They may be likelier and
    yet far off, as a falling friction is where a slowing joint may or may not stick.
    """
    needed = {t.effect for t in decision.alone.model.at(decision.joint)}
    kept = tuple(c for c in decision.refinements if c.term.effect in needed)
    return replace(decision, final=decision.alone, after=decision.bare, refinements=kept)


def _blurred(decision: Decision, given: Model) -> bool:
    """Whether a claimed law has an uncertain number beside the refinements, and a certain one
    without them.
    """
    kind = given.joint_kind(decision.joint)
    units = given.actuator.command_unit, given.torque_unit(decision.joint)

    def certain(fit: Fit, claim: Claim) -> bool:
        values = estimates(fit, claim.term, kind, *units)
        own = [values[key] for key in essence_of(claim.effect) if key in values]
        return all(abs(v.value) > SURE * v.std for v in own)

    laws = [c for c in decision.claims if c.effect != "unknown"]
    return any(
        certain(decision.alone.fit, c) and not certain(decision.final.fit, c) for c in laws
    )


def _exchanged(
    parts: Parts, search: JointSearch, final: Scored, first: Decision, jobs: int
) -> JointSearch | None:
    """The search with a likelier law in place of a claimed one; None where there is none, or where
    its simplified form is no likelier. Each exchange is a gain, so the exchanges end.
    """
    for claim in first.claims:
        if claim.instead is not None:
            other = replace(search, best=claim.instead)
            other.best, _ = simplify(other, informative(parts.fit, search.joint), jobs)
            if other.best.deviance < final.deviance - WAIT:
                return other
    return None


def find_sounder(
    parts: Parts, search: JointSearch, final: Scored, pieces: Sequence[Piece], jobs: int
) -> JointSearch | None:
    """The next search to decide upon where nothing proposed can be claimed; None where nothing is
    left to try.

    If the proposed model diverges on recordings that it was not fitted to: the next hypothesis of
    the first step, alone. Otherwise the first step without those that followed: they may have
    absorbed some discrepancy between machine and model, which costs the first its evidence.
    """
    if any(p.size > RUN_AWAY for p in pieces):
        there = {t.effect for t in final.model.at(search.joint)}
        for k, rival in enumerate(search.tried):
            gain = search.base.deviance - rival.scored.deviance
            if rival.effect not in there and gain > WAIT:
                return _with_best(replace(search, tried=search.tried[k + 1 :]), rival, parts, jobs)
        return None
    if len(search.steps) < 2:
        return None
    first = search.steps[0]
    return _with_best(replace(search, steps=[first]), first.chosen, parts, jobs)


def _with_best(search: JointSearch, rival: Rival, parts: Parts, jobs: int) -> JointSearch:
    """The search with one hypothesis alone as its best model, simplified."""
    other = replace(search, best=rival.scored)
    other.best, _ = simplify(other, informative(parts.fit, search.joint), jobs)
    return other
