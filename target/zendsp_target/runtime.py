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

from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp_isr.build import source_root
from zendsp_protocol.errors import RunnerDied
from zendsp_protocol.kept import About, Kept
from zendsp_protocol.messages import Held
from zendsp_target.api import (
    AcquireConfig,
    AcquireStatus,
    Blank,
    Change,
    Status,
    Value,
    VariableInfo,
)
from zendsp_target.motion import Motion
from zendsp_target.recorder import Recorder
from zendsp_target.status import empty_status, status_of


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


class Runtime(Motion):
    """A machine, and what runs on it.

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
        `zendsp_target.concealed`.
    **options
        Further fields of `zendsp_target.settings.Settings` (realtime, priority, cpu, spin_us,
        speed, hang_s, load_s), also as text; and ``machine.KEY`` for settings of the machine.

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
        super().__init__(machine, rate_hz, clock, machine_config, concealed, **options)
        self._recorder = Recorder(self._folder, lambda: self._session)

    @property
    def left_behind(self) -> tuple[list[Kept], list[Kept]]:
        """What targets that were killed had recorded: what stays in shared memory, and what the
        start of this one removed.
        """
        return self._folder.kept, self._folder.dropped

    # ---- variables ----------------------------------------------------------------------------------------------------------  # noqa: E501

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

    def ended(self) -> str:
        """Why the loaded program no longer runs although nobody paused it, in a sentence; empty
        where it does or none is loaded.
        """
        session = self._session
        return "" if session is None else session.ended()

    def check(self, values: Mapping[str, Value]) -> None:
        """Raise what :meth:`write` would raise for these values; nothing is written."""
        self._loaded().updates.check(values)

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
        session = self._session
        if session is None:
            session = self._loaded()
        try:
            return session.updates.write(values, author, at_tick)
        except RunnerDied:
            session.require_alive()  # tells how it died
            raise

    def repeat_read(self, names: Sequence[str], reply: Blank) -> Callable[[int], int] | None:
        """What reads the same doubles again, straight into a reply; None where there is no such
        way.

        Parameters
        ----------
        names : sequence of str
            As they were read before.
        reply : Blank

        Returns
        -------
        callable or None
            Takes the least tick that may be told. 0: nothing was read, `read` says why.
        """
        session = self._session
        return None if session is None else session.repeat_read(names, reply)

    def repeat_write(
        self, name: str, author: str, value_at: int, reply: Blank
    ) -> Callable[[bytes], int] | None:
        """What writes the same double again, straight out of a request; None where there is no such
        way.

        Parameters
        ----------
        name : str
            As it was written before.
        author : str
        value_at : int
            Where the value stands in the request, bytes.
        reply : Blank

        Returns
        -------
        callable or None
            Takes the request; returns the sequence number. 0: nothing was written, `write` says
            why.
        """
        session = self._session
        return None if session is None else session.repeat_write(name, author, value_at, reply)

    def wait_applied(self, sequence: int, timeout: float) -> int:
        """Sleep until an update has taken effect; returns its sample. See `Updates.wait_applied`.
        """
        return self._loaded().updates.wait_applied(sequence, timeout)

    def log(self, since: int = 0) -> tuple[Change, ...]:
        """Changes from line number `since` on."""
        session = self._session
        if session is not None:
            session.updates.harvest()
        return self._log.since(since)

    # ---- acquisition --------------------------------------------------------------------------------------------------------  # noqa: E501

    def acquire_configure(self, stream: int, config: AcquireConfig) -> AcquireStatus:
        """Set up a stream (0: recorder; 1 … 7: live); what it held before is dropped.

        Raises
        ------
        AcquisitionError
            No program, an unknown channel, or more than fits into memory.
        """
        return self._recorder.configure(stream, config)

    def acquire_start(self, stream: int, force: bool = False) -> None:
        """Begin to acquire, or wait for the trigger; `force` fires the trigger of a stream that is
        armed already.

        Raises
        ------
        AcquisitionError
            Not configured, or its program is no longer loaded.
        """
        self._recorder.start(stream, force)

    def acquire_keep(self, about: About) -> None:
        """Have the rows of the recorder outlive this process if it is killed; see
        `zendsp_protocol.kept`.
        """
        self._recorder.keep(about)

    def acquire_stop(self, stream: int) -> None:
        """End an acquisition at the next sample; its rows stay."""
        self._recorder.stop(stream)

    def acquire_status(self, stream: int) -> AcquireStatus:
        """Where a stream stands."""
        return self._recorder.status(stream)

    def acquire_held(self, stream: int) -> Held:
        """Where the rows of a stream stand, for a reader of the same user; see `acquisition.held`.
        """
        return self._recorder.held(stream)

    def acquire_read(
        self,
        stream: int,
        first: int,
        count: int,
        into: npt.NDArray[np.float64] | None = None,
        fold: bytearray | None = None,
    ) -> npt.NDArray[np.float64]:
        """Rows of a stream, shape (rows, channels). See `acquisition.read`."""
        return self._recorder.read(stream, first, count, into, fold)

    # ---- status -------------------------------------------------------------------------------------------------------------  # noqa: E501

    def status(self) -> Status:
        """Everything that a person wants to see at a glance."""
        session = self._session
        return empty_status(self._settings) if session is None else status_of(session)

    def __enter__(self) -> Runtime:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
