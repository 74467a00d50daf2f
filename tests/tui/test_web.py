"""``zendsp tui --web``: the screens reach a browser on loopback, and nobody else."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from waiting import PATIENCE_S

from zendsp.link import Target

aiohttp = pytest.importorskip("aiohttp")
pyte = pytest.importorskip("pyte")
web = pytest.importorskip("zendsp.tui.web")

END_S = 20.0  # what waited for pages took 28 or 60 s, or had no end


@dataclass
class Served:
    """A running server and where it is."""

    base: str
    process: subprocess.Popen[bytes]


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One server for all tests that leave it as it is: each page has a process of its own."""
    with _serve(tmp_path_factory.mktemp("pages"), "--screen", "reference") as served:
        yield served


@contextlib.contextmanager
def _serve(folder: Path, *options: str) -> Iterator[Served]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        number: int = probe.getsockname()[1]
    # a Python that reads the pages of a terminal cannot keep up with 30 a second on a busy computer
    frames = ["--frames", "4"]
    words = ["tui", "--web", "--port", str(number), "--folder", str(folder), *frames, *options]
    process = subprocess.Popen(
        [sys.executable, "-c", "from zendsp.cli import main; main()", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        deadline = time.monotonic() + PATIENCE_S
        while True:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", number)) == 0:
                    break
            assert process.poll() is None and time.monotonic() < deadline, "it did not start"
            time.sleep(0.05)
        yield Served(f"http://127.0.0.1:{number}", process)
    finally:
        process.terminate()
        process.wait(END_S)


class Page:
    """A page as a browser has it open: what it shows, and what the user presses there."""

    def __init__(self, websocket: Any) -> None:
        self.websocket = websocket
        self._shown = pyte.Screen(120, 36)
        self._stream = pyte.ByteStream(self._shown)

    @property
    def lines(self) -> list[str]:
        return list(self._shown.display)

    async def press(self, keys: str) -> None:
        await self.websocket.send_json(["stdin", keys])

    async def hear(self) -> bool:
        """Take one message; False where it was the end."""
        message = await asyncio.wait_for(self.websocket.receive(), PATIENCE_S)
        if message.type == aiohttp.WSMsgType.BINARY:
            self._stream.feed(message.data.replace(b"\x1b[>", b"\x1b["))
        return message.type in (aiohttp.WSMsgType.BINARY, aiohttp.WSMsgType.TEXT)

    async def until(self, done: Callable[[], object]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < deadline and await self.hear(), "\n".join(self.lines)


@contextlib.asynccontextmanager
async def _open(served: Served) -> AsyncIterator[Page]:
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(
            f"{served.base}/ws?width=120&height=36", headers={"Origin": served.base}
        ) as websocket,
    ):
        yield Page(websocket)


def _children(pid: int) -> list[int]:
    return [
        int(child)
        for task in Path(f"/proc/{pid}/task").iterdir()
        for child in (task / "children").read_text().split()
    ]


def _below(pid: int) -> set[int]:
    """The processes that this one has started, and those that they have."""
    children = _children(pid)
    return set(children).union(*map(_below, children))


def _running(pid: int) -> bool:
    """Whether it has not ended; what only waits to be looked at has."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


async def _all_ended(pids: set[int]) -> None:
    deadline = time.monotonic() + END_S
    while left := [pid for pid in pids if _running(pid)]:
        assert time.monotonic() < deadline, left
        await asyncio.sleep(0.02)


async def test_the_page_needs_no_other_computer_and_its_clock_goes_on_under_a_dialog(
    served: Served,
) -> None:
    """The clock tells a page that hears nothing that its picture is old."""
    base = served.base
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
    async with _open(served) as shown:
        words = "Reference and Diagnose work without a target"
        await shown.until(lambda: words in "".join(shown.lines))
        await shown.until(lambda: "Help" in "".join(shown.lines[-3:]))  # its keys are drawn
        while "Everywhere" not in "".join(shown.lines):
            await shown.press("?")  # a page may be drawn a moment before it hears keys
            again = time.monotonic() + 5.0
            await shown.until(
                lambda again=again: "Everywhere" in "".join(shown.lines)
                or time.monotonic() > again
            )
        first = shown.lines[0]
        await shown.until(lambda: shown.lines[0] != first)


async def test_a_key_and_a_click_stop_from_a_page(target: Target, tmp_path: Path) -> None:
    target.download("pd.c")
    target.start()
    with _serve(tmp_path, target.name) as served:
        async with _open(served) as page:

            def clock() -> list[str]:
                return re.findall(r"\d\d:\d\d:\d\d", page.lines[0])

            for press in ("\x1b[20~", "\x1b[<0;114;2M\x1b[<0;114;2m"):  # F9, and on the field
                await page.until(lambda: "● running" in page.lines[1] and clock())
                first = clock()
                # where the field is was told before this picture
                await page.until(lambda first=first: clock() != first)
                await page.press(press)
                await page.until(lambda: "stopped, at sample" in page.lines[1])
                trip = target.status().trip
                assert trip is not None and trip.reason == "stop"
                target.acknowledge()
                target.start()


ASKED = pytest.param("asked", marks=pytest.mark.long("a page that hangs is harder to end"))


@pytest.mark.parametrize("how", [ASKED, "page hangs", "killed"])
async def test_pages_end_with_the_server_and_let_the_target_go(
    target: Target, tmp_path: Path, how: str
) -> None:
    target.download("pd.c")
    with _serve(tmp_path, target.name) as served:
        async with _open(served) as page:
            await page.until(lambda: "○ loaded" in page.lines[1])
            if how == "killed":  # nobody has the right to command: who pressed Start lets go too
                await page.press("s")
                mine = "cmd nobody  run you"
            else:
                await page.press("o")
                await page.until(lambda: "homed" in page.lines[1])
                await page.press("es")
                mine = "cmd you"
            await page.until(lambda: "● running" in page.lines[1] and mine in page.lines[1])
            everything = {served.process.pid, *_below(served.process.pid)}
            if how == "page hangs":
                (child,) = _children(served.process.pid)
                os.kill(child, signal.SIGSTOP)
            served.process.send_signal(signal.SIGKILL if how == "killed" else signal.SIGTERM)
            await _all_ended(everything)
    deadline = time.monotonic() + PATIENCE_S
    while (trip := target.status().trip) is None:
        assert time.monotonic() < deadline, "the target did not notice"
        await asyncio.sleep(0.02)
    assert trip.reason == "host lost"


async def test_a_page_whose_process_died_is_closed(served: Served) -> None:
    """What it shows is old, and STOP would go nowhere."""
    async with _open(served) as page:
        await page.until(lambda: "zendsp" in page.lines[0])
        for pid in _below(served.process.pid):
            os.kill(pid, signal.SIGKILL)
        while await asyncio.wait_for(page.hear(), END_S):
            pass


@pytest.mark.long("a page that hangs is ended below; lost: a browser")
async def test_a_browser_that_hangs_does_not_hold_the_server(tmp_path: Path) -> None:
    """It reads nothing and answers no goodbye."""
    with _serve(tmp_path, "--screen", "reference") as served:
        async with _open(served) as page:
            await page.until(lambda: "zendsp" in page.lines[0])
            everything = {served.process.pid, *_below(served.process.pid)}
            served.process.terminate()
            deadline = time.monotonic() + END_S
            while any(map(_running, everything)):  # nothing is read meanwhile
                assert time.monotonic() < deadline
                time.sleep(0.02)


BROWSER = """
const bar = {}, starting = {}, ears = {}, sent = [], ticks = [];
const keys = { focus: () => { document.activeElement = keys; } };
let now = 0;
Date.now = () => now;
globalThis.window = globalThis;
const elements = { ".silence": bar, ".starting": starting, ".xterm-helper-textarea": null };
globalThis.document = { querySelector: (name) => elements[name], body: {}, activeElement: null };
document.activeElement = document.body;
globalThis.setInterval = (f) => { ticks.push(f); };
const tick = () => { for (const f of ticks) f(); };
globalThis.WebSocket = class {
  static CONNECTING = 0;
  readyState = 0;
  addEventListener(what, f) { ears[what] = f; }
  send(data) { if (this.readyState === 0) throw Error("connecting"); sent.push(data); }
};
SCRIPT
const socket = new WebSocket("ws://");
socket.send("F9");
console.log(sent.length === 0 && !starting.hidden);
socket.readyState = 1; ears.open(); socket.send("p");
console.log(sent);
ears.message({ data: "pong" }); console.log(!starting.hidden);
ears.message({ data: new Uint8Array(3) }); console.log(starting.hidden);
tick(); // before the first picture
elements[".xterm-helper-textarea"] = keys;
tick();
console.log(document.activeElement === keys ? "keys reach the terminal" : "keys go nowhere");
document.activeElement = bar;
tick();
console.log(document.activeElement === bar ? "what was chosen stays" : "it was taken away");
const look = (s) => { now = 1000 * s; tick(); console.log(bar.hidden ? "" : bar.textContent); };
look(3); look(5); ears.message({ data: "" }); look(6); look(20); ears.close(); look(21);
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="no node here: it runs the page's script")
def test_a_page_that_hears_nothing_says_so() -> None:
    page = (Path(web.__file__).parent / "page" / "app_index.html").read_text()
    (script,) = re.findall("<script>(.*?)</script>", page, re.DOTALL)
    said = subprocess.run(
        ["node", "-e", BROWSER.replace("SCRIPT", script)],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    waits = ["true", "[ 'F9', 'p' ]", "true", "true"]
    assert said[:4] == waits, "a key before the connection waits for it; starting until a picture"
    assert said[4:6] == ["keys reach the terminal", "what was chosen stays"]
    silent = [re.findall(r"No word from zendsp for (\d+) s", line) for line in said[6:]]
    assert silent == [[], ["5"], [], ["15"], []], "not after the end: that has words of its own"


async def test_pages_of_strangers_are_refused(served: Served) -> None:
    async with aiohttp.ClientSession() as session:
        assert (await session.get(served.base, headers={"Host": "evil.example"})).status == 403
        with pytest.raises(aiohttp.WSServerHandshakeError):
            await session.ws_connect(f"{served.base}/ws", headers={"Origin": "http://evil.example"})


@pytest.mark.skipif(os.getuid() != 0, reason="only root may be another user")
async def test_another_user_of_this_computer_gets_no_page(served: Served) -> None:
    """Whoever has a page moves the machine, and runs code as the user who serves it."""
    code = (
        "import sys, urllib.request as r, urllib.error as e\n"
        "try: print(r.urlopen(sys.argv[1], timeout=20).status)\n"
        "except e.HTTPError as error: print(error.code)"
    )
    for user, answer in ((0, "200"), (65534, "403")):
        done = await asyncio.to_thread(
            subprocess.run, ["/usr/bin/env", "python3", "-I", "-c", code, served.base],
            user=user, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.stdout.strip() == answer, done


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
    assert web.is_ours(host, origin) is ours
