"""A small process between the keyboard and the terminal application, which does nothing but STOP.

It reads the keys first, hands every byte on, and asks the target for STOP over a link of its own.
Python runs one thread of a process at a time, and a library that plans a motion or is being loaded
can hold that right for seconds: a thread of the application's own could not promise anything.

    stdin     in: the terminal (or, in a browser, the packets of the page)
    stdout    out: what was read, for the application
    CONTROL   in, a line each: the name of the target to be ready for, with "= " before it where it
              runs on this computer, whatever $ZENDSP_CONNECT says;
              "@ x y width height", where the red field is; "!", which is STOP (by the palette of
              commands); "?", which is answered by "here"; "^": the first picture is there, and the
              key PICTURE follows what was typed before
    VERDICTS  out: a line of JSON for each STOP: asked, then how it ended
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import select
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from zendsp.errors import NotStopped
from zendsp.here.registered import own_entries
from zendsp.here.stop_page import StopPage, find
from zendsp.here.stopped import TAKEN_S, stopped
from zendsp.link import connect
from zendsp.link.background import background

if TYPE_CHECKING:
    from textual.events import MouseDown

    from zendsp.link import Target
    from zendsp.tui.early import Early

PICTURE, _PICTURE = "f20", b"\x1b[57383u"  # the key, and how a terminal writes it
_ESC, _ESCAPE = b"\x1b", b"\x1b[27u"  # the key Escape, and how it is written beyond doubt
F9_MARKS = (b"\x1b[20~", b"\x1b[20;")  # with modifiers and kinds of event
F9_ALONE, PACKET = F9_MARKS[0], 5  # bytes before what a packet of a page holds
PASTE_BEGINS, PASTE_ENDS = b"\x1b[200~", b"\x1b[201~"
HERE = "here"  # the answer to "?"
EMERGENCY = "NOT STOPPED: use the machine's emergency stop"
STOPPERS = 2  # a second STOP does not wait for the end of the first
RETRY_S = 0.4  # between attempts to connect, or to stop what did not answer
INSIST_S = 10.0  # that a STOP without an answer is asked again
PASTE_S = 2.0  # of silence, after which a paste whose end did not come is over
ESCAPE_S = 0.1  # without another byte, after which an Escape is a key of its own


class StopState(StrEnum):
    """Progress of a STOP."""

    ASKED = "asked"
    STOPPED = "stopped"
    NOT_STOPPED = "not stopped"


def is_stop(key: str) -> bool:
    """Whether a key, by Textual's name, is STOP: F9 with any modifier, and Ctrl+Space by both of
    its names.
    """
    return key.rpartition("+")[2] == "f9" or key in ("ctrl+@", "ctrl+space")


@dataclass(frozen=True)
class Field:
    """The place of the red field on the screen, in characters."""

    x: int = 0
    y: int = 0
    width: int = 0
    height: int = 0

    def holds(self, event: MouseDown) -> bool:
        """Whether the first mouse button was pressed within it."""
        inside = (
            self.x <= event.x < self.x + self.width and self.y <= event.y < self.y + self.height
        )
        return inside and event.button == 1


class Links:
    """Keeps a link to the target that the application names."""

    def __init__(self) -> None:
        self.target: Target | None = None
        self.name, self._here = "", False
        self._wanted = threading.Event()
        background("links", self._keep)

    def want(self, name: str, here: bool) -> None:
        """Keep a link to this target from now on; given the same name again, look it up again.

        Parameters
        ----------
        here : bool
            It runs on this computer, wherever ``$ZENDSP_CONNECT`` leads to.
        """
        self.name, self._here = name, here
        self._wanted.set()

    def page(self) -> StopPage | None:
        """The stop page of the target if it is one of this computer; that needs no link."""
        target = self.target
        if target is not None and target.name == self.name:
            page = target.stop_page()
            if page is not None:
                return page
        return find(self.name) if own_entries(self.name, self._where()) else None

    def _where(self) -> tuple[str, ...] | None:
        return () if self._here else None

    def _keep(self) -> None:
        while True:
            self._wanted.wait()
            self._wanted.clear()
            name, old = self.name, self.target
            if old is not None and (old.name != name or not old.alive):
                self.target = None
                old.close()
            while name and self.target is None and not self._wanted.is_set():
                try:
                    # the terminal itself stands there already
                    self.target = connect(name, self._where(), shown=False)
                except BaseException:  # a panic of Zenoh's too: without this thread, no link again
                    self._wanted.wait(RETRY_S)


class Stops:
    """Asks the target for STOP, and reports how each one ended.

    If the target runs here and belongs to this user, the request is one byte in shared memory,
    written where the key is read. For everything else, and for targets elsewhere, there are
    threads.
    """

    def __init__(self, links: Links, tell: Callable[..., None]) -> None:
        self._links, self._tell = links, tell
        self._pressed = queue.Queue[tuple[float, StopPage | None, int]]()
        for _ in range(STOPPERS):
            background("stop", self._run)

    def press(self) -> None:
        """STOP. It never waits and never fails: where the stop page cannot be read, the link is
        used.
        """
        page, asked = None, 0
        try:
            page = self._links.page()
            asked = page.ask() if page is not None else 0
        except Exception:  # whatever it was, this process has to live
            page = None
        self._pressed.put((time.monotonic(), page, asked))

    def finish(self) -> None:
        """Wait until each of them has ended, in one way or the other."""
        self._pressed.join()

    def _run(self) -> None:
        while True:
            pressed, page, asked = self._pressed.get()
            self._tell(StopState.ASKED, "STOP asked: no word yet that it stopped")
            sample = None
            with contextlib.suppress(Exception):  # what the page cannot say the link is asked
                sample = page.taken(asked, TAKEN_S) if page is not None else None
            if sample is not None:
                self._tell(StopState.STOPPED, f"stopped, at sample {sample}")
            else:
                self._insist(pressed + INSIST_S)
            self._pressed.task_done()

    def _insist(self, until: float) -> None:
        links, name, told = self._links, self._links.name, False
        while True:
            target = links.target
            try:
                if target is None:
                    raise NotStopped(
                        f"{EMERGENCY} (there is no link to {links.name or 'a target'})"
                    )
                self._tell(StopState.STOPPED, stopped(target.stop()))
                return
            except BaseException as error:  # a panic of Zenoh's too
                if not told:
                    detail = (
                        str(error) if isinstance(error, NotStopped) else f"{EMERGENCY} ({error})"
                    )
                    self._tell(StopState.NOT_STOPPED, EMERGENCY, detail)
                told = True
            if time.monotonic() > until or name not in ("", links.name):
                return
            time.sleep(RETRY_S)


def be_prompt() -> None:
    """Raise the priority of this process where that is permitted: it does little, but that must not
    wait.
    """
    with contextlib.suppress(OSError):
        os.sched_setscheduler(
            0, os.SCHED_RR, os.sched_param(os.sched_get_priority_min(os.SCHED_RR))
        )


class Presses:
    """Finds keys and clicks in the bytes that are read. Textual's own parser tells them from pasted
    text, on all terminals.

    Parameters
    ----------
    web : bool
        The bytes are packets of the page.
    """

    def __init__(self, web: bool) -> None:
        from codecs import getincrementaldecoder

        self._web = web
        self._decode = getincrementaldecoder("utf-8")("replace").decode
        self._read_at, self._pasting = 0.0, False
        self._begin()

    def _begin(self) -> None:
        from textual._xterm_parser import XTermParser
        from textual.drivers._byte_stream import ByteStream

        self._parser, self._packets = XTermParser(), ByteStream()

    def find(self, data: bytes) -> Iterator[str | MouseDown]:
        """The names of the keys, and the clicks. Without data: a key that might still have
        continued.
        """
        if data:
            self._note_paste(data)
        try:
            yield from self._parsed(data)
        except Exception:  # a sequence that Textual cannot read must not be the end of STOP
            self._begin()
            if any(mark in data for mark in F9_MARKS):
                yield "f9"

    def _note_paste(self, data: bytes) -> None:
        """Give up a pasted text whose end did not arrive: after a silence, or where F9 comes alone.
        Who hammers on it leaves no silence, and no text comes in pieces of just that.
        """
        now, key = time.monotonic(), data[PACKET:] if self._web else data
        if self._pasting and (now > self._read_at + PASTE_S or key == F9_ALONE):
            self._begin()
            self._pasting = False
        begin, end = data.rfind(PASTE_BEGINS), data.rfind(PASTE_ENDS)
        if begin != end:
            self._pasting = begin > end
        self._read_at = now

    def _parsed(self, data: bytes) -> Iterator[str | MouseDown]:
        from textual.events import Key, MouseDown

        parts: Iterable[bytes] = (data,)
        if self._web:
            parts = (part for kind, part in self._packets.feed(data) if kind == "D" and part)
        for part in parts if data else ():  # nothing means the end to the parser
            for event in self._parser.feed(self._decode(part)):
                if isinstance(event, Key):
                    yield event.key
                elif isinstance(event, MouseDown):
                    yield event
        for event in self._parser.tick():
            if isinstance(event, Key):
                yield event.key


class Escapes:
    """Hands on the key Escape so that it is not taken for the beginning of the next key.

    An application that reads both together, because it was busy, takes them for Alt and a key, or
    for no key. This process sees that they arrived apart.

    Parameters
    ----------
    web : bool
        What is typed are packets of the page, of one key each.
    """

    def __init__(self, web: bool) -> None:
        self._web = web
        self._held, self._held_at = b"", 0.0  # one that may begin a sequence; when it came

    def alone(self) -> bool:
        """Whether an Escape is held back that no other byte has followed in time."""
        return bool(self._held) and time.monotonic() > self._held_at + ESCAPE_S

    def told_apart(self, data: bytes) -> bytes:
        """The bytes to hand on; without data, the Escape that was held back."""
        if self._web:
            return data.replace(_packet(_ESC), _packet(_ESCAPE))
        sequence = data.startswith((b"[", b"O"))  # that came in two parts
        before = self._held if sequence or not self._held else _ESCAPE
        self._held, self._held_at = _ESC if data.endswith(_ESC) else b"", time.monotonic()
        return before + data.removesuffix(_ESC)


def _packet(key: bytes) -> bytes:
    return b"D" + len(key).to_bytes(4, "big") + key


class Keys:
    """Hands on what is typed, and does STOP where that is among it.

    Parameters
    ----------
    control, verdicts : int
        File descriptors.
    web : bool
        What is read are packets of the page.
    early : Early
        Takes what is typed until `run`.
    """

    def __init__(self, control: int, verdicts: int, web: bool, early: Early) -> None:
        self._control, self._verdicts, self._early = control, verdicts, early
        self._lock = threading.Lock()
        self._links = Links()
        self._stops = Stops(self._links, self._tell)
        self._presses = Presses(web)
        self._field = Field()
        self._line = b""  # the beginning of one of the application's
        self._escapes = Escapes(web)
        self._waiting = b""  # for the application to take: it must never hold up the keys
        self._picture = _packet(_PICTURE) if web else _PICTURE

    def run(self) -> None:
        """Hand on bytes until the application or the terminal is gone, and each STOP has ended."""
        os.set_blocking(1, False)
        self._hand_on(self._early.taken())
        if self._links.name:
            self._stops.finish()

    def _hand_on(self, early: bytes) -> None:
        here = True
        while here:
            writable = [1] if self._waiting else []
            patience = 0.0 if early else ESCAPE_S
            readable, _, _ = select.select([0, self._control], writable, [], patience)
            pictures = 0
            if self._control in readable:  # first: a click means the field that was told before it
                data = os.read(self._control, 4096)
                here = bool(data)  # what was typed before its end is looked at all the same
                pictures = self._hear(data)
            if early or 0 in readable:
                data, early = early or _typed(), b""
                if not data:
                    return
                self._look(data)
                self._waiting += self._escapes.told_apart(data)
            elif not readable:
                self._look(b"")  # an Escape that nothing followed
            if self._escapes.alone():
                self._waiting += self._escapes.told_apart(b"")
            self._waiting += pictures * self._picture
            if self._waiting and here:
                with contextlib.suppress(BlockingIOError):
                    self._waiting = self._waiting[os.write(1, self._waiting) :]

    def _hear(self, data: bytes) -> int:
        """Carry out the lines of the application; return the number of pictures that it reports."""
        *lines, self._line = (self._line + data).split(b"\n")
        for line in lines:
            if line == b"!":
                self._stops.press()
            elif line == b"?":
                self._tell(HERE, "")
            elif line.startswith(b"@"):
                self._field = Field(*map(int, line[1:].split()))
            elif line != b"^":
                here, name = line.startswith(b"= "), line.removeprefix(b"= ")
                self._links.want(name.decode(), here)
        return lines.count(b"^")

    def _look(self, data: bytes) -> None:
        for press in self._presses.find(data):
            if is_stop(press) if isinstance(press, str) else self._field.holds(press):
                self._stops.press()

    def _tell(self, state: str, text: str, detail: str = "") -> None:
        line = json.dumps({"state": state, "text": text, "detail": detail}) + "\n"
        with self._lock, contextlib.suppress(OSError):
            os.write(self._verdicts, line.encode())


def _typed() -> bytes:
    """The bytes that were typed; none where the terminal is gone."""
    try:
        return os.read(0, 4096)
    except OSError:
        return b""


def serve(control: int, verdicts: int, web: bool, early: Early) -> None:
    """Run until the application or the terminal is gone; `early` has begun to take what is typed.
    Signals that end a command are blocked in this process.
    """
    be_prompt()  # first: threads inherit it
    Keys(control, verdicts, web, early).run()
