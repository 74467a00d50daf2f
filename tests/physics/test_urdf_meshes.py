"""URDFs that MuJoCo reads: meshes elsewhere, bases, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from zendsp.errors import ModelError
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.robots.mjcf import read_mjcf
from zendsp.physics.robots.robot import robot_tree
from zendsp.physics.robots.urdf import read_urdf


def test_a_urdf_whose_meshes_are_in_another_package_is_read_and_written_back(
    tmp_path: Path,
) -> None:
    from zendsp.physics.robots.mjcf_write import write_mjcf

    (tmp_path / "pole.urdf").write_text(
        '<robot name="pole"><link name="base"/><link name="pole"><inertial><origin xyz="0 0 0.3"/>'
        '<mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.001" ixy="0" ixz="0" iyz="0"/>'
        '</inertial><visual><geometry><mesh filename="package://somewhere/pole.stl"/></geometry>'
        '</visual><collision><geometry><mesh filename="package://somewhere/pole.stl"/></geometry>'
        '</collision></link><joint name="swing" type="revolute"><parent link="base"/>'
        '<child link="pole"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9"'
        ' velocity="2"/></joint></robot>'
    )
    mechanism = {"kind": "mjcf", "file": "pole.urdf"}
    payload = {"kind": "payload", "joint": 1, "mass": 0.5, "com_z": 0.6}
    model = parse_model({"mechanism": mechanism, "effect": [payload]}, str(tmp_path / "m.toml"))
    assert write_mjcf(model, tmp_path / "model.mjcf") is not None
    again = parse_model({"mechanism": mechanism | {"file": "model.mjcf"}}, str(tmp_path / "m.toml"))
    (body,), _ = robot_tree(again)
    assert (body.mass, body.com[2]) == (pytest.approx(2.5), pytest.approx(0.36))


@pytest.mark.parametrize(
    ("inertia", "said"),
    [("-0.02", "inertia"), ("nonsense", "bad format in attribute 'ixx'")],
    ids=["negative", "no number"],
)
def test_a_urdf_that_is_wrong_without_its_shapes_too_is_refused_in_the_words_of_mujoco(
    inertia: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / "pole.urdf").write_text(
        '<robot name="pole"><link name="base"/><link name="pole"><inertial><origin xyz="0 0 0.3"/>'
        f'<mass value="2"/><inertia ixx="{inertia}" iyy="0.02" izz="0.001" ixy="0" ixz="0"'
        ' iyz="0"/>'
        '</inertial></link><joint name="swing" type="revolute"><parent link="base"/>'
        '<child link="pole"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9"'
        ' velocity="2"/></joint></robot>'
    )
    mechanism = {"kind": "mjcf", "file": "pole.urdf"}
    with pytest.raises(ModelError, match="MuJoCo does not compile it: ") as refused:
        parse_model({"mechanism": mechanism}, str(tmp_path / "m.toml"))
    assert said in str(refused.value)


DUMMY = """<robot name="pole"><link name="base"><inertial><mass value="1e-6"/>
<inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="1e-6" ixz="1e-6" iyz="1e-6"/></inertial></link>
<link name="pole"><inertial><origin xyz="0 0 0.3"/><mass value="2"/>
<inertia ixx="0.02" iyy="0.02" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><mesh filename="package://somewhere/pole.stl"/></geometry></collision></link>
<joint name="swing" type="revolute"><parent link="base"/><child link="pole"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="9" velocity="2"/></joint></robot>"""


def test_an_impossible_inertia_of_a_base_that_stands_plays_no_part(tmp_path: Path) -> None:
    """As of many a base_link: 1e-6 in all six places."""
    (tmp_path / "pole.urdf").write_text(DUMMY)
    assert len(read_mjcf(str(tmp_path / "pole.urdf")).joints) == 1


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('izz="0.001"', 'izz="1"', r"'pole'.*write below <robot>: <mujoco><compiler balance"),
        ('ixx="0.02" iyy="0.02" izz="0.001"', 'ixx="0" iyy="0" izz="0"', "give that link a mass"),
        ('izz="0.001" ixy="0"', 'izz="0.001" ixy="1"', "'pole'.*no link has such an inertia"),
    ],
)  # fmt: skip
def test_a_link_that_mujoco_does_not_take_is_named_though_meshes_are_missing_too(
    tmp_path: Path, old: str, new: str, says: str
) -> None:
    assert old in DUMMY
    (tmp_path / "pole.urdf").write_text(DUMMY.replace(old, new))
    with pytest.raises(ModelError, match=says) as refused:
        read_mjcf(str(tmp_path / "pole.urdf"))
    assert "its shapes are not used: " in str(refused.value)
    assert "were fused" not in str(refused.value)


def test_a_urdf_with_xacro_left_in_it_is_to_be_expanded_first(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text('<robot name="a" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:arm/></robot>')
    with pytest.raises(ModelError, match="xacro has to make a URDF of it first"):
        read_urdf(str(file))
