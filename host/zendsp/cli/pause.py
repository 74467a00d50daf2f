"""``zendsp pause``."""

from __future__ import annotations

import click

from zendsp.cli.common import emit, open_target, target_options


@click.command("pause")
@target_options
def command(target: str, connect: str | None, as_json: bool) -> None:
    """Pause the program: outputs are safe, variables keep their values; 'zendsp run' goes on.

    Example:  zendsp pause
    """
    from zendsp.here.stopped import state_at

    with open_target(target, connect, moves=True) as t:
        t.pause()
        status = t.status()
        emit(status, as_json, state_at(status))
