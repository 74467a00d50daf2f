"""No weight sinks in an experiment: each recording begins with what holds the joints, and a push
with what holds the joint that is pushed, whatever is known of its weight.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import zendsp
from zendsp.errors import Unmeasured
from zendsp.experiment import Lab
from zendsp.experiment.breakaway import _push
from zendsp.experiment.gentle import CHANNELS, PROGRAM
from zendsp.experiment.high_speed import _steady
from zendsp.experiment.joints import Known, Load, axis_of
from zendsp.experiment.knowing import first_look, with_pushes
from zendsp.experiment.lab import Bench
from zendsp.experiment.push import Pusher, columns
from zendsp.experiment.staircase import HOLD, breakaway_torque
from zendsp.link import Target
from zendsp.recording import Recording
from zendsp.reference import Reference

# level, the elbow weighs 1.4715 N m by the cosine, and the shoulder up to 9.3
ARM = """<mujoco model="arm"><compiler angle="radian"/><worldbody><body pos="0 0 1">
<joint name="shoulder" axis="0 1 0" range="-2 2" armature="0.05" frictionloss="{0}" damping="0.5"/>
<geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02" mass="2"/><body pos="0.4 0 0">
<joint name="elbow" axis="0 1 0" range="-2 2" armature="0.02" frictionloss="{1}" damping="0.2"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="1"/></body></body></worldbody>
<actuator><motor joint="shoulder" ctrlrange="-40 40"/><motor joint="elbow" ctrlrange="-10 10"/>
</actuator></mujoco>"""
SMALL, LARGE = (1.0, 0.3), (14.0, 2.5)  # N m, of friction
WEIGHT = -1.4715  # N m, of the elbow where the shoulder is level
# a block that the bar touches at 1.1 rad, which no range declares
STOP = """<mujoco model="stop"><compiler angle="radian"/><worldbody><body><joint name="turn"
axis="0 0 1" armature="0.05" damping="0.3" frictionloss="0.4" range="-2 2"/><geom type="capsule"
fromto="0 0 0 0.4 0 0" size="0.02" mass="1"/></body><body pos="{x} {y} 0" euler="0 0 0.9"><geom
type="box" size="0.05 0.05 0.1" mass="10"/></body></worldbody>
<actuator><motor joint="turn" ctrlrange="-20 20"/></actuator></mujoco>"""


@contextmanager
def benched(folder: Path, xml: str, speed: float) -> Iterator[tuple[Target, Lab, Bench, Known]]:
    file = folder / "machine.xml"
    file.write_text(xml)
    options = ["--speed", "100", "--machine-option", f"speed_max={speed}"]
    with zendsp.local(str(file), clock="fast", options=options) as target:
        lab = Lab(folder, target)
        with lab.bench("breakaway") as bench:
            yield target, lab, bench, first_look(bench, lab)


def elbow(bench: Bench, known: Known, weight: float, level: float) -> Known:
    """The arm with an elbow of which this is believed."""
    load = Load(0.0515, cos=weight, weight_std=0.01, cos_std=0.01)
    axis = axis_of(2, bench.machine.joints[1], 0.0, load, level, viscous=0.2)
    return replace(known, axes={**known.axes, 2: axis})


@pytest.mark.parametrize("friction", [SMALL, LARGE])
@pytest.mark.parametrize("speed", [0.3, 1.0])
def test_breakaway_begins_at_what_holds_the_joint_not_at_what_is_believed_of_its_weight(
    tmp_path: Path, speed: float, friction: tuple[float, float]
) -> None:
    """A weight that is believed a third too large: the joint was let go with it."""
    level, found = friction[1], {}
    with benched(tmp_path, ARM.format(*friction), speed) as (target, _, bench, known):
        known = elbow(bench, known, 4 / 3 * WEIGHT, level)
        pusher, axis = Pusher(bench, known), known.axes[2]
        for direction in (1, -1):
            rec = _push(pusher, f"{direction}", 2, direction, 0.5, axis.fast, HOLD)
            q = columns(rec, "q", 2)[:, 1]
            pushed = rec["phase"] == 2
            place = q[pushed][0]
            held, _ = breakaway_torque(rec, known, 2, direction)
            found[direction] = direction * held + float(axis.load.weight(np.array(place)))
            n = round(0.02 / rec.sample_time)
            fastest = np.abs(q[n:] - q[:-n]).max() / (n * rec.sample_time)
            # it is braked where it passes 80 % of its speed; a tenth more until that acts
            assert fastest < 0.9 * speed, (direction, fastest)
        assert target.status().trip is None
    # half the difference is friction, half the sum weight; 3 %: the torque grew in 4 s
    assert 0.5 * (found[1] - found[-1]) == pytest.approx(level, rel=0.03)
    weight = WEIGHT * np.cos(0.5)
    assert 0.5 * (found[1] + found[-1]) == pytest.approx(weight, abs=0.03 * level + 0.01)


def test_a_push_from_where_friction_has_all_but_broken_away_is_made_again_from_farther_off(
    tmp_path: Path,
) -> None:
    """What holds a joint lies anywhere within friction of its weight, and here at its end."""
    with benched(tmp_path, ARM.format(*SMALL), 1.0) as (_, _, bench, known):
        known = elbow(bench, known, WEIGHT, SMALL[1])
        pusher, axis = Pusher(bench, known), known.axes[2]
        rec = _push(pusher, "edge", 2, -1, 1.26, axis.slow, HOLD)
        assert bench.recordings[-2:] == ["edge.npz", "edge_eased.npz"]
        held, _ = breakaway_torque(rec, known, 2, -1)
    assert held == pytest.approx(SMALL[1], rel=0.03)


def test_a_recording_begins_with_what_held_the_joints_where_the_machine_stands(
    tmp_path: Path,
) -> None:
    """After a motion a simulated machine begins again elsewhere: the elbow sank at 0.32 rad/s."""
    with benched(tmp_path, ARM.format(*SMALL), 0.3) as (target, _, bench, known):
        assert bench.held_here() is not None
        way = np.tile(known.pose, (2000, 1))
        way[:, 0] -= 0.05 * np.sin(np.linspace(0.0, np.pi / 2.0, 2000)) ** 2
        there = Reference(way, 0.001, kind="x", machine="")
        for name in ("first", "second"):
            rec = bench.record(name, PROGRAM, CHANNELS, reference=there)
            # rad/s, over 20 ms; the motion itself 0.04
            assert np.abs(rec["q"][20:] - rec["q"][:-20]).max() / 0.02 < 0.08, name
        assert target.status().trip is None


@pytest.mark.parametrize("name", [
    "breakaway",
    pytest.param("high-speed", marks=pytest.mark.long("one push is like the other; lost: its own")),
])  # fmt: skip
def test_a_joint_that_moves_in_one_direction_only_is_at_a_stop_and_pushed_no_further(
    tmp_path: Path, name: str
) -> None:
    """It was pushed by up to 16 N m, 80 % of its drive's torque, against a friction of 0.4."""
    x, y = (0.25 * np.cos(0.9) - 0.13 * np.sin(0.9), 0.25 * np.sin(0.9) + 0.13 * np.cos(0.9))
    with benched(tmp_path, STOP.format(x=x, y=y), 2.0 * np.pi) as (_, _, bench, known):
        load = Load(0.05 + 0.16 / 3)
        axis = axis_of(1, bench.machine.joints[0], 0.0, load, 0.4, 0.3)
        touch = _touch(bench, replace(known, axes={1: axis}))
        axis = replace(with_pushes(axis), way=(-touch, 1.5))
        pusher = Pusher(bench, replace(known, axes={1: axis}))
        said = r"something holds joint 1 up at 1\.\d+ rad.*does not move, and the other way it goes"
        with pytest.raises(Unmeasured, match=said):
            if name == "breakaway":
                _push(pusher, "beside", 1, 1, touch, axis.fast, HOLD)
            else:
                _steady(pusher, replace(axis, way=(touch, 1.5)), 1, 0.7, 1.0, (0.2, 0.8))
        pushes = [Recording.load(bench.folder / file) for file in bench.recordings]
    pushed = [rec["torque"][rec["phase"] == 2] for rec in pushes if "phase" in rec.names]
    # N m: `breakaway` tries twice the friction, and then 2.5 times what breaks it away the other
    # way, where the torque has grown by 0.1 until it is seen to go; `high-speed` 0.7 and 1.25 times
    assert max(np.abs(torque).max(initial=0.0) for torque in pushed) < 2.5 * (0.4 + 0.1)


def _touch(bench: Bench, known: Known) -> float:
    """Beside where the block is, rad: nearer than what a joint goes that has broken away."""
    with pytest.raises(Unmeasured):
        Pusher(bench, known).push("touch", 1, 1, 1.3, 0.1)
    return float(Recording.load(bench.folder / "touch.npz")["q"].max()) - 6e-3
