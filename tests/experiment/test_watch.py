"""What an experiment does where a drive is at its limit, or a held joint gives way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zendsp
from zendsp.errors import Incomplete, Refused, Unmeasured
from zendsp.experiment import Estimate, Lab, Result, run_experiment
from zendsp.experiment.breakaway import HOLD, _push
from zendsp.experiment.knowing import as_found
from zendsp.experiment.low_speed import low_speed
from zendsp.experiment.push import Pusher
from zendsp.experiment.result import FoundEffect
from zendsp.experiment.watch import Held, Seen, firmer, guarded, name_yielding, stood, widen
from zendsp.link import Target
from zendsp.recording import Recording
from zendsp.reference import Reference
from zendsp_protocol.messages import JointInfo
from zendsp_protocol.states import TripReason

# the upright outer link is held by 0.025 N m/rad, and weighs as much as that at 0.4 rad
LIGHT = """<mujoco model="light"><compiler angle="radian"/><worldbody><body pos="0 0 0.5">
<joint name="a" axis="0 1 0" range="-1 1"/>
<inertial pos="0 0 0.1" mass="0.1" diaginertia="0.0002 0.0002 0.0001"/><body pos="0 0 0.2">
<joint name="b" axis="0 1 0" range="-0.3 0.3"/>
<inertial pos="0 0 0.05" mass="0.02" diaginertia="0.00002 0.00002 0.00001"/></body></body>
</worldbody><actuator><motor joint="a" ctrlrange="-2 2"/><motor joint="b" ctrlrange="-1 1"/>
</actuator></mujoco>"""
COUPLED = """<mujoco model="coupled"><compiler angle="radian"/><worldbody><body>
<joint name="j1" axis="0 0 1" range="-2.5 2.5" armature="0.5" damping="1.5" frictionloss="3"/>
<inertial pos="0.2 0 0" mass="5" diaginertia="0.01 0.08 0.08"/><body pos="0.4 0 0">
<joint name="j2" axis="0 0 1" range="-2.5 2.5" armature="0.02" damping="0.5" frictionloss="1"/>
<inertial pos="0.15 0 0" mass="6" diaginertia="0.01 0.1 0.1"/></body></body></worldbody>
<actuator><motor joint="j1" ctrlrange="-60 60"/><motor joint="j2" ctrlrange="-20 20"/></actuator>
</mujoco>"""
STUCK = """<mujoco model="stuck"><compiler angle="radian"/><worldbody><body>
<joint name="b" axis="0 0 1" range="-2 2" armature="0.1" damping="0.5" frictionloss="30"/>
<inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><motor joint="b" ctrlrange="-10 10"/></actuator></mujoco>"""
# the second of three joints is held by a friction that its drive cannot overcome
ONE_STUCK = """<mujoco model="one"><compiler angle="radian"/><default><joint axis="0 0 1"
range="-2 2" armature="0.1" damping="0.5" frictionloss="1"/></default><worldbody>
<body><joint name="a"/><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
<body><joint name="b" frictionloss="30"/><inertial pos="0 0 0" mass="1"
diaginertia="0.01 0.01 0.01"/><body><joint name="c"/><inertial pos="0 0 0" mass="1"
diaginertia="0.01 0.01 0.01"/></body></body></body></worldbody><actuator>
<motor joint="a" ctrlrange="-10 10"/><motor joint="b" ctrlrange="-10 10"/>
<motor joint="c" ctrlrange="-10 10"/></actuator></mujoco>"""
# a block at 0.2 rad, which no range declares
STOP = """<mujoco model="stop"><compiler angle="radian"/><worldbody><body><joint name="turn"
axis="0 0 1" armature="0.05" damping="0.3" frictionloss="0.4" range="-2 2"/><geom type="capsule"
fromto="0 0 0 0.4 0 0" size="0.02" mass="1"/></body><body pos="0.25 0.13 0"><geom type="box"
size="0.05 0.05 0.1" mass="10"/></body></worldbody>
<actuator><motor joint="turn" ctrlrange="-20 20"/></actuator></mujoco>"""
# of what turns a hundredth is declared: its loop swings up
THROWN = """<mujoco model="thrown"><compiler angle="radian"/><worldbody><body>
<joint name="a" axis="0 0 1" range="-2 2" armature="0.1"/>
<inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><motor joint="a" ctrlrange="-10 10"/></actuator></mujoco>"""
HEAVY = """<mujoco model="heavy"><compiler angle="radian"/><worldbody><body>
<joint name="shoulder" axis="0 1 0" range="-2 2" damping="1"/>
<inertial pos="0.4 0 0" mass="3" diaginertia="0.03 0.03 0.03"/></body></worldbody>
<actuator><motor joint="shoulder" ctrlrange="-8 8"/></actuator></mujoco>"""
# a count of 1.5 mrad, which in 10 ms is a speed of 0.15 rad/s
COARSE = ["--machine-option", "counts=4096", "--machine-option", "speed_max=0.15"]
# what holds it may be 8 N below its weight of 49: to break it away takes twice that more
LIFT = """<mujoco model="lift20"><worldbody><body><joint name="lift" type="slide" axis="0 0 1"
range="-0.5 0.5" frictionloss="8" damping="30"/><geom type="box" size="0.1 0.1 0.1" mass="5"/>
</body></worldbody><actuator><motor joint="lift" ctrlrange="-80 80"/></actuator></mujoco>"""
OWN = JointInfo(name="b", position_min=-0.3, position_max=0.3, torque_max=1.0)


@contextmanager
def started(folder: Path, xml: str, options: Sequence[str] = ()) -> Iterator[Target]:
    file = folder / "machine.xml"
    file.write_text(xml)
    with zendsp.local(str(file), clock="fast", options=["--speed", "100", *options]) as target:
        yield target


OTHERS = [
    pytest.param(name, marks=pytest.mark.long("one loop watches all; lost: its motion"))
    for name in ("low-speed", "mechanical")
]


@pytest.mark.parametrize(
    "name",
    [
        "mechanical",
        *(
            pytest.param(name, marks=pytest.mark.long("one loop watches all; lost: its motion"))
            for name in ("friction", "low-speed")
        ),
    ],
)
def test_a_held_joint_that_gives_way_ends_the_experiment_at_a_tenth_of_its_range(
    tmp_path: Path, name: str
) -> None:
    """Before, its loop was made stiffer after the gentle motion, in which it gave a little."""
    with started(tmp_path, LIGHT) as target:
        with pytest.raises(Refused, match=r"joint 2 \(b\) was to be held") as e:
            run_experiment(name, Lab(tmp_path, target))
        assert all(x in str(e.value) for x in ("gave way by 0.06", "larger inertia", "acknowledge"))
        trip = target.status().trip
        assert trip is not None and trip.reason == TripReason.POSITION and trip.joint == 2
        rate = target.info.rate_hz
    for file in (tmp_path / name).glob("*.npz"):
        rec = Recording.load(file)
        driven = rec.t - rec.t[0] <= trip.tick / rate if "ended" in file.name else rec.t >= 0.0
        # rad; 5 mrad: what it swings in a few samples. Then an upright link falls, undriven
        assert np.abs(rec["q"][driven, 1]).max() < 0.065, file.name
    first, gentle = (
        np.asarray(Recording.load(tmp_path / name / f"{part}.npz").parameters["J"])
        for part in ("where_it_stands", "joint1_gentle")
    )
    assert gentle[1] == pytest.approx(3.0 * first[1]) and gentle[0] == pytest.approx(first[0])
    gave = np.ptp(Recording.load(tmp_path / name / "joint1_gentle.npz")["q"][:, 1])
    assert gave < 0.03, "rad; 0.058 with the loop as it was"


def test_a_held_joint_that_gives_way_as_a_recording_ends_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recording that was whole by then came without an error, and with other words."""
    with started(tmp_path, LIGHT) as target:
        real = target.acquire

        def whole(*given: Any, **values: Any) -> Recording:
            try:
                return real(*given, **values)
            except Incomplete:
                return target.acquire_load()

        monkeypatch.setattr(target, "acquire", whole)
        with pytest.raises(Refused, match=r"joint 2 \(b\) was to be held.*acknowledge"):
            run_experiment("mechanical", Lab(tmp_path, target))


def test_limits_are_as_they_were_after_a_watched_block(tmp_path: Path) -> None:
    with started(tmp_path, LIGHT) as target:
        target.download("joint_pd.c")
        before = target.limits()
        with guarded(target, "x", Held({2: 0.1}, (1,))):
            inside = target.limits()
            assert inside.position_max == pytest.approx((before.position_max[0], 0.16))
            # it stands at 0, and has to come to 0.1
            assert inside.position_min == pytest.approx((before.position_min[0], -0.06))
        assert target.limits() == before
        with pytest.raises(ZeroDivisionError), guarded(target, "x", Held({2: 0.1}, (1,))):
            raise ZeroDivisionError
        assert target.limits() == before


@pytest.mark.parametrize("name", ["friction", "low-speed", "mechanical"])
def test_a_joint_that_its_drive_cannot_move_gets_no_numbers(tmp_path: Path, name: str) -> None:
    with started(tmp_path, STUCK) as target, pytest.raises(Refused) as e:
        run_experiment(name, Lab(tmp_path, target))
    said = str(e.value)
    assert "the command of joint 1 (b) is at its limit of 10 N m" in said
    assert "larger inertia" not in said, "it is the torque that lacks"


@pytest.mark.parametrize("name", ["friction", *OTHERS])
def test_a_joint_at_its_limit_is_left_out_and_the_others_are_measured(
    tmp_path: Path, name: str
) -> None:
    """It ended the experiment, and the numbers of the first joint were lost with it."""
    with started(tmp_path, ONE_STUCK) as target:
        found = run_experiment(name, Lab(tmp_path, target))
        assert target.status().trip is None
    level = "level" if name == "low-speed" else "coulomb"
    for joint in (1, 3):
        e = found.values[f"{level}{joint}"]
        assert abs(e.value - 1.0) < 4 * e.std < 0.2, (joint, e)
    assert not any(f"{level}2" in key for key in found.values)
    left = [text for text in found.warnings if "left out" in text]
    assert len(left) == 1 and left[0].startswith("Joint 2 is left out: joint2_gentle: the command")
    assert "at its limit of 10 N m" in left[0]


@pytest.mark.parametrize("name", ["friction", *OTHERS])
def test_a_joint_whose_inertia_is_declared_wrongly_is_stopped_in_its_gentle_motion(
    tmp_path: Path, name: str
) -> None:
    wrong = ["--machine-option", "effect1=inertia joint=1 amount=10.0"]
    with started(tmp_path, THROWN, wrong) as target:
        with pytest.raises(Refused, match=r"1 \(a\) was to move from .* and came to .* inertia"):
            run_experiment(name, Lab(tmp_path, target))
        assert target.status().trip is not None
    files = {file.stem for file in (tmp_path / name).glob("*.npz")}
    assert files == {"where_it_stands", "joint1_gentle_ended"}


def test_a_joint_that_its_drive_cannot_carry_is_refused_before_anything_moves(
    tmp_path: Path,
) -> None:
    with started(tmp_path, HEAVY) as target, pytest.raises(Refused, match="limit of 8 N m"):
        run_experiment("low-speed", Lab(tmp_path, target))
    assert [f.name for f in (tmp_path / "low-speed").glob("*.npz")] == ["where_it_stands.npz"]


def test_numbers_are_as_uncertain_as_a_held_joint_may_have_made_them(tmp_path: Path) -> None:
    with started(tmp_path, COUPLED) as target:
        low = run_experiment("low-speed", Lab(tmp_path, target))
    # of the file: 0.5 + 0.08 + 5 0.2^2 + 0.1 + 6 0.55^2 in its pose
    truth = {"inertia1": 2.695, "level1": 3.0, "slope1": 1.5, "level2": 1.0, "slope2": 0.5}
    for name, true in truth.items():
        e = low.values[name]
        assert abs(e.value - true) < 2 * e.std < 0.3 * true, (name, e)
    assert sum("Joint 2 was to be held while joint 1" in w for w in low.warnings) == 1
    assert not any("Joint 1 was to be held" in w for w in low.warnings)


def test_what_a_held_joint_couples_into_a_move_is_fitted_beside_friction(tmp_path: Path) -> None:
    """The forearm gave way by 11 %, in time with the moves: friction had been 1.4 ± 1.0 N m."""
    with started(tmp_path, COUPLED) as target:
        found = run_experiment("mechanical", Lab(tmp_path, target))
    truth = {"inertia1": 2.695, "coulomb1": 3.0, "viscous1": 1.5, "coulomb2": 1.0, "viscous2": 0.5}
    for name, true in truth.items():
        e = found.values[name]
        assert abs(e.value - true) < 3 * e.std < 0.1 * true, (name, e)
    assert not any("was to be held" in text for text in found.warnings)


def test_a_held_joint_widens_by_the_most_that_it_can_couple() -> None:
    result = Result("x", "X", "arm", {n: Estimate(1.0, 0.0) for n in ("inertia1", "l1", "s1")})
    seen = {1: Seen(0.0, 1.0, 1.0, 0.0, fast=2.0), 2: Seen(0.0, 0.1, 0.0, 0.1)}
    widen(result, 1, seen, np.array([1.0, 0.25]), ("inertia1", "l1", "s1"), 4.0)
    # 0.1 of the way, times sqrt(1 * 0.25) kg m^2, times 4 rad/s^2, over 2 rad/s
    assert [e.std for e in result.values.values()] == pytest.approx([0.05, 0.2, 0.1])
    ways = Result("x", "X", "arm", {n: Estimate(1.0, 0.0) for n in ("l1_pos", "s1_neg")})
    parameters = {"level_pos": Estimate(1.0, 0.0), "level_neg": Estimate(1.0, 0.0)}
    ways.effects.append(FoundEffect("coulomb_asymmetry", 1, parameters))
    widen(ways, 1, seen, np.array([1.0, 0.25]), ("inertia1", "l1", "s1"), 4.0)
    assert [e.std for e in ways.values.values()] == pytest.approx([0.2, 0.1]), "of each direction"
    both = [e.std for e in ways.effects[0].parameters.values()]
    assert both == pytest.approx([0.2, 0.2])
    still = Result("x", "X", "arm", {"l1": Estimate(1.0, 0.3)})
    name_yielding(still, 1, 1.0, {2: 0.049})
    assert not still.warnings and len(result.warnings) == 1


def test_a_loop_is_made_stiffer_only_where_the_sampling_bears_it() -> None:
    joints, seen = (OWN, OWN), {1: Seen(0.0, 0.2, 0.2, 0.0), 2: Seen(0.0, 0.05, 0.0, 0.05)}
    assert firmer(seen, 1, joints, 1000.0, np.ones(2)) == [2]
    assert firmer(seen, 1, joints, 4000.0, np.array([1.0, 3.0])) == [2]
    with pytest.raises(Refused, match=r"gave way by 0\.05 rad"):
        firmer(seen, 1, joints, 1000.0, np.array([1.0, 3.0]))
    slightly = {**seen, 2: Seen(0.0, 0.012, 0.0, 0.012)}
    assert firmer(slightly, 1, joints, 1000.0, np.array([1.0, 3.0])) == []


def test_a_joint_that_was_to_move_and_did_not_is_refused() -> None:
    stood("x", 1, {1: Seen(0.0, 0.9, 1.0, 0.1)}, OWN)
    with pytest.raises(Refused, match=r"was to move 1 rad and moved 0\.2"):
        stood("x", 1, {1: Seen(0.0, 0.2, 1.0, 0.8)}, OWN)


def test_a_count_of_a_coarse_encoder_is_no_speed_and_a_speed_beyond_the_limit_still_trips(
    tmp_path: Path,
) -> None:
    """Standing still was a trip, at 0.15 and 0.31 rad/s."""
    with started(tmp_path, STUCK, COARSE) as target:
        target.download("joint_pd.c")
        target.acquire(["q"], seconds=20.0, start=True)
        assert target.status().trip is None
    free = STUCK.replace('"30"', '"0.1"')
    for speed, reason in ((0.12, None), (0.2, TripReason.SPEED)):
        with started(tmp_path, free, COARSE) as target:
            target.download("joint_pd.c")
            target.upload("ref", 0.001 * speed * np.arange(3000)[:, None])
            target.write(row_rate=1000, approach_time=1.0)
            with suppress(Incomplete):
                target.acquire(["q"], seconds=4.0, start=True)
            trip = target.status().trip
            assert (trip.reason if trip is not None else None) == reason, speed
            # 1 s to begin, 0.3 s to follow, and 0.26 s over which it is seen
            assert trip is None or 1000 < trip.tick < 2000


def test_what_is_held_follows_from_the_reference_or_the_push() -> None:
    way = np.stack([np.linspace(0.0, 1.0, 50), np.full(50, 0.3)], axis=1)
    held = Held.by(Reference(way, 0.001, kind="x", machine=""), {})
    assert held == Held({2: 0.3}, (1,), {1: (0.0, 1.0)}, {1: pytest.approx(1000.0 / 49.0)})
    assert Held.by(None, {"joint": 2, "place": [0.1, 0.2]}) == Held({1: 0.1}, (2,))
    assert Held.by(None, {}) == Held({}, ())


@pytest.mark.parametrize("name", ["friction", OTHERS[0]])
def test_a_joint_that_something_holds_up_is_held_there_at_once(tmp_path: Path, name: str) -> None:
    """It was pushed against the block for the whole of each move, by up to 20 N m."""
    with started(tmp_path, STOP) as target:
        said = r"something holds joint 1 \(turn\) up at 0\.19\d* rad, within its range of -2 to 2"
        with pytest.raises(Refused, match=said):
            run_experiment(name, Lab(tmp_path, target))
        assert target.status().trip is None
    rec = Recording.load(tmp_path / name / "joint1.npz")
    q, tau, blocked = (rec[x].ravel() for x in ("q", "tau", "blocked"))
    seen = int(np.argmax(blocked > 0))
    touched = seen - int(np.argmax(np.abs(q[seen::-1] - q[seen]) > 2e-3))
    assert (seen - touched) * rec.sample_time < 0.4, "s, from the touch on"
    # then by no more than it had moved by, once its loop has come to rest; 0.2 N m: noise
    later = seen + round(0.3 / rec.sample_time)
    assert np.abs(tau[later:]).max() < np.abs(tau[:touched]).max() + 0.2


def turned(angle: float) -> str:
    """STOP with its block farther on, beyond what `low-speed` moves over."""
    x, y = 0.25 * np.cos(angle) - 0.13 * np.sin(angle), 0.25 * np.sin(angle) + 0.13 * np.cos(angle)
    return STOP.replace('pos="0.25 0.13 0"', f'pos="{x} {y} 0" euler="0 0 {angle}"')


@pytest.mark.parametrize(("name", "came"), [
    pytest.param(
        "breakaway", "while its command came to",
        marks=pytest.mark.long("a push against a block is told alike; lost: its words"),
    ),
    ("high-speed", "that it had moved by"),
])  # fmt: skip
def test_a_push_that_something_holds_up_is_ended_and_says_where(
    tmp_path: Path, name: str, came: str
) -> None:
    """`breakaway` pushed against the block by up to 16 N m; `high-speed` for 4.5 s and more, five
    times, each with a quarter more torque.
    """
    with started(tmp_path, turned(0.9)) as target:
        said = rf"something holds joint 1 \(turn\) up at 1\.\d+ rad.*{came}"
        with pytest.raises(Refused, match=said):
            run_experiment(name, Lab(tmp_path, target))
        assert target.status().trip is None
    ended = [Recording.load(file) for file in (tmp_path / name).glob("joint1*.npz")]
    rec, = (rec for rec in ended if "blocked" in rec.names and rec["blocked"].any())
    q, tau, blocked = (rec[x].ravel() for x in ("q", "tau", "blocked"))
    seen = int(np.argmax(blocked > 0))
    most = int(np.argmax(q[:seen]))  # the touch
    assert (seen - most) * rec.sample_time < 0.5, "s, from the touch on"
    # then by no more than it had moved by
    later = seen + round(0.3 / rec.sample_time)
    assert np.abs(tau[later:]).max() < np.abs(tau[:most]).max()


def test_a_staircase_ends_where_a_joint_broke_away_and_stands(tmp_path: Path) -> None:
    """Beside a block it was pushed by twice the torque again and again, up to 16 N m."""
    with started(tmp_path, turned(0.9)) as target:
        lab = Lab(tmp_path, target)
        low = low_speed(lab)
        with lab.bench("breakaway") as bench:
            known = as_found(bench, lab, low)
            said = r"something holds joint 1 up at 1\.\d+ rad.*it broke away, went 0\.0\d+ rad"
            with pytest.raises(Unmeasured, match=said):
                _push(Pusher(bench, known), "beside", 1, 1, 1.07, known.axes[1].slow, HOLD)
            assert bench.recordings[-1] == "beside.npz", "no second, larger staircase"
        rec = Recording.load(tmp_path / "breakaway" / "beside.npz")
    # that of a staircase, twice the friction of 0.4 N m
    assert np.abs(rec["torque"][rec["phase"] == 2]).max() < 2.0 * 0.4 + 0.2


def test_a_lift_that_friction_held_up_is_pushed_by_what_its_drive_has_left(tmp_path: Path) -> None:
    """By 15 N, all that is left beside its whole weight, it did not break away."""
    with started(tmp_path, LIFT) as target:
        lab = Lab(tmp_path, target)
        low = low_speed(lab)
        with lab.bench("breakaway") as bench:
            known = as_found(bench, lab, low)
            assert known.axes[1].pace == low.values["peak1"].value < 0.25, "as its drive could"
            rec = _push(Pusher(bench, known), "up", 1, 1, 0.315, known.axes[1].fast, HOLD)
    pushing = rec["phase"] == 2
    assert (rec["phase"] > 2).any(), "it broke away and was braked"
    assert 49.05 + 8.0 < np.abs(rec["torque"][pushing]).max() < 0.8 * 80.0
