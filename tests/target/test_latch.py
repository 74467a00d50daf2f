"""A STOP stays latched until it is acknowledged, whatever is requested in between and by whom."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from desk import desk_of
from waiting import until

from zendsp.here.stop_page import StopPage
from zendsp_protocol import messages as m
from zendsp_protocol.errors import ZendspError
from zendsp_target.runtime import Runtime

# 3 N m whenever it may; crashes or computes nonsense where it is told to.
PUSHING = """
#include "isr.h"
#include <math.h>
static bool crash, nonsense, hold;
void UserInit(void) {
    PARAMETER(crash, false, "", NO_MIN, NO_MAX, "");
    PARAMETER(nonsense, false, "", NO_MIN, NO_MAX, "");
    PARAMETER(hold, false, "", NO_MIN, NO_MAX, "");
    if (CRASH) *(volatile int *)8 = 1;
}
void UserISR_INT2(void) {
    if (crash) *(volatile int *)8 = 1;
    WRITE_TORQUE(1, nonsense ? NAN : 3.0);
}
"""
HOSTS = ("anna", "bo")


class Lab:
    """A target that two hosts ask for anything, and whether a STOP or a trip stands, as they know
    it.
    """

    def __init__(self, runtime: Runtime, seed: int) -> None:
        self.runtime, self.desk, self.random = runtime, desk_of(runtime), random.Random(seed)
        self.stands = False
        self.said: list[str] = []
        self.good, self.bad = (
            self.desk.ask("compile", sources={"user.c": PUSHING.replace("CRASH", crash)}).key
            for crash in ("0", "1")
        )
        self.page = StopPage(runtime.stop_page())

    def ask(self, verb: str, **arguments: Any) -> str:
        """Ask by one of the hosts; the refusal, empty where there was none."""
        by = self.random.choice(HOSTS)
        try:
            self.desk.ask(verb, by, **arguments)
            refusal = ""
        except ZendspError as error:
            refusal = str(error) or "?"
        self.said.append(f"{by}: {verb} {arguments} {refusal}")
        return refusal

    def drive(self, action: str, **arguments: Any) -> str:
        return self.ask("drive", **{"action": action, "force": True, **arguments})

    def stop(self) -> None:
        if self.random.random() < 0.5:
            self.ask("stop")
        else:
            self.page.ask()
            self.said.append("STOP by shared memory")
        self.stands = True

    def stop_while(self, verb: str, **arguments: Any) -> None:
        """STOP at any time of a request that takes its time."""
        delay = self.random.uniform(0.0, 0.15)
        other = threading.Timer(delay, self.page.ask)
        other.start()
        self.ask(verb, **arguments)
        other.join()
        self.said.append(f"STOP {delay:.4f} s after that began")
        self.stands = True

    def acknowledge(self, refusal: str) -> None:
        self.stands = self.stands and refusal != ""

    def end(self, name: str) -> None:
        """A crash, or a trip of the program itself."""
        self.ask("write", values={name: True})

    def step(self) -> None:
        steps: tuple[Callable[[], object], ...] = (
            self.stop,
            lambda: self.ask("load", key=self.good),
            lambda: self.ask("load", key=self.bad),
            lambda: self.ask("unload"),
            lambda: self.ask("start"),
            lambda: self.ask("start", ticks=20),
            lambda: self.ask("pause"),
            lambda: self.ask("home"),
            lambda: self.ask("set_drive", mode=self.random.choice(("off", "torque", "auto"))),
            lambda: self.acknowledge(self.ask("acknowledge")),
            lambda: self.acknowledge(self.drive("acknowledge")),
            lambda: self.drive(self.random.choice(("take", "release", "auto"))),
            lambda: self.drive(self.random.choice(("power_on", "power_off", "home"))),
            lambda: self.drive(self.random.choice(("enable", "disable"))),
            lambda: self.ask("write", values={"drive.mode": 1}),
            lambda: self.end(self.random.choice(("crash", "nonsense"))),
            lambda: self.stop_while("load", key=self.good),
            lambda: self.stop_while("unload"),
            lambda: self.stop_while("start"),
        )
        self.random.choice(steps)()

    def look(self) -> None:
        """What must hold now."""
        moving = ("start", "home", "load")
        if not self.stands:
            self.stands = self.desk.ask("status").trip is not None
            return
        until(lambda: self.desk.ask("status").trip is not None, "it stands", self.told)
        tried = self.random.choice(moving)
        assert self.ask(tried, **({"key": self.good} if tried == "load" else {})), self.told()
        if tried != "start":
            assert self.drive("enable"), self.told()
        status: m.Status = self.desk.ask("status")
        assert status.trip is not None and status.drive in ("stopped", "tripped"), self.told()
        assert not np.any(status.io.get("aout", 0.0)), self.told()

    def told(self) -> str:
        return "\n".join([*self.said, str(self.desk.ask("status"))])


@pytest.fixture
def runtime() -> Iterator[Runtime]:
    with Runtime("imi_planar", clock="fast", speed=5.0) as made:
        yield made


def wander(runtime: Runtime, seed: int, steps: int = 25) -> None:
    """Ask anything, a number of times; look after each."""
    lab = Lab(runtime, seed)
    for _ in range(steps):
        lab.step()
        lab.look()


@pytest.mark.parametrize("seed", range(12))
def test_a_stop_stands_until_it_is_acknowledged(runtime: Runtime, seed: int) -> None:
    wander(runtime, seed)


def test_a_stop_ends_the_hold_of_a_pause(runtime: Runtime) -> None:
    lab = Lab(runtime, 0)
    lab.ask("load", key=lab.good)
    lab.ask("start", ticks=20)
    runtime.wait_paused()
    held = lab.desk.ask("status").io["aout"]
    assert np.any(held), "a simulated machine stands still in time, with its command"
    lab.ask("stop")
    until(lambda: lab.desk.ask("status").trip is not None, "it stands", lab.told)
    assert not np.any(lab.desk.ask("status").io["aout"])


def test_where_no_program_is_loaded_a_latched_stop_is_named_before_it(runtime: Runtime) -> None:
    """After a STOP that ended an experiment a start asked for a program, which no load gave."""
    lab = Lab(runtime, 0)
    assert lab.ask("start") == "no program is loaded: compile and load one first"
    lab.ask("stop")
    until(lambda: lab.desk.ask("status").trip is not None, "it stands", lab.told)
    refusal = lab.ask("start")
    assert refusal.startswith("STOP") and refusal.endswith(": acknowledge it first"), refusal
    lab.acknowledge(lab.ask("acknowledge"))
    assert lab.ask("start") == "no program is loaded: compile and load one first"


# Writes over the page of STOP in sample 5, as a stray pointer may, and crashes: no loop mends it.
STRAY = """
#include "isr.h"
#include <stdio.h>
#include <string.h>
static unsigned char *page;
static int samples;
void UserInit(void) {
    char line[512];
    FILE *maps = fopen("/proc/self/maps", "r");
    while (maps && fgets(line, sizeof line, maps)) {
        void *begin;
        if (strstr(line, " rw") && strstr(line, "/stop\\n") && sscanf(line, "%p", &begin) == 1)
            page = begin;
    }
}
void UserISR_INT2(void) {
    if (++samples < 5 || !page) return;
    memset(page, 255, 128);
    *(volatile int *)8 = 1;
}
"""


@pytest.mark.parametrize("sure", [None, "the trip that is seen"])
def test_user_code_that_writes_over_the_page_of_stop_does_not_lock_the_target(
    runtime: Runtime, sure: str | None
) -> None:
    """The number of trips left its 32 bits: no acknowledgement could be kept, so nothing could be
    loaded or started again.
    """
    lab = Lab(runtime, 0)
    key = lab.desk.ask("compile", sources={"user.c": STRAY}).key
    assert lab.ask("load", key=key) == ""
    assert lab.ask("start", ticks=100) == ""
    until(lambda: lab.desk.ask("status").trip is not None, "it is stopped", lab.told)
    assert lab.ask("unload") == ""
    status = lab.desk.ask("status")
    assert status.trip is not None and status.trip.number < 1 << 32, lab.told()
    meant = {"trip": status.trip.number} if sure else {}
    assert lab.ask("acknowledge", **meant) == "", lab.told()
    assert lab.desk.ask("status").trip is None
    assert lab.ask("load", key=lab.good) == "" and lab.ask("start", ticks=5) == "", lab.told()
