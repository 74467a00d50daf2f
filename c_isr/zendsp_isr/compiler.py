"""Find a C compiler, and run it within limits.

Order of the search: ``$CC``, then ``cc``, ``gcc``, ``clang``, then the ``ziglang`` package (extra
``zendsp[zig]``).
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import json
import math
import os
import select
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from zendsp_isr.messages import Message, between, parse_messages, without_between
from zendsp_protocol.errors import CompileFailed
from zendsp_protocol.states import Severity

_MAX_FILE = 256 << 20  # bytes of one file
_MAX_MEMORY = 2 << 30  # bytes of one process; the shipped programs take a tenth
_MAX_MEMORY_ZIG = 8 << 30  # it reserves more addresses than it uses
_MAX_OUTPUT = 4 << 20  # bytes of messages
_MAX_PROCESSES = 32  # of one compilation; gcc has three at a time, zig more
_MAX_MEMORY_ALL = 3 << 30  # bytes in memory of all of them
_MAX_FOLDER = 512 << 20  # bytes of all files
_LOOK_S = 0.1  # between looks at these three
_BUSY = 3.0  # times as long as it may compute: other work takes the rest
_WAITS_S = 1.0  # past its time, without wanting a processor or a disk: for a pipe, say
_MAX_MESSAGES = 200
_MAX_TEXT = 2000  # characters of one message
_ALONE = True  # nothing else is there, where the system allows namespaces
# what a compiler is made of; nothing else can be read while an upload is compiled
_TOOLCHAIN = (
    "/bin", "/lib", "/lib32", "/lib64", "/usr/bin", "/usr/include", "/usr/lib", "/usr/lib32",
    "/usr/lib64", "/usr/libexec", "/usr/local/bin", "/usr/local/include", "/usr/local/lib",
    "/etc/ld.so.cache", "/etc/alternatives", "/dev/urandom",
)

_PARTS = ("bin", "include", "lib", "lib32", "lib64", "libexec", f"{os.uname().machine[:3]}*-*-*")


@dataclass(frozen=True)
class Compiler:
    """A command that compiles C, with its version.

    Parameters
    ----------
    command : tuple of str
        The words that start it, the first a path.
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
class Outcome:
    """How a run of the compiler ended."""

    ok: bool
    messages: tuple[Message, ...]


def _probe(command: tuple[str, ...]) -> Compiler | None:
    try:
        done = subprocess.run(
            [*command, "--version"], capture_output=True, text=True, timeout=60, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    if done.returncode != 0:
        return None
    version = (done.stdout.strip() or "unknown version").splitlines()[0]
    gnu = "clang" not in done.stdout.lower() and (
        "gcc" in done.stdout.lower() or "free software" in done.stdout.lower()
    )
    return Compiler(command, version, gnu)


def _candidates(cc: str | None) -> list[tuple[str, ...]]:
    asked = tuple(shlex.split(cc or ""))
    package = importlib.util.find_spec("ziglang")
    zig = str(Path(package.origin).resolve().parent / "zig") if package and package.origin else ""
    if zig and "ziglang" in asked:  # python -m ziglang cc: without Python, which it does not need
        asked = (zig, *asked[asked.index("ziglang") + 1 :])
    found = [(os.path.abspath(shutil.which(asked[0]) or asked[0]), *asked[1:])] if asked else []
    found += [(path,) for name in ("cc", "gcc", "clang") if (path := shutil.which(name))]
    return [*found, (zig, "cc")] if zig else found


@functools.lru_cache(maxsize=8)
def _search(cc: str | None, path: str) -> Compiler:
    for command in _candidates(cc):
        compiler = _probe(command)
        if compiler is not None:
            return compiler
        if cc:
            raise CompileFailed(
                f"$CC is {cc!r}, which does not run: correct it, or unset it to use cc, gcc or"
                " clang"
            )
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


def run_compiler(
    compiler: Compiler,
    arguments: Sequence[str],
    cwd: Path,
    timeout_s: float = 60.0,
    readable: Sequence[Path] = (),
) -> Outcome:
    """Run the compiler in other processes, limited in time, memory, files and messages, and without
    access to other files.

    Parameters
    ----------
    cwd : Path
        Where it runs, and the only folder that it writes to; file names in its messages are
        relative to it.
    timeout_s : float
        Limit, s: of the time that has passed; where the computer is busy with other work, of the
        time it has computed, and of three times as much that has passed.
    readable : sequence of Path
        Folders of headers. It reads these, `cwd` and the toolchain; where the kernel has Landlock
        nothing else can be opened, and where it may have namespaces nothing else is there.

    Returns
    -------
    Outcome
        Whether it succeeded, and its messages in the user's own files, lines and columns.
    """
    style = ["-fdiagnostics-format=json"] if compiler.json else ["-fno-color-diagnostics"]
    allowed = [*_toolchain(compiler), *map(str, readable)]
    zig = _zig(compiler)
    settings = {
        "cpu_s": math.ceil(_BUSY * timeout_s),  # of each; all of them are watched
        "memory": _MAX_MEMORY if not zig else _MAX_MEMORY_ZIG,
        "file": _MAX_FILE,
        "read": allowed,
        "write": [str(cwd), "/dev/null", *zig.values()],
        "program": str(Path(compiler.command[0]).resolve()) if _ALONE else "",
    }
    script = Path(__file__).with_name("confine.py")
    launch = [sys.executable, "-I", "-S", str(script), json.dumps(settings)]
    # no file of the user's is found through the environment
    inherited = {key: os.environ[key] for key in ("PATH", "LD_LIBRARY_PATH") if key in os.environ}
    environment = {**inherited, "LC_ALL": "C", "TMPDIR": str(cwd), "HOME": str(cwd), **zig}
    command = [*launch, *compiler.command, *style, *arguments]
    ended = _run(command, cwd, environment, timeout_s)
    if ended.why:
        return Outcome(False, (Message(Severity.ERROR, "", 0, 0, ended.why),))
    reason = _reason(ended.text)  # of a limit: no word of the assembler's about it is needed
    said = tuple(m for m in parse_messages(ended.text) if not (reason and between(m)))
    inside = _inside({m.file for m in said}, cwd, [cwd, *map(Path, allowed)])
    messages = tuple(without_between(m) for m in said if m.file in inside)[:_MAX_MESSAGES]
    here = f"{cwd}/"  # of the linker's objects
    messages = tuple(replace(m, message=m.message.replace(here, "")[:_MAX_TEXT]) for m in messages)
    if ended.status != 0 and not any(m.severity == Severity.ERROR for m in messages):
        text = f"the compiler ended with status {ended.status}{reason}"
        messages = (*messages, Message(Severity.ERROR, "", 0, 0, text))
    return Outcome(ended.status == 0, messages)


@dataclass(frozen=True)
class _Ended:
    status: int
    text: str
    why: str = ""


_running: set[int] = set()  # sessions


def end_compilers() -> None:
    """End the compilers that run, for a process that ends without waiting for its threads."""
    for session in list(_running):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(session, signal.SIGKILL)


def _run(
    command: Sequence[str], cwd: Path, environment: Mapping[str, str], timeout_s: float
) -> _Ended:
    """Run the command to its end or to a limit; no process of its group is left."""
    text = bytearray()
    too_long = f"the compiler did not finish within {timeout_s:g} s and was stopped"
    began = time.monotonic()
    deadline = began + _BUSY * timeout_s
    look = time.monotonic() + _LOOK_S
    wanting = began  # a processor or a disk, the last time
    why = ""
    with subprocess.Popen(
        command, cwd=cwd, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, start_new_session=True,
    ) as process:
        assert process.stderr is not None
        _running.add(process.pid)
        try:
            while not why:
                ready = select.select([process.stderr], [], [], _LOOK_S)[0]
                now = time.monotonic()
                wanting = now if now < began + timeout_s or _wants(process.pid) else wanting
                if now > began + timeout_s and (
                    now > min(deadline, wanting + _WAITS_S) or _computed(process.pid) > timeout_s
                ):
                    why = too_long
                    break
                if time.monotonic() > look:
                    why = _too_much(process.pid, cwd)
                    look = time.monotonic() + _LOOK_S
                if not ready:
                    continue
                part = os.read(process.stderr.fileno(), 1 << 16)
                if not part:
                    break
                text += part
                if len(text) > _MAX_OUTPUT:
                    why = (
                        f"the compiler wrote more than {_MAX_OUTPUT >> 20} MB of messages and was"
                        " stopped"
                    )
            if not why:
                try:
                    process.wait(max(0.1, deadline - time.monotonic()))
                except subprocess.TimeoutExpired:
                    why = too_long
        finally:
            _running.discard(process.pid)
            # the leader is not yet waited for or just was: its group is still its own
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
    return _Ended(process.returncode, text.decode(errors="replace"), why)


def _of(session: int) -> list[list[str]]:
    """What /proc says of the processes of a session: the fields after the name."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, IndexError):
            fields = stat.read_text(errors="replace").rpartition(")")[2].split()
            if int(fields[3]) == session:
                found.append(fields)
    return found


def _wants(session: int) -> bool:
    """Whether a process of a session has a processor, or waits for one or for a disk."""
    return any(fields[0] in ("R", "D") for fields in _of(session))


def _computed(session: int) -> float:
    """CPU time of a session, s, including its processes that have ended."""
    ticks = sum(int(part) for fields in _of(session) for part in fields[11:15])
    return float(ticks) / os.sysconf("SC_CLK_TCK")


def _too_much(session: int, cwd: Path) -> str:
    """The limit of a compilation that is exceeded, in words; empty where none is."""
    of_session = _of(session)
    processes, pages = len(of_session), sum(int(fields[21]) for fields in of_session)
    size = 0
    for path in cwd.rglob("*"):
        with contextlib.suppress(OSError):
            size += path.lstat().st_blocks * 512
    if processes > _MAX_PROCESSES:
        return f"the compiler started more than {_MAX_PROCESSES} processes and was stopped"
    if pages * os.sysconf("SC_PAGE_SIZE") > _MAX_MEMORY_ALL:
        return f"the compiler took more than {_MAX_MEMORY_ALL >> 20} MB and was stopped"
    if size > _MAX_FOLDER:
        return f"the compiler wrote files of more than {_MAX_FOLDER >> 20} MB and was stopped"
    return ""


def _toolchain(compiler: Compiler) -> list[str]:
    program = Path(compiler.command[0])
    real = program.resolve()
    if str(real).startswith(("/usr/", "/bin/")):
        return list(_TOOLCHAIN)
    # a compiler unpacked elsewhere: its headers and libraries, not what else stands in ~
    base = real.parent.parent if real.parent.name == "bin" else real.parent
    own = [path for name in _PARTS for path in base.glob(name)]
    return [*_TOOLCHAIN, *map(str, [program, real, *own])]


def _zig(compiler: Compiler) -> dict[str, str]:
    """The environment for zig, which compiles its own libraries once and keeps them."""
    if Path(compiler.command[0]).resolve().name != "zig":
        return {}
    folder = Path(os.environ.get("ZIG_GLOBAL_CACHE_DIR") or Path.home() / ".cache" / "zig")
    folder.mkdir(parents=True, exist_ok=True)
    return {"ZIG_GLOBAL_CACHE_DIR": str(folder)}


def _inside(files: set[str], cwd: Path, folders: Sequence[Path]) -> set[str]:
    """The files that belong to the upload or the toolchain. A message about another file would show
    its contents.
    """
    real = [folder.resolve() for folder in folders]
    return {
        file
        for file in files
        if not file or any((cwd / file).resolve().is_relative_to(folder) for folder in real)
    }


def _reason(text: str) -> str:
    """Why the compilation failed, in our own words; the compiler's may quote a file that is not the
    user's.
    """
    if "out of memory" in text or "memory exhausted" in text or "std::bad_alloc" in text:
        return f": it needs more than the {_MAX_MEMORY >> 20} MB that a compilation may take"
    if "relocation truncated" in text:
        return ": its variables take more than 2 GB; declare less"
    if "File size limit" in text or "File too large" in text or "file truncated" in text:
        return f": its result exceeds {_MAX_FILE >> 20} MB; download data as a TABLE instead"
    return ""
