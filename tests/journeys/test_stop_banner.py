"""F9 ends in one of two banners, on every screen and size: what the user sees in a terminal."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest
from journey import Installed, until
from screen import Screen

F9 = b"\x1b[20~"
PREPARE = """
import zendsp
with zendsp.connect('imi') as t:
    if t.status().state == 'empty': t.download('pd.c')
    t.acknowledge(); t.start()
"""
NOT_STOPPED = """
import zendsp
with zendsp.connect('imi') as t:
    print('nothing happened' if t.status().trip is None else t.status().trip)
"""


@pytest.fixture
def screens(installed: Installed) -> Iterator[list[Screen]]:
    opened: list[Screen] = []
    yield opened
    for screen in opened:
        screen.end()


@pytest.mark.parametrize("name", ["console", "execute", "reference"])
@pytest.mark.parametrize("size", [(80, 24), (200, 60)], ids=["small", "large"])
def test_stop_ends_in_the_right_banner(
    installed: Installed, screens: list[Screen], name: str, size: tuple[int, int]
) -> None:
    process = installed.target("imi")
    done = installed.script(PREPARE)
    assert done.returncode == 0, done.stderr
    screen = Screen(installed, size, "imi", "--screen", name)
    screens.append(screen)
    screen.until("● running")

    screen.keys(F9)
    screen.until("stopped, at sample")

    assert installed.script(PREPARE).returncode == 0
    screen.until("● running")
    os.kill(process.pid, signal.SIGSTOP)
    screen.keys(F9)
    screen.until("NOT STOPPED: use the machine's emergency stop", 8.0)
    os.kill(process.pid, signal.SIGCONT)
    os.killpg(process.pid, signal.SIGKILL)
    screen.until("LINK LOST")
    screen.keys(F9)
    screen.until("NOT STOPPED: use the machine's emergency stop", 8.0)
    assert "STOP sent" not in screen.text()


def test_a_pasted_key_does_not_stop(installed: Installed, screens: list[Screen]) -> None:
    installed.target("imi")
    assert installed.script(PREPARE).returncode == 0
    screen = Screen(installed, (80, 24), "imi", "--screen", "console")
    screens.append(screen)
    screen.until("● running")
    screen.keys(b"\x1b[200~" + F9 + b"\x1b[201~")
    screen.keys(b"\x1bOS")  # a key after it has been seen: so the paste has been read
    screen.until("Motion")
    assert "stopped" not in screen.text()
    assert "nothing happened" in installed.script(NOT_STOPPED).stdout


def test_the_command_stops_or_says_loudly_that_it_could_not(installed: Installed) -> None:
    process = installed.target("imi")
    assert installed.script(PREPARE).returncode == 0
    done = installed.run("stop")
    assert done.returncode == 0 and "stopped, at sample" in done.stdout, done.stdout + done.stderr
    os.kill(process.pid, signal.SIGSTOP)
    done = installed.run("stop")
    assert done.returncode != 0 and "NOT STOPPED: use the machine's emergency stop" in done.stderr
    os.kill(process.pid, signal.SIGCONT)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    until(lambda: "imi" not in installed.run("ls").stdout, "gone")
    done = installed.run("stop")
    assert done.returncode != 0 and "NOT STOPPED: use the machine's emergency stop" in done.stderr
