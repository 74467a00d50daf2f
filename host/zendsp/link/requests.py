"""Sends any request of the protocol; all typed methods of a target use it."""

from __future__ import annotations

from typing import Any

from zendsp.errors import LinkError, VersionMismatch
from zendsp.link.link import Link

PATIENCE_S = 30.0  # for a broken link to come back


class Requests:
    """Sends requests through the present link, which a reconnection replaces."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self.outlives = True  # a program that is started, or commanded, here this process

    def request(self, /, verb: str, timeout: float | None = None, **arguments: Any) -> Any:
        """Send any verb of the protocol with its arguments, and return its result.

        Parameters
        ----------
        verb : str
            See the table in ``docs/protocol.md``.
        timeout : float, s, optional
            Default: that of the verb.
        **arguments
            As the table says; unknown or mistyped ones are refused by the target.

        Raises
        ------
        LinkError
            The target is gone or did not answer.
        VersionMismatch
            It is older and does not know the request, or its answer cannot be read.
        ZendspError
            What the target says.
        """
        return self.link.request(verb, arguments, timeout)

    def insist(self, /, verb: str, patience: float = PATIENCE_S, **arguments: Any) -> Any:
        """Send a request that may be repeated without harm, again after each outage of up to
        ``patience`` s.
        """
        while True:
            try:
                return self.request(verb, **arguments)
            except VersionMismatch:  # as ever
                raise
            except LinkError:
                if self.link.closed or not self.link.wait_alive(patience):
                    raise


class Part:
    """Base of the parts of a target, which share one `Requests`."""

    def __init__(self, requests: Requests) -> None:
        self._requests = requests
        self.request, self.insist = requests.request, requests.insist

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self.link.target}>"

    @property
    def link(self) -> Link:
        """The present link; ``Target.reconnect`` makes another."""
        return self._requests.link
