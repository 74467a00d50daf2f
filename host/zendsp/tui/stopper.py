"""A small process between the keyboard and the terminal application, which does nothing but STOP.

It reads the keys first, hands every byte on, and asks the target for STOP over a link of its own. Python runs one thread
of a process at a time, and a library that plans a motion or is being loaded can hold that right for seconds: a thread
of the application's own could not promise anything.

    stdin  the terminal (or, in a browser, the packets of the page)
    1      what was read, for the application
    CONTROL    in: the name of the target to be ready for, a line each; "!" is STOP (a click)
    VERDICTS   out: a line of JSON for each STOP: asked, then how it ended
"""

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
from typing import TYPE_CHECKING, Any

from zendsp.errors import NotStopped, ZendspError

if TYPE_CHECKING:
    from textual.driver import Driver

    from zendsp.link import Target

F9_MARKS = (b"\x1b[20~", b"\x1b[20;")  # with modifiers and kinds of event
EMERGENCY = "NOT STOPPED: use the machine's emergency stop"
STOPPERS = 2  # a second STOP does not wait for the end of the first
RETRY_S = 0.4  # between attempts to connect, or to stop what did not answer
INSIST_S = 10.0  # that a STOP without an answer is asked again
PASTE_S = 2.0  # of silence, after which a paste whose end did not come is over


def is_stop(key: str) -> bool:
    """Whether a key, by Textual's name, is STOP: F9 whatever is held with it, and Ctrl+Space by both its names."""
    return key.rpartition("+")[2] == "f9" or key in ("ctrl+@", "ctrl+space")


# -- the process ----------------------------------------------------------------------------------------------------------


class Links:
    """Keeps a link ready to the target that the application names."""

    def __init__(self) -> None:
        self.target: Target | None = None
        self.name = ""
        self._wanted = threading.Event()
        threading.Thread(target=self._keep, name="links", daemon=True).start()

    def want(self, name: str) -> None:
        """Be ready for this target from now on; the same name once more: look it up again."""
        self.name = name
        self._wanted.set()

    def _keep(self) -> None:
        from zendsp.link import connect

        while True:
            self._wanted.wait()
            self._wanted.clear()
            name, old = self.name, self.target
            if old is not None and (old.name != name or not old.alive):
                self.target = None
                old.close()
            while name and self.target is None and not self._wanted.is_set():
                try:
                    self.target = connect(name, shown=False)  # the terminal itself stands there already
                except ZendspError:
                    self._wanted.wait(RETRY_S)


def _stop(stops: queue.SimpleQueue[float], links: Links, tell: Callable[..., None]) -> None:
    from zendsp.link.programs import stopped

    while True:
        until = stops.get() + INSIST_S
        target = links.target
        tell("asked", "STOP asked: no word yet that it stopped")
        try:
            if target is None:
                raise NotStopped(f"{EMERGENCY} (there is no link to {links.name or 'a target'})")
            tell("stopped", stopped(target.stop()))
        except Exception as error:
            detail = str(error) if isinstance(error, NotStopped) else f"{EMERGENCY} ({error})"
            tell("not stopped", EMERGENCY, detail)
            while target is not None and target is links.target and time.monotonic() < until:
                time.sleep(RETRY_S)
                with contextlib.suppress(ZendspError):
                    tell("stopped", stopped(target.stop()))
                    break


def keys_of(web: bool) -> Callable[[bytes], Iterator[str]]:
    """Make what names the keys in bytes read; Textual's own parser tells them from pasted text in all terminals."""
    from codecs import getincrementaldecoder

    from textual import events
    from textual._xterm_parser import XTermParser
    from textual.drivers._byte_stream import ByteStream

    parser, packets = XTermParser(), ByteStream()
    decode = getincrementaldecoder("utf-8")("replace").decode

    silent_since, pasting = 0.0, False

    def keys(data: bytes) -> Iterator[str]:
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

    def parsed(data: bytes) -> Iterator[str]:
        parts: Iterable[Any] = (p for kind, p in packets.feed(data) if kind == "D" and p) if web else (data,)
        for part in parts if data else ():  # nothing means the end to the parser
            for event in parser.feed(decode(part)):
                if isinstance(event, events.Key):
                    yield event.key
        for event in parser.tick():
            if isinstance(event, events.Key):
                yield event.key

    return keys


def serve(control: int, verdicts: int, web: bool) -> None:
    """Run until the application or the terminal is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    lock = threading.Lock()

    def tell(state: str, text: str, detail: str = "") -> None:
        line = json.dumps({"state": state, "text": text, "detail": detail}) + "\n"
        with lock, contextlib.suppress(OSError):
            os.write(verdicts, line.encode())

    links, stops = Links(), queue.SimpleQueue[float]()
    for _ in range(STOPPERS):
        threading.Thread(target=_stop, args=(stops, links, tell), daemon=True).start()
    keys, lines = keys_of(web), b""
    waiting = b""  # for the application to take: it must never hold up the keys
    os.set_blocking(1, False)
    while True:
        readable, _, _ = select.select([0, control], [1] if waiting else [], [], 0.1)
        if 0 in readable:
            try:
                data = os.read(0, 4096)
            except OSError:  # the terminal is gone
                data = b""
            if not data:
                return
            for key in keys(data):
                if is_stop(key):
                    stops.put(time.monotonic())
            waiting += data
        elif not readable:
            for key in keys(b""):  # an Escape that nothing followed
                if is_stop(key):
                    stops.put(time.monotonic())
        if control in readable:
            data = os.read(control, 4096)
            if not data:  # the application is gone
                return
            *whole, lines = (lines + data).split(b"\n")
            for line in whole:
                if line == b"!":
                    stops.put(time.monotonic())
                else:
                    links.want(line.decode())
        if waiting:
            with contextlib.suppress(BlockingIOError):
                waiting = waiting[os.write(1, waiting) :]


# -- the application's side --------------------------------------------------------------------------------------------------


class Stopper:
    """Puts the process between the terminal and this one; where it ends, the terminal is this one's again.

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
            [sys.executable, "-c", call], stdin=self.terminal, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            pass_fds=(control_in, verdicts_out),
        )  # fmt: skip
        os.close(control_in)
        os.close(verdicts_out)
        assert self._process.stdout is not None
        os.dup2(self._process.stdout.fileno(), 0)
        self.alive = True
        threading.Thread(target=self._listen, name="tui-verdicts", daemon=True).start()

    def want(self, name: str) -> None:
        """Have a link to this target ready."""
        self._write(name)

    def stop(self) -> bool:
        """STOP, from a click; False where the process is gone."""
        return self._write("!")

    def close(self) -> None:
        """End it and take the terminal back."""
        self.alive = False
        with contextlib.suppress(OSError):
            os.close(self._control)
        self._process.terminate()
        self._process.wait()
        os.dup2(self.terminal, 0)

    def _write(self, line: str) -> bool:
        try:
            os.write(self._control, f"{line}\n".encode())
        except OSError:
            return False
        return self.alive

    def _listen(self) -> None:
        with open(self._verdicts, encoding="utf-8") as lines:
            for line in lines:
                verdict = json.loads(line)
                self._on_verdict(verdict["state"], verdict["text"], verdict["detail"])
        if self.alive:
            self.alive = False
            self._process.wait()
            os.dup2(self.terminal, 0)


def with_stop(base: type[Driver], stopper: Callable[[], Stopper | None], stop: Callable[[], object]) -> type[Driver]:
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
            if isinstance(message, events.Key) and is_stop(message.key):
                process = stopper()
                if process is None or not process.alive:
                    stop()
                return
            super().process_message(message)

    return Stopping
