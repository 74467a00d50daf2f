"""``zendsp stop``: STOP, at once."""

from __future__ import annotations

import click

from zendsp.cli.common import emit, open_target, target_options


@click.command("stop")
@click.option("--acknowledge", is_flag=True, help="Instead, acknowledge an earlier STOP or trip.")
@target_options
def command(acknowledge: bool, target: str, connect: str | None, as_json: bool) -> None:
    """STOP: outputs are safe from the next sample on, and stay so until acknowledged.

    Example:  zendsp stop
    """
    with open_target(target, connect) as t:
        if acknowledge:
            t.acknowledge()
        else:
            t.stop()
        status = t.status()
        emit(status, as_json, f"{status.state}, drive {status.drive}")
