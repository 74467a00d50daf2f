"""Compile what the host sends: in processes of its own, within limits, with messages in the user's
file, line and column.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from elftools.common.exceptions import ELFError
from elftools.elf.constants import P_FLAGS
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection

from zendsp_isr.build import Built, build, cache_root, source_root
from zendsp_protocol.errors import Refused
from zendsp_protocol.messages import CompileResult, Diagnostic
from zendsp_protocol.states import Severity

_NAME = re.compile(r"^[A-Za-z0-9_][A-Za-z0-9_.+-]*\.[ch]$")
_FLAG = re.compile(
    r"^-(O[0-3sg]?|O?fast|g\d?|W(?!l,|p,|a,)[A-Za-z0-9=_-]+|[DU][A-Za-z_]\w*(=.*)?|std=[a-z0-9]+|m[a-z0-9=.+-]+|f(?!plugin|dump|profile)[a-z0-9=-]+)$"
)
_MAX_SOURCE_BYTES = 16_000_000

_NEEDED = ("zendsp_isr_abi", "UserInit", "UserISR_INT2")


def check_sources(sources: Mapping[str, str], flags: Sequence[str]) -> None:
    """Refuse file names and compiler flags that reach outside the program.

    Parameters
    ----------
    sources : mapping of file name to text
    flags : sequence of str

    Raises
    ------
    Refused
        No source, a name that is not a plain ``.c`` or ``.h``, a flag other than optimisation,
        warnings, definitions, ``-f…``, ``-m…``.
    """
    if not any(name.endswith(".c") for name in sources):
        names = ", ".join(sources) or "no file"
        raise Refused(f"nothing to compile in {names}: the name of a C program ends in .c")
    for name in sources:
        if not _NAME.match(name):
            raise Refused(
                f"source name {name!r}: a name has letters a–z, digits, _ . + and -, ends in .c or"
                " .h, and has no folders; rename the file"
            )
    if sum(len(text) for text in sources.values()) > _MAX_SOURCE_BYTES:
        raise Refused(
            f"the sources exceed {_MAX_SOURCE_BYTES} bytes: download data as a TABLE instead"
        )
    for flag in flags:
        if not _FLAG.match(flag):
            raise Refused(
                f"compiler flag {flag!r} is not accepted: use -O…, -g, -W…, -D…, -U…, -std=…, -f…"
                " or -m…"
            )


_NO_HEADER = 'the program does not include "isr.h": begin it with #include "isr.h"'


def _load_problem(path: Path) -> str:
    """Why the compiled program could not be loaded, in a sentence; "" where it could. The file is
    read but not loaded: loading it would run its constructors here.
    """
    try:
        with path.open("rb") as file:
            symbols = ELFFile(file).get_section_by_name(".dynsym")
            if not isinstance(symbols, SymbolTableSection):
                return "the compiler made a shared object without symbols"
            found = {s.name for s in symbols.iter_symbols() if s["st_shndx"] != "SHN_UNDEF"}
    except (ELFError, OSError, ValueError) as error:
        return f"the compiler made no shared object that can be read: {error}"
    missing = [name for name in _NEEDED if name not in found]
    if "zendsp_isr_abi" in missing:
        return _NO_HEADER
    if missing:
        return (
            f"the program lacks {' and '.join(missing)}: see template.c for the sections of a"
            " program"
        )
    return ""


def compile_program(
    sources: Mapping[str, str], flags: Sequence[str] = (), timeout_s: float = 30.0
) -> CompileResult:
    """Compile a program, or take it from the cache, and return the result with the compiler's
    messages.

    Parameters
    ----------
    sources : mapping of file name to text
        All ``.c`` files are compiled together; ``.h`` files are found by ``#include "name"``.
    flags : sequence of str
    timeout_s : float
        Limit on the compiler, s. Nothing of the program runs.

    Returns
    -------
    CompileResult
        With ``ok`` False and the errors where the code does not compile: that is a result, not an
        exception.

    Raises
    ------
    Refused
        See `check_sources`.
    CompileFailed
        There is no C compiler.
    """
    check_sources(sources, flags)
    encoded = {name: text.encode() for name, text in sources.items()}
    built = build(
        "program", encoded, [source_root() / "include"], flags=tuple(flags), timeout_s=timeout_s
    )
    diagnostics = [
        Diagnostic(m.severity, _own(m.file), m.line, m.column, m.message) for m in built.messages
    ]
    ok = built.path is not None
    first = next(name for name in sources if name.endswith(".c"))
    if not ok and not any("isr.h" in text for text in sources.values()):
        # of what the compiler says the most follows from this; the rest it says again
        diagnostics = [Diagnostic(Severity.ERROR, first, 1, 0, _NO_HEADER)]
    if built.path is not None and not built.cached:
        problem = _load_problem(built.path)
        if problem:
            ok = False
            built.path.unlink(missing_ok=True)
            diagnostics.append(Diagnostic(Severity.ERROR, first, 0, 0, problem))
    return _result(built, ok, diagnostics)


def _own(file: str) -> str:
    """The user's name of a file. The compiler runs in the folder of the sources, so their names are
    plain or begin with ``./``.
    """
    return os.path.normpath(file) if file else ""


def _result(built: Built, ok: bool, diagnostics: list[Diagnostic]) -> CompileResult:
    return CompileResult(
        ok, built.key, tuple(diagnostics), built.seconds, built.cached, built.compiler, built.flags
    )


def check_memory(program: Path, allowed_mb: float) -> None:
    """Refuse a program whose own variables take more memory than user code may. The kernel maps
    them without counting them against the limit of the process.

    Raises
    ------
    Refused
        They take more.
    """
    with program.open("rb") as file:
        segments = [s.header for s in ELFFile(file).iter_segments("PT_LOAD")]
    size_mb = sum(s["p_memsz"] for s in segments if s["p_flags"] & P_FLAGS.PF_W) / 1e6
    if size_mb > allowed_mb:
        raise Refused(
            f"the program's own variables take {size_mb:.0f} MB, and user code may take"
            f" {allowed_mb:g} MB here: declare less, or give the target more (--memory)"
        )


def program_path(key: str) -> Path:
    """File of a compiled program.

    Parameters
    ----------
    key : str
        From `compile_program`.

    Raises
    ------
    Refused
        Nothing was compiled under this key.
    """
    path = cache_root() / "program" / f"{key}.so"
    if not re.fullmatch(r"[0-9a-f]{32}", key) or not path.is_file():
        raise Refused(f"no program with key {key!r} on this target: compile it first")
    return path
