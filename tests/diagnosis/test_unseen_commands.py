"""Commands between rows that nobody saw: how much torque and position error they make alone."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_claims import piece
from small_models import VISCOUS, model_of, signals_of

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.decide import notes, nothing_named
from zendsp.diagnosis.decide.contract import Reason, Verdict, times_off
from zendsp.diagnosis.decide.result import Diagnosis, FitTable
from zendsp.diagnosis.measure.discrepancy import Size, discrepancy, unseen_commands
from zendsp.diagnosis.measure.windows import (
    least_error,
    mostly_below,
    noise_floor,
    rms,
    window_error,
)
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


def test_a_complete_model_that_errs_more_than_its_sensor_says_how_much_and_how_fast() -> None:
    """Of a torque of 1.5 % above the observers' 10 Hz they showed 0.1 %, and the model was
    "complete" with five times the error of its encoder.
    """
    known, model = driven(0.0)
    (note,) = notes.off_sensor(known, model, Verdict.COMPLETE)
    assert "times as much as its sensor, nine tenths of it below" in note
    assert "is only that below 10 Hz" in note
    assert not notes.off_sensor(known, model, Verdict.UNEXPLAINED)
    assert not notes.off_sensor(driven(UNSEEN)[0], model, Verdict.COMPLETE)
    assert times_off(1.6e-5, 3.2e-6) == pytest.approx(5.0)
    assert times_off(6.3e-6, 3.2e-6) == 0.0 == times_off(None, None)


@pytest.mark.parametrize(
    ("floor", "begins"), [(3.2e-6, "Complete below 10 Hz"), (1e-5, "Complete: ")]
)
def test_a_headline_says_that_a_complete_model_errs_more_than_its_sensor(
    floor: float, begins: str
) -> None:
    table = FitTable(1.6e-5, 1.6e-5, 1.6e-5)
    complete: Any = SimpleNamespace(
        stopped=False, findings=(), discrepancy=(), test=table, heldout=table, nameless=(),
        verdict=Verdict.COMPLETE, rejected=(), doubted=(), loads=(), zeros=(),
        errors=(SimpleNamespace(test=table, noise_floor=floor),),
    )  # fmt: skip
    said = Diagnosis.headline.fget(complete)  # type: ignore[attr-defined]
    assert said.startswith(begins)
    assert ("errs 5 times as much as its sensor" in said) is (floor == 3.2e-6)


def test_the_frequency_of_a_position_error_is_that_of_the_torque_that_makes_it() -> None:
    data, model = driven(0.0)
    (record,) = data.records[0]
    wave = 2.0 * np.sin(2.0 * np.pi * 24.0 * STEP * np.arange(record.n))
    pushed = replace(record, command=record.command + wave, _once={}, runs={})
    assert mostly_below(replace(data, records=((pushed,),)), model, 1) == pytest.approx(24.0, abs=4)


@pytest.mark.parametrize("lacks", [True, False])
def test_what_adds_no_torque_that_lacked_is_not_called_like_what_lacks(lacks: bool) -> None:
    spring: Any = replace(piece(0.1, 5.0, 20.0, "elasticity"), lacks=lacks)
    before, beside = Size(0.1, 0.09, 0.11), Size(0.01, 0.0, 0.02)
    base = SimpleNamespace(model=SimpleNamespace(kind="rotary"))
    search: Any = SimpleNamespace(joint=1, base=base)
    lost = nothing_named._lost("elasticity", search, 500.0, [spring], before, beside)
    assert (lost.reason is Reason.NEAR) is lacks
