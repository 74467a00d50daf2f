"""How a handler says that it would have to wait."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class Later(Exception):
    """Raised by a handler that would wait: the rest is to be run by another thread."""

    def __init__(self, rest: Callable[[], Any]) -> None:
        self.rest = rest
