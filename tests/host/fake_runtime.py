"""A runtime without C, for tests of the server and the link alone: a thread that counts samples.

It keeps the promises of ``zendsp_target.api`` (all or nothing, next sample, one sample per read);
the real one is tested in tests/e2e and tests/target.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp_protocol.errors import AcquisitionError, CompileFailed, NotYet, Refused, VariableError
from zendsp_protocol.kept import About
from zendsp_protocol.messages import (
    AcquireStatus,
    Change,
    CompileResult,
    Diagnostic,
    Held,
    JointInfo,
    MachineInfo,
    Status,
    Timing,
    Trip,
    VariableInfo,
)
from zendsp_protocol.values import Value
from zendsp_target.api import AcquireConfig, Blank

INF = float("inf")
INFOS = (
    VariableInfo(
        "Kp1", "double", 1, "parameter", "N m/rad", 0.0, 1000.0, 100.0, "proportional gain", 0
    ),
    VariableInfo(
        "Kd1", "double", 1, "parameter", "N m s/rad", 0.0, 1000.0, 10.0, "derivative gain", 8
    ),
    VariableInfo("on", "bool", 1, "parameter", "", 0.0, 1.0, False, "a switch", 16),
    VariableInfo("q", "double", 2, "signal", "rad", -INF, INF, np.zeros(2), "positions", 24),
    VariableInfo(
        "ref", "double", 200_000, "table", "rad", -INF, INF, np.zeros(200_000), "a reference", 40
    ),
)


class FakeRuntime:
    """Counts samples at 1 kHz; ``q`` is ``[tick, -tick]``."""

    def __init__(self) -> None:
        self.lock = threading.Condition()
        self.values: dict[str, Any] = {info.name: info.initial for info in INFOS}
        self.changes: list[Change] = []
        self.pending: list[tuple[int, dict[str, Any], str]] = []
        self.sequence = self.applied = self.applied_tick = 0
        self.tick = 0
        self.limit: int | None = None
        self.state = "empty"
        self.key = ""
        self.crash = ""
        self.closed = False
        self.compile_gate = threading.Event()
        self.compile_gate.set()
        self.streams: dict[int, dict[str, Any]] = {}
        threading.Thread(target=self._loop, daemon=True).start()

    def _loop(self) -> None:
        while not self.closed:
            time.sleep(0.001)
            with self.lock:
                if self.state != "running":
                    continue
                self._sample()
                self.lock.notify_all()

    def _sample(self) -> None:
        for sequence, values, author in self.pending:
            for name, value in values.items():
                self.changes.append(
                    Change(self.tick, time.time(), name, self.values[name], value, author)
                )
            self.values |= values
            self.applied, self.applied_tick = sequence, self.tick
        self.pending.clear()
        self.values["q"] = np.array([self.tick, -self.tick], dtype=float)
        for stream in self.streams.values():
            config = stream["config"]
            if stream["state"] == "running" and self.tick % config.decimation == 0:
                if not stream["rows"]:
                    stream["start"] = self.tick
                stream["rows"].append([self._element(name) for name in stream["columns"]])
                if not config.continuous and len(stream["rows"]) >= stream["wanted"]:
                    stream["state"] = "done"
        self.tick += 1
        if self.limit is not None and self.tick >= self.limit:
            self.state, self.limit = "paused", None

    def _element(self, name: str) -> float:
        base, _, index = name.rstrip("]").partition("[")
        value = self.values[base]
        return float(value[int(index)]) if index else float(value)

    def compile(self, sources: Mapping[str, str], flags: Sequence[str] = ()) -> CompileResult:
        self.compile_gate.wait(30)
        if any("syntax error" in text for text in sources.values()):
            fault = Diagnostic("error", next(iter(sources)), 3, 7, "expected ';'")
            return CompileResult(False, "", (fault,), 0.1, False, "fake", tuple(flags))
        return CompileResult(True, "key1", (), 0.1, False, "fake 1", tuple(flags))

    def load(self, key: str) -> None:
        if key != "key1":
            raise CompileFailed(f"no compiled program {key!r}")
        with self.lock:
            self.state, self.key, self.tick = "loaded", key, 0

    def start(self, ticks: int | None = None) -> None:
        with self.lock:
            if self.state not in ("loaded", "paused"):
                raise Refused(f"cannot start: the state is {self.state}")
            self.limit = None if ticks is None else self.tick + ticks
            self.state = "running"

    def pause(self) -> None:
        with self.lock:
            self.state = "paused"

    def stop_page(self) -> str:
        return ""

    def stop(self, author: str = "") -> None:
        with self.lock:
            self.state = "stopped"

    def unload(self) -> None:
        with self.lock:
            self.state, self.key = "empty", ""

    def status(self) -> Status:
        counts = np.zeros(4, dtype=np.int64)
        timing = Timing(self.tick, 0, 0, 1.0, 2, 0.5, 3, counts, counts, np.geomspace(100, 1e6, 5))
        with self.lock:
            trip = Trip("stop", 0, self.tick, 0.0, 0.0, "STOP") if self.state == "stopped" else None
            return Status(
                self.state,
                self.tick,
                self.tick / 1000,
                1000.0,
                "real",
                "fake",
                "fake_machine",
                2,
                self.key,
                timing,
                "off",
                trip,
                self.crash,
                {"enc": np.zeros(2)},
            )

    def variables(self) -> tuple[VariableInfo, ...]:
        return INFOS if self.state != "empty" else ()

    def read(self, names: Sequence[str]) -> tuple[int, dict[str, Value]]:
        with self.lock:
            wrong = [name for name in names if name.partition("[")[0] not in self.values]
            if wrong:
                raise VariableError("\n".join(f"{name}: no such variable" for name in wrong))
            return self.tick, {n: self._element(n) if "[" in n else self.values[n] for n in names}

    def repeat_read(self, names: Sequence[str], reply: Blank) -> None:
        return None

    def repeat_write(self, name: str, author: str, value_at: int, reply: Blank) -> None:
        return None

    def ended(self) -> str:
        return f"the program crashed: {self.crash}" if self.state == "crashed" else ""

    def check(self, values: Mapping[str, Value]) -> None:
        wrong = []
        infos = {info.name: info for info in INFOS}
        for name, value in values.items():
            if name not in infos:
                wrong.append(f"{name}: no such variable")
            elif np.any(np.isnan(value)):
                wrong.append(f"{name}: NaN")
            elif np.any(np.asarray(value) > infos[name].maximum):
                wrong.append(f"{name}: {value} is above its maximum {infos[name].maximum}")
        if wrong:
            raise VariableError("\n".join(wrong))

    def write(self, values: Mapping[str, Value], author: str, at_tick: int | None = None) -> int:
        self.check(values)
        with self.lock:
            self.sequence += 1
            self.pending.append((self.sequence, dict(values), author))
            if self.state != "running":
                self._flush()
            return self.sequence

    def _flush(self) -> None:
        for sequence, values, _ in self.pending:
            self.values |= values
            self.applied, self.applied_tick = sequence, self.tick
        self.pending.clear()

    def wait_applied(self, sequence: int, timeout: float) -> int:
        with self.lock:
            if not self.lock.wait_for(lambda: self.applied >= sequence, timeout):
                raise NotYet("not applied in time")
            return self.applied_tick

    def machine(self) -> MachineInfo:
        return MachineInfo("fake_machine", joints=(JointInfo("one", torque_max=float("inf")),))

    def log(self, since: int = 0) -> tuple[Change, ...]:
        return tuple(self.changes[since:])

    def acquire_configure(self, stream: int, config: AcquireConfig) -> AcquireStatus:
        columns = []
        for name in config.channels:
            if name.partition("[")[0] not in self.values:
                raise AcquisitionError(f"{name}: no such channel")
            columns += ["q[0]", "q[1]"] if name == "q" else [name]
        wanted = round(config.seconds * 1000 / config.decimation)
        with self.lock:
            self.streams[stream] = {
                "config": config,
                "columns": tuple(columns),
                "rows": [],
                "state": "idle",
                "wanted": wanted,
                "start": 0,
            }
        return self.acquire_status(stream)

    def acquire_start(self, stream: int, force: bool = False) -> None:
        self.streams[stream]["state"] = "running"

    def acquire_keep(self, about: About) -> None:
        self.about = about

    def acquire_stop(self, stream: int) -> None:
        if stream in self.streams:
            self.streams[stream]["state"] = "done"

    def acquire_status(self, stream: int) -> AcquireStatus:
        s = self.streams.get(stream)
        if s is None:
            return AcquireStatus("idle", (), (), 1, 0, 0, 0, 0, 0, -1)
        units = tuple("rad" if name.startswith("q") else "" for name in s["columns"])
        wanted = 0 if s["config"].continuous else s["wanted"]
        return AcquireStatus(
            s["state"],
            s["columns"],
            units,
            s["config"].decimation,
            0,
            len(s["rows"]),
            wanted,
            0,
            s["start"],
            -1,
        )

    def acquire_held(self, stream: int) -> Held:
        return Held()

    def acquire_read(
        self,
        stream: int,
        first: int,
        count: int,
        into: npt.NDArray[np.float64] | None = None,
        fold: bytearray | None = None,
    ) -> npt.NDArray[np.float64]:
        rows = np.array(self.streams[stream]["rows"][first : first + count], dtype=np.float64)
        if fold is not None:
            for at, byte in enumerate(rows.tobytes()):
                fold[at % len(fold)] ^= byte
        if into is None:
            return rows
        into[: len(rows)] = rows
        return into[: len(rows)]

    def close(self) -> None:
        self.closed = True
