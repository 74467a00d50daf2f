"""Compiles, loads and unloads programs, and keeps what outlives a load."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from zendsp_isr.parts import build_machine, build_runner, is_model
from zendsp_protocol import stop_page
from zendsp_protocol.errors import Refused, RunnerDied
from zendsp_protocol.messages import CompileResult, Trip
from zendsp_protocol.states import Clock, DriveMode, TripReason
from zendsp_target.concealed.load import load_concealed
from zendsp_target.runtime import safety
from zendsp_target.runtime.compile_service import check_memory, compile_program, program_path
from zendsp_target.runtime.memory.layout import layout
from zendsp_target.runtime.memory.shm import SharedFile, SharedFolder
from zendsp_target.runtime.process.places import Place, placed
from zendsp_target.runtime.process.runner import ffi_address, look_at
from zendsp_target.runtime.process.settings import Settings, split_options
from zendsp_target.runtime.session import Session
from zendsp_target.runtime.variables.change_log import ChangeLog


def make_stop_page(folder: Path) -> SharedFile:
    """Make the file through which other programs of this user can stop the loop."""
    ffi, _ = layout()
    file = SharedFile(folder / stop_page.NAME, ffi.sizeof("stop_page"))
    set_up(file)
    return file


def set_up(file: SharedFile) -> None:
    """Write the head of a stop page, which user code may have overwritten. A STOP in it stays."""
    _, lib = layout()
    head = file.pointer("stop_page")
    head.magic, head.version = lib.LAYOUT_MAGIC, lib.STOP_PAGE_VERSION
    if head.stop > 1:  # else it is not touched: a host may ask for STOP at this very moment
        head.stop = 0


class Programs:
    """Compile, load and unload the programs of one machine. `Runtime` describes the parameters.

    Attributes
    ----------
    session : Session or None
        The present load.
    lock : RLock
        Held by whoever loads, starts or pauses; never by STOP.
    folder : SharedFolder
    log : ChangeLog
        Of all loads.
    settings : Settings
        Of the next load.
    unsafe : str
        Why the machine may still move though no program is loaded; empty: it is safe.
    farewell : str
        A clause on the machine, once this is closed; empty where no program was loaded.
    drive_wish : str
        ``"auto"`` (on at start), or what was asked for: ``"off"``, ``"torque"``, ``"velocity"``.
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
        self.options = dict(config)  # for hosts: without what is concealed
        config |= self._concealed.config()
        self.settings = Settings(machine, config, rate_hz, clock, **own)
        layout()
        build_runner()
        build_machine(machine)  # so that an error is reported now, not at the first load
        self.folder = SharedFolder()
        self._page = make_stop_page(self.folder.path)
        self._stop = ffi_address(self._page.pointer("stop_page")[0], "stop")
        self._held: Trip | None = None  # of a loop that is gone, until acknowledged
        try:
            self.title = look_at(self.settings, self.folder.path) if is_model(machine) else ""
        except BaseException:
            self.folder.close()
            raise
        self.lock = threading.RLock()
        self.session: Session | None = None
        self.log = ChangeLog()
        self._place: Place | None = None  # once a loop keeps time
        self._loads = 0
        self._sequence = 0  # of the last update of all loads
        self.drive_wish = DriveMode.AUTO
        self.unsafe = ""
        self.farewell = ""
        self._closed = False

    def compile(self, sources: Mapping[str, str], flags: Sequence[str] = ()) -> CompileResult:
        """Compile a program; errors in the code are part of the result. See `compile_program`."""
        return compile_program(sources, flags)

    def load(self, key: str) -> None:
        """Start a new runner with a compiled program and run its UserInit; the runner before it is
        ended first.

        Raises
        ------
        Refused
            No such program, or it cannot run; or a STOP or trip that is not acknowledged.
        RunnerDied
            Its UserInit crashed or did not return.
        """
        path = program_path(key)
        check_memory(path, self.settings.memory_mb)
        with self.lock:
            self._require_open()
            self.require_no_trip()
            ended = "" if self.session is None else "; what was loaded before was ended"
            self.unload()
            self.require_no_trip()  # what tripped at its very end
            if self.drive_wish != DriveMode.AUTO:
                # a fresh runner begins with its drives off, and is switched on deliberately
                self.drive_wish = DriveMode.OFF
            self._loads += 1
            set_up(self._page)
            try:
                self.session = Session(
                    key, self._here(), path, self.folder.path, self._loads, self.log,
                    self._sequence,
                )
            except (Refused, RunnerDied) as error:
                raise type(error)(f"{error}{ended}") from None
            self.unsafe = ""

    def _here(self) -> Settings:
        """The settings, with CPU and time awake filled in for this computer."""
        if self.settings.clock != Clock.REAL or not self.settings.realtime:
            return self.settings
        self._place = self._place or Place()
        return placed(self.settings, self._place)

    def unload(self) -> None:
        """End the runner; acquired data, the log, and a STOP or trip stay."""
        with self.lock:
            if self.session is not None:
                self.unsafe = self.session.close()
                self._held = safety.latched_trip(self.session.control, self.session.machine)
                self._sequence = self.session.flights.sequence
                self.session = None

    def ask_stop(self, author: str = "") -> None:
        """STOP: the loop obeys at its next sample. Without a loop the STOP stays until it is
        acknowledged. Never waits.
        """
        head = self._page.pointer("stop_page")
        layout()[0].memmove(head.by, stop_page.signed(author), stop_page.REASON - stop_page.BY)
        layout()[1].monitor_store32(self._stop, 1)

    def latched(self) -> Trip | None:
        """The STOP or trip that nobody has acknowledged, whether or not the loop has carried it
        out. It belongs to the target and outlives the loop that latched it.
        """
        session = self.session
        # before the trip, which the loop latches before it clears this
        asked = layout()[1].monitor_load32(self._stop)
        trip = (
            self._held
            if session is None
            else safety.latched_trip(session.control, session.machine)
        )
        if trip is None and asked:
            by = bytes(layout()[0].buffer(self._page.pointer("stop_page").by))
            trip = safety.asked_trip(TripReason.STOP, 0 if session is None else session.tick, by)
        return trip

    def trips(self) -> int:
        """How many trips and STOPs there were. Read it before the trip itself: the number is then
        never that of a trip that came later.
        """
        head = self._page.pointer("stop_page")
        # in this order: the loop may take one meanwhile
        return int(head.trips) + int(head.stop) & 0xFFFFFFFF

    def require_no_trip(self) -> None:
        """Refuse while a STOP or trip is not acknowledged."""
        trip = self.latched()
        if trip is not None:
            raise Refused(f"{trip.text}: acknowledge it first")

    def forget_trip(self, trip: int | None) -> None:
        """Acknowledge the trip of that number, or whichever is latched, where no loop runs. A STOP
        that comes meanwhile stays.
        """
        _, lib = layout()
        head = self._page.pointer("stop_page")
        asked = int(lib.monitor_load32(self._stop))
        number = int(head.trips) + asked & 0xFFFFFFFF  # whatever user code wrote there
        if trip not in (None, number):
            return
        head.trips = number
        if asked:
            lib.monitor_store32(self._stop, 0)
        self._held = None
        if self.session is not None:
            control = self.session.control
            lib.monitor_store32(ffi_address(control, "stop"), 0)
            lib.monitor_store32(ffi_address(control.trip, "reason"), 0)

    def stop_page(self) -> str:
        """Path of the file through which programs of this user stop the loop without this process;
        see `zendsp_protocol.stop_page`.
        """
        return str(self._page.path)

    def runner_pid(self) -> int:
        """Process id of the native runner, 0 where none runs."""
        session = self.session
        return session.process.pid if session is not None and session.alive() else 0

    def configure(self, **changes: Any) -> None:
        """Change fields of `Settings` (rate_hz, clock, machine, …) for the next load.

        Raises
        ------
        Refused
            A value out of range.
        """
        with self.lock:
            self.settings = Settings(**{**self.settings.__dict__, **changes})

    def _require_open(self) -> None:
        if self._closed:
            raise Refused("this runtime was closed")

    def loaded(self) -> Session:
        """The session of the loaded program, whether it runs or not.

        Raises
        ------
        Refused
            No program is loaded.
        """
        session = self.session
        if session is None:
            raise Refused("no program is loaded: compile and load one first")
        return session

    def living(self) -> Session:
        """The session of the loaded program, whose runner must be alive.

        Raises
        ------
        Refused
            No program is loaded.
        RunnerDied
            Its runner ended.
        """
        session = self.loaded()
        session.require_alive()
        return session

    def seal(self) -> str:
        """SHA-256 of what the machine conceals. It tells nothing of the effects, and proves
        afterwards that they were not changed.
        """
        return self._concealed.seal()

    def reveal(self) -> str:
        """The sealed record as JSON text: the truth, to be asked for once the diagnosis is made."""
        return self._concealed.record_text()

    def close(self) -> None:
        """End everything and remove the shared memory."""
        with self.lock:
            if not self._closed:
                ran = self.session is not None
                self.unload()
                if self.unsafe:
                    self.farewell = f": {self.unsafe}"
                elif ran:
                    self.farewell = "; its machine is in its safe state"
                self._closed = True
                self.folder.close()
                if self._place is not None:
                    self._place.close()
