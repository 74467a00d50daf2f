"""Diagnosis of a simulator that can only be called (``kind = "python"`` or ``"fmu"``).

Parameters are calibrated by output error: least squares on the simulated position. Effects act on
the simulator's input: the torque of an effect along the smoothed measured motion, divided by the
gain, is taken from the command. Every effect that can act there is screened by finite differences,
the promising ones are fitted together with the parameters, and a claim needs held-out evidence, as
for the other kinds.

A simulator that starts from the first row's position and velocity gets the recording in windows, so
that errors do not accumulate.

Not possible with a black box: effects with states inside it (springs, gaps, bristles, hysteresis),
and an observer.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.split import read_divided
from zendsp.diagnosis.data.used import columns_beside_a_call
from zendsp.diagnosis.decide.contract import Rejected, Verdict, contradicted
from zendsp.diagnosis.decide.moved import moved
from zendsp.diagnosis.decide.near import only_in_the_fit
from zendsp.diagnosis.decide.propose import experiment_of
from zendsp.diagnosis.decide.result import (
    Diagnosis,
    FitTable,
    SimulatorErrors,
    numbers_off,
)
from zendsp.diagnosis.decide.thresholds import LEFT_BY_A_LAW
from zendsp.diagnosis.external.hunt import (
    SHORT_WAYS,
    Hunt,
    findings_of,
    indistinct,
    judged_again,
)
from zendsp.diagnosis.external.nearby import Near, settled, spread_over
from zendsp.diagnosis.external.output_error import (
    Output,
    errors,
    fit_output,
    sensor_noise,
    weights,
)
from zendsp.diagnosis.external.simulator import Bench, Simulator, bench, on_input
from zendsp.diagnosis.measure.where import Missing, located, units
from zendsp.diagnosis.progress import Progress, Said, Step
from zendsp.errors import ModelError
from zendsp.physics.calibration.fit import Fit
from zendsp.physics.calibration.handles import free_handles
from zendsp.physics.calibration.joint import share_facts
from zendsp.physics.effects import library
from zendsp.physics.model import Model, Term
from zendsp.physics.term_numbers import file_model

Array = npt.NDArray[np.float64]

# s: where the simulator starts from the first row, each window starts from the smoothed motion
WINDOW = 0.25
# rounds, each of one effect per joint; a joint may have to wait for those of its neighbours
EFFECT_ROUNDS = 6
LAST = 3  # simulated steps of the last fit, after those with guessed slopes
OVER_NOISE = 3  # times the sensor's noise: a smaller error is no mismatch
RESTARTS = 0.02  # of the span, and START_NOISE times the noise: error of a start
START_NOISE = 4
UNEXPLAINED = 0.03  # of the RMS torque, as a function of time
REMAINS = (
    "A torque of {:.1f} % of the RMS torque remains over time that no effect on the simulator's"
    " input explains (it may be inside the simulator: springs, gaps, bristles)."
)
WHOLE = (
    "Over whole recordings the simulator errs by {:.2g} {}, {:.0f} times the sensor's noise, and no"
    " effect on its input explains it. One that starts from the first row's position and velocity"
    " is compared in windows, where errors do not accumulate and effects are told apart."
)


def missing_over_time(near: Near) -> dict[int, list[Missing]]:
    """The torque over time that would remove the remaining error, by regularised least squares over
    bumps of half a second.
    """
    out: dict[int, list[Missing]] = {}
    for k, b in enumerate(near.true):
        e = b.error(near.current.model)
        seconds = b.records[0].scale.seconds
        centres = np.linspace(0, seconds, int(min(60, max(8, 3 * seconds))))
        width = centres[1] - centres[0]
        t = b.signals.time - b.signals.time[0]
        shapes = np.maximum(0.0, 1 - np.abs(t[None, :] - centres[:, None]) / width)
        for i, record in enumerate(b.records):
            a = near.bumps(k, i, shapes) / sensor_noise(b, i)
            ridge = 1e-6 * float(np.trace(a.T @ a)) / a.shape[1] * np.eye(a.shape[1])
            # least squares: a simulator that ignores its command gives nothing to solve for
            coefficients = np.linalg.lstsq(
                a.T @ a + ridge, a.T @ e[:, i] / sensor_noise(b, i), rcond=1e-12
            )[0]
            torque = shapes.T @ coefficients
            q, qd, qdd = record.motion.states
            item = Missing(
                b.signals.time,
                torque,
                np.zeros_like(torque),
                {"velocity": qd, "position": q, "acceleration": qdd, "command": record.command},
                units(near.current.model, i + 1),
            )
            out.setdefault(i + 1, []).append(item)
    return out


class _Stages:
    """Reports the stage, and the number of simulations within it."""

    def __init__(self, tell: Progress) -> None:
        self.tell, self.stage, self.count = tell, Step.READING.says("starting"), 0

    def __call__(self, said: Said) -> None:
        self.stage = said
        self.tell(said)

    def ran(self) -> None:
        self.count += 1
        self.tell(self.stage.step.says(f"{self.stage} ({self.count} simulations)"))


def diagnose_simulator(
    sources: Sequence[Any],
    model: Model,
    heldout: Sequence[Any],
    simulator: Simulator,
    *,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find the physics that a user's own simulator leaves out.

    Parameters
    ----------
    sources, heldout : sequence of path, Recording or Table
        To calibrate on, and to judge on (where none: the last third of each).
    model : Model
        Of ``kind = "python"`` or ``"fmu"``; its mechanism parameters go to the simulator, its
        effects act on the command.
    simulator : Simulator
        Of the model.
    progress : callable, optional
        Receives a sentence at each stage.

    Raises
    ------
    RecordingError, ModelError
        Unusable input, or a simulator that fails.
    """
    return _diagnose(sources, model, heldout, simulator, progress or (lambda _text: None))


def _diagnose(
    sources: Sequence[Any],
    model: Model,
    heldout: Sequence[Any],
    simulator: Simulator,
    tell: Progress,
) -> Diagnosis:
    begin, tell = time.perf_counter(), _Stages(tell)
    train, test, notes = _recordings(sources, heldout, model, simulator)
    _refuse_copies(train[0], model)
    for b in (*train, *test):
        b.ran = tell.ran
    tell(Step.CALIBRATING.says("calibrating the simulator"))
    given_error = errors(train, model)
    base = fit_output(train, model, free_handles(model, offsets=False), given_error, 25)
    # a fit must not be worse than its start
    if float(np.sum((weights(train, given_error) * given_error) ** 2)) < base.fit.cost:
        base = fit_output(train, model, (), given_error, 1)
    hunt = Hunt(train, test, tell)
    current, steps = _hunted(hunt, base, train)
    tell(Step.LOOKING_ON.says("looking at what remains"))
    before = missing_over_time(Near(train, base))
    after = missing_over_time(Near(train, current)) if steps else before
    if _a_part(_left(after, train), {claim.term.joint for claim, _, _ in steps}):
        current, steps, after = base, [], before
    findings, names = findings_of(model, base, current, steps, train)
    left = max(_left(after, train).values(), default=0.0)
    floor = _floor(test)
    rest = _rms(test, current.model)
    unexplained = "" if rest <= OVER_NOISE * floor else _unexplained(left, rest, floor, train[0])
    rejected = _rejected(hunt, steps[0][0].gain if steps else 0.0, names)
    doubted = () if findings or unexplained else contradicted(rejected)
    unexplained = unexplained or "\n".join(only_in_the_fit(j, e) for e, j in doubted)
    silent = Verdict.UNEXPLAINED if unexplained else Verdict.COMPLETE
    verdict = Verdict.MISSING if findings else silent
    places, spans, at = located(before)
    calibrated, improved = _noted(base.fit), _noted(current.fit)
    untouched = FitTable(_rms(test, model), _rms(test, base.model), rest)
    off = numbers_off(verdict, untouched)
    return Diagnosis(
        verdict=verdict,
        findings=findings,
        regions=places if verdict != Verdict.COMPLETE else (),
        times=spans if verdict != Verdict.COMPLETE else (),
        times_of=at if verdict != Verdict.COMPLETE else (),
        unit=train[0].unit,
        estimation=FitTable(
            _rms(train, model), _rms(train, base.model), _rms(train, current.model)
        ),
        heldout=untouched,
        noise_floor=floor,
        rejected=rejected,
        next_recording=experiment_of(findings),
        seconds=time.perf_counter() - begin,
        notes=(*notes, _untried(train, test), *moved(model, improved, off=off)),
        given=file_model(model),
        calibrated=file_model(calibrated),
        improved=file_model(improved),
        unexplained=unexplained,
        missing=before,
        remaining=after,
        workings=_errors_over_time(test[0], base.model, current.model),
        doubted=doubted,
    )


def _rejected(hunt: Hunt, gain: float, names: set[tuple[str, int]]) -> tuple[Rejected, ...]:
    """The rejected hypotheses, the best first, with gains relative to the claimed one."""
    rejected = (
        Rejected(e, j, why, score - gain)
        for (e, j), (score, _z, why) in hunt.tried.items()
        if (e, j) not in names
    )
    return tuple(sorted(rejected, key=lambda r: -r.score)[:12])


def _unexplained(left: float, rest: float, floor: float, b: Bench) -> str:
    """The unexplained torque beyond the sensor's noise, in words; empty where it is too small."""
    if left > UNEXPLAINED:
        return REMAINS.format(100 * left)
    return "" if b.size else WHOLE.format(rest, b.unit, rest / floor)


def _hunted(
    hunt: Hunt, base: Output, train: Sequence[Bench]
) -> tuple[Output, list[tuple[Any, Any, Output]]]:
    """The effects of forward selection, refitted together at the end, without those that then
    vanish; each step with its rivals and the fit before it.
    """
    current, steps = base, []
    for _ in range(EFFECT_ROUNDS):
        fitted, taken = hunt.step(current)
        if not taken:
            break
        steps += [(claim, rivals, current) for claim, rivals in taken]
        current = fitted
    while steps:
        hunt.tell(Step.ASSEMBLING.says("fitting all together"))
        current = settled(train, current, SHORT_WAYS, base.error)
        # simulated slopes, for the uncertainties
        current = fit_output(train, current.model, current.fit.handles, current.error, LAST)
        gone = [t for claim, _, _ in steps for t in indistinct(current, claim.term)]
        if not gone:
            break
        model = current.model.with_terms(tuple(t for t in current.model.terms if t is not gone[-1]))
        steps = [s for s in steps if (s[0].term.effect, s[0].term.joint) in
                 {(t.effect, t.joint) for t in model.terms}]  # fmt: skip
        current = fit_output(train, model, free_handles(model, offsets=False), current.error, LAST)
    hunt.tell(Step.LOOKING_ON.says("asking the untouched recordings for the same numbers"))
    if not steps:
        return current, steps
    steps = judged_again(Near(train, current), train, steps)
    return spread_over(current, hunt.test), steps


def _noted(fit: Fit) -> Model:
    """The fitted model with the standard deviations of the fit."""
    mechanism = {key: list(items) for key, items in fit.model.mechanism.items()}
    terms = [dict(term.parameters) for term in fit.model.terms]
    for h, std in zip(fit.handles, fit.std, strict=True):
        if h.place == "mechanism":
            mechanism[h.key][h.index] = replace(mechanism[h.key][h.index], std=float(std))
        elif h.place == "term":
            terms[h.index][h.key] = replace(terms[h.index][h.key], std=float(std))
    return replace(
        fit.model,
        mechanism={key: tuple(items) for key, items in mechanism.items()},
        terms=tuple(
            Term(t.effect, t.joint, p) for t, p in zip(fit.model.terms, terms, strict=True)
        ),
    )


def _untried(train: Sequence[Bench], test: Sequence[Bench]) -> str:
    """The note on effects that cannot be tried on a black-box simulator."""
    inside = ", ".join(e.name for e in library().values() if not on_input(e))
    return (
        f"black box: {sum(b.calls for b in (*train, *test))} simulations; what has states of its"
        f" own inside the simulator, or moves all joints, cannot be tried: {inside}"
    )


def _recordings(
    sources: Sequence[Any], heldout: Sequence[Any], model: Model, simulator: Simulator
) -> tuple[list[Bench], list[Bench], list[str]]:
    signals, held, notes = read_divided(sources, heldout, model)
    notes += columns_beside_a_call([*signals, *held], model)
    train = [bench(s, model, simulator) for s in signals]
    test = [bench(s, model, simulator) for s in held]
    for benches in (train, test):
        share_facts([b.records for b in benches])
    if _restarts(train[0], model):
        for b in (*train, *test):
            b.size = max(16, round(WINDOW / b.signals.sample_time))
    else:
        notes.append(
            "the simulator does not start from the first row's position and velocity: it is"
            " compared over whole recordings, where errors accumulate"
        )
    return train, test, notes


def _refuse_copies(b: Bench, model: Model) -> None:
    """Refuse a simulator that errs by less than the sensor does, although the recorded command
    makes no difference to it: it hands the recording back, and nothing could be seen to lack.
    """
    driven = b.command(model)
    if _rms([b], model) > _floor([b]) or not np.any(driven):
        return
    if np.array_equal(b.run(driven, model), b.run(0.0 * driven, model)):
        raise ModelError(
            f"the simulator {model.entry or model.file!r} errs by less than the sensor, and gives"
            " the same position without the recorded command as with it: it has to compute the"
            " motion from the command, and not to hand the recording back"
        )


def _restarts(b: Bench, model: Model) -> bool:
    """Whether windows start at the recorded state: the simulated first row of every window equals
    the measured one.
    """
    size = max(16, round(WINDOW / b.signals.sample_time))
    windowed = Bench(b.signals, b.records, b.simulator, model, size)
    y = windowed.simulate(model)[::size]
    off = np.sqrt(np.mean((y - b.signals.position[::size]) ** 2, axis=0))
    return bool(
        np.all(
            off < RESTARTS * np.ptp(b.signals.position, axis=0) + START_NOISE * np.array(
                [sensor_noise(b, i) for i in range(len(b.records))]
            )
        )
    )


def _rms(benches: Sequence[Bench], model: Model) -> float:
    parts = [b.error(model).ravel() for b in benches]
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def _floor(benches: Sequence[Bench]) -> float:
    squares = [sensor_noise(b, i) ** 2 for b in benches for i in range(len(b.records))]
    return float(np.sqrt(np.mean(squares)))


def _left(missing: dict[int, list[Missing]], benches: Sequence[Bench]) -> dict[int, float]:
    """The largest missing torque of any recording, by joint, as a part of the RMS torque."""
    return {
        j: max(
            float(np.sqrt(np.mean(m.torque**2))) / b.records[j - 1].scale.torque
            for m, b in zip(parts, benches, strict=True)
        )
        for j, parts in missing.items()
    }


def _a_part(left: dict[int, float], named: Collection[int]) -> bool:
    """Whether much stays unexplained at a joint without a claim. Each joint feels its part of a
    missing body, and one may mistake it for a gain.
    """
    return bool(named) and any(x > LEFT_BY_A_LAW for j, x in left.items() if j not in named)


def _errors_over_time(b: Bench, calibrated: Model, improved: Model) -> SimulatorErrors:
    return SimulatorErrors(
        np.asarray(b.signals.time, dtype=np.float64), b.error(calibrated), b.error(improved)
    )
