"""The table of variables: value, unit, limits, initial value, and marks for what is plotted, staged or changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.style import Style
from rich.text import Text
from textual import on
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.widgets import DataTable, Input
from textual.widgets.data_table import CellDoesNotExist

from zendsp.tui.colours import trace_colours
from zendsp.tui.panels.values import differs, show_limits, show_value
from zendsp.tui.snapshot import Snapshot, Variable

COLUMNS = ("", "name", "value", "unit", "limits", "initial", "description")
WIDTHS = {"": 3, "value": 14}  # fixed: a value that changes its length must not make the table jump


class VariablesPanel(Vertical):
    """Filter line above the table."""

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._rows: dict[str, tuple[str, ...]] = {}  # what each row shows now
        self._shown: tuple[Variable, ...] = ()
        self._words = ""
        self.border_title = "Variables"

    def compose(self) -> ComposeResult:
        yield Input(placeholder="filter: part of a name, unit or description", id="filter", compact=True)
        table: DataTable[Text] = DataTable(id="variables", cursor_type="row", cell_padding=1, zebra_stripes=False)
        for name in COLUMNS:
            table.add_column(Text(name), key=name, width=WIDTHS.get(name))
        yield table

    @property
    def table(self) -> DataTable[Text]:
        """The table itself."""
        return self.query_one("#variables", DataTable)

    @property
    def marked(self) -> str:
        """Name of the variable under the cursor, "" in an empty table."""
        try:
            return str(self.table.coordinate_to_cell_key(self.table.cursor_coordinate).row_key.value or "")
        except CellDoesNotExist:
            return ""

    def open_filter(self) -> None:
        """Show the filter line and type into it."""
        line = self.query_one("#filter", Input)
        line.add_class("-shown")
        line.focus()

    @on(Input.Changed, "#filter")
    def _filter(self, event: Input.Changed) -> None:
        self._words = event.value.lower()
        self._shown = ()  # refill at the next snapshot

    @on(Input.Submitted, "#filter")
    def _filtered(self) -> None:
        if not self._words:
            self.query_one("#filter", Input).remove_class("-shown")
        self.table.focus()

    def show(self, snapshot: Snapshot, staged: Mapping[str, Any], plotted: Sequence[str]) -> None:
        """Bring the table up to date; only cells that differ are touched."""
        wanted = tuple(v for v in snapshot.variables if self._words in f"{v.name} {v.unit} {v.description}".lower())
        if [v.name for v in wanted] != [v.name for v in self._shown] or not self._rows:
            self._refill(wanted)
        colours = trace_colours(self.app.current_theme).traces
        theme = self.app.theme_variables
        for v in wanted:
            value = snapshot.values.get(v.name)
            curves = [k for k, name in enumerate(plotted) if name == v.name or name.startswith(f"{v.name}[")]
            changed = v.kind == "parameter" and value is not None and differs(value, v.initial)
            mark = "→" if v.name in staged else "*" if changed else " "
            text = show_value(staged.get(v.name, value), 2)
            now = (str(curves), mark, text, v.unit, theme["accent"])
            if self._rows.get(v.name) == now:
                continue
            self._rows[v.name] = now
            marks = Text("".join("▐" for _ in curves[:2]), no_wrap=True)
            for i, k in enumerate(curves[:2]):
                marks.stylize(Style(color=colours[k]), i, i + 1)
            marks.append(mark, Style(color=theme["accent"], bold=True))
            strong = Style(color=theme["accent"], bold=True) if mark == "→" else Style(bold=v.writable)
            self.table.update_cell(v.name, "", marks)
            self.table.update_cell(v.name, "value", Text(text, style=strong, justify="right"))
        self.border_subtitle = f"{len(wanted)} of {len(snapshot.variables)}" + (f", {len(staged)} staged" if staged else "")

    def _refill(self, wanted: tuple[Variable, ...]) -> None:
        at = self.marked
        self.table.clear()
        self._rows, self._shown = {}, wanted
        for v in wanted:
            dim = Style(dim=True)
            name = Text(v.name if v.length == 1 else f"{v.name}[{v.length}]", style=Style(bold=v.writable))
            initial = Text(show_value(v.initial, 2) if v.kind == "parameter" else v.kind, style=dim)
            cells = (Text(""), name, Text("—"), Text(v.unit, style=dim), Text(show_limits(v), style=dim), initial, Text(v.description, style=dim))
            self.table.add_row(*cells, key=v.name)
            if v.name == at:
                self.table.move_cursor(row=self.table.row_count - 1)
