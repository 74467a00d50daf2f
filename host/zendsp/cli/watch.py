"""``zendsp watch``: follow channels live."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from zendsp.cli.common import emit, open_target, target_options, trouble_of
from zendsp.cli.completing import variables
from zendsp.cli.lines import fitted
from zendsp_protocol.states import ProgramState
from zendsp_protocol.views import short

if TYPE_CHECKING:
    from zendsp.link import LiveView, Target

WAITS = "waiting for samples"
ASK_S = 1.0  # between questions to the target: it may be stopped, or gone


@click.command("watch")
@click.argument("channels", nargs=-1, required=True, shell_complete=variables)
@click.option(
    "--interval", type=click.FloatRange(min=0.001), default=0.1, show_default=True, metavar="S",
    help="Between lines.",
)
@click.option(
    "--count", type=click.IntRange(min=0), default=0, metavar="N",
    help="End after N lines (default: never).",
)
@target_options
def command(
    channels: tuple[str, ...],
    interval: float,
    count: int,
    target: str,
    connect: str | None,
    as_json: bool,
) -> None:
    """Follow channels until Ctrl-C: one line for each interval in which rows came; on a terminal
    one that changes, or as many as they need. What stops the program is said at once. Ends with a
    status other than 0 where the target is gone, or no longer lets you in.

    Example:  zendsp watch q tau --interval 0.2
    """
    rewrite = sys.stdout.isatty() and not as_json
    with (
        open_target(target, connect) as t,
        t.live(list(channels), interval=min(interval, 0.05), history=1.0) as view,
    ):
        shown, back, told, waited = 0, "", "", ""
        due = asked = time.monotonic()
        last, came = -1.0, due  # time of the newest row, and since when it is the newest
        while not count or shown < count:
            time.sleep(max(0.0, due - time.monotonic()))
            due += interval
            if time.monotonic() > asked + ASK_S:
                before, told = told, _trouble(t, told, "\n" if back else "")
                back = back if told in ("", before) else ""
                asked = time.monotonic()
            newest = view.latest()
            if not newest:
                newest = _first(t, view)
                due = time.monotonic() + interval  # from the first rows on
            new, now = newest["t"] != last, time.monotonic()
            last, came = newest["t"], now if new else came
            still = WAITS if now > came + ASK_S else ""  # an old row is no new line
            if not (new or rewrite):
                waited = _say_once(t, view, still, waited)
                continue
            waited = ""
            parts = [
                f"{name} {short(value):>12} {unit}".rstrip()
                for (name, value), unit in zip(newest.items(), ("s", *view.units), strict=False)
            ] + [f"({still})"] * bool(still)
            if rewrite:
                lines = in_rows(parts, shutil.get_terminal_size().columns)
                click.echo(f"{back}\x1b[J" + "\n".join(lines), nl=False)
                back = f"\x1b[{len(lines) - 1}A\r" if len(lines) > 1 else "\r"
            else:
                emit(newest, as_json, "  ".join(parts))
            shown += 1
        if rewrite:
            click.echo()


def in_rows(parts: Sequence[str], width: int) -> list[str]:
    """The parts in rows of at most ``width`` columns: a line that the terminal itself wraps could
    not be overwritten.

    Examples
    --------
    >>> in_rows(["q 1 rad", "qd 2 rad/s", "tau 3 N m"], 24)
    ['q 1 rad  qd 2 rad/s', 'tau 3 N m']
    """
    rows = [parts[0]]
    for part in parts[1:]:
        joined = f"{rows[-1]}  {part}"
        if len(joined) < width:
            rows[-1] = joined
        else:
            rows.append(part)
    return [row[: width - 1] for row in rows]


def _say_once(target: Target, view: LiveView, text: str, told: str) -> str:
    """Say why no rows come, unless that was said already; return what was said."""
    if text and not told:
        click.echo(_waiting(target, view), err=True)
    return text or told


def _waiting(target: Target, view: LiveView) -> str:
    """That no rows come, and what may be why: the state of the program, or another program."""
    state = target.status().state
    if state != ProgramState.RUNNING:
        return f"{WAITS}: the program is {state}"
    had = target.builtins() | target.variables()
    names = dict.fromkeys(name.partition("[")[0] for name in view.columns)
    gone = ", ".join(name for name in names if name not in had)
    return f"{WAITS}: the program " + (f"has no {gone} now" if gone else "runs")


def _trouble(target: Target, told: str, begin: str = "") -> str:
    """What stopped the program, which is said once; an error says that the target is gone."""
    said = trouble_of(target)[1]
    if said not in ("", told):
        click.echo(begin + fitted(f"zendsp: {target.name}: {said}", sys.stderr), err=True)
    return said


def _first(target: Target, view: LiveView) -> dict[str, float]:
    """Wait for the first rows, and say why none come."""
    told, waits = "", False
    while view.next_block(ASK_S) is None:
        told = _trouble(target, told)
        if not (told or waits):
            click.echo(_waiting(target, view), err=True)
            waits = True
    return view.latest()
