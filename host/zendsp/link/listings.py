"""Lists that a target returns, its variables and its log, readable at a prompt and in a notebook.
"""

from __future__ import annotations

import math

from zendsp_protocol import messages as m
from zendsp_protocol.states import VariableKind
from zendsp_protocol.views import html_table, short, text_table


class Listing:
    """Shows itself as a table, at a prompt and in a notebook."""

    header: tuple[str, ...]

    def rows(self) -> list[tuple[str, ...]]:
        """The rows of the table, one for each entry."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return text_table(self.header, self.rows()) if self else "none"

    def _repr_html_(self) -> str:
        return html_table([name.lower() for name in self.header], self.rows())


class Dictionary(Listing, dict[str, m.VariableInfo]):
    """The variables by name."""

    header = ("VARIABLE", "TYPE", "KIND", "UNIT", "MIN", "MAX", "")

    def rows(self) -> list[tuple[str, ...]]:
        """Name, type with its size, kind, unit, limits, description."""
        return [
            (v.name, v.type + _sizes(v), v.kind, v.unit, _limit(v.minimum), _limit(v.maximum),
             v.description)
            for v in self.values()
        ]  # fmt: skip


class Log(Listing, tuple[m.Change, ...]):
    """The changes of parameters, oldest first."""

    header = ("SAMPLE", "PARAMETER", "OLD", "NEW", "BY")

    def rows(self) -> list[tuple[str, ...]]:
        """Sample, name, value before and after, author."""
        return [(str(c.tick), c.name, short(c.old), short(c.new), c.author) for c in self]


def _limit(value: float) -> str:
    return short(value if math.isfinite(value) else None)


def _sizes(v: m.VariableInfo) -> str:
    if v.columns > 1 and v.kind != VariableKind.TABLE:
        return f"[{v.length // v.columns}][{v.columns}]"
    return f"[{v.length}]" if v.length > 1 else ""
