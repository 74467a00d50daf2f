"""Facts of a recording (speed, torque, range), from which grids, starts and bounds of effects
follow.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.signals import Signals
from zendsp.diagnosis.search.rounds import below_least
from zendsp.physics.calibration.joint import facts
from zendsp.physics.calibration.terms import grid_of
from zendsp.physics.effects import library
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Quantity, Term

T, COUNT = 0.002, 1e-4
MODEL = parse_model(
    {
        "sample_time": T,
        "mechanism": {"kind": "rotary", "parameters": {"inertia": {"value": 0.01}}},
        "effect": [{"kind": "coulomb", "joint": 1, "level": {"value": 0.01}}],
    }
)


def recording(seconds: float, size: float, middle: float = 0.0, moving: float = 1.0) -> Signals:
    """A sine about ``middle``, and rest behind it."""
    t = np.arange(round(seconds / T)) * T
    swing: npt.NDArray[np.float64] = np.where(t < moving * t[-1], np.sin(9.0 * t), 0.0)
    q = np.asarray(COUNT * np.round((middle + size * swing) / COUNT))
    return Signals(f"{size}", t, T, q[:, None], size * swing[:, None], None, np.array([COUNT]))


def test_facts_of_several_recordings_are_those_of_their_union() -> None:
    hard = facts(prepare([recording(4.0, 0.9, 1.0)], MODEL).records[0][0])
    data = prepare([recording(20.0, 0.1), recording(4.0, 0.9, 1.0)], MODEL)
    one, other = (facts(record[0]) for record in data.records)
    assert one == other
    for name in ("fast", "fastest", "strong", "strongest"):
        assert getattr(one, name) == pytest.approx(getattr(hard, name))
    # from -0.1 to 1.9
    assert one.centre == pytest.approx(0.9, abs=0.01)
    assert one.scale.position == pytest.approx(2.0, abs=0.01)
    assert facts(data.records[0][0].thinned(4)) == one


def test_a_joint_that_rests_nearly_always_has_a_speed_and_a_command() -> None:
    record = prepare([recording(20.0, 0.5, moving=0.03)], MODEL).records[0][0]
    record.motion.states[1][1000:] = 0.0
    record._facts = None
    known = facts(record)
    assert known.fast > 0.0 and known.fastest >= known.fast and known.strong > 0.0
    for effect in (e for e in library().values() if not e.reads):
        for point in grid_of(effect, record, MODEL):
            assert all(map(math.isfinite, point.values())), effect.name
            assert point.get("velocity", 1.0) > 0.0


@pytest.mark.parametrize("name", ["elasticity", "backlash", "stiffening"])
def test_a_transmission_may_swing_as_fast_as_rows_can_show(name: str) -> None:
    # at a bound a stiff contact of a slow recording was taken for a weaker drive of less mass
    known = facts(prepare([recording(4.0, 0.9)], MODEL).records[0][0])
    (stiffness,) = (p for p in library()[name].parameters if p.name == "stiffness")
    assert stiffness.limits is not None
    reduced = 0.25 * known.scale.inertia  # of two equal halves
    fastest = math.sqrt(stiffness.limits(known)[1] / reduced)
    assert fastest * T == pytest.approx(min(math.pi, 2 * math.pi * 200.0 * T))


def test_a_dead_zone_swallows_less_than_the_usual_command() -> None:
    """A slosh tank at a wrist became a dead zone of two to four times its RMS command, at 94 %."""
    record = prepare([recording(4.0, 0.9)], MODEL).records[0][0]
    (width,) = library()["dead_zone"].parameters
    assert width.limits is not None
    assert width.limits(facts(record))[1] == pytest.approx(0.9 / math.sqrt(2.0), rel=0.02)


def test_a_drive_whose_limit_all_commands_pass_or_no_friction_lets_through_is_no_law() -> None:
    """A wrist whose command only overcame a friction that nobody had written down was called
    saturated at 0.0 N m, at 97 %.
    """
    data = prepare([recording(4.0, 0.9), recording(4.0, 0.5)], MODEL)
    rubbing = parse_model(
        {
            "sample_time": T,
            "mechanism": {"kind": "rotary", "parameters": {"inertia": {"value": 0.01}}},
            "effect": [{"kind": "coulomb", "joint": 1, "level": {"value": 0.2}}],
        }
    )
    for level, model, refused in (
        (0.0, MODEL, True), (0.03, MODEL, True), (0.1, MODEL, False), (0.1, rubbing, True),
    ):  # fmt: skip
        term = Term("saturation", 1, {"level": Quantity(level)})
        assert below_least(term, data, 1, model) is refused
