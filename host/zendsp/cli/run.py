"""``zendsp run``: compiles, loads and starts a program."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import click

from zendsp.cli.common import (
    emit,
    file_and_values,
    flag_option,
    open_target,
    progress,
    target_options,
)
from zendsp.cli.compile import compiled
from zendsp.cli.completing import programs
from zendsp_protocol.states import ProgramState

if TYPE_CHECKING:
    from zendsp.link import Target


def _finite(_: click.Context, __: click.Parameter, seconds: float | None) -> float | None:
    """Refuse a time that is no number, or endless."""
    if seconds is not None and not math.isfinite(seconds):
        raise click.BadParameter(f"{seconds} is no time in which a program could end")
    return seconds


def _download(target: Target, file: str, flags: tuple[str, ...], values: dict[str, Any]) -> None:
    """Compile, load and set. Of a program that is loaded already, the values are checked before it
    is ended; what another declares is known only once it is loaded.
    """
    from zendsp.errors import Refused, VariableError

    key, before = target.compile(file, flags).key, target.status()
    if values and key == before.program:
        try:
            with suppress(Refused):  # of one that has crashed
                target.variables.check(**values)
        except VariableError as error:
            goes_on = "; what was loaded before goes on running"
            raise VariableError(
                f"{error}{goes_on if before.state == ProgramState.RUNNING else ''}"
            ) from None
    target.load(key)
    try:
        if values:
            target.write(**values)
    except VariableError as error:
        ended = "" if before.state == ProgramState.EMPTY else "; what was loaded before was ended"
        raise VariableError(f"{error}. {file} is loaded and not started{ended}") from None


@click.command("run")
@click.argument("words", nargs=-1, metavar="[FILE]", shell_complete=programs)
@click.option(
    "--set", "assignments", multiple=True, metavar="NAME=VALUE",
    help="Before it starts; several too: --set Kp1=400 Kd1=40.",
)
@click.option(
    "--seconds", type=click.FloatRange(0, min_open=True), callback=_finite,
    help="Pause after this time of the target, and wait for it; Ctrl-C pauses at once.",
)
@flag_option
@target_options
def command(
    words: tuple[str, ...],
    assignments: tuple[str, ...],
    seconds: float | None,
    flags: tuple[str, ...],
    target: str,
    connect: str | None,
    as_json: bool,
) -> None:
    """Compile FILE on the target, load it and start it; without FILE, start what is loaded.

    Waits until it has run for 0.25 s of the target's time, or with --seconds to its end. Exit
    status 1 where it does not compile, trips, is stopped or crashes meanwhile; standard error says
    which.

    Example:  zendsp run pd.c --set Kp1=400 --seconds 10
    """
    from zendsp.errors import RunnerDied
    from zendsp.here.stopped import state_at
    from zendsp.link.programs import late
    from zendsp.physics.codegen.compensation import SHARE, compensates

    file, values = file_and_values(words, assignments)
    with open_target(target, connect, moves=True) as t:
        if file is not None:
            compiled(lambda: _download(t, file, flags, values), as_json, t)
        elif values:
            t.write(**values)
        if file is not None and compensates(t.variables()):
            click.echo(
                f"zendsp: {t.name}: the program adds the torque of a compensation.c, times"
                f" {SHARE} = {t[SHARE]:g} (zendsp set {SHARE}=0 leaves it out)",
                err=True,
            )
        if seconds is None:
            t.programs.begin()
            status = t.watch_start()
        else:
            with progress("running", seconds, as_json) as set_fraction:
                first = t.status()
                t.programs.begin(max(1, round(seconds * first.rate_hz)))
                try:
                    status = t.wait(
                        2.0 * seconds + 10.0,
                        on_status=lambda s: set_fraction((s.t - first.t) / seconds),
                    )
                except KeyboardInterrupt:
                    t.pause()
                    raise
                except RunnerDied:  # open_target says how
                    status = t.status()
        going = status.state == ProgramState.RUNNING
        on = "running" if seconds else "running; it goes on until 'zendsp pause' or 'zendsp stop'"
        emit(status, as_json, on if going else state_at(status))
        if said := late(status):
            click.echo(f"zendsp: {t.name}: {said}", err=True)
        if status.state == ProgramState.CRASHED or status.trip is not None:
            raise click.exceptions.Exit(1)
