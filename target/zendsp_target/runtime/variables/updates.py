"""Synchronous updates: any number of variables, applied whole at the start of one sample.

A batch is filled in shared memory and then published by one release store: a monitor that dies
while filling it has published nothing. What becomes of it then is in `flights`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from zendsp_protocol.errors import Refused, TooSoon, VariableError
from zendsp_protocol.states import VariableKind
from zendsp_target.api import Blank
from zendsp_target.bounded import keep
from zendsp_target.runtime.memory.layout import layout
from zendsp_target.runtime.variables.banks import Banks
from zendsp_target.runtime.variables.change_log import Flight
from zendsp_target.runtime.variables.dictionary import Dictionary
from zendsp_target.runtime.variables.flights import LAST_TICK, TOGETHER, Flights
from zendsp_target.runtime.variables.plans import WritePlan
from zendsp_target.runtime.variables.values import FloatArray, check_kind, numbers_of

_NUMBERS = frozenset((float, int))


class Updates:
    """The writing side of one load.

    Parameters
    ----------
    control : cffi struct control
    dictionary : Dictionary
    flights : Flights
        What is under way.
    banks : Banks
    handle : int
        The runner's pidfd, which tells within the commit whether it still runs; -1 where the
        kernel has none.
    """

    def __init__(
        self, control: Any, dictionary: Dictionary, flights: Flights, banks: Banks, handle: int = -1
    ) -> None:
        self._pointer = layout()[0].addressof(control)
        self._dictionary, self._flights, self._banks = dictionary, flights, banks
        self._handle = handle
        # by names: of the program's variables, and of the runtime's settings
        self._plans: tuple[dict[tuple[str, ...], WritePlan], ...] = ({}, {})

    def write(
        self,
        values: Mapping[str, object],
        author: str,
        at_tick: int | None = None,
        fade: int = 0,
        *,
        settings: bool = False,
    ) -> int:
        """Check all values, then commit them as one batch.

        Parameters
        ----------
        values : mapping of name to value
        author : str
        at_tick : int or None
            First sample at which it may act; None: the next one.
        fade : int
            Samples over which numbers go from their old to their new values, slowly at first;
            whole numbers, flags and tables switch at the end. What is written later ends it.
        settings : bool
            The names are the runtime's own settings rather than the program's variables.

        Returns
        -------
        int
            Sequence number for `Flights.wait_applied`.

        Raises
        ------
        VariableError
            One line for each variable that is wrong; nothing was applied.
        Refused
            Nothing to write, or more than fits. `TooSoon`: too many updates wait, or a table's last
            download is not in effect yet.
        """
        _require_sample(at_tick)
        if not values:
            raise Refused("an update needs at least one variable")
        plan = self._plan(values, settings)
        if fade and 2 * plan.size > self._flights.room:
            raise Refused(
                f"fading {plan.size} bytes in needs twice as many, {self._flights.room} fit:"
                " fade fewer variables at once"
            )
        given = tuple(values.values())
        # What has to be looked at one by one is so before others are kept waiting; single numbers
        # are judged as they are committed.
        numbers = (
            None
            if plan.scalar and _NUMBERS.issuperset(map(type, given))
            else self._numbers(values, settings)
        )
        late = at_tick is not None or fade > 0
        flights = self._flights
        with flights.lock:
            slot = flights.take_slot(plan.tables, late)
            try:
                if numbers is None:
                    plan.fill(*given)
                else:
                    plan.put(self._banked(plan, numbers) if plan.tables else numbers)
                number = flights.sequence + 1
                done = plan.commit(flights.batches[slot], slot, number, at_tick or 0, fade)
                if done < 0:
                    raise VariableError(
                        "; ".join(
                            f"{name}: {value!r} does not fit" for name, value in values.items()
                        )
                    )
            except BaseException as error:
                flights.free.append(slot)
                if isinstance(error, VariableError | OverflowError):
                    self._numbers(values, settings)  # has the words
                raise
            flight = Flight(
                slot, plan.places, plan.size, plan.given(), author, time.time(), fade, late
            )
            return flights.enter(flight, done == 1)

    def _plan(self, values: Mapping[str, object], settings: bool) -> WritePlan:
        """The plan for these names, made where there is none yet."""
        names = tuple(values)
        plan = self._plans[settings].get(names)
        if plan is None:
            self._numbers(values, settings)  # says all that is wrong, not only with the names
            plan = WritePlan(
                [(name, self._dictionary.place(name)) for name in names],
                self._pointer,
                self._handle,
            )
            if plan.size > self._flights.room:
                raise Refused(
                    f"the update takes {plan.size} bytes, {self._flights.room} fit: write whole"
                    " arrays in place of their elements"
                )
            keep(self._plans[settings], names, plan)
        return plan

    def _numbers(self, values: Mapping[str, object], settings: bool) -> list[FloatArray]:
        """The numbers of every variable; where some are wrong, an error with one line for each."""
        found: list[FloatArray] = []
        problems: list[str] = []
        for name, value in values.items():
            try:
                place = self._dictionary.place(name, len(problems))
                check_kind(name, place, settings)
                found.append(numbers_of(name, place, value))
            except VariableError as error:
                problems.append(str(error))
        if problems:
            raise VariableError("\n".join(problems))
        return found

    def check(self, values: Mapping[str, object], at_tick: int | None = None) -> None:
        """Raise what `write` would raise for these values, without writing."""
        _require_sample(at_tick)
        self._numbers(values, False)

    def repeat(
        self,
        ended: Any,
        names: Sequence[str],
        author: str,
        request: Blank,
        reply: Blank,
    ) -> Callable[[bytes], int] | None:
        """Return a function that takes doubles out of the bytes of a request and commits them; see
        `RuntimeApi.repeat_write`.
        """
        plan = self._plans[False].get(tuple(names))
        commit = None if plan is None or self._handle < 0 else plan.again(ended, request, reply)
        if plan is None or commit is None:
            return None
        entries = partial(plan.entries_of, request.values)
        flights = self._flights
        lock, batches = flights.lock, flights.batches
        free, under_way = flights.free, flights.under_way
        now = time.time

        def write(request: bytes) -> int:
            with lock:
                if len(under_way) >= TOGETHER or not free:
                    flights.take_back()
                if not free:
                    return 0
                slot, sequence = free.pop(), flights.sequence + 1
                if commit(request, batches[slot], slot, sequence) != 1:
                    free.append(slot)
                    return 0
                under_way[sequence] = Flight(
                    slot, plan.places, plan.size, partial(entries, request), author, now()
                )
                flights.sequence = sequence
                return sequence

        return write

    def _banked(self, plan: WritePlan, numbers: list[FloatArray]) -> list[FloatArray]:
        """Put the rows of tables into their banks; the batch then holds bank and number of rows."""
        waiting = self._flights.variables()
        for name, place in plan.places:  # all of them before the first bank is touched
            if place.entry.info.kind == VariableKind.TABLE and place.entry.index in waiting:
                raise TooSoon(
                    f"{name}: its last download is not in effect yet; wait for it, then write again"
                )
        return [
            (
                np.array(self._banks.fill(place, rows), np.float64)
                if place.entry.info.kind == VariableKind.TABLE
                else rows
            )
            for (_, place), rows in zip(plan.places, numbers, strict=True)
        ]


def _require_sample(at_tick: int | None) -> None:
    if at_tick is not None and not 0 <= at_tick <= LAST_TICK:
        raise Refused(
            f"at_tick {at_tick} is no sample: give one from 0 on, or leave it out for the next"
        )
