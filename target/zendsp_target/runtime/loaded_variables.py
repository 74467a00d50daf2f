"""The variables of the program that is loaded now: read, write, and the log of changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from zendsp_protocol.errors import RunnerDied
from zendsp_protocol.messages import Change, VariableInfo
from zendsp_protocol.states import VariableKind
from zendsp_protocol.values import Value
from zendsp_target.api import Blank
from zendsp_target.runtime.programs import Programs


class LoadedVariables:
    """Variables by name.

    Parameters
    ----------
    programs : Programs
        Whose loaded program declares them.
    """

    def __init__(self, programs: Programs) -> None:
        self._programs = programs

    def declared(self) -> tuple[VariableInfo, ...]:
        """Variables that the loaded program declares."""
        return self._programs.loaded().dictionary.infos(
            VariableKind.PARAMETER, VariableKind.SIGNAL, VariableKind.TABLE
        )

    def builtins(self) -> tuple[VariableInfo, ...]:
        """Signals that exist without being declared."""
        return self._programs.loaded().dictionary.infos(VariableKind.BUILTIN)

    def read(self, names: Sequence[str]) -> tuple[int, dict[str, Value]]:
        """Values of variables, elements and built-in signals, all from one sample, and that
        sample's tick. While a trip is latched, no sample before it is read.

        Raises
        ------
        VariableError
            One line for each unknown name.
        """
        session = self._programs.loaded()
        session.show_trip()
        return session.read(names)

    def ended(self) -> str:
        """Why the loaded program no longer runs although nobody paused it, in a sentence; empty
        where it runs or none is loaded.
        """
        session = self._programs.session
        return "" if session is None else session.ended()

    def check(self, values: Mapping[str, Value], at_tick: int | None = None) -> None:
        """Raise what :meth:`write` would raise for these values, without writing."""
        self._programs.loaded().updates.check(values, at_tick)

    def write(
        self,
        values: Mapping[str, Value],
        author: str,
        at_tick: int | None = None,
        fade: int = 0,
    ) -> int:
        """Commit a synchronous update and return its sequence number; see `Updates.write`."""
        session = self._programs.session
        if session is None:
            session = self._programs.loaded()
        try:
            return session.updates.write(values, author, at_tick, fade)
        except RunnerDied:
            session.require_alive()  # tells how it died
            raise

    def repeat_read(self, names: Sequence[str], reply: Blank) -> Callable[[], int] | None:
        """A function that reads the same doubles again, see `RuntimeApi.repeat_read`; None where
        that cannot be prepared.
        """
        session = self._programs.session
        return None if session is None else session.repeat_read(names, reply)

    def repeat_write(
        self, names: Sequence[str], author: str, request: Blank, reply: Blank
    ) -> Callable[[bytes], int] | None:
        """A function that writes the same doubles again, see `RuntimeApi.repeat_write`; None where
        that cannot be prepared.
        """
        session = self._programs.session
        return None if session is None else session.repeat_write(names, author, request, reply)

    def wait_applied(self, sequence: int, timeout: float) -> int:
        """Wait until an update has taken effect and return its sample; see `Flights.wait_applied`.
        """
        return self._programs.loaded().flights.wait_applied(sequence, timeout)

    def log(self, since: int = 0) -> tuple[Change, ...]:
        """Changes from line number `since` on."""
        session = self._programs.session
        if session is not None:
            session.flights.harvest()
        return self._programs.log.since(since)
