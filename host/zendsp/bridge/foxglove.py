"""A target for Foxglove and PlotJuggler: signals, parameters and events over the Foxglove protocol.

It is a viewer of the target like any other: the loop does not notice. The server listens on the
loopback only. Its protocol knows no users: a door before it (`door`) lets in viewers of this user,
and no foreign web page.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from zendsp.bridge.door import HOST, Door, drawn_host
from zendsp.bridge.protobuf import MESSAGE, PACKAGE, Rows
from zendsp.errors import LinkError, Refused, ZendspError
from zendsp.extras import need
from zendsp.link import Target
from zendsp.link.background import background
from zendsp.link.live import LiveBlock, LiveView
from zendsp_protocol import messages as m
from zendsp_protocol.states import ProgramState, VariableKind
from zendsp_protocol.values import Assignable

PORT = 8765  # where viewers look first
POLL_S = 0.2  # between looks at the state
SIGNALS, EVENTS = "/signals", "/events"
BEHIND_S = 0.5
LONGEST = 64  # elements; longer parameters are data
INFO, WARNING, ERROR = 2, 3, 4  # levels of foxglove.Log
LOG_SCHEMA = {
    "type": "object",
    "title": "foxglove.Log",
    "properties": {
        "timestamp": {
            "type": "object",
            "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
        },
        "level": {"type": "integer"},
        "message": {"type": "string"},
        "name": {"type": "string"},
    },
}


class Bridge:
    """Serves a target to Foxglove and PlotJuggler on the loopback, until it is closed.

    Parameters
    ----------
    target : Target
    channels : sequence of str
        Signals to show; default all signals of the program.
    port : int
        On the loopback; 0 takes a free one.
    rate : float, Hz
        Rows a second at the most.
    writable : bool
        Viewers may write parameters; all of one message in one sample.

    Raises
    ------
    LinkError
        The port is taken, or foxglove-sdk is not installed.

    Attributes
    ----------
    behind : tuple of str and int
        Where the server itself listens.
    """

    def __init__(
        self,
        target: Target,
        channels: Sequence[str] = (),
        *,
        port: int = PORT,
        rate: float = 100.0,
        writable: bool = False,
    ) -> None:
        self._fox = need("foxglove", "foxglove", "the bridge", LinkError)
        self.target, self._channels = target, tuple(channels)
        self._rate, self._writable = rate, writable
        self._context = self._fox.Context()
        self._signals: Any = None
        self._events = self._fox.Channel(EVENTS, schema=LOG_SCHEMA, context=self._context)
        self._view: LiveView | None = None
        self._form = Rows((), ())
        self._offset = float("nan")  # Unix time of the target's t = 0, s
        self._names: tuple[str, ...] = ()
        self._sent: dict[str, Any] = {}
        self._known: m.Status | None = None
        self._closing = threading.Event()
        self._server = self._serve()
        try:
            self._door = Door(port, self.behind)
        except OSError as error:
            self._server.stop()
            raise LinkError(f"port {port} of {HOST} cannot be taken ({error}): --port") from error
        try:
            self._watch()
        except BaseException:
            self._door.close()
            self._server.stop()
            raise
        self._poller = background("bridge", self._poll)

    @property
    def url(self) -> str:
        """The address to open in a viewer."""
        return f"ws://{HOST}:{self._door.port}"

    def close(self) -> None:
        """End the server; the target goes on."""
        self._closing.set()
        self._door.close()
        self._poller.join(2.0)
        if self._view is not None:
            self._view.close()
        self._server.stop()

    def __enter__(self) -> Bridge:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _serve(self) -> Any:
        """Start the server behind the door, on an address that nobody knows."""
        host = drawn_host()
        server = self._fox.start_server(
            name=f"zendsp {self.target.name}", host=host, port=0, context=self._context,
            capabilities=[self._fox.websocket.Capability.Parameters],
            server_listener=_Listener(self),
        )
        self.behind: tuple[str, int] = (host, server.port)
        return server

    def alone(self) -> bool:
        """Whether every viewer was let in by the `Door`; others get no answer."""
        return self._door.alone()

    # -- what goes out

    def _poll(self) -> None:
        failed = ""  # why the last look did, said once
        while not self._closing.wait(POLL_S):
            if not self.alone():  # another user, who found the server: all come again by the door
                self._server.stop()
                self._server = self._serve()
                self._door.behind = self.behind
                self._say("somebody went past the bridge's port and was thrown out", WARNING)
            try:
                self._watch()
            except ZendspError as error:  # a link that is away comes back by itself
                if str(error) != failed:
                    self._say(f"{error}", ERROR)
                failed, self._known = str(error), None
            else:
                failed = ""

    def _watch(self) -> None:
        """Read the state, and publish what is new."""
        now = self.target.status()
        old, self._known = self._known, now
        if old is None or now.program != old.program or now.t < old.t:
            self._follow(now)
        if old is None or (now.state, now.drive) != (old.state, old.drive):
            self._say(f"program {now.state}, drives {now.drive}", INFO)
        if now.trip is not None and (old is None or old.trip != now.trip):
            self._say(f"trip at sample {now.trip.tick}: {now.trip.text}", ERROR)
        if now.crash and (old is None or old.crash != now.crash):
            self._say(f"crash: {now.crash}", ERROR)
        fresh = self.parameters()
        changed = [name for name, value in fresh.items() if self._sent.get(name) != value]
        if changed:
            self._sent = fresh
            self._server.publish_parameter_values(self.as_parameters(changed, fresh))

    def _follow(self, status: m.Status) -> None:
        """Use the signals and parameters of the program that is loaded now."""
        if self._view is not None:
            self._view.close()
            self._view = None
        self._names, self._sent = (), {}
        if status.state in (ProgramState.EMPTY, ProgramState.CRASHED):
            return
        infos = self.target.variables()
        self._names = tuple(
            n for n, i in infos.items() if i.kind == VariableKind.PARAMETER and i.length <= LONGEST
        )
        wanted = self._channels or [n for n, i in infos.items() if i.kind == VariableKind.SIGNAL]
        if not wanted:
            return
        self._offset = float("nan")
        every = max(1, round(status.rate_hz / self._rate))
        columns = columns_of(wanted, infos)
        units = {n: infos[n].unit for n, _, _ in columns if n in infos}
        names = ["time" if "t" in wanted else "t", *(n for n, _, _ in columns)]
        widths = [1, *(part.stop - part.start for _, part, _ in columns)]
        self._form = Rows(names, widths)
        if self._signals is not None:
            self._signals.close()
        self._signals = self._fox.Channel(
            SIGNALS,
            message_encoding="protobuf",
            schema=self._fox.Schema(
                name=f"{PACKAGE}.{MESSAGE}", encoding="protobuf", data=self._form.schema
            ),
            context=self._context,
            metadata={n: u for n, u in units.items() if u},
        )
        self._view = self.target.live(wanted, decimation=every, history=0.1, callback=self._rows)

    def _rows(self, block: LiveBlock) -> None:
        """Publish rows; called by the view's thread."""
        if len(block.t) == 0 or not self._signals.has_sinks():
            return
        newest = time.time() - float(block.t[-1])
        # begun anew only where the target fell behind, as by a pause: times never run back
        if not newest <= self._offset + BEHIND_S:
            self._offset = newest
        rows = self._form.encode(np.column_stack((block.t, block.data)))
        for t, row in zip(block.t.tolist(), rows, strict=True):
            self._signals.log(row, log_time=int((self._offset + t) * 1e9))

    def _say(self, text: str, level: int) -> None:
        now = time.time_ns()
        stamp = {"sec": now // 10**9, "nsec": now % 10**9}
        body = {"timestamp": stamp, "level": level, "message": text, "name": self.target.name}
        self._events.log(json.dumps(body).encode(), log_time=now)
        if level >= WARNING:
            self._server.publish_status(text, self._fox.websocket.StatusLevel.Warning)

    # -- parameters

    def parameters(self) -> dict[str, Assignable]:
        """All parameters of the program, from one sample."""
        if not self._names:
            return {}
        values = self.target.read(self._names).values
        return {name: np.asarray(value).tolist() for name, value in values.items()}

    def as_parameters(self, names: Sequence[str], values: Mapping[str, Assignable]) -> list[Any]:
        """The parameters in the form of the protocol."""
        return [self._fox.Parameter(n, value=values[n]) for n in names or values if n in values]

    def write(self, values: Mapping[str, Assignable]) -> None:
        """Write parameters for a viewer, all in one sample, or say why not."""
        if not self.alone():
            return
        if not self._writable:
            self._say("parameters are read only here: start the bridge with --write", WARNING)
            return
        try:
            infos = self.target.variables()
            other = [n for n in values if n in infos and infos[n].kind != VariableKind.PARAMETER]
            if other:
                raise Refused(f"{', '.join(other)}: no parameter, and only these are written here")
            whole = {n: _as_declared(n, v, infos.get(n)) for n, v in values.items()}
            tick = self.target.variables.update_alone(whole)
            self._say(f"{', '.join(values)} written at sample {tick}", INFO)
        except ZendspError as error:
            self._say(f"not written: {error}", WARNING)


class _Listener:
    """Handles the requests of viewers; called by the server's threads."""

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge

    def on_get_parameters(
        self, client: Any, param_names: list[str], request_id: str | None = None
    ) -> list[Any]:
        return self._present(param_names)

    def on_set_parameters(
        self, client: Any, parameters: list[Any], request_id: str | None = None
    ) -> list[Any]:
        self._bridge.write({p.name: p.get_value() for p in parameters})
        return self._present([p.name for p in parameters])

    def _present(self, names: list[str]) -> list[Any]:
        try:
            known = self._bridge.parameters() if self._bridge.alone() else {}
            return self._bridge.as_parameters(names, known)
        except ZendspError:  # the poller says so
            return []

    def on_subscribe(self, client: Any, channel: Any) -> None: ...
    def on_unsubscribe(self, client: Any, channel: Any) -> None: ...
    def on_client_advertise(self, client: Any, channel: Any) -> None: ...
    def on_client_unadvertise(self, client: Any, client_channel_id: int) -> None: ...
    def on_message_data(self, client: Any, client_channel_id: int, data: bytes) -> None: ...
    def on_parameters_subscribe(self, param_names: list[str]) -> None: ...
    def on_parameters_unsubscribe(self, param_names: list[str]) -> None: ...
    def on_connection_graph_subscribe(self) -> None: ...
    def on_connection_graph_unsubscribe(self) -> None: ...


foxglove = Bridge  # zendsp.bridge.foxglove(target) serves it until it is closed


def columns_of(
    names: Sequence[str], infos: dict[str, m.VariableInfo]
) -> list[tuple[str, slice, bool]]:
    """The columns of each signal in a row, and whether it is a single number."""
    found, at = [], 0
    for name in names:
        width = infos[name].length if name in infos else 1
        found.append((name, slice(at, at + width), width == 1))
        at += width
    return found


def _as_declared(name: str, value: Any, info: m.VariableInfo | None) -> Any:
    """A number in the type that the program declares: JSON does not tell 1 from 1.0 or true."""
    if isinstance(value, dict | bytes):
        raise Refused(f"{name}: is a number or an array, not a {type(value).__name__}")
    if info is None or not isinstance(value, int | float):
        return value
    if info.type == "bool" and value in (0, 1):
        return bool(value)
    if isinstance(value, bool):  # the target refuses it
        return value
    if info.type == "int32" and float(value).is_integer():
        return int(value)
    return float(value) if info.type in ("double", "float") else value
