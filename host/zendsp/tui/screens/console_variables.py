"""Console: edit variables at once, or stage, review and update in one sample; undo; parameter sets.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.style import Style
from rich.text import Text
from textual import on

from zendsp.errors import ZendspError
from zendsp.link import ParameterSet
from zendsp.tui.dialogs import Choose, Field, Form, Message, Option, Sliders, not_empty, slides
from zendsp.tui.panels.table import LiveTable
from zendsp.tui.panels.variables import VariablesPanel
from zendsp.tui.screens.base import LabScreen
from zendsp.tui.snapshot import Variable
from zendsp.tui.values import differs, reader, show_exact, show_limits, show_value
from zendsp_protocol.states import VariableKind
from zendsp_protocol.values import Assignable, Value

UNDO_DEPTH = 100


class VariableActions(LabScreen):
    """Actions on variables."""

    def __init__(self) -> None:
        super().__init__()
        self.staged: dict[str, Assignable] = {}
        self._undo: list[dict[str, Assignable]] = []
        self._key_time = 0.0
        # of the last edit: from the key to the target's word that it is applied
        self.key_to_applied_s = float("nan")

    @property
    def variables(self) -> VariablesPanel:
        """The table of this screen."""
        return self.query_one(VariablesPanel)

    def _variable(self, name: str) -> Variable | None:
        return next((v for v in self.lab.session.snapshot.variables if v.name == name), None)

    def _marked(self) -> Variable | None:
        v = self._variable(self.variables.marked)
        if v is None:
            self.say(
                "no variable is marked: build a program, then choose a row with ↑ ↓", "warning"
            )
        elif not v.writable:
            self.say(
                f"{v.name} is a signal: the program computes it, nobody can write it", "warning"
            )
            return None
        elif v.kind == VariableKind.TABLE:
            self.say(f"{v.name} is a table: Execute fills it with a planned reference", "warning")
            return None
        return v

    # -- one variable

    @on(LiveTable.Chosen)
    def _row_chosen(self) -> None:
        self.action_edit()

    def action_edit(self) -> None:
        """Write one variable at once."""
        v = self._marked()
        if v is not None:
            self._ask_value(v, "Write now", self._write)

    def action_stage(self) -> None:
        """Stage a new value of the marked variable."""
        v = self._marked()
        if v is not None:
            self._ask_value(v, "Stage", self._stage)

    def _ask_value(self, v: Variable, ok: str, then: Any) -> None:
        now = self.staged.get(v.name, self.lab.session.snapshot.values.get(v.name, v.initial))
        limits = show_limits(v)
        about = f"{v.description}\n" if v.description else ""
        text = (
            f"{about}{v.type}{f', {v.length} elements' if v.length > 1 else ''}{f', {limits}' if limits else ''},"  # noqa: E501
            f" initial {show_value(v.initial)}"
        )
        fields = [Field("value", v.name, show_exact(now), unit=v.unit, check=reader(v))]
        self.app.push_screen(
            Form(ok, fields, text, ok), lambda r: then(v, r["value"]) if r else None
        )

    def _stage(self, v: Variable, value: Any) -> None:
        self.staged[v.name] = value
        self._pulled = None

    def _write(self, v: Variable, value: Any) -> None:
        self._key_time = time.perf_counter()
        old = self.lab.session.snapshot.values.get(v.name)

        def done(tick: int) -> None:
            self.key_to_applied_s = time.perf_counter() - self._key_time
            self._remember({v.name: old})
            self.say(
                f"{v.name}: {show_value(old)} → {show_value(value)} {v.unit} at sample {tick}",
                "good",
            )

        self.ask(f"write {v.name}", lambda port: port.write({v.name: value}), done)

    def _remember(self, old: Mapping[str, Value | None]) -> None:
        self._undo.append({name: value for name, value in old.items() if value is not None})
        del self._undo[:-UNDO_DEPTH]

    # -- many variables in one sample

    def action_initial(self) -> None:
        """Stage the initial value of the marked variable."""
        v = self._marked()
        if v is not None:
            self._stage(v, v.initial)

    def action_initial_all(self) -> None:
        """Stage the initial values of all parameters that differ."""
        s = self.lab.session.snapshot
        self._stage_many(
            {v.name: v.initial for v in s.variables if v.kind == VariableKind.PARAMETER},
            "the initial values",
        )

    def _stage_many(self, values: Mapping[str, Assignable], what: str) -> None:
        s = self.lab.session.snapshot
        now = s.values
        known = {v.name for v in s.variables if v.kind == VariableKind.PARAMETER}
        fresh = {n: x for n, x in values.items() if n in known and differs(now.get(n), x)}
        unknown = sorted(set(values) - known)
        if unknown:
            self.say(
                f"left out, the program does not declare them: {', '.join(unknown)}", "warning"
            )
        self.staged.update(fresh)
        self._pulled = None
        self.say(
            f"{len(fresh)} values of {what} staged; u reviews and applies them"
            if fresh
            else f"nothing differs from {what}"
        )

    def review(self, values: Mapping[str, Assignable]) -> Text:
        """Old → new of each value, with units."""
        now = self.lab.session.snapshot.values
        width = max((len(n) for n in values), default=0)
        c = self.app.theme_variables
        text = Text()
        for name, value in values.items():
            v = self._variable(name)
            text.append(f"{name:<{width}}  ", "bold")
            text.append(f"{show_value(now.get(name)):>12}", Style(dim=True))
            text.append("  →  ")
            text.append(f"{show_value(value):<12}", Style(color=c["accent"], bold=True))
            text.append(f"  {v.unit if v else ''}\n", Style(dim=True))
        return text

    def action_update(self) -> None:
        """Review the staged values, then apply all in one sample."""
        if not self.staged:
            self.say(
                "nothing is staged: t stages the marked variable, w a parameter set", "warning"
            )
            return
        text = self.review(self.staged)
        n = len(self.staged)
        text.append("\nIt takes" if n == 1 else f"\nAll {n} take")
        text.append(
            " effect at the start of one sample."
            if n == 1
            else " effect at the start of one sample, or none does."
        )
        self.app.push_screen(
            Message("Update", text, agree="Apply"),
            lambda yes: self._apply(dict(self.staged)) if yes else None,
        )

    def _apply(self, values: dict[str, Assignable], undoing: bool = False) -> None:
        now = self.lab.session.snapshot.values
        old = {name: now.get(name) for name in values}

        def done(tick: int) -> None:
            for name in values:
                self.staged.pop(name, None)
            if not undoing:
                self._remember(old)
            self._pulled = None
            word = "taken back" if undoing else "applied"
            self.say(f"{len(values)} {word} at sample {tick}: {', '.join(values)}", "good")

        self.ask("update", lambda port: port.update(values), done)

    def action_undo(self) -> None:
        """Undo: first what is staged, then the last change on the target."""
        if self.staged:
            name, _ = self.staged.popitem()
            self._pulled = None
            self.say(f"{name} is no longer staged")
        elif self._undo:
            self._apply(self._undo.pop(), undoing=True)
        else:
            self.say("nothing to undo")

    # -- sliders

    def action_sliders(self) -> None:
        """Show sliders for parameters."""
        s = self.lab.session.snapshot
        found = [v for v in s.variables if slides(v) and v.name in s.values]
        if not found:
            self.say("no parameter has a slider: it needs two finite limits", "warning")
            return
        found.sort(key=lambda v: v.name != self.variables.marked)  # the marked one first

        def write(values: Mapping[str, float], together: bool) -> None:
            verb = "update" if together else "write"
            self.ask(f"sliders {verb}", lambda port: getattr(port, verb)(values))

        def closed(_: None) -> None:
            if dialog.before:
                self._remember(dialog.before)

        dialog = Sliders(found, lambda: self.lab.session.snapshot.values, write)
        self.app.push_screen(dialog, closed)

    # -- parameter sets

    def action_sets(self) -> None:
        """Save, compare and load parameter sets."""
        folder = self.lab.workspace.sets
        files = sorted(folder.glob("*.json"), key=lambda p: p.stat().st_mtime, reverse=True)
        options = [Option("", "＋ save the present values …")]
        options += [
            Option(
                str(p), p.stem, time.strftime("%Y-%m-%d %H:%M", time.localtime(p.stat().st_mtime))
            )
            for p in files
        ]

        def chosen(keys: list[str] | None) -> None:
            sets = [Path(key) for key in keys or () if key]
            if keys and not keys[0]:
                self._name_set(keys[1] or "set")
            elif len(sets) > 1:
                self._side_by_side(sets)
            elif sets:
                self._compare_set(sets[0])

        text = "One: what differs from the target, to be staged. Several: side by side."
        self.app.push_screen(Choose("Parameter sets", options, several=True, text=text), chosen)

    def _name_set(self, name: str) -> None:
        form = Form(
            "Save parameter set",
            [Field("name", "Name", name, check=not_empty)],
            str(self.lab.workspace.sets),
            "Save",
        )
        self.app.push_screen(form, lambda r: self._save_set(r["name"]) if r else None)

    def _save_set(self, name: str) -> None:
        s = self.lab.session.snapshot
        names = [
            v.name
            for v in s.variables
            if v.kind == VariableKind.PARAMETER and v.name in s.values
        ]
        values = {name: np.asarray(s.values[name]).tolist() for name in names}
        try:
            path = self.lab.workspace.free(self.lab.workspace.sets, name, ".json")
            ParameterSet(values, s.program, s.target).save(path)
        except OSError as error:
            self.say(f"parameter set not saved: {error}", "error")
            return
        self.say(f"{len(values)} values saved in {path}", "good")

    def _side_by_side(self, paths: list[Path]) -> None:
        """Show the differences between some sets and the target."""
        try:
            stored = {path.stem: ParameterSet.load(path).values for path in paths}
        except ZendspError as error:
            self.say(str(error), "error")
            return
        s = self.lab.session.snapshot
        parameters = {v.name for v in s.variables if v.kind == VariableKind.PARAMETER}
        now = {n: x for n, x in s.values.items() if n in parameters}
        columns = {"target": now, **stored} if now else stored
        first, *others = columns.values()
        names = dict.fromkeys(name for values in columns.values() for name in values)
        rows = [
            name
            for name in names
            if any(name not in c or differs(first.get(name), c[name]) for c in others)
        ]
        wide = max(map(len, rows), default=0)
        text = Text(f"{'':<{wide}}" + "".join(f"  {name[:14]:>14}" for name in columns) + "\n")
        for name in rows:
            cells = [show_value(c.get(name), 2)[:14] for c in columns.values()]
            text.append(f"{name:<{wide}}", "bold")
            text.append("".join(f"  {cell:>14}" for cell in cells) + "\n")
        if not rows:
            text = Text("no difference")
        self.app.push_screen(Message(f"{len(rows)} of {len(names)} differ", text))

    def _compare_set(self, path: Path) -> None:
        try:
            stored = ParameterSet.load(path)
        except ZendspError as error:
            self.say(str(error), "error")
            return
        now = self.lab.session.snapshot.values
        different = {n: x for n, x in stored.values.items() if n not in now or differs(now[n], x)}
        if not different:
            self.say(f"{path.stem}: every value is as on the target")
            return
        text = self.review(different)
        self.app.push_screen(
            Message(
                f"{path.stem}: differs in {len(different)} of {len(stored.values)}", text,
                agree="Stage these",
            ),
            lambda yes: self._stage_many(stored.values, path.stem) if yes else None,
        )
