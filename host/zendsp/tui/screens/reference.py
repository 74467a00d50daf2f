"""Reference: plans a motion, shows it with the limits of the machine, and saves the MAT file that
Execute plays. It needs no target.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from rich.text import Text
from textual import on
from textual.widgets import Button, Select, Static

from zendsp.errors import ReferenceError_, ZendspError
from zendsp.reference import (
    JUMPS,
    KINDS,
    MACHINES,
    UNPREDICTED,
    Machine,
    Reference,
    Violation,
    load_machine,
    load_reference,
    make_reference,
    save_reference,
)
from zendsp.tui.actions import bindings
from zendsp.tui.dialogs import Choose, Field, Form, Option, not_empty
from zendsp.tui.preview import (
    Columns,
    columns_of,
    curves_of,
    limits_of,
    path_of,
    peaks_of,
    views_of,
)
from zendsp.tui.scope import Scope
from zendsp.tui.scope.path import PathPlot
from zendsp.tui.screens.base import WIDE
from zendsp.tui.screens.reference_form import ReferenceForm, Wanted

NEAR = 0.9  # of a limit: more is shown as a warning


@dataclass(frozen=True)
class Plan:
    """One planned motion with its check against the limits."""

    machine: Machine
    reference: Reference
    tau: Any  # (N, joints), N m; None where no torque is predicted
    violations: tuple[Violation, ...]


class ReferenceScreen(ReferenceForm):
    """Form on the left, preview on the right."""

    NAME: ClassVar[str] = "reference"
    BINDINGS = bindings("reference")

    def __init__(self) -> None:
        super().__init__()
        self.plan: Plan | None = None
        self._planned: Wanted | None = None  # what ``plan`` was made of, or could not be made of
        self._saved: tuple[Wanted, Path] | None = None  # last: what was planned, and its file
        self._to_save: tuple[Wanted, str, str | None] | None = None  # once it is planned
        self.view = "all"

    # -- planning

    def plan_now(self) -> None:
        """Plan on a thread, since an optimal swing takes seconds."""
        wanted = self._wanted()
        try:
            values = self.values()
        except ReferenceError_ as error:
            self._settle(wanted, str(error))
            return
        self._show_problem("")
        machine, kind = self.machine, KINDS[self.kind]

        def work() -> None:
            found: Plan | str
            try:
                reference = make_reference(kind.name, machine, machine.sample_time, **values)
                found = make_plan(machine, reference)
            except ZendspError as error:
                found = str(error)
            self.app.call_from_thread(self._settle, wanted, found)

        self.run_worker(work, thread=True, exclusive=True, group="plan")

    def _settle(self, wanted: Wanted, found: Plan | str) -> None:
        """Show the plan that was asked for, or why there is none; save it if that was asked for
        too.
        """
        if wanted != self._wanted():
            return  # the user has gone on meanwhile: another plan is on its way
        self._planned = wanted
        if isinstance(found, str):
            self._show_problem(found)
        else:
            self._show_plan(found)
        if self._to_save is not None:
            (asked, name, then), self._to_save = self._to_save, None
            if asked == wanted:
                self._write(name, then)
            else:
                self.say(f"{name} is not saved: the form has been changed since", "warning")

    def _show_problem(self, text: str) -> None:
        self.query_one("#problem", Static).update(text)
        self.query_one("#save", Button).disabled = bool(text) or self.plan is None
        if text:
            self.plan = None
            self.query_one("#check", Static).update("")

    def _show_plan(self, plan: Plan) -> None:
        self.plan = plan
        if self.view not in self._views():
            self.view = self._views()[0]
        scope, path = self.query_one("#curves", Scope), self.query_one("#path", PathPlot)
        scope.display, path.display = self.view != "path", self.view == "path"
        if self.view == "path":
            path.show(*path_of(self.machine, plan.reference))
        else:
            curves_of(scope, self._columns(plan), plan.reference, self.view)
            scope.limits = limits_of(self.machine)
        self.query_one("#check", Static).update(self._check(plan))
        self.query_one("#save", Button).disabled = bool(plan.violations)

    def _columns(self, plan: Plan) -> Columns:
        return columns_of(self.machine, plan.reference, plan.tau)

    def _views(self) -> list[str]:
        return views_of(self._columns(self.plan), not self.small) if self.plan is not None else []

    def on_resize(self) -> None:
        self.refresh_plan()

    def refresh_plan(self) -> None:
        """Draw the present plan again after a change of view or size."""
        if self.plan is not None:
            self._show_plan(self.plan)

    def _check(self, plan: Plan) -> Text:
        c = self.app.theme_variables
        r = plan.reference
        brief = self.size.width < WIDE
        text = Text()
        text.append(
            f"{r.duration:.3f} s, {r.samples} samples at {1.0 / r.sample_time:g} Hz", "bold"
        )
        view = f"   view: {self.view}, v changes   below: % of the limits"
        text.append("\n" if brief else f"{view}\n", "dim")
        for line in peaks_of(self.machine, r, plan.tau, brief):
            for share, words_ in line:
                colour = (
                    c["error"]
                    if share > 1.0 + 1e-9
                    else c["warning"] if share > NEAR else c["success"]
                )
                text.append(words_, colour)
            text.append("\n")
        if plan.tau is None:
            text.append(f"! {JUMPS if r.jumps else UNPREDICTED}\n", c["warning"])
        for violation in plan.violations:
            text.append(f"✖ {violation}\n", f"bold {c['error']}")
        if not plan.violations:
            known = "" if plan.machine.modelled else " that are known"
            others = "" if r.jumps else f", and {100 * r.headroom:g} % of the others{known}"
            text.append(f"✔ within the limits of position{others}", c["success"])
        text.rstrip()
        return text

    # -- actions

    def action_machine(self) -> None:
        """Open the list of machines."""
        select = self.query_one("#machine", Select)
        select.focus()
        select.action_show_overlay()

    def action_kind(self) -> None:
        """Open the list of motions."""
        select = self.query_one("#kind", Select)
        select.focus()
        select.action_show_overlay()

    def action_view(self) -> None:
        """Go to the next view."""
        if self.plan is not None:
            views = self._views()
            self.view = views[(views.index(self.view) + 1) % len(views)]
            self.refresh_plan()

    @on(Button.Pressed, "#save")
    def action_save(self) -> None:
        """Ask for a name and save."""
        self._save(None)

    @on(Button.Pressed, "#to-execute")
    def action_execute(self) -> None:
        """Open the plan on Execute; an unsaved one is saved first."""
        wanted, path = self._saved or (None, Path())
        if wanted == self._wanted() and path.is_file():
            self.lab.play(path)
        else:
            self._save("execute")

    def _save(self, then: str | None) -> None:
        if self._planned == self._wanted() and self._savable() is None:
            return
        stem = self._stem()
        form = Form(
            "Save reference",
            [Field("name", "Name", stem, check=not_empty)],
            str(self.lab.workspace.references),
            "Save",
        )

        def take(result: Any) -> None:
            if not result:
                return
            if self._stem() != stem:
                self.say(f"not saved: this is {self._stem()} by now, not {stem}", "warning")
            elif self._planned == self._wanted():
                self._write(result["name"], then)
            else:
                self._to_save = self._wanted(), result["name"], then
                self.say(f"{result['name']} is being planned, and is saved then")
                self.lab.toast(f"{result['name']} is being planned, and is saved then")

        self.app.push_screen(form, take)

    def _stem(self) -> str:
        return f"{self.machine.name}-{self.query_one('#kind', Select).value}"

    def _savable(self) -> Plan | None:
        """The plan; None after saying why there is none to save."""
        if self.plan is None or self.plan.violations:
            self.say(
                "nothing to save: the motion is not planned, or it breaks a limit (see below the"
                " curves)",
                "warning",
            )
            return None
        return self.plan

    def _write(self, name: str, then: str | None) -> None:
        """Save the plan that the form describes."""
        plan = self._savable()
        if plan is None:
            return
        path = self.lab.workspace.free(self.lab.workspace.references, name, ".mat")
        try:
            save_reference(plan.reference, path, plan.machine)
        except (ZendspError, OSError) as error:
            self.say(f"save {path.name}: {error}", "error")
            return
        self._saved = self._wanted(), path
        self.say(f"saved {path}", "good")
        self.lab.toast(f"saved {path}")
        if then == "execute":
            self.lab.play(path)

    def action_load(self) -> None:
        """Choose among the saved references."""
        options = [
            Option(str(p), p.stem, p.parent.name) for p in self.lab.workspace.saved_references()
        ]
        if not options:
            self.say("no saved reference yet: save one with Ctrl+S", "warning")
            return
        self.app.push_screen(
            Choose("Reference", options),
            lambda keys: self.open_reference(Path(keys[0])) if keys else None,
        )

    def open_reference(self, path: Path) -> None:
        """Show a saved reference, with its parameters in the form where they are known."""
        try:
            reference = load_reference(path)
            machine = self._machine_of(reference)
            plan = make_plan(machine, reference)
        except (ZendspError, OSError) as error:
            self.say(f"{path.name}: {error}", "error")
            return
        self.machine, self._planned = machine, None
        with self.prevent(Select.Changed):
            self.query_one("#machine", Select).value = self._choice()
            if reference.kind in KINDS and KINDS[reference.kind].fits(machine):
                self.kind = reference.kind
                kinds = self.query_one("#kind", Select)
                kinds.set_options(self._kinds())
                kinds.value = self.kind
                self.call_later(self._fill_form, dict(reference.parameters))
            else:
                self._planned = self._wanted()  # the form cannot show it
        self._show_plan(plan)
        self.say(f"opened {path.name}", "good")

    def _machine_of(self, reference: Reference) -> Machine:
        """The machine that a saved reference was planned for."""
        name = reference.machine
        if self._own is not None and name == self._own.name:
            return self._own
        if name and name not in MACHINES:
            raise ReferenceError_(
                f"planned for {name}, whose limits are not known here: connect to it and load a"
                " program"
            )
        return load_machine(name) if name else self.machine


def make_plan(machine: Machine, reference: Reference) -> Plan:
    """The motion with its torque and its check against the limits."""
    violations = tuple(machine.find_violations(reference))
    return Plan(machine, reference, machine.torque(reference), violations)
