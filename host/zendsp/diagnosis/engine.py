"""The diagnosis: read, check, calibrate, search each joint, judge on held-out recordings, name, and
say what remains.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from zendsp.diagnosis.data.checks import check_excitation, check_motion
from zendsp.diagnosis.data.prepare import one_sensor, prepare
from zendsp.diagnosis.data.reading import Source
from zendsp.diagnosis.data.signals import Parts, Signals
from zendsp.diagnosis.data.split import cut_out, halves, read_parts
from zendsp.diagnosis.decide.absorbed import moved
from zendsp.diagnosis.decide.across import across_joints, timing
from zendsp.diagnosis.decide.assemble import Assembled, calibrated_machine
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.clocks import apart_in_time
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.decide_bodies import (
    BodyClaim,
    beside_bodies,
    decide_bodies,
    rejected_bodies,
    settled,
)
from zendsp.diagnosis.decide.detectable import detectable
from zendsp.diagnosis.decide.fast_ripple import FineRipple, fine_ripples, fixed
from zendsp.diagnosis.decide.naming import name_findings
from zendsp.diagnosis.decide.notes import bent, left_over, notes_of
from zendsp.diagnosis.decide.propose import propose
from zendsp.diagnosis.decide.remember import remembered
from zendsp.diagnosis.decide.result import Diagnosis, Finding, FitTable, Left, Rejected, Workings
from zendsp.diagnosis.joints import (
    Progress,
    decided_again,
    explain,
    plainer,
    with_bodies,
    with_their_links,
)
from zendsp.diagnosis.measure.bursts import everywhere
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.measure.where import intervals, mismatch, regions
from zendsp.diagnosis.measure.windows import model_error, noise_floor
from zendsp.diagnosis.report.files import left_out
from zendsp.diagnosis.search.bodies import BodySearch, find_bodies
from zendsp.diagnosis.search.hypothesis import JointSearch
from zendsp.diagnosis.transmission.links import divided, with_links
from zendsp.diagnosis.transmission.measured import Measured, measured_transmissions
from zendsp.diagnosis.transmission.one_sensor import by_one_sensor, said, shown
from zendsp.diagnosis.transmission.torque_sensor import sided
from zendsp.physics.calibration.fit import Data
from zendsp.physics.files.model_file import load_model, parse_model
from zendsp.physics.model import CALLED, Model
from zendsp.physics.term_numbers import file_model, kernel_model
from zendsp.prompt import shows_progress
from zendsp.recording import Recording, Table


@shows_progress
def diagnose(
    recordings: Source | Sequence[Source],
    model: Model | str | Path | dict[str, Any],
    heldout: Source | Sequence[Source] | None = None,
    *,
    seed: int = 0,
    jobs: int = 2,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find the physics that a model leaves out of real recordings.

    Parameters
    ----------
    recordings : path, Recording, Table, or a sequence of them
        To calibrate and to search on; several are fitted jointly. SI units, columns as the model
        names them.
    model : Model, path or dict
        The given model (docs/diagnosis.md).
    heldout : like ``recordings``, optional
        To judge on; where none is given, the last third of each is held out (of its motion, where
        it comes to rest).
    seed : int
        Of what is drawn at random (the proposed reference).
    jobs : int
        Threads.
    progress : callable, optional
        Receives a sentence at each stage.

    Returns
    -------
    Diagnosis

    Raises
    ------
    RecordingError, ModelError
        Unusable input: which file, which column or key, what was expected.

    Examples
    --------
    >>> import zendsp
    >>> d = zendsp.diagnose("run.csv", "bench.toml")  # doctest: +SKIP
    >>> d.verdict, [f.effect for f in d.findings]     # doctest: +SKIP
    ('missing', ['coulomb'])
    """
    # matrices are small and many run at a time: more threads of the linear algebra only wait for
    # each other
    with threadpool_limits(limits=1):
        return _diagnose(recordings, model, heldout, seed, jobs, progress or (lambda _text: None))


def _diagnose(
    recordings: Source | Sequence[Source],
    model: Model | str | Path | dict[str, Any],
    heldout: Source | Sequence[Source] | None,
    seed: int,
    jobs: int,
    tell: Progress,
) -> Diagnosis:
    begin = time.perf_counter()
    given_file = _as_model(model)
    given = kernel_model(given_file)
    if given.kind in CALLED:
        from zendsp.diagnosis.external.blackbox import diagnose_simulator

        return diagnose_simulator(
            _sources(recordings), given, _sources(heldout), jobs=jobs, progress=tell
        )
    signals, parts, notes = _ready(recordings, heldout, given, tell)
    found = _found(signals, parts, given, jobs, tell)
    parts, decisions, whole = found.parts, found.decisions, found.whole
    notes += [note for m in found.measured for note in m.notes]
    findings, refinements, rejected = _name(found, given)
    kinds = {d.kind for d in decisions}
    verdict: Verdict = "complete" if kinds == {"complete"} else "unexplained"
    if findings:
        verdict = "missing"
    improved = remembered(whole.improved if findings else whole.calibrated, given, decisions)
    joints = range(1, given.joints + 1)
    lacking = {j: mismatch(parts.fit, whole.calibrated, j) for j in joints}
    places, times = _where({j: lacking[j] for j in _lacking(found, findings, joints)})
    tell("proposing the next recording")
    proposal = propose(signals[0], given, found.searches, findings, decisions, seed)
    tell("asking what could have been seen")
    seen = detectable(parts, given, decisions, jobs)
    alone = by_one_sensor(parts, found.bodies.model, decisions)
    seen += (*(d for m in found.measured for d in m.detectable), *alone)
    test = _table(parts.test, given, whole.calibrated, improved)
    notes += [*said(alone), *notes_of(decisions, given)]
    notes += apart_in_time(parts, improved)
    notes += moved(given, found.whole.improved if findings else found.whole.calibrated)
    if not findings:
        notes += bent(test, noise_floor(parts.test))
    return Diagnosis(
        verdict=verdict,
        findings=findings,
        refinements=refinements,
        regions=places if verdict != "complete" else (),
        times=times if verdict != "complete" else (),
        unit="m" if given.joint_kind(1) == "linear" else "rad",
        estimation=_table(parts.fit, given, whole.calibrated, improved),
        heldout=_table(parts.held, given, whole.calibrated, improved),
        test=test,
        noise_floor=noise_floor(parts.test),
        discrepancy=tuple(_left(d) for d in decisions),
        detectable=seen,
        rejected=rejected,
        next_recording=proposal,
        seconds=time.perf_counter() - begin,
        notes=(*notes, *left_out(file_model(improved))),
        given=given_file,
        calibrated=file_model(whole.calibrated),
        improved=file_model(improved),
        unexplained=left_over(decisions, given, parts.fit),
        missing=lacking,
        remaining={j: mismatch(parts.fit, improved, j) for j in joints},
        workings=Workings(found.searches, decisions, whole, parts.fit, parts.test),
    )


def _left(decision: Decision) -> Left:
    after = decision.after
    share, low, high = (min(1.0, x) for x in (after.value, after.low, after.high))
    return Left(decision.joint, share, (low, high))


def _ready(
    recordings: Source | Sequence[Source],
    heldout: Source | Sequence[Source] | None,
    given: Model,
    tell: Progress,
) -> tuple[tuple[list[Signals], ...], Parts, list[str]]:
    """The signals to fit to, to choose by and to test on; all of them ready for the kernel, and
    what is wrong with them.
    """
    tell("reading the recordings")
    fit_signals, choose_signals, test_signals, notes = _read(recordings, heldout, given)
    tell("smoothing the motion")
    of_one = iter(one_sensor([*fit_signals, *choose_signals, *test_signals]))
    fit, choose, test = (
        prepare(list(islice(of_one, len(s))), given, 64.0)
        for s in (fit_signals, choose_signals, test_signals)
    )
    parts = Parts(fit, choose, choose if choose_signals is test_signals else test)
    names = [s.name for s in (*fit_signals, *choose_signals, *test_signals)]
    everything = Data((*fit.records, *choose.records, *test.records), fit.bandwidth)
    notes += check_motion(everything, given, names)
    notes += check_excitation(fit)
    return (fit_signals, choose_signals, test_signals), parts, notes


@dataclass(frozen=True)
class _Found:
    """What is known of a machine before it is put into words: bodies, transmissions, joints.

    ``bare`` are the recordings without what inverse dynamics says of inertias, ``beneath`` is the
    given model with the bodies and transmissions that the joints were searched with.
    """

    parts: Parts
    bare: Parts
    beneath: Model
    bodies: BodySearch
    measured: list[Measured]
    searches: list[JointSearch]
    decisions: list[Decision]
    whole: Assembled
    claims: tuple[BodyClaim, ...]
    fine: tuple[FineRipple, ...] = ()


def _find(measured_motion: Parts, given: Model, jobs: int, tell: Progress) -> _Found:
    """Bodies first, then measured transmissions, then every joint; again where one changes what
    the others have to explain, and without bodies that make untouched recordings worse.
    """
    tell("calibrating the given model")
    parts = with_links(measured_motion, given, divided(given))
    bodies = find_bodies(parts.fit, parts.choose, given, jobs, tell)
    found = _beneath(bodies, measured_motion, parts, given, jobs, tell)
    late = timing(found.decisions)
    if late and not found.claims:  # torque that comes at another time hides a body
        bodies = find_bodies(parts.fit, parts.choose, given, jobs, tell, beside=late)
        if bodies.found:
            again = _beneath(bodies, measured_motion, parts, given, jobs, tell)
            found = again if again.claims else found
    finished = _finished(found, given, jobs, tell)
    test, whole = finished.parts.test, finished.whole
    if finished.claims and model_error(test, whole.improved) > model_error(test, whole.calibrated):
        none = replace(bodies, model=given, found=())
        found = _beneath(none, measured_motion, parts, given, jobs, tell)
        finished = _finished(found, given, jobs, tell)
    return finished


def _beneath(
    bodies: BodySearch,
    measured_motion: Parts,
    parts: Parts,
    given: Model,
    jobs: int,
    tell: Progress,
) -> _Found:
    """What is found with some bodies, or with those of them that can be claimed beside it."""
    measured = measured_transmissions(parts, bodies.model, jobs)
    known = tuple(t for m in measured for t in m.terms)
    beneath, bare = bodies.model.with_terms((*bodies.model.terms, *known)), parts
    explained = explain(with_bodies(bare, beneath), given, beneath, jobs, tell)
    bare, explained = with_their_links(measured_motion, bare, given, beneath, explained, jobs, tell)
    parts, decisions = with_bodies(bare, beneath), explained[1]
    claims = decide_bodies(parts, bodies, decisions, jobs)
    if len(claims) < len(bodies.found):  # what is no body has to be explained at the joints
        beneath = given.with_terms((*given.terms, *(c.found.term for c in claims), *known))
        parts = with_bodies(bare, beneath)
        explained = explain(parts, given, beneath, jobs, tell)
    elif claims and any(c.mechanism == "inertia" for d in decisions for c in d.claims):
        # a body that the joints have to correct may be none: the plainer explanation stands
        plain = given.with_terms((*given.terms, *known))
        other = explain(with_bodies(bare, plain), given, plain, jobs, tell)
        if plainer(bare.test, other, explained, len(claims)):
            claims, beneath, parts, explained = (), plain, with_bodies(bare, plain), other
    return _Found(parts, bare, beneath, bodies, measured, *explained, claims)


def _finished(found: _Found, given: Model, jobs: int, tell: Progress) -> _Found:
    """With what passes fast, and bodies and joints settled together."""
    parts, bare, beneath, claims = found.parts, found.bare, found.beneath, found.claims
    searches, decisions, whole = found.searches, found.decisions, found.whole
    tell("looking for what passes fast")
    fine = [
        ripple
        for search, decision in zip(searches, decisions, strict=True)
        if decision.kind in ("complete", "missing")
        for ripple in fine_ripples(
            parts.fit, parts.choose, search, given.joint_kind(search.joint), jobs
        )
    ]
    # a ripple that the model lacks may be taken for other effects: decide again beside it
    if fine:
        beneath = beneath.with_terms((*beneath.terms, *(fixed(ripple.term) for ripple in fine)))
        rippled = {ripple.term.joint for ripple in fine}
        done = {
            s.joint: decided_again(parts, beneath, s, jobs, tell) if s.joint in rippled else (s, d)
            for s, d in zip(searches, decisions, strict=True)
        }
        searches, decisions, whole = explain(parts, given, beneath, jobs, tell, done)
    if claims:
        claims, improved = settled(parts, claims, whole.improved, jobs)
        bases = [
            calibrate_joint(bare.fit, given, joint, jobs) for joint in range(1, given.joints + 1)
        ]
        calibrated = calibrated_machine(bare.fit, given, bases, jobs)
        whole = replace(whole, improved=improved, calibrated=calibrated)
        decisions = beside_bodies(claims, decisions)
    return replace(
        found,
        searches=searches,
        decisions=shown(parts, found.bodies.model, across_joints(decisions)),
        whole=whole,
        claims=claims,
        fine=tuple(fine),
    )


def _found(
    signals: Sequence[Sequence[Signals]], parts: Parts, given: Model, jobs: int, tell: Progress
) -> _Found:
    """What is found; where something pushes, in the rest of the recordings (``signals``: to fit to,
    to choose by, to test on).
    """
    found = _find(parts, given, jobs, tell)
    pushes = _pushes(found.decisions)
    if not pushes:
        return found
    fit, choose, test = (cut_out(part, pushes) for part in signals)
    if not fit or not (choose or test):
        return found
    tell("once more, without what was pushed")
    left = (fit, choose or test, test or choose)
    data = [prepare(one_sensor(part), given, 64.0) for part in left]
    rest = Parts(data[0], data[1], data[2] if choose and test else data[1])
    return _beside_pushes(found, _find(rest, given, jobs, tell))


def _pushes(decisions: Sequence[Decision]) -> list[tuple[str, float, float]]:
    """Recording, begin and end (s) of each push."""
    return [
        (name, *span)
        for d in decisions
        if d.kind == "disturbance" and d.bursts is not None
        for name, span in zip(d.bursts.recordings, d.bursts.intervals, strict=True)
    ]


def _beside_pushes(pushed: _Found, found: _Found) -> _Found:
    """What was found without the pushes, and the pushes in all recordings, beside it."""
    every = (pushed.parts.fit, pushed.parts.held)
    decisions = []
    for first, again in zip(pushed.decisions, found.decisions, strict=True):
        if first.kind == "disturbance" and first.bursts is not None:
            kind = "disturbance" if again.kind == "complete" else again.kind
            beside = everywhere(first.bursts, every, again.final.model, again.joint)
            bursts = beside if beside.intervals else first.bursts
            again = replace(again, kind=kind, bursts=bursts)
        decisions.append(again)
    return replace(found, decisions=decisions, parts=pushed.parts)


def _name(
    found: _Found, given: Model
) -> tuple[tuple[Finding, ...], tuple[Finding, ...], tuple[Rejected, ...]]:
    """Findings, refinements and what was rejected, of joints, bodies and transmissions."""
    findings, refinements, rejected = name_findings(
        found.parts.test, given, found.decisions, found.whole, found.claims
    )
    rejected = (*rejected_bodies(found.bodies, found.claims), *rejected)
    findings += tuple(ripple.finding for ripple in found.fine)
    findings += tuple(finding for m in found.measured for finding in m.findings)
    return sided(findings, found.parts, found.bodies.model), refinements, rejected


def _as_model(model: Model | str | Path | dict[str, Any]) -> Model:
    if isinstance(model, Model):
        return model
    return parse_model(model) if isinstance(model, dict) else load_model(model)


def _sources(given: Source | Sequence[Source] | None) -> list[Source]:
    if given is None:
        return []
    return [given] if isinstance(given, str | Path | Recording | Table) else list(given)


def _read(
    recordings: Source | Sequence[Source], heldout: Source | Sequence[Source] | None, model: Model
) -> tuple[list[Signals], list[Signals], list[Signals], list[str]]:
    """Recordings to fit to, to choose by and to test on, and what was done to them."""
    signals, held, notes = read_parts(_sources(recordings), _sources(heldout), model)
    choose, test, how = halves(held)
    return signals, choose, test, [*notes, *how]


def _lacking(found: _Found, findings: Sequence[Finding], joints: Sequence[int]) -> set[int]:
    """Joints at which something is missing; all of them where a body is, which all may bear."""
    if found.claims:
        return set(joints)
    return {f.joint for f in findings} | {d.joint for d in found.decisions if d.kind != "complete"}


def _where(lacking: dict[int, Any]) -> tuple[Any, Any]:
    places: list[Any] = []
    times: list[tuple[float, float, float]] = []
    for joint, parts in lacking.items():
        for part in parts:
            places += regions(part, joint)[:2]
            times += intervals(part)
    places.sort(key=lambda r: r.time_share - r.share)
    # of several recordings the one that shows it best
    seen: dict[tuple[int, str], Any] = {}
    for place in places:
        seen.setdefault((place.joint, place.variable), place)
    places = list(seen.values())
    times.sort(key=lambda s: -s[2])
    return tuple(places[:6]), tuple((a, b) for a, b, _ in times[:6])


def _table(data: Data, given: Model, calibrated: Model, improved: Model) -> FitTable:
    return FitTable(
        *(float(np.float64(model_error(data, m))) for m in (given, calibrated, improved))
    )
