"""Parses the styles once for all screens."""

from __future__ import annotations

from textual.cache import LRUCache
from textual.css.stylesheet import Stylesheet

TEXTS = 4096  # more than all widgets have


class OnceParsed(Stylesheet):
    """A stylesheet that keeps what it has parsed. Textual's own parses the styles of all widgets
    again for each screen: one and a half seconds of processor time for the four.
    """

    def __init__(self, *, variables: dict[str, str]) -> None:
        super().__init__(variables=variables)
        self._parse_cache = LRUCache(TEXTS)

    def set_variables(self, variables: dict[str, str]) -> None:
        """Use other colours, and drop what was parsed with those before."""
        if variables != self._variables:
            super().set_variables(variables)

    def reparse(self) -> None:
        """Parse what was added, or everything where the colours have changed."""
        self.parse()
