"""The tables of a drafted model file on drives, sensors and columns."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from zendsp.physics.files.draft_data import (
    ALIKE,
    PREFERRED,
    WHOLE,
    Group,
    Machine,
    best_group,
    finite,
    in_order,
    is_behind,
    one_or_each,
)
from zendsp.physics.files.draft_limit import is_cut_off
from zendsp.physics.files.questions import ASKS
from zendsp.physics.kernel.signals import find_resolution
from zendsp.recording import Table
from zendsp.recording.roles import Role
from zendsp.recording.units import ENCODER
from zendsp_protocol.texts import enumerated, shown

TURN = 2.0 * np.pi  # rad
COUNTS_A_TURN = 4096  # of an encoder of which nothing is known
SAME = 1e-3  # two columns whose RMS difference is a smaller part of them hold the same


class Page:
    """The file as it is written.

    Attributes
    ----------
    lines : list of str
    questions : list of str
        What the recording does not tell; each stands above its line too.
    unused : tuple of str
        Columns that the file leaves.
    """

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.questions: list[str] = []
        self.unused: tuple[str, ...] = ()

    def line(self, text: str = "", comment: str = "", ask: str = "") -> None:
        """Write a line, with a comment beside it and a question above. Names of columns stand in
        both, and may hold what ends a comment.
        """
        comment, ask = shown(comment, lines=False), shown(ask, lines=False)
        if ask:
            self.questions.append(ask)
            self.lines.append(f"{ASKS}{ask}")
        if not comment:
            self.lines += [text] if text or not ask else []
        elif not text:
            self.lines.append(f"# {comment}")
        else:
            self.lines.append(f"{text:<38} # {comment}")

    def choice(self, text: str, comment: str = "", ask: str = "") -> None:
        """A line that holds where its ``#``, which no space follows, is taken away."""
        self.line(f"#{text}", comment, ask)


def put_effects(page: Page, unit: str) -> None:
    """Write how a known effect is stated; ``unit`` is that of a viscous friction."""
    page.line()
    page.line(
        comment="Physics that you know already; names and parameters as in docs/effects.md. What is"
        " missing is for zendsp diagnose to find."
    )
    for text in ("[[effect]]", 'kind = "viscous"', "joint = 1"):
        page.choice(text)
    page.choice("coefficient = { value = 0.01 }", unit)


def put_actuator(
    page: Page, command: Group | None, step: float, machine: Machine | None, lever: bool
) -> None:
    """Write ``[actuator]``; ``step`` is the sample time, s. ``lever``: joints turn by a force."""
    page.line()
    page.line("[actuator]")
    if command is None:
        page.line(
            "gain = { value = 1.0, free = false }",
            ask="no column looks like the command: which one is it? (see [columns])",
        )
        return
    names = ", ".join(name for name in command.names if name)  # empty: nothing drives it
    each = " One for each joint: value = [2.0, 1.5]" if command.values.shape[1] > 1 else ""
    mixed = command.is_torque and ", " in command.unit  # joints that slide and joints that turn
    if lever:
        ask = f"how many N m does one N of {names} make: at which radius, m, does it pull?{each}"
        page.line("gain = { value = 1.0, free = false }", "N m per N of command", ask)
    elif command.is_torque:
        of = "unit" if mixed else command.unit
        page.line("gain = { value = 1.0, free = false }", f"{command.unit} per {of} of command")
    elif _named_torque(command):
        what = f"{'is' if len(command.names) == 1 else 'are'} {names} in N m (N)?"
        page.line("gain = { value = 1.0, free = false }", ask=what)
    else:
        unit = command.unit or "unit"
        page.line(
            "gain = { value = 1.0, free = false }",
            ask=f"how many N m (N) does one {unit} of {names} make?{each}",
        )
    if command.unit and not mixed:
        page.line(f"unit = {json.dumps(command.unit, ensure_ascii=False)}")
    torque = command.is_torque or _named_torque(command)
    if machine is not None and torque and machine.limits:
        unit = command.unit or "N m (N)"
        page.line(f"limit = {listed(machine.limits)}", f"{unit}: the machine's own")
    else:
        _limit(page, command)
    _delay(page, step, machine)


def _named_torque(command: Group) -> bool:
    """Whether a command without a unit is called as a torque is."""
    return not command.unit and any(word in command.names[0].lower() for word in PREFERRED[:4])


def _limit(page: Page, command: Group) -> None:
    """Where the drive cuts off, if the recording shows it."""
    peaks = np.nanmax(np.abs(command.values), axis=0)
    cut = [is_cut_off(column) for column in command.values.T]
    if any(cut):
        limits = [float(f"{p:.4g}") if c else 0.0 for p, c in zip(peaks, cut, strict=True)]
        page.line(
            f"limit = {listed(limits)}",
            "the command stayed at this value again and again; 0: none seen",
        )
    else:
        seen = listed([float(f"{p:.3g}") for p in peaks])
        page.choice(
            f"limit = {seen}", "the largest command seen", "where does the drive cut off?"
        )


def _delay(page: Page, step: float, machine: Machine | None) -> None:
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


def put_sensor(page: Page, position: Group, linear: bool, machine: Machine | None) -> None:
    """Write ``[sensor]``."""
    page.line()
    page.line("[sensor]")
    steps = [find_resolution(finite(column)) for column in position.values.T]
    units, told = ["m" if linear else "rad"], "as the numbers are spaced"
    if ", " in position.unit:
        units = position.unit.split(", ")
    if machine is not None:
        steps = [1.0 / abs(float(joint["counts_per_unit"])) for joint in machine.joints]
        units, told = [str(joint["unit"]) for joint in machine.joints], "as the machine says"
    unit = one_or_each(units)
    in_counts = position.unit in ENCODER and machine is None
    if in_counts:
        each = np.diag([TURN / COUNTS_A_TURN] * len(steps)).round(8).tolist()
        page.choice(
            f"matrix = {each}", f"{unit} per {position.unit.removesuffix('s')}",
            f"how many {unit} is one of the {position.unit}? This and the numbers above are for"
            f" {COUNTS_A_TURN} a turn",
        )  # fmt: skip
    if all(steps) and not in_counts:
        said = f"{unit} per count, {told}"
        turns = [2 * np.pi / s for s in steps]
        if unit == "rad" and all(
            abs(turn - round(turn)) < WHOLE * max(1.0, turn / 1e4) for turn in turns
        ):
            said += (
                f": {', '.join(str(round(turn)) for turn in dict.fromkeys(turns))} counts a turn"
            )
        page.line(f"position_resolution = {listed([float(f'{s:.8g}') for s in steps])}", said)
    else:
        page.choice(
            "position_resolution = 0.001", f"{unit} per count",
            "what does the encoder resolve?"
            if in_counts
            else "no steps are seen: what does the encoder resolve?",
        )
    if machine is not None and machine.model:
        return
    page.line(
        'side = "motor"', ask='is the encoder on the motor, or behind gear and spring ("load")?'
    )


def put_columns(
    page: Page,
    table: Table,
    groups: dict[Role, list[Group]],
    clock: Group | None,
    position: Group,
    command: Group | None,
    joints: int,
) -> None:
    """Write ``[columns]``, and what of the recording is not used."""
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
    used = {name for group in chosen.values() for name in group.names}
    doubt = ""
    if more := _more_joints(groups, position, command, used):
        page.line(ask=more)
    elif command is not None:
        measured = chosen.get(Role.TORQUE_MEASURED.value)
        doubt = "does nothing drive the joint with the empty name?" if "" in command.names else ""
        doubt = doubt or _which_command(command, groups.get(Role.COMMAND, []), measured)
    for key, group in chosen.items():
        page.line(f"{key} = {group.spec}", group.unit, doubt * (group is command))
    if command is None:
        page.choice('command = "…"')
    page.unused = tuple(name for name in table.columns if name not in used)
    if page.unused:
        page.line(comment=f"not used: {', '.join(page.unused)}")
    for name, value in list(table.constants.items())[:12]:
        page.line(comment=f"also in the file: {name} = {value:g}")


def _more_joints(
    groups: dict[Role, list[Group]], position: Group, command: Group | None, used: set[str]
) -> str:
    """The question of further joints, whose names have nothing in common with those of the first:
    positions and commands are left. Empty where they are not.
    """
    names = []
    for first, role in ((position, Role.POSITION), (command, Role.COMMAND)):
        left = [
            name
            for group in groups.get(role, [])
            if not is_behind(group)
            for name in group.names
            if name not in used
        ]
        if first is None or not left:
            return ""
        names.append(json.dumps([*first.names, *left], ensure_ascii=False))
    return (
        f"are there more joints? Then write position = {names[0]} and command = {names[1]}, and"
        " above a number for each joint, in the same order"
    )


def _which_command(command: Group, rivals: Sequence[Group], measured: Group | None) -> str:
    """The question of which column is the command: others could be it, or it is not what was
    measured. Empty where nothing speaks for another.
    """
    others = [g for g in rivals if g is not command and _apart(g, command) > SAME]
    taken = enumerated(command.names)
    asked = f"is {taken} all that the drive was told, every compensation included?"
    if others:
        names = " or ".join(
            f"{enumerated(g.names)} ({_apart(g, command):.0%} apart)" for g in others
        )
        return f"{asked} Or else {names}: then write that one here"
    if measured is not None and (apart := _apart(measured, command)) > ALIKE:
        return (
            f"{asked} {enumerated(measured.names)} is {apart:.0%} apart from it. Where something"
            " was added to it later, write the sum here, or the measured one"
        )
    return ""


def _apart(group: Group, command: Group) -> float:
    """The RMS difference of two groups of the same unit, as a part of the command's; 0 where they
    cannot be compared, or one is constant.
    """
    a, b = group.values, command.values
    if a.shape != b.shape or group.unit != command.unit or not np.nanstd(a, axis=0).any():
        return 0.0
    return float(np.sqrt(np.nanmean((a - b) ** 2) / max(float(np.nanmean(b**2)), 1e-300)))


def listed(values: list[float]) -> str:
    """Numbers as TOML writes them: one by itself, several as a list."""
    same = values[0] if len(values) == 1 else values
    return json.dumps(same)
