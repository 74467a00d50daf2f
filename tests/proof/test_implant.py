"""Implants: exact truth in real recordings, and how the answers are counted."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from zendsp.proof.answer import Answer, Estimate, Finding, Smallest
from zendsp.proof.implant import Implant, Subject, implant_lines, uncontrolled
from zendsp.proof.implant_sizes import shape_of, share_of, size_of, sized
from zendsp.proof.implant_wishes import WANTED, Wish
from zendsp.proof.implanted import ACTUATORS, FORCES, LAWS, Columns, middle_motion
from zendsp.proof.real import Recordings, model_folder

RATE = 500.0


def columns(*gains: float, coupled: float = 0.0) -> Columns:
    """A recording of a joint a gain; joint 2 is driven through motor 1 too where ``coupled``."""
    t = np.arange(5000) / RATE
    q = np.stack([0.5 * np.sin(3 * t + k) + 0.2 * np.sin(7.3 * t) for k in range(len(gains))], 1)
    u = np.stack([np.sin(3 * t + k) + 0.7 * np.sin(5 * t) for k in range(len(gains))], 1)
    matrix = np.eye(len(gains))
    matrix[-1, 0] += coupled
    actuator = {"gain": {"value": list(gains)}, "matrix": matrix.tolist()}
    model = {
        "mechanism": {"kind": "urdf", "parameters": {}},
        "effect": [{"kind": "coulomb", "joint": 1, "level": {"value": 0.2}}],
        "actuator": actuator,
        "columns": {"time": "t", "position": "q", "command": "u"},
    }
    return Columns({"t": t, "q": q, "u": u}, model)


def test_motion_is_that_in_the_middle_of_each_row() -> None:
    t = np.arange(5000) * 1e-3
    q, v, a = (x[200:-200] for x in middle_motion(t, 0.1 * np.sin(3 * t)))  # filter's ends
    middle = (t + 5e-4)[200:-200]
    assert np.allclose(q, 0.1 * np.sin(3 * middle), atol=1e-6)
    assert np.allclose(v, 0.3 * np.cos(3 * middle), atol=1e-5)
    assert np.allclose(a, -0.9 * np.sin(3 * middle), atol=1e-4)


WISHES = [w for recordings in WANTED.values() for each in recordings for w in each]


@pytest.mark.parametrize("effect", sorted({w.effect for w in WISHES if w.share}))
def test_an_implant_without_a_stated_size_is_a_tenth_of_the_torque(effect: str) -> None:
    c = columns(2.0)
    times, size = size_of(Wish(effect), None, c)
    p = sized(effect, size, shape_of(effect, c.motion(1), c, 1), c.motion(1))
    assert math.isnan(times)
    assert share_of(effect, p, c, 1) == pytest.approx(0.1, rel=0.15)


@pytest.mark.parametrize("effect", sorted({"stiffness", "disturbance", "gain_drift", "dead_zone"}))
def test_only_the_torque_of_its_joint_changes_whatever_drives_it(effect: str) -> None:
    c = columns(2.0, 3.0, coupled=0.4)
    p = sized(effect, 0.05, shape_of(effect, c.motion(2), c, 2), c.motion(2))
    after = Columns(c.with_law(effect, 2, p), c.model).torques
    assert np.allclose(after[:, 0], c.torques[:, 0], atol=1e-12)
    law = FORCES.get(effect)
    if law is not None:
        assert np.allclose(after[:, 1] - c.torques[:, 1], law(c.motion(2), p), atol=1e-12)


def test_an_actuator_with_the_law_gives_the_recorded_torque() -> None:
    m = columns(2.0).motion(1)
    numbers = {"width": 0.1, "ratio": 0.2, "time_constant": 3.0, "rows": 7.0}
    gives = {
        "torque_gain": lambda u: 1.2 * u,
        "gain_drift": lambda u: u * (1.0 + 0.2 * (1.0 - np.exp(-m.t / 3.0))),
        "dead_zone": lambda u: 2.0 * (u / 2.0 - np.clip(u / 2.0, -0.1, 0.1)),  # 2 N m a unit
        "delay": lambda u: np.append(m.torque[:7], u[:-7]),
    }
    assert set(gives) == set(ACTUATORS)
    for effect, give in gives.items():
        assert np.allclose(give(ACTUATORS[effect](m, numbers)), m.torque, atol=1e-12), effect


def test_a_hysteresis_forgets_its_start_and_holds_its_force() -> None:
    m = columns(2.0).motion(1)
    force = FORCES["hysteresis"](m, {"force": 0.3, "stiffness": 15.0})
    assert np.abs(force).max() <= 0.3 * (1 + 1e-9)
    far = np.abs(np.gradient(m.q)) > 1e-3  # well after a reversal it resists
    assert np.mean(np.sign(force[far]) == np.sign(m.v[far])) > 0.8


def test_controller_is_dropped_because_the_command_is_not_its_any_more() -> None:
    table = tomllib.loads(uncontrolled((model_folder() / "emps.toml").read_text()))
    assert (
        "controller" not in table and table["columns"]["command"] == "vir" and "actuator" in table
    )


def an_implant(times: float, answer: Answer, *, silent: bool = False) -> Implant:
    """A spring of 2 N m/rad at joint 1."""
    numbers = {"coefficient": 2.0, "neutral": 0.0}
    return Implant("m", "stiffness", 1, times, 0.1, numbers, answer, silent)


def test_an_implant_counts_as_named_only_as_the_first_finding_of_its_joint() -> None:
    right = Finding("stiffness", 1, {"coefficient": Estimate(2.1, 0.1)}, 0.9)
    of_another = Finding("ripple", 2, {}, 0.9)
    alone = an_implant(2.0, Answer("missing", (of_another, right)))
    assert alone.named and not alone.wrong and alone.deviation() == pytest.approx(1.0)
    late = an_implant(2.0, Answer("missing", (Finding("ripple", 1, {}, 0.9), right)))
    assert not late.named and late.mechanism and late.wrong
    other = an_implant(2.0, Answer("missing", (of_another,)), silent=True)
    assert not other.named and not other.mechanism and not other.wrong and other.complete


def test_implants_above_and_below_the_stated_size_are_counted_apart() -> None:
    named = Answer("missing", (Finding("stiffness", 1, {"coefficient": Estimate(2.1, 0.1)}, 0.9),))
    done = [
        an_implant(1.3, named),
        an_implant(2.0, Answer("complete"), silent=True),
        an_implant(0.5, Answer("complete"), silent=True),
        an_implant(math.nan, Answer("unexplained")),
    ]
    above, below, silent = implant_lines(done)[-3:]
    assert "1 of 2 named first" in above and "1 of 2 called complete" in above
    assert "0 of 1 named first" in below and "1 of 1 called complete" in below
    assert "0 of 1 called complete" in silent
    assert [i.broken for i in done] == [False, True, False, False]


def test_sizes_follow_what_the_report_of_the_unaltered_recordings_states() -> None:
    said = Answer("complete", smallest=(Smallest(1, "stiffness", 3.0), Smallest(2, "ripple", 1.0)))
    subject = Subject("m", Recordings((), ()), Path(), said)
    spring = Wish("stiffness", times=2.0)
    assert size_of(spring, subject.stated(spring), columns(2.0)) == (2.0, 6.0)
    assert subject.stated(Wish("ripple")) is None


def test_no_more_than_fifty_implants_are_asked_one_a_joint_and_each_has_a_law() -> None:
    assert len(WISHES) <= 50 and {w.effect for w in WISHES} <= set(LAWS)
    for each in (each for recordings in WANTED.values() for each in recordings):
        assert len({w.joint for w in each}) == len(each)
