"""A table for values that change often.

Textual's DataTable renders every visible cell when one changes (80 ms a screen); this one paints
only the rows that changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from rich.segment import Segment
from rich.style import Style
from rich.text import Text
from textual import events
from textual.binding import Binding, BindingType
from textual.geometry import Region, Size
from textual.message import Message
from textual.scroll_view import ScrollView
from textual.strip import Strip
from textual.widgets import DataTable
from textual.widgets.data_table import RowKey


@dataclass(frozen=True)
class Column:
    """A heading, and the largest width of the column."""

    title: str
    width: int = 0  # 0: as wide as the widest cell, at most `most`
    most: int = 40
    right: bool = False


def mark_cuts(strip: Strip, left: bool, right: bool) -> Strip:
    """The line, with "…" where its visible part is cut within a word or a number."""
    text, width = strip.text, strip.cell_length
    if right and width > 1 and text[-1:] != " ":
        strip = Strip([*strip.crop(0, width - 1), Segment("…", Style(dim=True))], width)
    if left and width > 1 and text[:1] != " ":
        strip = Strip([Segment("…", Style(dim=True)), *strip.crop(1, width)], width)
    return strip


class ListTable(DataTable[Text]):
    """A DataTable that marks what its edges cut: the visible "0.00" of "0.00407" would be another
    number.
    """

    def add_row(self, *cells: Text, **options: Any) -> RowKey:
        """Add a row and widen the columns for it at once: Textual does so only when idle, after the
        next picture.
        """
        for column, cell in zip(self.ordered_columns, cells, strict=False):
            column.content_width = max(column.content_width, cell.cell_len)
        return super().add_row(*cells, **options)

    def render_line(self, y: int) -> Strip:
        strip, end = super().render_line(y), 0
        x, pad = self.scroll_offset.x, self.cell_padding
        width = self.scrollable_content_region.width  # the rest is under the scroll bar
        left = right = False
        for column in self.ordered_columns:
            begin, end = end, end + column.get_render_width(self)
            left |= begin + pad < x < end - pad
            right |= begin + pad < x + width < end - pad
        return mark_cuts(strip.crop(0, width), left, right)


Cell = tuple[str, Style]
HEADING = Style(bold=True, dim=True, underline=True)


class LiveTable(ScrollView, can_focus=True):
    """Rows of styled text with a cursor, below a heading that does not scroll."""

    DEFAULT_CSS = """
    LiveTable { height: 1fr; scrollbar-size-horizontal: 0; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "cursor(-1)", show=False),
        Binding("down", "cursor(1)", show=False),
        Binding("pageup", "page(-1)", show=False),
        Binding("pagedown", "page(1)", show=False),
        Binding("home", "cursor(-100000)", show=False),
        Binding("end", "cursor(100000)", show=False),
        Binding("left", "sideways(-8)", show=False),
        Binding("right", "sideways(8)", show=False),
    ]

    class Chosen(Message):
        """The row under the cursor was clicked twice."""

    def __init__(self, columns: Sequence[Column], *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._columns = tuple(columns)
        self._widths = [c.width or len(c.title) for c in columns]
        self._keys: list[str] = []
        self._cells: list[tuple[Cell, ...]] = []
        self._cursor = 0
        self._back: Style | None = None

    # -- content

    @property
    def row_count(self) -> int:
        """Number of rows."""
        return len(self._keys)

    @property
    def marked(self) -> str:
        """Key of the row under the cursor, "" where there is none."""
        return self._keys[self._cursor] if self._keys else ""

    def set_rows(self, rows: Sequence[tuple[str, tuple[Cell, ...]]]) -> None:
        """Show other rows; the cursor keeps its key where that is still there."""
        at = self.marked
        self._keys = [key for key, _ in rows]
        self._cells = [cells for _, cells in rows]
        for k, column in enumerate(self._columns):
            if not column.width:
                widest = max((len(cells[k][0]) for cells in self._cells), default=0)
                self._widths[k] = min(max(widest, len(column.title)), column.most)
        self._cursor = self._keys.index(at) if at in self._keys else 0
        self.virtual_size = Size(sum(self._widths) + len(self._widths), len(rows) + 1)
        self.refresh()

    def set_row(self, key: str, cells: tuple[Cell, ...]) -> None:
        """Change one row."""
        row = self._keys.index(key)
        if self._cells[row] != cells:
            self._cells[row] = cells
            self._paint(row)

    def _paint(self, row: int) -> None:
        y = row + 1 - self.scroll_offset.y
        if 0 < y < self.size.height:
            self.refresh(Region(0, y, self.size.width, 1))

    # -- cursor

    def mark(self, key: str) -> None:
        """Put the cursor on a row."""
        self._go(self._keys.index(key))

    def _go(self, row: int) -> None:
        if not self._keys:
            return
        before, self._cursor = self._cursor, min(max(row, 0), len(self._keys) - 1)
        top, height = self.scroll_offset.y, max(self.size.height - 1, 1)
        if self._cursor < top:
            self.scroll_to(y=self._cursor, animate=False)
        elif self._cursor >= top + height:
            self.scroll_to(y=self._cursor - height + 1, animate=False)
        self._paint(before)
        self._paint(self._cursor)

    def action_cursor(self, rows: int) -> None:
        """Move the cursor."""
        self._go(self._cursor + rows)

    def action_page(self, pages: int) -> None:
        """Move the cursor by as many rows as are visible."""
        self._go(self._cursor + pages * max(self.size.height - 2, 1))

    def action_sideways(self, columns: int) -> None:
        """Scroll to the right or left."""
        self.scroll_to(x=self.scroll_offset.x + columns, animate=False)

    def on_click(self, event: events.Click) -> None:
        """One click marks, two choose."""
        row = event.y - 1 + self.scroll_offset.y
        if event.y > 0 and 0 <= row < len(self._keys):
            self._go(row)
            if event.chain == 2:
                self.post_message(self.Chosen())

    def on_focus(self) -> None:
        """Paint the cursor, which shows the focus."""
        self._paint(self._cursor)

    def on_blur(self) -> None:
        """Paint the cursor, which shows the focus."""
        self._paint(self._cursor)

    # -- painting

    def notify_style_update(self) -> None:
        """Paint again in the background of another theme."""
        self._back = None
        super().notify_style_update()

    def render_line(self, y: int) -> Strip:
        width = self.scrollable_content_region.width  # the rest is under the scroll bar
        x = self.scroll_offset.x
        if self._back is None:
            self._back = Style(bgcolor=self.rich_style.bgcolor)
        back = self._back
        row = y - 1 + self.scroll_offset.y
        if y == 0:
            cells: tuple[Cell, ...] = tuple((c.title, HEADING) for c in self._columns)
        elif row < len(self._cells):
            cells = self._cells[row]
        else:
            return Strip.blank(width, back)
        if y and row == self._cursor:
            theme = self.app.theme_variables
            colour = theme["primary"] if self.has_focus else theme["border"]
            ink = theme["background"] if self.has_focus else theme["foreground"]
            strong = Style(bgcolor=colour, color=ink, dim=False)
            cells = (
                (cells[0][0], cells[0][1]),
                *((text, style + strong) for text, style in cells[1:]),
            )
            back = Style(bgcolor=colour)
        parts = []
        for (text, style), wide, column in zip(cells, self._widths, self._columns, strict=True):
            short = (
                text if len(text) <= wide else text[: wide - 1] + "…"
            )  # a number cut in silence would be another number
            shown = short.rjust(wide) if column.right else short.ljust(wide)
            parts.append(Segment(shown + " ", back + style))
        full = sum(self._widths) + len(self._widths)
        strip = Strip(parts, full).adjust_cell_length(max(x + width, full), back)
        text = strip.text
        return mark_cuts(
            strip.crop(x, x + width),
            x > 0 and text[x - 1] != " ",
            len(text) > x + width and text[x + width] != " ",
        )
