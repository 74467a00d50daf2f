"""Finds the model files that come with zendsp."""

from __future__ import annotations

from pathlib import Path

from zendsp.errors import ModelError
from zendsp_isr.sources import found_or_shipped


def model_folder() -> Path:
    """Folder of the given models: within the installed package, else ``examples/models`` of the
    source tree.

    Raises
    ------
    FileNotFoundError
        This is neither an installed wheel nor the source tree.
    """
    here = Path(__file__).resolve()
    places = (here.parents[2] / "examples" / "models", here.parents[4] / "examples" / "models")
    for folder in places:
        if folder.exists():
            return folder
    raise FileNotFoundError(
        f"no example models in {' or '.join(map(str, places))}: install zendsp again"
    )


def find_model(name: str | Path) -> Path:
    """Return the path of a model file, or of the one of this name that comes with zendsp.

    Parameters
    ----------
    name : path
        A file, or the name of one that is shipped: ``imi_planar.toml``.

    Raises
    ------
    ModelError
        There is neither; the message lists what is shipped.

    Examples
    --------
    >>> find_model("imi_planar.toml").is_file()
    True
    """
    shipped = sorted(model_folder().glob("*.toml"))
    found = found_or_shipped(Path(name).expanduser(), shipped)
    if found is None:
        raise ModelError(
            f"{name}: cannot be read: no such file, and no shipped model; give the path of a model"
            f" file, or one of {', '.join(each.name for each in shipped)}; 'zendsp model new'"
            " begins one"
        )
    return found
