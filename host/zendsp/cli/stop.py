"""``zendsp stop``: STOP, at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from zendsp.cli.common import emit, open_target, target_options
from zendsp.cli.completing import targets
from zendsp.errors import NotStopped, ZendspError

if TYPE_CHECKING:
    from zendsp.link.stop_page import StopPage
    from zendsp_protocol import messages as m


@click.command("stop")
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=targets)
@click.option("--acknowledge", is_flag=True, help="Instead, acknowledge an earlier STOP or trip.")
@target_options
def command(
    names: tuple[str, ...], acknowledge: bool, target: str, connect: str | None, as_json: bool
) -> None:
    """STOP: outputs are safe from the next sample on, and stay so until acknowledged.

    NAME is a target, as with --target. Without one it stops every target of yours on this machine.
    Ends with "stopped, at sample N", or with "NOT STOPPED" and a status other than 0.

    Example:  zendsp stop
    """
    if acknowledge:
        if len(names) > 1:
            raise click.UsageError("acknowledge one target at a time")
        with open_target("".join(names) or target, connect) as t:
            t.acknowledge()
            status = t.status()
            emit(status, as_json, f"{status.state}, drive {status.drive}")
        return
    from zendsp.link.programs import stopped

    all_asked = [_ask(name, connect) for name in names or _meant(target, connect)]
    if len(all_asked) == 1:
        status = all_asked[0].end()
        emit(status, as_json, stopped(status))
        return
    ended: dict[str, m.Status] = {}
    failed = []
    for asked in all_asked:
        try:
            ended[asked.name] = asked.end()
        except NotStopped as error:
            failed.append(f"{asked.name}: {error}")
    emit(ended, as_json, "\n".join(f"{name}: {stopped(status)}" for name, status in ended.items()))
    if failed:
        raise NotStopped("; ".join(failed))


def _meant(target: str, connect: str | None) -> list[str]:
    """Return which targets the user means: without a name all of this machine."""
    from zendsp.link.find import remote_endpoints
    from zendsp.link.registered import local_entries

    if target or remote_endpoints(connect):
        return [target]
    return [entry.name for entry in local_entries()] or [target]


@dataclass(frozen=True)
class _Asked:
    """A STOP that was asked of one target, through shared memory where that can be."""

    name: str
    connect: str | None
    page: StopPage | None
    before: int  # what the page said

    def end(self) -> m.Status:
        """Wait until it has stopped; ask over the link too."""
        from zendsp.link import connect as open_link
        from zendsp.link.programs import TAKEN_S, stopped_at

        sample = None if self.page is None else self.page.taken(self.before, TAKEN_S)
        try:
            t = open_link(self.name, self.connect)
        except ZendspError as error:
            if sample is None:
                raise NotStopped(
                    f"NOT STOPPED: use the machine's emergency stop ({error})"
                ) from error
            return stopped_at(sample)
        with t:
            return t.stop()


def _ask(name: str, connect: str | None) -> _Asked:
    from zendsp.link.stop_page import here

    page = here(name, connect)  # it needs neither Zenoh nor the target's own process
    return _Asked(name, connect, page, 0 if page is None else page.ask())
