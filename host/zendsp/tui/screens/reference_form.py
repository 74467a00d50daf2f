"""Reference: the form with machine, kind of motion and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.text import Text
from textual import events, on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.timer import Timer
from textual.widgets import Button, Input, Select, Static, Switch

from zendsp.reference import KINDS, MACHINES, Machine, Parameter, load_machine
from zendsp.reference.registry import HEADROOM
from zendsp.tui.dialogs.form import Label
from zendsp.tui.dialogs.yes_no import YesNo
from zendsp.tui.preflight import machine_of
from zendsp.tui.scope import Scope
from zendsp.tui.scope.path import PathPlot
from zendsp.tui.screens.base import LabScreen
from zendsp.tui.snapshot import Snapshot

TARGET = "target"  # in the list: the machine of the target, by its own limits
SETTLE_S = 0.25  # of quiet after a key before the motion is planned anew

Wanted = tuple[Machine, str, tuple[Any, ...]]  # machine, kind of motion and what stands in its form


class ReferenceForm(LabScreen):
    """The form; ``plan_now`` is called a moment after the last change."""

    def __init__(self) -> None:
        super().__init__()
        self.machine: Machine = load_machine(MACHINES[0])
        self.kind = next(iter(KINDS))
        self._timer: Timer | None = None
        self._seen: object = None  # of the target that was looked at last
        self._of_target: Machine | None = None
        self._own: Machine | None = None  # of a target whose machine is not among those shipped

    def plan_now(self) -> None:
        """Plan the motion that the form describes."""
        raise NotImplementedError

    # -- layout

    def body(self) -> ComposeResult:
        with Horizontal(id="reference-body"):
            with Vertical(id="form"):
                with Horizontal(classes="line"):
                    yield Label("Machine", classes="label")
                    yield Select(
                        self._machines(), value=self.machine.name, allow_blank=False, compact=True,
                        id="machine",
                    )
                with Horizontal(classes="line"):
                    yield Label("Motion", classes="label")
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

    def on_key(self, event: events.Key) -> None:
        """On Esc leave the field, so that letters are commands again."""
        if event.key == "escape" and isinstance(self.focused, Input):
            event.stop()
            self.set_focus(None)

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
            machine.name, machine.kind, machine.joints,
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

    async def _fill_form(self, values: Mapping[str, Any] | None = None) -> None:
        """Make a line for each parameter, with the value in ``values`` or else its default."""
        kind = KINDS[self.kind]
        self.query_one("#about", Static).update(kind.description)
        fields = self.query_one("#fields", VerticalScroll)
        await fields.remove_children()
        await fields.mount(*[self._line(p, (values or {}).get(p.name)) for p in self._parameters()])
        self._show_units()
        self._plan_soon()

    def _parameters(self) -> tuple[Parameter, ...]:
        """The lines of the form: the parameters of the kind, and the fraction of the limits that
        the motion may use.
        """
        return (*KINDS[self.kind].parameters, HEADROOM)

    def _line(self, p: Parameter, value: Any = None) -> Horizontal:
        value = p.default_for(self.machine) if value is None else value
        widget: Input | Select[str] | Switch
        if p.type == "choice":
            widget = Select(
                [(c, c) for c in p.choices], value=str(value), allow_blank=False, compact=True,
                name=p.name,
            )
        elif p.type == "bool":
            widget = YesNo(bool(value), name=p.name)
        else:
            widget = Input(words(value), compact=True, name=p.name)
        bounds = f"  ({p.describe_bounds()})" if p.describe_bounds() and not p.choices else ""
        widget.tooltip = f"{p.description}{bounds}".replace("[", "(").replace("]", ")")
        said = p.unit
        if p.type == "joints" and said.startswith("rad") and self.machine.unit != "rad":
            each = (unit + said.removeprefix("rad") for unit in self.machine.units)
            said = ", ".join(each if self.machine.joint_units else dict.fromkeys(each))
        unit = Label(said, classes="unit", name=said, markup=False)
        name = Label(p.name, classes="label", markup=False)
        return Horizontal(name, widget, unit, classes="line parameter")

    def on_descendant_focus(self, event: events.DescendantFocus) -> None:
        """Explain the field that is being edited."""
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

    @on(Select.Changed, "#fields Select")
    def _show_units(self) -> None:
        """Show the units in force where a parameter may have that of position or of torque."""
        chosen = int(("quantity", "torque") in self._wanted()[2])
        for label in self.query("#fields .unit").results(Label):
            label.update((label.name or "").split(" or ")[-chosen])

    def values(self) -> dict[str, Any]:
        """The parameters as typed, converted; raises ReferenceError_ with the reason."""
        values = {}
        typed = dict(self._wanted()[2])
        for p in self._parameters():
            if p.name in typed and not (p.default is None and typed[p.name] == ""):
                values[p.name] = p.parse(typed[p.name], self.machine)
        return values

    def _wanted(self) -> Wanted:
        """The motion that the form describes."""
        widgets = self.query("#form Select, #form Input, #form Switch")
        typed = [(w.name, w.value) for w in widgets if isinstance(w, Input | Select | Switch)]
        return self.machine, self.kind, tuple(typed)


def words(value: Any) -> str:
    """A default as text for an input field: numbers without trailing digits, lists separated by
    blanks.
    """
    if value is None:
        return ""
    if isinstance(value, bool | str):
        return str(value)
    if isinstance(value, list | tuple | np.ndarray):
        return " ".join(f"{float(v):.6g}" for v in np.ravel(value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)
