"""Find a C compiler, run it within limits, and read what it says.

Order of the search: ``$CC``, then ``cc``, ``gcc``, ``clang``, then the ``ziglang`` package (extra ``zendsp[zig]``).
"""

from __future__ import annotations

import functools
import importlib.util
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from zendsp_protocol.errors import CompileFailed

_LIMITS = 'ulimit -t "$1" -f "$2" 2>/dev/null; shift 2; exec "$@"'
_MAX_FILE_BLOCKS = 1_000_000  # 512 bytes each: no compiler output is larger
_TEXT = re.compile(
    r"^(?P<file>[^\s:][^:\n]*):(?P<line>\d+):(?:(?P<column>\d+):)?\s*"
    r"(?:(?P<severity>fatal error|error|warning|note):\s*)?(?P<message>.+)$"
)


@dataclass(frozen=True)
class Compiler:
    """A command that compiles C, and what it calls itself.

    Parameters
    ----------
    command : tuple of str
        The words that start it.
    version : str
        First line of ``--version``.
    json : bool
        Whether it gives diagnostics as JSON (gcc does).
    """

    command: tuple[str, ...]
    version: str
    json: bool

    def __str__(self) -> str:
        return f"{' '.join(self.command)} ({self.version})"


@dataclass(frozen=True)
class Message:
    """One diagnostic: severity "error" | "warning" | "note", file, line and column from 1 (0 where unknown)."""

    severity: str
    file: str
    line: int
    column: int
    message: str


@dataclass(frozen=True)
class Outcome:
    """How a run of the compiler ended."""

    ok: bool
    messages: tuple[Message, ...]


def _probe(command: tuple[str, ...]) -> Compiler | None:
    try:
        done = subprocess.run([*command, "--version"], capture_output=True, text=True, timeout=60, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    if done.returncode != 0:
        return None
    version = (done.stdout.strip() or "unknown version").splitlines()[0]
    gnu = "clang" not in done.stdout.lower() and ("gcc" in done.stdout.lower() or "free software" in done.stdout.lower())
    return Compiler(command, version, gnu)


def _candidates(cc: str | None) -> list[tuple[str, ...]]:
    found: list[tuple[str, ...]] = []
    if cc:
        found.append(tuple(shlex.split(cc)))
    found += [(path,) for name in ("cc", "gcc", "clang") if (path := shutil.which(name))]
    if importlib.util.find_spec("ziglang") is not None:
        found.append((sys.executable, "-m", "ziglang", "cc"))
    return found


@functools.lru_cache(maxsize=8)
def _search(cc: str | None, path: str) -> Compiler:
    for command in _candidates(cc):
        compiler = _probe(command)
        if compiler is not None:
            return compiler
        if cc and command == tuple(shlex.split(cc)):
            raise CompileFailed(f"$CC is {cc!r}, which does not run: correct it, or unset it to use cc, gcc or clang")
    raise CompileFailed(
        "no C compiler found: looked for $CC, cc, gcc, clang and the ziglang package. "
        "Install one (Debian: apt install gcc; without root: pip install 'zendsp[zig]')"
    )


def find_compiler() -> Compiler:
    """The compiler to use.

    Returns
    -------
    Compiler
        The first of ``$CC``, cc, gcc, clang, ziglang that runs.

    Raises
    ------
    CompileFailed
        None runs; the message says what to install.

    Examples
    --------
    >>> find_compiler().command[0] != ""
    True
    """
    return _search(os.environ.get("CC") or None, os.environ.get("PATH", ""))


def run_compiler(compiler: Compiler, arguments: Sequence[str], cwd: Path, timeout_s: float = 60.0) -> Outcome:
    """Run the compiler in a process of its own, with limits on time and on the size of its output.

    Parameters
    ----------
    compiler : Compiler
    arguments : sequence of str
    cwd : Path
        Where it runs; file names in its messages are relative to it.
    timeout_s : float
        Wall-clock and CPU limit, s.

    Returns
    -------
    Outcome
        Whether it succeeded, and its messages in the user's own files, lines and columns.
    """
    style = ["-fdiagnostics-format=json"] if compiler.json else ["-fno-color-diagnostics"]
    command = [*compiler.command, *style, *arguments]
    limits = [str(max(1, round(timeout_s))), str(_MAX_FILE_BLOCKS)]
    environment = {**os.environ, "LC_ALL": "C"}
    try:
        done = subprocess.run(
            ["/bin/sh", "-c", _LIMITS, "sh", *limits, *command],
            cwd=cwd, env=environment, capture_output=True, text=True, errors="replace", timeout=timeout_s, check=False,
            stdin=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        text = f"the compiler did not finish within {timeout_s:g} s and was stopped"
        return Outcome(False, (Message("error", "", 0, 0, text),))
    messages = parse_messages(done.stderr)
    if done.returncode != 0 and not any(m.severity == "error" for m in messages):
        text = done.stderr.strip()[-2000:] or f"the compiler ended with status {done.returncode}"
        messages = (*messages, Message("error", "", 0, 0, text))
    return Outcome(done.returncode == 0, messages)


def parse_messages(text: str) -> tuple[Message, ...]:
    """Diagnostics from a compiler's standard error: gcc's JSON, and the common ``file:line:column: severity: text``.

    Parameters
    ----------
    text : str

    Returns
    -------
    tuple of Message
        In the order given, repetitions left out.

    Examples
    --------
    >>> parse_messages("pd.c:3:5: error: expected ';'")
    (Message(severity='error', file='pd.c', line=3, column=5, message="expected ';'"),)
    """
    found: list[Message] = []
    decoder = json.JSONDecoder()
    for line in text.splitlines():
        if line.startswith("["):
            try:
                entries, _ = decoder.raw_decode(line)
            except json.JSONDecodeError:
                entries = None
            if isinstance(entries, list):
                found += [message for entry in entries if isinstance(entry, dict) for message in _from_json(entry)]
                continue
        match = _TEXT.match(line)
        if match and (match["severity"] or "undefined" in match["message"] or "multiple definition" in match["message"]):
            severity = (match["severity"] or "error").replace("fatal ", "")
            found.append(Message(severity, match["file"], int(match["line"]), int(match["column"] or 0), match["message"]))
    return tuple(dict.fromkeys(found))


def _from_json(entry: dict[str, object]) -> list[Message]:
    severity = str(entry.get("kind", "error")).replace("fatal ", "")
    locations = entry.get("locations")
    file, line, column = "", 0, 0
    if isinstance(locations, list) and locations and isinstance(locations[0], dict):
        caret = locations[0].get("caret")
        if isinstance(caret, dict):
            file, line, column = str(caret.get("file", "")), int(caret.get("line", 0)), int(caret.get("column", 0))
    option = entry.get("option")
    text = str(entry.get("message", "")) + (f" [{option}]" if option else "")
    messages = [Message(severity, file, line, column, text)]
    children = entry.get("children")
    if isinstance(children, list):
        for child in children:
            if isinstance(child, dict):
                messages += _from_json(child)
    return messages
