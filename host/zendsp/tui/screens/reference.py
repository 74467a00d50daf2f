"""Reference: plans a motion, shows it over the limits of the machine, saves the MAT that Execute
plays. Needs no target.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from rich.text import Text
from textual import events, on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.timer import Timer
from textual.widgets import Button, Input, Select, Static, Switch

from zendsp.errors import ReferenceError_, ZendspError
from zendsp.reference import (
    KINDS,
    MACHINES,
    UNPREDICTED,
    Machine,
    Parameter,
    Reference,
    Violation,
    load_machine,
    load_reference,
    make_reference,
    save_reference,
)
from zendsp.reference.registry import HEADROOM
from zendsp.tui.actions import bindings
from zendsp.tui.dialogs import Choose, Field, Form, Option, not_empty
from zendsp.tui.preflight import machine_of
from zendsp.tui.preview import curves_of, limits_of, path_of, peaks_of, views_of
from zendsp.tui.scope import Scope
from zendsp.tui.scope.path import PathPlot
from zendsp.tui.screens.base import WIDE, LabScreen
from zendsp.tui.snapshot import Snapshot

TARGET = "target"  # in the list: the machine of the target, by its own limits
SETTLE_S = 0.25  # of quiet after a key before the motion is planned anew


@dataclass(frozen=True)
class Plan:
    """One planned motion with its check."""

    machine: Machine
    reference: Reference
    tau: Any  # (N, joints), N m; None where no torque is predicted
    violations: tuple[Violation, ...]


Wanted = tuple[Machine, str, tuple[Any, ...]]  # machine, kind of motion and what stands in its form


class ReferenceScreen(LabScreen):
    """Form on the left, preview on the right."""

    NAME: ClassVar[str] = "reference"
    BINDINGS = bindings("reference")

    def __init__(self) -> None:
        super().__init__()
        self.machine: Machine = load_machine(MACHINES[0])
        self.kind = next(iter(KINDS))
        self.plan: Plan | None = None
        self._planned: Wanted | None = None  # what ``plan`` was made of, or could not be made of
        self._to_save: tuple[Wanted, str, str | None] | None = None  # once it is planned
        self.view = "all"
        self._timer: Timer | None = None
        self._seen: object = None  # of the target that was looked at last
        self._of_target: Machine | None = None
        self._own: Machine | None = None  # of a target whose machine is not among those shipped

    # -- layout
    # ----------------------------------------------------------------------------------------------

    def body(self) -> ComposeResult:
        with Horizontal(id="reference-body"):
            with Vertical(id="form"):
                with Horizontal(classes="line"):
                    yield Static("Machine", classes="label")
                    yield Select(
                        self._machines(),
                        value=self.machine.name,
                        allow_blank=False,
                        compact=True,
                        id="machine",
                    )
                with Horizontal(classes="line"):
                    yield Static("Motion", classes="label")
                    yield Select(
                        self._kinds(), value=self.kind, allow_blank=False, compact=True, id="kind"
                    )
                yield Static("", id="about", markup=False)
                yield VerticalScroll(id="fields")
                yield Static("", id="problem", markup=False)
                with Horizontal(classes="line"):
                    yield Button("Save ^s", id="save", variant="primary", compact=True)
                    yield Button("Execute x", id="to-execute", compact=True)
            with Vertical(id="preview"):
                yield Scope(id="curves", live=False)
                yield PathPlot(id="path")
                yield Static("", id="check", markup=False)

    def _machines(self) -> list[tuple[Text, str]]:
        own = [] if self._own is None else [(Text(f"{self._own.name} (target)"), TARGET)]
        return [*own, *((Text(name), name) for name in MACHINES)]

    def _kinds(self) -> list[tuple[Text, str]]:
        return [(Text(kind.title), name) for name, kind in KINDS.items() if kind.fits(self.machine)]

    def ready(self) -> None:
        self.query_one("#curves", Scope).empty_text = "nothing planned yet"
        self.call_later(self._fill_form)

    def pull(self, snapshot: Snapshot, fresh: bool) -> None:
        """Plan for the machine of a target that has just been connected."""
        seen = (snapshot.machine, snapshot.described, snapshot.limits, snapshot.rate_hz)
        if seen == self._seen:
            return
        self._seen = seen
        machine, before = machine_of(snapshot), self._of_target
        if machine is None:
            return
        self._of_target = machine
        same = before is not None and (before.name, before.kind, before.joints) == (
            machine.name,
            machine.kind,
            machine.joints,
        )
        chosen = same and self.machine is self._own
        if not machine.modelled:
            self._own = machine
        if chosen:  # its limits have changed
            self.machine = machine
            self._plan_soon()
        elif not same:
            self.call_later(self._use, machine)

    async def _use(self, machine: Machine) -> None:
        """Plan for a machine from now on."""
        self.machine = machine
        machines, kinds = self.query_one("#machine", Select), self.query_one("#kind", Select)
        fitting = self._kinds()
        if self.kind not in [name for _, name in fitting]:
            self.kind = fitting[0][1]
        with self.prevent(Select.Changed):
            machines.set_options(self._machines())
            machines.value = self._choice()
            kinds.set_options(fitting)
            kinds.value = self.kind
        await self._fill_form()

    def _choice(self) -> str:
        return self.machine.name if self.machine.modelled else TARGET

    # -- the form
    # ----------------------------------------------------------------------------------------------

    async def _fill_form(self, values: Mapping[str, Any] | None = None) -> None:
        """Make a line for each parameter, with its default unless ``values`` has it."""
        kind = KINDS[self.kind]
        self.query_one("#about", Static).update(kind.description)
        fields = self.query_one("#fields", VerticalScroll)
        await fields.remove_children()
        await fields.mount(*[self._line(p, (values or {}).get(p.name)) for p in self._parameters()])
        self._plan_soon()

    def _parameters(self) -> tuple[Parameter, ...]:
        """Return the lines of the form: the kind's own parameters, and how much of the limits the
        motion may use.
        """
        return (*KINDS[self.kind].parameters, HEADROOM)

    def _line(self, p: Parameter, value: Any = None) -> Horizontal:
        value = p.default_for(self.machine) if value is None else value
        widget: Input | Select[str] | Switch
        if p.type == "choice":
            widget = Select(
                [(c, c) for c in p.choices],
                value=str(value),
                allow_blank=False,
                compact=True,
                name=p.name,
            )
        elif p.type == "bool":
            widget = Switch(bool(value), name=p.name)
        else:
            widget = Input(words(value), compact=True, name=p.name)
        bounds = f"  ({p.describe_bounds()})" if p.describe_bounds() and not p.choices else ""
        widget.tooltip = f"{p.description}{bounds}".replace("[", "(").replace("]", ")")
        unit = Static(p.unit, classes="unit", markup=False)
        return Horizontal(
            Static(p.name, classes="label", markup=False), widget, unit, classes="line parameter"
        )

    def on_descendant_focus(self, event: events.DescendantFocus) -> None:
        """Say what the field means that is being edited."""
        names = [p for p in self._parameters() if p.name == event.widget.name]
        bounds = f" ({names[0].describe_bounds()})" if names and names[0].describe_bounds() else ""
        text = (
            f"{names[0].name}: {names[0].description}{bounds}"
            if names
            else KINDS[self.kind].description
        )
        self.query_one("#about", Static).update(text)

    @on(Select.Changed, "#machine")
    async def _machine_changed(self, event: Select.Changed) -> None:
        if event.value == self._choice():
            return
        own = self._own if event.value == TARGET else None
        await self._use(own or load_machine(str(event.value)))

    @on(Select.Changed, "#kind")
    async def _kind_changed(self, event: Select.Changed) -> None:
        if event.value != self.kind and str(event.value) in KINDS:
            self.kind = str(event.value)
            await self._fill_form()

    @on(Input.Changed, "#fields Input")
    @on(Select.Changed, "#fields Select")
    @on(Switch.Changed, "#fields Switch")
    def _plan_soon(self) -> None:
        if self._timer is not None:
            self._timer.stop()
        self._timer = self.set_timer(SETTLE_S, self.plan_now)

    def values(self) -> dict[str, Any]:
        """Return the parameters as typed, parsed; raises ReferenceError_ with the reason."""
        values = {}
        typed = dict(self._wanted()[2])
        for p in self._parameters():
            if p.name in typed and not (p.default is None and typed[p.name] == ""):
                values[p.name] = p.parse(typed[p.name], self.machine)
        return values

    def _wanted(self) -> Wanted:
        """Return what the form asks for as it stands."""
        widgets = self.query("#form Select, #form Input, #form Switch")
        typed = [(w.name, w.value) for w in widgets if isinstance(w, Input | Select | Switch)]
        return self.machine, self.kind, tuple(typed)

    # -- planning
    # ----------------------------------------------------------------------------------------------

    def plan_now(self) -> None:
        """Plan on a thread: an optimal swing takes seconds."""
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
        """Show the plan that was asked for, or why there is none; save it if that was asked for."""
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
            curves_of(scope, plan.reference, plan.tau, self.view)
            scope.limits = limits_of(self.machine)
        self.query_one("#check", Static).update(self._check(plan))
        self.query_one("#save", Button).disabled = bool(plan.violations)

    def _views(self) -> list[str]:
        return (
            views_of(self.plan.reference, not self.small, self.plan.tau is not None)
            if self.plan is not None
            else []
        )

    def on_resize(self) -> None:
        self.refresh_plan()

    def refresh_plan(self) -> None:
        """Show the present plan again, after a change of view or size."""
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
        text.append("\n" if brief else f"   view: {self.view}   v changes\n", "dim")
        for line in peaks_of(self.machine, r, plan.tau, brief):
            for share, words_ in line:
                colour = (
                    c["error"]
                    if share > 1.0 + 1e-9
                    else c["warning"] if share > 0.9 else c["success"]
                )
                text.append(words_, colour)
            text.append("\n")
        if not plan.machine.modelled:
            text.append(f"! {UNPREDICTED}\n", c["warning"])
        for violation in plan.violations:
            text.append(f"✖ {violation}\n", f"bold {c['error']}")
        if not plan.violations:
            text.append(
                f"✔ within {100 * r.headroom:g} % of every"
                f" {'' if plan.machine.modelled else 'known '}limit of the machine",
                c["success"],
            )
        text.rstrip()
        return text

    # -- actions
    # ----------------------------------------------------------------------------------------------

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
        """Save and open on Execute."""
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
        """Return the plan, or say why there is none to save."""
        if self.plan is None or self.plan.violations:
            self.say(
                "nothing to save: the motion is not planned, or it breaks a limit (see below the"
                " curves)",
                "warning",
            )
            return None
        return self.plan

    def _write(self, name: str, then: str | None) -> None:
        """Save the plan of the form as it stands."""
        plan = self._savable()
        if plan is None:
            return
        path = self.lab.workspace.free(self.lab.workspace.references, name, ".mat")
        try:
            save_reference(plan.reference, path, plan.machine)
        except (ZendspError, OSError) as error:
            self.say(f"save {path.name}: {error}", "error")
            return
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
        """Show a saved reference, and its parameters in the form where they are known."""
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
    """A motion with its torque and its check."""
    violations = tuple(machine.find_violations(reference))
    return Plan(machine, reference, machine.torque(reference), violations)


def words(value: Any) -> str:
    """Return a default as text for an input field: numbers without noise, lists with blanks."""
    if value is None:
        return ""
    if isinstance(value, bool | str):
        return str(value)
    if isinstance(value, list | tuple | np.ndarray):
        return " ".join(f"{float(v):.6g}" for v in np.ravel(value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)
