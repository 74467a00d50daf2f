"""The steps that remain until the program runs, from any state of a target."""

from __future__ import annotations

import pytest

from zendsp.link.programs import trouble
from zendsp.link.way_back import said, way_back
from zendsp_protocol.messages import Condition, DriveStatus, Status, Trip

LOST = Trip("host lost", tick=7, text="the host that commanded the motion is gone")
OUT = Trip("position", 1, 7, 1.2, 1.0, cause="it is beyond the limit")
NO_MOTOR = Trip("torque", 2, 7, 0.5, 0.0, cause="the code writes to a joint without a motor")
NOT_THERE = Trip("outside", 0, 7, 1.0, 1.0, cause="the code names a joint that is not there")
NO_JOINT = Trip("command", 3, 7, 50.0, 0.0, cause="the code writes to joint 3")
NO_NUMBER = Trip("nan", 1, 7, float("nan"), 0.0, cause="the code computed nan")
FELL = Trip("position", 4, 7, 3.2, 3.1, cause="the program commands it 0", idle=True)
TOO_MUCH = Trip("torque", 1, 7, 5.0, 4.0, cause="it exceeds the limit")


def conditions(**unmet: str) -> tuple[Condition, ...]:
    """The conditions, of which all but these are met."""
    names = ("power", "program", "homed", "limits", "sensors", "stop input", "no trip")
    return tuple(
        Condition(name=n, met=(key := n.replace(" ", "_")) not in unmet, advice=unmet.get(key, ""))
        for n in names
    )


@pytest.mark.parametrize(
    ("state", "trip", "drive", "explicit", "unmet", "steps"),
    [
        ("running", None, "running", True, {}, ()),
        ("paused", None, "homed", False, {}, ("start",)),
        ("loaded", None, "enabled", True, {}, ("start",)),
        ("loaded", None, "homed", True, {}, ("enable", "start")),
        ("stopped", LOST, "stopped", True, {"no_trip": "x"}, ("acknowledge", "enable", "start")),
        ("stopped", LOST, "stopped", False, {"no_trip": "x"}, ("acknowledge", "start")),
        # homing begins the explicit sequence
        ("loaded", None, "ready", False, {"homed": "x"}, ("home", "enable", "start")),
        ("loaded", None, "off", True, {"power": "x"}, ("power", "enable", "start")),
        ("crashed", None, "ready", False, {"program": "x", "homed": "x"}, ("build", "start")),
        ("stopped", OUT, "tripped", False, {"no_trip": "x"},
         ("acknowledge", "home", "enable", "start")),
        ("stopped", OUT, "tripped", True, {"no_trip": "x", "homed": "x"},
         ("acknowledge", "home", "enable", "start")),
        # it would do the same again
        ("stopped", FELL, "tripped", False, {"no_trip": "x"},
         ("acknowledge", "change the program", "build", "home", "enable", "start")),
        ("stopped", NO_MOTOR, "tripped", False, {"no_trip": "x"},
         ("acknowledge", "change the program", "build", "start")),
        ("stopped", NO_JOINT, "tripped", True, {"no_trip": "x"},
         ("acknowledge", "change the program", "build", "enable", "start")),
        ("stopped", NO_NUMBER, "tripped", False, {"no_trip": "x"},
         ("acknowledge", "change the program", "build", "start")),
        ("stopped", NOT_THERE, "tripped", False, {"no_trip": "x"},
         ("acknowledge", "change the program", "build", "start")),
        ("stopped", TOO_MUCH, "tripped", False, {"no_trip": "x"}, ("acknowledge", "start")),
        # it went on while the drives were off
        ("running", None, "homed", True, {}, ("pause", "enable", "start")),
        (
            "stopped", LOST, "stopped", True, {"no_trip": "x", "stop_input": "release it"},
            ("release it", "acknowledge", "enable", "start"),
        ),
    ],
)  # fmt: skip
def test_the_steps_come_in_the_order_in_which_they_are_granted(
    state: str, trip: Trip | None, drive: str, explicit: bool, unmet: dict[str, str],
    steps: tuple[str, ...],
) -> None:
    status = Status(state, trip=trip)  # type: ignore[arg-type]
    now = DriveStatus(state=drive, explicit=explicit, conditions=conditions(**unmet))  # type: ignore[arg-type]
    assert way_back(status, now) == steps


def test_taking_the_right_to_command_comes_first_and_a_held_program_is_told_to_go_on() -> None:
    drive = DriveStatus(state="homed", explicit=True, commander="anna@a:1")  # type: ignore[arg-type]
    paused, running = Status("paused"), Status("running")  # type: ignore[arg-type]
    assert way_back(paused, drive)[0] == "command"
    assert way_back(paused, drive, "anna@a:1")[0] == "enable"
    going = DriveStatus(state="running", explicit=True)  # type: ignore[arg-type]
    assert way_back(running, going, held=True) == ("go_on",)
    assert said(("go_on",), "imi", "tls/lab:7447") == (
        "zendsp set hold=false -t imi --connect tls/lab:7447"
    )


@pytest.mark.parametrize(
    ("trip", "explicit", "empty", "end"),
    [
        (OUT, False, False, "home, enable and start again"),
        (LOST, False, False, "start again"),
        (LOST, True, False, "enable and start again"),
        (LOST, True, True, "load a program, enable and start it"),
        (NO_MOTOR, False, False, "change the program, load it and start it"),
    ],
)
def test_the_sentence_on_a_trip_names_the_same_steps(
    trip: Trip, explicit: bool, empty: bool, end: str
) -> None:
    """It said "start again" where the line *next* said to home first."""
    status = Status("empty" if empty else "stopped", drive="tripped", trip=trip)  # type: ignore[arg-type]
    now = DriveStatus(state="tripped", explicit=explicit, conditions=conditions(no_trip="x"))  # type: ignore[arg-type]
    said = trouble(status, now)
    assert said.endswith(f"'zendsp drive acknowledge' or acknowledge(), then {end}")
    if not explicit:
        assert trouble(status) == said, "all of it follows from the trip"


@pytest.mark.parametrize("text", ["too fast (sample 7); outputs are safe", "in other words"])
def test_a_latched_trip_is_recognised_by_cause_and_sample_and_not_by_its_sentence(
    text: str
) -> None:
    trip = Trip("speed", tick=7, text=text, cause="too fast")
    tripped = Status(state="stopped", drive="tripped", trip=trip)
    assert trouble(tripped).startswith("tripped: too fast (sample 7); outputs are safe;")


@pytest.mark.parametrize(("trip", "away", "steps"), [
    (OUT, False, ("home", "enable", "start")),
    (None, True, ("home", "enable", "start")),
    (NOT_THERE, False, ("change the program", "build", "start")),
    (LOST, False, ("start",)),
])  # fmt: skip
def test_what_led_to_a_trip_is_there_still_when_it_is_acknowledged(
    trip: Trip | None, away: bool, steps: tuple[str, ...]
) -> None:
    """The line "next" led to the same trip again."""
    drive = DriveStatus(state="homed")  # type: ignore[arg-type]
    stopped = Status("stopped")  # type: ignore[arg-type]
    assert way_back(stopped, drive, away=away, acknowledged=trip) == steps
