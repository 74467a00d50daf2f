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
from collections.abc import Collection, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from zendsp.diagnosis.data.inertia import inertia_ranges
from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.absorbed import shifted
from zendsp.diagnosis.decide.across import all_late, pushed_alone, same_timing
from zendsp.diagnosis.decide.assemble import Assembled, assemble
from zendsp.diagnosis.decide.claims import Decision, unclaimed
from zendsp.diagnosis.decide.contract import BEYOND, Verdict
from zendsp.diagnosis.decide.law_torque import rms_torque
from zendsp.diagnosis.decide.moved import bodies_wrong
from zendsp.diagnosis.decide.notes import MADE_WORSE
from zendsp.diagnosis.explain.one_joint import explain_joint, upon_ripples
from zendsp.diagnosis.measure.discrepancy import discrepancy
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.measure.structure import Structure
from zendsp.diagnosis.measure.windows import model_error, noise_floor, rms, window_error
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.search.hypothesis import JointSearch
from zendsp.parent import die_with
from zendsp.physics.calibration.fit import Data
from zendsp.physics.model import Model

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
                done[joint] = explain_joint(parts, beneath, joint, jobs, tell)
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


# filled in the processes of _search only
_inherited: list[tuple[Parts, Model, Progress]] = []


def _inherit(parent: int, parts: Parts, beneath: Model, tell: Progress) -> None:
    die_with(parent)  # which could not end its children if killed
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # the parent handles them
        signal.signal(number, signal.SIG_DFL)
    _inherited[:] = [(parts, beneath, tell)]


def _search_inherited(joint: int) -> tuple[JointSearch, Decision]:
    parts, beneath, tell = _inherited[0]
    return explain_joint(parts, beneath, joint, 1, tell)
