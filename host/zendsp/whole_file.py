"""Text files that are written whole or not at all."""

import os
import shutil
from contextlib import suppress
from pathlib import Path


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
