"""Swings one joint about its present position, from the tables of the loaded program."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from zendsp.errors import AcquisitionError, Refused, ZendspError
from zendsp.experiment.player import Player, position
from zendsp.here.stopped import ended
from zendsp.link import Target, rehearse
from zendsp.link.rehearse import passed
from zendsp.recording import Recording
from zendsp_protocol.states import STOPS, Clock, ProgramState

Floats = npt.NDArray[np.float64]
APPROACH_S = 0.5  # from where the machine stands into the first row
FADE = 0.5  # of a period: in within the first, out after the last


def play(
    target: Target,
    make: Callable[[Floats], Floats],
    *,
    joint: int,
    quantity: str,
    seconds: float,
    times: int,
    channels: list[str],
    rehearsed: bool,
    progress: Callable[[float], None] | None = None,
) -> tuple[Recording, int]:
    """Play a period several times and record it.

    Afterwards the machine is at its position before, and the program does what it did before.
    `Player` describes an early end, also by Ctrl-C.

    Parameters
    ----------
    make : callable
        Values of a period at times, s; periodic.
    joint : int
        From 1.
    quantity : {"position", "torque"}
    seconds : float
        Length of the period, a multiple of the sample time.
    times : int
        How often.
    rehearsed : bool
        Try it on a simulated twin first, where the clock is real.

    Returns
    -------
    recording : Recording
        Every sample.
    first : int
        Its row at which the first period begins.
    """
    status = target.status()
    if status.trip is not None:
        raise Refused(f"{status.trip.text}: acknowledge it first")
    tables, row_rate = _tables(target, make, joint, quantity, seconds, times)
    values = {"use_table": True, "row_rate": row_rate, "approach_time": APPROACH_S, "hold": False}
    length = APPROACH_S + seconds * times + FADE * seconds
    player = Player(target, tables, values, channels, length, progress=progress)
    if rehearsed and target.info.clock == Clock.REAL:
        found = rehearse(target, tables, player.values, length, _sign_of_life(progress))
        if found.simulated and found.trip is not None:
            seen = passed(found.trip, target.info.rate_hz)
            raise Refused(f"not played: {seen}; take less amplitude, or lower the gains")
    try:
        recording, begin = player.play()
    except ZendspError:
        _refuse_trip(target)  # that it tripped says more than that rows are missing
        raise
    _refuse_trip(target)
    rate = target.info.rate_hz
    return recording, begin + round(APPROACH_S * rate) - recording.start_tick


def _sign_of_life(progress: Callable[[float], None] | None) -> Callable[[float], None] | None:
    """A callback for a rehearsal that calls ``progress`` with 0: nothing is done yet, but it can be
    interrupted.
    """
    if progress is None:
        return None
    tell = progress
    return lambda _: tell(0.0)


def _refuse_trip(target: Target) -> None:
    trip = target.status().trip if target.alive else None
    if trip is not None:
        less = "; take less amplitude" if trip.reason not in STOPS else ""
        raise Refused(f"{ended(trip)}{less}")


def _tables(
    target: Target,
    make: Callable[[Floats], Floats],
    joint: int,
    quantity: str,
    seconds: float,
    times: int,
) -> tuple[dict[str, Floats], int]:
    """The rows of every table, in the order in which they are sent, and the number of rows a
    second.
    """
    infos = target.variables()
    needed = ["ref", "use_table", "row_rate", "approach_time"]
    needed += ["ref_tau"] if quantity == "torque" else []
    lacking = [name for name in needed if name not in infos]
    if lacking:
        raise Refused(
            f"the loaded program lacks {', '.join(lacking)}: load one that plays tables, for"
            " example joint_pd.c (docs/references.md, 'How a program plays it')"
        )
    # of a program that is paused it says what was; it begins anew
    running = target.status().state == ProgramState.RUNNING
    if running and "playing" in infos and target["playing"]:
        raise Refused("a reference is being played: wait for its end")
    here = np.atleast_1d(np.asarray(position(target), dtype=np.float64))
    if not 1 <= joint <= len(here):
        raise Refused(f"joint {joint}: the machine has {len(here)}, counted from 1")
    rate = target.info.rate_hz
    room = infos["ref"].length // len(here)
    step = int(np.ceil((seconds * (times + FADE) * rate + 1) / room))  # samples a row
    while round(seconds * rate) % step or round(rate) % step:
        step += 1
        if step > rate:
            raise AcquisitionError(
                f"{times} periods of {seconds:g} s do not fit into the {room} rows of the table"
                " ref: raise f_min, or take fewer periods"
            )
    period = round(seconds * rate) // step
    t = np.arange(int(period * (times + FADE)) + 1) / period  # periods
    rows = len(t)
    swing = _fade(t, times) * make(t * seconds)
    motion, torque = np.tile(here, (rows, 1)), np.zeros((rows, len(here)))
    (motion if quantity == "position" else torque)[:, joint - 1] += swing
    tables = {"ref_tau": torque} if "ref_tau" in infos else {}
    return {**tables, "ref": motion}, round(rate / step)


def _fade(t: Floats, times: int) -> Floats:
    """A smooth factor: from 0 to 1 within the first periods, and back to 0 after the last."""
    share = np.clip(np.minimum(t, times + FADE - t) / FADE, 0.0, 1.0)
    return np.asarray(share**3 * (10.0 + share * (6.0 * share - 15.0)))
