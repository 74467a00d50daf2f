"""Optional packages: imported where they are used, named with their pip line where missing."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from zendsp.errors import ZendspError


def need(module: str, extra: str, reason: str, error: type[ZendspError] = ZendspError) -> Any:
    """The imported module; where its package is missing, a refusal that names the extra.

    Parameters
    ----------
    module : str
        What to import.
    extra : str
        The extra of zendsp that installs it.
    reason : str
        What needs it, as the subject of the sentence.
    error : type of ZendspError
        What is raised.

    Examples
    --------
    >>> need("math", "frames", "this example").sqrt(4.0)
    2.0
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as missing:
        package = module.partition(".")[0]
        if (missing.name or "").partition(".")[0] != package:
            raise  # the package is there; something that it needs is not
        raise error(f"{reason} needs {package}: pip install 'zendsp[{extra}]'") from missing


def installed(module: str) -> bool:
    """Whether a module is there; it is not loaded.

    Examples
    --------
    >>> installed("math"), installed("no_such_module")
    (True, False)
    """
    try:
        return find_spec(module) is not None
    except (ModuleNotFoundError, ValueError):
        return False
