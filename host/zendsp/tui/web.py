"""The same screens in a browser, on loopback only."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shlex
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from aiohttp import web
from textual_serve.app_service import AppService
from textual_serve.server import Server, to_int

from zendsp.here.loopback import is_own
from zendsp.parent import call

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
BEAT_S = 15.0  # between questions whether a page's browser is there; half of it for the answer
GRACE_S = 1.0  # for a process or a browser to end by itself
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def is_ours(request_host: str, origin: str | None) -> bool:
    """Whether a request comes from one of our own pages.

    Any page that a user has open could try to reach a port on the user's computer, and this one can
    move a machine. Therefore the server must have been called by a name of the loopback, and a page
    that opens the socket must come from the same place.
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
    """Answer 403 to requests from other pages, and to those of other users of this computer."""
    if not is_ours(request.host, request.headers.get("Origin")):
        raise web.HTTPForbidden(text="zendsp serves pages of this computer only")
    assert request.transport is not None
    (host, port), (_, at) = map(request.transport.get_extra_info, ("sockname", "peername"))
    if not is_own(host, port, at):
        raise web.HTTPForbidden(text="zendsp serves the user who started it only")
    return await handler(request)


class Page(AppService):
    """The process behind one page: a terminal of its own, which ends with the page or the server.
    """

    def __init__(self, words: Sequence[str], websocket: web.WebSocketResponse, **options: Any):
        super().__init__(
            shlex.join(words), write_bytes=websocket.send_bytes, write_str=websocket.send_str,
            close=self._close, **options,
        )
        self._words, self._websocket = words, websocket

    async def _close(self) -> None:
        """Close the connection; a browser that does not answer has gone."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(GRACE_S):
                await self._websocket.close()

    async def _open_app_process(self, width: int = 80, height: int = 24) -> Process:
        # not in the server's session: Ctrl-C there is for the server, which ends its pages
        self._process = process = await asyncio.create_subprocess_exec(
            *self._words, stdin=PIPE, stdout=PIPE, stderr=PIPE,
            env=self._build_environment(width, height), start_new_session=True,
        )
        self._stdin = process.stdin
        return process

    async def run(self) -> None:
        """Pass on the output of the process until it ends; then close the page, which says so."""
        try:
            await super().run()
        finally:
            await self._close()

    async def stop(self) -> None:
        """Ask the process to end, and end it if it does not; the target then sees its host as gone.
        """
        task, self._task, process = self._task, None, self._process
        if task is None or process is None:
            return
        try:
            async with asyncio.timeout(GRACE_S):
                await self._download_manager.cancel_app_downloads(
                    app_service_id=self.app_service_id
                )
                await self.send_meta({"type": "quit"})
                await process.wait()
        except TimeoutError:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            await process.wait()
        _, late = await asyncio.wait([task], timeout=GRACE_S)
        for task in late:
            task.cancel()


class LoopbackServer(Server):
    """textual-serve with a page that needs no network, a check of who asks, and a way to end."""

    def __init__(self, words: Sequence[str], port: int) -> None:
        super().__init__(
            shlex.join(words),
            host="127.0.0.1",
            port=port,
            title="zendsp",
            templates_path=Path(__file__).parent / "page",
        )
        self._words = (sys.executable, "-P", "-c", call(os.getpid()), *words)
        self._pages = set[Page]()

    async def _make_app(self) -> web.Application:
        app = await super()._make_app()
        app.middlewares.append(refuse_strangers)
        return app

    async def on_startup(self, app: web.Application) -> None:
        """Print its address."""
        self.console.print(f"{self.public_url}  (Ctrl-C ends it)", highlight=False)

    async def on_shutdown(self, app: web.Application) -> None:
        """End all pages before the server waits for their handlers."""
        await asyncio.gather(*(page.stop() for page in self._pages))

    async def handle_websocket(self, request: web.Request) -> web.WebSocketResponse:
        """Serve one page until it or the process behind it ends."""
        websocket = web.WebSocketResponse(heartbeat=BEAT_S, timeout=GRACE_S)
        await websocket.prepare(request)
        page = Page(self._words, websocket, download_manager=self.download_manager)
        self._pages.add(page)
        try:
            await page.start(
                to_int(request.query.get("width", ""), 80),
                to_int(request.query.get("height", ""), 24),
            )
            await self._process_messages(websocket, page)
        finally:
            await page.stop()
            self._pages.discard(page)
        return websocket

    def serve(self, debug: bool = False) -> None:
        """Serve until Ctrl-C or SIGTERM."""
        self.initialize_logging()
        web.run_app(
            self._make_app(), host=self.host, port=self.port, print=None, shutdown_timeout=GRACE_S
        )


def serve(words: Sequence[str], port: int) -> None:
    """Serve until Ctrl-C; each page that is opened runs ``zendsp WORDS`` in a process of its own.
    """
    LoopbackServer(words, port).serve()
