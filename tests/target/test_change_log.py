"""The log of changes: its order, and what it keeps; parameters that the program itself sets."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from samples import run

from zendsp_target.runtime import Runtime
from zendsp_target.runtime.memory.layout import layout
from zendsp_target.runtime.variables.change_log import ChangeLog, Flight
from zendsp_target.runtime.variables.plans import ENTRY

Make = Callable[..., Runtime]
PROGRAM = """
#include "isr.h"
static double a;
void UserInit(void) { PARAMETER(a, 0.0, "", NO_MIN, NO_MAX, ""); }
void UserISR_INT2(void) {}
"""


@pytest.mark.parametrize("looks", [1, 2, 3])
@pytest.mark.parametrize(
    "order", [[(3, 300), (1, 100), (2, 100), (0, None)], [(0, 50), (1, 100), (2, 100), (3, 300)]]
)
def test_the_log_is_in_the_order_of_the_samples_whenever_it_is_taken_down(
    monkeypatch: pytest.MonkeyPatch,
    make_runtime: Make,
    order: list[tuple[int, int | None]],
    looks: int,
) -> None:
    """The loop applies what waits between two looks of the harvest; also what waits for its sample
    and was written first.
    """
    runtime = make_runtime(PROGRAM)
    session = runtime.programs.session
    assert session is not None
    flights = session.flights

    class Meanwhile:
        """The monitor's functions; after so many looks of this thread into memory the loop runs 400
        samples. The supervisor looks too, and would have them run before all is written.
        """

        looked, own = 0, threading.get_ident()

        def __getattr__(self, name: str) -> object:
            found = getattr(layout()[1], name)
            return partial(self.look, found) if name.startswith("monitor_") else found

        def look(self, function: Callable[..., object], *arguments: object) -> object:
            seen = function(*arguments)
            if threading.get_ident() != self.own:
                return seen
            self.looked += 1
            if self.looked == looks:
                run(runtime, 400)
            return seen

    monkeypatch.setattr(flights, "_lib", Meanwhile())
    for value, tick in order:
        runtime.write({"a": value}, "me", at_tick=tick)
    flights.harvest()
    assert [change.new for change in runtime.log()] == [0, 1, 2, 3]
    assert [change.old for change in runtime.log()] == [0, 0, 1, 2]


def test_the_log_keeps_its_newest_lines_and_their_numbers(
    monkeypatch: pytest.MonkeyPatch, make_runtime: Make
) -> None:
    monkeypatch.setattr("zendsp_target.runtime.variables.change_log._MAX_LOG", 10)
    runtime = make_runtime(PROGRAM)
    session = runtime.programs.session
    assert session is not None
    place = session.dictionary.place("a")
    log = ChangeLog()

    def batch(number: int) -> bytes:
        return ENTRY.pack(place.entry.index, 0, 8, 0) + np.float64(number).tobytes()

    def come(first: int, last: int) -> None:
        for k in range(first, last):
            log.append(Flight(0, (("a", place),), 24, lambda k=k: batch(k), "me", 0.0), k,
                batch(k - 1))  # type: ignore[misc]

    come(0, 4)
    log.settle(2)
    assert [c.new for c in log.since(1)] == [1.0, 2.0, 3.0]
    come(4, 40)
    log.settle(1)
    assert [(c.tick, c.old, c.new) for c in log.since(0)] == [
        (k, k - 1.0, k) for k in range(30, 40)
    ]
    assert [c.new for c in log.since(38)] == [38.0, 39.0]
    assert log.since(40) == ()


def test_long_arrays_do_not_fill_the_memory_by_way_of_the_log(
    monkeypatch: pytest.MonkeyPatch, make_runtime: Make
) -> None:
    """This holds whether or not the log is read in between."""
    monkeypatch.setattr("zendsp_target.runtime.variables.change_log._MOST_BYTES", 480)
    runtime = make_runtime(PROGRAM)
    session = runtime.programs.session
    assert session is not None
    place = session.dictionary.place("a")
    for most in (1, 100):
        log = ChangeLog()
        for k in range(40):
            data = ENTRY.pack(place.entry.index, 0, 8, 0) + np.float64(k).tobytes()
            log.append(Flight(0, (("a", place),), 24, lambda data=data: data, "me", 0.0), k, data)
            if most == 1:
                log.settle(1)
        log.settle(most)
        assert len(log._lines) + len(log._raw) <= 10 + 1, "two values of 24 bytes each"
        assert [c.new for c in log.since(0)] == list(range(30, 40))
        assert [c.new for c in log.since(38)] == [38.0, 39.0]


SETS = """
#include "isr.h"
static double gain, kept, adapted;
void UserInit(void) {
    PARAMETER(gain, 400.0, "", 0.0, 5000.0, "");
    PARAMETER(kept, 1.0, "", 0.0, 10.0, "");
    PARAMETER(adapted, 0.0, "", 0.0, 1.0, "");
}
void UserISR_INT2(void) { gain = 400.0; if (SAMPLE_TICK > 100) adapted = 2.0; }
"""


def test_what_the_program_itself_sets_is_told_once_and_what_the_host_writes_is_not(
    make_runtime: Make, wait_for: Callable[..., None]
) -> None:
    runtime = make_runtime(SETS, clock="real")
    runtime.write({"kept": 2.0}, "test")
    runtime.start()
    wait_for(lambda: len(runtime.status().own) == 1, lambda: runtime.status().own)
    assert runtime.status().own == (
        "adapted: the program itself sets it, past its limits of 0 and 1 (2.)",
    )
    runtime.write({"gain": 450.0, "kept": 3.0}, "test")
    wait_for(lambda: len(runtime.status().own) == 2, lambda: runtime.status().own)
    for k in range(12):  # between looks and across them
        runtime.write({"kept": 4.0 + 0.1 * k, "gain": 500.0}, "test")
        time.sleep(0.1)
    own = runtime.status().own
    assert len(own) == 2 and own[1].startswith("gain: the program itself sets it, so that"), own
