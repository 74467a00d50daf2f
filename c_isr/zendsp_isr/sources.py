"""Finds control programs: all commands and functions turn a name into sources by this module."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from zendsp_isr.build import source_root
from zendsp_protocol.errors import CompileFailed

_INCLUDE = re.compile(r'^[^\S\n]*#[^\S\n]*include[^\S\n]*"([^"\n]+)"', re.MULTILINE)
Source = str | Path | Mapping[str, str]


def shipped_programs() -> list[Path]:
    """Return the programs that come with zendsp, sorted.

    Examples
    --------
    >>> "pd.c" in [path.name for path in shipped_programs()]
    True
    """
    return sorted((source_root() / "programs").glob("*.c"))


def find_program(name: str | Path) -> Path:
    """The file that a name means: a path, or else the shipped program of that name.

    Returns
    -------
    Path
        Of a file that exists.

    Raises
    ------
    CompileFailed
        There is neither, and the message lists the shipped programs; or a folder.

    Examples
    --------
    >>> find_program("pd.c").is_file()
    True
    """
    if Path(name).is_dir():
        inside = ", ".join(str(path) for path in sorted(Path(name).glob("*.c")))
        raise CompileFailed(
            f"{name}: is a folder; name the program in it"
            + (f": {inside}" if inside else ", where no C file is now")
        )
    shipped = shipped_programs()
    found = found_or_shipped(name, shipped)
    if found is None:
        raise CompileFailed(
            f"{name}: cannot be read: no such file, and no shipped program; give the path of a C"
            f" file, or one of {', '.join(program.name for program in shipped)}"
        )
    return found


def found_or_shipped(name: str | Path, shipped: Iterable[Path]) -> Path | None:
    """The file of that path, or else the shipped one of that bare name; None without either."""
    path = Path(name)
    if path.is_file():
        return path
    return next((each for each in shipped if each.name == str(name)), None)


def gather(source: Source) -> dict[str, str]:
    """The sources of a program and of the headers beside it, by file name. A shipped header that is
    not beside it (``motion.h``) comes along too.

    Parameters
    ----------
    source : path, or mapping of file name to text
        A path as in :func:`find_program`; to a mapping only shipped headers are added.

    Raises
    ------
    CompileFailed
        The file does not exist or is no text.

    Examples
    --------
    >>> list(gather("pd.c"))
    ['pd.c']
    """
    if isinstance(source, Mapping):
        lacking = {n for text in source.values() for n in _INCLUDE.findall(text)} - set(source)
        headers = {name: _shipped_header(name) for name in sorted(lacking)}
        return {**source, **{n: h.read_text(encoding="utf-8") for n, h in headers.items() if h}}
    if "\n" in str(source):
        raise CompileFailed(
            'the text of a program where a path is expected: give {"mine.c": text}, by its name'
        )
    path = find_program(source)
    sources: dict[str, str] = {}
    waiting = [path]
    while waiting:
        file = waiting.pop()
        text = _text_of(file)
        sources[file.relative_to(path.parent).as_posix()] = text
        for name in _INCLUDE.findall(text):
            header = file.parent / name
            known = (
                header.relative_to(path.parent).as_posix()
                if header.is_relative_to(path.parent)
                else ""
            )
            if known and known not in sources and header.is_file():
                waiting.append(header)
            elif known == name and known not in sources and (shipped := _shipped_header(name)):
                sources[known] = shipped.read_text(encoding="utf-8")
    return sources


def _text_of(file: Path) -> str:
    """The text of a source file, refused where it is none."""
    try:
        read = file.read_bytes()
        return read.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except OSError as error:
        raise CompileFailed(
            f"{file}: cannot be read ({error}); give a C file or {{name: text}}"
        ) from error
    except UnicodeDecodeError as error:
        line = read.count(b"\n", 0, error.start) + 1
        if b"\0" in read:
            raise CompileFailed(
                f"{file}: is no UTF-8 text: give a C file, saved as UTF-8"
            ) from error
        raise CompileFailed(
            f"{file}: line {line}: the byte 0x{read[error.start]:02x} is no UTF-8 text: save the"
            " file as UTF-8, with an editor or by 'iconv -f WINDOWS-1252 -t UTF-8'"
        ) from error


def _shipped_header(name: str) -> Path | None:
    """The header of that bare name that comes with the shipped programs."""
    folder = source_root() / "programs"
    return next((each for each in folder.glob("*.h") if each.name == name), None)
