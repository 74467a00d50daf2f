"""Where the model files are that come with zendsp."""

from __future__ import annotations

from pathlib import Path


def model_folder() -> Path:
    """Folder of the given models: within the installed package, else ``examples/models`` of the
    source tree.

    Raises
    ------
    FileNotFoundError
        This is neither an installed wheel nor the source tree.
    """
    here = Path(__file__).resolve()
    places = (here.parents[1] / "examples" / "models", here.parents[3] / "examples" / "models")
    for folder in places:
        if folder.exists():
            return folder
    raise FileNotFoundError(
        f"no example models in {' or '.join(map(str, places))}: install zendsp again"
    )
