"""F9 ends in one of two banners, on every screen and size: what the user sees in a terminal."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

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


def running(
    user: Installed,
    screens: list[Screen],
    size: tuple[int, int] = (80, 24),
) -> tuple[subprocess.Popen[str], Screen]:
    """A target whose program runs, and a terminal that shows it."""
    process = user.target("imi")
    done = user.script(PREPARE)
    assert done.returncode == 0, done.stderr
    screens.append(Screen(user, size, "imi", "--screen", "console"))
    screens[-1].until("● running")
    return process, screens[-1]


def test_stop_ends_in_the_right_banner(installed: Installed, screens: list[Screen]) -> None:
    """On the console, among the runs, and beside a motion on a large screen; a pasted key is none.
    """
    process, screen = running(installed, screens)
    screen.keys(b"\x1b[200~" + F9 + b"\x1b[201~")  # pasted, it does not stop
    screen.keys(b"\x1bOS")  # F4: a key after it has been seen, so the paste has been read
    screen.until("Motion")
    assert "stopped" not in screen.text()
    assert "nothing happened" in installed.script(NOT_STOPPED).stdout
    screen.keys(b"\x1bOQ")  # F2
    screen.until("Kp1")
    screen.keys(F9)
    screen.until("stopped, at sample")

    assert installed.script(PREPARE).returncode == 0
    screen.until("● running")
    screen.keys(b"\x1bOR")  # F3
    screen.until("reference chosen")
    runner = runner_of(process.pid)
    os.kill(process.pid, signal.SIGSTOP)  # before the runner: its watchdog would end it
    os.kill(runner, signal.SIGSTOP)
    screen.keys(F9)
    screen.until("NOT STOPPED: use the machine's emergency stop")
    os.kill(process.pid, signal.SIGCONT)
    os.killpg(process.pid, signal.SIGKILL)
    screen.until("LINK LOST")
    screen.resize(200, 60)
    screen.keys(b"\x1bOS")  # F4
    screen.until("Motion")
    screen.keys(F9)
    screen.until("NOT STOPPED: use the machine's emergency stop, then Ctrl+K")
    assert "STOP sent" not in screen.text()

    def acknowledged() -> bool:
        screen.keys(b"\x0b")  # Ctrl+K; the word about the second F9 may come after the first
        return "NOT STOPPED" not in screen.text()

    until(acknowledged, "the banner goes", screen.text)


def test_a_machine_that_was_started_here_is_stopped_wherever_the_environment_leads(
    installed: Installed, screens: list[Screen]
) -> None:
    """The process that reads the keys had looked for it at $ZENDSP_CONNECT, and the machine ran on.
    """
    away = replace(installed, env={**installed.env, "ZENDSP_CONNECT": "tcp/127.0.0.1:1"})
    screens.append(Screen(away, (80, 24), "--local", "imi_planar", "--source", "pd.c"))
    screens[-1].until("○ empty")
    screens[-1].keys(b"b")
    screens[-1].until("○ loaded")
    screens[-1].keys(b"s")
    screens[-1].until("● running")
    screens[-1].keys(F9)
    screens[-1].until("stopped, at sample")


def runner_of(target: int) -> int:
    """Number of the process with the loop."""
    for task in Path(f"/proc/{target}/task").iterdir():
        for child in (task / "children").read_text().split():
            words = Path(f"/proc/{child}/cmdline").read_text()
            if "/runner/" in words and "--safe" not in words:
                return int(child)
    pytest.fail("the target has no runner")


def test_a_target_whose_own_process_hangs_is_stopped_all_the_same(
    installed: Installed, screens: list[Screen]
) -> None:
    process, screen = running(installed, screens)
    os.kill(process.pid, signal.SIGSTOP)
    screen.keys(F9)
    screen.until("stopped, at sample")
    assert "NOT STOPPED" not in screen.text()
    os.kill(process.pid, signal.SIGCONT)
    assert "stop" in installed.script(NOT_STOPPED).stdout


def test_a_target_that_hangs_before_there_is_a_link_is_stopped_all_the_same(
    installed: Installed, screens: list[Screen], monkeypatch: pytest.MonkeyPatch
) -> None:
    process = installed.target("imi")
    assert installed.script(PREPARE).returncode == 0
    entry = json.loads((Path(installed.env["ZENDSP_RUNTIME_DIR"]) / "imi.json").read_text())
    # the same target, named as one is that runs elsewhere
    monkeypatch.setitem(installed.env, "ZENDSP_CONNECT", entry["endpoints"][0])
    os.kill(process.pid, signal.SIGSTOP)
    screen = Screen(installed, (80, 24), "imi", "--screen", "console")
    screens.append(screen)
    screen.until("F9")
    screen.keys(F9)
    screen.until("stopped, at sample")
    os.kill(process.pid, signal.SIGCONT)
    assert "stop" in installed.script(NOT_STOPPED).stdout


def test_a_key_that_is_pressed_before_the_screen_is_there_stops(
    installed: Installed, screens: list[Screen]
) -> None:
    installed.target("imi")
    assert installed.script(PREPARE).returncode == 0
    screen = Screen(installed, (80, 24), "imi", "--screen", "console")
    screens.append(screen)
    screen.keys(F9)
    screen.until("stopped, at sample")


def test_a_click_on_the_red_field_stops_while_the_screen_hangs(
    installed: Installed, screens: list[Screen]
) -> None:
    _, screen = running(installed, screens, (100, 24))
    first = screen.clock()
    until(lambda: screen.clock() != first, "a picture more: where the field is was told before it")
    os.kill(screen.pid, signal.SIGSTOP)
    screen.keys(b"\x1b[<0;94;2M\x1b[<0;94;2m")
    until(
        lambda: "stop" in installed.script(NOT_STOPPED).stdout, "stopped, though the screen hangs"
    )
    os.kill(screen.pid, signal.SIGCONT)
    screen.until("stopped, at sample")


def test_a_terminal_that_was_stopped_shows_at_once_what_is_when_it_goes_on(
    installed: Installed, screens: list[Screen]
) -> None:
    screen = Screen(installed, (80, 24), "--local", "imi_planar")
    screens.append(screen)
    screen.until("○ ready")
    screen.keys(b"\x12")  # Ctrl+R
    screen.until("cmd you")
    keys = Path(f"/proc/{screen.pid}/task/{screen.pid}/children").read_text().split()[0]
    for pid in (screen.pid, int(keys)):
        os.kill(pid, signal.SIGSTOP)
    (name,) = (entry["name"] for entry in json.loads(installed.run("ls", "--json").stdout))

    def told(*command: str) -> dict[str, Any]:
        done = installed.run(*command, "-t", name, "--json")
        return dict(json.loads(done.stdout))

    until(lambda: not told("drive")["commander"], "its right to command is free: it was lost")
    for pid in (screen.pid, int(keys)):
        os.kill(pid, signal.SIGCONT)
    screen.until("cmd nobody")
    screen.keys(b"\x12")
    screen.until("cmd you")
    os.kill(told("info")["info"]["pid"], signal.SIGKILL)
    screen.until("HAS ENDED: Ctrl+O")


@pytest.mark.parametrize("ended", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hangs"])
def test_f9_works_where_the_process_of_the_keys_does_not(
    installed: Installed, screens: list[Screen], ended: signal.Signals
) -> None:
    _, screen = running(installed, screens)
    stopper = Path(f"/proc/{stopper_of(screen.pid)}")
    os.kill(int(stopper.name), ended)
    if ended == signal.SIGKILL:
        until(lambda: not stopper.exists(), "it is gone, and was waited for")
    screen.keys(F9)
    screen.until("stopped, at sample")
    assert not stopper.exists()
    screen.keys(b"\x1bOR")
    screen.until("reference chosen")


def stopper_of(terminal: int) -> int:
    """Number of the process that reads the keys."""
    for task in Path(f"/proc/{terminal}/task").iterdir():
        for child in (task / "children").read_text().split():
            if "zendsp.tui.stop_process" in Path(f"/proc/{child}/cmdline").read_text():
                return int(child)
    pytest.fail("the terminal has no process of the keys")


def test_zendsp_stop_stops_or_says_loudly_that_it_could_not(installed: Installed) -> None:
    process = installed.target("imi")
    assert installed.script(PREPARE).returncode == 0
    done = installed.run("stop")
    assert done.returncode == 0 and "stopped, at sample" in done.stdout, done.stdout + done.stderr
    assert installed.script(PREPARE).returncode == 0
    runner = runner_of(process.pid)
    os.kill(process.pid, signal.SIGSTOP)
    done = installed.run("stop")
    assert done.returncode == 0 and "stopped, at sample" in done.stdout, "the loop itself says so"
    os.kill(runner, signal.SIGSTOP)
    done = installed.run("stop")
    assert done.returncode != 0 and "NOT STOPPED: use the machine's emergency stop" in done.stderr
    os.kill(process.pid, signal.SIGCONT)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    until(lambda: "imi" not in installed.run("ls").stdout, "gone")
    done = installed.run("stop")
    assert done.returncode != 0 and "NOT STOPPED: use the machine's emergency stop" in done.stderr
