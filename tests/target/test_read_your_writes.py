"""What is read after an acknowledgement shows what was acknowledged, however long samples take."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from desk import Desk, desk_of
from hardware import driver
from waiting import until

from zendsp_protocol.errors import RunnerDied
from zendsp_protocol.messages import Trigger
from zendsp_target.runtime import Runtime

Make = Callable[..., Runtime]

# Half of each sample passes between what the loop takes and the picture of it that others read.
SLOW = """
#include "isr.h"
#include <time.h>
static double a, ramp;
static table ref;
void UserInit(void) {
    PARAMETER(a, 0.0, "", NO_MIN, NO_MAX, ""); SIGNAL(ramp, "", ""); TABLE(ref, 8, 1, "", "");
}
void UserISR_INT2(void) {
    struct timespec begin, now;
    clock_gettime(CLOCK_MONOTONIC, &begin);
    do
        clock_gettime(CLOCK_MONOTONIC, &now);
    while ((now.tv_sec - begin.tv_sec) * 1e3 + (now.tv_nsec - begin.tv_nsec) * 1e-6 < 5.0);
    IOGP_FU1_WRITE_AOUT_ENGU(0) = 500.0;
    ramp += 1.0;
}
"""
LIMIT = 200.0  # N m, within what the machine bears


@pytest.fixture
def slow(make_runtime: Make) -> Runtime:
    """100 samples a second, each of which takes half of its time."""
    return make_runtime(SLOW, rate_hz=100.0, clock="real", realtime=False)


@pytest.fixture(params=["runs", "is paused", "has just been loaded"])
def desk(request: pytest.FixtureRequest, slow: Runtime) -> Desk:
    """A desk, with the loop in each state in which requests are possible."""
    if request.param != "has just been loaded":
        slow.start()
        until(lambda: slow.status().tick > 2, "it runs")
    if request.param == "is paused":
        slow.pause()
    return desk_of(slow)


def test_limits(desk: Desk) -> None:
    for k in range(5):
        applied = desk.ask("set_limits", torque_max=[LIMIT + k, 20.0])
        assert desk.service.runtime.limits().torque_max == (LIMIT + k, 20.0)
        assert desk.service.runtime.status().tick >= applied.tick


def test_changed_digital_inputs_are_read_at_once(desk: Desk) -> None:
    for bits in (2, 0, 3, 2):
        desk.ask("set_inputs", bits=bits)
        assert desk.ask("read", names=["din"]).values == {"din": float(bits)}
        assert desk.ask("status").io["din"] == [float(bits)]


def test_a_changed_drive_state_is_read_at_once(desk: Desk) -> None:
    for mode in ("off", "velocity", "off", "torque", "off"):
        desk.ask("set_drive", mode=mode)
        running = desk.ask("status").state == "running"
        acts = mode if running else "off"  # nothing is switched on while nothing runs
        assert desk.ask("status").drive_mode == acts
        number = {"off": 0.0, "torque": 1.0, "velocity": 2.0}[acts]
        assert desk.ask("read", names=["drive"]).values == {"drive": number}


def test_power_off_and_disable_are_read_at_once(desk: Desk) -> None:
    runtime = desk.service.runtime
    if runtime.status().state == "loaded":
        return
    runtime.set_ramp(0.0)
    runs = runtime.status().state == "running"
    desk.ask("pause")  # what ran while the drives were off is not enabled
    desk.ask("drive", action="power_on")
    desk.service.drives._ramp_s = 0.0
    desk.ask("drive", action="enable", mode="torque")
    desk.ask("start") if runs else None
    for action in ("disable", "power_off"):
        said = desk.ask("drive", action=action).text
        assert ("pause it before you enable again" in said) is runs
        assert desk.ask("status").drive_mode == "off"
        assert desk.ask("drive_status").mode == "off"
        assert desk.ask("read", names=["drive"]).values == {"drive": 0.0}


def test_an_acquisition_that_was_stopped_takes_no_row_any_more(desk: Desk) -> None:
    for _ in range(3):
        desk.ask("acquire_configure", channels=["tick"], seconds=5.0, continuous=True)
        desk.ask("acquire_start")
        assert desk.ask("acquire_status").state == "running"
        desk.ask("acquire_stop")
        status = desk.ask("acquire_status")
        assert status.state == "done"
        desk.ask("update", values={"a": 1.0})  # a whole sample more
        assert desk.ask("acquire_status").count == status.count
        desk.ask("acquire_stop")  # of one that is done: nothing, and at once


def test_a_trigger_fired_by_hand_has_fired(desk: Desk) -> None:
    never = Trigger("ramp", 1e9)
    for _ in range(3):
        desk.ask("acquire_configure", channels=["tick"], seconds=5.0, trigger=never)
        desk.ask("acquire_start")
        assert desk.ask("acquire_status").state == "armed"
        desk.ask("acquire_start", force=True)
        status = desk.ask("acquire_status")
        assert (status.state, status.trigger_row) == ("running", status.trigger_row)
        assert status.trigger_row >= 0


def test_homing_that_was_begun_is_seen(slow: Runtime) -> None:
    desk = desk_of(slow)
    slow.start(ticks=1)
    slow.wait_paused()
    for _ in range(3):
        before = desk.ask("status").tick
        desk.ask("home")
        now = desk.ask("status")
        assert now.state == "running" or now.tick > before
        slow.wait_paused()


def test_after_a_stop_the_outputs_that_are_read_are_safe(slow: Runtime) -> None:
    desk = desk_of(slow)
    for _ in range(3):
        slow.start()
        until(lambda: slow.read(["aout"])[1]["aout"][0] > 0.0, "it moves")  # type: ignore[index]
        slow.stop()
        until(lambda: slow.status().trip is not None, "the loop has taken it")
        trip = slow.status().trip
        reading = desk.ask("read", names=["aout", "drive"])
        assert trip is not None and "STOP" in reading.ended
        assert reading.tick >= trip.tick
        assert desk.ask("status").io["aout"] == [0.0, 0.0]
        slow.acknowledge()


def test_a_stop_while_paused_is_read_at_once(slow: Runtime) -> None:
    slow.start(ticks=3)
    slow.wait_paused()
    slow.stop()
    until(lambda: slow.status().trip is not None, "the loop has taken it")
    tick, _ = slow.read(["drive"])
    trip = slow.status().trip
    assert trip is not None and tick >= trip.tick and slow.ended()


def test_the_log_holds_every_update_that_was_acknowledged(desk: Desk) -> None:
    for k in range(1, 6):
        tick = desk.ask("update", values={"a": float(k)}).tick
        last = desk.ask("log")[-1]
        assert (last.name, last.new, last.tick) == ("a", float(k), tick)


def test_a_table_that_is_due_at_a_sample_is_acknowledged_at_that_sample(slow: Runtime) -> None:
    """A sample that has passed means the next one. For a future one nobody waits."""
    desk = desk_of(slow)
    slow.start()
    until(lambda: slow.status().tick > 20, "it runs")
    for ahead in (-20, 5):
        due = slow.status().tick + ahead
        _begin(desk, [float(ahead)] * 8)
        applied = desk.ask("table_commit", upload=desk.upload, at_tick=due)  # type: ignore[attr-defined]
        assert applied.tick >= due
        if ahead > 0:
            until(lambda tick=applied.tick: slow.status().tick > tick, "its sample has come")
        assert np.array_equal(np.ravel(slow.read(["ref"])[1]["ref"]), [float(ahead)] * 8)
        assert slow.log()[-1].tick == applied.tick


def _begin(desk: Desk, values: list[float]) -> None:
    from zendsp_protocol.chunks import crc

    data = np.array(values).tobytes()
    begun = desk.ask("table_begin", name="ref", dtype="<f8", length=len(values), crc=crc(data))
    desk.upload = begun.upload  # type: ignore[attr-defined]
    desk.ask("table_chunk", upload=begun.upload, offset=0, data=data, crc=crc(data))


def test_an_update_of_a_program_that_was_replaced_is_never_said_to_be_applied(
    slow: Runtime, load: Callable[[Runtime, str], None]
) -> None:
    """Updates of the next program have numbers of their own."""
    sequence = slow.write({"a": 1.0}, "me", at_tick=10**9)
    load(slow, SLOW)
    for k in range(5):
        slow.wait_applied(slow.write({"a": 2.0 + k}, "you"), 10.0)
    with pytest.raises(RunnerDied, match=f"update {sequence}: .* no longer loaded"):
        slow.wait_applied(sequence, 0.01)


# writes a line, which takes a while, as over a bus that is slow
SLOWLY_SAFE = """
    const struct timespec slow = {.tv_nsec = 50000000};
    nanosleep(&slow, NULL);
    FILE *f = fopen("%s", "a");
    if (f) { fputs("safe\\n", f); fclose(f); }
"""


def test_hardware_is_safe_when_a_pause_is_acknowledged(make_runtime: Make, tmp_path: Path) -> None:
    source, said = tmp_path / "fake.c", tmp_path / "said"
    source.write_text(driver(SLOWLY_SAFE % said))
    runtime = make_runtime(SLOW, machine=str(source), rate_hz=100.0, clock="real", realtime=False)
    until(said.exists, "it is safe from the start")
    runtime.start()
    until(lambda: runtime.read(["aout"])[1]["aout"] != 0.0, "it moves")
    said.unlink()
    runtime.pause()
    assert said.exists()
    assert runtime.status().drive_mode == "off"
    assert runtime.read(["aout", "drive"])[1] == {"aout": 0.0, "drive": 0.0}


def test_stop_is_confirmed_while_another_host_waits_for_the_loop(slow: Runtime) -> None:
    """The lane of STOP takes no lock that is held while the loop is waited for."""
    desk = desk_of(slow)
    drives = desk.service.drives
    held, done = threading.Event(), threading.Event()

    def wait() -> None:
        with drives._lock:
            held.set()
            done.wait(30.0)

    thread = threading.Thread(target=wait)
    thread.start()
    assert held.wait(30.0)
    answer: list[object] = []
    asked = threading.Thread(target=lambda: answer.append(desk.ask("stopped")), daemon=True)
    asked.start()
    asked.join(5.0)
    confirmed = bool(answer)
    done.set()
    thread.join()
    assert confirmed
