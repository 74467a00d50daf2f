"""Stiffness of joints that feel one another's links."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from zendsp.diagnosis.decide.assemble import _beside_other_springs
from zendsp.diagnosis.decide.thresholds import SPRINGS_SHIFT
from zendsp.diagnosis.transmission import other_springs
from zendsp.physics.calibration.fit import Fit
from zendsp.physics.calibration.handles import Handle

STIFFNESS, STD = 1500.0, 6.0


def _fit() -> Fit:
    handles = (Handle("term", 0, "stiffness"), Handle("term", 0, "load_inertia"))
    model: Any = None
    nothing = np.zeros(0)
    return Fit(
        model, handles, np.array([STIFFNESS, 1.2]), np.diag([STD**2, 0.01**2]), 0.0,
        (False, False), nothing, nothing,
    )  # fmt: skip


def _decision(joint: int, spring: bool) -> Any:
    return SimpleNamespace(joint=joint, claims=(SimpleNamespace(is_transmission=spring),))


@pytest.mark.parametrize("springs", [(True, False), (True, True)])
def test_springs_of_two_joints_hold_what_they_shift_each_other(springs: tuple[bool, bool]) -> None:
    searches = [_decision(joint, spring) for joint, spring in enumerate(springs, 1)]
    agreed = _beside_other_springs(searches, {1: _fit(), 2: _fit()})
    apart = SPRINGS_SHIFT * STIFFNESS if all(springs) else 0.0
    assert np.sqrt(agreed[1].covariance[0, 0]) == pytest.approx(np.hypot(STD, apart))
    assert agreed[1].covariance[1, 1] == pytest.approx(0.01**2), "of the stiffness alone"


@pytest.mark.parametrize(("goal", "passes"), [(np.inf, 8), (900.0, 8), (700.0, 6)])
def test_a_fit_of_springs_ends_where_it_would_not_reach_its_goal(
    goal: float, passes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    lively = [200.0, 195.0, 150.0, 149.5]  # of a part: climbed, then by Newton's steps
    values = [*lively, 1200.0, 1170.0, 640.0, 639.5, 639.0]
    left = iter(values)
    path = SimpleNamespace(liveliest=lambda _: "part")
    arm: Any = SimpleNamespace(links=None)
    chain = SimpleNamespace(smoothed=lambda _: (0.0, None), link_motion=lambda _: None)
    for name, stand_in in {
        "path_along": path, "chain_of": chain, "_strength": np.ones(1), "strongest": np.ones(1),
        "ArmMotion": arm,
    }.items():  # fmt: skip
        monkeypatch.setattr(other_springs, name, lambda *_, stand_in=stand_in: stand_in)
    asked = []

    def changed(path: Any, model: Any, _arm: Any) -> tuple[Any, float]:
        asked.append(path)
        return model, next(left)

    for name in ("_climbed", "_by_newton"):
        monkeypatch.setattr(other_springs, name, changed)
    anything: Any = None
    _, value = other_springs._likeliest(anything, anything, anything, arm, goal)
    assert values[passes - 1] == value
    assert asked == ["part"] * len(lively) + [path] * (passes - len(lively))


def test_what_begins_likely_is_the_goal_of_other_sets_of_springs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A fit of two springs, of which one was none, had taken twenty times that of the true one."""
    begin = {(1,): 900.0, (2,): 300.0, (1, 2): 250.0}
    ends = {(1,): 800.0, (2,): 200.0, (1, 2): 190.0}
    goals: dict[tuple[int, ...], float] = {}

    def likeliest(_rec: Any, _data: Any, model: Any, _arm: Any, goal: float) -> tuple[Any, float]:
        goals[model] = goal
        return model, ends[model]

    monkeypatch.setattr(other_springs, "with_springs_at", lambda _, some: tuple(sorted(some)))
    monkeypatch.setattr(
        other_springs, "arm_motion", lambda _r, _d, model: SimpleNamespace(deviance=begin[model])
    )
    monkeypatch.setattr(other_springs, "_likeliest", likeliest)
    number = SimpleNamespace(value=1.0)
    spring = SimpleNamespace(parameters={"load_inertia": number}, value=lambda _: 1.0)
    monkeypatch.setattr(other_springs, "springs_of", lambda _: {1: spring, 2: spring})
    monkeypatch.setattr(other_springs, "replace", lambda number, value: number)
    monkeypatch.setattr(other_springs, "_with_numbers", lambda model, *_: model)
    data: Any = SimpleNamespace(records=[None])
    model: Any = None
    assert other_springs.needed_springs(data, model, (1, 2)) == (2,)
    assert list(goals) == [(2,), (1,), (1, 2)]
    assert goals == {(2,): np.inf, (1,): 200.0, (1, 2): 200.0 - other_springs.LEAST_GAIN}
