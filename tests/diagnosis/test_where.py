"""Where the torque lacks: the places that a report names."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_models import model_of

from zendsp.diagnosis.decide.assemble import (
    beside_given_gravity,
)
from zendsp.diagnosis.decide.naming import _disturbance
from zendsp.diagnosis.decide.thresholds import TOLERANCE
from zendsp.diagnosis.measure import bursts
from zendsp.diagnosis.measure.bursts import Bursts
from zendsp.diagnosis.measure.where import Missing, regions
from zendsp.physics.calibration.fit import Fit
from zendsp.physics.calibration.handles import free_handles, get_values
from zendsp.physics.model import Model, Quantity, Term


def test_where_torque_is_missing_is_reported_over_all_recordings_together() -> None:
    """A torque at 0.5 rad, which only the second recording reaches, and a smaller one at -0.5."""
    t = np.arange(5000) * 0.002

    def one(low: float, high: float) -> Missing:
        q = low + (high - low) * (0.5 - 0.5 * np.cos(3.0 * t))
        pull = np.exp(-(((q - 0.5) / 0.1) ** 2)) + 0.4 * np.exp(-(((q + 0.5) / 0.1) ** 2))
        plain = {"velocity": np.gradient(q, t), "acceleration": t, "command": t}
        return Missing(t, pull, np.full(len(t), 0.01), {"position": q, **plain})

    for both in ([one(-1.0, 0.0), one(-1.0, 1.0)], [one(-1.0, 1.0), one(-1.0, 0.0)]):
        region = next(r for r in regions(both, 1) if r.variable == "position")
        low, high = region.interval
        assert low < 0.45 and high > 0.55 and region.share < 0.9
    assert regions([], 1) == []


def test_an_interval_with_hardly_more_than_its_share_of_time_is_not_reported_as_the_place() -> None:
    t = 0.002 * np.arange(5000)
    q = np.sin(3.0 * t)
    level = np.where(np.abs(q) < 0.97, 1.0, 0.6)  # 91 % of it in 84 % of the time
    plain = {"velocity": t, "acceleration": t, "command": t}
    lacks = [Missing(t, level, np.full(len(t), 0.01), {"position": q, **plain})]
    assert not [r for r in regions(lacks, 1) if r.variable == "position"]


def test_a_mismatch_of_fast_motion_both_ways_is_told_as_one_of_speed() -> None:
    """It had no place: beyond ±2 rad/s is no interval of the velocity."""
    t = 0.002 * np.arange(20000)
    q, qd = np.sin(3.0 * t + np.sin(0.1 * t)), 3.0 * np.cos(3.0 * t + np.sin(0.1 * t))

    def told(pull: np.ndarray) -> list[str]:
        states = {"velocity": qd, "position": q, "acceleration": -9.0 * q, "command": t}
        lacks = [Missing(t, pull, np.full(len(t), 0.01), states, {"velocity": "rad/s"})]
        return [str(r) for r in regions(lacks, 1) if r.variable in ("velocity", "speed")]

    (fast,) = told(np.where(np.abs(qd) > 2.0, 1.0, 0.0))
    assert fast.startswith("speed 2.") and fast.endswith("rad/s"), fast
    (slow,) = told(np.where(np.abs(qd) < 0.5, 1.0, 0.0))
    assert slow.startswith("velocity -0."), "slow motion is one of the velocity"
    (forward,) = told(np.where(qd > 2.0, 1.0, 0.0))
    assert forward.startswith("velocity")


def test_a_gravity_beside_the_models_own_is_reported_beside_the_given_number() -> None:
    """0.4878 and 0.0705 at 1.738 rad equal 0.4108 and another gravity. No recording separates them,
    so the second is known no better than the first.
    """
    given = model_of()
    given = replace(given, mechanism={**given.mechanism, "gravity": (Quantity(0.4108),)})
    found = Term("gravity", 1, {"torque": Quantity(0.0705), "angle": Quantity(1.738)})
    model = replace(
        given,
        terms=(found,),
        mechanism={**given.mechanism, "gravity": (Quantity(0.4878),)},
    )
    handles = tuple(h for h in free_handles(model) if h.key in ("gravity", "torque", "angle"))
    at = get_values(model, handles)
    fitted: Any = Fit(model, handles, at, np.diag([1e-8] * 3), 0.0, (), np.zeros(0), np.zeros(0))
    told = beside_given_gravity(given, 1, fitted)
    q = np.linspace(-3.0, 3.0, 50)

    def torque(m: Model) -> np.ndarray:
        (term,) = m.terms
        beside = term.value("torque") * np.sin(q - term.value("angle"))
        return np.asarray(m.mechanism["gravity"][0].value * np.sin(q) + beside)

    assert told.model.mechanism["gravity"][0].value == 0.4108
    np.testing.assert_allclose(torque(told.model), torque(model), atol=1e-12)
    std = dict(zip((h.key for h in handles), told.std, strict=True))
    assert std["gravity"] == 0.0
    assert std["torque"] == pytest.approx(TOLERANCE * 0.4108 * np.cos(told.x[2]), rel=0.01)
    assert std["angle"] == pytest.approx(
        TOLERANCE * 0.4108 * np.sin(told.x[2]) / told.x[1], rel=0.01
    )


@pytest.mark.parametrize(("largest", "laws"), [(0.05, ["saturation", "voltage_limit"]), (0.4, [])])
def test_a_push_at_commands_that_come_at_no_other_time_may_be_a_limit_of_the_drive(
    largest: float, laws: list[str]
) -> None:
    """A drive that reached its limit on the held-out recording alone was a disturbance (0.85)."""
    command = np.full(5000, largest)
    command[3000:3400] = 0.3
    record = SimpleNamespace(recording="a", t0=0.0, sample_time=2e-3, n=5000, command=command)
    each: Any = (SimpleNamespace(records=[[record]]),)
    push = Bursts(((6.02, 6.75),), ("a",), 0.9, 0.2, 0.1, 0.01, 1.0, 1.0, (1.0,), 0.95)
    push = replace(push, driven=bursts._driven(push, each, 1))
    given: Any = SimpleNamespace(torque_unit=lambda _: "N m", at=lambda _: ())
    found = _disturbance([SimpleNamespace(joint=1, bursts=push)], given)  # type: ignore[list-item]
    assert sorted(found.indistinguishable) == laws
