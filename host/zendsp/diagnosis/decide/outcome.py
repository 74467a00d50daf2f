"""The outcome of a diagnosis: its verdict, where and when something is missing, and the errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.decide.result import Errors, FitTable, Left
from zendsp.diagnosis.measure.where import Missing, Region, Times, located
from zendsp.diagnosis.measure.windows import least_error, model_error, seconds_of
from zendsp.physics.calibration.fit import Data
from zendsp.physics.model import Model


def verdict_of(
    findings: Sequence[Finding], decisions: Sequence[Decision], stopped: bool
) -> Verdict:
    """The verdict; ``stopped``: it was interrupted, so that no model is called complete."""
    if findings:
        return Verdict.MISSING
    complete = not stopped and {d.kind for d in decisions} == {Verdict.COMPLETE}
    return Verdict.COMPLETE if complete else Verdict.UNEXPLAINED


def doubted(
    findings: Sequence[Finding], decisions: Sequence[Decision]
) -> tuple[tuple[str, int], ...]:
    """Effects that only the recordings of the fit show, where nothing else is left open."""
    if findings or any(d.kind != Verdict.COMPLETE and not d.doubted for d in decisions):
        return ()
    return tuple(law for d in decisions for law in d.doubted)


def of_other_loads(decisions: Sequence[Decision]) -> tuple[int, ...]:
    """The unexplained joints, where numbers of its own explain each recording of all of them."""
    left = [d for d in decisions if d.kind == Verdict.UNEXPLAINED]
    return tuple(d.joint for d in left) if all(d.loads for d in left) else ()


def left_at(decision: Decision) -> Left:
    """The torque that is unexplained at a joint, at most all of it."""
    after = decision.after
    share, low, high = (min(1.0, x) for x in (after.value, after.low, after.high))
    return Left(decision.joint, share, (low, high))


def where_and_when(
    lacking: Mapping[int, Sequence[Missing]],
    decisions: Sequence[Decision],
    findings: Sequence[Finding],
    verdict: Verdict,
    bodies: bool,
) -> tuple[tuple[Region, ...], Times, tuple[str, ...]]:
    """The regions of the state, the times and their recordings in which torque is missing. Of
    pushes only the times, also of those of a complete model. ``bodies``: some are claimed.
    """
    if verdict == Verdict.COMPLETE:
        pushes = [d.beside for d in decisions if d.beside is not None]
    else:
        pushes = [d.bursts for d in decisions if d.kind == Verdict.DISTURBANCE and d.bursts]
    told = {d.joint for d in decisions if d.bursts in pushes}
    elsewhere = {j: lacking[j] for j in _lacking(decisions, findings, verdict, bodies) - told}
    places, times, at = located(elsewhere)
    spans = tuple(span for push in pushes for span in push.intervals)
    names = tuple(name for push in pushes for name in push.recordings)
    return places, (*spans, *times), (*names, *at)


def _lacking(
    decisions: Sequence[Decision], findings: Sequence[Finding], verdict: Verdict, bodies: bool
) -> set[int]:
    """The joints at which something is missing; where a body is missing, all, as each may feel it.
    """
    if verdict == Verdict.COMPLETE:
        return set()
    if bodies:
        return {d.joint for d in decisions}
    lacking = {d.joint for d in decisions if d.kind != Verdict.COMPLETE}
    return lacking | {f.joint for f in findings if not f.is_elsewhere}


def errors_of(parts: Parts, models: tuple[Model, Model, Model]) -> list[Errors]:
    """The errors of the given, calibrated and improved model, once for each unit of position."""
    units: dict[str, tuple[int, ...]] = {}
    for joint in range(1, models[0].joints + 1):
        unit = models[0].position_unit(joint)
        units[unit] = (*units.get(unit, ()), joint)

    def table(data: Data, joints: tuple[int, ...]) -> FitTable:
        return FitTable(*(model_error(data, m, joints) for m in models))

    return [
        Errors(
            unit, joints, table(parts.fit, joints), table(parts.held, joints),
            table(parts.test, joints), least_error(parts.test, models[1], *joints),
            seconds_of(parts.test),
        )
        for unit, joints in units.items()
    ]  # fmt: skip
