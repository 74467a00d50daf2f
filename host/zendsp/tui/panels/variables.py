"""The table of variables: value, unit, limits, initial value, and marks on those that are plotted,
staged or changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.style import Style
from textual import events, on
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.widgets import Input

from zendsp.tui.colours import trace_colours
from zendsp.tui.panels.table import Cell, Column, LiveTable
from zendsp.tui.snapshot import Snapshot, Variable
from zendsp.tui.values import differs, show_limits, show_value
from zendsp_protocol.states import VariableKind
from zendsp_protocol.values import Assignable

COLUMNS = (
    Column("", 2),
    Column("name", most=22),
    Column("value", 17, right=True),
    Column("unit", most=10),
    Column("limits", most=16),
    Column("initial", most=12),
    Column("description", most=60),
)


class VariablesPanel(Vertical):
    """The table of variables, with a filter line above it."""

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._words = ""
        self._rows: dict[str, tuple[object, ...]] = {}  # what each row was made of
        self.border_title = "Variables"

    def compose(self) -> ComposeResult:
        yield Input(
            placeholder="filter: part of a name, unit or description", id="filter", compact=True
        )
        yield LiveTable(COLUMNS, id="variables")

    @property
    def table(self) -> LiveTable:
        """The table itself."""
        return self.query_one("#variables", LiveTable)

    @property
    def marked(self) -> str:
        """Name of the variable under the cursor, "" in an empty table."""
        return self.table.marked

    def open_filter(self) -> None:
        """Show the filter line and type into it."""
        line = self.query_one("#filter", Input)
        line.add_class("-shown")
        line.focus()

    @on(Input.Changed, "#filter")
    def _filter(self, event: Input.Changed) -> None:
        self._words = event.value.lower()

    def on_key(self, event: events.Key) -> None:
        """On Esc leave the filter line and show all variables."""
        line = self.query_one("#filter", Input)
        if event.key == "escape" and line.has_focus:
            event.stop()
            line.value = ""
            line.remove_class("-shown")
            self.table.focus()

    @on(Input.Submitted, "#filter")
    def _filtered(self) -> None:
        if not self._words:
            self.query_one("#filter", Input).remove_class("-shown")
        self.table.focus()

    def show(
        self, snapshot: Snapshot, staged: Mapping[str, Assignable], plotted: Sequence[str]
    ) -> None:
        """Bring the table up to date; only rows that differ are painted."""
        wanted = [
            v
            for v in snapshot.variables
            if self._words in f"{v.name} {v.unit} {v.description}".lower()
        ]
        theme = self.app.current_theme
        colours = trace_colours(theme).traces
        accent = self.app.theme_variables["accent"]
        fresh: dict[str, tuple[object, ...]] = {}
        for v in wanted:
            value = staged.get(v.name, snapshot.values.get(v.name))
            curves = tuple(
                k
                for k, name in enumerate(plotted)
                if name == v.name or name.startswith(f"{v.name}[")
            )
            own = v.kind == VariableKind.PARAMETER and value is not None
            changed = own and differs(value, v.initial)
            mark = "→" if v.name in staged else "*" if changed else " "
            shown = value if isinstance(value, float | int) else show_value(value, 2)
            fresh[v.name] = (v, shown, mark, curves, theme.name)
        if list(fresh) != list(self._rows):
            self.table.set_rows(
                [(v.name, _cells(v, fresh[v.name], colours, accent)) for v in wanted]
            )
        else:
            for v in wanted:
                if fresh[v.name] != self._rows[v.name]:
                    self.table.set_row(v.name, _cells(v, fresh[v.name], colours, accent))
        self._rows = fresh
        subtitle = (
            f"{len(wanted)} of"
            f" {len(snapshot.variables)}{f', {len(staged)} staged' if staged else ''}"
        )
        if self.border_subtitle != subtitle:
            self.border_subtitle = subtitle


def sizes(v: Variable) -> str:
    """The size of an array, or the rows and columns of a matrix, as text."""
    matrix = v.columns > 1 and v.kind != VariableKind.TABLE
    return f"{v.length // v.columns},{v.columns}" if matrix else str(v.length)


def _cells(
    v: Variable, made_of: tuple[object, ...], colours: Sequence[str], accent: str
) -> tuple[Cell, ...]:
    _, value, mark, curves, _ = made_of
    assert isinstance(mark, str) and isinstance(curves, tuple)
    text = value if isinstance(value, str) else show_value(value, 2)
    dim, strong = Style(dim=True), Style(bold=v.writable)
    staged = Style(color=accent, bold=True)
    first = Style(color=colours[curves[0]], bold=True) if curves else staged
    return (
        (("▐" if curves else " ") + mark, first),
        (v.name if v.length == 1 else f"{v.name}[{sizes(v)}]", strong),
        (text, staged if mark == "→" else strong),
        (v.unit, dim),
        (show_limits(v), dim),
        (show_value(v.initial, 2) if v.kind == VariableKind.PARAMETER else v.kind, dim),
        (v.description, dim),
    )
