"""The real-time side as the server sees it: `zendsp_target.api.RuntimeApi` on shared memory and a native runner.

>>> from zendsp_target.runtime import Runtime
>>> with Runtime("imi_planar", clock="fast") as runtime:
...     result = runtime.compile({"pd.c": program_text("pd")})
...     runtime.load(result.key)
...     runtime.start(ticks=1000)
...     runtime.wait_paused()
...     runtime.status().tick
1000
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp_isr.build import build_machine, build_runner, source_root
from zendsp_protocol.errors import AcquisitionError, Refused, RunnerDied
from zendsp_target import acquisition, safety
from zendsp_target.api import (
    AcquireConfig,
    AcquireStatus,
    Change,
    CompileResult,
    Limits,
    MachineInfo,
    Status,
    Value,
    VariableInfo,
)
from zendsp_target.compile_service import compile_program, program_path
from zendsp_target.concealed import load_concealed
from zendsp_target.layout import layout, text_of
from zendsp_target.runner import Settings, ffi_address, split_options
from zendsp_target.session import Session
from zendsp_target.shm import SharedFolder
from zendsp_target.updates import ChangeLog

_IO = ("enc", "aout", "adc", "din", "dout")


def program_text(name: str) -> str:
    """Source of an example program.

    Parameters
    ----------
    name : str
        ``"template"``, ``"pd"``, …

    Returns
    -------
    str

    Examples
    --------
    >>> "UserISR_INT2" in program_text("template")
    True
    """
    return (source_root() / "programs" / f"{name}.c").read_text()


class Runtime:
    """A machine, and what runs on it.

    Parameters
    ----------
    machine : str
        Name of a shipped machine, or path of a ``.c`` file of your own.
    rate_hz : float
        Samples a second, 1 … 100 000.
    clock : str
        ``"real"``, or ``"fast"``: a simulated machine as fast as the CPU allows, with identical results.
    machine_config : mapping, optional
        Settings of the machine (start position …).
    concealed : str, optional
        Handed to the machine and to nobody else before `reveal`: ``"seed:17"`` or a file, see `zendsp_target.concealed`.
    **options
        Further fields of `zendsp_target.runner.Settings` (realtime, priority, cpu, spin_us, speed, hang_s, load_s), also as
        text; and ``machine.KEY`` for settings of the machine.

    Raises
    ------
    CompileFailed
        No compiler, no such machine, or it does not compile.
    Refused
        A setting out of range.
    """

    def __init__(
        self,
        machine: str,
        rate_hz: float = 1000.0,
        clock: str = "real",
        machine_config: Mapping[str, str | float] | None = None,
        concealed: str | None = None,
        **options: Any,
    ) -> None:
        config = dict(machine_config or {})
        own, for_machine = split_options(options)
        config |= for_machine
        self._concealed = load_concealed(concealed, machine, config)
        config |= self._concealed.config()
        self._settings = Settings(machine, config, rate_hz, clock, **own)
        layout()
        build_runner()
        build_machine(machine)  # what does not compile shall say so now, not at the first load
        self._folder = SharedFolder()
        self._lock = threading.RLock()
        self._session: Session | None = None
        self._log = ChangeLog()
        self._streams: dict[int, tuple[acquisition.Stream, Session]] = {}
        self._loads = 0
        self._files = 0
        self._drive_wish = "auto"
        self._closed = False

    # ---- program ----------------------------------------------------------------------------------------------------------

    def compile(self, sources: Mapping[str, str], flags: Sequence[str] = ()) -> CompileResult:
        """Compile a program; errors in the code are part of the result. See `compile_program`."""
        return compile_program(sources, flags)

    def load(self, key: str) -> None:
        """Start a fresh runner with a compiled program and run its UserInit. An earlier one is ended first.

        Raises
        ------
        Refused
            No such program, or it cannot run.
        RunnerDied
            Its UserInit crashed or did not return.
        """
        path = program_path(key)
        with self._lock:
            self._require_open()
            self.unload()
            if self._drive_wish != "auto":
                self._drive_wish = "off"  # a fresh runner begins with its drives off, and is switched on deliberately
            self._loads += 1
            self._session = Session(key, self._settings, path, self._folder.path, self._loads, self._log)

    def unload(self) -> None:
        """End the runner; acquired data and the log stay."""
        with self._lock:
            if self._session is not None:
                self._session.close()
                self._session = None

    def configure(self, **changes: Any) -> None:
        """Change fields of `Settings` (rate_hz, clock, machine, …) for the next load.

        Raises
        ------
        Refused
            A value out of range.
        """
        with self._lock:
            self._settings = Settings(**{**self._settings.__dict__, **changes})

    def _require_open(self) -> None:
        if self._closed:
            raise Refused("this runtime was closed")

    def _loaded(self) -> Session:
        session = self._session
        if session is None:
            raise Refused("no program is loaded: compile and load one first")
        return session

    def _living(self) -> Session:
        session = self._loaded()
        session.require_alive()
        return session

    # ---- run --------------------------------------------------------------------------------------------------------------

    def start(self, ticks: int | None = None) -> None:
        """Let the samples run.

        Parameters
        ----------
        ticks : int, optional
            Pause after exactly so many.

        Raises
        ------
        Refused
            No program, a STOP or trip that is not acknowledged, or running already.
        """
        _, lib = layout()
        with self._lock:
            session = self._living()
            trip = safety.trip_of(session.control)
            if trip is not None:
                raise Refused(f"{trip.text}: acknowledge it first")
            if session.running != lib.RUN_PAUSED:
                raise Refused("the program runs already: pause it first")
            if ticks is not None and ticks < 1:
                raise Refused(f"ticks = {ticks}: give 1 or more")
            if self._drive_wish == "auto":
                session.control.drive = lib.MACHINE_TORQUE
            before = session.tick
            lib.monitor_store64(ffi_address(session.control, "run_until"), before + ticks if ticks is not None else 0)
            session.started = True
            session.request_run(lib.RUN_ISR)
            requested = ffi_address(session.control, "run")
            session.until(
                lambda: session.running == lib.RUN_ISR or session.tick > before or lib.monitor_load32(requested) == lib.RUN_PAUSED,
                "start",
            )

    def pause(self) -> None:
        """Stop sampling after the present sample: a simulated machine stands still in time, hardware is made safe."""
        _, lib = layout()
        with self._lock:
            session = self._living()
            session.request_run(lib.RUN_PAUSED)
            session.until(lambda: session.running == lib.RUN_PAUSED, "pause")

    def wait_paused(self, timeout: float = 60.0) -> None:
        """Sleep until the loop pauses (the end of ``start(ticks=n)``).

        Raises
        ------
        Refused
            It still runs after `timeout` s.
        RunnerDied
            The runner ended before.
        """
        _, lib = layout()
        session = self._living()
        requested = ffi_address(session.control, "run")
        session.until(
            lambda: lib.monitor_load32(requested) == lib.RUN_PAUSED and session.running == lib.RUN_PAUSED,
            "the end of the run", timeout,
        )  # fmt: skip

    def stop(self) -> None:
        """STOP: from the next sample on the drives stand still in velocity mode; latched until acknowledged. Never waits."""
        self.trip("stop")

    def trip(self, reason: str) -> None:
        """As `stop`, with another reason.

        Parameters
        ----------
        reason : str
            ``"stop"`` or ``"host lost"``.
        """
        _, lib = layout()
        if reason not in safety.REQUESTS:
            raise Refused(f"trip reason {reason!r}: give one of {', '.join(safety.REQUESTS)}")
        session = self._session  # no lock: STOP never waits behind a load
        if session is not None:
            lib.monitor_store32(ffi_address(session.control, "stop"), safety.REQUESTS[reason])

    def acknowledge(self) -> None:
        """End a STOP or a trip. The program is paused; nothing moves before the next start.

        Raises
        ------
        Refused
            The STOP input of the machine is still active.
        """
        _, lib = layout()
        with self._lock:
            session = self._living()
            session.request_run(lib.RUN_PAUSED)
            session.until(lambda: session.running == lib.RUN_PAUSED, "acknowledge")
            control = session.control
            wanted = (int(control.acknowledge) + 1) & 0xFFFFFFFF
            lib.monitor_store32(ffi_address(control, "acknowledge"), wanted)
            answered = ffi_address(control, "acknowledged")
            session.until(lambda: lib.monitor_load32(answered) == wanted, "acknowledge")

    # ---- drives and limits --------------------------------------------------------------------------------------------------

    def set_drive(self, mode: str) -> None:
        """What the drives shall do: ``"off"``, ``"torque"``, ``"velocity"``, or ``"auto"`` (torque at each start, the default)."""
        if mode != "auto" and mode not in safety.DRIVE_MODES:
            raise Refused(f"drive mode {mode!r}: give off, torque, velocity or auto")
        with self._lock:
            if mode in ("torque", "velocity"):
                self._living()  # switching on needs somebody who obeys
            self._drive_wish = mode
            if self._session is not None:
                self._session.control.drive = safety.DRIVE_MODES.get(mode, int(self._session.control.drive))

    def home(self) -> None:
        """Start the machine's homing; ``status().homed`` tells when it is done, a trip when it fails.

        Raises
        ------
        Refused
            A trip stands, the program runs, or the machine needs no homing.
        """
        _, lib = layout()
        with self._lock:
            session = self._living()
            trip = safety.trip_of(session.control)
            if trip is not None:
                raise Refused(f"{trip.text}: acknowledge it first")
            if session.running != lib.RUN_PAUSED:
                raise Refused("the program runs: pause it before homing")
            lib.monitor_store64(ffi_address(session.control, "run_until"), 0)
            session.request_run(lib.RUN_HOME)

    def machine(self) -> MachineInfo:
        """What the loaded machine says of itself."""
        return safety.machine_of(self._loaded().control)

    def limits(self) -> Limits:
        """Limits in force."""
        _, values = self._loaded().read(safety.limit_names())
        return safety.limits_of(values)

    def set_limits(self, author: str, **changes: Any) -> int:
        """Tighten or restore limits, as one synchronous update.

        Parameters
        ----------
        author : str
        **changes
            Fields of Limits; one number per joint, or one for all.

        Returns
        -------
        int
            Sequence number for `wait_applied`.

        Raises
        ------
        Refused
            Beyond what the machine bears, or not a limit.
        """
        session = self._living()
        return session.set_settings(safety.check_limits(safety.machine_of(session.control), changes), author)

    def set_ramp(self, seconds: float) -> None:
        """Duration of soft start and soft stop, s; 0: at once."""
        if not 0.0 <= seconds <= 60.0:
            raise Refused(f"ramp of {seconds!r} s: give 0 … 60 s")
        self._apply({"drive.ramp": seconds})

    def set_overrun(self, policy: str, limit: int = 10) -> None:
        """What happens when samples take longer than the period: ``"count"``, ``"skip"``, or ``"trip"`` after `limit` in a row."""
        if policy not in safety.OVERRUN_POLICIES or limit < 1:
            raise Refused(f"overrun policy {policy!r}, limit {limit}: give count, skip or trip, and a limit of 1 or more")
        self._apply({"overrun.policy": safety.OVERRUN_POLICIES[policy], "overrun.limit": limit})

    def _apply(self, values: Mapping[str, object]) -> None:
        session = self._living()
        session.updates.wait_applied(session.set_settings(values, "runtime"), 5.0)

    def set_inputs(self, bits: int) -> None:
        """Digital inputs of a simulated machine, one bit each: what a person at its panel would press."""
        session = self._living()
        if not session.control.info.simulated:
            raise Refused("digital inputs of real hardware cannot be set")
        session.control.simulated_din = bits & 0xFFFFFFFF

    # ---- variables ----------------------------------------------------------------------------------------------------------

    def variables(self) -> tuple[VariableInfo, ...]:
        """Variables that the loaded program declares."""
        return self._loaded().dictionary.infos("parameter", "signal", "table")

    def builtins(self) -> tuple[VariableInfo, ...]:
        """Signals that exist without being declared."""
        return self._loaded().dictionary.infos("builtin")

    def read(self, names: Sequence[str]) -> tuple[int, dict[str, Value]]:
        """Values of variables, elements and built-ins, all from one sample, and its tick.

        Raises
        ------
        VariableError
            One line for each unknown name.
        """
        return self._loaded().read(names)

    def write(self, values: Mapping[str, Value], author: str, at_tick: int | None = None) -> int:
        """Commit a synchronous update: all values at the start of one sample, or none.

        Parameters
        ----------
        values : mapping
            A table takes an array of shape (rows, columns).
        author : str
        at_tick : int, optional
            Not before this sample.

        Returns
        -------
        int
            Sequence number for `wait_applied`.

        Raises
        ------
        VariableError
            One line for each variable that is wrong; nothing was applied.
        """
        return self._living().updates.write(values, author, at_tick)

    def wait_applied(self, sequence: int, timeout: float) -> int:
        """Sleep until an update has taken effect; returns its sample. See `Updates.wait_applied`."""
        return self._loaded().updates.wait_applied(sequence, timeout)

    def log(self, since: int = 0) -> tuple[Change, ...]:
        """Changes from line number `since` on."""
        session = self._session
        if session is not None:
            session.updates.harvest()
        return self._log.since(since)

    # ---- acquisition --------------------------------------------------------------------------------------------------------

    def acquire_configure(self, stream: int, config: AcquireConfig) -> AcquireStatus:
        """Set up a stream (0: recorder; 1 … 7: live); what it held before is dropped.

        Raises
        ------
        AcquisitionError
            No program, an unknown channel, or more than fits into memory.
        """
        _, lib = layout()
        if not 0 <= stream < lib.LAYOUT_STREAMS:
            raise AcquisitionError(f"stream {stream}: there are 0 … {lib.LAYOUT_STREAMS - 1}")
        with self._lock:
            session = self._session
            if session is None or not session.alive():
                raise AcquisitionError("no program is loaded: load one before configuring an acquisition")
            self._files += 1
            path = self._folder.path / f"stream-{stream}-{self._files}"
            fresh = acquisition.create(path, session.dictionary, config, session.settings.rate_hz, self._folder.free_bytes())
            try:
                acquisition.attach(fresh, session.control, stream, session.alive)
            finally:
                fresh.file.unlink()  # both sides have it mapped; nobody needs its name any more
            self._streams[stream] = (fresh, session)
            return acquisition.status(fresh, True)

    def _stream(self, number: int) -> tuple[acquisition.Stream, Session]:
        found = self._streams.get(number)
        if found is None:
            raise AcquisitionError(f"stream {number} is not configured: configure it first")
        return found

    def _fed(self, session: Session) -> bool:
        return session is self._session and session.alive()

    def acquire_start(self, stream: int, force: bool = False) -> None:
        """Begin to acquire, or wait for the trigger; `force` fires the trigger of a stream that is armed already.

        Raises
        ------
        AcquisitionError
            Not configured, or its program is no longer loaded.
        """
        found, session = self._stream(stream)
        if not self._fed(session):
            raise AcquisitionError(f"stream {stream} belongs to a program that is no longer loaded: configure it again")
        if force and acquisition.status(found, True).state == "armed":
            acquisition.request(found, "force", session.alive)
            return
        acquisition.request(found, "arm", session.alive)
        if force:
            acquisition.request(found, "force", session.alive)

    def acquire_stop(self, stream: int) -> None:
        """End an acquisition at the next sample; its rows stay."""
        found, session = self._stream(stream)
        if self._fed(session):
            acquisition.request(found, "disarm", session.alive)

    def acquire_status(self, stream: int) -> AcquireStatus:
        """Where a stream stands."""
        if stream not in self._streams:
            return AcquireStatus("idle", (), (), 1, 0, 0, 0, 0, 0, -1)
        found, session = self._streams[stream]
        return acquisition.status(found, self._fed(session))

    def acquire_read(self, stream: int, first: int, count: int) -> npt.NDArray[np.float64]:
        """Rows of a stream, shape (rows, channels). See `acquisition.read`."""
        return acquisition.read(self._stream(stream)[0], first, count)

    # ---- status -------------------------------------------------------------------------------------------------------------

    def status(self) -> Status:
        """Everything that a person wants to see at a glance."""
        session = self._session
        if session is None:
            return self._empty_status()
        control = session.control
        trip = safety.trip_of(control)
        state = self._state(session, trip is not None)
        tick = session.tick
        mode = {number: name for name, number in safety.DRIVE_MODES.items()}[int(control.drive_mode)]
        return Status(
            state=state, tick=tick, t=tick / session.settings.rate_hz, rate_hz=session.settings.rate_hz,
            clock=session.settings.clock, scheduling=text_of(control.scheduling), machine=text_of(control.info.name),
            joints=int(control.info.joints), program=session.key, timing=safety.timing_of(control),
            drive=self._drive(state, trip.reason if trip else "", mode, bool(control.homed)), trip=trip, crash=session.crash,
            io=self._io(session), homed=bool(control.homed), drive_mode=mode,
        )  # fmt: skip

    def _empty_status(self) -> Status:
        settings = self._settings
        return Status(
            state="empty", tick=0, t=0.0, rate_hz=settings.rate_hz, clock=settings.clock, scheduling="", machine=settings.machine,
            joints=0, program="", timing=safety.no_timing(), drive="off", trip=None, crash="",
        )  # fmt: skip

    @staticmethod
    def _state(session: Session, tripped: bool) -> str:
        _, lib = layout()
        if not session.alive():
            return "crashed"
        if tripped:
            return "stopped"
        if session.running != lib.RUN_PAUSED:
            return "running"
        return "paused" if session.started else "loaded"

    @staticmethod
    def _drive(state: str, reason: str, mode: str, homed: bool) -> str:
        if state == "crashed":
            return "off"
        if reason:
            return "stopped" if reason in safety.STOPS else "tripped"
        if mode == "off":
            return "homed" if homed else "ready"
        return "running" if state == "running" else "enabled"

    @staticmethod
    def _io(session: Session) -> dict[str, npt.NDArray[np.float64]]:
        names = [name for name in _IO if name in session.dictionary.entries]
        try:
            _, values = session.read(names)
        except (RunnerDied, Refused):
            return {}
        return {name: np.atleast_1d(np.asarray(value, dtype=np.float64)) for name, value in values.items()}

    # ---- what the machine conceals -----------------------------------------------------------------------------------------

    def seal(self) -> str:
        """SHA-256 of what the machine conceals: tells nothing, and proves afterwards that nothing was changed."""
        return self._concealed.seal()

    def reveal(self) -> str:
        """The sealed record itself, as JSON text: the truth, to be asked for when the diagnosis is made."""
        return self._concealed.record_text()

    # ---- end ----------------------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """End everything and remove the shared memory."""
        with self._lock:
            if not self._closed:
                self.unload()
                self._closed = True
                self._folder.close()

    def __enter__(self) -> Runtime:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()
