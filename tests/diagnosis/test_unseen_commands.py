"""Commands between rows that nobody saw: how much torque and position error they make alone."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from made_claims import piece
from small_models import VISCOUS, model_of, signals_of

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.decide import nothing_named
from zendsp.diagnosis.decide.contract import Reason
from zendsp.diagnosis.measure.discrepancy import Size, discrepancy, unseen_commands
from zendsp.diagnosis.measure.windows import least_error, noise_floor, rms, window_error
from zendsp.physics.calibration.fit import Data
from zendsp.physics.model import Model

STEP, UNSEEN = 0.01, 0.02  # s from row to row; N m RMS of the torque that nobody saw


def driven(between: float) -> tuple[Data, Model]:
    """A complete joint for 60 s whose recorded command has a white error."""
    t, speed, inertia, damping = np.arange(6000) * STEP, 6.0, 0.010, 0.004
    held = speed * (t + 0.5 * STEP)  # the middle of a row
    torque = speed * (damping * np.cos(held) - inertia * speed * np.sin(held))
    error = UNSEEN * np.random.default_rng(2).standard_normal(len(t))
    columns = {"t": t, "q": np.sin(speed * t), "u": torque + error}
    model = model_of(VISCOUS, inertia=inertia, rate=1.0 / STEP)
    signals = signals_of(columns, 1.0 / STEP)
    signals = replace(signals, resolution=np.full(1, 1e-6), between=np.array([between]))
    return prepare([signals], model, 64.0), model


def test_the_torque_of_commands_that_nobody_saw_is_what_a_complete_model_seems_to_lack() -> None:
    """And twice its energy is between two models that take it at different times."""
    known, model = driven(0.0)
    assert unseen_commands(known, model, 1) == 0.0
    told, _ = driven(UNSEEN)
    seems = math.sqrt(2.0) * discrepancy(known, model, 1).value
    assert unseen_commands(told, model, 1) == pytest.approx(seems, rel=0.1)


def test_a_perfect_model_errs_by_the_commands_that_nobody_saw() -> None:
    """Beside the floor of the sensor alone, two complete arms were 5 and 7 times off."""
    told, model = driven(UNSEEN)
    error = rms(window_error(told, model, 1))
    assert error > 100.0 * noise_floor(told, 1)
    assert least_error(told, model, 1) == pytest.approx(error, rel=0.1)


@pytest.mark.parametrize("lacks", [True, False])
def test_what_adds_no_torque_that_lacked_is_not_called_like_what_lacks(lacks: bool) -> None:
    spring: Any = replace(piece(0.1, 5.0, 20.0, "elasticity"), lacks=lacks)
    before, beside = Size(0.1, 0.09, 0.11), Size(0.01, 0.0, 0.02)
    lost = nothing_named._lost("elasticity", 1, 500.0, [spring], before, beside)
    assert (lost.reason is Reason.NEAR) is lacks
