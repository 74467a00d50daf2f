"""Keys that come faster than what they are meant for."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any
from weakref import WeakKeyDictionary

from textual import events
from textual.app import App
from textual.message_pump import MessagePump

from zendsp.tui.dialogs.base import Dialog
from zendsp.tui.stop_process import PICTURE

HELD_S = 5.0  # that keys wait for a dialog that is on its way, or for what a key does in a dialog


def _anew(key: events.Key) -> events.Key:
    """The same key, as if it came from the terminal."""
    typed = events.Key(key.key, key.character)
    typed.time = key.time
    return typed


class TypeAhead(App[None]):
    """Each key does what it would do if the screen were never late.

    Keys wait for a dialog that is on its way. In a dialog each waits until the one before has had
    its effect, which may be that the dialog has closed and that another one opens.
    """

    def __init__(self) -> None:
        super().__init__()
        self._typed = 0.0  # when the key or the click came that is handled now, monotonic
        self._expected = 0.0  # until when keys wait for a dialog
        self._held: list[events.Key] = []
        self._given: WeakKeyDictionary[events.Key, MessagePump] = WeakKeyDictionary()
        self._blind = False  # before the first picture
        self._way: Iterator[MessagePump] | None = None  # what a key has still to pass
        self._passed = 0.0  # until when it is waited for

    def expect_dialog(self) -> None:
        """Hold back the keys from now on until a dialog or an input line is there to take them,
        for :data:`HELD_S` at the most.
        """
        self._expected = time.monotonic() + HELD_S

    def no_dialog(self) -> None:
        """No dialog comes: what was typed for it is dropped, and never becomes a command."""
        self._expected = 0.0
        self._held.clear()

    async def hand_over(self, dialog: Dialog[Any] | None = None) -> None:
        """Hand what was typed to the dialog, or to whoever has the focus now; later keys wait in
        this task's queue meanwhile.
        """
        self._expected = 0.0
        if dialog is not None:
            dialog.opened = True
        held, self._held = self._held, []
        for key in sorted(held, key=lambda key: key.time):  # some came by way of a slow screen
            await self.on_event(key)

    def answered(self) -> None:
        """A dialog has its answer: keys wait until that has had its effect on the screen below."""
        self._hold_for(self.screen, self)

    def _hold_for(self, *pumps: MessagePump) -> None:
        self._passed = time.monotonic() + HELD_S
        self._way = iter(pumps)
        self._pass(self._way)

    def _pass(self, way: Iterator[MessagePump]) -> None:
        """Go on to the next queue, behind what a key has left in this one."""
        if way is not self._way:
            return  # a later one is waited for
        for pump in way:
            if pump.call_later(self._pass, way):
                return
        self._way = None
        if self._held and not self._dialog_comes():
            self.call_later(self.hand_over)

    def _see(self) -> None:
        """From now on keys are meant for what is seen."""
        self._blind = False

    async def on_event(self, event: events.Event) -> None:
        """Drop what was typed before the first picture. Keep keys for a dialog that is on its way:
        also those that no widget wanted and that come back here as commands, since a terminal
        hands on many keys at once. One that comes back when the focus has moved is for whoever has
        it now.
        """
        if self._blind and isinstance(event, events.InputEvent | events.Paste):
            if isinstance(event, events.Key) and event.key == PICTURE:
                self._see()
            return
        if isinstance(event, events.InputEvent):
            self._typed = event.time
        if not isinstance(event, events.Key):
            await super().on_event(event)
            return
        if self._dialog_comes():
            self._held.append(_anew(event))
            return
        taker = self.focused or self.screen
        if self._given.setdefault(event, taker) is not taker:
            event = _anew(event)
            self._given[event] = taker
        fresh = not event.is_forwarded
        if fresh and self._passes():
            self._held.append(event)
            return
        await super().on_event(event)
        way, screen = taker.ancestors_with_self, self.screen
        if fresh and isinstance(screen, Dialog) and screen.opened and screen in way:
            # up to the application as a key, and up to the dialog as what it has brought about
            self._hold_for(*way, *way[: way.index(screen) + 1])

    def _passes(self) -> bool:
        """Whether a key is still on its way through a dialog."""
        if self._way is not None and time.monotonic() > self._passed:
            self._way = None
        return self._way is not None

    def _dialog_comes(self) -> bool:
        screen = self.screen
        if isinstance(screen, Dialog) and not screen.opened:
            return True
        if self._expected and time.monotonic() > self._expected:
            self.no_dialog()
        return bool(self._expected)
