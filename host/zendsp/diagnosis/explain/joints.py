"""Searches and decides every joint, in a process of its own where there are several, and assembles
the machine.

Two models go through this file: ``given`` is the user's; ``beneath`` adds what is known of the
machine so far, and is the start of a joint's search.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
from collections.abc import Collection, Iterable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from zendsp.diagnosis.data.inertia import inertia_ranges
from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.absorbed import bodies_wrong, shifted
from zendsp.diagnosis.decide.across import all_late, pushed_alone, same_timing
from zendsp.diagnosis.decide.assemble import Assembled, assemble
from zendsp.diagnosis.decide.claims import Decision, unclaimed
from zendsp.diagnosis.decide.contract import BEYOND, Verdict
from zendsp.diagnosis.decide.decide import decide
from zendsp.diagnosis.decide.fast_ripple import fine_ripples
from zendsp.diagnosis.decide.notes import MADE_WORSE
from zendsp.diagnosis.decide.pieces import has, rms_torque
from zendsp.diagnosis.decide.pushes import unpushed
from zendsp.diagnosis.decide.thresholds import LAW_ERROR
from zendsp.diagnosis.explain.faster_observer import searched
from zendsp.diagnosis.measure.discrepancy import discrepancy
from zendsp.diagnosis.measure.evidence import compare
from zendsp.diagnosis.measure.likelihood import Scored, calibrate_joint, fit_scored
from zendsp.diagnosis.measure.structure import Structure
from zendsp.diagnosis.measure.windows import model_error, noise_floor, rms, window_error
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.search.forward import Searcher, is_white
from zendsp.diagnosis.search.hypothesis import JointSearch, Rival
from zendsp.diagnosis.search.short_fits import WAIT
from zendsp.diagnosis.search.simplify import upon
from zendsp.diagnosis.transmission.links import divided, with_links
from zendsp.parent import die_with
from zendsp.physics.calibration.fit import Data, joint_handles
from zendsp.physics.effects import get_effect, mechanism_of
from zendsp.physics.model import Model

# gain of creep alone, as a share of the gain of what was found: with less, that was not mistaken
# for creep
CREEPS = 0.15
LOOK_S = 0.5  # interval of checks on the processes of the joints
Explained = tuple[list[JointSearch], list[Decision], Assembled]
Done = Mapping[int, tuple[JointSearch, Decision]]  # by joint


class SearchStopped(KeyboardInterrupt):
    """Ctrl-C while joints were searched. ``done``: the finished joints, at least one."""

    def __init__(self, done: Done) -> None:
        super().__init__()
        self.done = done


class Outnumbered(Exception):
    """The joints claim as many laws as the explanation to which they are compared."""


# standard deviations on the recordings to choose by from which a step is taken; and from which one
# may wait for another, or a friction is taken that every machine has (of a real axis with both, and
# neither in its model, each had -0.6 in 5 s)
GOES_ON, CONTRADICTED = 1.0, -1.0


class Acceptance:
    """Decides whether the search goes on with a step: it must pay for its parameters, also on the
    recordings to choose by; which must not contradict one that ``waits``. It claims nothing.
    """

    def __init__(self, choose: Data) -> None:
        self.choose = choose

    def __call__(self, before: Scored, rival: Rival, *, waits: bool = False) -> bool:
        if before.deviance - rival.value < WAIT:
            return False
        held = compare(before, rival.scored, self.choose, rival.joint)
        # every machine has friction: such a step has only not to be contradicted
        own = mechanism_of(rival.effect)
        expected = get_effect(rival.effect).common and not has(before.model, own, rival.joint)
        return held.z > (CONTRADICTED if expected or waits else GOES_ON)


def plainer(test: Data, given: Model, one: Explained, other: Explained, bodies: int) -> bool:
    """Whether one explanation claims less than another and predicts as well, or as well as the
    sensor lets anyone judge. ``bodies``: the count of the other's bodies minus that of the one's.
    """
    errors = [model_error(test, whole.improved) for _, _, whole in (one, other)]
    if errors[0] > max(errors[1], BEYOND * noise_floor(test)):
        return False
    claims = [findings_at(test, given, explained) for explained in (one, other)]
    return claims[0] < claims[1] + bodies


def findings_at(test: Data, given: Model, explained: Explained) -> int:
    """The count of findings of an explanation at the joints, with given numbers that are wrong."""
    _, decisions, whole = explained
    at_joints = sum(
        len(d.claims) + len(shifted(given, d, whole, {c.term.effect for c in d.claims}, test))
        for d in decisions
    )
    return at_joints + bodies_wrong(given, whole.improved)


def with_their_links(
    measured_motion: Parts,
    parts: Parts,
    given: Model,
    beneath: Model,
    first: Explained,
    jobs: int,
    tell: Progress,
) -> tuple[Parts, Explained]:
    """The explanation, repeated where a joint was found to have a transmission or a sensor error.

    Other joints feel the true motion of its link, and otherwise have to explain it by something of
    their own. The joints are taken one after the other, each time the one that explains the machine
    best, as long as that claims no more and predicts no worse.
    """
    felt, now, explained = divided(beneath), parts, first
    while found := _claimed(explained, "transmission", "measurement") - felt:
        tell(Step.ASSEMBLING.says("the links that nobody sees: what the other joints feel"))
        tried = []
        for joint in found:
            with_it = with_links(measured_motion, explained[2].improved, felt | {joint})
            same = {joint: (explained[0][joint - 1], explained[1][joint - 1])}
            again = explain(with_bodies(with_it, beneath), given, beneath, jobs, tell, same)
            tried.append((_cost(with_it.choose, again), joint, with_it, again))
        best = min(tried, key=lambda t: t[0])
        before = _cost(now.choose, explained)
        if best[0][0] > before[0] or best[0][1] > before[1]:
            break
        felt, now, explained = felt | {best[1]}, best[2], best[3]
    swinging = _claimed(explained, "transmission")
    # the motion within a measured gap depends on the last digits of its numbers
    gaps = {t.joint for t in beneath.terms[len(given.terms) :] if get_effect(t.effect).rough}
    calm = [
        unpushed(d)
        if d.kind == Verdict.DISTURBANCE and (swinging - {d.joint} or d.joint in gaps)
        else d
        for d in explained[1]
    ]
    return now, (explained[0], calm, explained[2])


def _claimed(explained: Explained, *mechanisms: str) -> frozenset[int]:
    """The joints whose link has no sensor and for which one of some mechanisms is claimed."""
    claimed = {d.joint for d in explained[1] if any(c.mechanism in mechanisms for c in d.claims)}
    return divided(explained[2].improved) & claimed


def _cost(choose: Data, explained: Explained) -> tuple[int, float]:
    """The count of an explanation's claims, and its position error on the recordings to choose by.
    (A likelihood would not count what its observer follows.)
    """
    away = 0.0
    for decision in explained[1]:
        error = rms(window_error(choose, decision.final.model, decision.joint))
        read = max(error, noise_floor(choose, decision.joint))
        away += math.log(read) if read > 0.0 else 0.0  # no data is left there
    return sum(len(d.claims) for d in explained[1]), away


def explain(
    parts: Parts,
    given: Model,
    beneath: Model,
    jobs: int,
    tell: Progress,
    done: Done = MappingProxyType({}),
    most: float = math.inf,
) -> Explained:
    """The searches and decisions of all joints, and the assembled machine. ``beneath``: the given
    model with what is known so far. ``done``: joints that are searched already.

    Raises
    ------
    Outnumbered
        The joints claim ``most`` laws or more; the rest of them are not searched.
    """
    searches, decisions = _search(parts, given, beneath, jobs, tell, done, most)
    beneath = upon_ripples(beneath, searches)
    decisions = all_late(parts, beneath, searches, decisions, jobs)
    decisions = pushed_alone(same_timing(parts, decisions, jobs))
    tell(Step.ASSEMBLING.says("fitting the improved model"))
    decisions, whole = _no_worse(parts, beneath, decisions, jobs)
    added = beneath.terms[len(given.terms) :]  # held fixed, so they come out unchanged
    known = tuple(t for t in whole.calibrated.terms if t not in added)
    return searches, decisions, replace(whole, calibrated=whole.calibrated.with_terms(known))


def _no_worse(
    parts: Parts, beneath: Model, decisions: list[Decision], jobs: int
) -> tuple[list[Decision], Assembled]:
    """The assembled machine, without the claims of joints whose untouched data it predicts worse
    than the calibrated model; or than the given one, where something in the recordings of the fit
    bends the numbers.
    """
    while True:
        whole = assemble(parts, beneath, decisions, jobs)
        worse = {}
        for d in decisions:
            if d.claims:
                named = any(c.effect != "unknown" for c in d.claims)
                before = (beneath, whole.calibrated) if named else (beneath,)
                *errors, after = (
                    rms(window_error(parts.test, m, d.joint)) for m in (*before, whole.improved)
                )
                # where the model has nothing of what was found, calibration alone made it worse:
                # below the limit of the note ``bent`` the missing torque may be the reason
                most = 1.0 if named or d.refinements else MADE_WORSE
                # a joint that rests in what is tested on is predicted without an error
                worse[d.joint] = after / max(most * min(errors), 1e-300)
        joint = max(worse, key=lambda j: worse[j], default=0)
        if not joint or worse[joint] <= 1.0:
            return decisions, whole
        decisions = [unclaimed(d) if d.joint == joint else d for d in decisions]


def with_bodies(parts: Parts, model: Model) -> Parts:
    """The same recordings, with the joints' inertias by inverse dynamics once bodies are known."""
    return replace(parts, fit=replace(parts.fit, ranges=inertia_ranges(parts.fit.records, model)))


def _search(
    parts: Parts,
    given: Model,
    beneath: Model,
    jobs: int,
    tell: Progress,
    known: Done,
    most: float = math.inf,
) -> tuple[list[JointSearch], list[Decision]]:
    joints = [joint for joint in range(1, given.joints + 1) if joint not in known]
    done = dict(known)
    if jobs == 1 or len(joints) < 2:
        try:
            for joint in joints:
                done[joint] = _searched(parts, beneath, joint, jobs, tell)
                _count(done, most)
        except KeyboardInterrupt as stop:
            raise (SearchStopped(done) if done else stop) from None
        return _in_order(done)
    # joints are independent: each has a process, which inherits the recordings and the user's own
    # effects
    context = multiprocessing.get_context("fork")
    stages = context.SimpleQueue()
    inherited = (os.getpid(), parts, beneath, stages.put)
    with ProcessPoolExecutor(min(jobs, len(joints)), context, _inherit, inherited) as pool:
        searches = {joint: pool.submit(_search_inherited, joint) for joint in joints}
        waiting: Collection[Future[Any]] = searches.values()
        try:
            while waiting:
                _, waiting = wait(waiting, LOOK_S, FIRST_COMPLETED)
                while not stages.empty():
                    tell(stages.get())
                ready = {j: s.result() for j, s in searches.items() if s.done()}
                _count({**done, **ready}, most)
            done |= {joint: search.result() for joint, search in searches.items()}
        except BaseException as stop:  # an interrupt: what is pending is cancelled
            for process in list(pool._processes.values()):
                process.terminate()
            ended = {j: s for j, s in searches.items() if s.done() and not s.exception()}
            done |= {joint: search.result() for joint, search in ended.items()}
            if isinstance(stop, KeyboardInterrupt) and done:
                raise SearchStopped(done) from None
            raise
    return _in_order(done)


def _count(done: Done, most: float) -> None:
    if sum(len(decision.claims) for _, decision in done.values()) >= most:
        raise Outnumbered


def not_searched(
    parts: Parts, beneath: Model, joint: int, jobs: int
) -> tuple[JointSearch, Decision]:
    """The search and decision of a joint that was not searched: its calibrated model."""
    base = calibrate_joint(parts.fit, beneath, joint, jobs)
    left, none = discrepancy(parts.test, base.model, joint), Structure(0.0, 0.0, 0.0)
    scale = rms_torque(parts.test, joint)
    decision = Decision(
        joint, Verdict.UNEXPLAINED, (), (), base, base, left, left, none, left, base, scale,
        searched=False,
    )  # fmt: skip
    return JointSearch(joint, base), decision


def _in_order(
    done: Done,
) -> tuple[list[JointSearch], list[Decision]]:
    pairs = [done[joint] for joint in sorted(done)]
    return [s for s, _ in pairs], [d for _, d in pairs]


def _searched(
    parts: Parts, beneath: Model, joint: int, jobs: int, tell: Progress
) -> tuple[JointSearch, Decision]:
    """The search of a joint, and its decision."""

    def search(parts: Parts) -> tuple[JointSearch, Decision]:
        return _search_joint(parts, beneath, joint, jobs, tell)

    return searched(search, parts, beneath, joint, jobs, tell)


def _search_joint(
    parts: Parts, beneath: Model, joint: int, jobs: int, tell: Progress
) -> tuple[JointSearch, Decision]:
    tell(Step.CALIBRATING.says(f"joint {joint}: calibrating the given model"))
    base = calibrate_joint(parts.fit, beneath, joint, jobs)
    accept = Acceptance(parts.choose)
    searcher = Searcher(parts.fit, joint, accept, jobs, tell, beneath)
    late = searcher.late_log(base)
    if late is not None:  # found before any physics is blamed
        base, beneath = late, beneath.with_terms((*beneath.terms, late.model.terms[-1]))
        searcher = Searcher(parts.fit, joint, accept, jobs, tell, beneath)
    # how a known friction acts at reversals is no missing physics, and hides what is
    soft = None if is_white(base, joint) else searcher.softened(base)
    first = soft is not None and searcher.leads(soft, base)
    search = JointSearch(joint, base) if first else searcher.search(base)
    if soft is not None and (first or not is_white(search.final, joint)):
        tell(Step.SEARCHING.says(f"joint {joint}: with a dry friction that creeps"))
        creeping = beneath.with_terms((*beneath.terms, soft.model.terms[-1]))
        again = Searcher(parts.fit, joint, accept, jobs, tell, creeping)
        other = _upon_creep(search, soft, again, jobs) or again.search(soft)
        if other.final.deviance < search.final.deviance - WAIT:
            if any(t.effect == "creep" for t in other.final.model.at(joint)):
                search, beneath = other, creeping
            else:
                search = replace(other, base=base)  # the creep is no longer needed
    search, beneath = _creeping_found(parts, beneath, search, searcher, tell)
    if beneath.joints == 1:  # of several, bodies and links come before what passes fast
        rippled = with_fine_ripples(parts, search, jobs)
        if rippled.fine:
            done = decided_again(parts, upon_ripples(beneath, [rippled]), rippled, jobs, tell)
            if done[1].kind in (Verdict.COMPLETE, Verdict.MISSING):
                return done
    decision = decide(parts, beneath, search, jobs, tell)
    if beneath.joints > 1:
        tell(Step.SEARCHING.says(f"joint {joint} is done, by itself: {_seems(decision)}"))
    return search, decision


def _seems(decision: Decision) -> str:
    """A sentence on the decision of one joint, before all are considered together."""
    laws = ", ".join(c.effect for c in decision.claims)
    plain = {
        Verdict.COMPLETE: "nothing seems to be missing",
        Verdict.DISTURBANCE: "something pushes it",
        Verdict.UNEXPLAINED: "something is missing that has no name",
    }
    return plain.get(decision.kind) or f"{laws} seems to be missing"


def _creeping_found(
    parts: Parts, beneath: Model, first: JointSearch, searcher: Searcher, tell: Progress
) -> tuple[JointSearch, Model]:
    """The search, and the model beneath it: gone on with from a dry friction that was found, where
    that creeps; a spring, a delay or bristles beside it may only imitate it.
    """
    joint, jobs = first.joint, searcher.jobs
    laws = [(get_effect(t.effect), k) for k, s in enumerate(first.steps) for t in s.chosen.terms]
    at = next((k for law, k in laws if law.site == "dry"), None)
    if at is None or not any(law.hidden for law, _ in laws):
        return first, beneath
    soft = searcher.softened(first.steps[at].chosen.scored)
    if soft is None:
        return first, beneath
    tell(Step.SEARCHING.says(f"joint {joint}: with the dry friction found, that creeps"))
    # held: without that friction nothing depends on it
    *terms, creep = soft.model.terms
    creeping = beneath.with_terms((*beneath.terms, creep.held()))
    base = calibrate_joint(parts.fit, creeping, joint, jobs)
    model = soft.model.with_terms((*terms, creep.held()))
    dry = fit_scored(soft.data, model, joint_handles(soft.data, model, joint), (joint,), jobs=jobs)
    step = replace(first.steps[at], chosen=replace(first.steps[at].chosen, scored=dry))
    begun = replace(first, base=base, steps=[*first.steps[:at], step], best=dry, dropped=())
    other = Searcher(parts.fit, joint, searcher.accept, jobs, tell, creeping).further(begun)
    was, now = (_dry_level(found.final.model, joint) for found in (first, other))
    # smooth over more of the motion it is a law of the speed
    turns = abs(now - was) < LAW_ERROR * was
    pays = other.final.deviance < first.final.deviance - WAIT
    return (other, creeping) if turns and pays else (first, beneath)


def _dry_level(model: Model, joint: int) -> float:
    """The level of all dry friction of a joint, N m or N."""
    laws = [(t, get_effect(t.effect)) for t in model.at(joint)]
    return sum(t.value(law.parameters[0].name) for t, law in laws if law.site == "dry")


def _upon_creep(
    first: JointSearch, soft: Scored, again: Searcher, jobs: int
) -> JointSearch | None:
    """The earlier search, fitted again upon a creeping friction, and gone on with. None where the
    creep gains so much that it may have been mistaken for what was found.
    """
    found = first.base.deviance - first.final.deviance
    if not first.base.deviance - soft.deviance < CREEPS * found:
        return None
    both = again.creeping(first.final, soft.model.terms[-1])
    return again.further(upon(first, soft, jobs, both))


def with_fine_ripples(parts: Parts, search: JointSearch, jobs: int) -> JointSearch:
    """The search with the ripples that only a fast observer sees, where it has none yet."""
    if search.fine:
        return search
    return replace(search, fine=tuple(fine_ripples(parts.fit, parts.choose, search, jobs)))


def upon_ripples(beneath: Model, searches: Iterable[JointSearch]) -> Model:
    """The model with the fast ripples of some searches that it does not have. They are held: slower
    observers know less of them than the fast one that found them.
    """
    terms = [ripple.term.held() for s in searches for ripple in s.fine]
    return beneath.with_terms((*beneath.terms, *(t for t in terms if t not in beneath.terms)))


def decided_again(
    parts: Parts, beneath: Model, first: JointSearch, jobs: int, tell: Progress
) -> tuple[JointSearch, Decision]:
    """A search fitted upon a model that knows more by now, and decided again."""
    tell(Step.ASSEMBLING.says(f"joint {first.joint}: what was found, upon what passes fast"))
    known = first.base.model.terms
    had = {t.joint for t in beneath.terms if t.effect == "creep"}
    found = (k for k, t in enumerate(known) if t.effect == "creep" and t.joint not in had)
    creep = next(found, None)
    if creep is not None:
        terms = beneath.terms
        beneath = beneath.with_terms((*terms[:creep], known[creep], *terms[creep:]))
    base = calibrate_joint(parts.fit, beneath, first.joint, jobs)
    search = upon(first, base, jobs)
    return search, decide(parts, beneath, search, jobs, tell)


# filled in the processes of _search only
_inherited: list[tuple[Parts, Model, Progress]] = []


def _inherit(parent: int, parts: Parts, beneath: Model, tell: Progress) -> None:
    die_with(parent)  # which could not end its children if killed
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # the parent handles Ctrl-C
    _inherited[:] = [(parts, beneath, tell)]


def _search_inherited(joint: int) -> tuple[JointSearch, Decision]:
    parts, beneath, tell = _inherited[0]
    return _searched(parts, beneath, joint, 1, tell)
