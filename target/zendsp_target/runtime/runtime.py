"""The real-time side as the server sees it: `zendsp_target.api.RuntimeApi` on shared memory and a
native runner.

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

from collections.abc import Mapping
from typing import Any

from msgspec.structs import replace

from zendsp_isr.build import source_root
from zendsp_protocol.kept import Kept
from zendsp_protocol.messages import Status
from zendsp_target.runtime.loaded_variables import LoadedVariables
from zendsp_target.runtime.motion import Motion
from zendsp_target.runtime.programs import Programs
from zendsp_target.runtime.recorder import Recorder
from zendsp_target.runtime.status import empty_status, status_of


def program_text(name: str) -> str:
    """The source of an example program.

    Parameters
    ----------
    name : str
        ``"template"``, ``"pd"``, …

    Examples
    --------
    >>> "UserISR_INT2" in program_text("template")
    True
    """
    return (source_root() / "programs" / f"{name}.c").read_text()


class Runtime:
    """A machine and the program that runs on it: every method of `RuntimeApi`, each done by one of
    the parts below.

    Parameters
    ----------
    machine : str
        Name of a shipped machine, or path of a ``.c`` file of your own.
    rate_hz : float
        Samples a second, 1 … 100 000.
    clock : str
        ``"real"``, or ``"fast"``: a simulated machine as fast as the CPU allows, with identical
        results.
    machine_config : mapping, optional
        Settings of the machine (start position …).
    concealed : str, optional
        Handed to the machine and to nobody else before `reveal`: ``"seed:17"`` or a file, see
        `zendsp_target.concealed.sealed`.
    **options
        Further fields of `zendsp_target.runtime.process.settings.Settings` (realtime, priority,
        cpu, spin_us, speed, hang_s, load_s), also as text; and ``machine.KEY`` for settings of
        the machine.

    Attributes
    ----------
    programs : Programs
        Compile, load, unload.
    motion : Motion
        Start, pause, STOP, drives, limits.
    recorder : Recorder
        Acquisition streams.

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
        programs = Programs(machine, rate_hz, clock, machine_config, concealed, **options)
        motion = Motion(programs)
        variables = LoadedVariables(programs)
        recorder = Recorder(programs.folder, lambda: programs.session)
        self.programs, self.motion = programs, motion
        self.recorder = recorder

        self.title = programs.title
        self.compile, self.configure = programs.compile, programs.configure
        self.load, self.unload = programs.load, programs.unload
        self.stop_page, self.runner_pid = programs.stop_page, programs.runner_pid
        self.seal, self.reveal, self.close = programs.seal, programs.reveal, programs.close

        self.start, self.pause, self.wait_paused = motion.start, motion.pause, motion.wait_paused
        self.stop, self.trip, self.acknowledge = motion.stop, motion.trip, motion.acknowledge
        self.set_drive, self.home, self.machine = motion.set_drive, motion.home, motion.machine
        self.limits, self.set_limits = motion.limits, motion.set_limits
        self.set_ramp, self.set_overrun = motion.set_ramp, motion.set_overrun
        self.set_inputs, self.attend = motion.set_inputs, motion.attend
        self.cancel = motion.cancel

        self.variables, self.builtins = variables.declared, variables.builtins
        self.read, self.repeat_read = variables.read, variables.repeat_read
        self.write, self.repeat_write = variables.write, variables.repeat_write
        self.check, self.wait_applied = variables.check, variables.wait_applied
        self.ended, self.log = variables.ended, variables.log

        self.acquire_configure, self.acquire_start = recorder.configure, recorder.start
        self.acquire_keep, self.acquire_stop = recorder.keep, recorder.stop
        self.acquire_status, self.acquire_held = recorder.status, recorder.held
        self.acquire_read = recorder.read

    @property
    def farewell(self) -> str:
        """A clause on the machine, once this is closed; empty where no program was loaded."""
        return self.programs.farewell

    @property
    def unsafe(self) -> str:
        """Why the machine may still move though its program has ended; else empty."""
        return self.programs.unsafe

    @property
    def left_behind(self) -> tuple[list[Kept], list[Kept]]:
        """Recordings of targets that were killed: those that are still in shared memory, and those
        that the start of this target removed.
        """
        return self.programs.folder.kept, self.programs.folder.dropped

    def status(self) -> Status:
        """The state of program, loop, drives and trips."""
        programs, session = self.programs, self.programs.session
        number = programs.trips()
        status = (
            empty_status(programs.settings, programs.unsafe, programs.latched())
            if session is None
            else status_of(session, programs.latched)
        )
        trip = status.trip and replace(status.trip, number=number)
        return replace(status, trip=trip) if trip else status

    def __enter__(self) -> Runtime:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
