"""``zendsp bridge``: shows a target in other viewers."""

from __future__ import annotations

import time
from pathlib import Path

import click

from zendsp.cli.common import emit, open_target, target_options
from zendsp.cli.completing import variables


def until_ctrl_c() -> None:
    """Wait for Ctrl-C. ``signal.pause`` would miss one that comes just before it."""
    while True:
        time.sleep(0.2)


@click.group("bridge")
def command() -> None:
    """Show a running target in other viewers. Each needs its extra (pip install '.[foxglove]').

    Example:  zendsp bridge foxglove -t imi
    """


@command.command("foxglove")
@click.argument("channels", nargs=-1, shell_complete=variables)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=8765, show_default=True,
    help="On the loopback; 0: any that is free.",
)
@click.option("--rate", type=float, default=100.0, show_default=True, help="Rows a second.")
@click.option("--write", is_flag=True, help="Viewers may write parameters.")
@target_options
def foxglove(
    channels: tuple[str, ...],
    port: int,
    rate: float,
    write: bool,
    target: str,
    connect: str | None,
    as_json: bool,
) -> None:
    """Serve Foxglove and PlotJuggler.

    They get signals, parameters and events, until Ctrl-C. CHANNELS are signals; without them, all
    of the program. The server listens on 127.0.0.1 only: from another computer use ssh -L. It lets
    in your own viewers, no other user of this computer and no foreign web page. Parameters are read
    only without --write. Needs the extra foxglove.

    Example:  zendsp bridge foxglove q tau -t imi
    """
    from zendsp.bridge import foxglove as serve

    with (
        open_target(target, connect) as t,
        serve(t, channels, port=port, rate=rate, writable=write) as bridge,
    ):
        words = (
            f"{t.name} at {bridge.url} (Foxglove: Open connection, Foxglove WebSocket;"
            " PlotJuggler: Streaming, Foxglove Bridge)"
        )
        emit({"url": bridge.url, "target": t.name}, as_json, words)
        until_ctrl_c()


@command.command("rerun")
@click.argument("channels", nargs=-1, shell_complete=variables)
@click.option(
    "--save",
    type=click.Path(path_type=Path),
    help="Write this .rrd file; without it, to the viewer that runs here.",
)
@click.option("--rate", type=float, default=100.0, show_default=True, help="Rows a second.")
@target_options
def rerun(
    channels: tuple[str, ...],
    save: Path | None,
    rate: float,
    target: str,
    connect: str | None,
    as_json: bool,
) -> None:
    """Show signals in Rerun, or write its file.

    It goes on until Ctrl-C. CHANNELS are signals; without them, all of the program that is loaded.
    'rerun --bind 127.0.0.1' starts a viewer that only this computer reaches. Needs the extra rerun.

    Example:  zendsp bridge rerun q tau -t imi --save run.rrd
    """
    from zendsp.bridge import rerun as show

    with open_target(target, connect) as t, show(t, channels, rate=rate, save=save):
        where = save if save is not None else "the Rerun viewer"
        emit({"target": t.name, "to": str(where)}, as_json, f"{t.name} to {where}; Ctrl-C ends it")
        until_ctrl_c()
