"""Cuts recordings into those to fit to, to choose by, and to test on."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.checks import check_signals
from zendsp.diagnosis.data.reading import Source, Told, read_signals
from zendsp.diagnosis.data.sampling import whole_second
from zendsp.diagnosis.data.series import stretches
from zendsp.diagnosis.data.signals import MIN_SAMPLES, Signals, with_same_columns
from zendsp.errors import RecordingError
from zendsp.physics.kernel.smooth import moving_mean
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

# s, also cut out before and after: an observer is late, and a joint swings on
PUSH_MARGIN_S = 0.25
# of its travel: a joint that moves less rests; a joint held by its loop while another moved had
# 0.05
RESTS = 0.1
# into which a held-out recording is cut, to be dealt out by turns: the fewest with which the same
# joints move in both parts
PIECES = (2, 4, 6, 8, 12, 16)
LEFT = 0.5  # of the rows: least that must be left
# of the travel: a joint this near to its end position rests; and s: a rest at the end this long is
# left out. Chosen on one arm that crept by 0.002 of its travel in eight seconds
AT_REST, REST_S = 0.002, 2.0


def read_divided(
    recordings: Sequence[Source],
    heldout: Sequence[Source],
    model: Model,
    tell: Told | None = None,
) -> tuple[list[Signals], list[Signals], list[str]]:
    """Recordings to fit to and held-out ones, read and checked; and notes. ``tell``: as of
    ``read_signals``.

    Raises
    ------
    RecordingError
        None is given, one cannot be diagnosed, or one is both to fit to and held out.
    """
    signals = [read_signals(source, model, tell) for source in recordings]
    if not signals:
        raise RecordingError("no recording given")
    held = [read_signals(source, model, tell) for source in heldout]
    _refuse_twice(signals, held)
    begin = min(float(s.time[0]) for s in (*signals, *held))
    signals, held = ([replace(s, origin=begin) for s in each] for each in (signals, held))
    told: list[str] = []
    signals, held = (_each_once(each, told) for each in (signals, held))
    notes = [*check_signals([*signals, *held], model), *told]
    signals, held = with_same_columns(signals, held)
    if held:
        return signals, held, notes
    signals, held, how = split(signals)
    return signals, held, [*notes, *how]


def _is_same(s: Signals, h: Signals) -> bool:
    """Whether two recordings have the same rows."""
    return len(s.time) == len(h.time) and all(
        np.array_equal(a, b) for a, b in ((s.position, h.position), (s.command, h.command))
    )


def _each_once(signals: Sequence[Signals], told: list[str]) -> list[Signals]:
    """The recordings without those that have the rows of an earlier one, which are told: they would
    make everything seem twice as sure.
    """
    out: list[Signals] = []
    for s in signals:
        first = next((o for o in out if _is_same(s, o)), None)
        if first is None:
            out.append(s)
        else:
            same = f"{s.name} has the same rows as {first.name}"
            told.append(f"{same}: given twice, it says no more, and counts once")
    return out


def _refuse_twice(fitted: Sequence[Signals], held: Sequence[Signals]) -> None:
    """Refuse a recording that is both to fit to and held out."""
    for h in held:
        for s in fitted:
            if _is_same(s, h):
                raise RecordingError(
                    f"{h.name}: held out, and the same as {s.name}, which the model is fitted to:"
                    " hold out another recording, or none (a third of each is held out then)"
                )


def split(signals: Sequence[Signals]) -> tuple[list[Signals], list[Signals], list[str]]:
    """The recordings, with the last third of each one's motion held out.

    Returns
    -------
    train, test, notes
    """
    train, test, cuts, notes = [], [], [], []
    for whole in signals:
        s, rest = _until_rest(whole)
        notes += rest
        n = len(s.time)
        cut = int(
            np.clip(
                np.searchsorted(_way(s), 2 / 3), min(MIN_SAMPLES, n // 2),
                n - min(MIN_SAMPLES, n // 3),
            )
        )
        begin = whole_second(float(s.time[0]))
        after = f" after {begin:.0f} s" if begin else ""
        cuts.append(f"{s.name} from {s.time[cut] - begin:.2f} s{after} on")
        train.append(s.part(0, cut, _called(s.name, "first part")))
        test.append(s.part(cut, len(s.time), _called(s.name, "last part")))
    each = "its motion" if len(cuts) == 1 else "the motion of each"
    note = f"no recording was given to judge on; held out: {', '.join(cuts)}, the last third of"
    return train, test, [*notes, f"{note} {each}"]


def _called(name: str, part: str) -> str:
    """The name of a part of a recording, all parts in one bracket: run.csv (last part, to test on).
    """
    whole, bracket, outer = name.partition(" (")
    return f"{whole} ({outer[:-1]}, {part})" if bracket else f"{name} ({part})"


def _until_rest(s: Signals) -> tuple[Signals, list[str]]:
    """A recording without the rest at its end, and a note on that. A machine at rest shows nothing,
    and the missing torque would be a smaller part of a longer time.
    """
    span = np.ptp(s.position, axis=0)
    away = np.any(np.abs(s.position - s.position[-1]) > AT_REST * span, axis=1)
    moves = int(np.flatnonzero(away)[-1]) + 1 if away.any() else len(s.time)
    if moves < 2 * MIN_SAMPLES or (len(s.time) - moves) * s.sample_time < REST_S:
        return s, []
    end = moves + round(PUSH_MARGIN_S / s.sample_time)
    at = float(s.time[moves] - s.time[0])
    note = f"{s.name}: stands from {at:.2f} s after its begin to its end, which is left out"
    return s.part(0, end, s.name), [note]


def halves(held: Sequence[Signals]) -> tuple[list[Signals], list[Signals], list[str]]:
    """Recordings to choose by and to test on: whole ones where there are several, if the same
    joints move in both or one is too short to divide; otherwise the halves of each.

    Returns
    -------
    choose, test, notes
        The same list twice, where all are too short to divide.
    """
    middle = len(held) // 2
    if middle and _moved(held[:middle], held) == _moved(held[middle:], held):
        return list(held[:middle]), list(held[middle:]), []
    long = [s for s in held if len(s.time) >= 2 * MIN_SAMPLES]
    if middle and len(long) < len(held):
        return list(held[:middle]), list(held[middle:]), []
    if not long:
        note = (
            f"{held[0].name}: too short to be divided: what was chosen by it is tested on it too,"
            " so the tested figures flatter"
        )
        return (both := list(held)), both, [note]
    for pieces in PIECES:
        choose, test = _by_turns(long, pieces)
        if _moved(choose, held) == _moved(test, held):
            return choose, test, []
    choose, test = _by_turns(long, PIECES[0])
    return choose, test, [_in_one_only(choose, test, held)]


def _in_one_only(
    one: Sequence[Signals], other: Sequence[Signals], every: Sequence[Signals]
) -> str:
    """A note on the joints that move in one part only."""
    joints = sorted(j + 1 for j in _moved(one, every) ^ _moved(other, every))
    which = f"joint{'s' * (len(joints) > 1)} {', '.join(map(str, joints))}"
    return (
        f"{which}: in one half of what is held out there is no motion, and a test needs it in both:"
        " hold out a recording in which each joint moves twice"
    )


def _by_turns(
    signals: Sequence[Signals], pieces: int
) -> tuple[list[Signals], list[Signals]]:
    """Recordings cut into pieces of equal motion, which are dealt out by turns to choose by and to
    test on. A recording whose pieces would be too short is halved.
    """
    parts: tuple[list[Signals], list[Signals]] = [], []
    for s in signals:
        way, n = _way(s), len(s.time)
        cuts = [0, *np.searchsorted(way, np.arange(1, pieces) / pieces).tolist(), n]
        if min(np.diff(cuts)) < MIN_SAMPLES:
            half = np.clip(np.searchsorted(way, 0.5), MIN_SAMPLES, n - MIN_SAMPLES)
            cuts = [0, int(half), n]
        for k, (a, b) in enumerate(itertools.pairwise(cuts)):
            words = ("to choose by", "to test on")[k % 2]
            parts[k % 2].append(s.part(a, b, _called(s.name, words)))
    return parts


def _moved(some: Sequence[Signals], every: Sequence[Signals]) -> frozenset[int]:
    """The joints (from 0) that move in some recordings by more than a resting joint."""
    here, there = (
        np.max([np.ptp(s.position, axis=0) for s in signals], axis=0) for signals in (some, every)
    )
    return frozenset(np.flatnonzero(here > RESTS * there).tolist())


def cut_out(signals: Sequence[Signals], spans: Sequence[tuple[str, float, float]]) -> list[Signals]:
    """The recordings without some times (name, begin and end in s); empty where too little is left.
    """
    out: list[Signals] = []
    for s in signals:
        name, n = s.whole or s.name, len(s.time)
        bad = np.zeros(n, bool)
        for of, begin, end in spans:
            bad |= (of == name) & (s.time > begin - PUSH_MARGIN_S) & (s.time < end + PUSH_MARGIN_S)
        pieces = stretches(~bad)
        if pieces == [(0, n)]:
            out.append(s)
            continue
        out += [s.part(a, b, _called(s.name, "quiet")) for a, b in pieces if b - a >= MIN_SAMPLES]
    rows, left = (sum(len(s.time) for s in part) for part in (signals, out))
    return out if left >= LEFT * rows else []


def _way(s: Signals) -> Array:
    """The share of the path covered at each row, (n,), as the mean over the joints, with sensor
    noise averaged out.
    """
    block = max(1, round(0.02 / s.sample_time))
    columns = [moving_mean(q, block, "edge")[::block] for q in s.position.T]
    means = np.stack(columns, axis=1)
    way = np.cumsum(np.abs(np.diff(means, axis=0, prepend=means[:1])), axis=0)
    way = way[:, way[-1] > 0]
    share = np.mean(way / way[-1], axis=1) if way.shape[1] else np.linspace(0.0, 1.0, len(means))
    out: Array = np.interp(np.arange(len(s.time)), np.arange(len(means)) * block, share)
    return out
