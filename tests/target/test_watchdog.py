"""The machine's own watchdog is kept alive by healthy samples only, so that it acts when they stop.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from card import Card

from zendsp_target.runtime import Runtime

Make = Callable[..., Runtime]
Wait = Callable[..., None]

# words of the card: how often it was kept alive, how often outputs were written
CARD = """
static void card_read(void *h, machine_sensors *s) { pendulum_machine.read(h, s); }
static void card_write(void *h, const machine_actuators *u) {
    pendulum_machine.write(h, u);
    card[1]++;
}
static void card_step(void *h, double dt) { pendulum_machine.step(h, dt); }
static void card_safe(void *h) { pendulum_machine.safe(h); }
static void card_alive(void *h) { (void)h; card[0]++; }
const machine_ops zendsp_machine = {.abi = MACHINE_ABI, .open = card_open, .read = card_read,
    .write = card_write, .step = card_step, .safe = card_safe, .keep_alive = card_alive};
"""
ALIVE, WRITTEN = range(2)
PROGRAM = """
#include "isr.h"
#include <time.h>
static double x;
static int32_t hang, late;
void UserInit(void) {
    SIGNAL(x, "", "");
    PARAMETER(hang, 0, "", NO_MIN, NO_MAX, ""); PARAMETER(late, 0, "", NO_MIN, NO_MAX, "");
}
void UserISR_INT2(void) {
    x += 1.0;
    while (*(volatile int32_t *)&hang) { }
    if (late) { const struct timespec t = {0, 25000000}; nanosleep(&t, 0); }
}
"""
TRIPS_S = 0.15  # of the simulated hardware: a hundred times the period


@pytest.fixture
def card(tmp_path: Path) -> Card:
    """A card, and the machine that has it."""
    return Card(tmp_path, CARD, hardware=False)


def fires(card: Card) -> bool:
    """Whether nothing came within its time, as such a card decides."""
    before = card[ALIVE]
    time.sleep(TRIPS_S)
    return card[ALIVE] == before


def _running(make_runtime: Make, wait_for: Wait, card: Card, **options: float) -> Runtime:
    machine = str(card.machine)
    runtime = make_runtime(
        PROGRAM, machine=machine, clock="real", rate_hz=100.0, realtime=False, **options
    )
    runtime.start()
    wait_for(lambda: runtime.status().tick > 20)
    return runtime


def _pid(runtime: Runtime) -> int:
    assert runtime.programs.session is not None
    return runtime.programs.session.process.pid


def test_every_sample_keeps_the_watchdog_alive_after_its_outputs(
    make_runtime: Make, wait_for: Wait, card: Card
) -> None:
    runtime = _running(make_runtime, wait_for, card)
    for what in (lambda: None, runtime.pause):  # a pause is healthy
        what()
        before = card[ALIVE]
        wait_for(lambda before=before: card[ALIVE] > before + 20)  # type: ignore[misc]


def test_the_watchdog_fires_when_a_sample_does_not_return(
    make_runtime: Make, wait_for: Wait, card: Card
) -> None:
    runtime = _running(make_runtime, wait_for, card, hang_s=20.0)
    runtime.write({"hang": 1}, "me")
    wait_for(lambda: fires(card))
    assert runtime.status().crash == "", "before our own watchdog noticed"


def test_it_fires_when_samples_are_too_late_again_and_again(
    make_runtime: Make, wait_for: Wait, card: Card
) -> None:
    runtime = _running(make_runtime, wait_for, card)
    runtime.write({"late": 1}, "me")
    wait_for(lambda: fires(card))
    before = card[WRITTEN]
    wait_for(lambda: card[WRITTEN] > before)  # the loop lives, only too late
    assert fires(card)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_watchdog_fires_when_the_runner_is_gone_or_stopped(
    make_runtime: Make, wait_for: Wait, card: Card, number: signal.Signals
) -> None:
    runtime = _running(make_runtime, wait_for, card, hang_s=20.0)
    os.kill(_pid(runtime), number)
    wait_for(lambda: fires(card))


def test_the_watchdog_is_not_kept_alive_while_a_program_is_loaded(
    make_runtime: Make, wait_for: Wait, card: Card
) -> None:
    """As the page says, so that whoever writes a machine arms it by the first call."""
    code = (
        f'#include <fcntl.h>\n#include <sys/mman.h>\n{PROGRAM}'.replace(
            "UserInit(void) {",
            "UserInit(void) {\n    const struct timespec t = {0, 300000000}; nanosleep(&t, 0);"
            f'\n    x = (double)*(volatile long *)mmap(0, 4096, PROT_READ, MAP_SHARED,'
            f' open("{card.path}", O_RDONLY), 0);',
        )
    )
    runtime = make_runtime(
        code, machine=str(card.machine), clock="real", rate_hz=100.0, realtime=False
    )
    assert runtime.read(["x"])[1] == {"x": 0.0}
    wait_for(lambda: card[ALIVE] > 0)
