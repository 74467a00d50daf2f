"""STOP where the machine itself hangs: nobody is told "stopped" before the outputs are safe."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from card import Card
from waiting import PATIENCE_S, until

from zendsp.errors import NotStopped
from zendsp.here.stop_page import find
from zendsp.link import Target, connect
from zendsp_target.monitor import Monitor, Options
from zendsp_target.runtime import Runtime

# Hardware, as a driver that may not return. Words of the card: writes, reads, mode; hang in write,
# read, safe; in stop: write, read; in which it hangs.
CARD = """
static void hang(int word) { for (; card[word]; usleep(1000)) card[8] = word; }
static void card_read(void *h, machine_sensors *s) {
    hang(4);
    if (card[2] == MACHINE_VELOCITY) hang(7);
    pendulum_machine.read(h, s);
    card[1]++;
}
static void card_write(void *h, const machine_actuators *u) {
    hang(3);
    if (u->mode == MACHINE_VELOCITY) hang(6);
    pendulum_machine.write(h, u);
    card[2] = u->mode;
    card[0]++;
}
static void card_safe(void *h) { hang(5); pendulum_machine.safe(h); card[2] = MACHINE_OFF; }
const machine_ops zendsp_machine = {.abi = MACHINE_ABI, .open = card_open, .read = card_read,
    .write = card_write, .safe = card_safe};
"""
PROGRAM = """
#include "isr.h"
static double x;
static int32_t hang;
static void hold(void) { while (*(volatile int32_t *)&hang) { } }
void UserInit(void) { SIGNAL(x, "", ""); PARAMETER(hang, 0, "", NO_MIN, NO_MAX, ""); }
void UserISR_INT2(void) {
    x += 1.0;
    IOGP_FU1_WRITE_AOUT_ENGU(0) = 100.0;
    if (hang && !DRIVE_ENABLED) hold();
}
"""
WRITES, READS, MODE, WRITE, READ, SAFE, WRITE_OF_STOP, READ_OF_STOP, HANGS_IN = range(9)
VELOCITY = 2


@pytest.fixture
def card(tmp_path: Path) -> Card:
    return Card(tmp_path, CARD, hardware=True)


@pytest.fixture
def begin(
    card: Card, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., Target]]:
    """A target whose program commands the card: ``begin(hang_s)``."""
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.delenv("ZENDSP_CONNECT", raising=False)
    machine = str(card.machine)
    with ExitStack() as all_of_it:

        def begin(hang_s: float = 60.0) -> Target:
            runtime = all_of_it.enter_context(
                Runtime(machine, clock="real", realtime=False, rate_hz=200.0, hang_s=hang_s)
            )
            all_of_it.callback(Monitor(runtime, Options("held", "pendulum")).close)
            target = all_of_it.enter_context(connect("held"))
            target.download({"user.c": PROGRAM})
            target.start()
            until(lambda: target.status().io["aout"][0] == 100.0, "the program commands")
            return target

        try:
            yield begin
        finally:
            for word in (WRITE, READ, SAFE, WRITE_OF_STOP, READ_OF_STOP):
                card[word] = 0


def _stuck(card: Card, word: int) -> None:
    """Have the card hang there, and wait until the loop does."""
    card[word] = 1
    until(lambda: card[HANGS_IN] == word, "the loop hangs")


@pytest.mark.parametrize("road", ["page", "link"])
def test_stop_is_not_taken_before_the_machine_was_written(
    begin: Callable[..., Target], card: Card, monkeypatch: pytest.MonkeyPatch, road: str
) -> None:
    target = begin()
    if road == "link":  # of a host elsewhere
        monkeypatch.setattr(target.programs, "stop_page", lambda: None)
    card[WRITE_OF_STOP] = 1
    with pytest.raises(NotStopped, match="NOT STOPPED: use the machine's emergency stop"):
        target.stop()
    assert card[MODE] != VELOCITY, "the machine still does what it was told before"
    status = target.status()
    assert (status.state, status.trip) == ("running", None), "nor does anybody else hear of it"
    card[WRITE_OF_STOP] = 0
    status = target.stop()
    assert status.trip is not None
    assert card[MODE] == VELOCITY


@pytest.mark.parametrize("word", [WRITE, READ])
def test_a_machine_that_hung_before_is_not_stopped(
    begin: Callable[..., Target], card: Card, word: int
) -> None:
    target, page = begin(), find("held")
    assert page is not None
    _stuck(card, word)
    asked = page.ask()
    with pytest.raises(NotStopped, match="goes on or hangs"):
        target.stop()
    card[word] = 0
    assert page.taken(asked, PATIENCE_S) is not None
    assert card[MODE] == VELOCITY


def test_a_read_that_hangs_after_safe_outputs_is_stopped(
    begin: Callable[..., Target], card: Card
) -> None:
    target = begin()
    card[READ_OF_STOP] = 1
    assert target.stop().trip is not None
    assert card[MODE] == VELOCITY


def test_a_program_that_hangs_in_the_very_sample_of_stop_is_stopped_and_then_ended(
    begin: Callable[..., Target], card: Card
) -> None:
    target = begin(hang_s=0.5)
    target.update(hang=1)
    assert target.stop().trip is not None
    assert card[MODE] == VELOCITY
    until(lambda: target.status().crash != "", "the watchdog ends it")
    assert target.stop().state == "crashed"
    assert card[MODE] == 0, "made safe"


def test_a_pause_that_hangs_is_not_stopped_until_the_machine_was_made_safe(
    begin: Callable[..., Target], card: Card
) -> None:
    target = begin()
    target.pause()
    _stuck(card, READ)
    with pytest.raises(NotStopped, match="goes on or hangs"):
        target.stop()
    card[READ] = 0
    until(lambda: target.status().trip is not None, "the STOP is latched")


def test_a_machine_that_cannot_be_made_safe_is_never_stopped(
    begin: Callable[..., Target], card: Card, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zendsp_target.runtime.process.rescue.LIMIT_S", 1.5)
    target = begin(hang_s=0.3)
    card[SAFE] = 1
    _stuck(card, WRITE)

    def refused() -> str:
        with pytest.raises(NotStopped) as error:
            target.stop()
        return str(error.value)

    until(lambda: "NOT SAFE" in refused(), "hung, being made safe, not safe: no word of stopped")
    assert "NOT SAFE" in target.status().crash
    target.unload()
    until(lambda: "NOT SAFE" in refused(), "an empty target is not a safe machine")
    card[SAFE] = card[WRITE] = 0
    target.acknowledge()
    target.download({"user.c": PROGRAM})
    assert target.stop().trip is not None, "a runner that has the machine is believed again"
