"""One load of a program: its runner, its dictionary, its updates. It stays readable after its
runner has died.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from zendsp_protocol.errors import Refused, RunnerDied, VariableError
from zendsp_protocol.states import VariableKind
from zendsp_protocol.values import Value
from zendsp_target.api import Blank
from zendsp_target.bounded import keep
from zendsp_target.runtime import safety
from zendsp_target.runtime.memory.layout import layout
from zendsp_target.runtime.process.runner import RunnerProcess, ffi_address, ffi_pointer
from zendsp_target.runtime.process.settings import Settings
from zendsp_target.runtime.process.supervise import Supervisor
from zendsp_target.runtime.safety import machine_of
from zendsp_target.runtime.variables.banks import Banks
from zendsp_target.runtime.variables.change_log import ChangeLog
from zendsp_target.runtime.variables.dictionary import Dictionary, Place, decode
from zendsp_target.runtime.variables.flights import Flights
from zendsp_target.runtime.variables.own_writes import OwnWrites
from zendsp_target.runtime.variables.plans import ReadPlan
from zendsp_target.runtime.variables.updates import Updates

_LOOK_ROUNDS = 10  # of the supervisor, between looks for what the program itself sets
_ANSWER_S = 5.0  # the paused loop answers within a millisecond; a loaded machine may take longer


class Session:
    """One load.

    Parameters
    ----------
    key : str
        Of the program.
    folder : Path
        In shared memory.
    sequence : int
        The last number of an update of the loads before.

    Raises
    ------
    RunnerDied, Refused
        As `RunnerProcess`.
    """

    def __init__(
        self,
        key: str,
        settings: Settings,
        program: Path,
        folder: Path,
        number: int,
        log: ChangeLog,
        sequence: int = 0,
    ) -> None:
        self.key, self.settings = key, settings
        self.crash = ""
        self.started = False
        self.process = RunnerProcess(settings, program, folder, number)
        self.control = self.process.control
        self._pointer = ffi_pointer(self.control)
        data = self.process.data_file
        memory = np.frombuffer(data.map, dtype=np.uint8)
        start = int(self.control.initial_offset)
        initial = memory[start : start + int(self.control.snapshot_bytes)].copy()
        self.dictionary = Dictionary(self.control, initial)
        self.own_writes = OwnWrites(self.dictionary, initial)
        self._banks = Banks(self.control, data.map)
        self.flights = Flights(
            self.control, data, log, self._banks, self.process.alive, self.process.handle, sequence
        )
        self.updates = Updates(
            self.control, self.dictionary, self.flights, self._banks, self.process.handle
        )
        # kept here, since user code with a wild pointer may overwrite what is shared: nothing there
        # shall steer a copy
        self.machine = machine_of(self.control)
        self._newest = ffi_address(self.control, "newest")
        # every reading asks whether a trip is latched
        load = layout()[1].monitor_load32
        self._tripped = partial(load, ffi_address(self.control.trip, "reason"))
        self._slots_at = int(self.control.snapshot_offset)
        self._slots = data.pointer("unsigned char", self._slots_at)
        self._stride = int(self.control.snapshot_stride)
        self._bytes = int(self.control.snapshot_bytes)
        ffi, _ = layout()
        self._ended = ffi.new("uint32_t *")  # for what was made ready, and is kept by others
        self._read_plans: dict[tuple[str, ...], ReadPlan] = {}
        self._rounds = 0
        self._watched = ffi_address(self.control, "watched")
        self._supervisor = Supervisor(self.process, self._each_round, self._died)

    def _each_round(self) -> None:
        self.flights.harvest()
        self._rounds += 1
        if self._rounds % _LOOK_ROUNDS == 0 and self.alive():
            with contextlib.suppress(RunnerDied, Refused):  # the end is told elsewhere
                self._look()
        layout()[1].monitor_store32(self._watched, self._rounds & 0xFFFFFFFF)

    def _look(self) -> None:
        seen: list[np.ndarray[tuple[int], np.dtype[np.uint8]]] = []
        written = self.flights.take_written(lambda: seen.append(self.snapshot()[1]))
        self.own_writes.look(seen[0], written)

    def _died(self, sentence: str) -> None:
        told = safety.trip_of(self.control, self.machine)
        latched = safety.latched_trip(self.control, self.machine)
        why = "" if latched == told or latched is None else f"; not carried out: {latched.reason}"
        self.crash = sentence + why
        # what was made ready would not say that the values are old
        layout()[1].monitor_store32(self._ended, 1)

    def ended(self) -> str:
        """Why the program no longer runs, in a sentence: it crashed, or a STOP or trip is latched;
        else empty.
        """
        if not self.alive():
            return f"the program crashed: {self.crash or 'the runner ended'}"
        trip = safety.trip_of(self.control, self.machine) if self._tripped() else None
        return "" if trip is None else trip.text

    def alive(self) -> bool:
        """Whether the runner still runs."""
        return not self.crash and self.process.alive()

    def require_alive(self) -> None:
        """Raise RunnerDied, with how it died, when the runner is gone."""
        if not self.alive():
            self._supervisor.join()
            raise RunnerDied(
                f"the runner is gone ({self.crash or 'ended'}): load the program again"
            )

    @property
    def tick(self) -> int:
        """The number of samples done."""
        _, lib = layout()
        return int(lib.monitor_load64(ffi_address(self.control, "tick")))

    @property
    def running(self) -> int:
        """What the loop does now, a constant RUN_…."""
        _, lib = layout()
        return int(lib.monitor_load32(ffi_address(self.control, "running")))

    @property
    def pressed(self) -> bool:
        """Whether the machine's STOP input was active when the loop last read it."""
        _, lib = layout()
        return bool(lib.monitor_load32(ffi_address(self.control, "pressed"))) and self.alive()

    def request_run(self, run: int) -> None:
        """Ask the loop for RUN_PAUSED, RUN_ISR or RUN_HOME, without waiting."""
        _, lib = layout()
        lib.monitor_run(self._pointer, run)

    def until(self, done: Callable[[], bool], what: str, timeout_s: float = _ANSWER_S) -> None:
        """Wait until ``done`` says that the loop has answered.

        Raises
        ------
        RunnerDied
            The runner ended before.
        Refused
            It did not answer in time.
        """
        end = time.monotonic() + timeout_s
        while not done():
            if not self.alive():
                if done():
                    return
                self.require_alive()
            if time.monotonic() > end:
                raise Refused(
                    f"the loop does not answer to {what} within {timeout_s:g} s: see status"
                )
            time.sleep(0.0002)

    def settle(self, what: str) -> None:
        """Wait until the loop has seen everything stored before, and its result can be read.

        Raises
        ------
        RunnerDied, Refused
            As `until`.
        """
        _, lib = layout()
        over, heartbeat = lib.monitor_round(self._pointer), ffi_address(self.control, "heartbeat")
        self.until(lambda: bool(lib.monitor_load64(heartbeat) >= over), what)

    def snapshot(self) -> tuple[int, np.ndarray[tuple[int], np.dtype[np.uint8]]]:
        """The newest sample: its tick, and the values of all variables but tables as bytes."""
        ffi, lib = layout()
        values = np.empty(self._bytes, dtype=np.uint8)
        tick = ffi.new("uint64_t *")
        target = ffi.cast("unsigned char *", ffi.from_buffer(values))
        self.until(
            lambda: bool(
                lib.monitor_snapshot(
                    self._newest, self._slots, self._stride, 0, self._bytes, target, tick
                )
            ),
            "reading",
        )
        return int(tick[0]), values

    def read(self, names: Sequence[str]) -> tuple[int, dict[str, Value]]:
        """Values of one sample; tables as they are now.

        Raises
        ------
        VariableError
            One line for each unknown name.
        """
        key = tuple(names)
        plan = self._read_plans.get(key)
        if (
            plan is not None
            and (read := plan.read(self._newest, self._slots, self._stride)) is not None
        ):
            return read
        places: dict[str, Place] = {}
        problems: list[str] = []
        for name in names:
            try:
                places[name] = self.dictionary.place(name, len(problems))
            except VariableError as error:
                problems.append(str(error))
        if problems:
            raise VariableError("\n".join(problems))
        tick, values = self.snapshot()
        small = {n: p for n, p in places.items() if p.entry.info.kind != VariableKind.TABLE}
        if plan is None and small and len(small) == len(places):
            keep(self._read_plans, key, ReadPlan(places.items()))
        found = decode(small, values)
        for name, place in places.items():
            if name not in small:
                with self.flights.lock:  # nobody fills a bank meanwhile
                    found[name] = self._banks.rows(place)
        return tick, {name: found[name] for name in names}

    def show_trip(self) -> None:
        """Wait until the sample of a latched STOP or trip can be read; return at once where none is
        latched.
        """
        if self._tripped():
            shown, newest = self.control.trip, layout()[1].monitor_load64
            self.until(
                lambda: bool(newest(self._newest) >= shown.shown) or not self.alive(), "reading"
            )

    def repeat_read(self, names: Sequence[str], reply: Blank) -> Callable[[], int] | None:
        """A function that fills a reply with the newest values of the same names; see
        `RuntimeApi.repeat_read`.
        """
        plan = self._read_plans.get(tuple(names))
        if plan is None:
            return None
        ffi, _ = layout()
        control = ffi.from_buffer("control *", self.process.control_file.map)
        data = ffi.from_buffer("unsigned char[]", self.process.data_file.map)
        return plan.again(self._ended, control, data, self._slots_at, self._stride, reply)

    def repeat_write(
        self, names: Sequence[str], author: str, request: Blank, reply: Blank
    ) -> Callable[[bytes], int] | None:
        """A function that writes doubles again; see `RuntimeApi.repeat_write`."""
        return self.updates.repeat(self._ended, names, author, request, reply)

    def set_settings(self, values: Mapping[str, object], author: str) -> int:
        """Write the runtime's own settings as one update."""
        return self.updates.write(values, author, settings=True)

    @property
    def unsafe(self) -> str:
        """Why the machine may still move though the runner has ended; empty where it is safe."""
        return "" if self.alive() else self.process.unsafe

    def close(self) -> str:
        """End the runner and make the machine safe; what was recorded stays readable. Returns why
        the machine is not safe, or an empty string.
        """
        layout()[1].monitor_store32(self._ended, 1)
        self._supervisor.expect_end()
        self.process.quit()
        self._supervisor.join()
        self.process.unlink()
        return self.process.unsafe
