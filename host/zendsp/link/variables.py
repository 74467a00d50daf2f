"""Variables of the running code: asynchronous reads and writes, synchronous updates, the
dictionary, the log.
"""

from __future__ import annotations

import numbers
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

import msgspec

from zendsp.errors import EndedWarning, VariableError
from zendsp.link.listings import Dictionary, Log
from zendsp.link.requests import Part, Requests
from zendsp_protocol import messages as m
from zendsp_protocol.states import VariableKind
from zendsp_protocol.values import Assignable, Packed, Value, WireValue, from_wire, to_wire
from zendsp_protocol.views import html_table, sentence, short

_FLOATS = frozenset((float,))


class Reading(msgspec.Struct, frozen=True):
    """Values of several variables, all from sample ``tick``. It is a struct of msgspec, since one
    is made at each reading.
    """

    tick: int
    values: Mapping[str, Value]
    # why the program no longer runs: it crashed, tripped or was stopped; the values are those of
    # its last sample
    ended: str = ""

    def __getitem__(self, name: str) -> Value:
        return self.values[name]

    def __repr__(self) -> str:
        values = ", ".join(f"{name} {short(value)}" for name, value in self.values.items())
        return f"<Reading of sample {self.tick}: {values}{_after(self.ended)}>"

    def _repr_html_(self) -> str:
        rows = [(name, short(value)) for name, value in self.values.items()]
        return sentence(f"sample {self.tick}{_after(self.ended)}") + html_table(
            ("variable", "value"), rows
        )


def _check_name(name: object) -> None:
    """Refuse what is no name of one variable, and say what to write."""
    if isinstance(name, str):
        return
    if isinstance(name, tuple) and name and all(isinstance(one, str) for one in name):
        listed, named = ", ".join(map(repr, name)), ", ".join(f"{one}=…" for one in name)
        raise VariableError(
            f"target[{listed}]: in brackets is one name; several of one sample:"
            f" target.read([{listed}]), target.update({named})"
        )
    raise VariableError(f"target[{name!r}]: expected the name of a variable, such as target['Kp1']")


def _after(ended: str) -> str:
    return f"; the program has ended: {ended}" if ended else ""


class Variables(Part):
    """The variables of a target's program; called, it returns their dictionary."""

    def __init__(self, requests: Requests) -> None:
        super().__init__(requests)
        self._staged: dict[str, Assignable] = {}
        self._written = 0  # number of a write that no reading has seen yet

    def __repr__(self) -> str:
        return (
            f"<Variables of {self.link.target}: target.variables() is their dictionary,"
            " target['NAME'] reads one, target['NAME'] = value writes it>"
        )

    def __getitem__(self, name: str) -> Value:
        """The present value of one variable, or of one element ``"q[1]"`` of an array.

        Warns
        -----
        EndedWarning
            The program crashed, tripped or was stopped: what it computes is that of its last
            sample, what is set acts when it runs again.

        Raises
        ------
        VariableError
            No such variable.
        """
        if type(name) is not str:
            _check_name(name)
        reading = self.read([name])
        if reading.ended:
            last = "as it was set last" if self._is_set(name) else "that of its last sample"
            said = f"the program has ended, {name} is {last}: {reading.ended}"
            warnings.warn(said, EndedWarning, stacklevel=2)
        return reading.values[name]

    def __iter__(self) -> Iterator[str]:
        """Names of the variables."""
        return iter(self())

    def __contains__(self, name: object) -> bool:
        """Whether there is such a variable."""
        return name in self()

    def _is_set(self, name: str) -> bool:
        """Whether a host sets this variable."""
        info = self().get(name.partition("[")[0])
        return info is not None and info.kind != VariableKind.SIGNAL

    def __setitem__(self, name: str, value: Assignable) -> None:
        """Write one variable: it takes effect at the start of the next sample.

        Raises
        ------
        VariableError
            Unknown, read only, of another type, outside its limits or NaN; nothing was changed.
        """
        if type(name) is not str:
            _check_name(name)
        self.write(**{name: value})

    def read(self, names: Sequence[str]) -> Reading:
        """Values of several variables, all from one sample, in which everything that was written
        here before is in effect.

        Parameters
        ----------
        names : sequence of str
            Variables, or elements ``"q[1]"``.

        Returns
        -------
        Reading
            Its ``ended`` says why the program no longer runs, where it does not.
        """
        if isinstance(names, str):
            names = [names]
        asked: dict[str, Any] = {"names": list(names)}
        written = self._written
        if written:
            asked["after"] = written
        found: m.Reading = self._requests.link.request("read", asked)
        if written == self._written:
            self._written = 0
        if _FLOATS.issuperset(map(type, found.values.values())):
            return Reading(found.tick, cast("dict[str, Value]", found.values), found.ended)
        values = {name: from_wire(value) for name, value in found.values.items()}
        return Reading(found.tick, values, found.ended)

    def write(self, /, **values: Assignable) -> int:
        """Write variables asynchronously; return the sequence number. The reply does not wait for
        the sample; the next `read` does.
        """
        written: m.Written = self._requests.link.request("write", {"values": _wire(values)})
        self._written = written.sequence
        return written.sequence

    def check(self, /, **values: Assignable) -> None:
        """Have the target check values as `write` would; nothing is written.

        Raises
        ------
        VariableError, Refused
            As `stage`.
        """
        self.link.request("check", {"values": _wire(values)})

    def stage(self, /, **values: Assignable) -> dict[str, Assignable]:
        """Keep values for the next `update`, once the target has checked them; return all that is
        staged.

        Raises
        ------
        VariableError
            Unknown, read only, of another type, outside its limits or NaN; nothing was noted.
        Refused
            No program is loaded, so nothing can be checked.
        """
        self.check(**values)
        self._staged |= values
        return dict(self._staged)

    @property
    def staged(self) -> dict[str, Assignable]:
        """The values that are staged."""
        return dict(self._staged)

    def discard(self) -> dict[str, Assignable]:
        """Forget the staged values, and return them."""
        staged, self._staged = self._staged, {}
        return staged

    def update(self, /, at_tick: int | None = None, **values: Assignable) -> int:
        """Apply everything staged, and ``values``, at the start of one sample: all or nothing.

        Parameters
        ----------
        at_tick : int, optional
            The first sample at which to apply them; then the call does not wait for it. One that
            has passed is the next one. Default: the next one.

        Returns
        -------
        int
            The sample at which they took effect; with ``at_tick`` that number.

        Raises
        ------
        VariableError
            One line per variable that is wrong; nothing was applied, what was staged stays staged.
        """
        try:
            return self._update(at_tick, values)
        except VariableError as error:
            if self._staged:
                error.add_note(
                    f"still staged: {', '.join(self._staged)}; discard() (MatDSPdiscard) forgets"
                    " them"
                )
            raise

    def _update(self, at_tick: int | None, values: dict[str, Assignable]) -> int:
        if at_tick is not None and not hasattr(at_tick, "__index__"):  # values, as for a dict
            raise VariableError(
                f"at_tick = {at_tick!r} is not the number of a sample; values have names:"
                " update(Kp1=450.0), or update(**values)"
            )
        batch = {**self._staged, **values} if self._staged and values else self._staged or values
        if not batch:
            raise VariableError("nothing to update: stage values first, or give them as arguments")
        if at_tick is None:
            applied: m.Applied = self.link.request("update", {"values": _wire(batch)})
            tick = applied.tick
        else:
            self.link.request("write", {"values": _wire(batch), "at_tick": at_tick})
            tick = at_tick
        self._staged = {}
        return tick

    def fade(self, seconds: float, /, **values: Assignable) -> int:
        """Move numbers gradually to their new values while the program runs, and wait for the end:
        no gain then steps the torque.

        Whole numbers, flags and tables switch at the end. Another update ends the fade of the
        variables that it writes; Ctrl-C ends the waiting only. Where the program does not run, all
        values are set at once.

        Parameters
        ----------
        seconds : float
            At most 2.

        Returns
        -------
        int
            The sample at which the new values are there.

        Raises
        ------
        VariableError
            One line per variable that is wrong; nothing was applied.
        """
        if not isinstance(seconds, numbers.Real):
            raise VariableError(
                f"seconds = {seconds!r} is no number of seconds; values have names:"
                " fade(0.5, Kp1=450.0), or fade(0.5, **values)"
            )
        applied: m.Applied = self.link.request(
            "update", {"values": _wire(values), "fade": float(seconds)}
        )
        return applied.tick

    def update_alone(self, values: Mapping[str, Assignable]) -> int:
        """As `update`, of these values only; staged values stay staged."""
        staged, self._staged = self._staged, {}
        try:
            return self.update(None, **values)
        finally:
            self._staged = staged

    def __call__(self) -> Dictionary:
        """The dictionary of the running code: name to type, length, kind, unit, limits, initial
        value, description.
        """
        return Dictionary({info.name: info for info in self.request("variables")})

    def builtins(self) -> Dictionary:
        """Signals that exist without being declared and can be recorded: tick, t, exec_us, enc,
        aout, …
        """
        return Dictionary({info.name: info for info in self.request("builtins")})

    def log(self, since: int = 0) -> Log:
        """Changes of parameters: sample, time, old and new value, and who made them.

        Parameters
        ----------
        since : int
            Leave out this many of the oldest entries.
        """
        return Log(self.request("log", since=since))


def plain(value: Any) -> Any:
    """A value that came over the wire, as bool, int, float or list."""
    return from_wire(value).tolist() if isinstance(value, Packed) else value  # type: ignore[union-attr]


def _wire(values: Mapping[str, Assignable]) -> Mapping[str, WireValue]:
    """Values in types that the wire has; nearly always they are so already."""
    if _FLOATS.issuperset(map(type, values.values())):
        return cast("Mapping[str, WireValue]", values)
    ready: dict[str, WireValue] = {}
    wrong = []
    for name, value in values.items():
        try:
            ready[name] = to_wire(value)
        except TypeError as error:
            wrong.append(f"{name}: {error}")
    if wrong:
        raise VariableError("\n".join(wrong))
    return ready
