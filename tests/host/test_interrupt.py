"""Ctrl-C while a request waits for its answer."""

from __future__ import annotations

import os
import signal

import pytest

from zendsp.link import Target
from zendsp_target.runtime import Runtime


def test_ctrl_c_that_comes_with_the_answer_is_heard(
    target: Target, runtime: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It comes while the caller's thread waits, just before the answer ends the wait."""
    plain = runtime.compile

    def compile_(*words: object) -> object:
        os.kill(os.getpid(), signal.SIGINT)
        return plain(*words)  # type: ignore[arg-type]

    monkeypatch.setattr(runtime, "compile", compile_)
    for _ in range(5):
        with pytest.raises(KeyboardInterrupt):
            target.compile({"a.c": '#include "isr.h"'})
    assert target.status().state == "empty"


def test_ctrl_c_ends_the_recording_and_pauses_what_was_started_with_it(target: Target) -> None:
    """In a notebook the process goes on: nobody would watch what the machine does, or end the
    recorder.
    """

    def interrupt(share: float) -> None:
        if share > 0.0:
            os.kill(os.getpid(), signal.SIGINT)

    target.download("template.c")
    for start, left in ((True, "paused"), (False, "running")):
        if not start:
            target.start()
        with pytest.raises(KeyboardInterrupt) as ended:
            target.acquire(["tick"], 1e4, start=start, progress=interrupt)
        assert "acquire_load() brings them home" in ended.value.__notes__[0]
        assert target.status().state == left
        assert target.acquire_status().state == "done"
        assert len(target.acquire_load()) > 0
    assert target.acquire(["tick"], 0.1).lost == 0


def test_so_does_an_error_of_the_users_own_progress(target: Target) -> None:
    """The machine went on moving until the time of the recording was over."""

    def fail(share: float) -> None:
        if share > 0.0:
            raise ZeroDivisionError

    target.download("template.c")
    with pytest.raises(ZeroDivisionError):
        target.acquire(["tick"], 1e4, start=True, progress=fail)
    assert target.status().state == "paused"
    assert target.acquire_status().state == "done" and len(target.acquire_load()) > 0
