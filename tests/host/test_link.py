"""What the link promises, over real Zenoh sessions, on a runtime without C."""

from __future__ import annotations

import gc
import io
import os
import socket
import subprocess
import threading
import time
import weakref
from pathlib import Path

import msgspec
import numpy as np
import pytest
import zenoh
from fake_runtime import FakeRuntime
from waiting import PATIENCE_S, until

from zendsp.errors import (
    AcquisitionError,
    CompileFailed,
    LinkError,
    Refused,
    VariableError,
    VersionMismatch,
)
from zendsp.link import ParameterSet, Target, connect, discover
from zendsp.link.connect import locate
from zendsp.link.registered import local_entries
from zendsp.link.settings import Credentials, zenoh_config
from zendsp_protocol import codec, keys
from zendsp_protocol import messages as m
from zendsp_protocol.registry import Entry, born
from zendsp_protocol.verbs import VERBS
from zendsp_target.monitor import Monitor


def test_a_target_is_found_by_name_alone(target: Target) -> None:
    assert target.info.name == "fake" and target.info.joints == 2
    assert target.info.verbs == list(VERBS)  # every verb of the protocol has a handler
    assert [found.name for found in discover("fa*")] == ["fake"]
    assert discover("x*") == []
    with connect() as again:  # only one runs here
        assert again.name == "fake"
    with pytest.raises(
        LinkError, match="no target named 'other' runs on this machine \\(there runs fake\\)"
    ):
        connect("other")
    with pytest.raises(
        LinkError, match=r"no target named 'other' at unixsock-stream/.*; there is fake"
    ):
        connect("other", connect=target.link.endpoints[0])


def test_a_target_that_connect_waits_for_is_found_too(target: Target) -> None:
    """A busy machine or a slow line: what it is answers after 1.5 s; connect() waits 3 s."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        place = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    slow = zenoh.Config()
    slow.insert_json5("mode", '"peer"')
    slow.insert_json5("scouting/multicast/enabled", "false")
    slow.insert_json5("listen/endpoints", f'["{place}"]')
    said = codec.encode(msgspec.structs.replace(target.info, name="slow"))

    def answer(query: zenoh.Query) -> None:
        time.sleep(1.5)
        query.reply(keys.info("slow"), said)

    with zenoh.open(slow) as session:
        session.declare_queryable(keys.info("slow"), answer)
        assert "slow" in [found.name for found in discover("*", place)]


def test_silent_places_are_waited_for_together(monitor: Monitor) -> None:
    """Each place that takes a connection and says nothing costs its timeout, once for all of them.
    """
    silent = [socket.create_server(("127.0.0.1", 0)) for _ in range(6)]
    places = [f"tcp/127.0.0.1:{s.getsockname()[1]}" for s in silent]
    try:
        times = []
        for some in (places[:1], places):
            began = time.monotonic()
            assert [found.name for found in discover("*", some, timeout=1.5)] == ["fake"]
            times.append(time.monotonic() - began)
    finally:
        for s in silent:
            s.close()
    assert times[0] > 1.4, "one is waited for"
    assert times[1] < 4.0 * times[0], "in turn it were six times that"


def test_write_and_read_asynchronously(running: Target) -> None:
    running["Kp1"] = 400.0
    running["on"] = np.bool_(True)
    until(lambda: running["Kp1"] == 400.0 and running["on"] is True, "the write took effect")
    reading = running.read(["q", "q[1]", "Kp1"])
    assert reading["q"][1] == reading["q[1]"] == -reading["q"][0]


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
    assert str(caught.value).splitlines() == [
        "Kp1: 2000.0 is above its maximum 1000.0",
        "nope: no such variable",
        "on: NaN",
    ]
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


def test_compile_errors_name_file_line_and_column(target: Target) -> None:
    with pytest.raises(CompileFailed, match=r"^bad.c:3:7: error: expected ';'$") as caught:
        target.compile({"bad.c": "syntax error"})
    assert caught.value.result.diagnostics[0].line == 3  # type: ignore[attr-defined]


def test_a_slow_compile_holds_up_neither_stop_nor_reads(
    running: Target, runtime: FakeRuntime
) -> None:
    runtime.compile_gate.clear()
    compiles = [threading.Thread(target=running.compile, args=({"a.c": "x"},)) for _ in range(3)]
    for thread in compiles:
        thread.start()
    try:
        assert running["Kp1"] == 100.0
        running.stop()
        assert running.status().state == "stopped"
        assert all(thread.is_alive() for thread in compiles)
    finally:
        runtime.compile_gate.set()
        for thread in compiles:
            thread.join(PATIENCE_S)


def test_acquire_returns_every_sample_with_its_circumstances(running: Target) -> None:
    running.update(Kp1=5.0)
    done: list[float] = []
    rec = running.acquire(
        ["q", "Kp1"], seconds=0.2, decimation=2, note="hello", progress=done.append
    )
    assert rec.columns == ("q[0]", "q[1]", "Kp1") and len(rec) == 100 and rec.lost == 0
    assert np.array_equal(rec["q"][:, 0], rec.start_tick + 2 * np.arange(100))
    assert np.allclose(rec.t, rec["q[0]"] / 1000.0)
    assert (
        rec.sources == {"a.c": "int a;"} and rec.machine == "fake_machine" and rec.note == "hello"
    )
    assert any(change.name == "Kp1" and change.new == 5.0 for change in rec.log)
    assert rec.parameters["Kp1"] == 5.0 and rec.timing["exec_max_ns"] == 2
    assert done[-1] == 1.0


def test_acquire_with_start_begins_at_the_first_sample(target: Target) -> None:
    target.download({"a.c": "int a;"})
    with pytest.raises(Refused, match="the program is loaded; start it first"):
        target.acquire(["q"], 0.05)
    rec = target.acquire(["q"], seconds=0.05, start=True)
    assert rec.start_tick == 0 and len(rec) == 50
    assert target.wait().state == "paused"
    with pytest.raises(AcquisitionError, match="nope: no such channel"):
        target.acquire(["nope"], 0.05, start=True)


def test_a_recorder_in_use_is_refused_to_others_unless_taken(running: Target) -> None:
    running.acquire_configure(["q"], seconds=60.0)
    running.acquire_start()
    with connect("fake") as other:
        with pytest.raises(Refused, match=f"{running.link.author} is recording"):
            other.acquire(["q"], 0.05)
        assert len(other.acquire(["q"], 0.05, take=True)) == 50


def test_run_for_counts_samples_exactly(target: Target) -> None:
    target.download({"a.c": "int a;"})
    assert target.run_for(0.1).tick == 100
    assert target.run_for(0.05).tick == 150


def test_large_tables_arrive_whole_in_one_sample(running: Target, runtime: FakeRuntime) -> None:
    values = np.random.default_rng(0).normal(size=(50_000, 4))
    running.upload("ref", values)
    assert np.array_equal(runtime.values["ref"].reshape(-1, 4), values)
    with pytest.raises(VariableError, match="200001 elements do not fit into 200000"):
        running.upload("ref", np.zeros(200_001))
    assert isinstance(running.variables()["ref"].initial, float)  # not a megabyte of zeros


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


def raw_session(target: Target) -> zenoh.Session:
    return zenoh.open(zenoh_config(target.link.endpoints, Credentials(), 3.0))


def ask(session: zenoh.Session, key: str, payload: bytes | None) -> bytes:
    replies = list(session.get(key, payload=payload, timeout=5.0))
    assert len(replies) == 1, f"{key}: {len(replies)} replies"
    answer = replies[0].ok or replies[0].err
    assert answer is not None
    return answer.payload.to_bytes()


@pytest.mark.parametrize("lane", keys.LANES)
def test_malformed_messages_get_an_error_reply_and_nothing_else_happens(
    running: Target, lane: str
) -> None:
    rng = np.random.default_rng(7)
    good = codec.encode_request("write", {"values": {"Kp1": 4.0}}, "me")
    bad: list[bytes | None] = [
        None,
        b"",
        b"\x00",
        b"{}",
        b"\xc1",
        good[:-3],
        codec.encode([1, 2]),
        codec.encode({"v": 1}),
    ]
    bad += [rng.bytes(int(n)) for n in rng.integers(1, 400, 20)]
    bad += [
        codec.encode_request("write", {"values": {"Kp1": "x"}}, "me"),
        codec.encode_request("write", {}, "me"),
    ]
    bad += [
        codec.encode_request("write", {"values": {}, "typo": 1}, "me"),
        codec.encode_request("nonsense", {}, "me"),
    ]
    with raw_session(running) as session:
        for payload in bad:
            with pytest.raises((LinkError, VersionMismatch)):
                codec.decode_reply(ask(session, keys.rpc("fake", lane), payload), m.Empty)
    assert running["Kp1"] == 100.0 and running.status().state == "running"


def test_an_old_host_meeting_a_new_target_gets_a_clear_sentence(running: Target) -> None:
    with raw_session(running) as session:
        request = codec.encode_request("status", {}, "me", version=0)
        reply = ask(session, keys.rpc("fake", "quick"), request)
        with pytest.raises(
            VersionMismatch,
            match=(
                "the host speaks protocol 0, the target speaks protocol 1: upgrade zendsp on the"
                " host"
            ),
        ):
            codec.decode_reply(reply, m.Status)
        newer = codec.encode({"v": 99, "completely": "different"})
        with pytest.raises(VersionMismatch, match="upgrade zendsp on the target"):
            codec.decode_reply(ask(session, keys.rpc("fake", "quick"), newer), m.Status)


def test_any_zenoh_client_reads_a_variable_and_follows_the_state(running: Target) -> None:
    with raw_session(running) as session:
        value = codec.decode(ask(session, "zendsp/fake/var/Kp1", None), dict)
        assert (
            value["value"] == 100.0
            and value["unit"] == "N m/rad"
            and value["v"] == 1
            and value["tick"] >= 0
        )
        found = {str(r.ok.key_expr) for r in session.get("zendsp/*/var/K$*") if r.ok is not None}
        assert found == {"zendsp/fake/var/Kp1", "zendsp/fake/var/Kd1"}
        error = codec.decode(ask(session, "zendsp/fake/var/nope", None), dict)
        assert "no variable matches" in error["error"]["message"]
        events = session.declare_subscriber("zendsp/*/event")
        running.pause()
        deadline = time.monotonic() + PATIENCE_S
        while codec.decode(events.recv().payload.to_bytes(), dict)["state"] != "paused":
            assert time.monotonic() < deadline


def test_who_is_connected_is_known_and_a_host_that_leaves_is_gone(running: Target) -> None:
    with connect("fake") as other:
        until(lambda: other.link.author in running.status().hosts, "the other host is seen")
        view = other.live(["q"])
    until(lambda: other.link.author not in running.status().hosts, "the other host has gone")
    view.close()
    with pytest.raises(LinkError, match="connection to 'fake' is closed"):
        other.status()


def test_a_target_that_is_not_ready_in_time_is_told_as_that() -> None:
    from zendsp.link.connect import _wait_ready

    with (
        subprocess.Popen(["sleep", "60"], stdout=subprocess.PIPE) as process,
        pytest.raises(LinkError, match=r"not ready within 0\.1 s; it said: runs as root"),
    ):
        _wait_ready(process, io.BytesIO(b"runs as root"), 0.1)


def test_a_target_elsewhere_that_ends_is_not_waited_for(target: Target, monitor: Monitor) -> None:
    from zendsp_target.monitor import Options

    target.link.own = False  # elsewhere, there is no process to look for
    assert not target.link.ended
    monitor.close()
    until(lambda: not target.alive, "the end is noticed")
    begin = time.monotonic()
    with pytest.raises(LinkError, match=r"'fake' at .* has ended: 'write' was not answered"):
        target.link.request("write", {"values": {"Kp1": 1.0}}, timeout=PATIENCE_S)
    assert time.monotonic() < begin + PATIENCE_S / 2, "it waited for an answer"
    with pytest.raises(LinkError, match=r"has ended: 'status' was not answered"):
        target.status()
    again = Monitor(FakeRuntime(), Options("fake", "fake_machine"))
    try:
        until(lambda: target.alive, "the target is back")
        assert not target.link.ended
    finally:
        again.close()


def test_a_target_that_ends_is_reported_at_once_and_a_second_of_its_name_is_refused(
    target: Target, monitor: Monitor, runtime: FakeRuntime
) -> None:
    from zendsp_target.monitor import Options

    monitor.close()
    until(lambda: not target.alive, "the end is noticed")
    with pytest.raises(
        LinkError, match=r"target 'fake' at unixsock-stream/.* has ended: 'status' was not answered"
    ):
        target.status()
    begin = time.monotonic()
    with pytest.raises(
        LinkError,
        match=r"has ended: 'write' was not answered.*Whether it was applied cannot be known",
    ):
        target.link.request("write", {"values": {"Kp1": 1.0}}, timeout=PATIENCE_S)
    assert time.monotonic() < begin + PATIENCE_S / 2, "nobody is left to send it to"
    with pytest.raises(LinkError, match="no target named 'fake' runs on this machine"):
        connect("fake")
    with pytest.raises(
        LinkError, match=r"no target runs on this machine\. Start one with 'zendsp target'"
    ):
        connect()
    again = Monitor(runtime, Options("fake", "fake_machine"))
    again.close()


def test_an_unexpected_failure_inside_the_target_is_an_answer_too(
    running: Target, runtime: FakeRuntime
) -> None:
    runtime.values["Kp1"] = object()
    with pytest.raises(Refused, match=r"the target failed inside .* this is a bug"):
        running.read(["Kp1"])
    runtime.values["Kp1"] = 1.0
    assert running["Kp1"] == 1.0


def test_unknown_verbs_and_arguments_are_refused_by_name(target: Target) -> None:
    with pytest.raises(Refused, match="no such request 'dance'"):
        target.request("dance")
    with pytest.raises(LinkError, match="unknown field `speed`"):
        target.request("status", speed=3)


def test_an_endpoint_in_the_environment_is_meant_though_a_target_of_that_name_runs_here(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert locate(target.info.name)[1] != ["tcp/elsewhere:7447"]
    monkeypatch.setenv("ZENDSP_CONNECT", "tcp/elsewhere:7447")
    assert locate(target.info.name) == (target.info.name, ["tcp/elsewhere:7447"], None)


@pytest.mark.parametrize(
    ("credentials", "said"),
    [
        (Credentials(authority="none.pem"), "ZENDSP_TLS_CA.*none.pem.*cannot be read"),
        (Credentials(certificate=__file__), "certificate needs its key"),
    ],
)
def test_credentials_that_cannot_work_are_named_before_anything_is_sent(
    credentials: Credentials, said: str
) -> None:
    with pytest.raises(LinkError, match=said):
        zenoh_config(["tls/localhost:1"], credentials, 1.0)


def test_a_second_link_of_the_same_program_need_not_stand_among_the_hosts(running: Target) -> None:
    with connect("fake") as other, connect("fake", shown=False) as stopper:
        until(lambda: len(running.status().hosts) == 2, "the other host is shown")
        assert set(running.status().hosts) == {running.link.author, other.link.author}
        stopper.stop()
        assert running.status().state == "stopped"


def ask_on(
    other: Target, said: list[BaseException], verb: str, arguments: dict[str, object]
) -> None:
    try:
        while True:
            other.request(verb, **arguments)
    except BaseException as error:
        said.append(error)


def test_a_link_that_is_closed_while_others_ask_tells_them_so(running: Target) -> None:
    for _ in range(10):
        other, said = connect("fake"), list[BaseException]()
        threads = [
            threading.Thread(target=ask_on, args=(other, said, "read", {"names": ["Kp1"]})),
            threading.Thread(target=ask_on, args=(other, said, "write", {"values": {"Kp1": 1.0}})),
        ]
        for thread in threads:
            thread.start()
        time.sleep(0.01)  # any moment will do
        other.close()
        for thread in threads:
            thread.join(PATIENCE_S)
        assert [type(error) for error in said] == [LinkError, LinkError], said


@pytest.mark.timeout(60)
def test_rubbish_among_the_entries_of_targets_keeps_nobody_from_finding_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """STOP looks there too: what does not end when it is read must not be read."""
    tmp_path.chmod(0o700)
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(tmp_path))
    os.mkfifo(tmp_path / "a.json")
    (tmp_path / "b.json").symlink_to("/dev/zero")
    (tmp_path / "c.json").symlink_to("c.json")
    (tmp_path / "d.json").mkdir()
    (tmp_path / "e.json").write_text('{"x": ' + "[" * 50_000 + "]" * 50_000 + "}")
    (tmp_path / "f.json").write_bytes(bytes(range(256)))
    whole = Entry(
        name="imi", pid=os.getpid(), born=born(os.getpid()), endpoints=[], machine="m", protocol=1
    )
    (tmp_path / "imi.json").write_bytes(msgspec.json.encode(whole))
    assert local_entries() == [whole]
