"""``zendsp sweep``: the same measurement with many sets of parameters."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from zendsp.cli.common import (
    announcing,
    emit,
    open_target,
    out_option,
    progress,
    target_options,
)
from zendsp.errors import ZendspError
from zendsp_protocol.views import text_table

if TYPE_CHECKING:
    from zendsp.experiment.sweep_result import Sweep


@click.command("sweep")
@click.argument("values", nargs=-1, required=True, metavar="NAME=VALUES...")
@click.option("-c", "--channel", "channels", multiple=True, required=True, help="What is measured.")
@click.option(
    "-s", "--seconds", type=click.FloatRange(0, min_open=True), required=True,
    help="Length of each measurement.",
)
@click.option(
    "--settle", type=click.FloatRange(0), default=0.5, show_default=True, help="Seconds left out."
)
@click.option(
    "--fade", type=click.FloatRange(0.0, 2.0), default=1.0, show_default=True,
    help="Seconds in which each set goes over into the next; 0: at once.",
)
@click.option(
    "-m",
    "--measure",
    "measures",
    multiple=True,
    default=("rms", "max"),
    show_default=True,
    help="rms, max, mean, std or p2p; again for more.",
)
@click.option("--together", is_flag=True, help="Not all combinations: first values, second ones …")
@click.option("--keep", type=click.Path(path_type=Path), help="Folder for every recording.")
@out_option("Write the table (CSV).")
@target_options
def command(
    values: tuple[str, ...],
    channels: tuple[str, ...],
    seconds: float,
    settle: float,
    fade: float,
    measures: tuple[str, ...],
    together: bool,
    keep: Path | None,
    out: Path | None,
    target: str,
    connect: str | None,
    as_json: bool,
) -> None:
    """Try VALUES of parameters on the running program and measure each combination.

    VALUES are 100,200,400 or FIRST:LAST:COUNT: 100:500:5 is 100, 200, 300, 400, 500. Each set is
    faded in, so that no gain steps the torque; at the end the parameters go back in the same way.
    The best set is measured again after the last: differences no larger than those of the same
    values mean nothing. Ctrl-C ends it with the runs that are done by then: they are shown and
    written all the same. Exit status 1 where a limit tripped or the program crashed.

    Example:  zendsp sweep Kp1=500:2500:5 Kd1=60,120 -c e1 -s 2
    """
    from zendsp.experiment.sweep import announced, sweep, tried_of

    tried = tried_of(values)
    said = announced(tried, seconds, settle, together, fade)
    if out is not None and out.suffix.lower() != ".csv":
        raise click.BadParameter(f"{out}: a sweep is written as .csv", param_hint="--out")
    reached: list[Sweep] = []
    with open_target(target, connect, moves=True) as t:
        try:
            with progress("sweep", 2.0, as_json) as tell:
                found = sweep(t, tried, channels, seconds=seconds, settle=settle, fade=fade,
                              measures=measures, together=together, keep=keep,
                              progress=announcing(said, tell), on_run=reached.append)  # fmt: skip
        except (KeyboardInterrupt, ZendspError):  # what was measured until then is not lost
            if reached:
                _tell(reached[-1], out, as_json)
            raise
    _tell(found, out, as_json)
    if found.ended:
        raise click.exceptions.Exit(1)


def _tell(found: Sweep, out: Path | None, as_json: bool) -> None:
    shown = text_table(found.header, found.cells())
    if as_json:
        click.echo(repr(found)[1:-1], err=True)
    emit([run.row() for run in found.rows], as_json, f"{shown}\n{repr(found)[1:-1]}")
    if out is not None:  # last: what was measured is seen where it cannot be written
        found.save(out)
