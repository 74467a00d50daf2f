"""Checks and resamples a recording's clock and its sensors' counts."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.columns import Columns, Getter, column_name, cutting, has
from zendsp.diagnosis.data.signals import Signals
from zendsp.errors import RecordingError
from zendsp.physics.kernel.signals import FOURTH, MEDIAN, find_resolution
from zendsp.physics.model import Model, per_joint
from zendsp.recording.samples import is_gap
from zendsp.recording.stamps import JITTER, EvenClock, even_clock, usual_step
from zendsp_protocol.texts import counted

Array = npt.NDArray[np.float64]
TARGET_RATE = 1000.0  # Hz: faster recordings are averaged down to about this
# samples times joints above which a recording is averaged down further, to no less than
# SLOWEST_RATE, since the fastest observer has 10 Hz
BUDGET = 150_000
SLOWEST_RATE = 250.0  # Hz

TURN = 2 * np.pi  # rad
STEPS_AROUND = 3  # steps before and after one, whose median is the usual step there
REPEATED_COUNTS = 4.0  # of the sensor: least step that a repeated row may hide
SLOWEST_CLOCK = 0.1  # s between samples
UNIT = 50  # least factor between units of time: seconds, milliseconds, minutes
OTHER_UNIT = 0.2  # of the stated sample time: a larger difference means another unit
EQUALS = 1e-3  # of it: a mean within this equals it
EVEN = 5e-4  # of the sample time, RMS: less would be written as 0.0 %
A_ROW_LATE = 4.0  # standard deviations of the steps: without a missing row one in 30 000
MOST_OF_TWO = 2  # samples that a late stamp and its neighbour span; a missing row makes three
# of the roughness over stamps: smoother rows were read evenly. True stamps give 1 and more, however
# slow the motion
SMOOTHER = 0.8
# % of the command that lines between rows miss: more is a chattering loop. Chosen on one arm with
# 43
LINES_MISS = 20.0
UNSEEN = 0.05  # of the time between rows: less is rounding of stamps
UNITS = 0.02  # tolerance of a factor between units
IN_COUNTS = 2.0  # times the stated step: whole numbers with a larger one are counts of the sensor
COARSER = 3.0  # times the stated step: a whole multiple of it is another count, and is told
# steps in counts that show a lattice: smaller ones are rounding, larger ones exceed the printed
# digits
LATTICE = (0.02, 300)
OFF, ON = 0.05, 0.95  # of a count: most that a step is off a whole one, in this part of the steps
STEPS = 10  # least number to decide
STAMPS = 1e6  # s: a larger time is a calendar's stamp
MANY = 1.5  # times TARGET_RATE: above, means of counts are better than single ones


def whole_second(time: float) -> float:
    """The whole seconds of a calendar's time stamp, to be left out of labels; else 0."""
    return float(np.floor(time)) if time > STAMPS else 0.0


def turned_on(
    position: Array, reference: Array | None, turns: npt.NDArray[np.bool_]
) -> tuple[Array, Array | None, list[int]]:
    """Positions and references (n, joints) of wrapping sensors, unwrapped; and the joints (from 0),
    among those that may turn on, at which that was done.
    """
    span, step = np.ptp(position, axis=0), np.abs(np.diff(position, axis=0)).max(axis=0)
    found = turns & (span < TURN * (1 + UNITS)) & (step > 0.5 * TURN)
    out = np.where(found, np.unwrap(position, axis=0), position)
    if reference is not None:
        beside = np.unwrap(reference, axis=0)
        beside += TURN * np.round((position - reference)[0] / TURN)
        reference = np.where(found, beside, reference)
    return out, reference, np.flatnonzero(found).tolist()


def read_anew(position: Array, resolution: Array) -> tuple[Array, int]:
    """Positions (n, joints) without those that a logger only repeated, and their number.

    A moving joint does not stop for one sample and catch up in a next one. So a value is a
    repetition if it equals the one before, the steps around it are several counts, and the next
    step is twice as large; or the step after a few more, whose values came as late as it.
    """
    out, count = position.copy(), 0
    step = np.diff(position, axis=0)
    for j in range(position.shape[1]):
        padded = np.pad(step[:, j], STEPS_AROUND, mode="edge")
        around = np.lib.stride_tricks.sliding_window_view(padded, 2 * STEPS_AROUND + 1)
        usual = np.median(around, axis=1)
        # in a smooth motion three steps lie on a line, but for the sensor's noise, of which they
        # have √20 and the difference of two steps √6
        bends = np.abs(np.diff(step[:, j], 2))
        noisy = 2.0 * math.sqrt(6.0 / 20.0) * float(np.median(bends)) / MEDIAN
        several = np.abs(usual) > max(REPEATED_COUNTS * resolution[j], noisy)
        rows = 2 + np.flatnonzero((step[1:-1, j] == 0) & several[1:-1])
        for late in range(1, STEPS_AROUND + 1):
            rows = rows[rows + late < len(position)]
            far = usual[rows - 1]
            caught = np.abs(step[rows + late - 1, j] - 2.0 * far) < 0.5 * np.abs(far)
            for k in range(late - 1):
                out[rows[caught] + k, j] = position[rows[caught] + k + 1, j]
            unread = rows[caught] + late - 1
            out[unread, j] = _between_four(out[:, j], unread)
            rows, count = rows[~caught], count + late * len(unread)
    return out, count


def _between_four(y: Array, rows: npt.NDArray[np.int64]) -> Array:
    """The values at single rows of a series by those of the two rows before and after: of a cubic,
    or of a line where one of the outer rows is to be replaced too, or is not there.
    """
    inner = y[rows - 1] + y[rows + 1]
    first, last = rows - 2, np.minimum(rows + 2, len(y) - 1)
    whole = ~np.isin(first, rows) & ~np.isin(last, rows) & (rows + 2 < len(y))
    return np.asarray(np.where(whole, (4.0 * inner - y[first] - y[last]) / 6.0, 0.5 * inner))


def _of_another_rate(name: str, period: float, model: Model) -> RecordingError:
    stated, hold = model.sample_time or period, model.actuator.hold
    what = (
        "for recordings of several rates leave sample_time out of the model file. "
        + (f"Keep [actuator] hold = {hold:g}" if hold else "State [actuator] hold")
        + " if one loop ran at that sample time and a logger wrote fewer of its rows; leave hold"
        " out if each row is a sample of the loop"
    )
    if max(period / stated, stated / period) > UNIT:
        what = "check the unit of the time column"
    return RecordingError(
        f"{name}: samples are {period:.6g} s apart, the model says sample_time = {stated:.6g} s:"
        f" {what}"
    )


def _apart(name: str) -> str:
    return f" Give them as two files: {cutting(name, '-o', 'part.csv')} makes them"


def _forwards(name: str, column: str, time: Array, step: Array) -> None:
    """Refuse a time that runs backwards or stands still."""
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 2
        if not (step < 0).any():
            raise RecordingError(
                f"{name}: time column {column!r} stands still at row {row}, at"
                f" {time[row - 1]:.12g}: is it written with too few digits, or are rows there"
                " twice?"
            )
        raise RecordingError(
            f"{name}: time runs backwards at row {row}: are two runs glued together?{_apart(name)}"
        )


@dataclass(frozen=True)
class Clock:
    """The clock of a recording's rows: time of each row and sample time, s; notes on its stamps."""

    time: Array
    period: float
    notes: tuple[str, ...] = ()
    grid: Array | None = None  # s: where the stamps are not even, even times
    rounded: bool = False  # whether the stamps may be those of the even times, rounded


def clock(name: str, get: Getter, columns: Columns, model: Model, n: int) -> Clock:
    """The clock of a recording's ``n`` rows.

    Raises
    ------
    RecordingError
        There is no time; or it stands still, runs back, has a gap, or has not the model's rate.
    """
    stated = model.sample_time
    if "time" not in columns or not has(get, columns["time"]):
        if stated is None:
            raise RecordingError(
                f"{name}: has no time column {columns.get('time', 't')!r} and the model no"
                " sample_time"
            )
        return Clock(np.arange(n, dtype=np.float64) * stated, stated)
    time: Array = np.asarray(get(str(columns["time"])), dtype=np.float64)
    if time.ndim != 1 or not np.isfinite(time).all():
        raise RecordingError(
            f"{name}: time column {columns['time']!r} holds values that are not finite numbers"
        )
    step = np.diff(time)
    _forwards(name, str(columns["time"]), time, step)
    even, period = None, float(np.median(step))
    if float(np.max(np.abs(step - period))) >= JITTER * period:
        even = even_clock(time, stated)
        period = usual_step(time) if even is None else even.period
    if period > SLOWEST_CLOCK:
        raise RecordingError(
            f"{name}: samples are {period:.4g} s apart; a diagnosis needs at least 10 a second: is"
            f" the time column {columns['time']!r} in seconds?"
        )
    if stated and abs(period / stated - 1) > OTHER_UNIT:
        raise _of_another_rate(name, period, model)
    if is_gap(float(np.max(step)), period):
        k = int(np.argmax(step))
        raise RecordingError(
            f"{name}: a gap of {step[k]:.3g} s after row {k + 1}, {time[k] - time[0]:.4g} s from"
            f" the beginning: are two runs glued together?{_apart(name)}"
        )
    if even is not None:
        return _of_even(name, time, even, stated or even.period)
    if stated and abs(np.mean(step) / stated - 1) < EQUALS:
        period = stated
    if float(np.max(np.abs(step - period))) < JITTER * period:
        return Clock(time, float((time[-1] - time[0]) / (n - 1)))
    return _jittering(name, time, period)


def _of_even(name: str, time: Array, even: EvenClock, stated: float) -> Clock:
    """The clock of rows whose stamps are a rounding of an even one, of which some may be missing.
    """
    period, count = even.period, even.count
    grid, missing = time[0] + period * np.arange(count[-1] + 1), int(count[-1]) + 1 - len(count)
    notes = []
    if float(np.max(np.abs(time - grid[count]))) > JITTER * period:
        notes.append(
            f"{name}: its time stamps are those of an even clock, {period:.6g} s a sample, rounded"
            f" to {even.quantum:.3g} s"
            + (f" (the model says {stated:.6g} s)" if abs(period / stated - 1) > EQUALS else "")
        )
    if missing == 0:
        return Clock(time, period, tuple(notes), grid, rounded=True)
    notes.append(
        f"{name}: {counted(missing, 'row')} missing, all others evenly spaced (largest step"
        f" {np.max(np.diff(count)):.1f} samples)"
    )
    return Clock(grid[count], period, tuple(notes), grid)


def _jittering(name: str, time: Array, period: float) -> Clock:
    """The clock of rows whose stamps are neither even nor a rounding of even ones."""
    step = np.diff(time)
    whole = np.round(step / period)  # samples from one row to the next
    # a late stamp is no missing row: a step beside it is shorter
    padded = np.concatenate([[np.inf], step, [np.inf]])
    beside = step + np.minimum(padded[:-2], padded[2:])
    lacks = (whole > 1) & (np.round(beside / period) > MOST_OF_TWO)
    lacks &= step > period + A_ROW_LATE * np.median(np.abs(step - period)) / MEDIAN
    spread = float(np.std(step[~lacks])) / period
    missing = int(np.sum(whole - 1, where=lacks, initial=0.0))
    if missing and spread < EVEN:
        rows = f"{counted(missing, 'row')} missing, all others evenly spaced"
    else:
        rows = f"and {counted(missing, 'row')} missing" if missing else "no row is missing"
        of = "of the sample time"
        rows = f"the time from row to row jitters by {100 * spread:.1f} % {of}, {rows}"
    note = f"{name}: {rows} (largest step {np.max(step) / period:.1f} samples)"
    return Clock(time, period, (note,), np.arange(time[0], time[-1], period))


def evenly_read(of: Clock, position: Array) -> bool:
    """Whether rows were read evenly, whatever their stamps say, and none is missing: the motion is
    smoother over the number of rows than over the stamps; of stamps that are a rounding of an even
    clock, unless it is smoother over the stamps.
    """
    grid, time = of.grid, of.time
    if grid is None or abs(len(grid) - len(time)) > 1:
        return False
    by_row, by_stamp = (
        np.mean(np.diff(q, 4, axis=0) ** 2, axis=0)
        for q in (position, resample(grid, time, position))
    )
    moves = by_stamp > 0
    if not moves.any():
        return of.rounded
    ratio = left_by_lines(grid, time) * by_row[moves] / by_stamp[moves]
    rougher = float(np.exp(np.mean(np.log(np.maximum(ratio, 1e-12)))))
    return rougher < (1.0 / SMOOTHER if of.rounded else SMOOTHER)


def by_motion(of: Clock, name: str, position: Array) -> Clock:
    """The clock of a recording once its positions (n, joints) have said whether the rows were read
    evenly; notes tell what is done.
    """
    if of.grid is None:
        return of
    if not evenly_read(of, position):
        note = f"{name}: resampled uniformly, by the time stamps"
        of = replace(of, notes=(*of.notes, note))
        usual = float(np.median(np.diff(of.time)))
        if not (of.rounded and usual < of.period):
            return of
        # as finely as most rows stand, so that nothing between two of them is lost
        return replace(of, period=usual, grid=np.arange(of.time[0], of.time[-1], usual))
    why, n = "" if of.rounded else " the motion does not jitter:", len(of.time)
    notes = *of.notes, f"{name}:{why} its rows are taken as evenly spaced"
    period = of.period if of.rounded else float(of.time[-1] - of.time[0]) / (n - 1)
    return Clock(of.time[0] + period * np.arange(n), period, notes)


def resolution_of(
    name: str,
    columns: Columns,
    joint: int,
    position: Array,
    command: Array,
    model: Model,
    notes: list[str],
) -> float:
    """The step of a position column: that of the model, checked against the lattice of its numbers.
    """
    stated = per_joint(model.sensor.resolution, joint + 1, 0.0)
    y = position[:, joint]
    found = find_resolution(y)
    if stated <= 0:
        return found
    where = f"{name}: position {column_name(columns['position'], joint)!r}"
    if found > IN_COUNTS * stated and np.array_equal(y, np.round(y)):  # none is read in whole rad
        if model.sensor.matrix:
            return found  # ``stated`` is rad (m) a count, behind the matrix
        raise RecordingError(
            f"{where}: holds whole numbers, {found / stated:.4g} times the model's"
            f" position_resolution of {stated:.6g}: the column is in counts; say in the model what"
            f" one is: [sensor] matrix = [[{stated:.9g}]]"
        )
    if _on_lattice(y, stated):
        if found > COARSER * stated:
            notes.append(
                f"{where}: its smallest step is {found / stated:.4g} times the model's"
                f" position_resolution of {stated:.4g}: is it on the other side of a gear, or of"
                " another encoder?"
            )
        return stated
    if found > 0:
        for factor, words in ((180 / np.pi, "degrees, not radians"), (1e3, "milli-units")):
            if abs(found / stated / factor - 1) < UNITS:
                raise RecordingError(
                    f"{where}: its smallest step is {found:.6g}, {found / stated:.4g} times the"
                    f" model's position_resolution of {stated:.6g}: the column is in {words}"
                )
    if found < stated and any(_on_lattice(y, stated / part) for part in (2, 4, 8, 5, 10)):
        return stated  # fractions of a count: interpolated or averaged by the drive
    # its own, and not one of the multiples that a controller makes of counts
    own = find_resolution(command[:, joint]) if "command" in columns else 0.0
    if abs(own / stated - 1) < UNITS and _on_lattice(command[:, joint], stated, least=100):
        raise RecordingError(
            f"{where}: the command column has the sensor's resolution of {stated:.6g} and the"
            " position column has not: position and command are swapped"
        )
    notes.append(
        f"{where} does not lie on the model's position_resolution of {stated:.4g}; "
        + (f"its smallest step is {found:.4g}" if found else "no lattice is seen")
    )
    return found


def _on_lattice(y: Array, step: float, least: int = 0) -> bool:
    """Whether differences are whole steps, as far as the printed digits allow; ``least``: least
    number that must show it.
    """
    ratio = np.abs(np.diff(y)) / step
    ratio = ratio[(ratio > LATTICE[0]) & (ratio < LATTICE[1])]
    if len(ratio) < STEPS or len(ratio) < least:
        return least == 0
    return float(np.mean(np.abs(ratio - np.round(ratio)) < OFF)) > ON


def on_counts(values: Array, origin: Array, resolution: Array) -> Array:
    """Interpolated positions rounded to the sensor's counts, since the model of the quantiser holds
    for counts, not for their means.
    """
    step = np.where(resolution > 0, resolution, 1.0)
    counts: Array = np.where(
        resolution > 0, origin + step * np.round((values - origin) / step), values
    )
    return counts


def resample(grid: Array, time: Array, values: Array) -> Array:
    """Linear interpolation between the rows at the times of a uniform grid, (n, columns)."""
    return np.stack([np.interp(grid, time, column) for column in values.T], axis=1)


def between_stamps(grid: Array, time: Array) -> npt.NDArray[np.bool_]:
    """The times of a uniform grid at which no row was read, (n,); a stamp counts as even here as it
    does in ``clock``.
    """
    after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
    away = np.minimum(np.abs(grid - time[after - 1]), np.abs(time[after] - grid))
    out: npt.NDArray[np.bool_] = away > JITTER * (grid[1] - grid[0])
    return out


def left_by_lines(grid: Array, time: Array) -> float:
    """Part of white noise's variance that fourth differences see after `resample`: a point between
    two rows has less noise than either, and shares it with the next point.
    """
    white = np.random.default_rng(0).standard_normal((len(time), 1))
    return float(np.mean(np.diff(resample(grid, time, white), 4, axis=0) ** 2)) / FOURTH


def resample_held(grid: Array, time: Array, values: Array) -> Array:
    """The mean over each step of a uniform grid of values held from row to row, (n, columns).

    The last value before a grid time would be half a sample late.
    """
    period = float(grid[1] - grid[0])
    edges = np.append(grid, grid[-1] + period)
    ends = np.append(time, max(edges[-1], time[-1]) + period)
    out = []
    for column in values.T:
        sums = np.concatenate([[0.0], np.cumsum(column * np.diff(ends))])
        out.append(np.diff(np.interp(edges, ends, sums)) / period)
    return np.stack(out, axis=1)


def between_rows(s: Signals, hold: float) -> Signals:
    """A recording with the commands of a faster loop, each held for only a part of the time between
    rows. The mean command until the next row lies on the line to that row. White noise in the
    column is another at each step of the loop, beside that line. Each row ends one line and begins
    the next, so what two neighbouring lines miss is alike: of slow motion they miss all of the
    noise's part that nobody saw.
    """
    unseen = 1.0 - hold / s.sample_time
    if unseen < UNSEEN:
        return s
    white = np.mean(np.diff(s.command, 4, axis=0) ** 2, axis=0) / FOURTH
    command = s.command.copy()
    command[:-1] += 0.5 * unseen * np.diff(s.command, axis=0)
    beside = np.sqrt(white * unseen * (1.0 - 0.5 * unseen))  # of a single row
    usual = np.sqrt(np.mean(s.command**2, axis=0))
    share = 100.0 * float(np.max(beside / np.maximum(usual, 1e-300)))
    note = (
        f"{s.name}: the command is held for {hold:.4g} s ([actuator] hold) of the"
        f" {s.sample_time:.4g} s from row to row; in between, lines stand, which miss what the"
        f" loop does there by {share:.2g} % of the command"
    )
    if share > LINES_MISS:
        note += (
            ". Beside so much that nobody saw, what seems to come late, to swing or to turn with"
            " the joint may be nothing: record the command's mean from row to row, or every sample"
        )
    return replace(s, command=command, between=np.sqrt(white * unseen), notes=(*s.notes, note))


def decimated(signals: Signals) -> Signals:
    """The signals averaged down to a rate that a fit can afford, with the original ones as ``raw``;
    unchanged where that is no lower rate. Positions of a coarse sensor are not averaged.
    """
    seconds = len(signals.time) * signals.sample_time
    affordable = BUDGET / (seconds * signals.position.shape[1])
    rate = min(TARGET_RATE, max(SLOWEST_RATE, affordable))
    factor = int(1.0 / (signals.sample_time * rate) + 0.2)
    if factor < 2:
        return signals
    n = (len(signals.time) // factor) * factor
    half = (factor - 1) // 2  # overlapping windows would correlate the noise of neighbours

    def centred(values: Array) -> Array:  # mean over the samples around each kept sample
        padded = np.concatenate(
            [np.repeat(values[:1], half, axis=0), values, np.repeat(values[-1:], factor, axis=0)]
        )
        sums = np.cumsum(np.concatenate([np.zeros((1, values.shape[1])), padded]), axis=0)
        start = np.arange(0, n, factor)
        width = 2 * half + 1
        mean: Array = (sums[start + width] - sums[start]) / width
        return mean

    held = signals.command[:n].reshape(-1, factor, signals.command.shape[1]).mean(axis=1)
    # means of many counts within a sample are better than single ones; means of a few equal counts
    # at low speed only hide the counts
    few = half == 0 or 1 / signals.sample_time < MANY * TARGET_RATE
    counts = (signals.resolution > 0) & few
    white = signals.resolution / np.sqrt(12 * (2 * half + 1))
    least = np.zeros_like(white) if signals.least_noise is None else signals.least_noise
    note = (
        f"{signals.name}: {1 / signals.sample_time:.0f} Hz averaged down to"
        f" {1 / signals.sample_time / factor:.0f} Hz"
    )
    return replace(
        signals,
        time=signals.time[:n:factor],
        sample_time=signals.sample_time * factor,
        position=np.where(counts, signals.position[:n:factor], centred(signals.position)),
        command=held,
        reference=None if signals.reference is None else signals.reference[:n:factor],
        resolution=np.where(counts, signals.resolution, 0.0),
        least_noise=np.maximum(least, np.where(counts, 0.0, white)),
        extra={role: centred(values) for role, values in signals.extra.items()},
        notes=(*signals.notes, note),
        raw=signals,
    )
