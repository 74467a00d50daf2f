"""``zendsp set``: change variables, all in one sample."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import click

from zendsp.cli import completing
from zendsp.cli.common import emit, open_target, parse_assignments, target_options
from zendsp_protocol.states import ProgramState

if TYPE_CHECKING:
    from zendsp.link import Target

ACTS_S = 0.2  # for the loop to run the sample after the one in which values were set


@click.command("set")
@click.argument(
    "assignments", nargs=-1, required=True, metavar="NAME=VALUE...",
    shell_complete=completing.assignments,
)
@click.option(
    "--no-wait", is_flag=True, help="Do not wait for the sample at which they take effect."
)
@click.option(
    "--fade", type=click.FloatRange(0.0, 2.0), default=0.0, show_default=True,
    help="Seconds in which numbers go over to their new values while the program runs.",
)
@target_options
def command(
    assignments: tuple[str, ...],
    no_wait: bool,
    fade: float,
    target: str,
    connect: str | None,
    as_json: bool,
) -> None:
    """Change variables, all at the start of one sample or none of them.

    \b
    Examples:
      zendsp set Kp1=450 Kd1=40 --fade 0.5
      zendsp set 'K=[[1, 2], [3, 4]]' 'L[0]=0.5'  (of a program with a matrix K and a vector L)
    """
    values = parse_assignments(assignments)
    with open_target(target, connect, moves=True) as t:
        if no_wait:
            emit({"sequence": t.write(**values)}, as_json)
            return
        tick = t.fade(fade, **values) if fade else t.update(None, **values)
        at = f"at sample {tick}, the end of the fade" if fade else f"at sample {tick}"
        emit({"tick": tick, "values": values}, as_json, f"{', '.join(values)} set {at}")
        _see_it_act(t, tick)


def _see_it_act(target: Target, tick: int) -> None:
    """Wait for the sample after ``tick``, so that a trip caused by the new values is reported when
    the link closes.
    """
    until = time.monotonic() + ACTS_S
    while time.monotonic() < until:
        status = target.status()
        if status.state != ProgramState.RUNNING or status.trip or status.tick > tick + 1:
            return
        time.sleep(0.002)
