"""A viewer that speaks the Foxglove protocol sees signals, parameters and events of a target."""

from __future__ import annotations

import base64
import contextlib
import itertools
import json
import os
import socket
import struct
import subprocess
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("foxglove")
connect = pytest.importorskip("websockets.sync.client").connect
ConnectionClosed = pytest.importorskip("websockets.exceptions").ConnectionClosed

from waiting import PATIENCE_S, until  # noqa: E402

from zendsp.bridge import Bridge, foxglove  # noqa: E402
from zendsp.bridge.foxglove import WARNING  # noqa: E402
from zendsp.errors import LinkError, Refused  # noqa: E402
from zendsp.link import Target, local  # noqa: E402


@pytest.fixture(scope="module")
def target() -> Iterator[Target]:
    with local("imi_planar", clock="fast", options=["--speed", "5"]) as made:
        made.download("pd.c")
        made.start()
        yield made


class Viewer:
    """The part of a Foxglove viewer that the tests need."""

    def __init__(self, bridge: Bridge, protocol: Any = "foxglove.sdk.v1") -> None:
        self._connection = connect(bridge.url, subprotocols=[protocol])
        self.topics: dict[str, dict[str, Any]] = {}

    def __enter__(self) -> Viewer:
        self.socket = self._connection.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._connection.__exit__(*error)

    def until(self, wanted: Callable[[Any], bool]) -> Any:
        """The first message that fulfils a condition: JSON, or the body of a row."""
        while True:
            data = self.socket.recv(timeout=PATIENCE_S)
            message = json.loads(data) if isinstance(data, str) else self._row(data)
            for channel in message.get("channels", ()):
                self.topics[channel["topic"]] = channel
            if wanted(message):
                return message

    def _row(self, data: bytes) -> dict[str, Any]:
        opcode, channel, stamp = struct.unpack_from("<BIQ", data)
        if opcode != 1:
            return {}
        of, body = next(c for c in self.topics.values() if c["id"] == channel), data[13:]
        if of["encoding"] == "json":
            return {"row": json.loads(body), "stamp": stamp}
        names = _names(of["schema"])
        read = {names[k]: [x for x, in struct.iter_unpack("<d", v)] for k, v in _fields(body)}
        return {"row": {n: v[0] if len(v) == 1 else v for n, v in read.items()}, "stamp": stamp}

    def ask(self, op: str, **values: Any) -> None:
        self.socket.send(json.dumps({"op": op, **values}))

    def subscribe(self, topic: str) -> None:
        if topic not in self.topics:
            self.until(lambda _: topic in self.topics)
        channel = self.topics[topic]["id"]
        self.ask("subscribe", subscriptions=[{"id": channel, "channelId": channel}])


def _fields(data: bytes) -> Iterator[tuple[int, Any]]:
    """The fields of a Protobuf message: their numbers and values."""
    at = 0

    def varint() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    while at < len(data):
        number, kind = divmod(varint(), 8)
        if kind == 0:
            yield number, varint()
            continue
        size = 8 if kind == 1 else varint()
        yield number, data[at : at + size]
        at += size


def _names(schema: str) -> dict[int, str]:
    """The names of the fields of a message, by their numbers, from its description."""
    (_, file), = _fields(base64.b64decode(schema))
    message = next(body for number, body in _fields(file) if number == 4)
    fields = [dict(_fields(body)) for number, body in _fields(message) if number == 2]
    assert all(f[5] == 1 for f in fields), "doubles"
    return {f[3]: f[1].decode() for f in fields}


def test_every_signal_arrives_with_its_time_and_its_schema(target: Target) -> None:
    with foxglove(target, port=0) as bridge, Viewer(bridge) as viewer:
        viewer.subscribe("/signals")
        topic = viewer.topics["/signals"]
        # all that PlotJuggler takes beside ROS; names like Kp1 are none of ROS's
        assert topic["encoding"] == topic["schemaEncoding"] == "protobuf"
        assert topic["schemaName"] == "zendsp.Signals"
        rows = [viewer.until(lambda message: "row" in message) for _ in range(50)]
        times = [message["row"]["t"] for message in rows]
        assert all(b > a for a, b in itertools.pairwise(times))
        assert all(b["stamp"] > a["stamp"] for a, b in itertools.pairwise(rows))
        body = rows[-1]["row"]
        assert body["q"] == [body["q1"], body["q2"]] and body["e1"] == body["r1"] - body["q1"]


def test_a_viewer_that_knows_the_protocol_by_its_former_name_comes_in(target: Target) -> None:
    # Lichtblick and viewers of before 2025 ask for it so
    name = "foxglove.websocket.v1"
    with foxglove(target, ["q1"], port=0) as bridge, Viewer(bridge, name) as viewer:
        assert viewer.socket.subprotocol == name
        viewer.subscribe("/signals")
        assert viewer.until(lambda message: "row" in message)["row"]["t"] > 0.0


def test_parameters_are_read_and_not_written_unless_asked_for(target: Target) -> None:
    with foxglove(target, ["q1"], port=0) as bridge, Viewer(bridge) as viewer:
        viewer.ask("getParameters", parameterNames=[], id="all")
        found = viewer.until(lambda message: message.get("id") == "all")["parameters"]
        assert {"name": "Kp1", "value": 2000.0, "type": "float64"} in found
        viewer.ask("setParameters", parameters=[{"name": "Kp1", "value": 700.0}], id="set")
        assert viewer.until(lambda m: m.get("op") == "status")["message"].endswith("--write")
        assert target["Kp1"] == 2000.0


def test_a_viewer_that_may_writes_and_a_refusal_says_why(target: Target) -> None:
    with foxglove(target, ["q1"], port=0, writable=True) as bridge, Viewer(bridge) as viewer:
        try:
            viewer.ask("setParameters", parameters=[{"name": "Kp1", "value": 700}], id="a")
            answer = viewer.until(lambda message: message.get("id") == "a")["parameters"]
            assert answer[0]["value"] == 700.0 and target["Kp1"] == 700.0
            viewer.ask("setParameters", parameters=[{"name": "Kp1", "value": 1e9}], id="b")
            said = viewer.until(lambda message: message.get("op") == "status")["message"]
            assert "Kp1" in said and "20000" in said
            assert target["Kp1"] == 700.0
            viewer.ask("subscribeParameterUpdates", parameterNames=["Kp1"])
            target["Kp1"] = 800.0  # by somebody else
            viewer.until(
                lambda m: any(
                    p == {"name": "Kp1", "value": 800.0, "type": "float64"}
                    for p in m.get("parameters", ())
                )
            )
        finally:
            target["Kp1"] = 2000.0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"name": "Kp1", "value": True}, "Kp1: true"),
        ({"name": "Kp1", "value": {"a": 1.0}}, "Kp1: is a number"),
        ({"name": "Kp1", "value": "AAAA", "type": "byte_array"}, "Kp1: is a number"),
        ({"name": "ref", "value": [0.1, 0.2]}, "ref: no parameter"),
    ],
)
def test_a_wrong_parameter_value_from_a_viewer_is_refused_in_words(
    target: Target, given: dict[str, Any], said: str
) -> None:
    with foxglove(target, ["q1"], port=0, writable=True) as bridge, Viewer(bridge) as viewer:
        viewer.ask("setParameters", parameters=[given], id="a")
        assert said.lower() in viewer.until(lambda m: m.get("op") == "status")["message"].lower()
        assert target["Kp1"] == 2000.0


def test_a_repeated_refusal_by_the_target_is_reported_once(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For example after a role was withdrawn, where it had been printed five times a second."""
    asked: list[str] = []

    def refused() -> dict[str, Any]:
        asked.append("")
        raise Refused("no role")

    with foxglove(target, ["q1"], port=0) as bridge, Viewer(bridge) as viewer:
        monkeypatch.setattr(bridge, "parameters", refused)
        until(lambda: len(asked) > 5, "it goes on looking")
        bridge._say("the end", WARNING)
        said: list[str] = []
        viewer.until(lambda m: said.append(m.get("message")) or said[-1] == "the end")
        assert said.count("no role") == 1


def test_a_trip_is_an_event(target: Target) -> None:
    with foxglove(target, ["q1"], port=0) as bridge, Viewer(bridge) as viewer:
        viewer.subscribe("/events")
        try:
            target.stop()
            viewer.until(lambda m: "trip at sample" in m.get("row", {}).get("message", ""))
        finally:
            target.acknowledge()
            target.start()


def _said(port: int, head: str = "") -> bytes:
    """The port's HTTP answer to a page or a program that asks for the protocol."""
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as link:
        link.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n{head}"
            "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
            "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
            .encode()
        )
        return link.recv(4096)


def test_a_foreign_web_page_does_not_come_in(target: Target) -> None:
    with foxglove(target, ["q1"], port=0) as bridge:
        port = int(bridge.url.rpartition(":")[2])
        for origin in ("https://app.foxglove.dev", "http://localhost:8080", "file://"):
            assert b" 101 " in _said(port, f"Origin: {origin}\r\n"), origin
        for origin in ("https://evil.example", "http://localhost.evil.example", "null", "http://["):
            assert b" 403 " in _said(port, f"origin: {origin}\r\n"), origin


@pytest.mark.skipif(os.getuid() != 0, reason="only root may be another user")
def test_another_user_of_this_computer_does_not_come_in(target: Target) -> None:
    code = (
        "import socket, sys; s = socket.create_connection(('127.0.0.1', int(sys.argv[1])));"
        "s.sendall(b'GET / HTTP/1.1\\r\\nOrigin: http://x\\r\\n\\r\\n'); print(s.recv(99))"
    )
    with foxglove(target, ["q1"], port=0) as bridge:
        words = ["/usr/bin/env", "python3", "-I", "-c", code, bridge.url.rpartition(":")[2]]
        for user, answered in ((0, True), (65534, False)):
            done = subprocess.run(words, user=user, capture_output=True, text=True, check=False)
            assert (" 403 " in done.stdout) is answered, done


def test_who_goes_past_the_door_is_thrown_out_and_writes_nothing(target: Target) -> None:
    with foxglove(target, ["q1"], port=0, writable=True) as bridge:
        before = target["Kp1"]
        past = f"ws://{bridge.behind[0]}:{bridge.behind[1]}"
        with connect(past, subprotocols=["foxglove.sdk.v1"]) as intruder:
            values = [{"name": "Kp1", "value": 77.0}]
            with pytest.raises(ConnectionClosed):
                intruder.send(json.dumps({"op": "setParameters", "parameters": values}))
                while True:
                    intruder.recv(timeout=PATIENCE_S)
        with Viewer(bridge) as viewer:  # whoever comes in by the door does
            viewer.subscribe("/signals")
            viewer.until(lambda message: "row" in message)
        assert target["Kp1"] == before


def test_a_port_that_is_taken_is_refused_and_the_server_is_on_the_loopback(target: Target) -> None:
    with foxglove(target, ["q1"], port=0) as bridge:
        assert bridge.url.startswith("ws://127.0.0.1:")
        port = int(bridge.url.rpartition(":")[2])
        with pytest.raises(LinkError, match=f"port {port}"), contextlib.closing(
            foxglove(target, ["q1"], port=port)
        ):
            raise AssertionError("two servers on one port")
