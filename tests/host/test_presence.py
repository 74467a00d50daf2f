"""Targets that are found, hosts that come and go, and targets that end."""

from __future__ import annotations

import io
import os
import pwd
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
import zenoh
from waiting import PATIENCE_S, until

from zendsp.cli.common import how_left
from zendsp.errors import (
    LinkError,
)
from zendsp.here.registered import local_entries
from zendsp.link import Target, connect, discover
from zendsp.link.connect import locate
from zendsp.link.settings import Credentials, zenoh_config
from zendsp_protocol import codec, keys
from zendsp_protocol.registry import Entry, born
from zendsp_protocol.verbs import VERBS
from zendsp_target.monitor import Monitor, Options
from zendsp_target.runtime import Runtime


def test_a_message_names_eight_targets_and_how_many_more_there_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    entries = [SimpleNamespace(name=f"t{k:02d}") for k in range(50)]
    monkeypatch.setattr(sys.modules[connect.__module__], "local_entries", lambda: entries)
    for name in ("other", ""):
        with pytest.raises(LinkError, match=r"t07 and 42 more, see 'zendsp ls'"):
            connect(name)


def test_a_target_is_found_by_name_alone(target: Target) -> None:
    assert target.info.name == "fake" and target.info.machine == "imi_planar"
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


def test_a_target_that_answers_slowly_is_found_by_name(target: Target) -> None:
    """On a busy machine or a slow line it answers after 1.5 s; connect() waits 3 s."""
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


def test_several_silent_endpoints_cost_one_timeout(monitor: Monitor) -> None:
    """Endpoints that accept a connection and stay silent are waited for at the same time."""
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
    again = Monitor(Runtime("imi_planar"), Options("fake", "imi_planar"))
    try:
        until(lambda: target.alive, "the target is back")
        assert not target.link.ended
    finally:
        again.close()


@pytest.mark.parametrize("wrong", ["", "joint 1 still has its torque"])
def test_a_target_that_ends_says_whether_its_machine_is_safe(
    wrong: str, target: Target, monitor: Monitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The host said NOT KNOWN, though the target knew."""
    monkeypatch.setattr(Runtime, "unsafe", wrong)
    assert target.link.farewell(0.0) is None, "one that runs has said nothing"
    monitor.close()
    until(lambda: not target.alive, "the end is noticed")
    assert target.link.farewell(PATIENCE_S) is (wrong == "")
    said = "machine is NOT in its safe state" if wrong else "machine is in its safe state"
    assert said in how_left(target)


def test_where_nobody_waits_any_more_a_request_fails_at_once(
    target: Target, monitor: Monitor
) -> None:
    """What puts things back after an outage waited 5 s for each of them."""
    target.link.give_up()
    assert not target.link.given_up, "it is not lost"
    monitor.close()
    until(lambda: not target.alive, "the end is noticed")
    target.link.own = target.link.ended = False  # as if it were elsewhere, and cut off
    target.link.give_up()
    begin = time.monotonic()
    with pytest.raises(LinkError):
        target.link.request("write", {"values": {"Kp1": 1.0}}, timeout=PATIENCE_S)
    assert time.monotonic() < begin + PATIENCE_S / 2, "it waited for the target to come back"
    again = Monitor(Runtime("imi_planar"), Options("fake", "imi_planar"))
    try:
        until(lambda: target.alive, "the target is back")
        assert not target.link.given_up
    finally:
        again.close()


def test_a_target_that_ends_is_reported_at_once_and_its_name_is_free(
    target: Target, monitor: Monitor, monkeypatch: pytest.MonkeyPatch
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
    anna = pwd.struct_passwd(("anna", "x", 1, 1, "", "/", "/bin/sh"))
    monkeypatch.setattr("pwd.getpwuid", lambda uid: anna)  # under sudo: root's, not of who typed it
    with pytest.raises(
        LinkError, match=r"no target of anna runs on this machine .*Start one with 'zendsp target'"
    ):
        connect()
    with pytest.raises(LinkError, match=r"\(there runs none of anna\)"):
        connect("fake")
    Monitor(Runtime("imi_planar"), Options("fake", "imi_planar")).close()


def test_an_endpoint_in_the_environment_beats_a_local_target_of_the_same_name(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert locate(target.info.name)[1] != ["tcp/elsewhere:7447"]
    monkeypatch.setenv("ZENDSP_CONNECT", "tcp/elsewhere:7447")
    assert locate(target.info.name) == (target.info.name, ["tcp/elsewhere:7447"], None)
    monkeypatch.setenv("ZENDSP_CONNECT", "tcp/127.0.0.1:1")
    unset = r"fake runs on this computer, but .ZENDSP_CONNECT leads to tcp/127.0.0.1:1: .* unset"
    for name in ("fake", ""):
        with pytest.raises(LinkError, match=unset):
            connect(name, timeout=0.3)
    for name, place in (("other", None), ("fake", "tcp/127.0.0.1:1")):
        with pytest.raises(LinkError, match="asks for a password or for encryption") as caught:
            connect(name, place, timeout=0.3)
        assert "unset" not in str(caught.value), "nothing else was meant"


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
def test_rubbish_in_the_registry_of_targets_does_not_hide_targets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """STOP looks there too, so an endless file must not be read to its end."""
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


def test_a_host_behind_a_router_does_all_that_one_beside_the_target_does(
    runtime: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        place = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    usual = zenoh.Config()
    usual.insert_json5("mode", '"router"')
    usual.insert_json5("scouting/multicast/enabled", "false")
    usual.insert_json5("listen/endpoints", f'["{place}"]')
    with zenoh.open(usual):
        monitor = Monitor(runtime, Options("behind", "imi_planar", connect=[place]))
        try:
            until(lambda: discover("behind", place), "the router knows it")
            with connect("behind", place) as host:
                host.download("pd.c")
                host.take_command()
                host.start()
                host.update(Kp1=900.0)
                assert host["Kp1"] == 900.0 and len(host.acquire(["q"], 0.1)) == 100
                with host.live(["q"]) as view:
                    assert len(next(iter(view)).t)
                assert host.stop().trip.reason == "stop"
                host.acknowledge()
                host.start()
                host.link.session.close()  # type: ignore[no-untyped-call]  # without a word
            until(lambda: runtime.status().trip is not None, "the policy acts")
            assert runtime.status().trip.reason == "host lost"
        finally:
            monitor.close()
