"""Styles that are parsed once: the same text with the same colours gives the same rules."""

from __future__ import annotations

from textual.cache import LRUCache
from textual.css.stylesheet import Stylesheet

TEXTS = 4096  # more than all widgets have


class OnceParsed(Stylesheet):
    """Textual's own parses the styles of all widgets again for each screen that is built: a second
    and a half of the processor until all four are there.
    """

    def __init__(self, *, variables: dict[str, str]) -> None:
        super().__init__(variables=variables)
        self._parse_cache = LRUCache(TEXTS)

    def set_variables(self, variables: dict[str, str]) -> None:
        """Take other colours, and forget what was parsed with those before."""
        if variables != self._variables:
            super().set_variables(variables)

    def reparse(self) -> None:
        """Parse what has been added, or everything where the colours are others."""
        self.parse()
