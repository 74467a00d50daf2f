"""``zendsp drive``: the safe sequence of the drives."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import click

from zendsp.cli.common import acknowledge, emit, open_target, sample_option, target_options
from zendsp.cli.progress import stages
from zendsp.errors import Refused
from zendsp_protocol import messages as m
from zendsp_protocol.states import LATCHED, DriveState, ProgramState

if TYPE_CHECKING:
    from zendsp.link import Target
    from zendsp.link.outside import Outside

ACTIONS = (
    "status", "on", "off", "home", "enable", "disable", "acknowledge", "auto", "take", "host-lost",
)


@click.command("drive")
@click.argument("action", type=click.Choice(ACTIONS), default="status", metavar="[ACTION]")
@click.argument("policy", type=click.Choice(["stop", "hold", "finish"]), required=False)
@click.option(
    "--mode", type=click.Choice(["torque", "velocity"]), default="torque", show_default=True,
    help="Of enable.",
)
@click.option("--force", is_flag=True, help="take: also from another host.")
@sample_option
@target_options
def command(
    action: str,
    policy: str | None,
    mode: str,
    force: bool,
    sample: int | None,
    target: str,
    connect: str | None,
    as_json: bool,
) -> None:
    """Power, home and enable the drives, acknowledge a trip, or say what happens if the commanding
    host is lost.

    ACTION is status, on, off, home, enable, disable, acknowledge, auto, take or host-lost (which
    takes stop, hold or finish).

    off → ready → homed → enabled → running → stopped or tripped. Without ACTION: where the drives
    are, what enabling still needs, and the commands that bring the machine back into motion. A
    command that ends gives the right to command back; "take --force" thus frees it from another
    host. A refusal names each condition.

    \b
    Example:  zendsp load pd.c && zendsp drive on && zendsp drive home && zendsp drive enable
    && zendsp run
    """
    from zendsp.link.joints import joints_of
    from zendsp.link.outside import outside
    from zendsp.link.way_back import HOLD, said, way_back

    with open_target(target, connect, moves=True) as t:
        actions: dict[str, Callable[[], str]] = {
            "on": t.power_on,
            "off": t.power_off,
            "home": lambda: _home(t),
            "enable": lambda: t.enable(mode),
            "disable": t.disable,
            "auto": t.drive_auto,
            "take": lambda: _take(t, force),
        }
        tripped = t.status().trip if action == "acknowledge" else None
        try:
            if action == "acknowledge":
                acknowledge(t, sample)
            elif action == "host-lost":
                click.echo(t.set_host_lost(policy or "stop"), err=True)
            elif action != "status":
                click.echo(actions[action](), err=True)
        finally:
            if t.drive_status().commander == t.link.author:
                with contextlib.suppress(Refused):
                    t.release_command()
        status = t.drive_status()
        seen = t.status()
        lines = [f"{'homing' if seen.homing else status.state}, {_mode(status)}"]
        lines += [
            f"  {'✔' if c.met else '✖'} {c.name}{f': {c.advice}' if c.advice else ''}"
            for c in status.conditions
        ]
        held = seen.state == ProgramState.RUNNING and HOLD in t.variables() and bool(t[HOLD])
        away: Sequence[Outside] = ()
        if seen.state != ProgramState.EMPTY:  # what limits there are is known with a program
            machine, limits = t.machine().joints, t.limits()
            away = outside(seen, machine, limits)
            lines += [f"  ! {joint}" for joint in away]
            lines += ["", repr(joints_of(seen, machine, limits)), ""]
        mover = status.moved_by
        moved = f", moved by {mover}" if mover not in ("", status.commander) else ""
        lines.append(
            f"commanded by {status.commander or 'nobody'}{moved}; if the commanding host is lost:"
            f" {status.host_lost}"
        )
        steps = way_back(seen, status, t.link.author, held, bool(away), tripped)
        if steps:
            lines.append(f"next: {said(steps, target, connect)}")
        emit(status, as_json, "\n".join(lines))


def _home(t: Target) -> str:
    """Home the machine, and say so while it takes."""
    with stages() as tell:
        tell("homing; Ctrl-C ends it")
        return t.home_and_wait()


def _take(t: Target, force: bool) -> str:
    """Take the right to command; as this command ends, it gives it back."""
    t.take_command(force)
    return "taken, and free again: a command that ends gives the right to command back"


def _mode(status: m.DriveStatus) -> str:
    """The mode of the drives in this state, and what changes it without being asked."""
    words = {"off": "no torque", "torque": "torque mode", "velocity": "velocity mode"}
    said = words.get(status.mode, status.mode)
    if status.mode == "velocity" and status.state in LATCHED:
        said = "held at zero speed"
    if not status.explicit:
        return f"{said}; automatic: on at start, off at pause"
    return f"{said} before the program starts" if status.state == DriveState.ENABLED else said
