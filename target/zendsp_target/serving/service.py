"""What each verb does. The arguments are checked already, errors become replies, and nothing here
knows Zenoh.
"""

from __future__ import annotations

import os
import platform
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from typing import Any

import msgspec

from zendsp_protocol import keys, verbs
from zendsp_protocol import messages as m
from zendsp_protocol.errors import Refused, RunnerDied
from zendsp_protocol.kept import About
from zendsp_protocol.states import ProgramState, VariableKind
from zendsp_protocol.values import Value, to_wire
from zendsp_protocol.version import PROTOCOL
from zendsp_target.api import RECORDER, AcquireConfig, RuntimeApi
from zendsp_target.serving.claim import Claim
from zendsp_target.serving.deferred import Later
from zendsp_target.serving.drives import Drives
from zendsp_target.serving.guard import Guard
from zendsp_target.serving.live_streams import LiveStreams
from zendsp_target.serving.machine_verbs import MachineVerbs
from zendsp_target.serving.repeated_requests import Repeats
from zendsp_target.serving.request_log import Once
from zendsp_target.serving.runs import Runs
from zendsp_target.serving.variable_verbs import VariableVerbs

# answered by the server: they need more than arguments and author
SPECIAL = ("acquire_read", "live_open")
REMEMBERED = 32  # programs whose sources are kept for the recordings
MOST_ELEMENTS = 1024  # of a parameter that is kept; longer arrays are data
POST_MORTEM_S = 4.0  # at most, until it is known how a runner died


@dataclass(frozen=True)
class Identity:
    """What the target says of itself."""

    name: str
    machine: str
    started: float


class Service:
    """Handlers of all verbs, in terms of a runtime.

    ``handlers`` maps each verb to ``function(arguments, author) -> result``; more may be added
    before the server starts.
    """

    def __init__(
        self, runtime: RuntimeApi, identity: Identity, live: LiveStreams, managed: bool = False
    ) -> None:
        self.runtime = runtime
        self.identity = identity
        self.live = live
        self.variables = VariableVerbs(runtime)
        self.claim = Claim(lambda: runtime.acquire_status(RECORDER))
        self.drives = Drives(runtime, managed)
        self.guard = Guard(self.drives)
        self.runs = Runs(runtime, self.drives)
        self.once = Once()
        self._programs: OrderedDict[str, m.Program] = OrderedDict()
        self._repeats: list[Repeats] = []
        self._recorded = False  # rows of the program that is loaded
        self._replaced: m.Replaced | None = None  # what made the rows, where it is loaded no more
        self._log_start = 0
        self._lock = threading.Lock()
        self.handlers: dict[str, Callable[[Any, str], Any]] = {
            name: getattr(room, f"do_{name}")
            for room in (MachineVerbs(runtime), self.variables, self.runs, self)
            for name in verbs.VERBS
            if hasattr(room, f"do_{name}")
        }
        self.guard.enter(self.handlers)

    # the target

    def do_info(self, args: verbs.Nothing, by: str) -> m.Info:
        status = self.runtime.status()
        packages = ("zendsp", "eclipse-zenoh", "numpy", "msgpack", "msgspec", "cffi")
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
            verbs=[name for name in verbs.VERBS if name in self.handlers or name in SPECIAL],
            started=self.identity.started,
            instance=self.once.instance.hex(),
        )

    def do_status(self, args: verbs.Nothing, by: str) -> m.Status:
        status = self.runtime.status()
        if status.state == ProgramState.CRASHED and not status.crash:
            raise Later(self._post_mortem)
        return self._shown(status)

    def _shown(self, status: m.Status) -> m.Status:
        return msgspec.structs.replace(
            status, hosts=self.claim.present(), drive=self.drives.state(status)
        )

    def _post_mortem(self) -> m.Status:
        """The status of a runner that has died, once it is known how."""
        deadline = time.monotonic() + POST_MORTEM_S
        status = self.runtime.status()
        while (
            status.state == ProgramState.CRASHED
            and not status.crash
            and time.monotonic() < deadline
        ):
            time.sleep(0.005)
            status = self.runtime.status()
        return self._shown(status)

    def do_stop(self, args: verbs.Nothing, by: str) -> m.Empty:
        self.runtime.stop(by)
        return m.Empty()

    def do_stopped(self, args: verbs.Nothing, by: str) -> m.Status:
        return self._shown(self.runtime.status())

    # what a simulated machine conceals

    def do_seal(self, args: verbs.Nothing, by: str) -> m.Seal:
        return m.Seal(sha256=self.runtime.seal())

    def do_reveal(self, args: verbs.Nothing, by: str) -> m.Revealed:
        record, sha256 = self.runtime.reveal(), self.runtime.seal()
        return m.Revealed(record=record, sha256=sha256, tick=self.runtime.status().tick)

    # programs

    def do_compile(self, args: verbs.Compile, by: str) -> m.CompileResult:
        result = self.runtime.compile(args.sources, args.flags)
        if result.ok:
            program = m.Program(
                key=result.key, sources=args.sources, flags=tuple(result.flags),
                compiler=result.compiler,
            )
            with self._lock:
                self._programs[result.key] = program
                self._programs.move_to_end(result.key)
                while len(self._programs) > REMEMBERED:
                    self._programs.popitem(last=False)
        return result

    def do_load(self, args: verbs.Load, by: str) -> m.Empty:
        before, gone = len(self.runtime.log()), self._made_by()
        self.runtime.load(args.key)
        self._log_start, self._replaced = before, gone
        self._forget()
        self.claim.owner = ""
        return m.Empty()

    def do_unload(self, args: verbs.Nothing, by: str) -> m.Empty:
        gone = self._made_by()
        self.runtime.unload()
        self._replaced = gone
        self._forget()
        return m.Empty()

    def repeats(self, lane: str) -> Repeats:
        """The prepared answers for one thread of a lane."""
        repeats = Repeats(self.runtime, self.drives, lane)
        self._repeats.append(repeats)
        return repeats

    def _forget(self) -> None:
        for repeats in self._repeats:
            repeats.forget()

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

    # acquisition

    def do_acquire_configure(self, args: verbs.AcquireConfigure, by: str) -> m.AcquireStatus:
        config = AcquireConfig(
            tuple(args.channels), args.decimation, args.seconds, args.trigger, args.continuous
        )
        with self.claim.lock:
            if not args.take:
                self.claim.check_free(by)
            status = self.runtime.acquire_configure(RECORDER, config)
            self.claim.take(by)
            self._recorded, self._replaced = True, None
        return status

    def do_acquire_start(self, args: verbs.AcquireStart, by: str) -> m.AcquireStatus:
        with self.claim.lock:
            self.claim.check_rows(args.begun, self._recorder().begun, by)
            self.claim.check_free(by)
            self.runtime.acquire_start(RECORDER, args.force)
            self.claim.take(by)
            self.runtime.acquire_keep(self._about())
            return self._recorder()

    def _about(self) -> About:
        """The metadata of a recording that begins, kept for the case that this process is killed.
        """
        status, info = self.runtime.status(), self.do_info(verbs.Nothing(), "")
        names = [v.name for v in self.runtime.variables() if v.kind == VariableKind.PARAMETER]
        return About(
            target=info.name,
            machine=info.machine,
            rate_hz=info.rate_hz,
            begun=time.time(),
            since_start=time.monotonic(),
            program=self.do_program(verbs.Nothing(), ""),
            parameters=self.runtime.read(names)[1] if names else {},
            versions={**info.versions, "protocol": str(PROTOCOL)},
            extra={
                "program": status.program, "scheduling": status.scheduling, "clock": status.clock,
            },
        )

    def do_acquire_stop(self, args: verbs.OfRows, by: str) -> m.Empty:
        with self.claim.lock:
            self.claim.check_rows(args.begun, self._recorder().begun, by)
            self.runtime.acquire_stop(RECORDER)
        return m.Empty()

    def do_acquire_status(self, args: verbs.AcquireStatus, by: str) -> m.AcquireStatus:
        status = self._recorder()  # once: what is checked is what is answered
        self.claim.check_rows(args.begun, status.begun, by)
        if args.loaded:
            self.claim.loaded(by)
        return status

    def _recorder(self) -> m.AcquireStatus:
        replaced = self._replaced is not None
        status = self.runtime.acquire_status(RECORDER)
        return msgspec.structs.replace(status, replaced=replaced)

    def do_acquire_program(self, args: verbs.Nothing, by: str) -> m.Replaced:
        if self._replaced is None:
            raise Refused("the program that made the recorder's rows is loaded: ask for it")
        return self._replaced

    def _made_by(self) -> m.Replaced | None:
        """What a reader of the recorder's rows needs to know of their program once it is no longer
        loaded.
        """
        if self._replaced is not None or not self._recorded:
            return self._replaced
        program = self.do_program(verbs.Nothing(), "")
        tick, found = 0, dict[str, Value]()
        with suppress(Refused, RunnerDied):
            infos = self.runtime.variables()
            names = [
                i.name
                for i in infos
                if i.kind == VariableKind.PARAMETER and i.length <= MOST_ELEMENTS
            ]
            tick, found = self.runtime.read(names) if names else (0, {})
        return m.Replaced(
            program=program,
            tick=tick,
            values={name: to_wire(value) for name, value in found.items()},
            log=self.runtime.log(program.log_start),
        )

    def do_acquire_held(self, args: verbs.OfRows, by: str) -> m.Held:
        held = self.runtime.acquire_held(RECORDER)
        self.claim.check_rows(args.begun, self._recorder().begun, by)
        return held

    # live

    def open_live(self, args: verbs.LiveOpen, by: str, user: str) -> m.LiveOpened:
        """Answer ``live_open``; the stream's key contains the name under which the host is known.
        """
        stream = self.live.open(
            args.channels, args.decimation, args.interval, args.window, by, user
        )
        rate = self.runtime.status().rate_hz
        return m.LiveOpened(
            stream=stream.number,
            key=keys.live(self.identity.name, stream.number, user),
            channels=stream.columns,
            units=stream.units,
            sample_time=args.decimation / rate,
        )

    def do_live_close(self, args: verbs.LiveClose, by: str) -> m.Empty:
        self.live.close_stream(args.stream, by)
        return m.Empty()

    def host_gone(self, host: str) -> None:
        """Release what a lost host held. The program goes on, unless that host commanded or moved
        the machine (see ``runs`` and ``drives``).
        """
        self.claim.gone(host)
        self.runs.host_gone(host)
        self.live.forget(host)


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "unknown"


def identity(name: str, machine: str) -> Identity:
    """The identity of a target that starts now."""
    return Identity(keys.check_name(name), machine, time.time())
