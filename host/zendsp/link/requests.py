"""The generic request path on which every typed method of a target stands."""

from __future__ import annotations

from typing import Any

from zendsp.link.link import Link


class Requests:
    """Holds the link; the rooms of :class:`zendsp.link.target.Target` build upon it."""

    def __init__(self, link: Link) -> None:
        self.link = link

    def request(self, verb: str, timeout: float | None = None, **arguments: Any) -> Any:
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
        ZendspError
            What the target says.
        """
        return self.link.request(verb, arguments, timeout)
