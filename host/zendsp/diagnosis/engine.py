"""The diagnosis: read, check, calibrate, search each joint, decide on held-out recordings, name
findings, and report what remains.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from threadpoolctl import threadpool_limits

from zendsp.diagnosis.data.checks import check_excitation, check_given, check_motion
from zendsp.diagnosis.data.columns import cutting
from zendsp.diagnosis.data.inertia import with_its_scale
from zendsp.diagnosis.data.inputs import Given, Recorded, model_of, sources_of
from zendsp.diagnosis.data.prepare import at_their_poses, of_one_sensor, prepare
from zendsp.diagnosis.data.reading import Source
from zendsp.diagnosis.data.signals import Parts, Signals
from zendsp.diagnosis.data.split import halves, read_divided
from zendsp.diagnosis.data.used import used_columns
from zendsp.diagnosis.decide.claims import Decision, unclaimed
from zendsp.diagnosis.decide.clocks import apart_in_time
from zendsp.diagnosis.decide.contract import Rejected, Verdict, listed
from zendsp.diagnosis.decide.decide_bodies import rejected_bodies
from zendsp.diagnosis.decide.detectable import blind, detectable
from zendsp.diagnosis.decide.detectable_bodies import detectable_bodies
from zendsp.diagnosis.decide.detectable_push import detectable_pushes
from zendsp.diagnosis.decide.findings import Estimate, Finding, number
from zendsp.diagnosis.decide.moved import moved
from zendsp.diagnosis.decide.naming import name_findings
from zendsp.diagnosis.decide.notes import apart, bent, left_over, notes_of, off_sensor, repeated
from zendsp.diagnosis.decide.other_load import of_load
from zendsp.diagnosis.decide.outcome import (
    doubted,
    errors_of,
    left_at,
    of_other_loads,
    verdict_of,
    where_and_when,
)
from zendsp.diagnosis.decide.propose import experiment_of, propose
from zendsp.diagnosis.decide.pushes import unpushed
from zendsp.diagnosis.decide.remember import as_reported, remembered
from zendsp.diagnosis.decide.result import (
    Detectable,
    Diagnosis,
    Next,
    Workings,
    numbers_off,
)
from zendsp.diagnosis.decide.thresholds import FINEST
from zendsp.diagnosis.decide.zeros import check_zeros
from zendsp.diagnosis.explain.machine import Found, Stopped
from zendsp.diagnosis.explain.undisturbed import find
from zendsp.diagnosis.measure.discrepancy import beyond
from zendsp.diagnosis.measure.significance import INTEGRATION_ERROR
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.report.files import left_out
from zendsp.diagnosis.report.missed import missed
from zendsp.diagnosis.report.sides import clearest, sides
from zendsp.diagnosis.search.body_hypotheses import LIMITS
from zendsp.diagnosis.search.joint_zeros import OtherZero, with_zero
from zendsp.diagnosis.transmission.detectable import detectable_transmissions
from zendsp.diagnosis.transmission.measured import without_guesses
from zendsp.diagnosis.transmission.one_sensor import said, unseen
from zendsp.diagnosis.transmission.torque_sensor import on_both_sides, sided
from zendsp.errors import RecordingError
from zendsp.physics.calibration.fit import Data
from zendsp.physics.model import CALLED, Model
from zendsp.physics.term_numbers import file_model, kernel_model
from zendsp.prompt import shows_progress

# s times joints: 200 s of one joint took 19 s of processor time, 1000 s 45 s, 10 000 s over 280 s
LONG_S = 2000.0
ENDED = (
    "The search was interrupted: this is what was found until then; other explanations, what could"
    " have been seen and the next recording were not asked for"
)
ENDED_LAST = (
    "It was interrupted when all joints had been searched; what could have been seen and"
    " the next recording were not asked for"
)


@shows_progress
def diagnose(
    recordings: Recorded | Sequence[Recorded],
    model: Given,
    heldout: Recorded | Sequence[Recorded] | None = None,
    *,
    seed: int = 0,
    jobs: int = 2,
    progress: Progress | None = None,
    so_far: bool = False,
) -> Diagnosis:
    """Find the physics that a model leaves out of real recordings.

    Parameters
    ----------
    recordings : path, Recording, Table, DataFrame, or a sequence of them
        To calibrate and to search on; several are fitted jointly. SI units, or units in the heads
        (``angle [deg]``); columns as the model names them, without units.
    model : Model, path or dict
        The given model (docs/diagnosis.md).
    heldout : like ``recordings``, optional
        To judge on; where none is given, the last third of each is held out (of its motion, where
        it comes to rest).
    seed : int
        Seed of everything random (the proposed reference).
    jobs : int
        Threads; processes where there are several joints.
    progress : callable, optional
        Receives a sentence at each stage.
    so_far : bool
        After Ctrl-C return what was found at the finished joints, if any; also when only steps
        after the search were left. A second Ctrl-C ends that too. For a simulator that is compared
        by its output nothing is kept.

    Returns
    -------
    Diagnosis

    Raises
    ------
    RecordingError, ModelError
        Unusable input: which file, which column or key, what was expected.
    KeyboardInterrupt
        After Ctrl-C.

    Examples
    --------
    >>> import zendsp
    >>> d = zendsp.diagnose("run.csv", "bench.toml")  # doctest: +SKIP
    >>> d.verdict, [f.effect for f in d.findings]     # doctest: +SKIP
    ('missing', ['coulomb'])
    """
    # matrices are small and many run at a time: more threads of the linear algebra only wait for
    # each other
    tell = progress or (lambda _text: None)
    with threadpool_limits(limits=1):
        given, asked = model_of(model)
        sources = sources_of(recordings), sources_of(heldout)
        if given.kind in CALLED:
            from zendsp.diagnosis.external.roads import diagnose_called

            once = partial(_diagnose, seed=seed, jobs=jobs, tell=tell, so_far=so_far)
            d = diagnose_called(sources, given, jobs, tell, so_far, once)
        else:
            d = _diagnose(sources, given, seed, jobs, tell, so_far)
    return replace(d, notes=(*asked, *d.notes))


def _diagnose(
    sources: tuple[list[Source], list[Source]],
    given: Model,
    seed: int,
    jobs: int,
    tell: Progress,
    so_far: bool,
    homings: int = 0,
) -> Diagnosis:
    """The diagnosis; where joints have other zeros than the model's, made with these. ``homings``:
    how often that was done by now.
    """
    begin = time.perf_counter()
    try:
        d = _with_zeros_given(sources, given, seed, jobs, tell, so_far)
        if isinstance(d.workings, Workings):
            d.workings.forget()
        return d
    except OtherZero as other:
        if homings == given.joints:
            raise RecordingError(
                f"{listed(other.angles)}: another zero explains the recordings again after"
                f" {homings} estimates of it: check [sensor] offset and the columns of the model"
            ) from None
        homed, angles = _homed(sources, given, other, jobs, tell)
        seen_at = other.bandwidth
    d = _diagnose(sources, homed, seed, jobs, tell, so_far, homings + 1)
    for _ in range(LIMITS.rounds):  # what was missing had bent the estimate of the zeros
        if not d.findings or d.zeros or d.stopped:
            break
        beside = replace(d.improved, sensor=given.sensor)
        zero = OtherZero({joint: angle for joint, (angle, _) in angles.items()}, seen_at)
        again, now = _homed(sources, beside, zero, jobs, tell)
        moved_by = {j: abs(angle - angles[j][0]) for j, (angle, _) in now.items()}
        if all(by < LIMITS.moves * now[j][1] for j, by in moved_by.items()):
            break
        homed = replace(given, sensor=again.sensor)
        # it may go on moving by as much
        angles = {j: (angle, math.hypot(std, moved_by[j])) for j, (angle, std) in now.items()}
        d = _diagnose(sources, homed, seed, jobs, tell, so_far, homings + 1)
    zeros = (_of_zeros(homed, angles), *d.zeros)
    return replace(d, zeros=zeros, seconds=time.perf_counter() - begin)


def _warn_of_length(signals: Sequence[Signals]) -> None:
    """Say before the search that it will take long, and what is sooner answered."""
    seconds = sum(len(s.time) * s.sample_time for s in signals)
    if seconds * signals[0].position.shape[1] > LONG_S:
        name = signals[0].whole or signals[0].name
        warnings.warn(
            f"{seconds:.0f} s are to be searched, which takes many minutes. A part is sooner"
            f" answered: {cutting(name, '--to', '300', '-o', 'part.csv')}",
            stacklevel=2,
        )


def _with_zeros_given(
    sources: tuple[list[Source], list[Source]],
    given_file: Model,
    seed: int,
    jobs: int,
    tell: Progress,
    so_far: bool,
) -> Diagnosis:
    begin = time.perf_counter()
    given = kernel_model(given_file)
    signals, parts, notes = _ready(*sources, given, tell)
    given, scale = with_its_scale(at_their_poses(given, parts.fit), parts.undriven)
    found, stopped = _found(signals, parts, given, jobs, tell, so_far)
    found, clocks = _by_one_clock(found)
    found, findings, refinements, rejected = _name(found, given)
    parts, whole, looked = found.parts, found.whole, _Looked(decisions := found.decisions)
    try:
        if not stopped:
            looked = _look_on(found, given, findings, signals[0], seed, jobs, tell)
    except KeyboardInterrupt:
        if not so_far:
            raise
        stopped = [ENDED_LAST]
    verdict = verdict_of(findings, decisions, bool(stopped))
    better = whole.improved if findings else whole.calibrated
    improved = remembered(better, given, decisions, findings)
    of_held = any(not f.is_elsewhere for f in found.loads)
    shown_on = parts.test if of_held else parts.fit  # where the missing torque can be seen
    joints = range(1, given.joints + 1)
    seen_at = {j: clearest(shown_on, sides(findings, given, whole, j), j) for j in joints}
    lacking = {j: before for j, (_, before, _) in seen_at.items()}
    places, times, at = where_and_when(lacking, decisions, findings, verdict, bool(found.claims))
    alone = unseen(parts, found.bodies.model, decisions := looked.decisions)
    notes = [*stopped, *notes, *scale, *(note for m in found.measured for note in m.notes)]
    seen = (*looked.seen, *(d for m in found.measured for d in m.detectable), *alone)
    own, *others = errors_of(parts, (given, whole.calibrated, improved))
    notes += [*said(alone), *notes_of(decisions, given), *repeated(decisions, parts), *clocks]
    off = numbers_off(verdict, own.test, left := tuple(left_at(d) for d in decisions))
    notes += moved(given, whole.calibrated if of_held else better, off=off)
    if not findings and all(d.final is d.base for d in decisions):  # else it is told by then
        notes += [note for errors in (own, *others) for note in bent(errors)]
    notes += [*of_load(found.loads), *_of_sensors(found, findings, improved, verdict)]
    notes += [n for e in (own, *others) for n in apart(e, verdict)]
    return Diagnosis(
        verdict=verdict,
        findings=findings, refinements=refinements,
        regions=places, times=times, times_of=at,
        unit=own.unit, estimation=own.estimation, heldout=own.heldout, test=own.test,
        noise_floor=own.noise_floor, window=own.window,
        others=tuple(others), discrepancy=left,
        detectable=tuple(x for x in seen if x.is_shown),
        undetectable=missed(seen, (*findings, *refinements), decisions),
        rejected=rejected,
        next_recording=looked.proposal,
        seconds=time.perf_counter() - begin,
        notes=(*notes, *left_out(file_model(improved))),
        given=given_file,
        calibrated=file_model(whole.calibrated),
        improved=as_reported(file_model(improved), (*findings, *refinements)),
        unexplained=left_over(decisions, given, parts.fit),
        missing=lacking,
        remaining={j: after for j, (_, _, after) in seen_at.items()},
        workings=Workings(found.searches, decisions, whole, shown_on, parts.test),
        stopped=bool(stopped),
        doubted=doubted(findings, decisions),
        loads=of_other_loads(decisions),
        undriven=parts.undriven,
    )


def _homed(
    sources: tuple[list[Source], list[Source]],
    given: Model,
    other: OtherZero,
    jobs: int,
    tell: Progress,
) -> tuple[Model, dict[int, tuple[float, float]]]:
    """The given model with other zeros of joints; by joint the angle and its std, rad."""

    def recorded_with(model: Model) -> Data:
        return _ready(*sources, kernel_model(model), tell)[1].fit

    return with_zero(given, other, recorded_with, jobs)


def _of_zeros(homed: Model, angles: Mapping[int, tuple[float, float]]) -> str:
    # four of a simulated arm were 0.5 to 0.7 mrad off, up to four times the scatter of their blocks
    said = (
        f"joint {joint} is {number(Estimate(angle, math.hypot(std, INTEGRATION_ERROR), 'rad'))}"
        " farther along than recorded"
        for joint, (angle, std) in angles.items()
    )
    offsets = ", ".join(f"{x:.5g}" for x in homed.sensor.offset)
    return (
        f"Another zero than the model's: {', '.join(said)}. All here is with [sensor] offset ="
        f" [{offsets}]."
    )


def _found(
    signals: Sequence[Sequence[Signals]],
    parts: Parts,
    given: Model,
    jobs: int,
    tell: Progress,
    so_far: bool,
) -> tuple[Found, list[str]]:
    """What is found, and a note where an interrupt ended the search (``so_far``: keep it)."""
    try:
        return find(signals, parts, given, jobs, tell), []
    except Stopped as stop:
        if not so_far:
            raise
        return stop.found, [ENDED]


@dataclass(frozen=True)
class _Looked:
    """What follows the search: the detectable sizes, and the next recording."""

    decisions: list[Decision]
    seen: tuple[Detectable, ...] = ()
    proposal: Next | None = None


def _look_on(
    found: Found,
    given: Model,
    findings: Sequence[Finding],
    fit: Sequence[Signals],
    seed: int,
    jobs: int,
    tell: Progress,
) -> _Looked:
    tell(Step.LOOKING_ON.says("asking what could have been seen"))
    seen = (
        *detectable(found.parts, given, found.decisions, jobs),
        *detectable_transmissions(found.parts, given, found.decisions, jobs),
        *detectable_pushes(found.parts, given, found.decisions),
    )
    bodies = detectable_bodies(
        found.parts, found.whole.improved, found.decisions, found.claims, jobs
    )
    decisions = blind(found.parts, given, found.decisions, seen)
    tell(Step.LOOKING_ON.says("proposing the next recording"))
    if given.called is not None:
        return _Looked(decisions, seen, experiment_of(findings))
    free = found.parts.undriven
    proposal = propose(fit, given, found.searches, findings, decisions, seed, free)
    return _Looked(decisions, (*seen, *bodies), proposal)


def _by_one_clock(found: Found) -> tuple[Found, list[str]]:
    """What was found, and notes on recordings whose columns are shifted in time against the others.
    A torque missing in such a recording alone is no push.
    """
    loads = {(d.joint, name) for d in found.decisions for name in d.loads}
    said = apart_in_time(found.parts, found.whole.improved, loads)
    late = {joint for joint, _ in said}
    decisions = [
        unpushed(d) if d.kind == Verdict.DISTURBANCE and d.joint in late else d
        for d in found.decisions
    ]
    return replace(found, decisions=decisions), [sentence for _, sentence in said]


def _of_sensors(
    found: Found, findings: Sequence[Finding], improved: Model, verdict: Verdict
) -> list[str]:
    """Notes on what the sensors beside the position show, and on what the position's one does."""
    sides = on_both_sides(findings, found.parts, found.bodies.model)
    return [*sides, *off_sensor(found.parts.test, improved, verdict)]


def _unnamed(
    decision: Decision, findings: Sequence[Finding], refinements: Sequence[Finding]
) -> Decision:
    """The decision of a joint whose claims became refinements, as their numbers may be nothing."""
    refines = {r.effect for r in refinements if r.joint == decision.joint}
    claimed = {c.effect for c in decision.claims}
    if not claimed or not claimed <= refines or any(f.joint == decision.joint for f in findings):
        return decision
    small = beyond(decision.before.value, decision.known.all) < FINEST
    out = unclaimed(decision, "its number may be nothing")
    return replace(out, kind=Verdict.COMPLETE) if small else out


def _ready(
    recordings: Sequence[Source],
    heldout: Sequence[Source],
    given: Model,
    tell: Progress,
) -> tuple[tuple[list[Signals], ...], Parts, list[str]]:
    """The signals to fit to, to choose by and to test on; all of them prepared for the kernel; and
    notes on them.
    """
    tell(Step.READING.says("reading the recordings"))

    def told(file: str | Path, share: float) -> None:
        tell(Step.READING.says(f"reading {Path(file).name}: {share:.0%}"))

    fit_signals, held, notes = read_divided(recordings, heldout, given, told)
    _warn_of_length([*fit_signals, *held])
    choose_signals, test_signals, how = halves(held)
    tell(Step.READING.says("smoothing the motion"))
    read = (fit_signals, choose_signals, test_signals)
    fit, choose, test = (prepare(part, given, 64.0) for part in of_one_sensor(read))
    parts = Parts(fit, choose, choose if choose_signals is test_signals else test)
    names = [s.name for s in (*fit_signals, *choose_signals, *test_signals)]
    everything = Data((*fit.records, *choose.records, *test.records), fit.bandwidth)
    if given.called is None:
        stated = {s.whole or s.name for s in (*fit_signals, *held) if s.unit_stated}
        check_motion(everything, given, names, stated)
        check_zeros(everything, given)
    used = used_columns([*fit_signals, *held], given)
    return read, parts, [
        *notes, *used, *how, *check_given(everything, given), *check_excitation(fit)
    ]  # fmt: skip


def _name(
    found: Found, given: Model
) -> tuple[Found, tuple[Finding, ...], tuple[Finding, ...], tuple[Rejected, ...]]:
    """What was found, without claims that may be nothing; and the findings, refinements and
    rejected hypotheses of joints, bodies and transmissions.
    """
    findings, refinements, rejected = name_findings(
        found.parts.test, given, found.decisions, found.whole, found.claims
    )
    rejected = (*rejected_bodies(found.bodies, found.claims), *rejected)
    findings, guessed = without_guesses(findings, found.measured)
    refinements = (*refinements, *guessed)
    if found.loads:
        # at one joint a load of all held-out recordings holds all that differs there from the given
        # numbers
        beside = given.joints > 1 or all(f.is_elsewhere for f in found.loads)
        findings = (*found.loads, *(findings if beside else ()))
    findings += found.fine
    findings += tuple(f for m in found.measured for f in m.stated(found.whole.improved))
    findings = sided(findings, found.parts, found.bodies.model)
    decisions = [_unnamed(d, findings, refinements) for d in found.decisions]
    return replace(found, decisions=decisions), findings, refinements, rejected
