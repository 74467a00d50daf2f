"""NPZ: one array per channel, ``t``, and the metadata as JSON text."""

from __future__ import annotations

import math
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zendsp.errors import RecordingError
from zendsp.recording.formats.raw import Raw, check_room
from zendsp_protocol import written

if TYPE_CHECKING:
    from zendsp.recording.recording import Recording

KEY = "zendsp"
ZIP, NPY = (b"PK\3\4", b"PK\5\6"), b"\x93NUMPY"  # how an archive and a single array begin


def write(recording: Recording, metadata: str, path: Path) -> None:
    """Write ``recording``."""
    arrays = {"t": recording.t, **recording.signals}
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays, **{KEY: np.array(metadata)})


def read(path: Path) -> Raw:
    """Read any NPZ of numeric arrays. Pickled objects are refused, since loading them could run
    code.
    """
    columns, constants, refused = {}, {}, {}
    metadata = ""
    try:
        _check_archive(path)
        with np.load(path, allow_pickle=False) as archive:
            check_room(path, sum(_size(archive, name) for name in archive.files))
            for name in archive.files:
                try:
                    values = archive[name]
                except ValueError:  # NumPy would advise to allow them
                    refused[name] = "is not a plain numeric array, but a pickle"
                    continue
                if name == KEY and values.dtype.kind == "U":
                    metadata = str(values[()])
                elif values.dtype.kind not in "fiub":
                    refused[name] = f"holds {values.dtype}, not real numbers"
                elif values.size == 1:
                    constants[name] = float(values.reshape(-1)[0])
                elif values.ndim > 2:
                    refused[name] = f"has {values.ndim} dimensions; at most 2 can be columns"
                else:
                    columns[name] = values.astype(np.float64)
    except RecordingError:
        raise
    except (
        zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, NotImplementedError,
    ) as error:
        raise RecordingError(
            f"{path}: is not a readable NPZ file, or it is cut short ({error})"
        ) from error
    return Raw(columns, _units(metadata), constants, metadata, refused)


def _check_archive(path: Path) -> None:
    """Refuse what is none: NumPy takes it for a pickle, and says how to load that unsafely."""
    with path.open("rb") as file:
        begin = file.read(len(NPY))
    if begin == NPY:
        raise RecordingError(f"{path}: is a single array; save several, each with its name, in NPZ")
    if not begin.startswith(ZIP):
        raise zipfile.BadZipFile("it does not begin as an archive of arrays does")


def _size(archive: Any, name: str) -> int:
    """Bytes of an array by its header, known before anything is read."""
    headers: Any = np.lib.format
    with archive.zip.open(f"{name}.npy") as member:
        old = headers.read_magic(member) == (1, 0)
        read_header = headers.read_array_header_1_0 if old else headers.read_array_header_2_0
        shape, _, dtype = read_header(member)
    return int(dtype.itemsize * math.prod(shape))


def _units(metadata: str) -> dict[str, str]:
    """Units of the channels of a recording of zendsp; none for other files."""
    try:
        channels = written.json(metadata)["channels"]
        return {"t": "s", **{str(c["name"]): str(c["unit"]) for c in channels}}
    except (ValueError, KeyError, TypeError):
        return {}
