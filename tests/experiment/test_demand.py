"""A planned motion keeps within what the drive of a joint has, by what a gentle one has shown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import zendsp
from zendsp.errors import Refused, Unmeasured
from zendsp.experiment import Lab, Result, any_friction, run_experiment
from zendsp.experiment.demand import Felt, felt, within_drive
from zendsp.experiment.gentle import (
    CALM,
    EASY,
    GENTLE,
    PEAK,
    SLOWEST,
    TORQUE,
    TURN,
    _calm,
)
from zendsp.experiment.sliding import Sliding
from zendsp.experiment.watch import Held, cause
from zendsp.recording import Recording
from zendsp.reference import Reference
from zendsp_protocol.messages import JointInfo, Trip
from zendsp_protocol.states import TripReason

# 20 kg turned round in 0.15 s at 0.67 m/s would take 90 N and more
SLIDE = """<mujoco model="slide20"><worldbody><body><joint name="slide" type="slide" axis="1 0 0"
range="-0.5 0.5" frictionloss="5" damping="10"/><geom type="box" size="0.1 0.1 0.1" mass="20"/>
</body></worldbody><actuator><motor joint="slide" ctrlrange="-{most} {most}"/></actuator>
</mujoco>"""
PERIOD = 1e-3


def own(speed: float = 3.0, force: float = 40.0) -> JointInfo:
    """What the slide declares."""
    return JointInfo(
        name="slide", unit="m", position_min=-0.5, position_max=0.5, speed_max=speed,
        torque_max=force,
    )  # fmt: skip


def found(folder: Path, name: str, most: float, options: tuple[str, ...] = ()) -> Result:
    """The result of an experiment on the slide with this largest force; it must not trip."""
    file = folder / "slide20.xml"
    file.write_text(SLIDE.format(most=most))
    given = [part for option in options for part in ("--machine-option", option)]
    with zendsp.local(str(file), clock="fast", options=["--speed", "100", *given]) as target:
        try:
            return run_experiment(name, Lab(folder, target))
        finally:
            assert target.status().trip is None


def swing(share: float) -> Reference:
    """A move of 0.4 m there and back in 1 s, about 0.1 m, and slower by a share."""
    t = np.arange(0.0, 1.0 / share, PERIOD) * share
    q = 0.1 - 0.2 * np.cos(2 * np.pi * t)
    return Reference(q[:, None], PERIOD, kind="point_to_point", machine="")


def pieces(slope: float, way: float) -> Sliding:
    """Of six moves over a way: 20 kg, 5 N, 10 N s/m, and a weight of 8 N that changes along it; and
    0.1 N that differ from piece to piece.
    """
    s = (np.arange(10) + 0.5) / 10
    q = np.concatenate([way * s, way * s[::-1]] * 3)
    sign = np.repeat([1.0, -1.0] * 3, 10)
    speed = sign * way * np.tile(1.5 * np.sin(np.pi * s), 6)
    gain = sign * way * np.tile(4.0 * np.cos(np.pi * s), 6)
    noise = np.random.default_rng(1).normal(0.0, 0.1, len(q))
    torque = 20.0 * gain + 5.0 * sign + 10.0 * speed + 8.0 + slope * (q - way / 2) + noise
    part = np.repeat(np.arange(6), 10)
    return Sliding(part, q, speed, torque, np.zeros_like(q), gain)


@pytest.mark.parametrize("name", ["friction", "low-speed"])
def test_a_heavy_slide_is_moved_as_fast_as_its_drive_can(tmp_path: Path, name: str) -> None:
    result = found(tmp_path, name, 40.0)
    level, slope = ("coulomb1", "viscous1") if name == "friction" else ("level1", "slope1")
    assert result.values[level].value == pytest.approx(5.0, abs=0.05)  # 1 %: ten times its ±
    assert result.values[slope].value == pytest.approx(10.0, abs=0.2)
    slower = [x for x in result.warnings if "its drive has 40 N (torque_max)" in x]
    assert len(slower) == 1
    assert slower[0].startswith("Joint 1 moves at up to ")
    rec = Recording.load(tmp_path / name / "joint1.npz")
    full = np.abs(rec["tau"]) >= 40.0  # a row or two, where the plan's acceleration jumps
    assert full.mean() < 1e-3


def test_a_drive_that_friction_leaves_nothing_is_told_with_its_limit_before_it_moves_far(
    tmp_path: Path,
) -> None:
    with pytest.raises(Refused) as e:
        found(tmp_path, "friction", 6.0)
    said = str(e.value)
    assert "joint 1 (slide): friction and weight take up to 5." in said
    assert "of the 6 N that its drive has (torque_max)" in said
    assert "larger torque_max" in said
    assert "inertia" not in said, "it is the force that lacks"
    assert not (tmp_path / "friction" / "joint1.npz").exists()


def test_a_gentle_motion_that_saturates_the_drive_is_made_again_slower(tmp_path: Path) -> None:
    """It carries four times what it declares: 12 N of 10 would turn it round in 2 s."""
    result = found(tmp_path, "mechanical", 10.0, ("effect1=inertia joint=1 amount=60.0",))
    assert result.values["mass1"].value == pytest.approx(80.0, rel=0.02)
    rec = Recording.load(tmp_path / "mechanical" / "joint1_gentle.npz")
    assert rec["play_time"].max() > 6 * 2.0 * CALM


def test_a_motion_is_as_slow_as_its_drive_wants_and_no_slower() -> None:
    x = np.array([20.0, 5.0, 10.0, 3.0, 0.0])
    known = Felt(20.0, 0.1, x, np.zeros((5, 5)))
    weak = own(force=60.0)
    share, said = within_drive(swing, known, weak, 1)
    assert known.takes(swing(share), 1)[0] == pytest.approx(60.0, rel=1e-3)
    # inertia, by the largest acceleration of 7.9 m/s^2, takes far more than what is left
    assert share == pytest.approx((0.8 * 52.0 / (20.0 * 7.9)) ** 0.5, rel=0.02)
    assert "its drive has 60 N (torque_max)" in said
    assert within_drive(swing, known, own(force=300.0), 1) == (1.0, "")
    with pytest.raises(Unmeasured, match=r"take up to 8 N from -0.1 to 0.3 m, of the 8.5 N"):
        within_drive(swing, known, own(force=8.5), 1)


def test_what_a_gentle_motion_shows_is_told_from_what_its_pieces_scatter_by() -> None:
    known = felt(pieces(30.0, 0.2), 1.0, 0.0)
    std = np.sqrt(np.diag(known.covariance))
    assert (np.abs(known.x - [20.0, 5.0, 10.0, 8.0, 30.0]) < 4.0 * std).all()
    assert known.inertia == known.x[0]


def test_a_weight_that_may_change_along_the_way_is_not_continued_where_it_is_not_told() -> None:
    """Over 5 mm nothing bounds what it might be at the end of 0.4 m; 400 N would refuse a slide
    that takes 13.
    """
    known = felt(pieces(0.0, 0.005), 20.0, 0.0)
    assert known.x[4] == 0.0
    assert known.x[0] == 20.0, "as it is declared: so little acceleration tells nothing"
    assert known.takes(swing(0.1), 1)[1] < 15.0


def test_of_a_joint_that_slid_one_way_all_that_it_took_is_friction() -> None:
    whole = pieces(0.0, 0.2)
    up = whole.part == 0
    one = Sliding(*(x[up] for x in (
        whole.part, whole.q, whole.speed, whole.torque, whole.gravity, whole.acceleration
    )))  # fmt: skip
    still = replace(one, q=one.q[:3], speed=one.speed[:3], torque=one.torque[:3],
                    acceleration=one.acceleration[:3])  # fmt: skip
    known = felt(still, 20.0, 0.0)
    assert known.inertia == 0.0
    rest = np.abs(still.torque - 20.0 * still.acceleration).max()
    assert known.takes(swing(0.1), 1)[1] == pytest.approx(rest)


def test_the_gentle_motion_of_a_slow_joint_goes_once_a_quarter_of_the_way() -> None:
    """In 2 s it would go 2 cm, and its weight be guessed from there for 0.8 m."""
    assert _calm(own(), 0.2, 1.0) == [(CALM, 0.2)] * GENTLE
    *calm, (seconds, way) = _calm(own(0.3), 0.2, 1.0)
    assert way == 0.2
    assert PEAK * way / seconds == pytest.approx(EASY * 0.3)
    for seconds, near in calm:  # friction is not known yet: it might be let go too fast
        assert seconds == CALM
        assert PEAK * near / seconds == pytest.approx(EASY * 0.3)
    *_, (seconds, way) = _calm(own(0.01), 0.2, 1.0)
    assert seconds == pytest.approx(SLOWEST)
    assert PEAK * way / seconds == pytest.approx(EASY * 0.01)
    for seconds, way in _calm(own(), 0.1, 400.0):
        assert TURN * way / seconds**2 * 400.0 == pytest.approx(TORQUE * 40.0)


def test_a_trip_names_the_drive_that_was_at_its_limit_and_else_the_inertia(tmp_path: Path) -> None:
    t = np.arange(0.0, 1.0, PERIOD)
    tau = np.where(t > 0.8, -40.0, 5.0)
    held = Held({}, (1,), {1: (-0.2, 0.2)}, {1: 0.6})

    def said(tau: np.ndarray, reason: TripReason) -> str:
        rec = Recording.from_columns({"tau": tau, "play_time": t}, sample_time=PERIOD)
        return cause(Trip(reason=reason, joint=1, value=0.7, limit=0.5), rec, [own()], held)

    for reason in (TripReason.POSITION, TripReason.SPEED):
        full = said(tau, reason)
        assert "at its limit of 40 N (torque_max) in 40% of the last 0.5 s" in full
        assert "torque_max" not in said(0.9 * tau, reason)


def test_a_plan_that_its_drive_cannot_keep_trips_with_the_drive_in_the_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(any_friction, "within_drive", lambda *given: (1.0, ""))
    file = tmp_path / "slide20.xml"
    file.write_text(SLIDE.format(most=40))
    said = r"command was at its limit of 40 N .*does not turn round .*larger torque_max"
    with (
        zendsp.local(str(file), clock="fast", options=["--speed", "100"]) as target,
        pytest.raises(Refused, match=said),
    ):
        run_experiment("friction", Lab(tmp_path, target))
