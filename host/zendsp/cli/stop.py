"""``zendsp stop``: STOP, at once."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from queue import SimpleQueue
from typing import TYPE_CHECKING, TypeAlias

import click

from zendsp.cli.common import (
    acknowledge as acknowledge_trip,
)
from zendsp.cli.common import (
    emit,
    held_target,
    open_target,
    sample_option,
    target_options,
)
from zendsp.cli.completing import targets
from zendsp.cli.entry import LEAST_MEMORY
from zendsp.errors import NotStopped, ZendspError

if TYPE_CHECKING:
    from zendsp.here.stop_page import StopPage
    from zendsp_protocol import messages as m

    _Tell: TypeAlias = Callable[[str, m.Status | NotStopped], None]

LINK_S = 3.0  # for the link to a target of which nothing is known yet
MORE_S = 1.0  # for the link to say more, once the loop itself has said that it stopped
EMERGENCY = "NOT STOPPED: use the machine's emergency stop"
TOO_LITTLE = f"a link needs {LEAST_MEMORY >> 20} MB of addresses: 'ulimit -v' allows less"


@click.command("stop")
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=targets)
@click.option("--acknowledge", is_flag=True, help="Instead, acknowledge an earlier STOP or trip.")
@sample_option
@target_options
def command(
    names: tuple[str, ...],
    acknowledge: bool,
    sample: int | None,
    target: str,
    connect: str | None,
    as_json: bool,
) -> None:
    """STOP: outputs are safe from the next sample on, and stay so until acknowledged.

    NAME is a target, as with --target. Without one it stops every target of yours on this machine,
    and all that $ZENDSP_CONNECT leads to; with --connect, all that is there. A NAME is stopped at
    both, too. At the prompt of "zendsp shell" it stops the target of that prompt, and no other.
    Ends with "stopped, at sample N", or with "NOT STOPPED" and a status other than 0.

    Example:  zendsp stop
    """
    if acknowledge:
        if len(names) > 1:
            raise click.UsageError("acknowledge one target at a time")
        with open_target("".join(names) or target, connect) as t:
            acknowledge_trip(t, sample)
            status = t.status()
            emit(status, as_json, f"{status.state}, drive {status.drive}")
        return
    from zendsp.cli.complaints import say
    from zendsp.here.stopped import stopped

    held = held_target(target, connect)
    if held is not None and not names:
        status = held.stop()
        emit(status, as_json, f"{held.name}: {stopped(status)}")
        return
    asked = _ask_all(names or ((target,) if target else ()), connect)
    several = len(asked) > 1 or isinstance(asked[0], _Place)
    ended: dict[str, m.Status] = {}
    failed = 0
    told = set()
    try:
        for name, how in _ends(asked, whole=as_json):
            head = f"{name}: " if several else ""
            if isinstance(how, NotStopped):
                failed += 1
                say(NotStopped(f"{head}{how}"))
                continue
            before, ended[name] = ended.get(name), how
            more = stopped(how).removeprefix(stopped(before) if before else "").lstrip()
            if more and not as_json and head + more not in told:
                told.add(head + more)
                emit(how, False, head + more)
    except KeyboardInterrupt:
        for one in asked:
            if one.label not in ended:
                say(NotStopped(f"{one.label}: {EMERGENCY} (interrupted before it was known)"))
        raise
    if as_json and ended:
        emit(ended if len(ended) + failed > 1 else ended.popitem()[1], True)
    if failed:
        raise click.exceptions.Exit(2)


@dataclass(frozen=True)
class _Asked:
    """A STOP that was sent to one target, through shared memory where that is possible."""

    name: str
    connect: str | Sequence[str] | None
    page: StopPage | None = None
    before: int = 0  # what the page said
    at: str = ""  # of one of several of this name: where it is
    sample: int | None = None  # at which its loop stopped, where that has said so

    @property
    def label(self) -> str:
        """The target's name, for people."""
        return f"{self.name} at {self.at}" if self.at else self.name

    def end(self, tell: _Tell) -> None:
        """Report the answer of the target's own process, or of a loop that was late."""
        from zendsp.here.stopped import stopped_at

        sample = self.sample
        if _little_memory():
            if sample is None:
                raise NotStopped(f"{EMERGENCY} ({TOO_LITTLE})")
            return
        from zendsp.link import connect as open_link

        try:
            t = open_link(self.name, self.connect, timeout=LINK_S if sample is None else MORE_S)
        except ZendspError:
            if sample is None and self.page is not None:  # of a loop that was late
                sample = self.page.taken(self.before, 0.0)
                if sample is not None:
                    tell(self.label, stopped_at(sample))
            if sample is None:
                raise
            return
        with t:
            tell(self.label, t.stop())


@dataclass(frozen=True)
class _Place:
    """Endpoints at which every target that answers is stopped, except the runs ``but``."""

    label: str  # its endpoint
    but: frozenset[str]

    def end(self, tell: _Tell) -> None:
        """Send STOP to them, and report how each ended."""
        if _little_memory():
            raise NotStopped(f"{EMERGENCY} ({TOO_LITTLE})")
        from zendsp.link.find import there

        found = [
            one for one in there([self.label]) if not one.info or one.info.instance not in self.but
        ]
        _at_once([_Asked(one.name, self.label) for one in found], tell)


def _ask_all(names: Sequence[str], connect: str | None) -> list[_Asked | _Place]:
    """Send STOP to the targets named; without names to those at ``--connect``, or else to every
    target of this computer and those at ``$ZENDSP_CONNECT``. Never waits.
    """
    from zendsp.here.registered import own_entries, remote_endpoints
    from zendsp.here.stop_page import find

    def ask(name: str, connect: str | Sequence[str] | None, here: bool, at: str = "") -> _Asked:
        page = find(name) if here else None  # it needs neither Zenoh nor the target's own process
        return _Asked(name, connect, page, 0 if page is None else page.ask(), at)

    endpoints = remote_endpoints(connect)
    if names:
        meant = [ask(name, connect, bool(own_entries(name, connect))) for name in names]
        others = () if connect or not endpoints else (one for one in meant if one.page is None)
        # where $ZENDSP_CONNECT leads elsewhere, those of this machine too: who names them sees them
        also = [ask(one.name, (), True, "this machine") for one in others if own_entries(one.name)]
        return [*meant, *also]
    entries = [one for one in own_entries() if not connect or {*endpoints} & {*one.endpoints}]
    all_asked: list[_Asked | _Place] = [ask(one.name, (), True) for one in entries]
    ours = {endpoint for one in entries for endpoint in one.endpoints}
    but = frozenset(one.instance for one in entries)
    all_asked += [_Place(endpoint, but) for endpoint in endpoints if endpoint not in ours]
    return all_asked or [ask("", connect, False)]


def _ends(
    asked: Sequence[_Asked | _Place], whole: bool
) -> Iterator[tuple[str, m.Status | NotStopped]]:
    """How each STOP ended, as reported; for each target the last report counts. What its loop
    confirms is reported first, and no link is opened for it unless there is more to say: which trip
    came before, or with ``whole`` the whole status.
    """
    from zendsp.here.stopped import TAKEN_S, stopped_at

    deadline = time.monotonic() + TAKEN_S
    left: list[_Asked | _Place] = []
    for one in asked:
        if isinstance(one, _Asked) and one.page is not None:
            sample = one.page.taken(one.before, max(0.0, deadline - time.monotonic()))
            if sample is not None:
                yield one.label, stopped_at(sample)
                if one.page.by_stop() and not whole:
                    continue
            one = replace(one, sample=sample)
        left.append(one)
    if left:
        yield from _ends_by_link(left)


def _ends_by_link(
    asked: Sequence[_Asked | _Place],
) -> Iterator[tuple[str, m.Status | NotStopped]]:
    """How each STOP ended, as reported by the targets' own processes."""
    words: SimpleQueue[tuple[str, m.Status | NotStopped] | None] = SimpleQueue()

    def all_of_them() -> None:
        _at_once(asked, lambda name, how: words.put((name, how)))
        words.put(None)

    if _little_memory():  # not even for threads
        all_of_them()
    else:
        from zendsp.link.background import background

        background("stop", all_of_them)
    while (word := words.get()) is not None:
        yield word


def _at_once(asked: Sequence[_Asked | _Place], tell: _Tell) -> None:
    """Wait for the end of each STOP in a thread of its own, so that a silent target delays no
    other.
    """
    def end(one: _Asked | _Place) -> None:
        try:
            one.end(tell)
        except NotStopped as error:
            tell(one.label, error)
        except Exception as error:  # whatever it is: nothing says that it stopped
            tell(one.label, NotStopped(f"{EMERGENCY} ({error})"))

    if _little_memory():
        for one in asked:
            end(one)
        return
    from zendsp.link.background import background

    for thread in [background("stop", end, one) for one in asked]:
        thread.join()


def _little_memory() -> bool:
    """Whether the address space is so small that Zenoh and NumPy might hang or end this process."""
    return 0 <= resource.getrlimit(resource.RLIMIT_AS)[0] < LEAST_MEMORY
