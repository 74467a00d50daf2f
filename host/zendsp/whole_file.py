"""Files that are written whole or not at all."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from zendsp.errors import RecordingError


def write_whole(path: Path, text: str) -> None:
    """Write a text file in UTF-8. An older one stays as it was until the new one is whole, also on
    a full disk.

    Raises
    ------
    OSError
        As of ``Path.write_text``.
    """
    place = path.resolve()  # a link stays one
    if place.exists() and not place.is_file():  # /dev/stdout
        place.write_text(text, encoding="utf-8")
        return
    part = place.with_name(f".{place.name}.{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8")
        if place.exists():
            shutil.copymode(place, part)
        os.replace(part, place)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """A block that writes a file. Where it fails no half of a new file stays, and the error names
    the file: the one of a full disk does not.

    Raises
    ------
    RecordingError
        It cannot be written.
    """
    there = path.exists()
    try:
        yield
    except OSError as error:
        if not there:
            with suppress(OSError):
                path.unlink(missing_ok=True)
        raise RecordingError(f"{path}: cannot be written ({error.strerror or error})") from error
