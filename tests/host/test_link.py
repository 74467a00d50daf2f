"""What the link promises, over real Zenoh sessions, in one process."""

from __future__ import annotations

import gc
import threading
import weakref
from typing import Any

import msgspec
import numpy as np
import pytest
from waiting import PATIENCE_S, until

from zendsp.errors import (
    AcquisitionError,
    CompileFailed,
    EndedWarning,
    Incomplete,
    LinkError,
    Refused,
    VariableError,
)
from zendsp.link import ParameterSet, Target, connect
from zendsp.matdsp import MatDSPcompile, MatDSPdownload
from zendsp_protocol.messages import CompileResult, JointInfo, MachineInfo
from zendsp_target.monitor import Monitor, Options
from zendsp_target.runtime import Runtime
from zendsp_target.serving.lanes import THREADS
from zendsp_target.serving.service import Service
from zendsp_target.serving.turns import Turns


def test_write_and_read_asynchronously(running: Target) -> None:
    for value in range(400, 450):  # what is read shows what was written, at once
        running["Kp1"] = value
        running["on"] = np.bool_(value % 2)
        assert (running["Kp1"], running["on"]) == (value, bool(value % 2))
    reading = running.read(["q", "q[1]", "Kp1"])
    assert reading["q"][1] == reading["q[1]"] == -reading["q"][0]


def test_several_names_in_brackets_are_refused_with_what_to_write(running: Target) -> None:
    asked: Any = ("Kp1", "Kd1")
    with pytest.raises(VariableError, match=r"target\.read\(\['Kp1', 'Kd1'\]\)"):
        running[asked]
    with pytest.raises(VariableError, match=r"target\.update\(Kp1=…, Kd1=…\)"):
        running[asked] = 1.0, 2.0
    with pytest.raises(VariableError, match="expected the name of a variable"):
        running[asked[:0]]


def test_a_target_that_tells_nonsense_of_itself_is_named(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = Service.do_info

    def nonsense(self: Service, args: Any, by: str) -> Any:
        return msgspec.structs.replace(told(self, args, by), instance="no hex")

    monkeypatch.setattr(Service, "do_info", nonsense)
    with Runtime("imi_planar", realtime=False) as runtime:
        monitor = Monitor(runtime, Options("other", "imi_planar"))
        try:
            with pytest.raises(LinkError, match="malformed instance, 'no hex'"):
                connect("other")
        finally:
            monitor.close()


def test_written_values_are_read_after_a_trip_and_an_ended_program_is_reported(
    running: Target
) -> None:
    running.stop()
    running.acknowledge()
    running.start()
    running.stop()
    running["Kp1"] = 321.0
    with pytest.warns(EndedWarning, match=r"ended, Kp1 is as it was set last: .*STOP"):
        assert running["Kp1"] == 321.0
    with pytest.warns(EndedWarning, match=r"ended, q\[0\] is that of its last sample: .*STOP"):
        running["q[0]"]


def test_update_applies_everything_staged_in_one_sample_and_says_which(running: Target) -> None:
    running.stage(Kp1=1.0)
    assert running.staged == {"Kp1": 1.0}
    tick = running.update(Kd1=2.0)
    assert running.staged == {}
    ours = [change for change in running.log() if change.name in ("Kp1", "Kd1")]
    assert {change.tick for change in ours} == {tick} and len(ours) == 2
    assert all(change.author == running.link.author for change in ours)


def test_a_wrong_batch_applies_nothing_and_names_each_offender(running: Target) -> None:
    running.stage(Kd1=3.0)
    with pytest.raises(VariableError) as caught:
        running.update(Kp1=2000.0, nope=1.0, on=float("nan"))
    lines = str(caught.value).splitlines()
    assert [line.partition(":")[0] for line in lines] == ["Kp1", "nope", "on"]
    assert lines[0] == "Kp1: 2000 N m/rad is outside its limits 0 … 1000 N m/rad"
    assert running.staged == {"Kd1": 3.0}
    assert running["Kd1"] == 10.0
    with pytest.raises(VariableError, match="Kp1: 'x' is not a number"):
        running["Kp1"] = "x"


def test_parameter_sets_save_diff_restore_and_reset(running: Target, tmp_path: object) -> None:
    before = running.parameters()
    running.update(Kp1=7.0, on=True)
    path = f"{tmp_path}/set.json"
    running.parameters().save(path)
    assert [(d.name, d.mine, d.other) for d in before.diff(ParameterSet.load(path))] == [
        ("Kp1", 100.0, 7.0), ("on", False, True),
    ]  # fmt: skip
    running.reset()
    until(lambda: running["Kp1"] == 100.0, "reset")
    running.restore(path)
    until(lambda: running["Kp1"] == 7.0, "restored")
    with pytest.raises(VariableError, match="not a parameter set"):
        ParameterSet.load(__file__)
    with pytest.raises(VariableError, match=r"are JSON; name it .*good\.json"):
        before.save(f"{tmp_path}/good.toml")


class Overdue:
    """A querier whose answer does not come in time."""

    ok = None

    def get(self, **_: object) -> Overdue:
        return self

    def recv(self) -> Overdue:
        return self


def test_an_update_that_got_no_answer_in_time_is_asked_for_again(
    loaded: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It had ended as "not answered: Timeout", without saying whether it was applied."""
    with monkeypatch.context() as patch:
        patch.setitem(loaded.link._queriers, "sync", Overdue())
        loaded.update(Kp1=250.0)
    assert loaded["Kp1"] == 250.0


def test_a_compile_dropped_by_a_flooded_target_is_requested_again(
    running: Target, runtime: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error had been "did not answer within 120 s", and came at once."""
    let_go: list[str] = []
    usual = Turns.next

    def flooded(turns: Turns) -> Any:
        query = usual(turns)
        while "/slow" in str(query.key_expr) and len(let_go) < 3:
            let_go.append(str(query.key_expr))
            query.drop()
            query = usual(turns)
        return query

    compiled = CompileResult(True, "", (), 0.0, False, "", ())
    monkeypatch.setattr(runtime, "compile", lambda *_: compiled)
    monkeypatch.setattr(Turns, "next", flooded)
    for _ in range(1 + THREADS["slow"]):  # the first ones by threads that wait already
        assert running.compile({"a.c": "x"}).ok
    assert let_go


def test_a_slow_compile_holds_up_neither_stop_nor_reads(
    running: Target, runtime: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = threading.Event()

    def slow(*_: object) -> CompileResult:
        gate.wait(PATIENCE_S)
        return CompileResult(True, "", (), 0.0, False, "", ())

    monkeypatch.setattr(runtime, "compile", slow)
    compiles = [threading.Thread(target=running.compile, args=({"a.c": "x"},)) for _ in range(3)]
    for thread in compiles:
        thread.start()
    try:
        assert running["Kp1"] == 100.0
        running.request("stop")  # over the link, as from another computer
        until(lambda: running.status().state == "stopped", "stopped")
        assert all(thread.is_alive() for thread in compiles)
    finally:
        gate.set()
        for thread in compiles:
            thread.join(PATIENCE_S)


def test_a_stop_is_told_of_the_connection_that_asked(running: Target) -> None:
    """It stood in the log as that of the first connection of the process."""
    with connect("fake") as other:
        trip = other.stop().trip
        assert trip is not None and f"by {other.link.author} at" in trip.text, trip
        assert other.link.author != running.link.author


def test_acquire_returns_every_sample_with_its_metadata(
    running: Target, runtime: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    endless = MachineInfo("imi_planar", joints=(JointInfo("one", torque_max=float("inf")),))
    monkeypatch.setattr(runtime, "machine", lambda: endless)
    running.update(Kp1=5.0)
    done: list[float] = []
    rec = running.acquire(
        ["q", "Kp1"], seconds=0.2, decimation=2, note="hello", progress=done.append
    )
    assert rec.columns == ("q[0]", "q[1]", "Kp1") and len(rec) == 100 and rec.lost == 0
    assert np.array_equal(rec["q"][:, 0], rec.start_tick + 2 * np.arange(100))
    assert np.allclose(rec.t, rec["q[0]"] / 1000.0)
    assert "q[0]" in rec.sources["a.c"] and rec.machine == "imi_planar" and rec.note == "hello"
    assert rec.extra["machine"]["joints"][0]["torque_max"] is None, "no limit, as JSON has it"
    assert any(change.name == "Kp1" and change.new == 5.0 for change in rec.log)
    assert rec.parameters["Kp1"] == 5.0 and rec.timing["exec_max_ns"] > 0
    assert done[-1] == 1.0


def test_acquire_with_start_begins_at_the_first_sample(loaded: Target) -> None:
    with pytest.raises(Refused, match="the program is loaded; start it first"):
        loaded.acquire(["q"], 0.05)
    rec = loaded.acquire(["q"], seconds=0.05, start=True)
    assert rec.start_tick == 0 and len(rec) == 50
    assert loaded.wait().state == "paused"
    with pytest.raises(AcquisitionError, match="nope: no such variable"):
        loaded.acquire(["nope"], 0.05, start=True)


def test_a_channel_named_twice_is_refused_before_it_is_recorded(running: Target) -> None:
    """Such a recording could not be loaded: its seconds had been lost."""
    before = running.acquire_status().begun
    with pytest.raises(AcquisitionError, match="q: is named twice"):
        running.acquire(["q", "tau", "q"], seconds=0.05)
    assert running.acquire_status().begun == before


def test_an_element_beside_its_vector_is_a_channel_of_its_own(running: Target) -> None:
    run = running.acquire(["q[0]", "q"], seconds=0.05)
    assert run.names == ("q[0]", "q")
    assert np.array_equal(run["q[0]"], run["q"][:, 0])


def test_a_recorder_in_use_is_refused_to_others_unless_taken(running: Target) -> None:
    running.acquire_configure(["q"], seconds=60.0)
    running.acquire_start()
    with connect("fake") as other:
        own = rf"another connection of your own process \({running.link.author}\) is recording"
        with pytest.raises(Refused, match=f"{own}.*--take"):
            other.acquire(["q"], 0.05)
        assert len(other.acquire(["q"], 0.05, take=True)) == 50


@pytest.mark.parametrize(
    ("what", "wrong", "says"),
    [
        ("load", Incomplete, "the program was replaced before the recording was complete"),
        ("take", Refused, r"\S+ began another recording on this target before this one was"),
    ],
    ids=["load", "take"],
)
def test_a_recording_whose_rows_would_be_others_is_no_recording(
    running: Target, what: str, wrong: type[Exception], says: str
) -> None:
    with connect("fake") as other:

        def disturb(_: float) -> None:
            if what == "load":
                other.download("template.c")
            elif other.acquire_status().channels != ("Kp1",):
                other.acquire_configure(["Kp1"], 60.0, take=True)
                other.acquire_start()

        with pytest.raises(wrong, match=says) as caught:
            running.acquire(["q"], 60.0, progress=disturb)
        if what == "load":
            assert "acquire_load() brings home" in caught.value.__notes__[0]
            assert running.acquire_load().columns == ("q[0]", "q[1]")


def test_what_another_host_recorded_meanwhile_is_not_taken_for_ones_own(running: Target) -> None:
    running.acquire_configure(["q"], seconds=0.05)
    running.acquire_start()
    assert running.acquire_finish().columns == ("q[0]", "q[1]")
    with connect("fake") as other:
        other.acquire(["Kp1"], 0.05, take=True)
        with pytest.raises(Refused, match=f"{other.link.author} began another recording on this"):
            running.acquire_finish()
        assert running.acquire_load().columns == ("Kp1",)
        assert other.acquire_finish().columns == ("Kp1",)
    running.acquire_start()  # what was configured by the other one, and it is this host's now
    assert running.acquire_finish().columns == ("Kp1",)


@pytest.mark.parametrize(
    ("what", "was"), [("pause", "paused"), ("stop", "stopped"), ("host lost", "stopped")]
)
def test_a_recording_that_another_host_cuts_short_says_so_and_keeps_what_there_is(
    running: Target, runtime: Runtime, what: str, was: str
) -> None:
    def disturb(done: float) -> None:
        if 0.0 < done < 0.9:  # soon, but for a busy computer
            runtime.pause() if what == "pause" else runtime.trip(what)

    says = rf"the program was {was} before the recording was complete \((\d+) of 10000 rows\)"
    with pytest.raises(Incomplete, match=says) as caught:
        running.acquire(["q"], 10.0, progress=disturb)
    assert "acquire_load() brings home" in caught.value.__notes__[0]
    rows = running.acquire_load()
    assert f"({len(rows)} of" in str(caught.value) and 0 < len(rows) < 10_000
    trip = running.status().trip
    assert (trip is None) == (what == "pause")
    assert str(caught.value).endswith("rows)" if trip is None else f"rows): {trip.text}")
    assert np.array_equal(rows["q[0]"], rows.start_tick + np.arange(len(rows)))


def test_a_recording_whose_host_was_lost_is_not_complete_for_those_who_wait_for_it(
    running: Target,
) -> None:
    with connect("fake") as other:
        other.take_command()
        other.acquire_configure(["q"], 60.0)
        other.acquire_start()
        until(lambda: other.acquire_status().count > 0, "rows")
        other.link.session.close()  # type: ignore[no-untyped-call]  # without a word
        until(lambda: running.acquire_status().state == "done", "the target ends it")
    with pytest.raises(Incomplete, match=r"the program was stopped before .* of 60000 rows"):
        running.acquire_finish()
    assert len(running.acquire_load()) > 0


def test_a_recording_that_is_not_complete_in_time_says_how_far_it_came(running: Target) -> None:
    running.acquire_configure(["q"], 60.0)
    running.acquire_start()
    says = r"not complete after 0.1 s \(\d+ of 60000 rows, running\)"
    with pytest.raises(Incomplete, match=says):
        running.acquire_finish(0.1)


def test_large_tables_arrive_whole_in_one_sample(running: Target) -> None:
    values = np.random.default_rng(0).normal(size=(50_000, 4))
    running.upload("ref", values.reshape(-1))
    assert np.array_equal(running["ref"], values)
    with pytest.raises(VariableError, match="200001 elements do not fit into 200000"):
        running.upload("ref", np.zeros(200_001))
    assert isinstance(running.variables()["many"].initial, float)  # not kilobytes of zeros


def test_a_damaged_or_missing_chunk_is_refused(running: Target) -> None:
    begun = running.request("table_begin", name="ref", dtype="<f8", length=4, crc=1)
    with pytest.raises(Refused, match="arrived damaged"):
        running.request("table_chunk", upload=begun.upload, offset=0, data=b"12345678", crc=5)
    with pytest.raises(Refused, match="does not follow byte 0 of 32"):
        running.request("table_chunk", upload=begun.upload, offset=8, data=b"", crc=0)
    with pytest.raises(Refused, match="not complete: 0 of 32 bytes"):
        running.request("table_commit", upload=begun.upload)


def test_live_rows_follow_one_another_without_gaps(running: Target) -> None:
    blocks = []
    with running.live(["q", "Kp1"], history=0.5) as view:
        for block in view:
            blocks.append(block)
            if view.received > 300:
                break
        newest = view.latest()
        t, data = view.window()
    assert view.columns == ("q[0]", "q[1]", "Kp1") and view.units[0] == "rad"
    joined = np.concatenate([block.data for block in blocks])
    assert np.array_equal(np.diff(joined[:, 0]), np.full(len(joined) - 1, 1.0)) or view.lost > 0
    assert newest["q[0]"] == -newest["q[1]"] and 0 < len(t) == len(data) <= 500
    assert np.allclose(t[~np.isnan(data[:, 0])] * 1000.0, data[~np.isnan(data[:, 0]), 0])


def test_live_streams_run_out_with_a_sentence_and_come_back(running: Target) -> None:
    views = [running.live(["q"], decimation=k + 1) for k in range(7)]
    shared = running.live(["q"], decimation=3)  # of the same channels: no stream of its own
    with pytest.raises(Refused, match="all 7 live streams are in use by"):
        running.live(["Kp1"])
    for view in [*views, shared]:
        view.close()
    running.live(["Kp1"]).close()


def test_a_closed_live_view_is_freed_while_the_link_lasts(running: Target) -> None:
    views = [running.live(["q"]) for _ in range(3)]
    held = [weakref.ref(view) for view in views]
    for view in views:
        view.close()
    del view
    views.clear()
    gc.collect()
    # else each change of the curves would grow the memory
    assert [view() for view in held] == [None] * 3


@pytest.mark.parametrize("verb", [MatDSPcompile, MatDSPdownload])
def test_swapped_target_and_file_arguments_are_refused_with_the_right_call(verb: object) -> None:
    target = object.__new__(Target)  # no link: what is refused asks for none
    with pytest.raises(CompileFailed, match=r"MatDSPconnect\(target\)"):
        verb(target, "pd.c")  # type: ignore[operator]
