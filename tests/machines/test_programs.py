"""Every shipped control program compiles without a warning, runs in the fast clock and does what it
teaches.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zendsp.reference import (
    Reference,
    load_machine,
    make_circle,
    make_lspb,
    make_point_to_point,
    make_swing,
)
from zendsp_isr.build import source_root
from zendsp_isr.sources import gather
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime

Array = np.ndarray  # type: ignore[type-arg]
PROGRAMS = sorted(path.name for path in (source_root() / "programs").glob("*.c"))


@contextmanager
def running(
    machine: str, program: str, flags: tuple[str, ...] = (), **config: Any
) -> Iterator[Runtime]:
    """A machine in the fast clock with a program loaded; without noise, which is not what programs
    are tested for.
    """
    with Runtime(machine, clock="fast", machine_config={"ideal": 1, **config}) as runtime:
        result = runtime.compile(gather(program), flags)
        assert result.ok, result.diagnostics
        assert not result.diagnostics, "shipped programs give no warning"
        runtime.load(result.key)
        yield runtime


def record(runtime: Runtime, seconds: float, *channels: str, **values: Any) -> dict[str, Array]:
    """Write values, run, and return each channel as an array of (rows,) or (rows, elements)."""
    if values:
        runtime.write(values, "test")
    ticks = round(seconds * 1000)
    status = runtime.acquire_configure(0, AcquireConfig(channels, seconds=seconds))
    runtime.acquire_start(0)
    runtime.start(ticks=ticks + 5)
    runtime.wait_paused()
    assert runtime.status().trip is None, runtime.status().trip
    rows = runtime.acquire_read(0, 0, ticks)
    out = {}
    for name in channels:
        columns = [i for i, channel in enumerate(status.channels) if channel.split("[")[0] == name]
        out[name] = rows[:, columns] if len(columns) > 1 else rows[:, columns[0]]
    return out


def play(
    runtime: Runtime,
    reference: Reference,
    *channels: str,
    before: float = 0.5,
    after: float = 0.5,
    **values: Any,
) -> dict[str, Array]:
    """Play a reference after an approach of ``before`` seconds; rows of the reference only, then
    ``after`` seconds.
    """
    runtime.write({**reference.tables(), "approach_time": before, **values}, "test")
    names = ("play_time", *channels)
    out = record(runtime, before + reference.duration + after + 0.1, *names)
    first = int(np.argmax(out["play_time"] >= -1e-9))
    return {
        name: out[name][first : first + reference.samples + round(after * 1000)] for name in names
    }


@pytest.mark.parametrize("program", PROGRAMS)
def test_program_compiles_without_a_warning_and_without_conversion_warnings(program: str) -> None:
    machine = (
        "wam7"
        if program.startswith("wam")
        else "pendulum" if program.startswith("pendulum") else "imi_planar"
    )
    with running(machine, program, ("-Wconversion", "-Wshadow")) as runtime:
        runtime.start(ticks=20)
        runtime.wait_paused()
        assert runtime.status().tick == 20
        described = [v for v in runtime.variables() if not v.description]
        assert not described, "every variable says what it is"


@pytest.mark.parametrize(
    ("joint", "direction", "level"),
    [(1, 1, 11.4 * 1.05), (1, -1, 11.4 * 0.95), (2, 1, 3.1 * 0.96), (2, -1, 3.1 * 1.04)],
)
def test_torque_steps_find_the_breakaway_torque_of_each_joint_and_direction(
    joint: int, direction: int, level: float
) -> None:
    with running("imi_planar", "torque_steps.c") as runtime:
        out = record(
            runtime, 8.0, "moved", "breakaway", "torque", "position", joint=joint,
            direction=direction, first=0.4 * level, increment=0.01 * level, hold=0.1, go=1,
        )
    assert out["moved"][-1] == 1.0 and out["torque"][-1] == 0.0
    # a step of 1 %, and the joint needs a few steps' time to travel the threshold
    assert abs(out["breakaway"][-1]) == pytest.approx(level, rel=0.04)
    assert np.sign(out["breakaway"][-1]) == direction == np.sign(out["position"][-1])


def test_constant_torque_settles_at_the_speed_where_friction_equals_it() -> None:
    level = 2.35 * 0.96 + 1.1 * 0.97 * 2.0  # N m: friction of joint 2 at 2 rad/s, upwards
    with running("imi_planar", "constant_torque.c", q2=-2.0) as runtime:
        out = record(runtime, 3.0, "q", "qd", "running", joint=2, level=level, upper=1.8, go=1)
    steady = (out["q"][:, 1] > 0.5) & (out["q"][:, 1] < 1.6)
    assert out["qd"][steady, 1].mean() == pytest.approx(2.0, rel=0.02)
    assert out["running"][-1] == 0.0 and abs(out["q"][-1, 1]) < 2.15, "braked before the stop"
    assert np.abs(out["q"][:, 0]).max() < 5e-3, "the other joint is held"


def test_constant_torque_compiles_for_one_joint() -> None:
    with running("pendulum", "constant_torque.c", ("-DN=1",)) as runtime:
        out = record(runtime, 2.0, "speed", joint=1, level=0.5, upper=900.0, lower=-900.0, go=1)
    assert out["speed"][-1] > 10.0


def test_inverse_dynamics_follows_the_circle_and_friction_compensation_takes_most_of_the_error_away() -> (  # noqa: E501
    None
):
    reference = make_circle(load_machine("imi_planar"), radius=0.15, duration=4.5)
    rms = {}
    for compensate in (False, True):
        with running("imi_planar", "inverse_dynamics.c") as runtime:
            out = play(runtime, reference, "q", "r", "e", compensate=compensate)
        n = reference.samples
        assert np.abs(out["r"][:n] - reference.q).max() < 1e-9, "the table is played row by row"
        rms[compensate] = np.sqrt(np.mean(out["e"][:n] ** 2, axis=0))
    # the paper's orders
    assert rms[False][0] == pytest.approx(2e-3, rel=0.9) and rms[False][1] == pytest.approx(
        1.5e-2, rel=0.9
    )
    assert np.all(1.0 - rms[True] / rms[False] > 0.5)


def test_the_table_is_interpolated_between_its_rows() -> None:
    coarse = Reference(np.column_stack([np.linspace(0.0, 0.5, 51), np.zeros(51)]), 0.02)
    with running("imi_planar", "inverse_dynamics.c") as runtime:
        out = play(runtime, coarse, "r", "rd", row_rate=50, before=0.2)
    k = 505  # 10.1 rows after the first
    assert out["r"][k, 0] == pytest.approx(0.5 * 0.505, abs=1e-9)
    assert out["rd"][k, 0] == pytest.approx(0.5, abs=1e-9)


def test_hold_brings_the_reference_to_rest_on_its_path_and_continues_it() -> None:
    reference = make_circle(load_machine("imi_planar"), radius=0.15, duration=4.5)
    with running("imi_planar", "inverse_dynamics.c") as runtime:
        free = play(runtime, reference, "r", before=0.5)["r"]
    with running("imi_planar", "inverse_dynamics.c") as runtime:
        runtime.write({**reference.tables(), "approach_time": 0.5}, "test")
        names = ("play_time", "r", "rd", "rdd", "qd")
        moving = record(runtime, 2.0, *names)
        held = record(runtime, 1.5, *names, hold=True)
        after = record(runtime, 1.5, *names, hold=False)
    assert np.abs(moving["rd"][-1]).max() > 0.05, "it was moving"
    stands = held["r"][400:]
    assert (
        np.ptp(stands, axis=0).max() < 1e-12 and np.abs(held["qd"][1200:]).max() < 0.02
    ), "0.3 s later nothing moves"
    assert not held["rd"][400:].any() and not held["rdd"][400:].any()
    # on its path all the while: each point of the held motion is one of the free motion at the same
    # time of the reference
    for out in (held, after):
        k = out["play_time"] * 1000.0
        for joint in range(2):
            assert (
                np.abs(
                    out["r"][:, joint] - np.interp(k, np.arange(len(free)), free[:, joint])
                ).max()
                < 1e-6
            )
    # rd and rdd are the derivatives of r, slowing down included, to the half sample by which their
    # differences are taken apart
    speed = (held["r"][2:] - held["r"][:-2]) / 0.002
    assert np.abs(speed - held["rd"][1:-1]).max() < 1e-3 * np.abs(held["rdd"]).max()
    slope = (held["rd"][2:] - held["rd"][:-2])[10:280] / 0.002
    assert np.abs(slope - held["rdd"][11:281]).max() < 0.02 * np.abs(held["rdd"]).max()
    assert after["play_time"][-1] > held["play_time"][-1] + 1.0, "and goes on"


def test_pd_holds_at_its_place_on_the_circle_and_continues_from_there() -> None:
    with running("imi_planar", "pd.c") as runtime:
        moving = record(runtime, 3.0, "r1", "qd1")
        held = record(runtime, 1.5, "r1", "qd1", "tau1", hold=True)
        after = record(runtime, 1.5, "r1", "qd1", hold=False)
    assert abs(moving["r1"][-1] - moving["r1"][-100]) > 1e-2, "it was moving"
    assert np.ptp(held["r1"][400:]) < 1e-12 and np.abs(held["qd1"][1000:]).max() < 1e-2
    assert np.abs(held["tau1"]).max() < 200.0, "without a jerk beyond the machine's torque"
    assert (
        np.abs(np.diff(np.concatenate([held["r1"], after["r1"]]))).max() < 5e-3
        and np.ptp(after["r1"]) > 0.05
    )


def test_pd_goes_from_its_circle_to_a_table_and_back_without_a_step() -> None:
    with running("imi_planar", "pd.c") as runtime:
        parts = [
            record(runtime, 2.0, "r1", "r2", "tau1", use_table=table)
            for table in (False, True, False)
        ]
    for name in ("r1", "r2"):
        assert (
            np.abs(np.diff(np.concatenate([part[name] for part in parts]))).max() < 5e-3
        ), "an empty table is all zeros, and far off"
    assert (
        abs(parts[1]["r1"][-1]) < 1e-9 and np.ptp(parts[2]["r1"][-500:]) > 0.05
    ), "it got there, and is on the circle again"
    assert max(np.abs(part["tau1"]).max() for part in parts) < 245.0, "within the machine's torque"


@pytest.mark.parametrize(
    "change", [{"radius": 0.5}, {"center1": -0.4}, {"center2": 1.0}, {"turn_time": 3.0}]
)
def test_pd_goes_to_a_changed_circle_without_a_step(change: dict[str, float]) -> None:
    with running("imi_planar", "pd.c") as runtime:
        before = record(runtime, 2.6, "r1", "r2", "tau1", "tau2")
        after = record(runtime, 3.0, "r1", "r2", "tau1", "tau2", **change)
        assert runtime.status().trip is None
    for name in ("r1", "r2"):
        both = np.concatenate([before[name], after[name]])
        assert np.abs(np.diff(both)).max() < 5e-3, name
    assert np.abs(after["tau1"]).max() < 245.0, "within the machine's torque"
    center = after["r1"] - change.get("center1", 0.2), after["r2"] - change.get("center2", 0.6)
    radius = np.hypot(*center)[-1000:]
    assert np.allclose(radius, change.get("radius", 0.4), atol=1e-6), "it got there"


@pytest.mark.parametrize("program", ["pd.c", "inverse_dynamics.c", "joint_pd.c"])
def test_a_start_far_from_a_table_takes_the_time_that_the_way_needs(program: str) -> None:
    """As after a STOP in a run whose host is gone: the table begins where the run began."""
    far = make_point_to_point(
        load_machine("imi_planar"), start=[1.0, -1.0], goal=[0.5, 0.0], duration=2.0
    )
    with running("imi_planar", program, q1=-0.6, q2=1.2) as runtime:
        runtime.write({"ref": far.q, "use_table": True, "approach_time": 0.2}, "test")
        out = record(runtime, 6.0, "q", "tau")
    assert np.all(np.abs(out["tau"]).max(axis=0) < [0.5 * 245.0, 0.5 * 39.2])
    assert np.abs(np.diff(out["q"], axis=0)).max() < 4.0e-3, "rad a sample"
    assert np.abs(out["q"][-1] - far.q[-1]).max() < 0.05, "and it is played to its end"


@pytest.mark.parametrize("program", ["pd.c", "inverse_dynamics.c", "joint_pd.c"])
def test_another_approach_time_or_row_rate_does_not_move_what_is_played(program: str) -> None:
    """Execute puts them back after a run, at whose end the reference stands."""
    motion = make_point_to_point(load_machine("imi_planar"), start=0.0, goal=0.5, duration=1.0)
    reference = "r1" if program == "pd.c" else "r"
    with running("imi_planar", program) as runtime:
        runtime.write({"ref": motion.q, "use_table": True, "approach_time": 0.2}, "test")
        record(runtime, 1.3, reference)
        after = record(runtime, 1.5, reference, approach_time=1.5, row_rate=300)
    assert np.ptp(after[reference], axis=0).max() < 1e-12


def test_changing_play_repeats_the_motion_from_where_the_machine_stands() -> None:
    reference = make_point_to_point(
        load_machine("imi_planar"), start=0.0, goal=[0.3, 0.0], duration=0.3
    )
    with running("imi_planar", "inverse_dynamics.c") as runtime:
        play(runtime, reference, "q", before=0.3)
        again = record(runtime, 0.7, "play_time", "r", "playing", play=1)
    assert again["play_time"][0] == pytest.approx(-0.3, abs=2e-3)
    assert (
        again["r"][0, 0] == pytest.approx(0.3, abs=1e-3)
        and np.abs(np.diff(again["r"][:, 0])).max() < 5e-3
    )
    assert again["playing"].sum() == pytest.approx(301, abs=2)


def test_pendulum_current_loop_in_user_code_follows_its_torque_reference() -> None:
    with running("pendulum", "pendulum_current.c", drive="voltage", brake=0.5) as runtime:
        out = record(runtime, 0.5, "i", "i_ref", "v", torque=0.25)
    # three steps of the 10-bit sensor
    assert out["i"][100:] == pytest.approx(0.25 / 0.1762, abs=0.03)
    assert np.abs(out["v"]).max() <= 24.0


def test_pendulum_voltage_mode_gives_the_straight_line_of_the_motor() -> None:
    points = []
    for volts in (5.0, 9.0, 13.0, -8.0, -12.0):
        with running("pendulum", "pendulum_current.c", drive="voltage", brake=0.0) as runtime:
            out = record(runtime, 3.0, "i", "v", "q", voltage_mode=True, volts=volts)
        speed = (out["q"][-1] - out["q"][1500]) / (0.001 * (len(out["q"]) - 1501))
        points.append(
            (speed / out["i"][1500:].mean(), out["v"][1500:].mean() / out["i"][1500:].mean())
        )
    slope, intercept = np.polyfit(*np.array(points).T, 1)
    assert slope == pytest.approx(0.1762, rel=0.02) and intercept == pytest.approx(5.54, rel=0.1)


def test_pendulum_torque_law_is_the_papers() -> None:
    with running("pendulum", "pendulum_torque.c") as runtime:
        out = record(runtime, 1.5, "tau", "q", go=1, duration=1.0)
    first = int(np.argmax(out["tau"] != 0.0))
    t = 0.001 * np.arange(1000)
    law = 0.3 * (1 - np.exp(-1.8 * t)) + 0.1 * np.sin(26 * t + 0.08) + 0.1 * np.sin(12 * t + 0.34)
    assert np.abs(out["tau"][first : first + 1000] - law).max() < 1e-9
    assert np.all(out["tau"][first + 1002 :] == 0.0) and abs(out["q"][-1]) > 0.05


@pytest.fixture(scope="module")
def swing() -> Reference:
    return make_swing(load_machine("pendulum"), goal=math.pi, duration=0.8, torque_limit=0.5)


@pytest.mark.long("tests/reference integrates a swing; lost: that the machine in C follows it")
def test_a_swing_planned_with_friction_reaches_its_goal_open_loop_and_better_in_closed_loop(
    swing: Reference,
) -> None:
    """The nominal model has no breakaway, bristle or asymmetry: the machine does, so open loop ends
    near the goal, not on it.
    """
    ends = {}
    for kp, kv in ((0.0, 0.0), (1.2, 0.005)):
        with running("pendulum", "pendulum_track.c") as runtime:
            out = play(runtime, swing, "q", "tau", before=0.0, after=1.0, kp=kp, kv=kv)
        ends[kp] = abs(float(out["q"][-1]) - math.pi)
    assert ends[0.0] < 0.35 and ends[1.2] < 0.1


@pytest.mark.long("tests/reference integrates a swing; lost: what a lack of friction does")
def test_a_swing_planned_without_friction_misses_open_loop_and_is_helped_by_compensation() -> None:
    frictionless = make_swing(
        load_machine("pendulum"), goal=math.pi, duration=0.8, torque_limit=0.5, friction=0.0
    )
    with running("pendulum", "pendulum_track.c") as runtime:
        bare = play(runtime, frictionless, "q", before=0.0, kp=0.0, kv=0.0)
    with running("pendulum", "pendulum_compensation.c") as runtime:
        helped = play(runtime, frictionless, "q", before=0.0)
    assert abs(bare["q"][-1] - math.pi) > 0.5
    assert abs(helped["q"][-1] - math.pi) < 0.3


def test_wam_follows_the_papers_lspb_with_all_joints_and_gravity_compensation_matters() -> None:
    start = np.array([0, 0.5, 0, 1.5, -1.5, 0, 0])
    goal = np.array([0.5, 0.0, 0.5, 2.0, -1.0, 0.5, 0.5])
    reference = make_lspb(
        load_machine("wam7"), start=start, goal=goal, duration=7.0, blend_time=1.0
    )
    error = {}
    for compensate in (True, False):
        with running(
            "wam7", "wam_pd_gravity.c", **{f"q{j + 1}": float(x) for j, x in enumerate(start)}
        ) as runtime:
            out = play(runtime, reference, "e", "g", "q", compensate=compensate)
        error[compensate] = np.abs(out["e"][: reference.samples]).max(axis=0)
    assert error[True].max() < 0.04
    assert error[False][1] > 3.0 * error[True][1], "joint 2 carries the arm"


def test_gravity_of_the_program_is_pinocchios(wam_of_pinocchio: Any) -> None:
    import pinocchio as pin

    model = wam_of_pinocchio
    data = model.createData()
    with running("wam7", "wam_pd_gravity.c") as runtime:
        out = record(runtime, 0.2, "q", "g")
    for q, g in zip(out["q"][::40], out["g"][::40], strict=True):
        assert np.abs(np.array(pin.computeGeneralizedGravity(model, data, q)) - g).max() < 1e-9
    assert math.isfinite(out["g"].sum())


def test_joint_pd_suits_a_joint_of_hardly_any_inertia(tmp_path: Path) -> None:
    """As the fins of a model of a fish: 2.5e-7 kg m^2."""
    pytest.importorskip("mujoco")
    model = tmp_path / "fin.xml"
    model.write_text(
        """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="fin" axis="0 1 0"/>
        <geom size="0.005" pos="0.01 0 0" mass="0.002"/></body></worldbody></mujoco>"""
    )
    with running(str(model), "joint_pd.c") as made:
        assert 0.0 < np.ravel(made.read(["J"])[1]["J"])[0] < 1e-6


def test_a_program_for_any_machine_says_metres_and_newtons_where_joints_slide() -> None:
    pytest.importorskip("mujoco")
    model = str(Path(__file__).parent / "models" / "cart.xml")
    with running(model, "joint_pd.c", joints="slider,pole") as made:
        unit = {v.name: v.unit for v in made.variables()}
        status = made.acquire_configure(0, AcquireConfig(("q", "tau"), seconds=0.1))
    assert status.units == ("m", "rad", "N", "N m")
    assert (unit["rdd"], unit["ref"]) == ("m/s^2, rad/s^2", "m or rad")
    assert (unit["J"], unit["amplitude"]) == ("kg, kg m^2", "m or rad")
