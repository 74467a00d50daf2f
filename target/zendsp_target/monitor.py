"""The target process: one runtime, one server, one entry in the registry, ended together."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import zenoh

from zendsp_protocol.errors import LinkError, Refused
from zendsp_target.access import endpoints as listening
from zendsp_target.access.admission import Doors, access_control, settle
from zendsp_target.access.endpoints import Security
from zendsp_target.access.registration import Registration, check_free, own_folder, users_file
from zendsp_target.api import RuntimeApi
from zendsp_target.serving.server import Server
from zendsp_target.serving.service import identity

TRIES = 5  # another process may take a free port before Zenoh does
PARENT_POLL_S = 0.2
Asked: TypeAlias = "queue.SimpleQueue[int]"


@dataclass(frozen=True)
class Options:
    """The name of a target, where it listens, and who may come in."""

    name: str
    machine: str
    listen: Sequence[str] = ()  # empty: a socket that only this user can open
    connect: Sequence[str] = ()
    security: Security = field(default_factory=Security)
    managed: bool = False  # the safe sequence of the drives cannot be left


def asked_to_end() -> Asked:
    """Return a queue that takes the signals to end the process, from now on.

    A signal that comes while the target starts is thus only noted: a process that ended at once
    would leave its socket behind.
    """
    # no threading.Event: its lock may be held by what the signal interrupts, for ever then
    asked: Asked = queue.SimpleQueue()
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, lambda number, _: asked.put(number))
    return asked


class Monitor:
    """Serves ``runtime`` until closed.

    Raises
    ------
    Refused
        Endpoints that others could reach without TLS and authentication, or a name that is taken.
    LinkError
        None of the endpoints can be listened to.
    """

    def __init__(self, runtime: RuntimeApi, options: Options) -> None:
        who = identity(options.name, options.machine)
        check_free(who.name)
        doors = settle(who.name, options.listen, options.connect, options.security)
        self._runtime = runtime
        self._session, self.endpoints = _open(options, doors)
        self._server = Server(runtime, who, self._session, options.managed, doors)
        self.token = doors.token
        self._entry = Registration(
            who.name, self.endpoints, options.machine, doors.token,
            self._server.service.once.instance.hex(), runtime.stop_page(),
        )
        self._closed = False

    def close(self) -> None:
        """End serving; the runtime is left in its safe state, or hosts are told that it is not."""
        if self._closed:
            return
        self._closed = True
        self._entry.remove()
        self._server.close()
        try:
            self._runtime.close()
            self._server.say_farewell(not self._runtime.unsafe)
        finally:
            self._session.close()  # type: ignore[no-untyped-call]

    def run(self, asked: Asked, parent: int, ready: Callable[[], None]) -> None:
        """Serve until a signal is in ``asked``, or until the process ``parent`` (0: none) is no
        longer the parent of this one; ``ready`` is called first.
        """
        try:
            ready()
            while not parent or os.getppid() == parent:
                with contextlib.suppress(queue.Empty):
                    asked.get(timeout=PARENT_POLL_S)
                    break
                self._entry.keep()
        finally:
            self.close()


def _open(options: Options, doors: Doors) -> tuple[Any, list[str]]:
    own_folder()  # that of its socket
    access = access_control(options.name, doors, options.connect)
    for attempt in range(TRIES):
        chosen = listening.with_free_ports(doors.endpoints)
        usual = os.umask(0o077)  # a socket is its user's alone, at any path
        try:
            with users_file(options.name, doors.users) as users:
                config = listening.zenoh_config(
                    chosen, options.security, options.connect, access, users
                )
                return zenoh.open(config), chosen
        except zenoh.ZError as error:
            if list(doors.endpoints) == chosen or attempt == TRIES - 1:
                shown = ", ".join(doors.endpoints)
                raise LinkError(f"cannot listen on {shown}: {_reason(error)}") from error
        finally:
            os.umask(usual)
    raise Refused("no endpoint was given to --listen")


def _reason(error: Exception) -> str:
    """The sentence of an error of Zenoh, without the places in Zenoh's source."""
    return str(error).partition(" at /")[0].strip()
