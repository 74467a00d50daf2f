"""Notes of the report beside its findings, and the unexplained torque in words."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.contract import (
    BEYOND,
    LEAST_NAMELESS,
    Verdict,
    listed,
    spans,
    times_off,
    two_digits,
)
from zendsp.diagnosis.decide.findings import percent, torque_word
from zendsp.diagnosis.decide.headline import SEEN
from zendsp.diagnosis.decide.near import likeness, only_in_the_fit
from zendsp.diagnosis.decide.pushes import predicts
from zendsp.diagnosis.decide.result import Errors
from zendsp.diagnosis.decide.thresholds import AMISS, LAWFUL, OF_STATE, PREDICTED
from zendsp.diagnosis.measure.bursts import Bursts
from zendsp.diagnosis.measure.discrepancy import BANDS, as_seen
from zendsp.diagnosis.measure.where import units
from zendsp.diagnosis.measure.windows import least_error, model_error, mostly_below, seconds_of
from zendsp.physics.calibration.fit import Data
from zendsp.physics.model import TREES, Model, Term, per_joint
from zendsp_protocol.texts import enumerated

# ratio of errors, calibrated over given, above which calibration is said to make it worse: 3 of 240
# cases (seed 109) reached it, each with something missing, and none of 99 complete models
MADE_WORSE = 1.5
# error on untouched recordings, in the sensor's errors, above which a note says that only those of
# the fit are explained: a UR5 with a payload of 1.8 kg in those alone had 208
APART = 10.0
# of the travel: a joint that returns by less moves one way; and s of motion, below which a
# recording is short. Where the model does not follow, the user is told so
ONE_WAY, SHORT = 0.05, 5.0
AHEAD = 0.2  # ms: fits of friction that has no lead ended at 0 to 0.11
# of the motion: two recordings that differ by less are of one motion. Chosen; two runs of one chirp
# differed by 0.0001
REPEATS = 0.05
SLOW_ROWS = 0.004  # s: loops are seldom slower


def notes_of(decisions: Sequence[Decision], given: Model) -> list[str]:
    """The notes of the joints' decisions, beside findings."""
    return [
        *_loosely_fitted(decisions),
        *_felt(decisions, given),
        *_creeping(decisions, given),
        *_late_log(decisions, given),
        *_against_masses(decisions, given),
        *_all_for_the_load(decisions, given),
        *_other_loads(decisions),
    ]


def repeated(decisions: Sequence[Decision], parts: Parts) -> list[str]:
    """The note where a torque without a law was judged on a recording that repeats the motion of
    one that was fitted to.
    """
    return [
        f"joint {d.joint}: {held} repeats the motion of {own}, and so whatever follows the time of"
        " that motion, as a hand does: of the torque without a law it does not tell. Hold out"
        " another motion"
        for d in decisions
        if d.kind is Verdict.UNEXPLAINED or any(c.effect == "unknown" for c in d.claims)
        for held, own in _pairs(parts, d.joint)[:1]
    ]


def _pairs(parts: Parts, joint: int) -> list[tuple[str, str]]:
    """Untouched recordings of the same motion as one of the fit, and that one."""
    found = []
    for test, fit in itertools.product(parts.test.records, parts.fit.records):
        held, own = test[joint - 1], fit[joint - 1]
        into = round((held.began - own.began) / own.sample_time)
        n = min(held.n, own.n - into)
        if into < 0 or n < SHORT / own.sample_time or held.recording == own.recording:
            continue
        a, b = held.motion.states[0][:n], own.motion.states[0][into : into + n]
        if float(np.std(a - b)) < REPEATS * float(np.std(b)):
            found.append((held.recording, own.recording))
    return found


def _felt(decisions: Sequence[Decision], given: Model) -> list[str]:
    """The note of pushes too small for a finding."""
    return [
        f"joint {d.joint}: a torque of up to {two_digits(d.beside.peak)}"
        f" {given.torque_unit(d.joint)} acts at {spans(d.beside.intervals, d.beside.recordings)}"
        " that no state explains; all of the time it is less than the"
        f" {percent(LAWFUL)} % of the torque that a finding has. Was the machine touched?"
        for d in decisions
        if not d.claims and d.beside is not None
    ]


def _other_loads(decisions: Sequence[Decision]) -> list[str]:
    """The note of recordings of a machine with another load, or of another zero."""
    alike = [
        f"joint {d.joint}: numbers of its own explain {_each_of(d.loads)}: another load,"
        " another machine, or a law that these numbers stand for there; diagnose each recording by"
        " itself (zendsp diagnose --each)"
        for d in decisions
        if d.loads and not d.differs
    ]
    return alike + [f"joint {d.joint}: {what}" for d in decisions for what in d.differs]


def _each_of(names: Sequence[str]) -> str:
    """A list of recordings in words."""
    *first, last = names
    return f"each of {', '.join(first)} and {last}" if first else last


def _loosely_fitted(decisions: Sequence[Decision]) -> list[str]:
    """The note where nothing is missing, yet numbers fitted to the first recordings do not predict
    the untouched ones.
    """
    return [
        f"joint {d.joint}: with numbers fitted to the first recordings, {percent(d.before.value)} %"
        " of the torque of the untouched ones stays unexplained; with numbers fitted to all,"
        f" {percent(d.after.value)} %. The first recordings hardly determine the numbers for such"
        " motion: fit one that has it too"
        for d in decisions
        if d.kind == Verdict.COMPLETE and d.final is not d.base
    ]


def _creeping(decisions: Sequence[Decision], given: Model) -> list[str]:
    """The note where a known dry friction changes softly at reversals."""
    return [
        f"joint {d.joint}: the improved model lets dry friction change its sign within"
        f" {t.value('speed'):.2g} {unit}{_ahead(t)}, not at once, as many simulators do: the"
        " recordings follow that better. Whether the machine itself creeps at standstill they do"
        " not tell; it is no missing physics"
        for d in decisions
        if d.kind != Verdict.UNEXPLAINED  # there the reversals may be what is unexplained
        for unit in [units(given, d.joint)["velocity"]]
        for t in d.final.model.at(d.joint)
        if t.effect == "creep" and not any(g.effect == "creep" for g in given.at(d.joint))
    ]


def _ahead(creep: Term) -> str:
    """A clause on how long before the joint a creeping friction turns; empty where it does not."""
    lead = 1e3 * creep.value("lead")
    return f" and {lead:.2g} ms before the joint does" if lead > AHEAD else ""


def _late_log(decisions: Sequence[Decision], given: Model) -> list[str]:
    """The note where the command column is late by less than a claimed shift; a claimed one has its
    own finding.
    """
    late = [
        (t.value("time"), d)
        for d in decisions
        for t in d.final.model.at(d.joint)
        if t.effect == "column_shift"
        and not any(g.effect == t.effect for g in given.at(d.joint))
        and not any(c.effect == t.effect for c in d.claims)
    ]
    if not late:
        return []
    at = ", ".join(
        f"{1e3 * time:.2g} ms ({time / d.final.data.records[0][d.joint - 1].sample_time:.2g} rows)"
        f" late at joint {d.joint}"
        for time, d in late
    )
    # a law that is missing bends such a shift, and hides behind it
    unsure = [
        d.joint
        for _, d in late
        if d.kind == Verdict.UNEXPLAINED or d.after.value > LEAST_NAMELESS or d.beside is not None
    ]
    part = unsure and f"at {listed(unsure)} it may stand in for a part of what is left"
    return [
        f"the command column is {at} against the position column: behind a filter of the log, in a"
        " simulator of first order, or of a loop faster than the rows ([actuator] hold). The model"
        f" has it; {part or 'it is no missing physics'}"
    ]


def _against_masses(decisions: Sequence[Decision], given: Model) -> list[str]:
    """The note that a gain relies on the masses of a file."""
    return [
        f"joint {d.joint}: its torque_gain is measured by the masses of {given.file}: if what it"
        " moves is 2 % heavier than there, the true gain is 2 % larger"
        for d in decisions
        if given.kind in TREES and any(c.effect == "torque_gain" for c in d.claims)
    ]


def _all_for_the_load(decisions: Sequence[Decision], given: Model) -> list[str]:
    """The note that a transmission's error relies on the inertia, where no sensor is on the load,
    and nothing says what of it is the motor's: neither rotors nor a load on a spring.
    """
    return [
        f"joint {d.joint}: its transmission_error is measured by what the load resists, and all"
        " inertia is taken for the load's: if half of it is the motor's, the true error is twice as"
        ' large. An effect of kind = "inertia" with free = false says the motor\'s, and [mechanism]'
        " the load's"
        for d in decisions
        if any(c.effect == "transmission_error" for c in d.claims)
        and not any(t.effect == "inertia" for t in given.at(d.joint))
        and not any("load_inertia" in t.parameters for t in d.final.model.at(d.joint))
    ]


def bent(errors: Errors) -> list[str]:
    """The note where calibration makes predictions worse, since missing physics bends the numbers.
    """
    test, unit = errors.test, errors.unit
    least = MADE_WORSE * max(test.given, errors.noise_floor)
    if not test.calibrated or test.calibrated < least:  # of a joint that rests all are nothing
        return []
    return [
        "calibrated, the model predicts the untouched recordings worse than as given"
        f" ({test.calibrated:.3g} {unit} against {test.given:.3g} {unit}): something that it lacks"
        " in the recordings of the fit, a push perhaps, bends its numbers. Keep the given ones,"
        " or fit other recordings"
    ]


def off_sensor(test: Data, model: Model, verdict: Verdict) -> list[str]:
    """The notes where a complete model errs well above its sensor: how much, and how fast that is.
    The torque that is said to be left is slow.
    """
    out = []
    for j in range(1, test.joints + 1) if verdict == Verdict.COMPLETE else ():
        error = model_error(test, model, (j,))
        times = times_off(error, least_error(test, model, j))
        if times:
            below = mostly_below(test, model, j)
            out.append(
                f"joint {j}: in untouched recordings the position errs by {error:.2g}"
                f" {model.position_unit(j)} within {seconds_of(test):.2g} s, {two_digits(times)}"
                " times as much as its sensor"
                + (f", nine tenths of it below {below:.0f} Hz" if math.isfinite(below) else "")
                + f". The torque that is said to be unexplained is only that below {SEEN:.0f} Hz"
            )
    return out


def apart(errors: Errors, verdict: Verdict) -> list[str]:
    """The note where recordings of the fit are explained, held-out ones are not at all, and nothing
    is named.
    """
    known, floor = errors.estimation.improved, errors.noise_floor
    far = errors.test.improved >= APART * floor
    if verdict != Verdict.UNEXPLAINED or known > BEYOND * floor or not far:
        return []
    return [
        f"the recordings of the fit are explained to {known:.3g} {errors.unit}, about the error of"
        f" the sensor, and the untouched ones to {errors.test.improved:.3g} {errors.unit} only:"
        " they are of another load or another machine, or of motion that the fit has not. Diagnose"
        " each recording by itself (zendsp diagnose --each)"
    ]


def _hardly_moves(fit: Data, joint: int) -> str:
    """The note where the model does not follow recordings that hardly determine its numbers: they
    are short, or move one way.
    """
    records = [rec[joint - 1] for rec in fit.records]
    steps = np.concatenate([np.diff(r.others[joint - 1, 0]) for r in records])
    ways = np.maximum(steps, 0.0).sum(), np.maximum(-steps, 0.0).sum()
    seconds = sum(r.n * r.sample_time for r in records)
    one_way = min(ways) < ONE_WAY * max(ways)
    if not one_way and seconds > SHORT:
        return ""
    way = ", and go one way" if one_way else ""
    return (
        f". The recordings of the fit last {seconds:.2g} s{way}: too little to tell friction from"
        " inertia and gravity. Record 10 s and more, there and back"
    )


def _behind_another(decisions: Sequence[Decision], given: Model, joint: int) -> str:
    """The note where the link of another joint moves behind a found transmission: this joint's
    model knows only the motion of that motor.
    """
    others = [
        str(d.joint)
        for d in decisions
        if d.joint != joint
        and any(c.is_transmission for c in d.claims)
    ]
    if not others or given.kind in ("rotary", "linear"):  # whose joints do not act on each other
        return ""
    return (
        f". The link behind joint {enumerated(others)} moves otherwise than its motor does, and"
        " this joint bears its torque: the model takes the motor's motion for the link's"
    )


def _held(d: Decision, fit: Data, given: Model) -> str:
    """The note that commands are taken as held from row to row: the model does not say how long, or
    the rows are so far apart that the loop may be faster. Only where that may be what is missing.
    """
    hold, records = given.actuator.hold, [r for rec in fit.records for r in rec]
    if any(r.between for r in records) or d.after.value * d.scale > _of_a_row(d, fit, given):
        return ""
    if hold is None:
        return (
            " (if the rows are samples of a faster loop, say how long it holds a command:"
            " [actuator] hold)"
        )
    if max(r.sample_time for r in records) < SLOW_ROWS:
        return ""
    return (
        " (if the loop is faster than the rows, its [actuator] hold is less than the"
        f" {hold:.4g} s that the model says)"
    )


def _of_a_row(d: Decision, fit: Data, given: Model) -> float:
    """RMS torque at a joint by a command that acts a row sooner or later, as the observer that sees
    most of it does, N m or N.
    """
    gain = per_joint(given.actuator.gain, d.joint, 1.0)
    records = [rec[d.joint - 1] for rec in fit.records]
    moved = [gain * np.diff(r.command, prepend=r.command[:1])[None] for r in records]
    seen = [
        as_seen(r, d.final.model, BANDS[0], torque)
        for r, torque in zip(records, moved, strict=True)
    ]
    return float(np.sqrt(np.mean(np.concatenate(seen, axis=1) ** 2)))


def left_over(decisions: Sequence[Decision], given: Model, fit: Data) -> str:
    """The unexplained torque in words, a line for each joint; empty where it is too small to
    matter.
    """
    words = []
    for d in decisions:
        words.append(_left_at(d, decisions, given, fit))
        if d.beside is not None and d.claims:
            words.append(_bending(d.joint, d.beside, given.torque_unit(d.joint)))
    return "\n".join(line for line in words if line)


def _left_at(d: Decision, decisions: Sequence[Decision], given: Model, fit: Data) -> str:
    """The unexplained torque at a joint in words."""
    most = percent(min(1.0, d.after.high))
    if not d.searched:
        return _not_searched(d)
    if d.after.value > 1.0:
        return (
            f"Joint {d.joint}: the model does not follow the recording: more than all of the"
            " joint's torque stays unexplained. Check that the model is of this machine, and its"
            " units, [actuator] gain and limit those of the command column"
            + _hardly_moves(fit, d.joint)
        )
    if d.doubted:
        return only_in_the_fit(d.joint, d.doubted[0][0])
    if d.kind == Verdict.MISSING:
        rest = _beside(d)
        told = rest > OF_STATE and d.after.low > OF_STATE
        what = f"beside what was found, {_torque(d, rest, given)} stays unexplained"
        return f"Joint {d.joint}: {what}" if told else ""
    if d.kind != Verdict.UNEXPLAINED:
        return ""
    if d.strap:
        what = f"{_torque(d, d.after.value, given)} stays unexplained"
        return f"Joint {d.joint}: {what}, a part of what pulls at {listed(d.strap)}"
    if d.loads:
        return (
            f"Joint {d.joint}: one set of numbers for all recordings leaves"
            f" {_torque(d, d.after.value, given)}; numbers of its own explain each of them"
        )
    if d.state.size > OF_STATE and predicts(d.state):
        return (
            f"Joint {d.joint}: {_of_state(d, given)}"
            + (f". {likeness(d.near)}" if d.near else " and is none of the known effects")
            + (_behind_another(decisions, given, d.joint) or _hardly_moves(fit, d.joint))
        )
    if d.after.value < LAWFUL and d.after.high > AMISS:
        return (
            f"Joint {d.joint}: the position is off by far more than the sensor errs by, and the"
            f" recordings held out are too short to say by what: up to {most} % of the torque may"
            " be missing. Hold a longer recording out"
        )
    if d.after.value < OF_STATE:
        return (
            f"Joint {d.joint}: recordings are surely likelier with what was tried, and none of it"
            f" is surely what acts: at most {most} % of the torque is missing."
            f" {f'{likeness(d.near)}. ' if d.near else ''}Larger and faster motion would show more"
            " of it"
        )
    reason = _behind_another(decisions, given, d.joint) or _hardly_moves(fit, d.joint)
    return _lawless(d, given) + (reason or _held(d, fit, given))


def _lawless(d: Decision, given: Model) -> str:
    """The unexplained torque that no function of the state predicts, in words."""
    what = f"Joint {d.joint}: {_torque(d, d.after.value, given)} is missing that"
    smooth = "smooth function of the joint's state predicts on untouched recordings"
    if d.near:
        return f"{what} no {smooth}. {likeness(d.near)}"
    return f"{what} neither a known effect nor any {smooth}"


def _torque(d: Decision, share: float, given: Model) -> str:
    """A part of a joint's torque in words, in its unit and in per cent."""
    unit = given.torque_unit(d.joint)
    size, word = two_digits(share * d.scale), torque_word(unit)
    return f"a {word} of {size} {unit} RMS ({percent(share)} % of the {word})"


def _of_state(d: Decision, given: Model) -> str:
    """The torque that functions of the state predict; the whole missing one where they predict the
    smaller part of it, as 35 % of a slow torque over time alone.
    """
    if d.state.share < PREDICTED:
        part = f"functions of the joint's state predict {percent(d.state.share)} %"
        return f"{_torque(d, d.after.value, given)}, of which {part}, is missing"
    # fitted where there is more of it, it may be larger than what is missing where it is judged
    size = min(d.state.size, d.after.value)
    return f"{_torque(d, size, given)} depends on the state of the joint"


def _beside(d: Decision) -> float:
    """The torque left beside the findings. A torque without a law that no refinement describes is
    in no model, and counts.
    """
    drawn = 0.0 if d.refinements else sum(c.size**2 for c in d.claims if c.effect == "unknown")
    return float(np.sqrt(max(d.after.value**2 - drawn, 0.0)))


def _not_searched(decision: Decision) -> str:
    return (
        f"Joint {decision.joint}: it was not searched before the interrupt; calibrated, the model"
        f" leaves {percent(decision.after.value)} % of its torque"
    )


def _bending(joint: int, push: Bursts, unit: str) -> str:
    """The note of a push beside what is claimed."""
    return (
        f"Joint {joint}: a torque of up to {two_digits(push.peak)} {unit} acts at"
        f" {spans(push.intervals, push.recordings)} that no state explains: a push, which bends the"
        " numbers of what was found if it is in a recording of the fit"
    )
