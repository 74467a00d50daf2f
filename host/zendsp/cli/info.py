"""``zendsp info``: a target, its program, and its variables."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress

import click

from zendsp.cli.common import emit, open_target, target_options
from zendsp.cli.completing import targets
from zendsp.errors import RunnerDied
from zendsp.link.listings import Dictionary
from zendsp_protocol import messages as m
from zendsp_protocol.states import ProgramState, VariableKind
from zendsp_protocol.values import Value
from zendsp_protocol.views import short, text_table

LATE = 100  # one sample late or left out in so many is told


@click.command("info")
@click.argument("name", default="", metavar="[NAME]", shell_complete=targets)
@target_options
def command(name: str, target: str, connect: str | None, as_json: bool) -> None:
    """Show a target: machine, state, program, and its variables with their values.

    NAME is a target, as with --target.

    Example:  zendsp info imi
    """
    from zendsp.link.outside import Outside, outside
    from zendsp.link.way_back import HOLD, said, way_back

    with open_target(name or target, connect) as t:
        status = t.status()
        # what there is to say of machine and variables comes from the code that runs
        none = status.state == ProgramState.EMPTY
        variables, machine = ({}, None) if none else (t.variables(), t.machine())
        sources = t.program().sources if status.program else {}
        readable = [v.name for v in variables.values() if v.kind != VariableKind.TABLE]
        values: dict[str, Value] = {}
        away: Sequence[Outside] = ()
        with suppress(RunnerDied):  # what it left cannot be read; that it crashed is in the status
            values |= t.request("read", names=readable).values if readable else {}
            away = outside(status, machine.joints, t.limits()) if machine else ()
        held = status.state == ProgramState.RUNNING and bool(values.get(HOLD))
        drive = t.drive_status()
        left = way_back(status, drive, t.link.author, held, bool(away))
        steps = said(left, name or target, connect)
        body = {
            "info": t.info,
            "status": status,
            "machine": machine,
            "variables": list(variables.values()),
            "values": values,
            "outside": list(map(str, away)),
        }
        who = " and ".join(sorted({drive.commander, drive.moved_by} - {""}))
        further = [
            *([f"command    {who}; if that host is lost: {drive.host_lost}"] if who else []),
            *(f"outside    {joint}" for joint in away),
            *(f"note       {sentence}" for sentence in status.own),
            *([f"next       {steps}"] if steps else []),
        ]
        emit(
            body, as_json,
            lambda: _text(t.info, status, machine, variables, values, sources, further),
        )


def _program(key: str, sources: Collection[str]) -> str:
    """The program as the names of its C files and the first characters of its key."""
    if not key:
        return "none: load one with zendsp run or zendsp load"
    named = ", ".join(name for name in sources if name.endswith(".c"))
    return f"{named or 'without its source'} ({key[:12]})"


def _text(
    info: m.Info,
    status: m.Status,
    machine: m.MachineInfo | None,
    variables: Mapping[str, m.VariableInfo],
    values: Mapping[str, Value],
    sources: Collection[str],
    further: Sequence[str],
) -> str:
    if machine is None:
        described = f"{status.machine} (joints and variables are known when a program is loaded)"
    else:
        joints = ", ".join(f"{j.name} ({j.unit})" for j in machine.joints)
        what = f"{machine.name}: {machine.text}" if machine.text else machine.name
        described = f"{what.removesuffix('.')}; {joints}"
    lines = [
        (
            f"target     {info.name} on {info.hostname}, process {info.pid}, zendsp"
            f" {info.versions.get('zendsp', '?')}"
        ),
        f"machine    {described}",
        f"loop       {status.rate_hz:g} Hz, {status.clock} clock"
        + (f"; {status.scheduling}" if status.scheduling else ""),
        f"state      {status.doing}, tick {status.tick}, drive {status.drive}",
        f"program    {_program(status.program, sources)}",
        f"hosts      {', '.join(status.hosts) or 'none'}",
    ]
    t = status.timing
    if (t.overruns + t.missed) * LATE > t.ticks:
        left_out = f", {t.missed} were left out" if t.missed else ""
        took = f"{t.overruns} of {t.ticks} samples took longer than the period"
        lines.append(f"late       {took}{left_out}: 'zendsp stats' has the times")
    if status.crash:
        lines.append(f"crash      {status.crash}")
    elif status.unsafe:
        lines.append(f"unsafe     {status.unsafe}")
    if status.trip is not None:
        lines.append(f"trip       {status.trip.text}")
    return "\n".join([*lines, *further]) + (f"\n\n{_table(variables, values)}" if variables else "")


def _table(variables: Mapping[str, m.VariableInfo], values: Mapping[str, Value]) -> str:
    """The variables with their values, as a table."""
    listed = Dictionary(variables)
    header = (*listed.header[:3], "VALUE", *listed.header[3:])
    rows = [
        (*row[:3], short(values[row[0]]) if row[0] in values else "–", *row[3:])
        for row in listed.rows()
    ]
    return text_table(header, rows)
