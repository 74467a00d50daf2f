"""Reads a file in a process of its own, for libraries whose native code a damaged file brings down.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path

import numpy as np

from zendsp.errors import RecordingError
from zendsp.recording.formats.raw import Raw

REFUSED = 3  # exit status: what was said is for the user


def read_apart(module: str, path: Path) -> Raw:
    """What ``module.parse(path)`` returns, in a process that may die.

    Raises
    ------
    RecordingError
        What the reader says; or that the file broke it.
    """
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder, "raw.npz")
        command = [sys.executable, "-m", __name__, module, str(path), str(result)]
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", check=False
        )
        if done.returncode == REFUSED:
            raise RecordingError(done.stderr.strip().partition("\0")[2])
        if done.returncode < 0:
            raise ValueError(f"its reader ended on {signal.Signals(-done.returncode).name}")
        if done.returncode or not result.exists():
            raise ValueError(
                (done.stderr.strip().splitlines() or ["its reader ended without a word"])[-1]
            )
        with np.load(result, allow_pickle=False) as stored:
            about = json.loads(str(stored["about"]))
            columns = {name: stored[f"c{k}"] for k, name in enumerate(about["names"])}
    return Raw(
        columns,
        about["units"],
        about["constants"],
        about["circumstances"],
        about["refused"],
        tuple(about["notes"]),
    )


def _main(module: str, path: str, result: str) -> int:
    try:
        raw: Raw = import_module(module).parse(Path(path))
    except RecordingError as error:
        sys.stderr.write(f"\0{error}")
        return REFUSED
    about = {
        "names": list(raw.columns),
        "units": raw.units,
        "constants": raw.constants,
        "circumstances": raw.circumstances,
        "refused": raw.refused,
        "notes": raw.notes,
    }
    arrays = {f"c{k}": values for k, values in enumerate(raw.columns.values())}
    np.savez(result, allow_pickle=False, about=np.array(json.dumps(about)), **arrays)
    return 0


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
