"""A small process between the keyboard and the terminal application, which does nothing but STOP.

It reads the keys first, hands every byte on, and asks the target for STOP over a link of its own.
Python runs one thread of a process at a time, and a library that plans a motion or is being loaded
can hold that right for seconds: a thread of the application's own could not promise anything.

    stdin  the terminal (or, in a browser, the packets of the page)
    1      what was read, for the application
    CONTROL    in, a line each: the name of the target to be ready for; "@ x y width height", where the red field is;
               "!", which is STOP (by the palette of commands); "?", which is answered by "here"; "^": the first picture is
               there, and the key PICTURE follows what was typed before
    VERDICTS   out: a line of JSON for each STOP: asked, then how it ended

A process that does not answer any more is ended: it would hold every key back. The application then reads the keys itself.
"""  # noqa: E501

from __future__ import annotations

import contextlib
import json
import os
import queue
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zendsp.errors import NotStopped, ZendspError
from zendsp.here.registered import own_entries
from zendsp.here.stop_page import StopPage, find
from zendsp.here.stopped import TAKEN_S, stopped
from zendsp.link import connect
from zendsp.link.background import background

if TYPE_CHECKING:
    from textual.driver import Driver
    from textual.events import MouseDown

    from zendsp.link import Target

PICTURE, _PICTURE = "f20", b"\x1b[57383u"  # the key, and how a terminal writes it
F9_MARKS = (b"\x1b[20~", b"\x1b[20;")  # with modifiers and kinds of event
HERE = "here"
EMERGENCY = "NOT STOPPED: use the machine's emergency stop"
STOPPERS = 2  # a second STOP does not wait for the end of the first
RETRY_S = 0.4  # between attempts to connect, or to stop what did not answer
INSIST_S = 10.0  # that a STOP without an answer is asked again
ASK_S = 0.2  # between questions whether it is there
LOOK_S = 0.1  # between looks at one that has not answered yet
ASLEEP_S = 0.5  # without an answer, after which it is ended unless it wants a processor
SILENT_S = 3.0  # the same where it wants one: the computer is busy
PASTE_S = 2.0  # of silence, after which a paste whose end did not come is over


def is_stop(key: str) -> bool:
    """Whether a key, by Textual's name, is STOP: F9 whatever is held with it, and Ctrl+Space by
    both its names.
    """
    return key.rpartition("+")[2] == "f9" or key in ("ctrl+@", "ctrl+space")


@dataclass(frozen=True)
class Field:
    """Where the red field is on the screen, in characters."""

    x: int = 0
    y: int = 0
    width: int = 0
    height: int = 0

    def holds(self, event: MouseDown) -> bool:
        """Whether the first button was pressed in it."""
        inside = (
            self.x <= event.x < self.x + self.width and self.y <= event.y < self.y + self.height
        )
        return inside and event.button == 1


# -- the process


class Links:
    """Keeps a link ready to the target that the application names."""

    def __init__(self) -> None:
        self.target: Target | None = None
        self.name = ""
        self._wanted = threading.Event()
        background("links", self._keep)

    def want(self, name: str) -> None:
        """Be ready for this target from now on; the same name once more: look it up again."""
        self.name = name
        self._wanted.set()

    def page(self) -> StopPage | None:
        """The stop page of the target, where it is one of this machine: it needs no link."""
        target = self.target
        if target is not None and target.name == self.name:
            page = target.stop_page()
            if page is not None:
                return page
        return find(self.name) if own_entries(self.name, None) else None

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
                    self.target = connect(name, shown=False)
                except ZendspError:
                    self._wanted.wait(RETRY_S)


class Stops:
    """Asks the target for STOP, and tells how each ended.

    The request itself is one byte in shared memory, written where the key is read, if the target
    runs here and is this user's; the rest, and targets elsewhere, have threads.
    """

    def __init__(self, links: Links, tell: Callable[..., None]) -> None:
        self._links, self._tell = links, tell
        self._pressed = queue.SimpleQueue[tuple[float, StopPage | None, int]]()
        for _ in range(STOPPERS):
            background("stop", self._run)

    def press(self) -> None:
        """STOP. Never waits."""
        page = self._links.page()
        asked = page.ask() if page is not None else 0
        self._pressed.put((time.monotonic(), page, asked))

    def _run(self) -> None:
        while True:
            pressed, page, asked = self._pressed.get()
            self._tell("asked", "STOP asked: no word yet that it stopped")
            sample = page.taken(asked, TAKEN_S) if page is not None else None
            if sample is not None:
                self._tell("stopped", f"stopped, at sample {sample}")
            else:
                self._insist(pressed + INSIST_S)

    def _insist(self, until: float) -> None:
        links, name, told = self._links, self._links.name, False
        while True:
            target = links.target
            try:
                if target is None:
                    raise NotStopped(
                        f"{EMERGENCY} (there is no link to {links.name or 'a target'})"
                    )
                self._tell("stopped", stopped(target.stop()))
                return
            except Exception as error:
                if not told:
                    detail = (
                        str(error) if isinstance(error, NotStopped) else f"{EMERGENCY} ({error})"
                    )
                    self._tell("not stopped", EMERGENCY, detail)
                told = True
            if time.monotonic() > until or name not in ("", links.name):
                return
            time.sleep(RETRY_S)


def be_prompt() -> None:
    """Have this process run before ordinary ones, where that is permitted: it does little, and what
    it does cannot wait.
    """
    with contextlib.suppress(OSError):
        os.sched_setscheduler(
            0, os.SCHED_RR, os.sched_param(os.sched_get_priority_min(os.SCHED_RR))
        )


def presses_of(web: bool) -> Callable[[bytes], Iterator[str | MouseDown]]:
    """Make what finds keys (their names) and clicks in bytes read; Textual's own parser tells them
    from pasted text in all terminals.
    """
    from codecs import getincrementaldecoder

    from textual import events
    from textual._xterm_parser import XTermParser
    from textual.drivers._byte_stream import ByteStream

    parser, packets = XTermParser(), ByteStream()
    decode = getincrementaldecoder("utf-8")("replace").decode

    silent_since, pasting = 0.0, False

    def presses(data: bytes) -> Iterator[str | MouseDown]:
        nonlocal parser, packets, silent_since, pasting
        if data:
            if pasting and time.monotonic() > silent_since + PASTE_S:
                parser, pasting = XTermParser(), False
            begin, end = data.rfind(b"\x1b[200~"), data.rfind(b"\x1b[201~")
            pasting = begin > end if begin != end else pasting
            silent_since = time.monotonic()
        try:
            yield from parsed(data)
        except Exception:  # a sequence that Textual cannot read must not be the end of STOP
            parser, packets = XTermParser(), ByteStream()
            if any(mark in data for mark in F9_MARKS):
                yield "f9"

    def parsed(data: bytes) -> Iterator[str | MouseDown]:
        parts: Iterable[Any] = (
            (p for kind, p in packets.feed(data) if kind == "D" and p) if web else (data,)
        )
        for part in parts if data else ():  # nothing means the end to the parser
            for event in parser.feed(decode(part)):
                if isinstance(event, events.Key):
                    yield event.key
                elif isinstance(event, events.MouseDown):
                    yield event
        for event in parser.tick():
            if isinstance(event, events.Key):
                yield event.key

    return presses


def serve(control: int, verdicts: int, web: bool) -> None:
    """Run until the application or the terminal is gone."""
    be_prompt()  # first: threads inherit it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    lock = threading.Lock()

    def tell(state: str, text: str, detail: str = "") -> None:
        line = json.dumps({"state": state, "text": text, "detail": detail}) + "\n"
        with lock, contextlib.suppress(OSError):
            os.write(verdicts, line.encode())

    links = Links()
    stops = Stops(links, tell)
    presses, field, lines = presses_of(web), Field(), b""
    waiting = b""  # for the application to take: it must never hold up the keys
    mark = b"D" + len(_PICTURE).to_bytes(4, "big") + _PICTURE if web else _PICTURE
    gone = False
    os.set_blocking(1, False)

    def look(data: bytes) -> None:
        for press in presses(data):
            if is_stop(press) if isinstance(press, str) else field.holds(press):
                stops.press()

    while True:
        readable, _, _ = select.select([0, control], [1] if waiting else [], [], 0.1)
        pictures = 0
        if control in readable:  # first: a click means the field that was told before it
            data = os.read(control, 4096)
            gone = not data  # the application; what was typed before is looked at all the same
            *whole, lines = (lines + data).split(b"\n")
            for line in whole:
                if line == b"!":
                    stops.press()
                elif line == b"?":
                    tell(HERE, "")
                elif line == b"^":
                    pictures += 1
                elif line.startswith(b"@"):
                    field = Field(*map(int, line[1:].split()))
                else:
                    links.want(line.decode())
        if 0 in readable:
            try:
                data = os.read(0, 4096)
            except OSError:  # the terminal is gone
                data = b""
            if not data:
                return
            look(data)
            waiting += data
        elif not readable:
            look(b"")  # an Escape that nothing followed
        if gone:
            return
        waiting += pictures * mark
        if waiting:
            with contextlib.suppress(BlockingIOError):
                waiting = waiting[os.write(1, waiting) :]


def _states(pid: int) -> set[str]:
    """What the threads of a process do: R runs or would, D waits for a disk, T is stopped, …"""
    found = set()
    for stat in Path(f"/proc/{pid}/task").glob("*/stat"):
        with contextlib.suppress(OSError):
            found.add(stat.read_text(errors="replace").rpartition(")")[2].split()[0])
    return found


# -- the application's side


class Stopper:
    """Puts the process between the terminal and this one; where it ends, the terminal is this one's
    again.

    Parameters
    ----------
    on_verdict : callable
        ``on_verdict(state, text, detail)``, called in a thread of its own.
    """

    def __init__(self, on_verdict: Callable[[str, str, str], None]) -> None:
        self._on_verdict = on_verdict
        self.terminal = os.dup(0)
        os.set_inheritable(self.terminal, False)
        control_in, self._control = os.pipe()
        self._verdicts, verdicts_out = os.pipe()
        web = "web_driver" in os.environ.get("TEXTUAL_DRIVER", "")
        call = f"from zendsp.tui.stopper import serve; serve({control_in}, {verdicts_out}, {web})"
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", call],
            stdin=self.terminal,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            pass_fds=(control_in, verdicts_out),
        )
        os.close(control_in)
        os.close(verdicts_out)
        assert self._process.stdout is not None
        os.dup2(self._process.stdout.fileno(), 0)
        self.alive, self.field = True, Field()
        self._here = threading.Event()
        threading.Thread(target=self._listen, name="tui-verdicts", daemon=True).start()
        threading.Thread(target=self._watch, name="tui-keys-watch", daemon=True).start()

    def want(self, name: str) -> None:
        """Have a link to this target ready."""
        self._write(name)

    def place(self, field: Field) -> None:
        """Tell where the red field is: a click there is STOP."""
        if field != self.field:
            self.field = field
            self._write(f"@ {field.x} {field.y} {field.width} {field.height}")

    def stop(self) -> bool:
        """STOP, not by a key or a click; False where the process is gone."""
        return self._write("!")

    def picture(self) -> bool:
        """Have the key :data:`PICTURE` follow what was typed until now; False where the process is
        gone.
        """
        return self._write("^")

    def close(self) -> None:
        """End it and take the terminal back."""
        self.alive = False
        with contextlib.suppress(OSError):
            os.close(self._control)
        self._process.kill()  # one that is stopped would not hear anything less
        self._process.wait()
        os.dup2(self.terminal, 0)

    def _write(self, line: str) -> bool:
        try:
            os.write(self._control, f"{line}\n".encode())
        except OSError:
            return False
        return self.alive

    def _watch(self) -> None:
        """End the process if it hangs: what follows is as if it had been killed."""
        begun = False
        while self._write("?"):
            asked = time.monotonic()
            while not self._here.wait(LOOK_S):
                if self._hangs(time.monotonic() - asked if begun else 0.0):
                    if self.alive:
                        self._process.kill()
                    return
            self._here.clear()
            begun = True
            time.sleep(ASK_S)

    def _hangs(self, silent_s: float) -> bool:
        """Whether nobody will read the next key, after so many seconds without an answer."""
        if select.select([self._verdicts], [], [], 0.0)[0]:
            return False  # its answer is there: it is the application that could not look
        states = _states(self._process.pid)
        if "T" in states:
            time.sleep(LOOK_S)  # a whole job that goes on does so one by one
            return "T" in _states(self._process.pid)
        return silent_s > (SILENT_S if states & {"R", "D"} else ASLEEP_S)

    def _listen(self) -> None:
        with open(self._verdicts, encoding="utf-8") as lines:
            for line in lines:
                verdict = json.loads(line)
                if verdict["state"] == HERE:
                    self._here.set()
                else:
                    self._on_verdict(verdict["state"], verdict["text"], verdict["detail"])
        if self.alive:
            self.alive = False
            self._process.wait()
            os.dup2(self.terminal, 0)


def with_stop(
    base: type[Driver], stopper: Callable[[], Stopper | None], stop: Callable[[], object]
) -> type[Driver]:
    """Make a driver like ``base`` that reads what the process hands on, and lets it do STOP.

    Where the process is gone, the thread that reads the keys calls ``stop`` itself.
    """
    from textual import events
    from textual.message import Message

    class Stopping(base):  # type: ignore[misc, valid-type]
        _fileno = 0

        @property
        def fileno(self) -> int:
            """The keys' thread reads standard input; settings are those of the terminal itself."""
            process = stopper()
            reading = threading.current_thread().name == "textual-input"
            return self._fileno if reading or process is None or self.is_web else process.terminal

        @fileno.setter
        def fileno(self, value: int) -> None:
            self._fileno = value

        def process_message(self, message: Message) -> None:
            process = stopper()
            alive = process is not None and process.alive
            if isinstance(message, events.Key) and is_stop(message.key):
                if not alive:
                    stop()
                return
            if (
                alive
                and process is not None
                and isinstance(message, events.MouseDown)
                and process.field.holds(message)
            ):
                return
            super().process_message(message)

    return Stopping
