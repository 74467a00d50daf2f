"""The same screens in a browser, on loopback only."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from aiohttp import web
from textual_serve.server import Server

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def is_ours(request_host: str, origin: str | None) -> bool:
    """Tell whether a request comes from a page of ours.

    Any page that a user has open may try to reach a port on his own computer, and this one can move
    a machine. So the name by which the server was called must be loopback, and a page that opens
    the socket must have come from the same place.
    """
    name = (
        request_host.rpartition(":")[0]
        if not request_host.endswith("]") and ":" in request_host
        else request_host
    )
    if name not in LOOPBACK:
        return False
    return origin is None or urlsplit(origin).netloc == request_host


@web.middleware
async def refuse_strangers(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Answer 403 to what is not ours."""
    if not is_ours(request.host, request.headers.get("Origin")):
        raise web.HTTPForbidden(text="zendsp serves pages of this computer only")
    return await handler(request)


class LoopbackServer(Server):
    """textual-serve with a page that needs no network, and with an eye on who asks."""

    def __init__(self, command: str, port: int) -> None:
        super().__init__(
            command,
            host="127.0.0.1",
            port=port,
            title="zendsp",
            templates_path=Path(__file__).parent / "page",
        )

    async def _make_app(self) -> web.Application:
        app = await super()._make_app()
        app.middlewares.append(refuse_strangers)
        return app

    async def on_startup(self, app: web.Application) -> None:
        """Say where it is."""
        self.console.print(f"{self.public_url}  (Ctrl-C ends it)", highlight=False)


def serve(command: str, port: int, debug: Any = False) -> None:
    """Serve until Ctrl-C; each page that is opened runs ``command`` in a process of its own."""
    LoopbackServer(command, port).serve(debug=bool(debug))
