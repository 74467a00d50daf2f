"""STOP straight from the keyboard's own thread, whatever the event loop of the screen is doing."""

from __future__ import annotations

from collections.abc import Callable

from textual import events
from textual.driver import Driver
from textual.message import Message

STOP_KEYS = ("f9", "ctrl+@")


def with_stop(base: type[Driver], stop: Callable[[], object]) -> type[Driver]:
    """Make a driver like ``base`` that calls ``stop`` for the keys of STOP, in the thread that reads the keys.

    Textual's own parser knows the sequences of all terminals, and tells keys from pasted text; the event loop, and a
    screen that is being built or drawn, have no part in it. In a browser, the driver reads a pipe, in the same way.
    """

    class Stopping(base):  # type: ignore[misc, valid-type]
        def process_message(self, message: Message) -> None:
            if isinstance(message, events.Key) and message.key in STOP_KEYS:
                stop()
                return
            super().process_message(message)

    return Stopping
