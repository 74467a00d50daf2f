"""A model file begun from a recording of zendsp, whose machine is known."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from drafts import COUNTS, STEP, model_of, recording

from zendsp.physics.files.draft import draft_model
from zendsp.physics.files.draft_data import machine_of
from zendsp.physics.files.model_file import parse_model
from zendsp.recording import Recording, read_table
from zendsp_protocol.messages import JointInfo, MachineInfo


def own_recording(
    folder: Path, machine: MachineInfo, decimation: int = 2, command: str = "N m"
) -> Path:
    """What zendsp recorded of a machine, every second sample."""
    columns = recording()
    units = {"q": "rad", "tau": command, "r": "rad"}
    told = msgspec.json.decode(msgspec.json.encode(machine))
    made = Recording.from_columns(
        {name: values for name, values in columns.items() if name != "t"},
        sample_time=STEP, units=units, extra={"machine": told},
    )  # fmt: skip
    return replace(made, decimation=decimation).save(folder / "run.mat")


def test_a_draft_for_a_shipped_machine_asks_nothing_that_the_recording_says(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    arm = tmp_path / "models" / "arm.xml"
    arm.parent.mkdir()
    arm.write_text(
        '<mujoco><worldbody><body><joint name="shoulder" axis="0 1 0"/>'
        '<geom size="0.1" pos="0.2 0 0"/></body></worldbody>'
        '<actuator><motor joint="shoulder"/></actuator></mujoco>'
    )
    joint = JointInfo("shoulder", counts_per_unit=COUNTS / (2 * np.pi), torque_max=7.5)
    info = MachineInfo("arm_1", joints=(joint,), model=str(arm), options=("current_loop=0.0002",))
    path = own_recording(tmp_path, info)
    draft = draft_model(read_table(path), machine=machine_of(path, tmp_path))
    assert draft.questions == ()
    assert 'file = "models/arm.xml"' in draft.text
    model = parse_model(tomllib.loads(draft.text), str(tmp_path / "arm_1.toml"))
    assert (model.name, model.kind, model.robot.joints) == ("arm_1", "mjcf", ("shoulder",))
    assert model.sample_time == STEP and model.actuator.hold == pytest.approx(STEP / 2)
    assert model.actuator.delay == pytest.approx(STEP / 2 + 0.0002), "a sample of the loop, no row"
    assert model.actuator.limit == (7.5,)
    assert model.sensor.resolution[0] == pytest.approx(2 * np.pi / COUNTS, rel=1e-6)


def test_a_draft_for_a_machine_without_a_model_asks_the_rest(tmp_path: Path) -> None:
    info = MachineInfo("bench", joints=(JointInfo("axis", counts_per_unit=1000.0),))
    path = own_recording(tmp_path, info)
    draft = draft_model(read_table(path), machine=machine_of(path, tmp_path))
    model = model_of(draft.text)
    assert (model.name, model.kind) == ("bench", "rotary")
    assert model.actuator.delay == pytest.approx(STEP / 2)
    assert model.sensor.resolution == (0.001,)
    assert len(draft.questions) == 3, "gravity's zero, the drive's limit, and the encoder's side"
    shipped = own_recording(tmp_path, msgspec.structs.replace(info, name="single_pendulum"))
    asked = draft_model(read_table(shipped), machine=machine_of(shipped, tmp_path)).questions
    assert any("--model single_pendulum.toml" in question for question in asked)
    pole = JointInfo("pole", counts_per_unit=1000.0)
    cart = own_recording(tmp_path, msgspec.structs.replace(info, joints=(*info.joints, pole)))
    asked = draft_model(read_table(cart), machine=machine_of(cart, tmp_path)).questions
    assert any("2 joints (axis, pole), and only q looks like" in question for question in asked)


def test_joints_that_slide_are_of_the_machine_not_of_the_program(tmp_path: Path) -> None:
    rail = JointInfo("rail", counts_per_unit=1000.0, unit="m")
    path = own_recording(tmp_path, MachineInfo("gantry", joints=(rail,)))  # joint_pd.c says rad
    draft = draft_model(read_table(path), machine=machine_of(path, tmp_path))
    model = model_of(draft.text)
    assert (model.kind, tuple(model.mechanism)) == ("linear", ("mass",))
    assert model.actuator.unit == "N" and "rad" not in draft.text.partition("[actuator]")[2]
    columns = recording()
    wrist = JointInfo("wrist", counts_per_unit=1000.0)
    told = msgspec.json.decode(msgspec.json.encode(MachineInfo("scara", joints=(rail, wrist))))
    both = {name: np.stack([columns[name]] * 2, axis=1) for name in ("q", "tau")}
    units = {"q": "rad", "tau": "N m"}
    made = Recording.from_columns(both, sample_time=STEP, units=units, extra={"machine": told})
    path = made.save(tmp_path / "both.mat")
    draft = draft_model(read_table(path), machine=machine_of(path, tmp_path))
    assert any("rail slides, wrist turns" in question for question in draft.questions)
    assert 'command = "tau"                        # N, N m' in draft.text
    assert "# m, rad per count" in draft.text and "N, N m per unit of command" in draft.text
    assert "unit = " not in draft.text.partition("[actuator]")[2], "one stands for both"
    made = replace(made, channels=tuple(
        replace(c, unit={"q": "m, rad", "tau": "N, N m"}[c.name]) for c in made.channels
    ))  # fmt: skip
    for name in ("both.csv", "both.mat"):
        read = read_table(made.save(tmp_path / name))
        assert (read.units["q"], read.units["tau"]) == ("m, rad", "N, N m")
        asked = draft_model(read).questions
        assert any("Joints that slide beside joints that turn" in question for question in asked)


def test_the_drives_limit_is_known_where_the_program_left_out_the_unit(tmp_path: Path) -> None:
    joint = JointInfo("axis", counts_per_unit=1000.0, torque_max=7.5)
    path = own_recording(tmp_path, MachineInfo("bench", joints=(joint,)), command="")
    draft = draft_model(read_table(path), machine=machine_of(path, tmp_path))
    assert model_of(draft.text).actuator.limit == (7.5,)
    assert any("is tau in N m (N)?" in question for question in draft.questions)
    assert not any("cut off" in question for question in draft.questions)


def test_a_foreign_file_names_no_machine(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t [s],q [rad]\n0,1\n0.1,2\n")
    assert machine_of(path, tmp_path) is None
