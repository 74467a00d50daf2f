"""``zendsp tui --web``: the screens reach a browser on loopback, and nobody else."""

from __future__ import annotations

import asyncio
import json
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from waiting import PATIENCE_S

from zendsp.link import Target

aiohttp = pytest.importorskip("aiohttp")
pyte = pytest.importorskip("pyte")
pytest.importorskip("textual_serve")


@pytest.fixture
def port(tmp_path: Path) -> Iterator[int]:
    yield from _served(tmp_path, "--screen", "reference")


def _served(folder: Path, *options: str) -> Iterator[int]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        number: int = probe.getsockname()[1]
    call = "from zendsp.cli import main; main()"
    process = subprocess.Popen(
        [
            sys.executable,
            "-c",
            call,
            "tui",
            "--web",
            "--port",
            str(number),
            "--folder",
            str(folder),
            *options,
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + PATIENCE_S
    while True:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", number)) == 0:
                break
        assert process.poll() is None and time.monotonic() < deadline, "the server did not start"
        time.sleep(0.05)
    yield number
    process.terminate()
    process.wait(PATIENCE_S)


async def test_the_page_shows_the_screen_and_needs_no_other_computer(port: int) -> None:
    base = f"http://127.0.0.1:{port}"
    async with aiohttp.ClientSession() as session:
        page = await (await session.get(base)).text()
        others = [
            part
            for part in page.split('"')
            if "://" in part and not part.startswith((base, base.replace("http", "ws")))
        ]
        assert others == [], "nothing is fetched from elsewhere"
        for name in ("css/xterm.css", "js/textual.js", "fonts/RobotoMono-VariableFont_wght.ttf"):
            assert (await session.get(f"{base}/static/{name}")).status == 200
        url = f"{base}/ws?width=120&height=36"
        async with session.ws_connect(url, headers={"Origin": base}) as socket_:
            seen = b""
            deadline = time.monotonic() + PATIENCE_S
            while b"Reference and Diagnose work without a target" not in seen:
                assert time.monotonic() < deadline, seen[-500:]
                message = await asyncio.wait_for(socket_.receive(), PATIENCE_S)
                if message.type == aiohttp.WSMsgType.BINARY:
                    seen += message.data
                elif message.type == aiohttp.WSMsgType.TEXT:
                    seen += json.dumps(message.data).encode()


@pytest.mark.parametrize("press", ["\x1b[20~", "\x1b[<0;114;2M\x1b[<0;114;2m"], ids=["F9", "click"])
async def test_stop_from_a_page(target: Target, tmp_path: Path, press: str) -> None:
    target.download("pd.c")
    target.start()
    shown = pyte.Screen(120, 36)
    stream = pyte.ByteStream(shown)

    def clock() -> list[str]:
        return re.findall(r"\d\d:\d\d:\d\d", shown.display[0])

    for number in _served(tmp_path, target.name):
        base = f"http://127.0.0.1:{number}"
        async with aiohttp.ClientSession() as session:
            page = await session.ws_connect(
                f"{base}/ws?width=120&height=36", headers={"Origin": base}
            )

            async def until(
                done: Callable[[], object], page: aiohttp.ClientWebSocketResponse = page
            ) -> None:
                deadline = time.monotonic() + PATIENCE_S
                while not done():
                    assert time.monotonic() < deadline, "\n".join(shown.display)
                    message = await asyncio.wait_for(page.receive(), PATIENCE_S)
                    if message.type == aiohttp.WSMsgType.BINARY:
                        stream.feed(message.data.replace(b"\x1b[>", b"\x1b["))

            await until(lambda: "● running" in shown.display[1] and clock())
            first = clock()
            await until(lambda first=first: clock() != first)  # type: ignore[misc]  # where the field is was told before this picture
            await page.send_json(["stdin", press])
            await until(lambda: "stopped, at sample" in shown.display[1])
            await page.close()
        trip = target.status().trip
        assert trip is not None and trip.reason == "stop"


async def test_pages_of_strangers_are_refused(port: int) -> None:
    async with aiohttp.ClientSession() as session:
        base = f"http://127.0.0.1:{port}"
        assert (await session.get(base, headers={"Host": "evil.example"})).status == 403
        with pytest.raises(aiohttp.WSServerHandshakeError):
            await session.ws_connect(f"{base}/ws", headers={"Origin": "http://evil.example"})


@pytest.mark.parametrize(
    ("host", "origin", "ours"),
    [
        ("127.0.0.1:8000", None, True),
        ("localhost:8000", "http://localhost:8000", True),
        ("[::1]:8000", "http://[::1]:8000", True),
        ("127.0.0.1:8000", "http://127.0.0.1:9000", False),
        ("127.0.0.1:8000", "null", False),
        ("lab.example:8000", None, False),
    ],
)
def test_who_is_a_stranger(host: str, origin: str | None, ours: bool) -> None:
    from zendsp.tui.web import is_ours

    assert is_ours(host, origin) is ours
