"""The right to command, and what happens when its holder is lost."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from waiting import until

from zendsp.errors import Refused
from zendsp.link import Target, connect, local
from zendsp.recording import Recording


def test_the_right_to_command_is_exclusive_and_taken_over_deliberately(target: Target) -> None:
    assert target.drive_status().commander == ""
    target.power_on()
    assert target.drive_status().commander == target.link.author
    with connect(target.name) as other:
        for forbidden in (
            other.start,
            other.pause,
            other.enable,
            other.power_off,
            other.acknowledge,
            other.release_command,
            lambda: other.update(Kp1=1.0),
            lambda: other.load("x"),
            lambda: other.set_ramp(0.1),
        ):
            with pytest.raises(Refused, match="exclusive right"):
                forbidden()
        assert other["Kp1"] == 2000.0
        with pytest.raises(Refused, match="take it over deliberately"):
            other.take_command()
        assert "taken over" in other.take_command(force=True)
        with pytest.raises(Refused, match="exclusive right"):
            target.pause()
        other.release_command()
    target.pause()


def test_the_right_falls_free_when_its_holder_leaves(target: Target) -> None:
    with connect(target.name) as other:
        other.take_command()
        assert target.drive_status().commander == other.link.author
    until(lambda: target.drive_status().commander == "", "freed")


def test_who_watches_what_it_started_lets_go_when_it_is_lost(target: Target) -> None:
    """Without the right to command: the terminal's Start. One that does not watch leaves it going,
    and so does one after whose start somebody paused and started.
    """

    def started(attended: bool, anew: bool = False) -> None:
        target.pause()
        with connect(target.name) as other:
            other.start(attended=attended)
            assert other.drive_status().moved_by == (other.link.author if attended else "")
            if anew:
                target.pause()
                target.start()
        until(lambda: other.link.author not in target.status().hosts, "it is gone")
        until(lambda: target.drive_status().moved_by == "", "nobody watches")

    started(attended=False)
    started(attended=True, anew=True)
    assert target.status().state == "running" and target.status().trip is None
    started(attended=True)
    until(lambda: target.status().trip is not None, "the policy acts")
    trip = target.status().trip
    assert trip is not None and trip.reason == "host lost"


def test_a_homing_ends_when_the_host_that_began_it_is_lost() -> None:
    """Also in automatic mode, where homing does not take the right to command."""
    with local("wam7", clock="fast", options=["--speed", "2"]) as target:
        target.download("joint_pd.c")
        target.start(ticks=400)
        target.wait()  # it has sunk a little, and has a way to go
        with connect(target.name) as other:
            other.home()
            assert other.status().state == "running"
        until(lambda: target.status().state != "running" or target.status().trip, "it ends")
        trip = target.status().trip
        assert trip is not None and trip.reason == "host lost"


def test_the_host_lost_policy_of_a_commander_ends_with_its_command(target: Target) -> None:
    with connect(target.name) as other:
        other.set_host_lost("finish")
        assert other.take_command() == "you command"
        assert "taken over" in target.take_command(force=True)
        assert target.drive_status().host_lost == "stop", "not that of the one before"
        target.release_command()
        other.take_command()
        other.set_host_lost("finish")
    until(lambda: target.drive_status().commander == "", "freed")
    assert target.drive_status().host_lost == "stop"


def test_the_host_lost_policy_set_by_a_non_commander_stays_and_is_reported(target: Target) -> None:
    assert _cli(target, "host-lost", "hold").returncode == 0
    said = target.take_command()
    assert said.startswith("you command; if this host is lost: hold, as ") and "chose" in said
    assert target.drive_status().host_lost == "hold"
    target.set_host_lost("stop")


def _cli(target: Target, *words: str) -> subprocess.CompletedProcess[str]:
    call = [
        sys.executable, "-c", "from zendsp.cli import main; main()", "drive", *words, "--target",
        target.name,
    ]
    return subprocess.run(call, capture_output=True, text=True, timeout=100, check=False)


def test_the_commands_that_are_told_after_a_lost_host_bring_the_program_back(
    target: Target,
) -> None:
    """Drives that are enabled are not called off."""
    target.enable()
    target.release_command()
    with connect(target.name) as other:
        other.start(attended=True)
    until(lambda: target.status().trip, "the policy acts")
    told, seen = [], _cli(target).stdout
    assert "stopped, held at zero speed" in seen
    for _ in range(3):
        line = next(line for line in seen.splitlines() if line.startswith("next: "))
        step = line.removeprefix("next: ").split(", then ")[0]
        told.append(step.removesuffix(f" -t {target.name}"))
        words = step.split()[1:]
        call = [sys.executable, "-c", "from zendsp.cli import main; main()", *words]
        subprocess.run(call, check=True, timeout=100, capture_output=True)
        seen = _cli(target).stdout
        if told[-1] == "zendsp drive enable":
            assert "enabled, no torque before the program starts" in seen
    assert told == ["zendsp drive acknowledge", "zendsp drive enable", "zendsp run"]
    assert target.status().state == "running" and "next: " not in seen


COMMANDS_AND_DIES = """
import os, sys, zendsp
target = zendsp.connect(sys.argv[1])
target.take_command()
target.acquire_configure(["q"], 60.0)
target.acquire_start()
target.start()
while target.acquire_status().count < 100: pass
os._exit(0)
"""


def test_a_recording_ends_a_second_after_a_trip_by_the_loss_of_its_host(tmp_path: Path) -> None:
    with local("imi_planar", clock="real") as target:
        target.download("pd.c")
        subprocess.run([sys.executable, "-c", COMMANDS_AND_DIES, target.name], timeout=60)
        until(lambda: target.status().trip is not None, "tripped")
        until(lambda: target.acquire_status().state == "done", "ended")
        tripped = target.status().trip
        assert tripped is not None and tripped.reason == "host lost"
        held = target.acquire_status()
        after = (held.start_tick + held.count - tripped.tick) / 1000.0
        assert 0.5 < after < 3.0, "the second in which it comes to rest; a loaded computer's delay"
        call = [sys.executable, "-c", "from zendsp.cli import main; main()", "acquire", "--last"]
        file = tmp_path / "run.mat"
        words = ["-o", str(file), "-t", target.name]
        refused = subprocess.run([*call, "q", *words], capture_output=True, text=True, timeout=100)
        assert refused.returncode == 2 and "without CHANNELS" in refused.stderr
        subprocess.run([*call, *words], check=True, timeout=100)
        assert len(Recording.load(file)) == held.count
