"""The diagnosis: read, check, calibrate, search each joint, judge on held-out recordings, name, and say what remains."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from zendsp.diagnosis.assemble import Assembled, assemble
from zendsp.diagnosis.checks import check_excitation, check_motion, check_signals
from zendsp.diagnosis.evidence import compare, compare_errors, torque_share, unmodelled_torque
from zendsp.diagnosis.findings import NUMERIC, file_model, kernel_model
from zendsp.diagnosis.fine import fine_ripples, fixed
from zendsp.diagnosis.hypothesis import JointSearch, Rival
from zendsp.diagnosis.naming import name_findings
from zendsp.diagnosis.prepare import prepare
from zendsp.diagnosis.propose import propose
from zendsp.diagnosis.reading import Signals, read_signals, split
from zendsp.diagnosis.result import Diagnosis, FitTable
from zendsp.diagnosis.score import Scored
from zendsp.diagnosis.search import Searcher, calibrate_joint
from zendsp.diagnosis.verdict import Outcome, judge, settled, uncurved
from zendsp.diagnosis.where import intervals, mismatch, regions
from zendsp.diagnosis.windows import model_error, noise_floor
from zendsp.errors import RecordingError
from zendsp.physics.fit import Data
from zendsp.physics.model import Model
from zendsp.physics.model_file import load_model, parse_model
from zendsp.recording import Recording, Table

Source = str | Path | Recording | Table
Progress = Callable[[str], None]

MIN_TRAIN_GAIN = 40.0  # deviance beyond the price of the parameters
MIN_HELD_GAIN = 20.0
MIN_Z = 2.5
MIN_SIGN = 4.0  # a contact that comes a sample too early loses the track of a block
PLAIN = 200.0
MIN_SHARE = 0.0015  # of the RMS torque: smaller effects are called negligible (the figures are measured: docs/diagnosis.md)


class Acceptance:
    """The gates of a claim: likelihood beyond its price, held-out gain, z over blocks, and a size that matters."""

    def __init__(self, test: Data) -> None:
        self.test = test

    def __call__(self, before: Scored, rival: Rival) -> bool:
        gain = before.deviance - rival.value
        if gain < MIN_TRAIN_GAIN:
            return False
        held = compare(before, rival.scored, self.test, rival.joint)
        if held.gain < MIN_HELD_GAIN or held.z < MIN_Z:
            fitted = sum(rec[0].n for rec in rival.scored.data.records)
            tested = sum(rec[0].n for rec in self.test.records)
            # active in a small part of the record: few blocks speak, but they say as much as in the fit
            strong = held.gain > max(300.0, 0.1 * gain * tested / fitted) and (
                held.z > 1.8 or compare_errors(before, rival.scored, self.test, rival.joint).z > MIN_Z
            )
            contact = rival.effect == "backlash" and held.gain > 300.0 and held.sign > MIN_SIGN
            if gain < 1000 or not (strong or contact):
                return False
        share = torque_share(before, rival.scored, rival.joint)
        if gain > PLAIN and held.gain > 0.5 * PLAIN and held.z > 4.0 and share > NUMERIC:
            return True  # small as a torque, but plain above the noise: a bearing on a heavy pendulum
        return share > max(
            MIN_SHARE, 0.5 * unmodelled_torque(rival.scored, rival.joint) if gain < 400 else 0.0
        )


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
        To calibrate and to search on; several are fitted jointly. SI units, columns as the model names them.
    model : Model, path or dict
        The given model (docs/diagnosis.md).
    heldout : like ``recordings``, optional
        To judge on; where none is given, the last third of each is held out (of its motion, where it comes to rest).
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
    # matrices are small and many run at a time: more threads of the linear algebra only wait for each other
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
    if given.kind == "python":
        from zendsp.diagnosis.blackbox import diagnose_simulator

        return diagnose_simulator(
            _sources(recordings), given, _sources(heldout), seed=seed, jobs=jobs, progress=tell
        )
    tell("reading the recordings")
    train_signals, test_signals, notes = _read(recordings, heldout, given)
    tell("smoothing the motion")
    train, test = prepare(train_signals, given, 64.0), prepare(test_signals, given, 64.0)
    names = [s.name for s in (*train_signals, *test_signals)]
    notes += check_motion(Data((*train.records, *test.records), train.bandwidth), given, names)
    notes += check_excitation(train)
    tell("calibrating the given model")
    searches, whole, outcome = _explain(train, test, given, given, jobs, tell)
    tell("looking for what passes fast")
    fine = [
        ripple
        for search, joint in zip(searches, outcome.joints, strict=True)
        if joint.kind not in ("unexplained", "disturbance")
        for ripple in fine_ripples(train, test, search, given.joint_kind(search.joint), jobs)
    ]
    beneath = given  # what the search builds upon
    if fine:  # a ripple that nobody models lends itself to effects that are not there: search again upon it
        beneath = given.with_terms((*given.terms, *(fixed(ripple.term) for ripple in fine)))
        searches, whole, outcome = _explain(train, test, given, beneath, jobs, tell)
    findings, rejected = name_findings(train, test, beneath, searches, whole, outcome, jobs, tell)
    findings += tuple(ripple.finding for ripple in fine)
    verdict = "missing" if findings else outcome.verdict if outcome.verdict != "missing" else "complete"
    improved = whole.improved if findings else whole.calibrated
    lacking = {j: mismatch(train, whole.calibrated, j) for j in range(1, given.joints + 1)}
    places, times = _where(lacking)
    tell("proposing the next recording")
    proposal = propose(train_signals, given, whole, searches, findings, outcome, seed)
    floor = noise_floor(test)
    return Diagnosis(
        verdict=verdict,
        findings=findings,
        regions=places if verdict != "complete" else (),
        times=times if verdict != "complete" else (),
        unit="m" if given.joint_kind(1) == "linear" else "rad",
        estimation=_table(train, given, whole.calibrated, improved),
        heldout=_table(test, given, whole.calibrated, improved),
        noise_floor=floor,
        rejected=rejected,
        next_recording=proposal,
        seconds=time.perf_counter() - begin,
        notes=tuple(notes),
        given=given_file,
        calibrated=file_model(whole.calibrated),
        improved=file_model(improved),
        unexplained=outcome.sentence,
        missing=lacking,
        remaining={j: mismatch(train, improved, j) for j in range(1, given.joints + 1)},
        details={"searches": searches, "whole": whole, "train": train, "test": test, "outcome": outcome},
    )


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
) -> tuple[list[Signals], list[Signals], list[str]]:
    signals = [read_signals(source, model) for source in _sources(recordings)]
    if not signals:
        raise RecordingError("no recording given")
    held = [read_signals(source, model) for source in _sources(heldout)]
    notes = check_signals([*signals, *held], model)
    if held:
        return signals, held, notes
    train, test, how = split(signals)
    return train, test, [*notes, *how]


def _explain(
    train: Data, test: Data, given: Model, beneath: Model, jobs: int, tell: Progress
) -> tuple[list[JointSearch], Assembled, Outcome]:
    """Search every joint and put the machine together; ``beneath`` is the given model, with what is known of it by now."""
    searches = _search(train, test, beneath, jobs, tell)
    tell("fitting the improved model")
    whole = assemble(train, test, beneath, searches, jobs)
    outcome = judge(train, test, beneath, searches, whole, jobs)
    added = beneath.terms[len(given.terms) :]  # held, so they come out as they went in
    known = tuple(t for t in whole.calibrated.terms if t not in added)
    return searches, replace(whole, calibrated=whole.calibrated.with_terms(known)), outcome


def _search(train: Data, test: Data, given: Model, jobs: int, tell: Progress) -> list[JointSearch]:
    joints = range(1, given.joints + 1)
    if jobs == 1 or given.joints == 1:
        return [_search_joint(train, test, given, joint, jobs, tell) for joint in joints]
    # joints are independent: a process each, which inherits the recordings and the effects that a user has added
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(min(jobs, given.joints), context, _inherit, (train, test, given)) as pool:
        out = []
        for joint, search in zip(joints, pool.map(_search_inherited, joints), strict=True):
            tell(f"joint {joint} of {given.joints}: searched")
            out.append(search)
    return out


def _search_joint(
    train: Data, test: Data, given: Model, joint: int, jobs: int, tell: Progress
) -> JointSearch:
    tell(f"joint {joint}: calibrating the given model")
    base = calibrate_joint(train, given, joint, jobs)
    searcher = Searcher(train, joint, Acceptance(test), jobs, tell, given)
    return settled(test, uncurved(test, searcher.search(base), searcher.n, jobs))


_inherited: list[tuple[Data, Data, Model]] = []  # filled in the processes of _search only


def _inherit(train: Data, test: Data, given: Model) -> None:
    _inherited[:] = [(train, test, given)]


def _search_inherited(joint: int) -> JointSearch:
    train, test, given = _inherited[0]
    return _search_joint(train, test, given, joint, 1, lambda _text: None)


def _where(lacking: dict[int, Any]) -> tuple[Any, Any]:
    places: list[Any] = []
    times: list[tuple[float, float, float]] = []
    for joint, parts in lacking.items():
        for part in parts:
            places += regions(part, joint)[:2]
            times += intervals(part)
    places.sort(key=lambda r: r.time_share - r.share)
    times.sort(key=lambda s: -s[2])
    return tuple(places[:6]), tuple((a, b) for a, b, _ in times[:6])


def _table(data: Data, given: Model, calibrated: Model, improved: Model) -> FitTable:
    return FitTable(*(float(np.float64(model_error(data, m))) for m in (given, calibrated, improved)))
