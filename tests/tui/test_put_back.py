"""What a run changed in the program is put back when nothing moves; the next start is gentle."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from waiting import PATIENCE_S
from waiting import until as wait_for

from zendsp.link import Target, local
from zendsp.reference import Reference, load_machine, make_reference
from zendsp.tui.events import EventLog
from zendsp.tui.link_port import LinkPort
from zendsp.tui.play_job import PlayJob
from zendsp.tui.playing import Setup

CHANGED = ("use_table", "row_rate", "approach_time", "hold")
OWN = {"use_table": False, "row_rate": 777, "approach_time": 1.25, "hold": False}
FAR = 0.5  # rad of both joints from where the run began


@pytest.fixture
def arm() -> Iterator[Target]:
    with local("imi_planar", clock="real") as target:
        target.download("pd.c")
        target.update(**OWN)
        target.enable()
        yield target


def started(target: Target, tmp_path: Path, motion: Reference, **setup: Any) -> PlayJob:
    """A run of a motion, as Execute starts it."""
    found = SimpleNamespace(trip=None, simulated=True, good=True, text="as planned")
    port = LinkPort(target)
    port.snapshot()
    job = PlayJob(
        SimpleNamespace(require=lambda: port, events=EventLog()),
        [motion], [], load_machine("imi_planar"), Setup(**setup), tmp_path, {},
        SimpleNamespace(found=lambda plan: found),  # type: ignore[arg-type]
    )  # fmt: skip
    job.start()
    return job


def position(target: Target) -> np.ndarray:
    """Where the arm stands, also where no program says so."""
    return np.array(LinkPort(target).snapshot().position)


def out_there(target: Target) -> bool:
    return min(abs(target["q1"]), abs(target["q2"])) > FAR


@pytest.mark.parametrize("how", ["complete", "aborted", "stopped", "paused"])
def test_a_run_leaves_the_parameters_as_they_were(how: str, arm: Target, tmp_path: Path) -> None:
    motion = make_reference("point_to_point", "imi_planar", start=0.0, goal=0.6, duration=1.0)
    job = started(arm, tmp_path, motion, go_home=False)
    if how != "complete":
        wait_for(lambda: not job.busy or out_there(arm), "far out")
        {"aborted": job.abort, "stopped": arm.stop, "paused": arm.pause}[how]()
    run = job.result.result(PATIENCE_S)
    if how == "stopped":
        arm.acknowledge()
    stood = position(arm)
    assert run is not None and (how in run.ending or "STOP" in run.ending), "its rows are kept"
    assert {name: arm[name] for name in CHANGED} == OWN
    recording = run.recording()
    kept = recording.parameters
    assert kept["use_table"] and kept["approach_time"] == 0.2, "the run says how it was played"
    time.sleep(0.3)
    assert np.abs(position(arm) - stood).max() < 1e-3, "nothing moves because of it"
    if how != "stopped":  # a STOP brakes for some time yet
        assert np.abs(stood - recording["q"][-1]).max() < 5e-3


def peak_of_start(target: Target) -> np.ndarray:
    """Largest command of each joint within 4 s of a start."""
    target.acquire_configure(["tau"], seconds=4.0)
    target.acquire_start()
    target.start()
    wait_for(lambda: target.acquire_status().state == "done", "recorded")
    assert target.status().trip is None
    target.pause()
    return np.abs(target.acquire_load()["tau"]).max(axis=0)


def test_start_after_a_stop_in_a_run_is_as_gentle_as_the_first(arm: Target, tmp_path: Path) -> None:
    first = peak_of_start(arm)
    job = started(arm, tmp_path, make_reference("circle", "imi_planar"))
    wait_for(lambda: not job.busy or out_there(arm), "far out")
    arm.stop()
    job.result.result(PATIENCE_S)
    arm.acknowledge()
    arm.enable()
    after = peak_of_start(arm)
    assert np.all(after < 1.25 * first), (first, after)
