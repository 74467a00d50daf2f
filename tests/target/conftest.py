"""Helpers of the target's tests: programs on a machine, and waiting on a condition."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from waiting import until

from zendsp.link import Target, local
from zendsp_target.runtime import Runtime


def _load(runtime: Runtime, code: str) -> None:
    result = runtime.compile({"user.c": code})
    assert result.ok, result.diagnostics
    runtime.load(result.key)


@pytest.fixture
def load() -> Callable[[Runtime, str], None]:
    """Compile and load code: ``load(runtime, code)``."""
    return _load


@pytest.fixture
def make_runtime() -> Iterator[Callable[..., Runtime]]:
    """A runtime with a program loaded: ``make_runtime(code, clock="fast", …)``."""
    made: list[Runtime] = []

    def make(
        code: str, machine: str = "imi_planar", clock: str = "fast", **options: Any
    ) -> Runtime:
        runtime = Runtime(machine, clock=clock, **options)
        made.append(runtime)
        _load(runtime, code)
        return runtime

    yield make
    for runtime in made:
        runtime.close()


@pytest.fixture
def wait_for() -> Callable[..., None]:
    """Sleep until a condition holds: ``wait_for(condition, shown_on_failure)``."""

    def wait(done: Callable[[], bool], shown: Callable[[], object] = str) -> None:
        until(done, "what the test waits for", shown)

    return wait


@pytest.fixture(scope="module")
def process() -> Iterator[Target]:
    """A host's link to a simulated arm on the fast clock."""
    target = local("imi_planar", clock="fast", options=["--speed", "20"])
    yield target
    target.close()


@pytest.fixture
def target(process: Target) -> Iterator[Target]:
    """The same with a program, and afterwards nobody's and at rest."""
    process.download("pd.c")
    yield process
    process.take_command(force=True)
    process.acknowledge()
    process.pause()
    process.drive_auto()
    process.release_command()
