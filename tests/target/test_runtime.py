"""The runtime seam on the planar arm: compile, load, start, read, write, acquire, in both clocks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from samples import run
from waiting import until

from zendsp_protocol.chunks import FOLD, crc, folded_crc
from zendsp_protocol.errors import AcquisitionError, Refused, VariableError
from zendsp_protocol.messages import Trigger
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime, program_text
from zendsp_target.runtime.programs import set_up


@pytest.fixture(params=["fast", "real"])
def runtime(request: pytest.FixtureRequest) -> Iterator[Runtime]:
    with Runtime("imi_planar", clock=request.param) as made:
        result = made.compile({"pd.c": program_text("pd")})
        assert result.ok, result.diagnostics
        made.load(result.key)
        yield made


def test_a_program_runs_exactly_the_samples_asked_for(runtime: Runtime) -> None:
    assert runtime.status().state == "loaded"
    run(runtime, 200)
    status = runtime.status()
    assert (status.state, status.tick, status.t) == ("paused", 200, 0.2)
    run(runtime, 1)
    assert runtime.status().tick == 201


def test_a_recording_has_one_row_a_sample_and_nothing_lost(runtime: Runtime) -> None:
    status = runtime.acquire_configure(0, AcquireConfig(("tick", "q", "aout[1]"), seconds=0.3))
    assert status.channels == ("tick", "q[0]", "q[1]", "aout[1]")
    assert status.units == ("", "rad", "rad", "mV")
    runtime.acquire_start(0)
    run(runtime, 310)
    status = runtime.acquire_status(0)
    assert (status.state, status.count, status.lost, status.start_tick) == ("done", 300, 0, 0)
    rows = runtime.acquire_read(0, 0, 1000)
    assert rows.shape == (300, 4)
    assert np.array_equal(rows[:, 0], np.arange(300))


def test_an_update_takes_effect_at_its_sample_and_is_logged_with_the_old_value(
    runtime: Runtime,
) -> None:
    runtime.acquire_configure(0, AcquireConfig(("Kp1", "Kd1"), seconds=0.2))
    runtime.acquire_start(0)
    sequence = runtime.write({"Kp1": 1234.0, "Kd1": 56.0}, "me", at_tick=100)
    runtime.start(ticks=200)
    assert runtime.wait_applied(sequence, 10.0) == 100
    runtime.wait_paused()
    rows = runtime.acquire_read(0, 0, 200)
    assert np.array_equal(rows[:, 0], np.where(np.arange(200) < 100, 2000.0, 1234.0))
    assert np.array_equal(rows[:, 1], np.where(np.arange(200) < 100, 120.0, 56.0))
    assert [(c.tick, c.name, c.old, c.new, c.author) for c in runtime.log()] == [
        (100, "Kp1", 2000.0, 1234.0, "me"),
        (100, "Kd1", 120.0, 56.0, "me"),
    ]


def test_a_table_switches_over_whole_at_one_sample_with_its_length(runtime: Runtime) -> None:
    runtime.write({"approach_time": 0.4, "use_table": True}, "me")
    first = np.full((500, 2), 0.25)
    sequence = runtime.write({"ref": first}, "me")
    run(runtime, 600)
    runtime.wait_applied(sequence, 10.0)
    tick, values = runtime.read(["ref", "r1", "tick"])
    assert np.array_equal(values["ref"], first)
    assert values["r1"] == 0.25
    assert tick == values["tick"] == 599
    second = np.array([[0.1, 0.2], [0.3, 0.4]])
    runtime.write({"ref": second}, "me", at_tick=700)
    run(runtime, 300)
    assert np.array_equal(runtime.read(["ref"])[1]["ref"], second)
    assert [(c.old, c.new) for c in runtime.log() if c.name == "ref"] == [(0, 500), (500, 2)]


def test_one_wrong_variable_stops_the_whole_update_and_each_is_named(runtime: Runtime) -> None:
    with pytest.raises(VariableError) as caught:
        runtime.write(
            {
                "Kp1": 1.0,
                "Kp2": -1.0,
                "Kd1": float("nan"),
                "none": 1,
                "q1": 1.0,
                "row_rate": 1.5,
                "use_table": 2,
            },
            "me",
        )
    lines = str(caught.value).splitlines()
    assert [line.split(":")[0] for line in lines] == [
        "Kp2", "Kd1", "none", "q1", "row_rate", "use_table",
    ]
    assert "0 … 5000" in lines[0]
    assert runtime.read(["Kp1"])[1]["Kp1"] == 2000.0
    assert runtime.log() == ()


@pytest.mark.parametrize("reason", ["stop", "host lost"])
def test_stop_is_latched_until_acknowledged(runtime: Runtime, reason: str) -> None:
    runtime.start()
    runtime.trip(reason)
    runtime_state_is(runtime, "stopped")
    trip = runtime.status().trip
    assert trip is not None and trip.reason == reason
    with pytest.raises(Refused, match="acknowledge"):
        runtime.pause()
        runtime.start()
    runtime.acknowledge()
    assert runtime.status().state == "paused"
    run(runtime, 5)


@pytest.mark.parametrize("later", ["stop", "host lost"])
def test_the_loop_ends_no_trip_that_came_while_one_was_acknowledged(
    runtime: Runtime, later: str
) -> None:
    runtime.start()
    runtime.trip("stop")
    runtime_state_is(runtime, "stopped")
    seen = runtime.status().trip
    assert seen is not None
    runtime.trip(later)
    until(lambda: runtime.status().trip == replace(seen, number=seen.number + 1), "it is counted")
    runtime.acknowledge(seen.number)
    assert runtime.status().state == "stopped"
    runtime.acknowledge(seen.number + 1)
    assert runtime.status().state == "paused"


def test_where_no_loop_runs_no_stop_is_acknowledged_but_the_one_that_is_meant(
    runtime: Runtime,
) -> None:
    runtime.start()
    runtime.stop("anna")
    runtime_state_is(runtime, "stopped")
    runtime.unload()
    seen = runtime.status().trip
    assert seen is not None
    runtime.stop("bo")
    runtime.acknowledge(seen.number)
    later = runtime.status().trip
    assert later is not None and later.number == seen.number + 1
    runtime.acknowledge(later.number)
    assert runtime.status().trip is None


def test_a_stop_that_comes_while_its_page_is_set_up_stands() -> None:
    class Head:
        magic = version = asked = 0

        @property
        def stop(self) -> int:
            before, self.asked = self.asked, 1  # a host asks right after the look
            return before

        @stop.setter
        def stop(self, value: int) -> None:
            self.asked = value

    head = Head()
    page: Any = SimpleNamespace(pointer=lambda _: head)
    set_up(page)
    assert head.asked == 1


def runtime_state_is(runtime: Runtime, state: str) -> None:
    until(lambda: runtime.status().state == state, f"it is {state}", runtime.status)


def test_a_trigger_keeps_what_came_before_it(runtime: Runtime) -> None:
    runtime.write({"approach_time": 0.2}, "me")
    config = AcquireConfig(
        ("tick", "t"), seconds=0.1, trigger=Trigger("t", 0.2, "rising", pre_s=0.04)
    )
    runtime.acquire_configure(3, config)
    runtime.acquire_start(3)
    run(runtime, 400)
    status = runtime.acquire_status(3)
    assert (status.state, status.wanted, status.trigger_row, status.first) == (
        "done", 100, 200, 160,
    )
    rows = runtime.acquire_read(3, status.first, status.wanted)
    assert np.array_equal(rows[:, 0], np.arange(160, 260))


def test_a_forced_trigger_fires_once_and_only_the_armed_acquisition(runtime: Runtime) -> None:
    config = AcquireConfig(
        ("tick",), seconds=0.02, trigger=Trigger("t", 1e6, "rising", pre_s=0.005)
    )
    runtime.acquire_configure(2, config)
    runtime.acquire_start(2)
    run(runtime, 50)
    assert runtime.acquire_status(2).state == "armed"
    runtime.acquire_start(2, force=True)
    run(runtime, 50)
    status = runtime.acquire_status(2)
    assert (status.state, status.trigger_row) == ("done", 50)
    assert np.array_equal(runtime.acquire_read(2, status.first, 20)[:, 0], np.arange(45, 65))
    runtime.acquire_start(2)
    run(runtime, 50)
    assert runtime.acquire_status(2).state == "armed"  # armed anew: the old force is spent


def test_a_ring_keeps_the_newest_rows_and_counts_what_a_reader_missed(runtime: Runtime) -> None:
    runtime.acquire_configure(
        1, AcquireConfig(("tick",), seconds=0.1, continuous=True, decimation=2)
    )
    runtime.acquire_start(1)
    run(runtime, 600)
    status = runtime.acquire_status(1)
    assert (status.state, status.count, status.first, status.wanted) == ("running", 300, 250, 0)
    rows = runtime.acquire_read(1, status.first, 50)
    assert np.array_equal(rows[:, 0], 2.0 * np.arange(250, 300))
    with pytest.raises(AcquisitionError, match="overwritten"):
        runtime.acquire_read(1, 0, 200)
    assert runtime.acquire_status(1).lost > 0


def test_rows_are_folded_into_their_checksum_on_the_way_also_across_the_end_of_a_ring(
    runtime: Runtime,
) -> None:
    runtime.acquire_configure(
        1, AcquireConfig(("tick", "t", "exec_us"), seconds=0.3, continuous=True)
    )
    runtime.acquire_start(1)
    run(runtime, 600)
    # the ring holds 364 rows: row 364 follows the last place
    for first, count in ((300, 300), (300, 2), (301, 171), (370, 200)):
        fold = bytearray(FOLD)
        rows = runtime.acquire_read(1, first, count, fold=fold)
        assert np.array_equal(rows[:, 0], np.arange(first, first + count))
        assert crc(fold) == folded_crc(rows.tobytes())


@pytest.mark.parametrize("ticks", [0, -1, 2**53 + 1, 2**64 - 1])
def test_a_number_of_samples_that_cannot_be_is_refused(runtime: Runtime, ticks: int) -> None:
    with pytest.raises(Refused, match=f"ticks = {ticks}: give 1 to"):
        runtime.start(ticks)
    assert runtime.status().state == "loaded"


def test_a_log_line_that_is_not_yet_written_is_not_returned(runtime: Runtime) -> None:
    sequence = runtime.write({"Kp1": 300.0}, "me")
    runtime.start(ticks=5)
    runtime.wait_applied(sequence, 10.0)
    runtime.wait_paused()
    assert [c.name for c in runtime.log(0)] == ["Kp1"]
    assert runtime.log(1) == runtime.log(2**64 - 1) == ()


def test_a_unit_and_a_description_of_several_lines_are_told_on_one(
    make_runtime: Callable[..., Runtime],
) -> None:
    """A row of a table has one line, in a terminal as at a prompt."""
    runtime = make_runtime(
        '#include "isr.h"\nstatic double K;\nvoid UserInit(void) {\n'
        '    PARAMETER(K, 1.0, "N m\\n", 0.0, 9.0, "gain,\\r\\n\\tof the outer loop\\n");\n}\n'
        "void UserISR_INT2(void) {}\nvoid UserBackground(void) {}\n"
    )
    (info,) = (v for v in runtime.variables() if v.name == "K")
    assert (info.unit, info.description) == ("N m", "gain, of the outer loop")
