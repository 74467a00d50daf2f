"""Compile C into shared objects and programs, cached by content.

A result is named by a hash of everything that went into it: sources, headers, flags and the
compiler's version. The same content is never compiled twice, and changed content never meets an old
name (``dlopen`` of one path twice gives the old code).
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import importlib.resources
import json
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from zendsp_isr.compiler import Compiler, find_compiler, run_compiler
from zendsp_isr.messages import Message, where_it_lacks
from zendsp_protocol.errors import CompileFailed
from zendsp_protocol.states import Severity

# -g1: the line of a crash; more takes a third longer, and three times as long for 900 variables
_INCLUDED_C = re.compile(r'^[^\S\n]*#[^\S\n]*include[^\S\n]*"([^"\n]+\.c)"', re.MULTILINE)
BASE_FLAGS = ("-std=gnu11", "-O2", "-g1", "-ffp-contract=off", "-Wall", "-Wextra")
_KEPT = 1000  # compiled results of one kind
_ABANDONED_S = 3600.0
# -Bsymbolic: a program's own names are its own; without it, its `error` is the C library's
_SHARED = ("-shared", "-fPIC", "-Wl,-z,defs", "-Wl,-z,now", "-Wl,-Bsymbolic")


@dataclass(frozen=True)
class Built:
    """The result of a build: the file (None if it failed), its key, messages, duration in s, and
    whether it came from the cache.
    """

    path: Path | None
    key: str
    messages: tuple[Message, ...]
    seconds: float
    cached: bool
    compiler: str
    flags: tuple[str, ...]


def source_root() -> Path:
    """Folder of the C sources that ship with the package: include, runtime, machines, programs.

    Examples
    --------
    >>> (source_root() / "include" / "isr.h").exists()
    True
    """
    return Path(str(importlib.resources.files("zendsp_isr")))


def cache_root() -> Path:
    """Folder that keeps compiled code: ``$ZENDSP_CACHE``, else ``zendsp`` in the user's cache
    folder.

    Returns
    -------
    Path
        Exists.

    Raises
    ------
    CompileFailed
        Neither can be written, and what stands in its place is not this user's alone: what is kept
        there is run.
    """
    base = os.environ.get("ZENDSP_CACHE")
    try:
        root = (
            Path(base)
            if base
            else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "zendsp"
        )
        root.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # a home that cannot be written, or none at all
        root = Path(tempfile.gettempdir()) / f"zendsp-{os.getuid()}"
        root.mkdir(mode=0o700, exist_ok=True)
        found = root.lstat()  # a link has all rights
        if found.st_uid != os.getuid() or found.st_mode & 0o077:
            raise CompileFailed(
                f"compiled code is not kept in {root}, which others may write: set ZENDSP_CACHE to"
                " a folder of your own"
            ) from None
    return root


def _prune(folder: Path) -> None:
    """Remove what has not been used for longest, and what a killed compiler left behind."""
    results = sorted(
        (p for p in folder.iterdir() if p.suffix != ".json" and p.is_file()),
        key=lambda p: p.stat().st_mtime,
    )
    for path in results[: max(0, len(results) - _KEPT)]:
        path.unlink(missing_ok=True)
        path.with_suffix(".json").unlink(missing_ok=True)
    for path in folder.glob("build-*"):
        # by its age as well: one is not locked yet for a moment after it was made
        if time.time() - path.stat().st_mtime > _ABANDONED_S:
            with contextlib.suppress(BlockingIOError), _locked(path):
                shutil.rmtree(path, ignore_errors=True)


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Lock a folder, so that no other process takes it for abandoned; a clock may jump by years.

    Raises
    ------
    BlockingIOError
        Somebody works in it.
    """
    file = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(file)


def _headers(folders: Sequence[Path]) -> dict[str, bytes]:
    return {
        f"{folder.name}/{path.name}": path.read_bytes()
        for folder in folders
        for path in sorted(folder.glob("*.h"))
    }


def content_key(
    kind: str, sources: Mapping[str, bytes], headers: Mapping[str, bytes], words: Sequence[str]
) -> str:
    """The hash that names a build.

    Parameters
    ----------
    kind : str
    sources, headers : mapping of name to content
    words : sequence of str
        Flags, compiler, and whatever else decides the result.

    Returns
    -------
    str
        32 hexadecimal digits.
    """
    digest = hashlib.sha256(kind.encode())
    for part in (sources, headers):
        for name in sorted(part):
            digest.update(b"\0" + name.encode() + b"\0" + hashlib.sha256(part[name]).digest())
    for word in words:
        digest.update(b"\0" + word.encode())
    return digest.hexdigest()[:32]


def build(
    kind: str,
    sources: Mapping[str, bytes],
    include: Sequence[Path],
    *,
    flags: Sequence[str] = (),
    shared: bool = True,
    libraries: Sequence[str] = ("-lm",),
    timeout_s: float = 60.0,
) -> Built:
    """Compile sources into one shared object or program, or take it from the cache.

    Parameters
    ----------
    kind : str
        Folder of the cache, for example ``"program"``.
    sources : mapping of file name to content
        ``.c`` files are compiled; all are written where ``#include "name"`` finds them.
    include : sequence of Path
        Folders of headers.
    flags : sequence of str
        Added to `BASE_FLAGS`.
    shared : bool
        A shared object; otherwise an executable.
    libraries : sequence of str
    timeout_s : float
        Limit on the compiler, s.

    Returns
    -------
    Built
        ``path`` is None where the compiler found errors.

    Raises
    ------
    CompileFailed
        There is no compiler, or no place for what it makes.
    """
    began = time.monotonic()
    compiler = find_compiler()
    all_flags = (*BASE_FLAGS, *flags)
    wanted = (*all_flags, *(_SHARED if shared else ()))
    key = content_key(kind, sources, _headers(include), [*wanted, *libraries, str(compiler)])
    folder = cache_root() / kind
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / (key + (".so" if shared else ""))
    notes = folder / f"{key}.json"
    if target.exists() and notes.exists():
        os.utime(target)  # used: it is not what `_prune` takes first
        kept = json.loads(notes.read_text())
        messages = tuple(Message(Severity(e.pop("severity")), **e) for e in kept)
        return Built(
            target, key, messages, time.monotonic() - began, True, str(compiler), all_flags
        )
    with contextlib.suppress(OSError):  # another process may prune at the same time
        _prune(folder)
    try:
        ok, messages = _compile(compiler, sources, include, wanted, libraries, timeout_s, target)
    except OSError as error:
        raise CompileFailed(
            f"nothing can be compiled in {folder} ({error.strerror}): make room, or set"
            " ZENDSP_CACHE to another folder"
        ) from error
    return Built(
        target if ok else None, key, messages, time.monotonic() - began, False, str(compiler),
        all_flags,
    )


@contextlib.contextmanager
def _workplace(folder: Path) -> Iterator[Path]:
    """A folder for the duration of one compilation."""
    work = Path(tempfile.mkdtemp(prefix="build-", dir=folder))
    try:
        with _locked(work):
            yield work
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _included(sources: Mapping[str, bytes]) -> set[str]:
    """C files that another one includes; they are compiled as part of it."""
    return {
        found
        for name, text in sources.items()
        for include in _INCLUDED_C.findall(text.decode(errors="replace"))
        if (found := os.path.normpath(os.path.join(os.path.dirname(name), include))) != name
    }


def _compile(
    compiler: Compiler,
    sources: Mapping[str, bytes],
    include: Sequence[Path],
    flags: Sequence[str],
    libraries: Sequence[str],
    timeout_s: float,
    target: Path,
) -> tuple[bool, tuple[Message, ...]]:
    """Compile ``target`` and write its messages beside it; return whether it succeeded, and the
    messages.
    """
    with _workplace(target.parent) as work:
        for name, content in sources.items():
            (work / name).write_bytes(content)
        within = _included(sources)
        units = [name for name in sources if name.endswith(".c") and name not in within]
        output = work / "result"
        # the folder is gone afterwards: what the debugger and the linker say shall be the user's
        # own names
        own_names = f"-ffile-prefix-map={work}=."
        arguments = [*flags, own_names, "-I.", *(f"-I{folder}" for folder in include)]
        outcome = run_compiler(
            compiler, [*arguments, *units, "-o", str(output), *libraries], work, timeout_s, include
        )
        if outcome.ok and not output.is_file():
            text = "the compiler made no program: does a flag keep it from that?"
            return False, (*outcome.messages, Message(Severity.ERROR, "", 0, 0, text))
        if outcome.ok:
            # notes first: a target without notes would be compiled again, notes without a target do
            # no harm
            scratch = work / "notes"
            scratch.write_text(json.dumps([asdict(message) for message in outcome.messages]))
            os.replace(scratch, target.with_suffix(".json"))
            os.replace(output, target)
        return outcome.ok, tuple(where_it_lacks(m, sources) for m in outcome.messages)
