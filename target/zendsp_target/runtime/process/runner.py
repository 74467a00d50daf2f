"""The native runner as a process: start it, wait until it is ready, end it, and say how it died."""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import signal
import subprocess
import threading
import time
import uuid
import weakref
from pathlib import Path
from typing import Any

from zendsp_isr.parts import build_machine, build_runner, is_model, stated_speeds, with_remedy
from zendsp_protocol import stop_page
from zendsp_protocol.errors import Refused, RunnerDied, ZendspError
from zendsp_protocol.states import Clock
from zendsp_target.runtime.memory.layout import layout, set_text, text_of
from zendsp_target.runtime.memory.shm import SharedFile
from zendsp_target.runtime.process.places import make_urgent
from zendsp_target.runtime.process.rescue import Rescue
from zendsp_target.runtime.process.said import open_said
from zendsp_target.runtime.process.settings import Settings
from zendsp_target.runtime.process.strays import MARK, Strays

_WITHIN = {
    1: "while the program was being loaded", 2: "in UserInit", 3: "in UserISR_INT2",
    4: "in UserBackground", 5: "in the machine",
}
PLACE_S = 0.2  # for a loop that hangs to note where, and end; it takes milliseconds
QUIT_S = 2.0  # for the loop to make its machine safe and end
_MEANT = {
    "SIGFPE": " (an integer division by zero, or a floating-point trap that the code has enabled)",
    "SIGABRT": " (abort(), a failed assertion, or a thread that ends itself)",
    "SIGILL": " (a division by zero, or other code that C leaves undefined)",
}
STACK_USED_UP = (
    " (the stack is used up: a function that calls itself without end, or a local array that is too"
    " large; make it static)"
)
KILLED_S = 2.0  # for the system to end it: a call of a driver may hold that up for good
BEING_MADE_SAFE = "the machine is being made safe"


def _fill(control: Any, settings: Settings, program: Path, data: Path, number: int = 1) -> None:
    ffi, lib = layout()
    control.magic = lib.LAYOUT_MAGIC
    control.version = lib.LAYOUT_VERSION
    control.bytes = ffi.sizeof("control")
    control.rate_hz = settings.rate_hz
    control.period_ns = round(1e9 / settings.rate_hz)
    control.clock = lib.CLOCK_REAL if settings.clock == Clock.REAL else lib.CLOCK_FAST
    control.realtime = settings.realtime
    control.priority = settings.priority
    control.monitor = os.getpid()
    control.spin_us, control.speed = max(settings.spin_us, 0.0), settings.speed
    control.hang_s = settings.hang_s
    control.memory = round(settings.memory_mb * 1e6)
    # which load of the session this is: noise continues instead of beginning again
    given = dict(settings.machine_config) | {"load": str(number)}
    if is_model(settings.machine):
        given |= {"model": os.path.abspath(settings.machine), "clock": settings.clock}
        given |= {"speeds": speeds} if (speeds := stated_speeds(settings.machine)) else {}
    config = "".join(f"{key} = {value}\n" for key, value in given.items())
    for name, text in (
        ("data_path", str(data)),
        ("stop_path", str(data.with_name(stop_page.NAME))),
        ("program_path", str(program)),
        ("machine_path", str(build_machine(settings.machine))),
        ("machine_config", config),
    ):
        try:
            set_text(getattr(control, name), text)
        except ValueError as error:
            raise Refused(f"{name.replace('_', ' ')}: {error}") from None


def _control_file(
    path: Path, settings: Settings, program: Path, data: Path, number: int = 1
) -> SharedFile:
    """A control file, filled in."""
    ffi, _ = layout()
    file = SharedFile(path, ffi.sizeof("control"))
    try:
        _fill(file.pointer("control")[0], settings, program, data, number)
    except BaseException:
        file.unlink()
        raise
    return file


def look_at(settings: Settings, folder: Path) -> str:
    """Open and close a machine in a process of its own, so that an error is reported before a
    program is loaded.

    Parameters
    ----------
    folder : Path
        In shared memory.

    Returns
    -------
    str
        What the machine says of itself, one sentence.

    Raises
    ------
    Refused
        It does not open.
    """
    path = folder / "control-look"
    file = _control_file(path, settings, Path("/dev/null"), path)
    control: Any = file.pointer("control")[0]
    try:
        command = [str(build_runner()), "--look", str(file.path)]
        status = subprocess.run(command, timeout=settings.load_s, check=False).returncode
        if status != 0:
            said = text_of(control.error)
            if said and is_model(settings.machine):
                said = with_remedy(said, settings.machine)
            raise Refused(
                said or f"the machine {settings.machine} ended the runner with status {status}"
            )
        return text_of(control.info.text)
    except subprocess.TimeoutExpired:
        raise Refused(
            f"the machine {settings.machine} did not open within {settings.load_s:g} s"
            + (
                ", as it does for each program: its meshes are too large for this computer, or"
                " others keep it busy. Stop these, or give a model with smaller meshes or none"
                if is_model(settings.machine)
                else ""
            )
        ) from None
    finally:
        file.unlink()


class RunnerProcess:
    """One runner with its control and data files. When the constructor returns, the runner is ready
    and UserInit is done.

    Parameters
    ----------
    program : Path
        Shared object of the user's program.
    folder : Path
        In shared memory.
    number : int
        Tells the files of one load from those of the next.

    Raises
    ------
    RunnerDied
        User code crashed or did not return while it was loaded.
    Refused
        The runner declined: another ABI, a wrong declaration, a machine that does not open.
    """

    def __init__(self, settings: Settings, program: Path, folder: Path, number: int) -> None:
        _, lib = layout()
        self._ended = lib.monitor_ended
        self.settings = settings
        path, data_path = folder / f"control-{number}", folder / f"data-{number}"
        self.control_file = _control_file(path, settings, program, data_path, number)
        self.control: Any = self.control_file.pointer("control")[0]
        self._program = program
        self._contained = False  # not known yet
        # not known yet: a crash while loading makes even a simulated machine safe, which does no
        # harm
        self.simulated = False
        self.unsafe = BEING_MADE_SAFE  # once it has ended: why the machine may still move
        self._making_safe = threading.Lock()
        try:
            own = path.with_name(f"{path.name}-safe")
            self._rescue = Rescue(_control_file(own, settings, program, data_path, number))
        except BaseException:
            self.control_file.unlink()
            raise
        try:
            mark, said = uuid.uuid4().hex, open_said()
            try:
                self._process = subprocess.Popen(
                    [str(build_runner()), str(self.control_file.path)],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=said,
                    start_new_session=True,
                    cwd="/",
                    env={**os.environ, MARK: mark},
                )
            finally:
                os.close(said)
        except BaseException:
            self._rescue.dismiss()
            self.control_file.unlink()
            raise
        self._rescue.guard(self.pid)
        self._strays = Strays(self.pid, mark)
        self.handle = os.pidfd_open(self.pid) if hasattr(os, "pidfd_open") else -1
        if self.handle >= 0:
            # not while anybody may still use it: the number of a closed file is used again
            weakref.finalize(self, os.close, self.handle)
        try:
            self._wait_ready()
            self.data_file = SharedFile(data_path)
            # kept here: a wild pointer may change it
            self._contained = bool(self.control.contained)
            self.look()
            self.simulated = bool(self.control.info.simulated)
        except BaseException as error:
            self.kill()
            unsafe = self.make_safe()
            self._rescue.dismiss()
            data_path.unlink(missing_ok=True)
            self.control_file.unlink()
            if unsafe and isinstance(error, ZendspError):
                raise type(error)(f"{error}; {unsafe}") from error
            raise

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def _wait_ready(self) -> None:
        _, lib = layout()
        deadline = time.monotonic() + self.settings.load_s
        phase = ffi_address(self.control, "phase")
        while lib.monitor_load32(phase) not in (lib.PHASE_READY, lib.PHASE_FAILED):
            if self._process.poll() is not None:
                break
            if lib.monitor_load32(phase) == lib.PHASE_LOADED and not self.control.scheduled:
                self.control.scheduled = 1 + make_urgent(self.pid, self.settings)
            if time.monotonic() > deadline:
                where = _WITHIN.get(int(self.control.within), "while it was being loaded")
                self.kill()
                raise RunnerDied(
                    f"the program did not return within {self.settings.load_s:g} s {where}; it was"
                    " ended"
                )
            time.sleep(0.0005)
        if lib.monitor_load32(phase) == lib.PHASE_READY:
            return
        self._process.wait(5)
        if lib.monitor_load32(phase) == lib.PHASE_FAILED:
            raise Refused(f"the program cannot run: {text_of(self.control.error)}")
        raise RunnerDied(self.death())

    def alive(self) -> bool:
        """Whether the process still runs."""
        if self.handle < 0:
            return self._process.poll() is None
        return not self._ended(self.handle)

    def wait_death(self, timeout_s: float) -> bool:
        """Wait until the process ends.

        Returns
        -------
        bool
            True when it has ended.
        """
        if self.handle < 0:
            try:
                self._process.wait(timeout_s)
            except subprocess.TimeoutExpired:
                return False
            return True
        poll = select.poll()
        poll.register(self.handle, select.POLLIN)
        ended = bool(poll.poll(timeout_s * 1000.0))
        return ended and self._process.poll() is not None

    def death(self, hung: bool = False) -> str:
        """A sentence on how the runner ended: what, where, and the last sample.

        Parameters
        ----------
        hung : bool
            The watchdog ended it.
        """
        code = None if hung else self._status()
        tick = int(self.control.tick)
        crashed = int(self.control.crash_signal)
        within = int(self.control.crash_within) if crashed else int(self.control.within)
        where = _WITHIN.get(within, "in the runtime") + self._line()
        last = f"last sample {tick - 1}" if tick > 0 else "before the first sample"
        if hung and self._stands_still():
            return (
                "the runner was stopped from outside (SIGSTOP, a debugger, a frozen container) for"
                f" {self.settings.hang_s:g} s: ended by the watchdog; {last}"
            )
        if (
            hung and within not in _WITHIN
        ):  # in nobody's code: it waited for its next sample and was not woken
            return (
                f"the loop got no CPU for {self.settings.hang_s:g} s (another real-time program on"
                f" the same CPU?): ended by the watchdog; {last}"
            )
        if hung:
            return (
                f"no return within {self.settings.hang_s:g} s {where}: ended by the watchdog;"
                f" {last}"
            )
        if code is not None and code < 0:
            name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
            meant = STACK_USED_UP if self.control.crash_stack else _MEANT.get(name, "")
            return f"{name} {where}{meant}; {last}"
        return f"the process ended with status {code} {where} (user code called exit?); {last}"

    def ask_where(self) -> None:
        """Have a loop that hangs in the ISR note its place as it would at a crash, and end."""
        _, lib = layout()
        if int(self.control.within) == lib.WITHIN_ISR and not self._stands_still():
            with contextlib.suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGABRT)
            self.wait_death(PLACE_S)

    def _stands_still(self) -> bool:
        """Whether the system has stopped the process (SIGSTOP)."""
        try:
            stat = Path(f"/proc/{self.pid}/stat").read_text(encoding="utf-8", errors="replace")
        except OSError:
            return False
        return stat.rpartition(")")[2].split()[0] in ("T", "t")

    def _status(self) -> int | None:
        """Exit status of a process that has ended. `poll` cannot be used alone: it answers None
        while another thread is asking.
        """
        try:
            return self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            return None

    def _line(self) -> str:
        """The place of a crash within the program, as " at pd.c:42"; "" where it is not known."""
        address = int(self.control.crash_address)
        tool = shutil.which("addr2line")
        if not address or tool is None:
            return ""
        command = [tool, "-e", str(self._program), hex(address)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=5.0, check=False)
        except (OSError, subprocess.TimeoutExpired):
            return ""
        place = os.path.basename(done.stdout.split("(")[0].strip())
        return f" at {place}" if place and "?" not in place else ""

    def quit(self) -> None:
        """Ask the runner to make the machine safe and end. It is killed if it does not answer in
        time.
        """
        _, lib = layout()
        if self.alive():
            lib.monitor_run(ffi_pointer(self.control), lib.RUN_QUIT)
            try:
                if self._process.wait(QUIT_S) == 0 and self.control.phase == lib.PHASE_ENDED:
                    self.unsafe = ""  # by the loop itself
            except subprocess.TimeoutExpired:
                self.kill()
        self.make_safe()
        self.end_group()

    def kill(self) -> None:
        """Kill it at once."""
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGSTOP)  # it starts nothing more
        self.end_group()
        if self._process.poll() is None:
            self._process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(KILLED_S)

    def keep_rescue(self) -> None:
        """See to it that a process waits to make the machine safe. It may have been ended, when
        memory ran out for example.
        """
        with self._making_safe:
            if self.unsafe == BEING_MADE_SAFE and self.alive():
                self._rescue.stand_by(self.pid)

    def look(self) -> None:
        """Note the processes that user code started, where the system cannot forbid starting them.
        """
        if not self._contained:
            self._strays.look()

    def end_group(self) -> None:
        """End the processes that user code started, where the system cannot forbid starting them:
        the process group, and those that left it.
        """
        if not self._contained:
            self._strays.end()
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)

    def make_safe(self) -> str:
        """Bring real hardware into its safe state, by the process that waits for that; a second
        call does nothing. Returns why it failed, or an empty string.

        A simulated machine ended with its runner.
        """
        with self._making_safe:
            if self.unsafe:
                self.unsafe = "" if self.simulated else self._rescue.act()
            return self.unsafe

    def unlink(self) -> None:
        """Remove the names of the files and dismiss the rescue process; what was mapped stays
        readable.
        """
        self._rescue.dismiss()
        self.control_file.unlink()
        if hasattr(self, "data_file"):
            self.data_file.unlink()


def ffi_pointer(struct: Any) -> Any:
    """Pointer to a cffi struct.
    """
    ffi, _ = layout()
    return ffi.addressof(struct)


def ffi_address(struct: Any, field: str) -> Any:
    """Pointer to a field of a cffi struct.
    """
    ffi, _ = layout()
    return ffi.addressof(struct, field)
