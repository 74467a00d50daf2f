"""Complete, missing, or unexplained: decided by what remains after the best explanation, joint by joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zendsp.diagnosis.assemble import Assembled
from zendsp.diagnosis.findings import new_terms
from zendsp.diagnosis.hypothesis import UNSETTLED, JointSearch, counterpart, sizes
from zendsp.diagnosis.remainder import Remainder, remainder
from zendsp.diagnosis.score import deviance, fastest, tune_bandwidth
from zendsp.diagnosis.simplify import simplify
from zendsp.diagnosis.where import intervals, missing_torque
from zendsp.diagnosis.windows import noise_floor, rms, window_error
from zendsp.physics.fit import Data, fit
from zendsp.physics.joint import run
from zendsp.physics.model import Model

SLOW = 8.0  # rad/s: an observer that follows little of what is missing
STATE = 0.25  # share of the remaining torque that a function of state must predict on held-out data
LARGE = 0.1  # of the RMS torque, and of the energy of the position error
MOST = 0.5  # of the energy of the held-out position error beyond the noise, and of the torque lacking: findings that leave so much explain nothing
SAME = 0.05  # physics has the same numbers in other recordings, to so much of their size; what lends itself to something else has others
UNPREDICTED = 0.03  # of the RMS torque: above the slow random torques and the noise that every machine has
PEAK = 0.55  # share of the energy in the tenth of the time where it is largest: 0.44 of noise, more of pushes
STRAY = 0.15  # share of the first mismatch that may remain, as a function of state, beside a named effect
# Of the RMS torque: a remainder below is called neither unexplained nor a disturbance. Other joints' motion, as well as it is measured, makes bursts of
# half of it, and so do the starts from rest in slow motion.
SMALL = 0.01
TRANSMISSION = {"elasticity", "backlash"}
OF_POSITION = ("stiffness", "cubic_stiffness", "gravity", "ripple")


@dataclass(frozen=True)
class JointOutcome:
    """What one joint came to: "complete", "missing", "unexplained" or "disturbance"."""

    joint: int
    kind: str
    before: Remainder
    after: Remainder
    fast: bool  # the best model needs the fastest observer still
    spans: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Outcome:
    """The verdict over all joints, and the sentence about what no effect explains."""

    verdict: str
    joints: tuple[JointOutcome, ...]
    sentence: str


def judge(
    train: Data, test: Data, given: Model, searches: Sequence[JointSearch], whole: Assembled, jobs: int
) -> Outcome:
    """Decide the verdict.

    Parameters
    ----------
    train, test : Data
    given : Model
    searches : sequence of JointSearch
    whole : Assembled
    jobs : int

    Returns
    -------
    Outcome
    """
    joints = tuple(_judge_joint(train, test, s) for s in searches)
    if train.joints > 1 and any(TRANSMISSION & {t.effect for t in new_terms(s.base.model, s.final.model, s.joint)} for s in searches):
        # nobody measured how the load behind a spring moves, which pushes the other joints
        joints = tuple(replace(j, kind="complete") if j.kind == "disturbance" else j for j in joints)
    kinds = {j.kind for j in joints}
    unit = "N" if given.joint_kind(1) == "linear" else "N m"
    words = []
    for j in joints:
        share = f"{100 * j.after.relative:.1f} % of the torque"
        if j.kind == "unexplained" and j.after.state_share > STATE:
            words.append(
                f"Joint {j.joint}: a torque of {j.after.state_size:.3g} {unit} RMS ({share}) depends on the state of the joint and is none of the known effects"
            )
        elif j.kind == "unexplained":
            words.append(
                f"Joint {j.joint}: a torque of {j.after.size:.3g} {unit} RMS ({share}) is missing that neither a known effect nor any function of the joint's state predicts"
            )
        elif j.kind == "missing" and j.after.relative > SMALL and (j.after.state_share > STATE or j.fast):
            words.append(
                f"Joint {j.joint}: beside what was found, {j.after.size:.3g} {unit} RMS ({share}) stays unexplained"
            )
    verdict = (
        "missing"
        if kinds & {"missing", "disturbance"}
        else "unexplained"
        if "unexplained" in kinds
        else "complete"
    )
    return Outcome(verdict, joints, ". ".join(words))


def _judge_joint(train: Data, test: Data, search: JointSearch) -> JointOutcome:
    j = search.joint
    before = remainder(search.base.data, test, search.base.model, j)
    final = search.final
    after = before if not search.steps else remainder(final.data, test, final.model, j)
    bandwidth = final.data.bandwidth[j - 1]
    fast = 2 * bandwidth > fastest(final.data)
    if search.steps:
        stray = after.state_share * after.size**2 / max(before.size**2, 1e-300)
        if _series(search):
            return JointOutcome(j, "unexplained", before, before, fast)  # nothing of it is claimed
        large = after.relative > LARGE and bandwidth >= UNSETTLED and _error_left(test, search) > LARGE
        if after.state_share > STATE and after.relative > SMALL and (stray > STRAY or large):
            return JointOutcome(j, "unexplained", before, after, fast)
        return JointOutcome(j, "missing", before, after, fast)
    if before.state_share > STATE and before.relative * np.sqrt(before.state_share) > SMALL:
        return JointOutcome(j, "unexplained", before, after, fast)
    if bandwidth >= UNSETTLED and before.relative > SMALL:
        spans = _disturbance(search) if before.time_peak > PEAK and before.state_share < STATE else ()
        if spans:
            return JointOutcome(j, "disturbance", before, after, fast, spans)
        if before.relative > (UNPREDICTED if fast else LARGE) and (fast or search.discarded):  # for the sensor's noise a slower observer does, in slow motion too
            return JointOutcome(j, "unexplained", before, after, fast)
    return JointOutcome(j, "complete", before, after, fast)


def settled(test: Data, search: JointSearch) -> JointSearch:
    """The search, without its findings where they leave most of the mismatch, as a torque, as a position and to a slow observer, and a fast one is
    needed still.

    Something else acts, which lends likelihood to whatever resembles it a little: other joints' motion that is known only as well as it
    was measured, or physics that the library does not have. But a small effect beside much that nobody can predict is still there: it
    is kept where other recordings give it the same numbers and what is left is no function of state.
    """
    j, final = search.joint, search.final
    if not search.steps or final.data.bandwidth[j - 1] <= UNSETTLED:
        return search
    if _error_left(test, search) <= MOST:
        return search
    best = deviance(test.at_bandwidth(j, final.data.bandwidth[j - 1]), final.model, (j,))
    slow = [deviance(test.at_bandwidth(j, SLOW), m, (j,)) - best for m in (search.base.model, final.model)]
    if slow[1] <= MOST * slow[0]:
        return search
    before, after = (remainder(s.data, test, s.model, j) for s in (search.base, final))
    if after.size**2 <= MOST * before.size**2:
        return search
    if after.state_share < STATE and found_again(test, search):
        return search
    return JointSearch(j, search.base, tried=search.tried, discarded=True)


def found_again(test: Data, search: JointSearch) -> bool:
    """Whether a refit to the held-out recordings gives each new term the size that it has."""
    j, final = search.joint, search.final
    data = test.at_bandwidth(j, final.data.bandwidth[j - 1])
    again = fit(data, final.model, final.fit.handles, joints=(j,), iterations=8, tolerance=1e-3, jobs=1).model
    for term in new_terms(search.base.model, final.model, j):
        other = counterpart(again.at(j), term)
        if any(abs(other.value(n) - term.value(n)) > SAME * abs(term.value(n)) for n in sizes(term.effect)):
            return False
    return True


def _error_left(test: Data, search: JointSearch) -> float:
    """Share of the energy of the held-out position error beyond the noise that is left."""
    floor = noise_floor(test, search.joint) ** 2
    before, after = (
        rms(window_error(test, m, search.joint)) ** 2 - floor for m in (search.base.model, search.final.model)
    )
    return after / before if before > 0 else 1.0


def _series(search: JointSearch) -> frozenset[str]:
    """Effects with which the search has been drawing a curve: three terms of one kind, or three torques of position alone, are a series, not physics."""
    names = [t.effect for t in search.final.model.at(search.joint)]
    given = [t.effect for t in search.base.model.at(search.joint)]
    new = {n: names.count(n) - given.count(n) for n in set(names) if n != "coupling"}
    many = {n for n, count in new.items() if count >= 3}
    if sum(n for effect, n in new.items() if effect in OF_POSITION and n > 0) >= 3:
        many |= {effect for effect in OF_POSITION if new.get(effect, 0) > 0}
    if not many and sum(n for n in new.values() if n > 0) >= 4:
        many = {n for n, count in new.items() if count >= 2}
    return frozenset(many)


def uncurved(test: Data, search: JointSearch, n: int, jobs: int) -> JointSearch:
    """The search without a curve that it went on to draw, where what was found before closes nearly all of the held-out gap."""
    series = _series(search) if search.steps else frozenset()
    drawn = [k for k, step in enumerate(search.steps) if step.chosen.effect in series]
    if len(drawn) > 1 and not any(search.steps[k].alone for k in drawn[1:]):
        drawn = drawn[1:]  # the first is no part of the curve: the others did not pass by themselves
    if not drawn or drawn[0] == 0:
        return search
    shorter = JointSearch(search.joint, search.base, search.steps[: drawn[0]], search.steps[drawn[0]].before, tried=search.tried)
    if _error_left(test, shorter) > LARGE:
        return search
    shorter.best, shorter.dropped = simplify(shorter, n, jobs)
    return shorter


def _disturbance(search: JointSearch) -> tuple[tuple[float, float], ...]:
    """Time intervals (s) outside of which the model is complete: a torque in them alone must make a slow observer do."""
    j, final = search.joint, search.final
    spans: list[tuple[float, float]] = []
    extras, total, covered = [], 0.0, 0.0
    for rec in final.data.records:
        record = rec[j - 1]
        lacking = missing_torque(record, final.model)
        found = [s for s in intervals(lacking, most=12) if s[2] > 0.02]
        spans += [(a, b) for a, b, _ in found]
        keep = np.zeros(record.n, bool)
        for a, b, _ in found:
            keep |= (lacking.time >= a - 0.15) & (lacking.time <= b + 0.15)
        extras.append(np.ascontiguousarray(np.where(keep, lacking.torque, 0.0)))
        total += record.n
        covered += float(keep.sum())
    if not spans or covered / total > 0.35:
        return ()
    before = deviance(final.data, final.model, (j,))
    bandwidth = final.data.bandwidth[j - 1]
    gain = 0.0
    for slower in (bandwidth, bandwidth / 2, bandwidth / 4):
        data = final.data.at_bandwidth(j, slower)
        value = _deviance_with(data, final.model, j, extras)
        gain = max(gain, before - value)
    _, tuned = tune_bandwidth(final.data, final.model, (j,))
    return tuple(sorted(spans)) if gain > 100.0 + (before - tuned) else ()


def _deviance_with(data: Data, model: Model, joint: int, extras: list[np.ndarray]) -> float:  # type: ignore[type-arg]
    from zendsp.diagnosis.score import deviance_of

    parts = [
        run(rec[joint - 1], model, data.bandwidth[joint - 1], inner=data.inner, extra=extra).innovations
        for rec, extra in zip(data.records, extras, strict=True)
    ]
    return deviance_of(data, joint, np.concatenate(parts))
