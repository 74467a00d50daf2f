"""Stiffness of joints that feel one another's links."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from zendsp.diagnosis.decide.assemble import _beside_other_springs
from zendsp.diagnosis.decide.thresholds import SPRINGS_SHIFT
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
