"""Ctrl-C while the target is asked."""

from __future__ import annotations

import os
import signal

import pytest

from zendsp.link import Target
from zendsp_target.runtime import Runtime


def test_ctrl_c_that_comes_with_the_answer_is_heard(
    target: Target, runtime: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It comes while the caller's thread waits, and the answer ends the wait."""
    plain = runtime.compile

    def compile_(*words: object) -> object:
        os.kill(os.getpid(), signal.SIGINT)
        return plain(*words)  # type: ignore[arg-type]

    monkeypatch.setattr(runtime, "compile", compile_)
    for _ in range(5):
        with pytest.raises(KeyboardInterrupt):
            target.compile({"a.c": '#include "isr.h"'})
    assert target.status().state == "empty"
