"""The findings of a machine; where something pushes, or recordings have another load, once more in
the rest of the recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from zendsp.diagnosis.data.prepare import of_one_sensor, prepare
from zendsp.diagnosis.data.signals import Parts, Signals
from zendsp.diagnosis.data.split import cut_out
from zendsp.diagnosis.decide.assemble import assemble
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.other_load import other_load
from zendsp.diagnosis.decide.own_numbers import by_recording, may_be_zeroed_elsewhere
from zendsp.diagnosis.decide.pushes import unpushed
from zendsp.diagnosis.decide.thresholds import LAWFUL
from zendsp.diagnosis.explain.machine import Found, find_once, kept
from zendsp.diagnosis.explain.one_apart import (
    by_one_alone,
    split_alone,
    with_other_zeros,
    without,
    without_one,
)
from zendsp.diagnosis.explain.other_bodies import (
    Loaded,
    confirmed,
    may_be_loaded,
    other_bodies,
)
from zendsp.diagnosis.explain.taken_up import cut_where_taken
from zendsp.diagnosis.measure.bursts import everywhere
from zendsp.diagnosis.measure.discrepancy import beyond, discrepancy
from zendsp.diagnosis.measure.windows import noise_floor, rms, window_error
from zendsp.diagnosis.progress import Progress, Step
from zendsp.physics.calibration.fit import Data
from zendsp.physics.model import Model


def find(
    signals: Sequence[Sequence[Signals]], parts: Parts, given: Model, jobs: int, tell: Progress
) -> Found:
    """The findings; where something pushes, those in the rest of the recordings (``signals``: to
    fit to, to choose by, to test on).

    Raises
    ------
    Stopped
        After Ctrl-C, where something was found by then.
    """
    found = find_once(parts, given, jobs, tell)
    with kept(lambda: found):
        cut = signals
        if may_be_loaded(found, given):
            tell(Step.ASSEMBLING.says("whether a load is taken up or put down"))
            cut = cut_where_taken(signals, given, jobs)
        loads = other_bodies(found, cut, given, jobs, tell)
        other = _without_loads(found, loads, cut, given, jobs, tell)
        if other is None and (sure := [load for load in loads if load.is_sure]):
            other = _without_loads(found, sure, cut, given, jobs, tell)
        other = other or without_one(found, signals, given, jobs, tell)
        other = other or _without_pushes(found, signals, given, jobs, tell)
        return by_one_alone(other, signals, given, jobs, tell)


def _without_loads(
    found: Found,
    loads: Sequence[Loaded],
    signals: Sequence[Sequence[Signals]],
    given: Model,
    jobs: int,
    tell: Progress,
) -> Found | None:
    """The findings of the recordings without another load, and these loads. Where too few are left
    to diagnose, those of all recordings, in which nothing pushes. None where the loads, beside what
    is found in the rest, do not explain their recordings.
    """
    if not loads:
        return None
    names = tuple(name for load in loads for name in load.names)
    tell(Step.ASSEMBLING.says("once more, without the recordings of another load"))
    rest = without(signals, names, given)
    if rest is None:  # the load may have been taken up before all that is held out
        pieces = [s for s in signals[0] if s.whole == s.name and s.name not in names]
        longest = max(pieces, key=lambda s: len(s.time), default=None)
        rest = split_alone(longest, given) if longest is not None else None
    if rest is None:
        if not all(load.is_sure for load in loads):
            return None
        decisions = [unpushed(d) for d in found.decisions]
        decisions = [
            replace(d, loads=names) if d.kind == Verdict.UNEXPLAINED else d for d in decisions
        ]
        stated = tuple(load.finding(given) for load in loads)
        return replace(found, decisions=decisions, loads=stated)
    again = find_once(rest.parts, given, jobs, tell)
    again = _without_pushes(again, rest.signals, given, jobs, tell)
    sure = confirmed(loads, again, signals, jobs)
    return replace(again, loads=tuple(load.finding(given) for load in sure)) if sure else None


def _without_pushes(
    found: Found, signals: Sequence[Sequence[Signals]], given: Model, jobs: int, tell: Progress
) -> Found:
    """The findings; where something pushes, those in the rest of the recordings."""
    pushes = _pushes(found.decisions)
    if not pushes:
        return _loaded(found, given, jobs)
    # pieces of a slow recording alone say too little of the noise that all have
    alike = of_one_sensor(signals)
    fit, choose, test = (cut_out(part, pushes) for part in alike)
    if not fit or not (choose or test):  # a calibration bent by a push lacks something everywhere
        largest = _pushes(found.decisions, largest=True)
        fit, choose, test = (cut_out(part, largest) for part in alike)
    # pushes beside a missing friction are certain once the friction is known without them
    alone = [d if d.kind == Verdict.DISTURBANCE else unpushed(d) for d in found.decisions]
    if not (choose or test):
        return _loaded(replace(found, decisions=alone), given, jobs)
    untouched = prepare(test or choose, given, 64.0)
    chosen = untouched
    if choose and test and signals[1] is not signals[2]:
        chosen = prepare(choose, given, 64.0)
    calibrated = found.whole.calibrated
    if fit:
        tell(Step.ASSEMBLING.says("once more, without what was pushed"))
        rest = Parts(prepare(fit, given, 64.0), chosen, untouched)
        again = find_once(rest, given, jobs, tell)
        zeroed = _zeroed_elsewhere(found, again, jobs)
        if zeroed is not None:
            return zeroed
        beside = _beside_pushes(found, again)
        if not _misled(beside, calibrated, untouched):
            return beside
    found = replace(found, decisions=alone)
    if not _misled(found, calibrated, untouched):
        return _loaded(found, given, jobs)
    # something permanent was taken for a push
    decisions = [unpushed(d) for d in found.decisions]
    whole = assemble(found.parts, found.beneath, decisions, jobs)
    return replace(found, decisions=decisions, whole=replace(whole, calibrated=calibrated))


def _loaded(found: Found, given: Model, jobs: int) -> Found:
    """The findings with the load that only the held-out recordings have."""
    (first, *_), whole = found.decisions, found.whole
    other = other_load(found.parts, given, first, jobs) if first.loads else None
    if other is None:
        return found
    mechanism = other.decision.final.model.mechanism
    whole = replace(whole, improved=replace(whole.improved, mechanism=mechanism))
    return replace(found, loads=(other.finding,), decisions=[other.decision], whole=whole)


def _misled(found: Found, calibrated: Model, rest: Data) -> bool:
    """Whether a pushed joint is predicted worse outside the pushes, by more than the sensor's error
    (``rest``: of the untouched recordings).
    """
    for d in found.decisions:
        if d.bursts is not None:
            with_it, without = (
                rms(window_error(rest, m, d.joint)) for m in (found.whole.improved, calibrated)
            )
            if beyond(with_it, without) > noise_floor(rest, d.joint):
                return True
    return False


def _pushes(
    decisions: Sequence[Decision], largest: bool = False
) -> list[tuple[str, float, float]]:
    """Recording, begin and end (s) of each push, or of the ``largest`` at each joint."""
    each = [d.bursts.largest() if largest else d.bursts for d in decisions if d.bursts is not None]
    return [
        (name, *span)
        for pushes in each
        for name, span in zip(pushes.recordings, pushes.intervals, strict=True)
    ]


def _beside_pushes(pushed: Found, found: Found) -> Found:
    """The findings without the pushes, and beside them the pushes in all recordings."""
    every = (pushed.parts.fit, pushed.parts.held)
    decisions = []
    for first, again in zip(pushed.decisions, found.decisions, strict=True):
        if first.bursts is not None and not _explained(first, again, every):
            kind = Verdict.DISTURBANCE if again.kind == Verdict.COMPLETE else again.kind
            beside = everywhere(first.bursts, every, again.final.model, again.joint)
            bursts = beside if beside.intervals else first.bursts
            again = replace(again, kind=kind, bursts=bursts)
        decisions.append(again)
    return replace(found, decisions=decisions, parts=pushed.parts)


def _zeroed_elsewhere(pushed: Found, found: Found, jobs: int) -> Found | None:
    """The findings without the pushes, where these stand in recordings with another zero of the
    position: the laws found without them, shifted, explain those, and nothing has pushed.
    """
    (first, *_), (again, *_) = pushed.decisions, found.decisions
    if first.bursts is None or not may_be_zeroed_elsewhere(again.final.model):
        return None
    every = by_recording(pushed.parts, again.final.model, again.joint)
    return with_other_zeros(found, {n: every[n] for n in set(first.bursts.recordings)}, jobs)


def _explained(pushed: Decision, again: Decision, every: Sequence[Data]) -> bool:
    """Whether what was found without the pushes leaves nothing of them: a friction that drifts in
    the first seconds seems to push, beside a drive that is late, and is found in the rest.
    """
    assert pushed.bursts is not None
    model, joint = again.final.model, again.joint
    left = max(discrepancy(part, model, joint).value for part in every)
    found = again.kind is Verdict.MISSING and beyond(left, again.known.all) < LAWFUL
    return found and not everywhere(pushed.bursts, every, model, joint).intervals
