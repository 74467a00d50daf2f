"""Columns of an arm in another order, sign, zero or without gravity are refused by that name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import small_arms
from acceptance import accepted
from small_arms import Arm

from zendsp.diagnosis.data.checks import check_motion
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.errors import RecordingError

Columns = dict[str, np.ndarray]


@pytest.fixture(scope="session")
def run() -> Columns:
    return small_arms.simulate(Arm(), 1)


def exchanged(c: Columns, *names: str) -> Columns:
    return {k: x[:, [0, 2, 1]] if k in names else x for k, x in c.items()}


def reversed_(c: Columns) -> Columns:
    sign = np.array([1.0, -1.0, 1.0])
    return {**c, "q": sign * c["q"], "u": sign * c["u"]}


def turned(c: Columns) -> Columns:
    return {**c, "q": c["q"] + np.array([0.0, np.pi / 2, 0.0])}


def without_gravity(c: Columns) -> Columns:
    import pinocchio as pin

    given = pin.buildModelFromXML(small_arms.urdf(small_arms.LINKS))
    data = given.createData()
    weight = np.stack([pin.computeGeneralizedGravity(given, data, q) for q in c["q"]])
    return {**c, "u": c["u"] - weight}


def motor_side(c: Columns) -> Columns:
    return {**c, "u": c["u"] / 100.0}


MISTAKES: dict[str, tuple[Callable[[Columns], Columns], str]] = {
    "by the alphabet": (
        lambda c: exchanged(c, "q", "u"), "the columns of joints 2 and 3 are exchanged",
    ),
    "positions": (lambda c: exchanged(c, "q"), "the positions of joints 2 and 3 are exchanged"),
    "commands": (lambda c: exchanged(c, "u"), "the commands of joints 2 and 3 are exchanged"),
    "another direction": (reversed_, "joint 2 counts the other way"),
    "another zero": (turned, r"joint 2 lies elsewhere (\[sensor\] offset = -1.571)"),
    "gravity compensated": (without_gravity, "the command is without gravity"),
    "torque of the motors": (motor_side, "actuator's gain by about 0.0"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_columns_that_are_not_the_models_joints_are_refused_with_what_is_wrong(
    mistake: str, run: Columns, tmp_path: Path
) -> None:
    """They had been couplings, gravities, inertias and gains, at up to 94 %."""
    change, words = MISTAKES[mistake]
    model, paths = small_arms.recorded(tmp_path, "arm", Arm(), friction=True)
    np.savez(paths[0], **change(run))
    data = prepare([read_signals(paths[0], model)], model, 64.0)
    with pytest.raises(RecordingError) as refused:
        check_motion(data, model, ["arm1.npz"])
    assert words.replace("\\", "") in str(refused.value)


@pytest.mark.parametrize("arm", [Arm(), Arm(mass=3.0), Arm(tilt=0.3), Arm(heavier=4.0)])
def test_wrong_bodies_are_no_matter_of_the_columns(arm: Arm, tmp_path: Path) -> None:
    _, paths = small_arms.recorded(tmp_path, "arm", arm)
    accepted(paths[0], tmp_path / "model.toml")
