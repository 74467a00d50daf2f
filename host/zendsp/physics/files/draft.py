"""Drafts a model file from a recording, with questions where its columns do not say enough."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zendsp.errors import RecordingError
from zendsp.physics.files.draft_data import (
    Group,
    Machine,
    best_group,
    driven_by,
    first_idea,
    groups_of,
    in_order,
    sliding,
    unbroken,
    why_degrees,
)
from zendsp.physics.files.draft_robot import (
    all_commands,
    all_positions,
    by_joints,
    joints_in,
    of_arm,
    put_robot,
)
from zendsp.physics.files.draft_tables import (
    COUNTS_A_TURN,
    TURN,
    Page,
    listed,
    put_actuator,
    put_columns,
    put_effects,
    put_sensor,
)
from zendsp.physics.files.shipped import model_folder
from zendsp.recording import Table
from zendsp.recording.names import told
from zendsp.recording.roles import Role
from zendsp.recording.samples import is_gap
from zendsp.recording.stamps import even_times
from zendsp.recording.units import ENCODER, not_known
from zendsp_protocol.texts import counted

SHORTEST = 1e-6  # s between rows: less are days, as a datenum of MATLAB or a spreadsheet has them
ROUGH = 0.15  # relative standard deviation of a first idea: what is missing bends it


@dataclass(frozen=True)
class Draft:
    """The text of a model file, the questions in it, and the recording's columns that it leaves."""

    text: str
    joints: int
    questions: tuple[str, ...]
    unused: tuple[str, ...] = ()


def draft_model(
    table: Table,
    machine: Machine | None = None,
    robot: Path | None = None,
    folder: Path = Path(),
    typed: str = "",
) -> Draft:
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
    robot : Path, optional
        A URDF or an MJCF of the machine. Columns that name its joints are put in its order.
    folder : Path
        Where the model file will lie.
    typed : str
        The command that begins it, as it stands in its first line; empty: that of the table alone.

    Raises
    ------
    RecordingError
        No column looks like a position.
    ModelError
        The robot has fewer joints than the recording, or its file cannot be taken over.
    """
    groups, position = groups_of(table), None
    if robot is not None:
        groups = of_arm(groups, robot)
        position = all_positions(groups, robot)
    position = position or best_group(groups, Role.POSITION)
    bare = [name for name, values in table.columns.items() if not np.isfinite(values).any()]
    nothing = f"{', '.join(bare)} hold{'s' if len(bare) == 1 else ''} no finite number"
    if position is None:
        raise _no_position(table, groups, f", of which {nothing}" if bare else "")
    joints = position.values.shape[1]
    known = machine if machine is not None and len(machine.joints) == joints else None
    if known is not None and any(known.slides):
        groups = sliding(groups, known.slides)
        position = best_group(groups, Role.POSITION) or position
    groups, command, asked = driven_by(groups, position)
    command = command and in_order(command, position)
    if robot is not None:
        command = command or all_commands(groups, robot)
        joints_there = joints_in(robot)
        position, _ = by_joints(position, joints_there)
        command = command and by_joints(command, joints_there)[0]
    page = Page()
    _head(page, table, typed, f"{nothing}: why?" if bare else "")
    _ask_of_holes(page, [group for group in (position, command) if group is not None])
    if asked and machine is None:
        page.line(ask=asked)
    name = (machine.name if machine else table.path.name.partition(".")[0]) or "machine"
    page.line(f"name = {json.dumps(name, ensure_ascii=False)}")
    clock = best_group(groups, Role.TIME)
    if clock is not None:
        clock = replace(clock, values=even_times(clock.values[:, 0])[:, np.newaxis])
    step = _sample_time(page, clock, table.path.name)
    page.line()
    linear = position.unit.partition(", ")[0] == "m"
    if machine is not None and known is None:
        page.line(ask=_others(machine, position))
    degrees = why_degrees(position, best_group(groups, Role.VELOCITY, joints), clock)
    unit = _unit_asked(position, degrees, table.path.suffix.lower() == ".mat")
    if robot is not None:
        unit *= not {*position.unit.split(", ")} <= {"rad", "m"}  # its file says which joint slides
        put_robot(page, robot, folder, position, unit)
    elif known is not None and known.model:
        _mujoco(page, known)
    else:
        part = unbroken(clock, len(position.values))
        turned = TURN / COUNTS_A_TURN if position.unit in ENCODER and known is None else 1.0
        shown = replace(position, values=turned * position.values[part])
        driven = command and replace(command, values=command.values[part])
        _mechanism(page, shown, driven, step, linear, known, unit)
    lever = command is not None and command.unit == "N" and position.unit == "rad"
    put_actuator(page, command, step, known, lever and robot is None)
    put_sensor(page, position, linear, known)
    _feedback(page)
    put_columns(page, table, groups, clock, position, command, joints)
    return Draft("\n".join(page.lines) + "\n", joints, tuple(page.questions), page.unused)


def _no_position(table: Table, groups: dict[Role, list[Group]], bare: str) -> RecordingError:
    """The error of a recording in which no column looks like a position."""
    said = "".join(f" ({note})" for note in table.notes if "left out" in note)
    speed = best_group(groups, Role.VELOCITY)
    alone = f" A velocity alone ({', '.join(speed.names)}) is not diagnosed." if speed else ""
    return RecordingError(
        f"{table.path}: no column looks like a position; it has"
        f" {', '.join(told(table.columns))}{bare}{said}."
        " Name one q, position or theta, or give its unit: 'x1 [rad]'; a model file of your own"
        f" names any column.{alone}"
    )


def _ask_of_holes(page: Page, groups: Sequence[Group]) -> None:
    for group in groups:
        if bad := int(np.sum(~np.isfinite(group.values))):
            many = "values that are no finite numbers"
            what = many if bad > 1 else "value that is no finite number"
            page.line(ask=f"{group.names[0]} has {bad} {what}: why?")


def _head(page: Page, table: Table, typed: str, ask: str) -> None:
    """Where the file comes from, and how it is read."""
    typed = typed or shlex.join(["zendsp", "model", "new", table.path.name])
    page.line(comment=f"Model of the machine in {table.path.name}, begun by: {typed}")
    page.line(
        comment="What the recording cannot tell is asked with a question mark, above its line."
        " docs/models.md explains every key."
    )
    page.line(comment="To make use of a line such as #kp = 0.0, take its # away.")
    for note in table.notes:
        page.line(comment=note)
    if ask:
        page.line(ask=ask)


def _sample_time(page: Page, clock: Group | None, file: str) -> float:
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
    longest = float(np.max(steps))
    broken = ""
    if (steps < 0).any():
        broken = f"runs backwards at row {int(np.argmax(steps < 0)) + 2}"
    elif is_gap(longest, step):
        broken = f"has a gap of {longest:.3g}{' s' if shown <= 0.1 else ''}"
    if broken:
        page.line(
            ask=f"the time {broken}: two runs in one file?"
            f" '{shlex.join(['zendsp', 'cut', file, '-o', 'part.csv'])}' makes them two, and a"
            " diagnosis takes no other"
        )
    gaps = f", {missing} row{'s' if missing > 1 else ''} missing" if missing else ""
    if shown > 0.1 or shown < SHORTEST:
        sizes = (1e5, "ns", 1e-9), (100.0, "us", 1e-6), (0.1, "ms", 1e-3), (0.0, "days", 86400.0)
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


def _feedback(page: Page) -> None:
    page.line()
    page.line(
        comment="The feedback law, where it is known: command = kp (reference - position) - kd"
        " velocity."
    )
    for text in ("[controller]", 'kind = "pd"', "kp = 0.0", "kd = 0.0"):
        page.choice(text)


def _mujoco(page: Page, machine: Machine) -> None:
    """The mechanism of a target that simulates a MuJoCo model."""
    page.line("[mechanism]")
    page.line('kind = "mjcf"')
    page.line(f"file = {json.dumps(machine.model)}", "the model that the target simulated")
    page.line(f"joints = {json.dumps([joint['name'] for joint in machine.joints])}")


def _mechanism(
    page: Page,
    position: Group,
    command: Group | None,
    step: float,
    linear: bool,
    machine: Machine | None,
    unit: str,
) -> None:
    joints = position.values.shape[1]
    if machine is not None and (model_folder() / f"{machine.name}.toml").is_file():
        page.line(
            ask=f"zendsp has a model of this machine: is --model {machine.name}.toml what you want?"
        )
    page.line("[mechanism]")
    kinds = "rotary | linear | planar2r | urdf | mjcf | fmu | python"
    page.line(f'kind = "{"linear" if linear else "rotary"}"', kinds, unit)
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
        two = ' kind = "planar2r" (numbers p1, p2, p3);' if joints == 2 and not linear else ""
        page.line(
            comment="",
            ask=f"do the {joints} joints act on one another, as in an arm? Then write{two} kind ="
            ' "urdf" or "mjcf" with file = "arm.urdf" or a MuJoCo model; or kind = "fmu" or'
            ' "python" with a simulator of yours',
        )
    page.line("[mechanism.parameters]")
    _numbers(page, position, command, step, linear)
    put_effects(page, "N s/m" if linear else "N m s/rad")


def _unit_asked(position: Group, degrees: str, in_name: bool) -> str:
    """The question after the unit of the position, empty where it has one. ``degrees`` is why it
    looks like degrees. ``in_name``: names hold no brackets, as those of MATLAB.
    """
    one, names = len(position.names) == 1, ", ".join(position.names)
    no_unit = f"{names} {'has' if one else 'have'} no"
    head = ("its " if one else "their ") + ("name" if in_name else "head") + "s" * (not one)
    name, bare = position.names[0], position.names[0].rpartition(".")[2]
    deg, mm = (f"'{bare}_{u}'" if in_name else f"'{name} [{u}]'" for u in ("deg", "mm"))
    if position.unit in ("rad", "m"):
        return ""
    if degrees:
        return (
            f"{no_unit} known unit and looks like degrees ({degrees}): write the unit in"
            f" {head}, as {deg}, and begin anew"
        )
    units = position.unit.split(", ")
    if len(units) > 1 and all(unit in ("rad", "m") for unit in units):
        return (
            f"{', '.join(position.names)}: {position.unit}. Joints that slide beside joints that"
            ' turn are described by kind = "urdf" or "mjcf" and its file: write them'
        )
    if position.unit in ENCODER:
        return ""  # asked in [sensor]
    if position.unit:
        return (
            f"{names}: {not_known(position.unit)}. Write one of them in {head}, such as"
            f" {deg} or {mm}, and begin anew"
        )
    if (position.values == np.round(position.values)).all():  # of an integer type, say
        counts = f"'{bare}_counts'" if in_name else f"'{name} [counts]'"
        return (
            f"{no_unit} unit and whole numbers alone: is it in counts? rad is taken; write the unit"
            f" in {head}, as {counts}, and begin anew"
        )
    return (
        f"{no_unit} unit: is it rad, degrees or m? rad is taken; of another write the unit in"
        f" {head}, such as {deg}, and begin anew"
    )


def _numbers(
    page: Page, position: Group, command: Group | None, step: float, linear: bool
) -> None:
    """Inertia and gravity, as the recording suggests them."""
    key, unit = ("mass", "kg") if linear else ("inertia", "kg m^2")
    ideas = [
        first_idea(position.values[:, j], command.values[:, j], step, linear) if command else None
        for j in range(position.values.shape[1])
    ]
    values = [float(f"{idea.inertia:.3g}") if idea else 0.01 for idea in ideas]
    rough = ROUGH if all(ideas) else 1.0
    torque = command is not None and command.is_torque and (linear or command.unit != "N")
    many = len(ideas) > 1
    hidden = [str(j + 1) for j, idea in enumerate(ideas) if idea is None]
    of = f" of joint {', '.join(hidden)}" if many and len(hidden) < len(ideas) else ""
    said, ask = unit, ""
    if hidden:
        ask = f"the recording does not show the {key}{of}: what does the drawing say?"
    else:
        shares = ", ".join(f"{idea.share:.0%}" for idea in ideas if idea)
        said = f"{unit}: a first idea; with friction it explains {shares} of the command"
    seen = f"{'numbers' if many else 'number'} below {'are' if many else 'is'}"
    gained = "" if torque else f"the {seen} for a gain of 1: times the actuator's gain"
    if gained and len(hidden) < len(ideas):
        ask += f" And {gained} it is in {unit}" if ask else f"{gained} it is in {unit}"
    page.line(f"{key} = {{ {_rough(values, rough)} }}", said, ask=ask)
    gravity = [float(f"{idea.gravity:.3g}") if idea else 0.0 for idea in ideas]
    if not linear and any(gravity):
        page.line(
            f"gravity = {{ {_rough(gravity, ROUGH)} }}", "N m, times sin(q)",
            ask="is q = 0 where it hangs down?" + (f" And {gained} it is in N m" if gained else ""),
        )
    elif not linear:
        page.choice(
            "gravity = { value = 0.1 }",
            "N m, times sin(q), q = 0 hanging down; none of this form is seen",
        )


def _rough(values: list[float], share: float) -> str:
    """Numbers, and how well they are known: a calibration that moves them by less is no finding."""
    stds = [float(f"{share * abs(value):.2g}") for value in values]
    return f"value = {listed(values)}, std = {listed(stds)}"


def model_name(path: Path) -> Path:
    """Name of the model file for a recording: beside the user, not beside the data."""
    return Path(f"{path.name.partition('.')[0] or 'model'}.toml")
