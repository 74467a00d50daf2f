"""Checks of the data that come before physics is blamed; each refusal is one clear sentence."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.causes import check_caused
from zendsp.diagnosis.data.columns import cutting
from zendsp.diagnosis.data.hangs import Hung, hangs, hung
from zendsp.diagnosis.data.jumps import BACK, JUMP_QUANTILE, stands_out
from zendsp.diagnosis.data.plausibility import check_driven, check_free
from zendsp.diagnosis.data.series import stretches
from zendsp.diagnosis.data.signals import Signals, unused_effects
from zendsp.errors import ModelError, RecordingError
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.effects import mechanism_of
from zendsp.physics.kernel.signals import noise_beside_quantisation
from zendsp.physics.model import Model, per_joint

Array = npt.NDArray[np.float64]

DEGREE = 180.0 / np.pi
TINY = 1e-15  # avoids a division by a step of zero
MIN_SECONDS = 2.0  # eight blocks of the held-out statistics; of several recordings, half each
MIN_COUNTS = 8

# What refuses a recording: tests/diagnosis/test_bad_input.py has recordings on either side.
CONSTANT = 1e-9  # of the largest position: a smaller span is a constant
# least counts of a step between rows that repeat a position, and the number of such steps that
# shows it: chosen, not measured; rows that are all new have such steps one apart
REFRESHED, REFRESHES = 3.0, 50
NOISE_SPANS = 15  # standard deviations: 20 000 samples of white noise span 8
FOLLOWED = 0.8  # R^2 of position on reference from which the slope says unit and sign
MOSTLY = 0.5  # of the samples
OPPOSITE = -0.5  # slope
UNIT_FACTOR = (0.7, 1.4)  # times a factor between units: its tolerance
# times the RMS torque of a driven motion: a given dry friction that no torque of it overcomes, by
# ten times the highest peak. One of 150 N m, for mN m, left a search without any gradient
IMMOVABLE = 30.0
LATE_ROWS = 100  # of a recording: a longer delay or hold is noted; chosen, for ms taken for s
OTHER_UNITS = 10  # times the actuator's limit, and most of the time beyond it
# of the largest speed: a slower swing may be noise. Of the one before: a faster one was driven
SWINGS = 0.05
MILLI = 1000.0  # times a unit: a command in milli-units is this many times larger
TOO_LARGE = 1.001  # of the actuator's limit: more than rounding
AT_TOP = 0.999  # of the largest command: at it
STUCK = 0.03  # of the time at the largest command
VALUES = 20  # least number of values, to six digits, of a command that is not a relay's
DIGITS = 6
DROPPED_S = 1.0  # s, within which a sensor that dropped out is back: chosen, not measured
ARRIVAL = 0.004  # s, over which the speed before a stop is taken
LAG = 0.02  # s, over which the usual acceleration is; a stop lasts longer
STOP_COUNTS = 4  # of the sensor, within ARRIVAL
STOP_USUAL = 6  # times the usual acceleration
STOP_TIME = 0.01  # of the recording, at the extreme
STOP_TWICE = 2  # sudden stops at least,
STOP_MOST = 0.6  # and of all long ones


def check_signals(signals: Sequence[Signals], model: Model) -> list[str]:
    """The notes on recordings that pass the checks before smoothing.

    Raises
    ------
    RecordingError
        A recording cannot be diagnosed: too short, constant, unexcited, clipped, glued. Hanging
        sensors are named for all recordings at once.
    """
    notes = unused_effects(signals, model)
    stood: list[Hung] = []
    least = MIN_SECONDS if len(signals) == 1 else MIN_SECONDS / 2
    for s in signals:
        notes += [note for note in s.notes if note not in notes]  # equal notes once
        raw = s.raw or s
        seconds = float(raw.time[-1] - raw.time[0]) + raw.sample_time  # including the last row's
        if seconds < least - 0.5 * raw.sample_time:
            beside = " each, where there are several recordings" if len(signals) > 1 else ""
            raise RecordingError(
                f"{s.name}: lasts {seconds:.4g} s; a diagnosis needs at least {least:g} s{beside}:"
                " play a longer motion, such as a multisine or a trapezoid of 10 s"
            )
        joints = raw.position.shape[1]
        moved = [j for j in range(joints) if any(not _rests(other, j) for other in signals)]
        still = [j for j in moved if _rests(s, j)]
        if still:
            one, joints_of = len(still) == 1, ", ".join(str(j + 1) for j in still)
            rest = f"joint {joints_of} rests" if one else f"joints {joints_of} rest"
            notes.append(
                f"{s.name}: {rest}; what is said of {'it' if one else 'them'} comes from the other"
                " recordings"
            )
        for j in (j for j in range(joints) if j not in still):
            where = f"{s.name}: joint {j + 1}" if joints > 1 else s.name
            y = raw.position[:, j]
            _moves(where, y, float(raw.resolution[j]), model)
            _refreshed(where, y, float(raw.resolution[j]), raw.sample_time)
            stood += _glued(where, y, float(raw.resolution[j]), raw)
            _clipped(where, y, float(raw.resolution[j]), raw.sample_time)
            if raw.reference is not None:
                kind = model.joint_kind(j + 1)
                _follows(where, y, raw.reference[:, j], kind, raw.sample_time)
            notes += _limits(where, raw.command[:, j], per_joint(model.actuator.limit, j + 1, 0.0))
            notes += _seldom(where, raw.command[:, j], raw.sample_time, model.actuator.hold)
    if stood:
        raise RecordingError(hung(stood, MIN_SECONDS / 2))
    return notes


def _rests(s: Signals, j: int) -> bool:
    """Whether a joint (from 0) moves by less than a few counts in the raw recording."""
    raw = s.raw or s
    y, least = raw.position[:, j], MIN_COUNTS * float(raw.resolution[j])
    return _constant(y) or float(np.ptp(y)) < least


def _constant(y: Array) -> bool:
    return float(np.ptp(y)) <= CONSTANT * max(CONSTANT, float(np.max(np.abs(y))))


def _moves(where: str, y: Array, resolution: float, model: Model) -> None:
    span = float(np.ptp(y))
    instead = "excite it more, or leave this recording out"
    if model.kind == "planar2r":
        instead = (
            'let every joint move, or describe the one that moves alone, as kind = "rotary" with'
            " the inertia that it has in this pose"
        )
    elif model.joints > 1:
        instead = (
            "let every joint of the model move, or make this one fixed in the model (in a URDF:"
            ' type="fixed") and name the columns of the others'
        )
    if _constant(y):
        raise RecordingError(
            f"{where}: the position is constant; what does not move cannot be diagnosed: {instead}"
        )
    if resolution > 0 and span < MIN_COUNTS * resolution:
        raise RecordingError(
            f"{where}: the position spans {span / resolution:.0f} counts of the sensor; a diagnosis"
            f" needs at least {MIN_COUNTS}: {instead}"
        )
    noise = noise_beside_quantisation(y, resolution)
    if span < NOISE_SPANS * noise:
        raise RecordingError(
            f"{where}: the position spans {span:.3g}, {span / noise:.0f} times its own noise of"
            f" {noise:.2g}: it is noise, not motion; excite the joint more, or leave this recording"
            " out"
        )


def _refreshed(where: str, y: Array, resolution: float, sample_time: float) -> None:
    """Refuse a position that steps only every few rows: it was read less often than logged, and so
    is late by half of that interval.
    """
    steps = np.flatnonzero(np.abs(np.diff(y)) > REFRESHED * resolution)
    if len(steps) < REFRESHES:
        return
    apart = np.diff(steps)
    every = int(np.gcd.reduce(apart))
    if every > 1 and float(np.mean(apart == every)) > MOSTLY:
        raise RecordingError(
            f"{where}: the position is new in one row of {every} only, though it moves on: the"
            f" sensor was read at {1.0 / (every * sample_time):.4g} Hz and logged at"
            f" {1.0 / sample_time:.4g} Hz. Keep the rows in which it is new, each with the mean of"
            f" the command from there to the next of them, and in the model sample_time ="
            f" {every * sample_time:.4g} without [actuator] hold; or read the sensor in every row"
        )


def _seldom(where: str, u: Array, sample_time: float, hold: float | None) -> list[str]:
    """The note on a command that is new in every n-th row only."""
    changes = np.flatnonzero(np.diff(u))
    every = int(np.gcd.reduce(np.diff(changes))) if len(changes) > REFRESHES else 1
    if every < 2 or (hold or sample_time) > MOSTLY * every * sample_time:
        return []
    return [
        f"{where}: the command is new in one row of {every} only. If the loop commands that"
        f" seldom, say so ([actuator] hold = {every * sample_time:.4g}); if it is faster, nobody"
        " saw what it did in between, and what seems to be a delay, a lag or a late column may be"
        " the log's"
    ]


def _follows(where: str, y: Array, r: Array, kind: str, sample_time: float) -> None:
    """Refuse a reference that is the position, or differs from it by a factor of 180/pi or -1; and
    a velocity that is called the position.
    """
    if np.array_equal(y, r):
        raise RecordingError(
            f"{where}: the position is its reference, to the last digit: [columns] names the set"
            " value in both places; name the column of the sensor"
        )
    slope, r2 = _on(y, r)
    if r2 < FOLLOWED:
        # its sum, not the reference's slope: of fast parts the loop follows little
        rise, r2 = _on(np.cumsum(y) * sample_time, r)
        if r2 >= FOLLOWED and UNIT_FACTOR[0] < rise < UNIT_FACTOR[1]:
            raise RecordingError(
                f"{where}: the position does not follow its reference, but its sum over time does:"
                " [columns] names a velocity as the position. Name the column of the position; a"
                " velocity alone is not diagnosed, since a constant error of it would be a drift of"
                " the position"
            )
        return
    if slope < OPPOSITE:
        raise RecordingError(
            f"{where}: the position runs opposite to its reference (slope {slope:.3g}): the sign of"
            " one of them is flipped"
        )
    factors = (
        ((DEGREE, "degrees and radians"),)
        if kind == "rotary"
        else ((1e3, "millimetres and metres"),)
    )
    for factor, units in factors:
        for value, first in ((factor, "position"), (1 / factor, "reference")):
            if UNIT_FACTOR[0] < slope / value < UNIT_FACTOR[1]:
                raise RecordingError(
                    f"{where}: the position is {slope:.3g} times its reference: {units} are mixed"
                    f" (the {first} has the larger numbers)"
                )


def _on(y: Array, x: Array) -> tuple[float, float]:
    """The slope of a regression of ``y`` on ``x``, and its R^2; zeros where ``x`` is constant."""
    a, b = y - y.mean(), x - x.mean()
    power = float(b @ b)
    slope = float(a @ b) / power if power > 0 else 0.0
    return slope, slope**2 * power / max(float(a @ a), 1e-300)


def _limits(where: str, u: Array, limit: float) -> list[str]:
    top = float(np.max(np.abs(u)))
    if limit > 0 and top > OTHER_UNITS * limit and float(np.mean(np.abs(u) > limit)) > MOSTLY:
        milli = ", such as mA in place of A" if top < MILLI * limit else ""
        raise RecordingError(
            f"{where}: the command reaches {top:.4g} and is most of the time beyond the actuator's"
            f" limit of {limit:.4g}: is it in other units than the model's [actuator]{milli}? Write"
            " the unit that its numbers have into the column's head, or give [actuator] gain for it"
        )
    if limit > 0 and top > TOO_LARGE * limit:
        return [
            f"{where}: the command reaches {top:.4g}, beyond the actuator's limit of {limit:.4g};"
            " it is clipped in the model"
        ]
    stuck = float(np.mean(np.abs(u) >= AT_TOP * top)) if top > 0 else 0.0
    clipped = limit <= 0 and stuck > STUCK
    if clipped and len(np.unique(np.round(np.abs(u) / top, DIGITS))) > VALUES:
        return [
            f"{where}: the command stays at its largest value {top:.4g} for {100 * stuck:.0f} % of"
            " the time; it looks clipped and the model states no limit"
        ]
    return []


def _glued(where: str, y: Array, resolution: float, s: Signals) -> list[Hung]:
    """Refuse a jump: a speed of one sample that the motion around it does not have. Returns the
    times at which a sensor hung, if that was the cause.
    """
    step = np.diff(y)
    usual = float(np.quantile(np.abs(step), JUMP_QUANTILE))
    k = int(np.argmax(np.abs(step)))
    if stands_out(step, k, float(np.ptp(y)), float(np.max(s.resolution)), max(usual, TINY)):
        jump = float(abs(step[k]))
        between = float(s.time[k] + s.time[k + 1]) / 2.0 - float(s.time[0])
        stood = hangs(y, resolution)
        if any(h.first + h.rows == k + 1 for h in stood):
            return [Hung(where, s, tuple(stood))]
        back = k + 1 + np.flatnonzero(np.abs(y[k + 1 :] - y[k]) < BACK * jump)[:1]
        if (
            len(back)
            and s.time[back[0]] - s.time[k] < DROPPED_S
            and abs(step[back[0] - 1] + step[k]) < BACK * jump
        ):
            until = float(s.time[back[0] - 1] + s.time[back[0]]) / 2.0 - float(s.time[0])
            away = cutting(s.name, "--without", f"{between:.4f}:{until:.4f}", "-o", "part.csv")
            raise RecordingError(
                f"{where}: the position is {jump:.4g} off for {back[0] - k - 1} rows from row"
                f" {k + 2} on, {between:.4f} s from the beginning: did the sensor drop out? {away}"
                " makes a file of each part beside them"
            )
        raise RecordingError(
            f"{where}: the position jumps by {jump:.4g} after row {k + 1}, {between:.4f} s from the"
            " beginning: are two runs glued together, or were samples dropped? Give them as two"
            f" files, made by {cutting(s.name, '-o', 'part.csv')} with --to {between:.4f} and with"
            f" --from {between:.4f}"
        )
    return []


def _clipped(where: str, y: Array, resolution: float, sample_time: float) -> None:
    """Refuse a joint that stops at its extreme within one sample, with an acceleration that it
    shows nowhere else.
    """
    width = max(2, round(ARRIVAL / sample_time))
    lag = max(1, round(LAG / sample_time))
    mean = np.convolve(y, np.ones(lag) / lag, mode="valid")
    speed = (mean[lag:] - mean[:-lag]) / (lag * sample_time)
    usual = float(np.quantile(np.abs(speed[lag:] - speed[:-lag]), 0.98)) / (
        lag * sample_time
    )  # of acceleration
    for name, edge in (("top", float(y.max())), ("bottom", float(y.min()))):
        at = y == edge
        share = float(np.mean(at))
        long = [k for k, end in stretches(at) if (end - k) * sample_time > LAG]
        sudden = 0
        for k in long:
            if k > width:
                travel = abs(float(y[k - 1] - y[k - 1 - width]))
                # braking at the usual acceleration from this speed would take well over ARRIVAL,
                # and several counts
                sudden += (
                    travel > STOP_COUNTS * resolution
                    and travel / (width * sample_time) > STOP_USUAL * usual * width * sample_time
                )
        often = sudden >= STOP_TWICE and sudden >= STOP_MOST * max(1, len(long))
        if share > STOP_TIME and often:
            raise RecordingError(
                f"{where}: the position stops dead at its {name} ({edge:.4g}, {100 * share:.0f} %"
                " of the time): the sensor's range was exceeded, the values are clipped, or the"
                " joint hits a stop"
            )


def check_motion(
    data: Data, model: Model, names: Sequence[str], stated: Collection[str] = ()
) -> None:
    """Compare motion with the command: units, signs, swapped columns (``plausibility``).

    Parameters
    ----------
    data : Data
        All recordings.
    names : sequence of str
        Of the recordings.
    stated : collection of str
        Names of the recordings whose heads state the unit of the positions.

    Raises
    ------
    RecordingError
        Position and command contradict the model so clearly that the data must be wrong; names the
        likeliest mistake.
    """
    # signs are judged on the liveliest part of a recording
    speeds = np.array([[float(np.std(r.motion.states[1])) for r in rec] for rec in data.records])
    lively = (speeds / np.maximum(speeds.max(axis=0), TINY)).sum(axis=1)
    most: dict[str, float] = {}
    for rec, speed in zip(data.records, lively, strict=True):
        most[rec[0].recording] = max(speed, most.get(rec[0].recording, 0.0))
    for rec, name, speed in zip(data.records, names, lively, strict=True):
        where = [f"{name}: joint {record.joint}" if len(rec) > 1 else name for record in rec]
        driven = False
        for place, record in zip(where, rec, strict=True):
            if not np.any(record.command):
                named = model.columns.get("command")
                if named and not any(np.any(r.command) or _let_go(r) for r in rec):
                    raise RecordingError(
                        f"{place}: the command is zero throughout, and the joint does not move as"
                        " one that was let go, whose swings get slower: was the drive's command"
                        " logged? A machine that is moved by hand has no command column in"
                        " [columns]"
                    )
            elif float(np.ptp(record.command)) > 0:
                driven = True
            elif not any(float(np.ptp(r[record.joint - 1].command)) for r in data.records):
                raise RecordingError(
                    f"{place}: the command is constant ({record.command[0]:.4g}); a diagnosis needs"
                    " an excited recording"
                )
        if driven:
            of = rec[0].recording
            parts = [part for part in data.records if part is not rec and part[0].recording == of]
            check_driven(where, rec, model, parts, of in stated, signs=speed == most[of])
            check_caused(where, rec, model)
        else:
            check_free(where, rec, model, rec[0].recording in stated)


def _let_go(record: JointRecord) -> bool:
    """Whether a joint moves as one that was let go: no swing is faster than the one before it to
    the same side.
    """
    speed = record.motion.states[1]
    least = SWINGS * float(np.max(np.abs(speed)))
    swings = np.split(speed, np.flatnonzero(np.diff(np.sign(speed)) != 0) + 1)
    peaks = [peak for swing in swings if (peak := float(np.max(np.abs(swing)))) > least]
    fastest = int(np.argmax(np.abs(speed)))
    slows = fastest < len(speed) // 2
    return slows and all(b < (1.0 + SWINGS) * a for a, b in zip(peaks, peaks[2:], strict=False))


def check_given(data: Data, model: Model) -> list[str]:
    """The notes on given numbers that the recordings make doubtful.

    Raises
    ------
    ModelError
        A given dry friction is so large that the joint, which moves, could not.
    """
    notes = []
    for joint in range(1, data.joints + 1):
        driven = [rec[joint - 1] for rec in data.records if np.any(rec[joint - 1].command)]
        largest = max((r.scale.torque for r in driven), default=math.inf)
        for term in model.at(joint):
            level = term.parameters.get("level")
            dry = level is not None and mechanism_of(term.effect) == "dry_friction"
            if level is not None and dry and abs(level.value) > IMMOVABLE * largest:
                unit = model.torque_unit(joint)
                raise ModelError(
                    f"{model.name}: {term.effect} of joint {joint} has a level of"
                    f" {level.value:.4g} {unit}, and the torque of the recorded motion is"
                    f" {largest:.2g} {unit} RMS: the joint could not move. Its unit? level ="
                    f' {{ value = {level.value:.4g}, unit = "m{unit}" }}, or leave the term out'
                )
    for name in ("delay", "hold"):
        time, row = getattr(model.actuator, name), data.records[0][0].sample_time
        if (time or 0.0) > LATE_ROWS * row:
            notes.append(
                f"[actuator] {name} = {time:.4g} s is {time / row:.0f} rows of the recording: is it"
                f" in ms? {name} = {time / 1e3:.4g}"
            )
    return notes


def never_reverses(data: Data, joint: int) -> bool:
    """Whether a joint (1-based) moves one way in all recordings."""
    speeds = [rec[joint - 1].motion.states[1] for rec in data.records]
    return not any(np.any(np.diff(np.sign(v)) != 0) for v in speeds)


def check_excitation(data: Data) -> list[str]:
    """The notes on joints that hardly move."""
    notes = []
    for j in range(1, data.joints + 1):
        if never_reverses(data, j):
            notes.append(
                f"joint {j} never reverses: Coulomb friction, offset and asymmetry cannot be told"
                " apart; nor can viscous friction from them where its speed hardly varies"
            )
    return notes
