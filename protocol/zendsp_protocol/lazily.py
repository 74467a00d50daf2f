"""Modules that are imported when they are first used, so that a command that needs no array does
not wait for NumPy.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any


class Lazily:
    """Stands for a module until one of its attributes is asked for.

    Parameters
    ----------
    module : str
        Its name.

    Examples
    --------
    >>> math = Lazily("math")
    >>> math.sqrt(4.0)
    2.0
    """

    def __init__(self, module: str) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        value = getattr(import_module(self._module), name)
        setattr(self, name, value)  # the next time it is an attribute like any other
        return value
