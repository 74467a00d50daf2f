"""Sweeps: the same measurement of the running program with each of many sets of parameters."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from zendsp.errors import AcquisitionError, VariableError, ZendspError
from zendsp.experiment.sweep_result import Sweep, SweepRun, short
from zendsp.link import Target
from zendsp.link.put_back import kept
from zendsp.link.transfer import need_channels
from zendsp.prompt import shows_progress
from zendsp.recording import Recording
from zendsp.recording.names import split_element
from zendsp_protocol.messages import VariableInfo
from zendsp_protocol.states import ProgramState
from zendsp_protocol.texts import counted, units_of
from zendsp_protocol.values import Assignable

Floats = npt.NDArray[np.float64]
MEASURES: dict[str, Callable[[Floats], float]] = {
    "rms": lambda y: float(np.sqrt(np.mean(y * y))),
    "max": lambda y: float(np.max(np.abs(y))),
    "mean": lambda y: float(np.mean(y)),
    "std": lambda y: float(np.std(y)),
    "p2p": lambda y: float(np.ptp(y)),
}
MOST = 10_000  # runs
FADE_S = 1.0  # back from weak gains the planar arm asks for 123 N m at the most, in 2 s for 72
AGAIN = 2  # measurements of the best values after the last ones: how well a result repeats
WATCH_S = 0.2  # of the target's time: what is put back acts at once, and a speed builds up
PATIENCE_S = 2.0  # for a slow target to come so far


@shows_progress
def sweep(
    target: Target,
    values: Mapping[str, Sequence[Assignable]],
    channels: Sequence[str],
    *,
    seconds: float,
    settle: float = 0.5,
    fade: float = FADE_S,
    measures: Sequence[str] = ("rms", "max"),
    together: bool = False,
    keep: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
    on_run: Callable[[Sweep], None] | None = None,
) -> Sweep:
    """Try sets of parameters on the running program, one after the other, and measure each.

    Each set is faded in: within ``fade`` seconds of the target's time every number goes from its
    value before to the new one. Without it, strong gains after weak ones, with which the machine
    lags far behind, would pull it back with a jerk. The following ``settle`` seconds are not
    measured. At the end, and after Ctrl-C or an error, the parameters are restored in the same way;
    so they are when this host is lost. Where a limit trips or the program crashes, the sweep ends;
    the row says why, and so does ``ended``, which also tells what came afterwards.

    Each window is another piece of the motion. Therefore the best set is measured twice more after
    the last; the spread of its results is reported, and smaller differences between sets mean
    nothing. For a periodic motion choose ``seconds`` as whole periods: then all pieces are alike.

    Parameters
    ----------
    target : Target
        With a program that runs.
    values : mapping of str to sequence
        Values to try, by parameter; all combinations, the last parameter fastest.
    channels : sequence of str
        What is measured.
    seconds : float
        Length of each measurement, s.
    settle : float
        After each fade, s.
    fade : float
        s, at most 2; 0: each set takes effect in one sample.
    measures : sequence of str
        Of each channel: ``rms``, ``max`` (largest magnitude), ``mean``, ``std``, ``p2p``.
    together : bool
        The first values of all parameters, then the second ones …, in place of all combinations.
    keep : path, optional
        New or empty folder in which every recording is kept as ``001.mat``, ….
    progress : callable, optional
        Called with the fraction done; first, with 0, once all is checked.
    on_run : callable, optional
        Called after each run with the sweep as far as it came: what is left of it where Ctrl-C or
        an error ends it.

    Returns
    -------
    Sweep

    Raises
    ------
    VariableError
        A value that the program refuses: unknown, read only, beyond its limits. All values and
        channels are checked before the first run.
    AcquisitionError
        Nothing to try, an unknown measure, no such channel, or ``keep`` holds the recordings of
        another sweep.
    """
    runs = _runs(values, together)
    wrong = [name for name in measures if name not in MEASURES]
    if wrong or not measures:
        raise AcquisitionError(
            f"no measure {', '.join(map(repr, wrong))}; there are {', '.join(MEASURES)}"
        )
    for run in runs:
        target.request("check", values=dict(run))
    need_channels(target.request, channels, target.status())
    infos = target.variables()
    folder = Path(keep) if keep is not None else None
    if folder is not None and (old := sorted(folder.glob("[0-9]*.mat"))):
        raise AcquisitionError(
            f"{folder}: {counted(len(old), 'recording')} of another sweep, {old[0].name} the first:"
            " move them away, or keep these in another folder"
        )
    asked = [f"{m} {c}" for c in channels for m in measures]
    rows: list[SweepRun] = []
    again: list[Mapping[str, float]] = []
    why = ""

    def so_far() -> Sweep:
        # as measured: an array has several columns
        names = next(filter(None, (list(run.results) for run in rows)), asked)
        columns = {name: name.partition(" ")[2] for name in names}
        units = {name: _unit(infos, columns.get(name, name)) for name in (*values, *names)}
        found = tuple(rows), tuple(again)
        return Sweep(tuple(values), tuple(names), *found, why, units, len(runs), best)

    best, count = 0, len(runs) + (AGAIN if len(runs) > 1 else 0)
    if progress is not None:
        progress(0.0)
    with kept(target, values, fade=fade):
        for number in range(1, count + 1):
            if number == len(runs) + 1:
                best = so_far().best_row() or 0
            run = runs[number - 1] if number <= len(runs) else runs[best]
            tell = _part(progress, number - 1, count)
            recording, ended = _one(target, run, channels, settle + seconds, fade, tell)
            results = _measured(recording, measures, settle, ended)
            if number > len(runs):
                again += [results] if results else []
            else:
                rows.append(SweepRun(run, results, ended))
                if folder is not None and recording is not None:
                    recording.save(folder / f"{number:03}.mat")
            if on_run is not None:
                on_run(so_far())
            if progress is not None:
                progress(number / count)
            if ended:
                repeated = number > len(runs)
                why = f"{'the best values, again' if repeated else f'run {number}'}: {ended}"
                break
    if not why and (ended := _afterwards(target)):
        why = f"the parameters were put back: {ended}"
    return so_far()


def _unit(infos: Mapping[str, VariableInfo], name: str) -> str:
    """Of a variable, or of one of its elements; of a whole one whose elements differ, of each."""
    whole, element = split_element(name) or (name, None)
    info = infos.get(name) or infos.get(whole)
    if info is None or element is None or not element < info.length:
        return info.unit if info is not None else ""
    return units_of(info.unit, info.length)[element]


def _runs(
    values: Mapping[str, Sequence[Assignable]], together: bool
) -> list[dict[str, Assignable]]:
    lengths = {len(v) for v in values.values()}
    if not values or 0 in lengths:
        raise AcquisitionError("nothing to try: name parameters, and at least one value for each")
    if together and len(lengths) > 1:
        raise AcquisitionError(
            "together: as many values for each parameter; there are"
            f" {', '.join(f'{len(v)} of {n}' for n, v in values.items())}"
        )
    pick = zip(*values.values(), strict=True) if together else itertools.product(*values.values())
    runs = [dict(zip(values, found, strict=True)) for found in pick]
    if len(runs) > MOST:
        raise AcquisitionError(f"{len(runs)} runs; at most {MOST}: try fewer values")
    return runs


def announced(
    values: Mapping[str, Sequence[Assignable]],
    seconds: float,
    settle: float,
    together: bool,
    fade: float = FADE_S,
) -> str:
    """A sentence on how many runs a sweep has, and how long it takes at the least.

    Raises
    ------
    AcquisitionError
        Nothing to try, or too many runs.
    """
    runs = len(_runs(values, together))
    least = (runs + (AGAIN if runs > 1 else 0)) * (fade + settle + seconds)
    tried = ", ".join(
        f"{name} = {short(v[0])} … {short(v[-1])}" if len(v) > 1 else f"{name} = {short(v[0])}"
        for name, v in values.items()
    )
    time = f"{least:.0f} s" if least < 120.0 else f"{least / 60.0:.0f} min"
    return f"sweep of {counted(runs, 'run')}, {time} at the least: {tried}"


def _one(
    target: Target,
    run: Mapping[str, Assignable],
    channels: Sequence[str],
    seconds: float,
    fade: float,
    tell: Callable[[float], None] | None,
) -> tuple[Recording | None, str]:
    """The recording of one run, and why it ended early."""
    try:
        target.fade(fade, **run)
        recording = target.acquire(channels, seconds, progress=tell)
    except ZendspError:  # not running any more, or not for long enough
        if ended := _trouble(target):
            return None, ended
        raise
    return recording, _trouble(target)


def _part(
    progress: Callable[[float], None] | None, done: int, runs: int
) -> Callable[[float], None] | None:
    """The progress of one run as part of all runs."""
    if progress is None:
        return None
    tell = progress
    return lambda share: tell((done + share) / runs)


def _trouble(target: Target) -> str:
    """Why the program has stopped, in a sentence; "" where nothing stopped it."""
    status = target.status()
    return status.crash or (status.trip.text or status.trip.reason if status.trip else "")


def _afterwards(target: Target) -> str:
    """Why the program ended soon after the parameters were restored; "" where it goes on."""
    status, deadline = target.status(), time.monotonic() + PATIENCE_S
    end = status.tick + round(WATCH_S * target.info.rate_hz)
    while status.state == ProgramState.RUNNING and status.tick < end:
        if status.trip is not None or time.monotonic() >= deadline:
            break
        time.sleep(0.01)  # until the target's clock has come so far
        status = target.status()
    return _trouble(target)


def _measured(
    recording: Recording | None,
    measures: Sequence[str],
    settle: float,
    ended: str,
) -> dict[str, float]:
    if recording is None or ended:
        return {}
    after = recording.t >= recording.t[0] + settle - 1e-9
    matrix = recording.data[after]
    return {
        f"{m} {column}": MEASURES[m](matrix[:, k])
        for k, column in enumerate(recording.columns)
        for m in measures
    }


def tried_of(words: Sequence[str]) -> dict[str, list[float]]:
    """The values to try by parameter, from words such as ``Kp1=500:2500:5``, ``Kd1=60,120``.

    Parameters
    ----------
    words : sequence of str
        ``NAME=VALUES`` each; VALUES as `values_of` reads them.

    Raises
    ------
    VariableError
        Anything else.
    """
    tried = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not (name and equals):
            raise VariableError(f"{word!r}: expected NAME=VALUES, for example Kp1=100:500:5")
        try:
            tried[name] = values_of(text)
        except VariableError as error:
            raise VariableError(f"{name} = {error}") from None
    return tried


def _refuse_infinite(text: str) -> None:
    for part in text.replace(":", ",").split(","):
        try:
            finite = math.isfinite(float(part))
        except ValueError:  # no number: told with what is expected
            continue
        if not finite:
            raise VariableError(f"{text!r}: {part} is no finite number")


def values_of(text: str) -> list[float]:
    """The values in a text: ``100,200,400``, or ``100:500:5`` for five from 100 to 500.

    Raises
    ------
    VariableError
        Anything else.
    """
    parts = text.split(":")
    _refuse_infinite(text)
    try:
        count = int(parts[2]) if len(parts) == 3 else 0
        if len(parts) == 1:
            return [float(part) for part in text.split(",")]
        if 2 <= count <= MOST and float(parts[0]) != float(parts[1]):
            return [float(v) for v in np.linspace(float(parts[0]), float(parts[1]), count)]
        same = len(parts) == 3 and float(parts[0]) == float(parts[1])
        wrong = f"is one value {count} times" if same else "is no list of values"
    except ValueError:
        wrong = "is no list of values"
    raise VariableError(
        f"{text!r} {wrong}: write 100,200,400 or FIRST:LAST:COUNT, for example 100:500:5 for"
        " 100, 200, 300, 400, 500"
    )
