"""A first model file from a recording: what its columns say, and questions where they say nothing.
"""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zendsp.errors import RecordingError
from zendsp.physics.files.draft_data import (
    PREFERRED,
    WHOLE,
    Group,
    Machine,
    best_group,
    finite,
    first_idea,
    groups_of,
    in_order,
    is_behind,
    sliding,
    unbroken,
    why_degrees,
)
from zendsp.physics.files.shipped import model_folder
from zendsp.physics.kernel.signals import find_resolution
from zendsp.recording import Table
from zendsp.recording.roles import Role
from zendsp_protocol.texts import counted

ROUGH = 0.15  # relative standard deviation of a first idea: what is missing bends it
SATURATED = 20  # samples at the largest command: it was cut off there


@dataclass(frozen=True)
class Draft:
    """The text of a model file, the questions in it, and the recording's columns that it leaves."""

    text: str
    joints: int
    questions: tuple[str, ...]
    unused: tuple[str, ...] = ()


class _Page:
    def __init__(self) -> None:
        self.lines: list[str] = []
        self.questions: list[str] = []
        self.unused: tuple[str, ...] = ()

    def line(self, text: str = "", comment: str = "", ask: str = "") -> None:
        if ask:
            self.questions.append(ask)
            self.lines.append(f"# ? {ask}")
        if not comment:
            self.lines += [text] if text or not ask else []
        elif not text:
            self.lines.append(f"# {comment}")
        else:
            self.lines.append(f"{text:<38} # {comment}")

    def choice(self, text: str, comment: str = "", ask: str = "") -> None:
        """A line that holds where its ``#``, which no space follows, is taken away."""
        self.line(f"#{text}", comment, ask)


def draft_model(table: Table, machine: Machine | None = None) -> Draft:
    """A commented model file for the machine that a recording shows.

    Columns are told by their names and units; sample time, resolution of the encoder, number of
    joints and a first idea of the inertia come from the numbers. What they cannot tell stands as a
    question, in comments with a ``?``.

    Parameters
    ----------
    table : Table
        As ``read_table`` gives it.
    machine : Machine, optional
        What zendsp's own recording says beside its rows: limits, encoders, delay, MuJoCo model.

    Raises
    ------
    RecordingError
        No column looks like a position.
    """
    groups = groups_of(table)
    position = best_group(groups, Role.POSITION)
    bare = [name for name, values in table.columns.items() if not np.isfinite(values).any()]
    nothing = f"{', '.join(bare)} hold{'s' if len(bare) == 1 else ''} no finite number"
    if position is None:
        raise RecordingError(
            f"{table.path}: no column looks like a position; it has {', '.join(table.columns)}"
            + (f", of which {nothing}. " if bare else ". ")
            + "Name one q, position or theta, or give its unit: 'x1 [rad]'"
        )
    joints = position.values.shape[1]
    known = machine if machine is not None and len(machine.joints) == joints else None
    if known is not None and all(known.slides):
        groups = sliding(groups)
        position = best_group(groups, Role.POSITION) or position
    command = best_group(groups, Role.COMMAND, joints) or best_group(groups, Role.CURRENT, joints)
    command = command and in_order(command, position)
    page = _Page()
    _head(page, table, f"{nothing}: why?" if bare else "")
    for group in (position, command):
        bad = 0 if group is None else int(np.sum(~np.isfinite(group.values)))
        if group is not None and bad:
            page.line(ask=f"{group.names[0]} has {bad} values that are no finite numbers: why?")
    name = (machine.name if machine else table.path.name.partition(".")[0]) or "machine"
    page.line(f"name = {json.dumps(name, ensure_ascii=False)}")
    clock = best_group(groups, Role.TIME)
    step = _sample_time(page, clock, table.path.name)
    page.line()
    linear = position.unit == "m"
    if machine is not None and known is None:
        page.line(ask=_others(machine, position))
    if known is not None and known.model:
        _mujoco(page, known)
    else:
        part = unbroken(clock, len(position.values))
        shown = replace(position, values=position.values[part])
        driven = command and replace(command, values=command.values[part])
        degrees = why_degrees(position, best_group(groups, Role.VELOCITY, joints), clock)
        _mechanism(page, shown, driven, step, linear, known, degrees)
    _actuator(page, command, step, known)
    _sensor(page, position, linear, known)
    page.line()
    page.line(
        comment="The feedback law, where it is known: command = kp (reference - position) - kd"
        " velocity."
    )
    for text in ("[controller]", 'kind = "pd"', "kp = 0.0", "kd = 0.0"):
        page.choice(text)
    _columns(page, table, groups, clock, position, command, joints)
    return Draft("\n".join(page.lines) + "\n", joints, tuple(page.questions), page.unused)


def _head(page: _Page, table: Table, ask: str) -> None:
    """Where the file comes from, and how it is read."""
    page.line(
        comment=f"Model of the machine in {table.path.name}, begun by: zendsp model new"
        f" {shlex.quote(table.path.name)}"
    )
    page.line(
        comment="What the recording cannot tell is asked with a question mark, above its line."
        " docs/models.md explains every key."
    )
    page.line(comment="To make use of a line such as #kp = 0.0, take its # away.")
    for note in table.notes:
        page.line(comment=note)
    if ask:
        page.line(ask=ask)


def _sample_time(page: _Page, clock: Group | None, file: str) -> float:
    if clock is None:
        page.line(
            "sample_time = 0.001", "s", ask="there is no time column: how far are two rows apart?"
        )
        return 1e-3
    if len(clock.values) < 2:
        raise RecordingError(f"{file}: has {len(clock.values)} row; a recording has many")
    steps = np.diff(clock.values[:, 0])
    step = float(np.median(steps))
    if step == 0.0 and not (steps < 0).any():
        raise RecordingError(
            f"{file}: column {clock.names[0]!r} looks like time and stands still at"
            f" {clock.values[0, 0]:.12g}: is it written with too few digits?"
        )
    if not np.isfinite(step) or step <= 0:
        raise RecordingError(
            f"{file}: column {clock.names[0]!r} looks like time and does not run forwards: sort the"
            " rows, or give two runs as two files"
        )
    shown, even = float(f"{step:.6g}"), float(f"{step:.3g}")
    shown = even if abs(even / step - 1) < 1e-3 else shown
    missing = int(np.sum(np.round(steps / step) - 1, where=steps > 1.5 * step, initial=0.0))
    jitter = float(np.std(steps[steps < 1.5 * step])) / step  # as `model check` says of it
    gaps = f", {missing} row{'s' if missing > 1 else ''} missing" if missing else ""
    if shown > 0.1:
        sizes = (1e5, "ns", 1e-9), (100.0, "us", 1e-6), (0.0, "ms", 1e-3)
        unit, factor = next((u, f) for least, u, f in sizes if shown > least)
        clock_name = clock.names[0]
        page.line(
            f"sample_time = {shown * factor:g}", f"s: if {clock_name} is in {unit}",
            ask=f"is that column in {unit}? Its steps are {shown:g}; write its unit:"
            f" '{clock_name} [{unit}]'",
        )
        shown *= factor
    else:
        page.line(
            f"sample_time = {shown:g}",
            f"s: median of {clock.names[0]}"
            + (f", jitter by {100 * jitter:.1f} %" if jitter > 0.02 else "")
            + gaps,
        )
    return shown


def _others(machine: Machine, position: Group) -> str:
    """The question of a recording of some joints of a machine."""
    names = ", ".join(str(joint["name"]) for joint in machine.joints)
    return (
        f"the machine has {counted(len(machine.joints), 'joint')} ({names}), and only"
        f" {', '.join(position.names)} {'looks' if len(position.names) == 1 else 'look'} like a"
        " position: do the others matter? Record all positions as one array, 'q', and all commands"
        " as 'tau'; then what zendsp knows of the machine stands here"
    )


def _mujoco(page: _Page, machine: Machine) -> None:
    """The mechanism of a target that simulates a MuJoCo model."""
    page.line("[mechanism]")
    page.line('kind = "mjcf"')
    page.line(f"file = {json.dumps(machine.model)}", "the model that the target simulated")
    page.line(f"joints = {json.dumps([joint['name'] for joint in machine.joints])}")


def _mechanism(
    page: _Page,
    position: Group,
    command: Group | None,
    step: float,
    linear: bool,
    machine: Machine | None,
    degrees: str,
) -> None:
    joints = position.values.shape[1]
    if machine is not None and (model_folder() / f"{machine.name}.toml").is_file():
        page.line(
            ask=f"zendsp has a model of this machine: is --model {machine.name}.toml what you want?"
        )
    page.line("[mechanism]")
    kinds = "rotary | linear | planar2r | urdf | mjcf | fmu | python"
    page.line(f'kind = "{"linear" if linear else "rotary"}"', kinds, _unit_asked(position, degrees))
    if machine is not None and len(set(machine.slides)) > 1:
        names = (
            f"{joint['name']} {'slides' if slides else 'turns'}"
            for joint, slides in zip(machine.joints, machine.slides, strict=True)
        )
        page.line(
            ask=f"{', '.join(names)}: one kind of numbers has not both; a URDF has"
            ' (kind = "urdf", file = "arm.urdf"), or a MuJoCo model (kind = "mjcf")'
        )
    elif joints > 1:
        page.line(
            comment="",
            ask=f"do the {joints} joints act on one another, as in an arm? Then a URDF says it"
            ' best: kind = "urdf", file = "arm.urdf"; or a MuJoCo model: kind = "mjcf"',
        )
    page.line("[mechanism.parameters]")
    _numbers(page, position, command, step, linear)
    page.line()
    page.line(
        comment="Physics that you know already; names and parameters as in docs/effects.md. What is"
        " missing is for zendsp diagnose to find."
    )
    for text in ("[[effect]]", 'kind = "viscous"', "joint = 1"):
        page.choice(text)
    page.choice("coefficient = { value = 0.01 }", "N s/m" if linear else "N m s/rad")


def _unit_asked(position: Group, degrees: str) -> str:
    """The question after the unit of the position, empty where it has one. ``degrees`` is why it
    looks like degrees.
    """
    name = position.names[0]
    if position.unit in ("rad", "m"):
        return ""
    if degrees:
        return (
            f"{name} has no known unit and looks like degrees ({degrees}): write '{name} [deg]' in"
            " its head, and begin anew"
        )
    if position.unit:
        return (
            f"{name}: the unit {position.unit!r} is not known: write a known one in its head,"
            f" such as '{name} [deg]' or '{name} [mm]', and begin anew"
        )
    return (
        f"{name} has no unit: is it rad, degrees or m? rad is taken; of another write the unit in"
        f" its head, such as '{name} [deg]', and begin anew"
    )


def _numbers(
    page: _Page, position: Group, command: Group | None, step: float, linear: bool
) -> None:
    """Inertia and gravity, as the recording suggests them."""
    key, unit = ("mass", "kg") if linear else ("inertia", "kg m^2")
    ideas = [
        first_idea(position.values[:, j], command.values[:, j], step, linear) if command else None
        for j in range(position.values.shape[1])
    ]
    values = [float(f"{idea.inertia:.3g}") if idea else 0.01 for idea in ideas]
    rough = ROUGH if all(ideas) else 1.0
    torque = command is not None and command.unit in ("N m", "Nm", "N")
    said, ask = unit, f"the recording does not show the {key}: what does the drawing say?"
    if all(ideas):
        shares = ", ".join(f"{idea.share:.0%}" for idea in ideas if idea)
        said = f"{unit}: a first idea; with friction it explains {shares} of the command"
        gain = f"the number below is for a gain of 1: times the actuator's gain it is in {unit}"
        ask = "" if torque else gain
    page.line(f"{key} = {{ {_rough(values, rough)} }}", said, ask=ask)
    gravity = [float(f"{idea.gravity:.3g}") if idea else 0.0 for idea in ideas]
    if not linear and any(gravity):
        page.line(
            f"gravity = {{ {_rough(gravity, ROUGH)} }}", "N m, times sin(q)",
            ask="is q = 0 where it hangs down?",
        )
    elif not linear:
        page.choice(
            "gravity = { value = 0.1 }",
            "N m, times sin(q), q = 0 hanging down; none of this form is seen",
        )


def _rough(values: list[float], share: float) -> str:
    """Numbers, and how well they are known: a calibration that moves them by less is no finding."""
    stds = [float(f"{share * abs(value):.2g}") for value in values]
    return f"value = {_list(values)}, std = {_list(stds)}"


def _actuator(page: _Page, command: Group | None, step: float, machine: Machine | None) -> None:
    page.line()
    page.line("[actuator]")
    if command is None:
        page.line(
            "gain = { value = 1.0, free = false }",
            ask="no column looks like the command: which one is it? (see [columns])",
        )
        return
    if command.unit in ("N m", "Nm", "N"):
        page.line(
            "gain = { value = 1.0, free = false }", f"{command.unit} per {command.unit} of command"
        )
    elif _named_torque(command):
        page.line("gain = { value = 1.0, free = false }", ask=f"is {command.names[0]} in N m (N)?")
    else:
        unit = command.unit or "unit"
        page.line(
            "gain = { value = 1.0, free = false }",
            ask=f"how many N m (N) does one {unit} of {command.names[0]} make?",
        )
    if command.unit:
        page.line(f"unit = {json.dumps(command.unit, ensure_ascii=False)}")
    torque = command.unit in ("N m", "Nm", "N") or _named_torque(command)
    if machine is not None and torque and machine.limits:
        unit = command.unit or "N m (N)"
        page.line(f"limit = {_list(machine.limits)}", f"{unit}: the machine's own")
    else:
        _limit(page, command)
    _delay(page, step, machine)


def _named_torque(command: Group) -> bool:
    """Whether a command without a unit is called as a torque is."""
    return not command.unit and any(word in command.names[0].lower() for word in PREFERRED[:4])


def _limit(page: _Page, command: Group) -> None:
    """Where the drive cuts off, if the recording shows it."""
    peaks = np.max(np.abs(command.values), axis=0)
    cut = np.sum(np.abs(command.values) > 0.9995 * peaks, axis=0) >= SATURATED
    if np.any(cut & (peaks > 0)):
        limits = [float(f"{p:.4g}") if c else 0.0 for p, c in zip(peaks, cut, strict=True)]
        page.line(
            f"limit = {_list(limits)}",
            "the command stayed at this value again and again; 0: none seen",
        )
    else:
        seen = _list([float(f"{p:.3g}") for p in peaks])
        page.choice(
            f"limit = {seen}", "the largest command seen", "where does the drive cut off?"
        )


def _delay(page: _Page, step: float, machine: Machine | None) -> None:
    """How long a command acts, and when it begins to."""
    if machine is not None:
        lag = " and the drive's current loop" if machine.lag else "; add the drive's own, if known"
        page.line(f"hold = {machine.period:.6g}", "s: a sample of the loop")
        page.line(f"delay = {machine.period + machine.lag:.6g}", f"s: one sample{lag}")
        return
    page.line(
        f"hold = {float(f'{step:.6g}'):g}",
        "s: how long a command acts; the sample time, unless the drive is faster",
    )
    page.line(
        "delay = 0.0",
        "s",
        ask="how long until a command acts? One sample is common; on a zendsp target it is one"
        f" ({step:.6g} s where every sample was recorded) and the drive's current loop",
    )


def _sensor(page: _Page, position: Group, linear: bool, machine: Machine | None) -> None:
    page.line()
    page.line("[sensor]")
    steps = [find_resolution(finite(column)) for column in position.values.T]
    units, told = {"m" if linear else "rad"}, "as the numbers are spaced"
    if machine is not None:
        steps = [1.0 / abs(float(joint["counts_per_unit"])) for joint in machine.joints]
        units, told = {str(joint["unit"]) for joint in machine.joints}, "as the machine says"
    unit = " or ".join(sorted(units))
    if all(steps):
        said = f"{unit} per count, {told}"
        turns = [2 * np.pi / s for s in steps]
        if unit == "rad" and all(
            abs(turn - round(turn)) < WHOLE * max(1.0, turn / 1e4) for turn in turns
        ):
            said += (
                f": {', '.join(str(round(turn)) for turn in dict.fromkeys(turns))} counts a turn"
            )
        page.line(f"position_resolution = {_list([float(f'{s:.8g}') for s in steps])}", said)
    else:
        page.choice(
            "position_resolution = 0.001", f"{unit} per count",
            "no steps are seen: what does the encoder resolve?",
        )
    if machine is not None and machine.model:
        return
    page.line(
        'side = "motor"', ask='is the encoder on the motor, or behind gear and spring ("load")?'
    )


def _columns(
    page: _Page,
    table: Table,
    groups: dict[Role, list[Group]],
    clock: Group | None,
    position: Group,
    command: Group | None,
    joints: int,
) -> None:
    page.line()
    page.line("[columns]")
    chosen: dict[str, Group] = {}
    if clock is not None:
        chosen["time"] = clock
    chosen["position"] = position
    if command is not None:
        chosen["command"] = command
    for role in (
        Role.REFERENCE, Role.VELOCITY, Role.CURRENT, Role.TEMPERATURE, Role.TORQUE_MEASURED,
    ):
        group = best_group(groups, role, joints)
        if group is not None and group is not command:
            chosen[role.value] = in_order(group, position)
    behind = [
        g
        for g in groups.get(Role.POSITION, [])
        if g is not position and g.values.shape[1] == joints and is_behind(g)
    ]
    if behind:
        chosen["position_load"] = in_order(behind[0], position)
    for key, group in chosen.items():
        page.line(f"{key} = {group.spec}", group.unit)
    if command is None:
        page.choice('command = "…"')
    used = {name for group in chosen.values() for name in group.names}
    page.unused = tuple(name for name in table.columns if name not in used)
    if page.unused:
        page.line(comment=f"not used: {', '.join(page.unused)}")
    for name, value in list(table.constants.items())[:12]:
        page.line(comment=f"also in the file: {name} = {value:g}")


def _list(values: list[float]) -> str:
    same = values[0] if len(values) == 1 else values
    return json.dumps(same)


def model_name(path: Path) -> Path:
    """Name of the model file for a recording: beside the user, not beside the data."""
    return Path(f"{path.name.partition('.')[0] or 'model'}.toml")
