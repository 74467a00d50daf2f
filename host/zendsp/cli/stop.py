"""``zendsp stop``: STOP, at once."""

from __future__ import annotations

import click

from zendsp.cli.common import emit, open_target, target_options
from zendsp.errors import NotStopped, ZendspError


@click.command("stop")
@click.option("--acknowledge", is_flag=True, help="Instead, acknowledge an earlier STOP or trip.")
@target_options
def command(acknowledge: bool, target: str, connect: str | None, as_json: bool) -> None:
    """STOP: outputs are safe from the next sample on, and stay so until acknowledged.

    Ends with "stopped, at sample N", or with "NOT STOPPED" and a status other than 0.

    Example:  zendsp stop
    """
    if acknowledge:
        with open_target(target, connect) as t:
            t.acknowledge()
            status = t.status()
            emit(status, as_json, f"{status.state}, drive {status.drive}")
        return
    from zendsp.link.programs import TAKEN_S, stopped, stopped_at
    from zendsp.link.stop_page import here

    page = here(target, connect)  # first: it needs neither Zenoh nor the target's own process
    sample = None if page is None else page.taken(page.ask(), TAKEN_S)
    from zendsp.link import connect as open_link

    try:
        t = open_link(target, connect)
    except ZendspError as error:
        if sample is None:
            raise NotStopped(f"NOT STOPPED: use the machine's emergency stop ({error})") from error
        status = stopped_at(sample)
    else:
        with t:
            status = t.stop()
    emit(status, as_json, stopped(status))
