"""Vast numbers are refused or bounded, and other users do not notice."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable

import pytest
from desk import desk_of
from waiting import until

from zendsp_protocol.errors import AcquisitionError, Refused, VariableError
from zendsp_protocol.messages import Trigger
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime
from zendsp_target.serving.live_streams import LiveStreams

Make = Callable[..., Runtime]
PROGRAM = """#include "isr.h"
double a = 1.0, x;
void UserInit(void) { PARAMETER(a, 1.0, "", 0.0, 10.0, ""); SIGNAL(x, "", ""); }
void UserISR_INT2(void) { x += a; }
void UserBackground(void) {}
"""
NOT_FINITE = (1e308, float("inf"), float("nan"))


@pytest.mark.parametrize("seconds", NOT_FINITE)
def test_a_vast_recording_is_refused_with_its_time(make_runtime: Make, seconds: float) -> None:
    runtime = make_runtime(PROGRAM)
    with pytest.raises(AcquisitionError, match="give a finite time"):
        runtime.acquire_configure(0, AcquireConfig(("x",), seconds=seconds))
    trigger = Trigger("x", 0.0, "rising", seconds)
    with pytest.raises(AcquisitionError, match="pre_s"):
        runtime.acquire_configure(0, AcquireConfig(("x",), trigger=trigger))


@pytest.mark.parametrize("interval", [*NOT_FINITE, 60.0])
def test_a_slow_live_view_does_not_delay_others(make_runtime: Make, interval: float) -> None:
    runtime = make_runtime(PROGRAM, clock="real", realtime=False)
    messages: list[float] = []
    live = LiveStreams(runtime, lambda *_: messages.append(time.monotonic()), lambda *_: True)
    try:
        runtime.start()
        live.open(["x"], 1, interval, 16, "rare", "rare")
        until(lambda: len(messages) > 0 or interval != interval or _asleep(live), "a first look")
        before = len(messages)
        live.open(["a"], 1, 0.01, 16, "other", "other")
        until(lambda: len(messages) > before + 5, "rows of the other viewer")
        before = len(messages)
        live.open(["x"], 1, 0.01, 16, "joins", "joins")  # the stream that is hardly ever looked at
        until(lambda: len(messages) > before + 20, "rows of the viewer that joined")
    finally:
        live.close()


def test_a_live_stream_that_fails_for_a_while_ends_no_other(
    make_runtime: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    runtime = make_runtime(PROGRAM, clock="real", realtime=False)
    messages: list[int] = []
    live = LiveStreams(runtime, lambda *_: messages.append(1), lambda *_: True)
    try:
        runtime.start()
        live.open(["x"], 1, 0.01, 16, "me", "me")
        until(lambda: len(messages) > 0, "rows")
        refused: list[int] = []

        def refuse(*_: object) -> None:
            refused.append(1)
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

        with monkeypatch.context() as none_left:
            none_left.setattr(runtime, "acquire_configure", refuse)
            runtime.acquire_stop(1)
            until(lambda: len(refused) > 1, "a second try")
        before = len(messages)
        until(lambda: len(messages) > before, "rows again")
    finally:
        live.close()


def _asleep(live: LiveStreams) -> bool:
    return all(stream.due > 0.0 for stream in live._streams.values())


@pytest.mark.parametrize("fade", [float("nan"), -1.0, 3.0])
def test_check_refuses_a_fade_and_a_sample_that_write_would_refuse(
    make_runtime: Make, fade: float
) -> None:
    desk = desk_of(make_runtime(PROGRAM))
    for verb in ("check", "write"):
        with pytest.raises(Refused, match="a fade of"):
            desk.ask(verb, "me", values={"a": 2.0}, fade=fade)
        with pytest.raises(Refused, match="is no sample"):
            desk.ask(verb, "me", values={"a": 2.0}, at_tick=-1)
    desk.ask("check", "me", values={"a": 2.0}, fade=1.0, at_tick=7)


@pytest.mark.parametrize("decimation", [0, -1, 1 << 32, (1 << 63) - 1])
def test_a_decimation_that_no_stream_holds_is_refused(
    make_runtime: Make, decimation: int
) -> None:
    runtime = make_runtime(PROGRAM)
    config = AcquireConfig(("x",), decimation, seconds=1e9)
    with pytest.raises(AcquisitionError, match=f"decimation {decimation}: give 1 to"):
        runtime.acquire_configure(0, config)


def test_a_recording_that_is_refused_leaves_the_one_before_alone(make_runtime: Make) -> None:
    """A transfer that sees another `begun` takes the rows for others and gives up."""
    runtime = make_runtime(PROGRAM)
    desk = desk_of(runtime)
    desk.ask("acquire_configure", "anna", channels=["x"], seconds=0.01)
    desk.ask("acquire_start", "anna")
    runtime.start(100)
    until(lambda: desk.ask("acquire_status").state == "done", "the recording")
    before = desk.ask("acquire_status")
    with pytest.raises(AcquisitionError):
        desk.ask("acquire_configure", "anna", channels=["mistyped"])
    assert desk.ask("acquire_status") == before
    desk.ask("unload")
    with pytest.raises(AcquisitionError):
        desk.ask("acquire_start", "anna")
    assert desk.ask("acquire_status").begun == before.begun


NUMBERS = range(900)
MANY = f"""#include "isr.h"
double big[4096];
{"".join(f"double number_{n};" for n in NUMBERS)}
void UserInit(void) {{
    SIGNAL(big, "", "");
    {"".join(f'SIGNAL(number_{n}, "", "");' for n in NUMBERS)}
}}
void UserISR_INT2(void) {{}}
"""


def test_many_wrong_names_block_nobody(make_runtime: Make) -> None:
    """Suggestions for each name had taken a minute, during which nobody was answered."""
    runtime = make_runtime(MANY)
    names = [f"nunber_{n}" for n in range(3000)]
    began = time.monotonic()
    for do in (
        lambda: runtime.read(names),
        lambda: runtime.write(dict.fromkeys(names, 1.0), "me"),
        lambda: runtime.acquire_configure(0, AcquireConfig(tuple(names))),
    ):
        with pytest.raises((VariableError, AcquisitionError), match="did you mean number_") as said:
            do()
        assert str(said.value).count("no such variable") == len(names)
    assert time.monotonic() - began < 10.0  # 0.7 s here; without care 150 s


def test_an_array_requested_thousands_of_times_is_refused_at_once(make_runtime: Make) -> None:
    runtime = make_runtime(MANY)
    began = time.monotonic()
    with pytest.raises(AcquisitionError, match="more than 1024 channels"):
        runtime.acquire_configure(0, AcquireConfig(("big",) * 3000))
    assert time.monotonic() - began < 2.0


def test_an_index_of_thousands_of_digits_is_no_such_variable(make_runtime: Make) -> None:
    runtime = make_runtime(PROGRAM)
    with pytest.raises(VariableError, match="no such variable"):
        runtime.read([f"a[{'9' * 5000}]"])
