"""The table of a sweep: the result of each set of parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.widgets import DataTable, Static

from zendsp.tui.panels.table import ListTable
from zendsp_protocol.values import Assignable

if TYPE_CHECKING:
    from zendsp.experiment.sweep_result import Sweep


class SweepView(Vertical):
    """One row for each set of parameters. The best one is marked, and those that cannot be told
    from it.
    """

    DEFAULT_CSS = """
    SweepView Static { height: auto; }
    SweepView DataTable { height: 1fr; }
    SweepView #sweep-keys { color: $text-muted; }
    """

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.sweep: Sweep | None = None

    def compose(self) -> ComposeResult:
        yield Static("", id="sweep-words", markup=False)
        yield ListTable(id="sweep", cursor_type="row")
        keys = "⏎, or a click on the marked row, writes its values"
        yield Static(keys, id="sweep-keys", markup=False)

    def show(self, sweep: Sweep) -> None:
        """Show another sweep, the cursor on its best row."""
        self.sweep = sweep
        self.query_one("#sweep-words", Static).update(Text(repr(sweep)[1:-1]))
        table = self.query_one("#sweep", DataTable)
        table.clear(columns=True)
        for name in ("", *sweep.parameters, *sweep.results, "ended"):
            table.add_column(Text(name))
        best = sweep.best_rows()
        for k, cells in enumerate(sweep.cells()):
            style = "bold" if k in best else ""
            table.add_row(Text("●" if k in best else " "), *(Text(c, style) for c in cells))
        table.move_cursor(row=sweep.best_row() or 0)

    def values(self, row: int) -> Mapping[str, Assignable]:
        """The parameters of a row."""
        return {} if self.sweep is None else self.sweep.rows[row].values
