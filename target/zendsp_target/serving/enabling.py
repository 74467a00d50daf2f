"""The conditions of enabling the drives, each with what to do where it does not hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from zendsp_protocol.errors import ZendspError
from zendsp_protocol.messages import Condition, Status
from zendsp_protocol.states import ProgramState
from zendsp_target.api import PRESSED, RuntimeApi


def conditions(status: Status, powered: bool, runtime: RuntimeApi) -> tuple[Condition, ...]:
    """The conditions of enabling; the advice is empty where a condition holds.

    Parameters
    ----------
    powered : bool
        Whether the drives have power, or need none of the sequence.
    """
    there, trip = loaded(status), status.trip
    unknown = "" if there else "known once a program is loaded"
    found = (
        ("power", powered, "switch the drives' power on (zendsp drive on)"),
        (
            "program",
            there,
            f"no code is loaded (the program is {status.state}): download a program",
        ),
        (
            "homed",
            status.homed and there,
            unknown
            or "the position is unknown: home the machine (zendsp drive home); each load asks for"
            " it anew",
        ),
        (
            "limits",
            _limits_set(runtime),
            unknown or "torque, speed and position limits must be finite: set them",
        ),
        (
            "sensors",
            there and _finite(status.io.get("enc")) and not _faults(status),
            unknown
            or _faults(status)
            or "no position comes from the machine: check its sensors, load the program again",
        ),
        ("stop input", there and not status.pressed, unknown or PRESSED),
        (
            "no trip",
            trip is None,
            f"{trip.text or trip.reason}: acknowledge it (zendsp drive acknowledge)"
            if trip
            else "",
        ),
    )
    return tuple(
        Condition(name=name, met=met, advice="" if met else advice)
        for name, met, advice in found
    )


def loaded(status: Status) -> bool:
    """Whether a program is loaded and has not crashed."""
    return status.state not in (ProgramState.EMPTY, ProgramState.CRASHED)


def refusal(what: str, failing: Sequence[Condition]) -> str:
    """The refusal of an action, naming each condition that fails."""
    names: dict[str, list[str]] = {}
    for c in failing:
        names.setdefault(c.advice, []).append(c.name.removeprefix("no "))
    return f"{what} is refused: " + "; ".join(
        f"{', '.join(same)}: {advice}" for advice, same in names.items()
    )


def _limits_set(runtime: RuntimeApi) -> bool:
    try:
        limits = runtime.limits()
    except ZendspError:
        return False
    rows = (limits.position_min, limits.position_max, limits.speed_max, limits.torque_max)
    return all(len(row) > 0 and all(math.isfinite(x) for x in row) for row in rows)


def _faults(status: Status) -> str:
    """The position sensors that report a fault while the machine rests, in a sentence; empty where
    there are none.
    """
    bad = np.flatnonzero(np.asarray(status.io.get("fault", ())))
    joints = f"joint{'s' * (len(bad) > 1)} {', '.join(str(j + 1) for j in bad)}"
    return f"the machine reports a fault of {joints}: mend it, load the program again" * bool(
        len(bad)
    )


def _finite(values: Any) -> bool:
    return values is not None and len(values) > 0 and all(math.isfinite(float(v)) for v in values)
