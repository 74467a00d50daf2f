"""Columns of an arm in another order, sign, zero or without gravity are refused by that name."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import small_arms
from acceptance import accepted
from plane_arms import plane_model, two_links
from small_arms import Arm

from zendsp.diagnosis.data import order
from zendsp.diagnosis.data.checks import check_motion
from zendsp.diagnosis.data.order import check_order
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.errors import RecordingError
from zendsp.physics.calibration.joint import JointRecord

Columns = dict[str, np.ndarray]


@pytest.fixture(scope="session")
def run() -> Columns:
    return small_arms.simulate(Arm(), 1)


def exchanged(c: Columns, *names: str) -> Columns:
    return {k: x[:, [0, 2, 1]] if k in names else x for k, x in c.items()}


def reversed_(c: Columns) -> Columns:
    sign = np.array([1.0, -1.0, 1.0])
    return {**c, "q": sign * c["q"], "u": sign * c["u"]}


def reversed_sign(c: Columns, name: str) -> Columns:
    return {**c, name: np.array([1.0, -1.0, 1.0]) * c[name]}


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


def from_the_base(c: Columns) -> Columns:
    return {**c, "q": c["q"] + np.stack([0.0 * c["t"], 0.0 * c["t"], c["q"][:, 1]], axis=1)}


def through_a_parallelogram(c: Columns) -> Columns:
    none = 0.0 * c["t"]
    return {**from_the_base(c), "u": c["u"] - np.stack([none, c["u"][:, 2], none], axis=1)}


MISTAKES: dict[str, tuple[Callable[[Columns], Columns], str]] = {
    "by the alphabet": (
        lambda c: exchanged(c, "q", "u"), "the columns of joints 2 and 3 are exchanged",
    ),
    "positions": (lambda c: exchanged(c, "q"), "the positions of joints 2 and 3 are exchanged"),
    "commands": (lambda c: exchanged(c, "u"), "the commands of joints 2 and 3 are exchanged"),
    "another direction": (reversed_, "joint 2 counts the other way"),
    "the sign of a position": (
        lambda c: reversed_sign(c, "q"), "the position of joint 2 has the other sign",
    ),
    "the sign of a command": (
        lambda c: reversed_sign(c, "u"), "the command of joint 2 has the other sign",
    ),
    "another zero": (turned, r"joint 2 lies elsewhere (\[sensor\] offset = -1.571)"),
    "gravity compensated": (without_gravity, "the command is without gravity"),
    "angles of links": (from_the_base, "joint 3 counts from the base, not from joint 2 ([sensor]"),
    "a parallelogram": (
        through_a_parallelogram,
        "driven through a parallelogram ([sensor] matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0],"
        " [0.0, -1.0, 1.0]], [actuator] matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 1.0],",
    ),
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


def test_all_mistakes_take_one_call_of_the_dynamics(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One after the other, the 81 of six joints had taken 0.5 s of CPU a recording."""
    model, paths = small_arms.recorded(tmp_path, "arm", Arm(mass=3.0))
    data, rows, rigid = prepare([read_signals(paths[0], model)], model, 64.0), [], order.rigid_body
    monkeypatch.setattr(
        order, "rigid_body", lambda slow, m: rows.append(slow.q.shape[1]) or rigid(slow, m)
    )
    check_order("run", data.records[0], model)
    assert len(rows) == 2
    assert rows[1] > 20 * rows[0]


@pytest.mark.parametrize(("name", "words"), [("q", "position"), ("u", "command")])
def test_one_column_of_a_plane_arm_that_has_the_other_sign_is_named(
    name: str, words: str, tmp_path: Path
) -> None:
    """It was "unexplained: check units, gain and limit"."""
    path, model = tmp_path / "run.npz", plane_model()
    np.savez(path, **{**two_links(), name: two_links()[name] * np.array([1.0, -1.0])})
    data = prepare([read_signals(path, model)], model, 64.0)
    with pytest.raises(RecordingError, match=f"the {words} of joint 2 has the other sign"):
        check_order("run", data.records[0], model)


LINK_ANGLES = "joint 2 counts from the base, not from joint 1"
MIRRORED = (
    "joint 1 counts the other way than in the model (position and command), or joint 2 counts the"
    " other way"
)


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        ([[1, 0], [0, 1]], ""), ([[1, 0], [1, 1]], LINK_ANGLES), ([[0, 1], [1, 0]], "exchanged"),
        ([[1, 0], [0, -1]], MIRRORED),
    ],
)  # fmt: skip
def test_the_columns_of_a_plane_arm_are_checked_too(
    matrix: list[list[int]], words: str, tmp_path: Path
) -> None:
    c, change = two_links(), np.array(matrix)
    moved = change if words != LINK_ANGLES else np.eye(2)
    path = tmp_path / "run.npz"
    np.savez(path, t=c["t"], q=c["q"] @ change.T, u=c["u"] @ moved.T)
    model = plane_model()
    data = prepare([read_signals(path, model)], model, 64.0)
    if not words:
        check_order("run", data.records[0], model)
        return
    with pytest.raises(RecordingError, match=re.escape(words)):
        check_order("run", data.records[0], model)


def test_no_order_is_accused_by_a_part_where_a_longer_part_shows_it_right(tmp_path: Path) -> None:
    """The last third of a second of a circle of the shipped arm was taken for one with its joints
    exchanged, and the recording refused.
    """
    model, c = plane_model(), two_links()

    def part(name: str, rows: slice, exchanged: bool) -> list[JointRecord]:
        q, u = (c[key][rows, ::-1] if exchanged else c[key][rows] for key in "qu")
        np.savez(tmp_path / name, t=c["t"][rows], q=q, u=u)
        read = read_signals(tmp_path / f"{name}.npz", model)
        return list(prepare([read], model, 64.0).records[0])

    short, right = part("short", slice(2500, 4000), True), part("long", slice(0, 2500), False)
    check_order("run", short, model, [right])
    for beside in ([], [part("wrong", slice(0, 2500), True)]):
        with pytest.raises(RecordingError, match="exchanged"):
            check_order("run", short, model, beside)
    with pytest.raises(RecordingError, match="exchanged"):
        check_order("run", part("most", slice(0, 3500), True), model, [right])
