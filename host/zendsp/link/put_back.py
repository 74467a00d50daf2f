"""Restores what a run has set in the program when the run ends, in whichever way."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from zendsp.errors import Refused, ZendspError
from zendsp.here.uninterrupted import uninterrupted
from zendsp_protocol import messages as m
from zendsp_protocol.states import ProgramState, VariableKind

if TYPE_CHECKING:
    from zendsp.link.target import Target

GONE = (ProgramState.CRASHED, ProgramState.EMPTY)


class Before:
    """The values that variables of the loaded program have now, tables included, to be restored
    after a run. The target keeps them, and restores them itself if this host is lost.

    Parameters
    ----------
    names : iterable of str
        What the run will set, elements ``"q[1]"`` too; names that the program lacks are left out.
    moves : bool
        The run moves the machine: if this host is lost, the host-lost policy acts.
    fade : float
        Time in which numbers go back while the program runs, s; at most 2.
    """

    def __init__(
        self, target: Target, names: Iterable[str], moves: bool = False, fade: float = 0.0
    ) -> None:
        self._target = target
        asked = {"fade": fade} if fade else {}
        self._begun: m.RunBegun = target.request(
            "run_begin", names=list(names), moves=moves, **asked
        )

    @property
    def follows(self) -> bool:
        """Whether the program followed its table."""
        return self._begun.follows

    def put_back(self) -> str:
        """Restore all values, in one sample or faded; return why that failed, else "".

        Nothing is written into another program, into one that was loaded anew, or into one that
        crashed. The rows of tables are not restored while the program runs and follows its tables,
        since the switch-over would start their motion.
        """
        try:
            self._target.request("run_end", run=self._begun.run)
        except ZendspError as error:
            what = ", ".join(self._begun.names)
            return (
                f"not all of {what} is put back: {error}"
                if what
                else f"the target did not hear that the run ended: {error}"
            )
        return ""


class Loaded:
    """The loaded program as it is now, with parameters and tables, to be loaded again after others.

    Raises
    ------
    Refused
        A STOP or a trip is latched: nothing could be loaded, and nothing is touched.
    """

    def __init__(self, target: Target) -> None:
        self._target = target
        status = target.status()
        if status.trip is not None:
            raise Refused(f"{status.trip.text or status.trip.reason}: acknowledge it first")
        self._empty = status.state in GONE
        if not self._empty:
            infos = target.variables().values()
            kept = (VariableKind.PARAMETER, VariableKind.TABLE)
            names = [info.name for info in infos if info.kind in kept]
            self._program = target.program()
            self._values = dict(target.read(names).values) if names else {}

    def put_back(self) -> str:
        """Load the program again without starting it; return why that failed, else "".

        While a STOP or a trip is latched nothing can be loaded, and no program is loaded then.
        """
        target = self._target
        try:
            status = target.status()
            if status.state == ProgramState.RUNNING and status.trip is None:
                target.pause()
            if self._empty or status.trip is not None:
                target.unload()
                return "" if self._empty else f"{self._name} is not loaded any more: load it again"
            target.download(self._program.sources, self._program.flags)
            if self._values:
                target.variables.update_alone(self._values)
        except ZendspError as error:
            return f"what was loaded before the run is not put back: {error}"
        return ""

    @property
    def _name(self) -> str:
        return next(iter(self._program.sources), "the program")


@contextmanager
def kept(
    target: Target, names: Iterable[str], moves: bool = False, fade: float = 0.0
) -> Iterator[Before]:
    """A block at whose end the variables that it sets in the program are restored.

    Parameters
    ----------
    names : iterable of str
        Parameters and tables.
    fade : float
        As for `Before`.

    Warns
    -----
    UserWarning
        They could not be put back; the message says why.
    """
    before = Before(target, names, moves, fade)
    try:
        yield before
    finally:
        with uninterrupted():
            why = before.put_back()
        if why and not target.link.given_up:  # a lost target puts back by itself
            warnings.warn(why, stacklevel=3)
