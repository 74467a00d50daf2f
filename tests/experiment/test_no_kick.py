"""What a host sets while the machine moves does not kick it: no step of the torque that the motion
itself does not have.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from waiting import until

import zendsp
import zendsp_isr
from zendsp.errors import Refused
from zendsp.link import Target, local
from zendsp.link.put_back import Before

WEAK = {"Kp1": 5.0, "Kd1": 5.0}  # the arm lags 1 rad behind its circle
STRONG = {"Kp1": 2000.0, "Kd1": 120.0}
STEP = 5.0  # N m a sample; the circle itself: 2.8, a count of the encoder times Kd
FASTEST = 16 / 9  # of a steady fade: growth of a gain in a sample, at the most


@pytest.fixture
def watched() -> Iterator[Target]:
    """The arm on its circle, by a program that keeps the largest step of its torque beside what the
    gains grow by in a sample, and that growth: how far the arm lags where a fade begins, and what
    the growth makes of it, is chance.
    """
    text = (Path(zendsp_isr.__file__).parent / "programs" / "pd.c").read_text()
    for old, new in (
        ("static double q1,", "static double step, grown, before, kp, kd, q1,"),
        (
            "    CompensationInit();\n",
            '    CompensationInit();\n    PARAMETER(step, 0.0, "N m", 0.0, NO_MAX, "");\n'
            '    PARAMETER(grown, 0.0, "N m/rad", 0.0, NO_MAX, "");\n',
        ),
        (
            "    WRITE_TORQUE(0, tau1);\n",
            "    const double more = (Kp1 - kp) * e1 + (Kd1 - kd) * (rd1 - qd1);\n"
            "    step = fmax(step, fabs(tau1 - before - more));\n"
            "    grown = fmax(grown, fabs(Kp1 - kp));\n"
            "    before = tau1;\n    kp = Kp1;\n    kd = Kd1;\n    WRITE_TORQUE(0, tau1);\n",
        ),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    with local("imi_planar", clock="fast", options=["--ideal", "--speed", "100"]) as target:
        target.download({"pd.c": text})
        target.update(turn_time=2.0)
        target.start()
        until(lambda: target.status().t > 2.0, "the arm is on its circle")
        target.update(step=0.0, grown=0.0)
        yield target


def runs_on(target: Target, seconds: float) -> None:
    end = target.status().t + seconds
    until(lambda: target.status().t > end or target.status().trip is not None, "it runs on")


def is_smooth(target: Target, change: float, samples: int) -> bool:
    """Whether no gain grew faster than in a fade, and the motion itself has no step beside that."""
    return target["step"] < STEP and target["grown"] <= 1.001 * FASTEST * change / samples


def test_a_gain_in_one_sample_is_a_step_of_the_torque_and_a_faded_one_is_none(
    watched: Target,
) -> None:
    for seconds in (0.0, 0.5):
        watched.update(step=0.0, grown=0.0)
        for _ in range(5):
            watched.fade(0.5, Kp1=50.0)
            runs_on(watched, 0.8)
            watched.fade(seconds, Kp1=2000.0)
            runs_on(watched, 0.8)
        assert is_smooth(watched, 1950.0, 500) == (seconds > 0.0)
    with pytest.raises(Refused, match="a fade of 3 s: give 0 … 2 s"):
        watched.fade(3.0, Kp1=50.0)


def test_a_sweep_of_weak_gains_does_not_kick(watched: Target) -> None:
    values = {name: [WEAK[name], STRONG[name], WEAK[name]] for name in WEAK}
    found = zendsp.sweep(watched, values, ["e1"], seconds=1.0, settle=0.5, together=True)
    assert found.ended == "" and is_smooth(watched, 1995.0, 1000)
    assert {name: watched[name] for name in STRONG} == STRONG
    back = [c for c in watched.log() if c.name == "Kp1" and c.old != c.new][-1]
    assert (back.old, back.new, back.fade) == (5.0, 2000.0, 1000)


def test_nor_does_its_host_when_it_is_lost(watched: Target) -> None:
    lost = zendsp.connect(watched.name)
    Before(lost, WEAK, fade=0.5)
    lost.fade(0.5, **WEAK)
    runs_on(watched, 1.0)
    lost.close()
    until(lambda: watched["Kp1"] == 2000.0, "it is put back")
    assert watched.status().trip is None and is_smooth(watched, 1995.0, 500)
    back = [c for c in watched.log() if c.name == "Kp1"][-1]
    assert (back.old, back.new, back.fade) == (5.0, 2000.0, 500)


@pytest.fixture(scope="module")
def arm() -> Iterator[Target]:
    with local("imi_planar", clock="fast", options=["--ideal", "--speed", "100"]) as target:
        yield target


@pytest.mark.parametrize(
    ("program", "before", "change"),
    [
        ("pd.c", {"turn_time": 2.0}, {"center1": 0.5}),
        ("pd.c", {"turn_time": 2.0}, {"turn_time": 4.0}),
        ("pd.c", {"turn_time": 2.0}, {"use_table": True}),
        ("pd.c", {"use_table": True}, {"use_table": False}),
        ("pd.c", {"use_table": True}, {"ref": 0.5}),
        ("joint_pd.c", {"amplitude": 0.2, "period": 2.0}, {"play": 1}),
        ("joint_pd.c", {"amplitude": 0.2, "period": 2.0}, {"amplitude": 0.4}),
        ("joint_pd.c", {"amplitude": 0.2, "period": 2.0}, {"period": 1.0}),
        ("joint_pd.c", {"amplitude": 0.2, "period": 2.0}, {"ref": 0.5}),
        ("inverse_dynamics.c", {"compensate": True}, {"compensate": False}),
        ("inverse_dynamics.c", {"compensate": True}, {"play": 1}),
    ],
)
def test_another_motion_takes_over_without_a_step(
    program: str, before: dict[str, Any], change: dict[str, Any], arm: Target
) -> None:
    """In the middle of a motion, in one sample: position, speed and command go on."""
    rows = 0.1 * (1.0 - np.cos(2.0 * np.pi * np.arange(4001) / 1000.0))[:, None] * np.ones(2)
    arm.download(program)
    arm.upload("ref", rows)
    arm.update(None, approach_time=0.5, **before)
    at = 2300
    if "ref" in change:
        arm.upload("ref", change["ref"] * rows, at_tick=at)
    else:
        arm.update(at, **change)
    tau = arm.acquire(["tau"], 4.5, start=True).data
    step = np.abs(np.diff(tau, axis=0)).max(axis=1)
    assert arm.status().trip is None
    assert step[at - 3 : at + 3].max() < 1.2 * step[600 : at - 3].max()
