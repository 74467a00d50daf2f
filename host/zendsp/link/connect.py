"""``connect`` to a running target, or start one on this computer with ``local``."""

from __future__ import annotations

import json
import os
import sys
import time
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING

from zendsp.errors import LinkError
from zendsp.here.registered import CONNECT, local_entries, own_entries, remote_endpoints
from zendsp.link.background import background
from zendsp.link.find import reach, there, unreachable
from zendsp.link.link import Link
from zendsp.link.settings import Credentials
from zendsp.link.target import Target
from zendsp_protocol.lazily import Lazily

if TYPE_CHECKING:
    import select
    import subprocess
    import tempfile
else:  # only local() starts anything
    select, subprocess, tempfile = map(Lazily, ("select", "subprocess", "tempfile"))

WHERE = f"{CONNECT}=tls/robot.lab:7447, for example"
LISTED = 8  # targets that a message names
# for a target to come up, on a machine that is busy with everything else and has to compile it
# first; one that ends is told at once
START_S = 150.0
END_S = 5.0
_started: weakref.WeakKeyDictionary[Target, str] = weakref.WeakKeyDictionary()  # by local()


def connect(
    name: str = "",
    connect: str | Sequence[str] | None = None,
    credentials: Credentials | None = None,
    timeout: float = 3.0,
    shown: bool = True,
) -> Target:
    """Connect to a running target.

    Parameters
    ----------
    name : str
        Name of the target; may be left out where only one runs on this machine.
    connect : str or sequence of str, optional
        Zenoh endpoints, for example ``"tls/robot.lab:7447"``. Default: ``$ZENDSP_CONNECT``, else
        the entry that a target on this machine leaves in the user's runtime directory.
    credentials : Credentials, optional
        Default: from the environment (``ZENDSP_TLS_CA``, ``ZENDSP_USER``, …).
    timeout : float, s
    shown : bool
        Stand among the hosts of the target's status; a second link of the same program need not.

    Raises
    ------
    LinkError
        No such target, or nothing answers.
    VersionMismatch
        It speaks another version of the protocol.

    Examples
    --------
    >>> import zendsp
    >>> with zendsp.connect("imi") as target:    # doctest: +SKIP
    ...     target["Kp1"] = 400.0
    """

    def given(own: Credentials | None) -> Credentials:
        return credentials or own or Credentials.from_environment()

    def reopen() -> Link:
        _, endpoints, own = locate(name, connect)
        return Link(name, endpoints, given(own), timeout, shown)

    asked = name
    try:
        name, endpoints, own = locate(name, connect)
        return Target(Link(name, endpoints, given(own), timeout, shown), reopen=reopen)
    except LinkError as error:
        if connect is None and (hint := _not_asked(asked)):
            raise LinkError(f"{hint}. There: {error}") from error
        raise


def _not_asked(name: str) -> str:
    """A hint for an error: the target of this computer that may have been meant, where
    ``$ZENDSP_CONNECT`` names another place.
    """
    here = [entry.name for entry in own_entries(name)] if remote_endpoints(None) else []
    if not here:
        return ""
    some = f"{', '.join(here[:LISTED])} run{'s' if len(here) == 1 else ''}"
    return (
        f"{some} on this computer, but ${CONNECT} leads to {', '.join(remote_endpoints(None))}: to"
        f" stay here, unset {CONNECT}"
    )


def locate(
    name: str, connect: str | Sequence[str] | None = None
) -> tuple[str, list[str], Credentials | None]:
    """Name and endpoints of the target that is meant, and for a target of this computer the
    credentials of its own user.
    """
    entries = {entry.name: entry for entry in local_entries()}
    endpoints = remote_endpoints(connect)
    if endpoints:
        if name:
            return name, endpoints, None
        own = own_entries(name, endpoints)
        if own and Credentials.from_environment() == Credentials():
            return own[0].name, endpoints, reach(own[0])[1]
        names = [found.name for found in there(endpoints)]
        if len(names) > 1:
            raise LinkError(
                f"name the target: at {', '.join(endpoints)} there are {', '.join(names)}"
            )
        return names[0], endpoints, None
    more = len(entries) - LISTED
    running = ", ".join(list(entries)[:LISTED]) or f"none of {_user()}"
    running += f" and {more} more, see 'zendsp ls'" if more > 0 else ""
    if not name:
        if not entries:
            raise LinkError(
                f"no target of {_user()} runs on this machine (a user finds none of others). Start"
                f" one with 'zendsp target', or say where it is: {WHERE}"
            )
        if len(entries) > 1:
            raise LinkError(f"name the target: on this machine there run {running}")
        name = next(iter(entries))
    if name not in entries:
        raise LinkError(
            f"no target named {name!r} runs on this machine (there runs {running}). Start one with "
            f"'zendsp target --name {name}', or say where it is: {WHERE}"
        )
    if problem := unreachable(entries[name]):
        raise LinkError(problem)
    return name, *reach(entries[name])


def _user() -> str:
    """Whose targets are looked for: under sudo, not those of who typed it."""
    import pwd

    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # a user without a name, as in a container
        return f"user {os.getuid()}"


def local(
    machine: str = "imi_planar",
    clock: str = "real",
    rate: float = 1000.0,
    name: str = "",
    options: Sequence[str] = (),
    timeout: float = START_S,
) -> Target:
    """Start a target process on this computer, which only this user can reach, and connect to it.

    It ends when the returned target is closed or no longer referred to, and also when this process
    dies in any way.

    Parameters
    ----------
    machine : str
        A shipped one, for example ``"imi_planar"``; a ``.c`` file, or a MuJoCo model (``.xml``).
    clock : str
        ``"real"``, or ``"fast"``: as fast as the CPU allows, with identical results.
    rate : float, Hz
    name : str
        Default: machine and process number.
    options : sequence of str
        Further arguments of ``python -m zendsp_target``.
    timeout : float, s
        For it to come up.

    Returns
    -------
    Target

    Raises
    ------
    LinkError
        The target did not come up; with what it said.

    Examples
    --------
    >>> import zendsp
    >>> with zendsp.local("imi_planar", clock="fast") as target:    # doctest: +SKIP
    ...     target.download("pd.c")
    """
    name = name or f"{Path(machine).stem}-{os.getpid()}-{time.monotonic_ns() % 100_000}"
    command = [
        sys.executable,
        "-P",  # a file of the user's, cmd.py say, must not stand for the standard library's
        "-m",
        "zendsp_target",
        "--machine",
        machine,
        "--name",
        name,
        "--rate",
        repr(float(rate)),
        "--clock",
        clock,
        "--parent",
        str(os.getpid()),
        "--json",
        *options,
    ]
    said = tempfile.TemporaryFile()
    # in a session of its own: Ctrl-C, which a terminal or a notebook sends to all of a group, is
    # meant for what the user typed, not for the target
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=said,
        start_new_session=True,
    )
    try:
        _wait_ready(process, said, timeout)
        name, endpoints, own = locate(name, [])
        link = Link(name, endpoints, own or Credentials(), timeout)
        target = Target(link, on_close=lambda: _end(process, said))
    except BaseException:
        _end(process, said)
        raise
    # a notebook's cell that is run again forgets the target of its first run
    weakref.finalize(target, _forgotten, os.getpid(), link, process, said).atexit = False
    if hasattr(sys, "ps1") and sys._getframe(1).f_globals.get("__name__") == "__main__":
        _say_others(machine)
    _started[target] = machine
    return target


def _say_others(machine: str) -> None:
    """Say at a prompt which targets of the same machine it started before and still has: what a
    notebook has shown, it refers to for ever.
    """
    for other, its in list(_started.items()):
        if its == machine and other.alive:
            print(
                f"zendsp: {other.name}, which was started here before, still runs; its close() ends"
                f" it, and 'zendsp stop -t {other.name}' stops its machine",
                file=sys.stderr,
            )


def _forgotten(
    parent: int, link: Link, process: subprocess.Popen[bytes], said: IO[bytes]
) -> None:
    """End a target that nothing refers to any more, without being waited for."""
    if os.getpid() != parent or process.returncode is not None:  # another's, or closed before
        return

    def end() -> None:
        link.close()
        _end(process, said)

    background("forgotten", end)


def _wait_ready(process: subprocess.Popen[bytes], said: IO[bytes], timeout: float) -> None:
    assert process.stdout is not None
    ready, _, _ = select.select([process.stdout], [], [], timeout)
    line = process.stdout.readline() if ready else b""
    try:
        json.loads(line)
    except ValueError:
        process.terminate()
        said.seek(0)
        words = said.read().decode(errors="replace").strip()
        why = words or "it said nothing"
        if not ready:  # what it said until then is not the reason
            why = f"it was not ready within {timeout:g} s; it said: {words or 'nothing'}"
        raise LinkError(f"the target did not start: {why}") from None


def _end(process: subprocess.Popen[bytes], said: IO[bytes]) -> None:
    process.terminate()
    try:
        process.wait(END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()
    said.close()
