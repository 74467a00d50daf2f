"""A model file begun from a recording and the robot's URDF: which joints the columns are."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from drafts import N, T

from zendsp.cli.model import command
from zendsp.errors import ModelError
from zendsp.physics.files.draft import draft_model
from zendsp.physics.files.model_file import load_model
from zendsp.recording import Table

CHAIN = (  # name, type, parent, child
    ("shoulder", "continuous", "base", "a"),
    ("elbow", "revolute", "a", "b"),
    ("wrist", "revolute", "b", "c"),
    ("finger", "prismatic", "c", "left"),
    ("other_finger", "prismatic", "c", "right"),
)


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """An arm of three joints with a gripper, one finger of which follows the other."""
    links = "".join(f'<link name="{name}"/>' for name in ("base", "a", "b", "c", "left", "right"))
    follows = '<mimic joint="finger"/>'
    joints = "".join(
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="0 1 0"/>{follows if name == "other_finger" else ""}'
        "</joint>"
        for name, kind, parent, child in CHAIN
    )
    file = tmp_path / "arm.urdf"
    file.write_text(f'<robot name="arm">{links}{joints}</robot>')
    return file


def table(*joints: str) -> Table:
    columns = {"t": T}
    for k, joint in enumerate(joints, 1):
        columns[f"joint_states.{joint}.position"] = np.sin(k * T)
        columns[f"joint_states.{joint}.effort"] = np.cos(k * T) + np.zeros(N)
    return Table(columns, {"t": "s"}, {}, Path("run.csv"))


def test_the_file_says_all_that_was_typed_to_begin_it(
    robot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(robot.parent)
    rows = np.stack([T, np.sin(T), np.cos(T)], axis=1)
    np.savetxt("run 1.csv", rows, "%.6f", ",", header="t,shoulder.position,shoulder.effort",
               comments="")  # fmt: skip
    typed = ["new", "run 1.csv", "-o", "bench.toml", "--robot", "arm.urdf", "--force"]
    done = CliRunner().invoke(command, typed)
    assert done.exit_code == 0, done.output
    first = Path("bench.toml").read_text().splitlines()[0]
    assert first.endswith(f"begun by: zendsp model {shlex.join(typed)}")


def test_joints_that_the_columns_name_are_taken_in_the_robots_order(robot: Path) -> None:
    drawn = draft_model(table("elbow", "shoulder", "wrist"), robot=robot, folder=robot.parent)
    model = tomllib.loads(drawn.text)
    assert model["mechanism"] == {
        "kind": "urdf", "file": "arm.urdf", "joints": ["shoulder", "elbow", "wrist"]
    }  # fmt: skip
    order = ["shoulder", "elbow", "wrist"]
    assert model["columns"]["position"] == [f"joint_states.{j}.position" for j in order]
    assert model["columns"]["command"] == [f"joint_states.{j}.effort" for j in order]
    assert not any("recorded?" in q or "order?" in q for q in drawn.questions)
    file = robot.parent / "arm.toml"
    file.write_text(drawn.text)
    assert load_model(file).joint_kinds == ("rotary",) * 3


def test_what_columns_without_names_of_joints_are_is_asked(robot: Path) -> None:
    columns = {"t": T, **{f"q{k}": np.sin(k * T) for k in (1, 2)}}
    drawn = draft_model(Table(columns, {}, {}, Path("run.csv")), robot=robot)
    assert any("which 2 of shoulder, elbow, wrist were" in q for q in drawn.questions)
    assert any("no unit: is it rad" in q for q in drawn.questions)
    assert tomllib.loads(drawn.text)["mechanism"]["joints"] == ["shoulder", "elbow"]
    columns["q3"] = np.sin(3 * T)
    drawn = draft_model(Table(columns, {}, {}, Path("run.csv")), robot=robot)
    assert any("q1, q2, q3 stand in this order?" in q for q in drawn.questions)


@pytest.mark.parametrize("path", ["joint_states.{}.{}", "/joint_states/{}/{}"])
def test_the_fingers_that_a_driver_publishes_too_are_not_taken(robot: Path, path: str) -> None:
    """One follows the other: a model can only hold both. PlotJuggler writes names with slashes."""
    columns = {"__time": T}
    for k, joint in enumerate(("elbow", "finger", "other_finger", "shoulder", "wrist"), 1):
        columns[path.format(joint, "position")] = np.sin(k * T)
        columns[path.format(joint, "effort")] = np.cos(k * T)
    drawn = draft_model(
        Table(columns, {}, {}, Path("run.csv")), robot=robot, folder=robot.parent
    )
    order = ["shoulder", "elbow", "wrist"]
    model = tomllib.loads(drawn.text)
    assert model["columns"]["position"] == [path.format(j, "position") for j in order]
    assert model["columns"]["command"] == [path.format(j, "effort") for j in order]
    fingers = [f"{j}.{w}" for j in ("finger", "other_finger") for w in ("position", "effort")]
    assert [".".join(re.split("[./]", name)[-2:]) for name in drawn.unused] == fingers
    file = robot.parent / "arm.toml"
    file.write_text(drawn.text)
    assert load_model(file).robot.joints == tuple(order)


def test_a_robot_of_fewer_joints_than_were_recorded_is_refused(robot: Path) -> None:
    columns = {"t": T, **{f"q{k}": np.sin(k * T) for k in range(1, 5)}}
    with pytest.raises(ModelError, match=r"has 3 joints .* the recording 4 positions"):
        draft_model(Table(columns, {}, {}, Path("run.csv")), robot=robot)


def test_the_command_line_takes_the_robot_beside_the_recording(
    robot: Path, tmp_path: Path
) -> None:
    rows = np.column_stack([T, np.sin(T), np.cos(T)])
    run = tmp_path / "run.csv"
    np.savetxt(run, rows, delimiter=",", header="t,elbow.position,elbow.effort", comments="")
    out = tmp_path / "models" / "arm.toml"
    done = CliRunner().invoke(command, ["new", str(run), "--robot", str(robot), "-o", str(out)])
    assert done.exit_code == 0, done.output
    assert load_model(out).robot.joints == ("elbow",)
    checked = CliRunner().invoke(command, ["check", str(out)])
    assert "  link that joint 1 moves: b\n" in checked.output, checked.output


def test_friction_that_a_urdf_states_is_stated_in_the_draft(robot: Path) -> None:
    """A student whose URDF had a damping was told that it was missing."""
    text = robot.read_text()
    for name, words in {"elbow": 'damping="0.05"', "wrist": 'damping="x" friction="0.2"'}.items():
        at = f'<joint name="{name}" type="revolute">'
        text = text.replace(at, f"{at}<dynamics {words}/>")
    robot.write_text(text)
    drawn = draft_model(table("elbow", "shoulder", "wrist"), robot=robot, folder=robot.parent)
    assert tomllib.loads(drawn.text)["effect"] == [
        {"kind": "viscous", "joint": 2, "coefficient": {"value": 0.05}},
        {"kind": "coulomb", "joint": 3, "level": {"value": 0.2}},
    ]
    assert "# damping of elbow in arm.urdf" in drawn.text


URDF = (
    '<robot name="cart"><link name="rail"/><link name="cart"/><link name="pole"/>'
    '<joint name="slide" type="prismatic"><parent link="rail"/><child link="cart"/>'
    '<axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="20" velocity="5"/></joint>'
    '<joint name="hinge" type="continuous"><parent link="cart"/><child link="pole"/>'
    '<axis xyz="0 1 0"/></joint></robot>'
)
MJCF = (
    '<mujoco><worldbody><body><joint name="slide" type="slide"/><geom size="0.1"/><body>'
    '<joint name="hinge"/><geom size="0.1"/></body></body></worldbody><actuator><motor'
    ' joint="slide"/></actuator></mujoco>'
)


@pytest.mark.parametrize(("name", "text", "unit"), [
    ("cart.urdf", URDF, "N"), ("cart.xml", MJCF, "N"), ("cart.xml", MJCF, "V"),
])  # fmt: skip
def test_the_joints_of_a_robot_that_nothing_drives_are_drafted_too(
    tmp_path: Path, name: str, text: str, unit: str
) -> None:
    """Of a cart and its pole the cart alone was drafted, and the angle of the pole "not used"."""
    if name.endswith(".xml"):
        pytest.importorskip("mujoco")
    (tmp_path / name).write_text(text)
    columns = {"t": T, "phi": np.sin(T), "x": np.cos(T), "u": np.sin(2.0 * T)}
    run = Table(columns, {"t": "s", "phi": "rad", "x": "m", "u": unit}, {}, Path("run.csv"))
    draft = draft_model(run, robot=tmp_path / name, folder=tmp_path)
    written = tomllib.loads(draft.text)
    assert written["mechanism"]["joints"] == ["slide", "hinge"]
    assert written["columns"]["position"] == ["x", "phi"]
    assert written["columns"]["command"] == ["u", ""]
    assert draft.joints == 2 and draft.unused == ()
    assert "does nothing drive the joint with the empty name?" in draft.questions
    assert "do x, phi stand in this order? Drivers often list joints by the alphabet" in (
        draft.questions
    )
