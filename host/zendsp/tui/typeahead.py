"""Keeps keys that are typed faster than the screens follow."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any
from weakref import WeakKeyDictionary

from textual import events
from textual.app import App
from textual.message_pump import MessagePump

from zendsp.tui.actions import ACTIONS
from zendsp.tui.dialogs.base import Dialog
from zendsp.tui.stop_process import PICTURE, is_stop

HELD_S = 5.0  # that keys wait for a dialog that is on its way, or for what a key does in a dialog


def _anew(key: events.Key) -> events.Key:
    """The same key, as if it came from the terminal."""
    typed = events.Key(key.key, key.character)
    typed.time = key.time
    return typed


# keys that work everywhere go by no screen, and would overtake those that do
EVERYWHERE = frozenset(k for a in ACTIONS if a.priority for k in a.keys.split(","))


class TypeAhead(App[None]):
    """Has each key do what it would do if the screen were never late.

    Keys wait for a dialog that is about to open. In a dialog each key waits until the one before
    has had its effect, which may be that this dialog closes and another opens. A key that works
    everywhere waits for those that are still on their way through the present screen.
    """

    def __init__(self) -> None:
        super().__init__()
        self._typed = 0.0  # when the key or the click came that is handled now, monotonic
        self._expected = 0.0  # until when keys wait for a dialog
        self._held: list[events.Key] = []
        self._given: WeakKeyDictionary[events.Key, MessagePump] = WeakKeyDictionary()
        self._blind = False  # before the first picture
        self._ways: set[Iterator[MessagePump]] = set()  # what keys have still to pass
        self._passed = 0.0  # until when they are waited for

    def expect_dialog(self) -> None:
        """Hold back keys until a dialog or an input line is there to take them, for at most
        :data:`HELD_S`.
        """
        self._expected = time.monotonic() + HELD_S

    def no_dialog(self) -> None:
        """No dialog opens: keys that were typed for it are dropped, and never become commands."""
        self._expected = 0.0
        self._held.clear()

    async def hand_over(self, dialog: Dialog[Any] | None = None) -> None:
        """Hand the keys that were held back to the dialog, or to the widget with the focus; later
        keys wait in this task's queue meanwhile.
        """
        self._expected = 0.0
        if dialog is not None:
            dialog.opened = True
        held, self._held = self._held, []
        for key in sorted(held, key=lambda key: key.time):  # some came by way of a slow screen
            await self.on_event(key)

    def answered(self) -> None:
        """A dialog was answered: hold back keys until the answer has had its effect on the screen
        below.
        """
        self._ways.clear()
        self._wait_for(self.screen, self)

    def _wait_for(self, *pumps: MessagePump) -> None:
        way = iter(pumps)
        self._ways.add(way)
        self._passed = time.monotonic() + HELD_S
        self._pass(way)

    def _pass(self, way: Iterator[MessagePump]) -> None:
        """Go on to the next queue, after what a key has put into this one."""
        if way not in self._ways:
            return  # it is waited for no more
        for pump in way:
            if pump.call_later(self._pass, way):
                return
        self._ways.discard(way)
        if self._held and not self._ways and not self._dialog_comes():
            self.call_later(self.hand_over)

    def _see(self) -> None:
        """Note that from now on keys are meant for what is visible."""
        self._blind = False

    async def on_event(self, event: events.Event) -> None:
        """Drop keys that were typed before the first picture, and hold back keys for a dialog that
        is about to open.

        That includes keys that no widget wanted and that come back here as commands, since a
        terminal sends many keys at once. A key that comes back after the focus has moved goes to
        the widget that has it now.
        """
        if self._blind and isinstance(event, events.InputEvent | events.Paste):
            if isinstance(event, events.Key) and event.key == PICTURE:
                self._see()
            return
        if isinstance(event, events.InputEvent):
            self._typed = event.time
        if not isinstance(event, events.Key) or is_stop(event.key):
            await super().on_event(event)
            return
        if self._dialog_comes():
            self._held.append(_anew(event))
            return
        taker = self.focused or self.screen
        if self._given.setdefault(event, taker) is not taker:
            event = _anew(event)
            self._given[event] = taker
        if event.is_forwarded:
            await super().on_event(event)
        elif self._is_early(event):
            self._held.append(event)
        else:
            await super().on_event(event)
            way, screen = taker.ancestors_with_self, self.screen
            if screen in way:
                # up to here as a key, and in a dialog up to it as what the key has brought about
                again = way[: way.index(screen) + 1] if isinstance(screen, Dialog) else []
                self._wait_for(*way, *again)

    def _is_early(self, key: events.Key) -> bool:
        """Whether keys typed before this one must have their effect first."""
        if self._ways and time.monotonic() > self._passed:
            self._ways.clear()
            self.call_later(self.hand_over)
        overtakes = isinstance(self.screen, Dialog) or key.key in EVERYWHERE
        return bool(self._held or (self._ways and overtakes))

    def _dialog_comes(self) -> bool:
        screen = self.screen
        if isinstance(screen, Dialog) and not screen.opened:
            return True
        if self._expected and time.monotonic() > self._expected:
            self.no_dialog()
        return bool(self._expected)
