"""A target as its user sees it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NoReturn

from zendsp.errors import LinkError
from zendsp.link.acquire import Acquisition
from zendsp.link.concealed import Concealment
from zendsp.link.drives import Drives
from zendsp.link.link import Link
from zendsp.link.live import LiveViews
from zendsp.link.programs import Programs
from zendsp.link.sequence import Sequence
from zendsp.link.tables import Tables
from zendsp_protocol import messages as m
from zendsp_protocol.views import html_table, sentence

_ATTRIBUTES = ("link", "info")


def _short(value: Any) -> str:
    """A value in a few digits; of an array, the first elements."""
    items = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(items, list):
        return " ".join(_short(item) for item in items[:4]) + (" …" if len(items) > 4 else "")
    return f"{items:.6g}" if isinstance(items, float) else str(items)


def _quoted(name: str) -> str:
    return f'"{name}"'


class Target(Programs, Acquisition, LiveViews, Tables, Drives, Sequence, Concealment):
    """A target that runs somewhere: load programs, tune variables, record, watch.

    Made by :func:`zendsp.connect` and :func:`zendsp.local`. Safe to use from several threads.

    Attributes
    ----------
    info : Info
        Name, machine, joints, rate, clock, versions.

    Examples
    --------
    >>> import zendsp
    >>> with zendsp.local("imi_planar") as target:    # doctest: +SKIP
    ...     target.download("pd.c")
    ...     target.start()
    ...     target["Kp1"] = 400.0
    ...     tick = target.update(Kp1=450.0, Kd1=40.0)
    ...     rec = target.acquire(["q", "tau"], seconds=2.0)
    """

    def __init__(
        self,
        link: Link,
        on_close: Callable[[], None] | None = None,
        reopen: Callable[[], Link] | None = None,
    ) -> None:
        super().__init__(link)
        self._staged = {}
        self._on_close = on_close
        self._reopen = reopen
        try:
            self.info: m.Info = self.request("info")
            link.instance = bytes.fromhex(self.info.instance) or link.instance
        except BaseException:
            link.close()
            raise

    def __setattr__(self, name: str, value: Any) -> None:
        if not name.startswith("_") and name not in _ATTRIBUTES and not hasattr(type(self), name):
            raise AttributeError(
                f"a target has no attribute {name!r}; to write a variable: target[{_quoted(name)}]"
                f" = {value!r}"
            )
        super().__setattr__(name, value)

    # which knows the attributes there are, and would take all others for good
    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> NoReturn:
            hint = "" if name.startswith("_") else f"; to read a variable: target[{_quoted(name)}]"
            raise AttributeError(f"a target has no attribute {name!r}{hint}")

    @property
    def name(self) -> str:
        """Name of the target."""
        return self.link.target

    @property
    def alive(self) -> bool:
        """Whether the target is reachable now, as the link itself knows it."""
        return self.link.alive

    def reconnect(self) -> None:
        """Look the target up again and connect anew: after it was started again, which gave it
        another address.

        An outage of the link alone needs no call: the connection comes back by itself. Live views
        go on; what is staged stays.

        Raises
        ------
        LinkError
            No target of that name, or nothing answers; the old connection is closed all the same.
        """
        if self._reopen is None:
            raise LinkError(
                f"{self.name} was started by this host and ended with it; start another with"
                " local()"
            )
        old = self.link
        old.close()
        self.link = self._reopen()
        self.info = self.request("info")
        self.link.instance = bytes.fromhex(self.info.instance) or self.link.instance
        self.link.take_over(old)

    def close(self) -> None:
        """End the connection; a target started by :func:`zendsp.local` ends with it, others go on.
        """
        self.link.close()
        if self._on_close is not None:
            on_close, self._on_close = self._on_close, None
            on_close()

    def __enter__(self) -> Target:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ipython_key_completions_(self) -> list[str]:
        """Names for ``target["<Tab>`` at a prompt."""
        return [*self.variables(), *self.builtins()] if self.alive else []

    def _repr_html_(self) -> str:
        """What a notebook shows: how the target does, and the program's variables now."""
        if not self.alive:
            return sentence(repr(self))
        status = self.status()
        shown = sentence(repr(self)) + status._repr_html_()
        infos = [v for v in self.variables().values() if v.kind != "table"]
        if not infos or status.state in ("empty", "crashed"):
            return shown
        values = self.read([v.name for v in infos]).values
        rows = [(v.name, _short(values[v.name]), v.unit, v.description) for v in infos]
        return shown + html_table(("variable", "value", "unit", "description"), rows)

    def __repr__(self) -> str:
        state = "" if self.alive else ", not reachable"
        return (
            f"<Target {self.name}: {self.info.machine}, {self.info.rate_hz:g} Hz,"
            f" {self.info.clock}{state}>"
        )
