"""The application's side of the process that does STOP: see :mod:`zendsp.tui.stop_process`.

If that process no longer answers it is ended, since it would hold back every key. The application
then reads the keys itself.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from zendsp.here.ending import ENDING
from zendsp.tui.early import taken
from zendsp.tui.stop_process import HERE, Field, StopState, is_stop

if TYPE_CHECKING:
    from textual.driver import Driver

ASK_S = 0.2  # between questions whether it is there
LOOK_S = 0.1  # between looks at one that has not answered yet
ASLEEP_S = 0.5  # without an answer, after which it is ended unless it wants a processor
SILENT_S = 3.0  # the same where it wants one: the computer is busy
ENDING_S = 3.0  # that it has at the end for a STOP that was typed before
# it takes what is typed before it loads what it needs
CALL = (
    "import os; from zendsp.tui.early import Early; early = Early(0, {!r}); "
    "from zendsp.tui.stop_process import serve; serve({}, early); os._exit(0)"
)
OnVerdict = Callable[[StopState, str, str], None]
KEY_LOST = "a STOP pressed just now may be lost: press F9 again"


def _states(pid: int) -> set[str]:
    """The states of a process's threads: R runs or is ready to, D waits for a disk, T is stopped, …
    """
    found = set()
    for stat in Path(f"/proc/{pid}/task").glob("*/stat"):
        with contextlib.suppress(OSError):
            found.add(stat.read_text(errors="replace").rpartition(")")[2].split()[0])
    return found


class Stopper:
    """Puts the other process between the terminal and this one; when it ends, this process reads
    the terminal again.

    Parameters
    ----------
    target : str
        The target that STOP stops until another is named; empty for none.
    """

    def __init__(self, target: str = "") -> None:
        self.terminal = os.dup(0)
        os.set_inheritable(self.terminal, False)
        control_in, self._control = os.pipe()
        self._verdicts, verdicts_out = os.pipe()
        web = "web_driver" in os.environ.get("TEXTUAL_DRIVER", "")
        arguments = f"{control_in}, {verdicts_out}, {web}"
        call = CALL.format(taken(), arguments)
        # it ends when this process does, or the terminal is gone, and not before it has stopped
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", call],
                stdin=self.terminal,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                pass_fds=(control_in, verdicts_out),
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        os.close(control_in)
        os.close(verdicts_out)
        assert self._process.stdout is not None
        os.dup2(self._process.stdout.fileno(), 0)
        self.alive, self.field, self._heard = True, Field(), False
        self._here = threading.Event()
        self.want(target, here=False)  # before it reads a key

    def listen(self, on_verdict: OnVerdict) -> None:
        """Take its words from now on, and end it if it hangs.

        Parameters
        ----------
        on_verdict : callable
            ``on_verdict(state, text, detail)``, called in a thread of its own.
        """
        self._heard = True
        threading.Thread(
            target=self._listen, args=(on_verdict,), name="tui-verdicts", daemon=True
        ).start()
        threading.Thread(target=self._watch, name="tui-keys-watch", daemon=True).start()

    def want(self, name: str, here: bool) -> None:
        """Have it keep a link to this target. ``here``: on this computer; otherwise it looks for
        it.
        """
        self._write(f"= {name}" if here else name)

    def place(self, field: Field) -> None:
        """Tell it where the red field is: a click there is STOP."""
        if field != self.field:
            self.field = field
            self._write(f"@ {field.x} {field.y} {field.width} {field.height}")

    def stop(self) -> bool:
        """STOP that was not asked for by a key or a click; False where the process is gone."""
        return self._write("!")

    def picture(self) -> bool:
        """Have it send the key `PICTURE` after everything that was typed until now; False where it
        is gone.
        """
        return self._write("^")

    def close(self) -> str:
        """End it and take the terminal back; return how a STOP ended to which nobody has listened,
        empty where there was none.
        """
        self.alive = False
        with contextlib.suppress(OSError):
            os.close(self._control)
        if "T" not in _states(self._process.pid):
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(ENDING_S)
        self._process.kill()  # one that is stopped would not hear anything less
        self._process.wait()
        os.dup2(self.terminal, 0)
        return "" if self._heard else self._last_word()

    def _last_word(self) -> str:
        """How the last STOP ended, in its words."""
        said = ""
        with open(self._verdicts, encoding="utf-8") as lines, contextlib.suppress(ValueError):
            for line in lines:
                verdict = json.loads(line)
                if verdict["state"] in (StopState.STOPPED, StopState.NOT_STOPPED):
                    said = ": ".join(filter(None, (verdict["text"], verdict["detail"])))
        return said

    def _write(self, line: str) -> bool:
        try:
            os.write(self._control, f"{line}\n".encode())
        except OSError:
            return False
        return self.alive

    def _watch(self) -> None:
        """End the process if it hangs; the application then goes on as if it had been killed.

        Looks are counted, not seconds: while the interpreter is busy neither this thread runs, nor
        the one that has read the answer already.
        """
        begun = False
        while self._write("?"):
            looks = 0
            while not self._here.wait(LOOK_S):
                looks += begun
                if self._hangs(looks * LOOK_S):
                    if self.alive:
                        self._process.kill()
                    return
            self._here.clear()
            begun = True
            time.sleep(ASK_S)

    def _hangs(self, silent_s: float) -> bool:
        """Whether the process hangs, after looking for so many seconds without an answer."""
        try:
            if select.select([self._verdicts], [], [], 0.0)[0]:
                return False  # its answer is there: it is the application that could not look
        except OSError:  # it has ended, and its words were closed
            return True
        states = _states(self._process.pid)
        if "T" in states:
            time.sleep(LOOK_S)  # a whole job that goes on does so one by one
            return "T" in _states(self._process.pid)
        return silent_s > (SILENT_S if states & {"R", "D"} else ASLEEP_S)

    def _listen(self, on_verdict: OnVerdict) -> None:
        why = ""
        with open(self._verdicts, encoding="utf-8") as lines:
            try:
                for line in lines:
                    self._hear(json.loads(line), on_verdict)
            except Exception as error:  # nobody would tell any more how a STOP ended
                why = f" ({type(error).__name__}: {error})"
        if self.alive:
            self.alive = False
            self._process.kill()
            self._process.wait()
            os.dup2(self.terminal, 0)
            on_verdict(
                StopState.NOT_STOPPED,
                KEY_LOST,
                f"the process that reads the keys first has ended{why}: {KEY_LOST}."
                " The terminal reads the keys itself now",
            )

    def _hear(self, verdict: dict[str, str], on_verdict: OnVerdict) -> None:
        if verdict["state"] == HERE:
            self._here.set()
        else:
            state = StopState(verdict["state"])
            on_verdict(state, verdict["text"], verdict["detail"])


def with_stop(
    base: type[Driver], stopper: Callable[[], Stopper | None], stop: Callable[[], object]
) -> type[Driver]:
    """A driver like ``base`` that reads the bytes which the process hands on, and has it do STOP.
    It draws on standard output, so that ``2>file`` redirects standard error.

    Where the process is gone, the thread that reads the keys calls ``stop`` itself.
    """
    from textual import events
    from textual.message import Message

    class Stopping(base):  # type: ignore[misc, valid-type]
        _fileno = 0

        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            if getattr(self, "_file", None) is sys.__stderr__:
                # no sign of a picture may end it where the locale cannot write it
                cast(TextIOWrapper, sys.__stdout__).reconfigure(errors="backslashreplace")
                self._file = sys.__stdout__

        @property
        def fileno(self) -> int:
            """The descriptor of the terminal, for its settings; the thread that reads keys uses
            standard input.
            """
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
