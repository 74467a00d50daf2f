"""Where target or router ends in the middle of an experiment, what was measured is kept, and within
seconds the host says what it knows of the machine.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import zendsp
from zendsp.cli.common import how_left
from zendsp.errors import LinkError
from zendsp.experiment import Estimate, Lab, Result
from zendsp.link import Target
from zendsp.recording import Recording

ROWS = 1500  # recorded before all ends: three looks, the first of which only reads who records
# 3 s for the link to come back, and as long for a busy computer; it was 40 s
SOON_S = 6.0


def cut_off(lab: Lab, end: Callable[[], None]) -> tuple[LinkError, float]:
    """Measure, and ``end`` what is needed; the error, and how long after it came, s."""
    at: list[float] = []

    def done(target: Target) -> bool:
        if not at and target.status().tick > ROWS:
            end()
            at.append(time.monotonic())
        return False

    result = Result("friction", "Friction", "imi_planar")
    with (
        pytest.raises(LinkError) as error,
        lab.bench("friction", result) as bench,
    ):
        result.values["coulomb1"] = Estimate(8.4, 0.1, "N m")
        channels = ("play_time", "q", "tau")
        bench.record("joint2", "joint_pd.c", channels, seconds=60.0, done=done)
    return error.value, time.monotonic() - at[0]


def check_kept(lab: Lab) -> None:
    """What was measured before, and the rows of what was cut off, are there and named."""
    folder = lab.folder / "friction"
    part = Recording.load(folder / "joint2_ended.npz")
    # the latest look is at most half a second old, and another one on a busy computer
    assert len(part) > ROWS - 1000 and part["q"].shape == (len(part), 2)
    assert part.t[-1] == pytest.approx((len(part) - 1) * part.sample_time, abs=1e-9)
    early = Result.load(folder / "result_ended.toml")
    assert early.values["coulomb1"].value == 8.4 and "ended early" in early.warnings[0]
    for name in ("result_ended.toml", "joint2_ended.npz"):
        assert str(folder / name) in lab.left
    assert not (folder / "result.toml").exists(), "nothing builds on half a result"


@pytest.mark.parametrize(
    "by, said",
    [
        (signal.SIGINT, "the target has ended; as it said, its machine is in its safe state"),
        (signal.SIGKILL, "NOT KNOWN whether the machine still moves: its target has ended without"),
    ],
)
def test_what_was_measured_is_kept_where_the_target_ends(
    by: signal.Signals, said: str, real: Target, tmp_path: Path
) -> None:
    lab = Lab(tmp_path, real)
    _, after_s = cut_off(lab, lambda: os.kill(int(real.info.pid), by))
    assert after_s < SOON_S
    check_kept(lab)
    assert how_left(real).startswith(said)
    with zendsp.local("imi_planar", clock="fast") as again:
        assert again.status().trip is None, "the next start is clean"


def test_what_was_measured_is_kept_where_the_router_ends(
    routed: tuple[subprocess.Popen[str], str], tmp_path: Path
) -> None:
    router, place = routed
    with zendsp.connect("imi", place) as target:
        target.set_host_lost("stop")
        lab = Lab(tmp_path, target)
        _, after_s = cut_off(lab, router.kill)
        assert after_s < SOON_S
        check_kept(lab)
        assert "If the target lives, it has lost this host" in lab.left
        assert "stop: it stops now" in lab.left and "zendsp acquire --last -t imi" in lab.left
    with zendsp.connect("imi") as beside:
        assert beside.status().trip.reason == "host lost", "and so it did"
