"""The steps that remain until the program of a target runs: after a STOP, a trip, a lost host, or
at the beginning.
"""

from __future__ import annotations

from zendsp_protocol import messages as m
from zendsp_protocol.states import DriveState, ProgramState, TripReason

# a step by the name of the terminal's action, and the command that takes it; any other step is a
# sentence
COMMANDS = {
    "command": "zendsp drive take --force",
    "acknowledge": "zendsp drive acknowledge",
    "pause": "zendsp pause",
    "build": "zendsp load FILE",
    "power": "zendsp drive on",
    "home": "zendsp drive home",
    "enable": "zendsp drive enable",
    "start": "zendsp run",
    "go_on": "zendsp set hold=false",
}
# of them all, after `acknowledge` in a sentence
WORDS = {
    "command": "take the right to command", "build": "load a program",
    "power": "switch the power on", "home": "home", "enable": "enable", "start": "start again",
}  # fmt: skip
CHANGE = "change the program"  # which would do the same again
HOLD = "hold"  # the parameter by which a lost host, or an abort, brings a program to rest


def way_back(
    status: m.Status, drive: m.DriveStatus | None, me: str = "", held: bool = False,
    away: bool = False, acknowledged: m.Trip | None = None,
) -> tuple[str, ...]:
    """The steps in their order, as names in `COMMANDS` or as sentences; none where the program
    runs.

    Parameters
    ----------
    status : Status
    drive : DriveStatus, optional
        Of the same moment. None where it is not known: the drives are taken for automatic ones
        that only the trip keeps from running.
    me : str
        The host that asks: it need not take the right to command from itself.
    held : bool
        Whether the program's parameter ``hold`` is set.
    away : bool
        Whether a joint stands outside its limits.
    acknowledged : Trip, optional
        What was acknowledged just now: what led to it is there still.
    """
    drive = drive or m.DriveStatus(state=status.drive)
    unmet = {c.name: c.advice for c in drive.conditions if not c.met}
    gone = status.state in (ProgramState.EMPTY, ProgramState.CRASHED)
    there = "program" not in unmet and not gone
    running = status.state == ProgramState.RUNNING and status.trip is None
    off = drive.explicit and drive.state in (DriveState.OFF, DriveState.READY, DriveState.HOMED)
    if running and not off:
        steps = ["go_on"] if held else []
    else:
        trip = status.trip or acknowledged
        # a program that went out of the range would go there again
        outside = away or (trip is not None and trip.reason == TripReason.POSITION)
        home = there and (outside or "homed" in unmet)
        enable = (drive.explicit or home) and drive.state != DriveState.ENABLED
        change = there and trip is not None and _by_the_code(trip)
        needed = {
            "acknowledge": status.trip is not None, "pause": running, CHANGE: change,
            "build": change or not there,
            "power": "power" in unmet, "home": home, "enable": enable, "start": True,
        }  # fmt: skip
        # what no command can solve comes first: nothing else is granted before
        first = [unmet[name] for name in ("stop input", "sensors", "limits") if name in unmet]
        steps = first * there + [name for name, yes in needed.items() if yes]
    other = drive.commander not in ("", me)
    return tuple(["command"] * bool(steps and other) + steps)


def _by_the_code(trip: m.Trip) -> bool:
    """Whether the code itself is wrong: it named a joint that is not there, left one to its weight,
    or wrote what is no command: no number, or to an output that the machine has not, which has no
    limit.
    """
    nowhere = trip.reason in (TripReason.TORQUE, TripReason.COMMAND) and trip.limit == 0.0
    return nowhere or trip.idle or trip.reason in (TripReason.NAN, TripReason.OUTSIDE)


def after(status: m.Status, drive: m.DriveStatus | None) -> str:
    """What is to be done once a trip is acknowledged, as the end of a sentence.

    Examples
    --------
    >>> after(m.Status("stopped", trip=m.Trip("position")), None)
    'home, enable and start again'
    """
    steps = [step for step in way_back(status, drive) if step in WORDS or step == CHANGE]
    own = {"start": "start it"} if "build" in steps else {}
    if CHANGE in steps:
        own["build"] = "load it"
    words = [own.get(step) or WORDS.get(step, step) for step in steps]
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last


def said(steps: tuple[str, ...], target: str = "", connect: str | None = None) -> str:
    """The steps as commands to type one after another, "" where there are none.

    Parameters
    ----------
    target, connect : str
        As the user named the target; empty where there was no need to.
    """
    where = which(target, connect)
    return ", then ".join(
        f"{COMMANDS[step]}{where}" if step in COMMANDS else step for step in steps
    )


def which(target: str, connect: str | None) -> str:
    """The options of a command that name a target as the user did; empty where it was not."""
    return f" -t {target}" * bool(target) + f" --connect {connect}" * bool(connect)
