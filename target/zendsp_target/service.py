"""What each verb does: the arguments are checked already, errors are replies, and nothing here knows Zenoh."""

from __future__ import annotations

import os
import platform
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import metadata
from typing import Any

import msgspec
import numpy as np

from zendsp_protocol import keys, values, verbs
from zendsp_protocol import messages as m
from zendsp_protocol.errors import Refused, VariableError
from zendsp_protocol.version import PROTOCOL
from zendsp_target.api import AcquireConfig, CompileResult, RuntimeApi, Status, Trigger, VariableInfo
from zendsp_target.drives import Drives
from zendsp_target.live import LiveStreams
from zendsp_target.uploads import Uploads

PLAIN = frozenset((float, int, bool))
RECORDER = 0  # the acquisition stream that `acquire_…` verbs speak of
REMEMBERED = 32  # programs whose sources are kept for the recordings
APPLY_INLINE_S = 0.005  # an update that needs longer is finished by another thread
APPLY_LIMIT_S = 5.0
CATCH_UP_S = 0.05  # for the sample that an update was acknowledged at to be finished
POST_MORTEM_S = 4.0  # at most, until it is known how a runner died


class Later(Exception):
    """Raised by a handler that would wait: the rest is to be run by another thread."""

    def __init__(self, rest: Callable[[], Any]) -> None:
        self.rest = rest


@dataclass(frozen=True)
class Identity:
    """What the target says of itself."""

    name: str
    machine: str
    started: float


class Service:
    """Handlers of all verbs, in terms of a runtime.

    ``handlers`` maps each verb to ``function(arguments, author) -> result``; more may be added before the server starts.
    """

    def __init__(
        self, runtime: RuntimeApi, identity: Identity, live: LiveStreams, managed: bool = False
    ) -> None:
        self.runtime = runtime
        self.identity = identity
        self.live = live
        self.uploads = Uploads()
        self.present: Callable[[], tuple[str, ...]] = tuple
        self.drives = Drives(runtime, managed)
        self._programs: OrderedDict[str, m.Program] = OrderedDict()
        self._recorder_owner = ""
        self._log_start = 0
        self._acknowledged = 0  # newest sample that a host was told of
        self._lock = threading.Lock()
        self.handlers: dict[str, Callable[[Any, str], Any]] = {
            name: getattr(self, f"do_{name}") for name in verbs.VERBS if hasattr(self, f"do_{name}")
        }
        self.drives.guard(self.handlers)

    # the target ------------------------------------------------------------------------------------------------------

    def do_info(self, args: verbs.Nothing, by: str) -> m.Info:
        status = self.runtime.status()
        packages = ("zendsp", "eclipse-zenoh", "numpy", "msgspec", "cffi")
        versions = {"python": platform.python_version(), "kernel": platform.release()}
        versions |= {name: _version(name) for name in packages}
        return m.Info(
            v=PROTOCOL,
            name=self.identity.name,
            machine=self.identity.machine,
            joints=status.joints,
            rate_hz=status.rate_hz,
            clock=status.clock,
            pid=os.getpid(),
            hostname=platform.node(),
            versions=versions,
            verbs=[name for name in verbs.VERBS if name in self.handlers or name == "acquire_read"],
            started=self.identity.started,
        )

    def do_status(self, args: verbs.Nothing, by: str) -> Any:
        status = self.runtime.status()
        if status.state == "crashed" and not status.crash:
            raise Later(self._post_mortem)
        return self._shown(status)

    def _shown(self, status: Status) -> Any:
        return {**_with_hosts(status, self.present()), "drive": self.drives.state(status)}

    def _post_mortem(self) -> Any:
        """Status of a runner that is dead already, once it is known how it died."""
        deadline = time.monotonic() + POST_MORTEM_S
        status = self.runtime.status()
        while status.state == "crashed" and not status.crash and time.monotonic() < deadline:
            time.sleep(0.005)
            status = self.runtime.status()
        return self._shown(status)

    def do_stop(self, args: verbs.Nothing, by: str) -> m.Empty:
        self.runtime.stop()
        return m.Empty()

    # machine and drives ----------------------------------------------------------------------------------------------

    def do_machine(self, args: verbs.Nothing, by: str) -> Any:
        return self.runtime.machine()

    def do_limits(self, args: verbs.Nothing, by: str) -> Any:
        return self.runtime.limits()

    def do_set_limits(self, args: verbs.SetLimits, by: str) -> dict[str, int]:
        given = {name: getattr(args, name) for name in args.__struct_fields__}
        changes = {n: tuple(v) if isinstance(v, list) else v for n, v in given.items() if v is not None}
        return {"sequence": self.runtime.set_limits(by, **changes)}

    def do_set_drive(self, args: verbs.SetDrive, by: str) -> m.Empty:
        self.runtime.set_drive(args.mode)
        return m.Empty()

    def do_set_ramp(self, args: verbs.SetRamp, by: str) -> m.Empty:
        self.runtime.set_ramp(args.seconds)
        return m.Empty()

    def do_set_overrun(self, args: verbs.SetOverrun, by: str) -> m.Empty:
        self.runtime.set_overrun(args.policy, args.limit)
        return m.Empty()

    def do_set_inputs(self, args: verbs.SetInputs, by: str) -> m.Empty:
        self.runtime.set_inputs(args.bits)
        return m.Empty()

    def do_home(self, args: verbs.Nothing, by: str) -> m.Empty:
        self.runtime.home()
        return m.Empty()

    def do_acknowledge(self, args: verbs.Nothing, by: str) -> m.Empty:
        self.runtime.acknowledge()
        return m.Empty()

    # what a simulated machine conceals ----------------------------------------------------------------------------------

    def do_seal(self, args: verbs.Nothing, by: str) -> m.Seal:
        return m.Seal(sha256=self.runtime.seal())

    def do_reveal(self, args: verbs.Nothing, by: str) -> m.Revealed:
        record, sha256 = self.runtime.reveal(), self.runtime.seal()
        return m.Revealed(record=record, sha256=sha256, tick=self.runtime.status().tick)

    # programs --------------------------------------------------------------------------------------------------------

    def do_compile(self, args: verbs.Compile, by: str) -> CompileResult:
        result = self.runtime.compile(args.sources, args.flags)
        if result.ok:
            program = m.Program(
                key=result.key, sources=args.sources, flags=tuple(result.flags), compiler=result.compiler
            )
            with self._lock:
                self._programs[result.key] = program
                self._programs.move_to_end(result.key)
                while len(self._programs) > REMEMBERED:
                    self._programs.popitem(last=False)
        return result

    def do_load(self, args: verbs.Load, by: str) -> m.Empty:
        before = len(self.runtime.log())
        self.runtime.load(args.key)
        self._log_start = before
        self._acknowledged = 0
        self._recorder_owner = ""
        return m.Empty()

    def do_unload(self, args: verbs.Nothing, by: str) -> m.Empty:
        self.runtime.unload()
        return m.Empty()

    def do_start(self, args: verbs.Start, by: str) -> m.Empty:
        self.runtime.start(args.ticks)
        return m.Empty()

    def do_pause(self, args: verbs.Nothing, by: str) -> m.Empty:
        self.runtime.pause()
        return m.Empty()

    def do_program(self, args: verbs.Nothing, by: str) -> m.Program:
        key = self.runtime.status().program
        with self._lock:
            program = self._programs.get(key) or m.Program(key=key)
        return msgspec.structs.replace(program, log_start=self._log_start)

    # variables -------------------------------------------------------------------------------------------------------

    def do_variables(self, args: verbs.Nothing, by: str) -> tuple[VariableInfo, ...]:
        return tuple(_light(info) for info in self.runtime.variables())

    def do_builtins(self, args: verbs.Nothing, by: str) -> tuple[VariableInfo, ...]:
        return self.runtime.builtins()

    def do_read(self, args: verbs.Read, by: str) -> dict[str, Any]:
        tick, found = self.runtime.read(args.names)
        deadline = 0.0
        # Whoever was told that an update took effect at a sample must not read the sample before it.
        while tick < self._acknowledged:
            now = time.monotonic()
            deadline = deadline or now + CATCH_UP_S
            if now > deadline:
                break  # the loop has stopped in the middle of a sample
            time.sleep(0.0001)
            tick, found = self.runtime.read(args.names)
        return {"tick": tick, "values": found}

    def do_write(self, args: verbs.Write, by: str) -> dict[str, int]:
        return {"sequence": self._write(args, by)}

    def do_update(self, args: verbs.Write, by: str) -> dict[str, int]:
        sequence = self._write(args, by)
        try:
            return self._applied(sequence, APPLY_INLINE_S)
        except Refused:  # not yet: it waits for its sample
            raise Later(lambda: self._applied(sequence, APPLY_LIMIT_S)) from None

    def do_wait_applied(self, args: verbs.Wait, by: str) -> dict[str, int]:
        return self._applied(args.sequence, min(args.timeout, 60.0))

    def do_log(self, args: verbs.Log, by: str) -> Any:
        return self.runtime.log(args.since)

    def _write(self, args: verbs.Write, by: str) -> int:
        given: dict[str, Any] = args.values  # type: ignore[assignment]
        odd = [name for name, value in given.items() if type(value) not in PLAIN]
        if odd:
            try:
                given = {**given, **{name: values.from_wire(given[name]) for name in odd}}
            except ValueError as error:
                raise VariableError(str(error)) from error
            given = self._shaped(given)
        return self.runtime.write(given, by, args.at_tick)

    def _shaped(self, given: dict[str, Any]) -> dict[str, Any]:
        """Give the values of a table that came flat their rows and columns back."""
        flat = [name for name, value in given.items() if isinstance(value, np.ndarray) and value.ndim == 1]
        columns = {i.name: i.columns for i in self.runtime.variables() if i.name in flat and i.kind == "table"}
        fits = [name for name in columns if given[name].size % columns[name] == 0]
        return {**given, **{name: given[name].reshape(-1, columns[name]) for name in fits}}

    def _applied(self, sequence: int, timeout: float) -> dict[str, int]:
        tick = self.runtime.wait_applied(sequence, timeout)
        self._acknowledged = max(self._acknowledged, tick)
        return {"sequence": sequence, "tick": tick}

    # large arrays ----------------------------------------------------------------------------------------------------

    def do_table_begin(self, args: verbs.TableBegin, by: str) -> verbs.TableState:
        self._check_table(args.name, args.length)
        number = self.uploads.begin(args.name, args.dtype, args.length, args.crc)
        return verbs.TableState(upload=number, received=0)

    def do_table_chunk(self, args: verbs.TableChunk, by: str) -> verbs.TableState:
        received = self.uploads.chunk(args.upload, args.offset, args.data, args.crc)
        return verbs.TableState(upload=args.upload, received=received)

    def do_table_commit(self, args: verbs.TableCommit, by: str) -> dict[str, int]:
        name, array = self.uploads.finish(args.upload)
        sequence = self.runtime.write(self._shaped({name: array}), by, args.at_tick)
        if args.at_tick is not None:
            return {"sequence": sequence, "tick": args.at_tick}
        return self._applied(sequence, APPLY_LIMIT_S)

    def _check_table(self, name: str, length: int) -> None:
        info = next((info for info in self.runtime.variables() if info.name == name), None)
        if info is None:
            raise VariableError(f"{name}: no such variable in the running code")
        if info.length < length:
            raise VariableError(f"{name}: {length} elements do not fit into {info.length}")
        if length % info.columns:
            raise VariableError(f"{name}: {length} elements are no whole number of rows of {info.columns}")

    # acquisition -----------------------------------------------------------------------------------------------------

    def do_acquire_configure(self, args: verbs.AcquireConfigure, by: str) -> Any:
        trigger = None if args.trigger is None else Trigger(
            args.trigger.source, args.trigger.level, args.trigger.edge, args.trigger.pre_s
        )  # fmt: skip
        config = AcquireConfig(tuple(args.channels), args.decimation, args.seconds, trigger, args.continuous)
        with self._lock:
            owner = self._recorder_owner
            busy = self.runtime.acquire_status(RECORDER).state in ("armed", "running") if owner else False
            if busy and owner != by and owner in self.present() and not args.take:
                raise Refused(f"{owner} is recording; wait, or take the recorder over (take=True)")
            status = self.runtime.acquire_configure(RECORDER, config)
            self._recorder_owner = by
        return status

    def do_acquire_start(self, args: verbs.AcquireStart, by: str) -> m.Empty:
        self.runtime.acquire_start(RECORDER, args.force)
        return m.Empty()

    def do_acquire_stop(self, args: verbs.Nothing, by: str) -> m.Empty:
        self.runtime.acquire_stop(RECORDER)
        return m.Empty()

    def do_acquire_status(self, args: verbs.Nothing, by: str) -> Any:
        return self.runtime.acquire_status(RECORDER)

    # live ------------------------------------------------------------------------------------------------------------

    def do_live_open(self, args: verbs.LiveOpen, by: str) -> m.LiveOpened:
        stream = self.live.open(args.channels, args.decimation, args.interval, args.window, by)
        rate = self.runtime.status().rate_hz
        return m.LiveOpened(
            stream=stream.number,
            key=keys.live(self.identity.name, stream.number),
            channels=stream.columns,
            units=stream.units,
            sample_time=args.decimation / rate,
        )

    def do_live_close(self, args: verbs.LiveClose, by: str) -> m.Empty:
        self.live.close_stream(args.stream, by)
        return m.Empty()

    def host_gone(self, host: str) -> None:
        """Give back what a vanished host held; the program goes on, unless that host commanded (see ``drives``)."""
        self.drives.host_gone(host)
        self.live.forget(host)


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "unknown"


def _light(info: VariableInfo) -> VariableInfo:
    """Shorten the initial value of a large array that is one value throughout: a table of zeros is not worth megabytes."""
    initial = info.initial
    if (
        isinstance(initial, np.ndarray)
        and initial.size > values.LIST_LIMIT
        and bool((initial == initial[0]).all())
    ):
        return replace(info, initial=initial[0].item())
    return info


def _with_hosts(status: Any, hosts: tuple[str, ...]) -> Mapping[str, Any]:
    return {**{name: getattr(status, name) for name in status.__dataclass_fields__}, "hosts": hosts}


def identity(name: str, machine: str) -> Identity:
    """Who this target is, from now on."""
    return Identity(keys.check_name(name), machine, time.time())
