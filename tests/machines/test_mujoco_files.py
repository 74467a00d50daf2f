"""Which models MuJoCo's machine takes, URDFs among them, and what it says of those it refuses."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest
from plants import MODELS, edited, robot

import zendsp
from zendsp_isr.parts import build_machine
from zendsp_protocol.errors import CompileFailed, Refused
from zendsp_target.runtime.process.runner import look_at
from zendsp_target.runtime.process.settings import Settings

pytest.importorskip("mujoco")
ARM = MODELS / "bench_arm.xml"
URDF = """<robot name="pole"><link name="base"><visual><geometry>
<mesh filename="package://somewhere/base.stl"/></geometry></visual></link>
<link name="pole"><inertial><origin xyz="0 0 0.3"/><mass value="2"/>
<inertia ixx="0.02" iyy="0.02" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><mesh filename="package://somewhere/pole.stl"/></geometry></collision></link>
<joint name="swing" type="revolute"><parent link="base"/><child link="pole"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="20" velocity="2"/></joint></robot>"""


@pytest.mark.parametrize(
    ("change", "lines", "says"),
    [
        (("<worldbody>", "<worldbdy>"), (), "XML"),
        (
            ('type="capsule" fromto="0 0 0 0.3 0 0"', 'type="capsle" fromto="0 0 0 0.3 0 0"'),
            (),
            "capsle",
        ),
        (
            ("bench_arm", "bench_arm"),
            ("joints = turn,elbw",),
            "no joint 'elbw'; there are turn,shoulder,elbow",
        ),
        (("bench_arm", "bench_arm"), ("keyframe = upright",), "no keyframe 'upright'"),
        (
            (
                '<joint name="turn" axis="0 0 1" range="-2.5 2.5"/>',
                '<joint name="turn" type="ball"/>',
            ),
            (),
            "ball joint",
        ),
        (('gear="50"', 'gear="nan"'), (), "a number of actuator_gear is nan"),
        (
            ("<actuator>", '<actuator><motor joint="turn" ctrlrange="-40 nan"/>'),
            (),
            "a number of actuator_ctrlrange is nan",
        ),
        (
            ("bench_arm", "bench_arm"),
            ("effect1 = coulomb joint=4 level=1.0",),
            "joint out of range, the machine has 3",
        ),
    ],
)
def test_a_model_that_cannot_be_a_machine_is_refused_in_a_sentence(
    tmp_path: Path, change: tuple[str, str], lines: tuple[str, ...], says: str
) -> None:
    model = edited(tmp_path, ARM, change)
    with pytest.raises(ValueError, match=says):
        robot(model, *lines)


def test_too_many_joints_are_counted_and_a_choice_is_asked_for(tmp_path: Path) -> None:
    chain, close = "", ""
    for k in range(9):
        chain += (
            f'<body pos="0 0 0.1"><joint name="j{k}" axis="0 1 0"/><geom size="0.02" mass="0.1"/>'
        )
        close += "</body>"
    snake = tmp_path / "snake.xml"
    snake.write_text(f"<mujoco><worldbody>{chain}{close}</worldbody></mujoco>")
    with pytest.raises(
        ValueError,
        match=r"9 joints with a drive, a machine has 8 at most: choose, such as --machine-option "
        r"joints=j0,j1,j2,j3,j4,j5,j6,j7$",
    ):
        robot(snake)
    with robot(snake, "joints = j0,j8") as plant:
        assert plant.joints == 2


def test_actuators_that_move_no_joint_are_named_with_what_would(tmp_path: Path) -> None:
    model = tmp_path / "pulled.xml"
    model.write_text(
        """<mujoco><worldbody><body><joint name="slider" type="slide"/><geom size="0.1"/></body>
        </worldbody><tendon><fixed name="rope"><joint joint="slider" coef="1"/></fixed></tendon>
        <actuator><motor name="winch" tendon="rope"/></actuator></mujoco>"""
    )
    with pytest.raises(
        ValueError, match=r'its actuators act on tendons.*give it <motor joint="slider"/>'
    ):
        robot(model)


def test_a_part_that_other_files_include_is_told_from_a_model(tmp_path: Path) -> None:
    part = tmp_path / "part.xml"
    part.write_text("<mujocoinclude><body/></mujocoinclude>")
    with pytest.raises(ValueError, match="a part that another file includes: give that file"):
        robot(part)


def test_a_urdf_whose_meshes_are_in_another_package_runs_without_its_shapes(tmp_path: Path) -> None:
    file = tmp_path / "pole.urdf"
    file.write_text(URDF)
    with robot(file) as plant:
        said = plant.ffi.string(plant.info.text).decode()
        assert "without shapes: files of meshes are missing" in said
        assert plant.info.joint[0].inertia == pytest.approx(0.02 + 2 * 0.3**2)
    file.with_suffix(".xml").write_text('<mujoco><asset><mesh file="no.stl"/></asset></mujoco>')
    with pytest.raises(ValueError, match=r"no\.stl"):
        robot(file.with_suffix(".xml"))


SHAPE = '<geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>'


def with_shapes(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    """The pole with a box about its joint and one about its base."""
    file = tmp_path / "pole.urdf"
    box = "<collision>" + SHAPE
    text = re.sub(r"<visual>.*?</link>", box, URDF, count=1, flags=re.DOTALL)
    text = re.sub(r"<collision><geometry><mesh.*?</link>", box, text, flags=re.DOTALL)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file.write_text(text)
    return file


def test_the_first_link_of_a_urdf_passes_through_its_base_as_each_link_does_through_the_next(
    tmp_path: Path,
) -> None:
    """Their shapes meet in the joint: MuJoCo collides what touches a base that stands."""
    with robot(with_shapes(tmp_path), "q1 = 0.1") as plant:
        for _ in range(200):
            plant.torque([-2.0 * 9.81 * 0.3 * np.sin(0.1) + 1.0])
        push, fall = 1.0 / 0.2, 2.0 * 9.81 * 0.3 / 0.2  # rad/s^2; a rad
        moved = push / fall * (np.cosh(np.sqrt(fall) * 0.2) - 1.0)
        assert plant.q[0] - 0.1 == pytest.approx(moved, rel=0.02)


def test_bodies_that_overlap_at_the_start_are_named(tmp_path: Path) -> None:
    second = """<link name="tip"><inertial><mass value="1"/><inertia ixx="0.02" iyy="0.02"
    izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial><collision><origin xyz="0 0 -0.35"/>""" + SHAPE
    joint = """<joint name="bend" type="revolute"><parent link="pole"/><child link="tip"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9"
    velocity="2"/></joint></robot>"""
    with robot(with_shapes(tmp_path, ("</robot>", second + joint))) as plant:
        said = plant.ffi.string(plant.info.text).decode()
        assert "tip begins 150 mm inside world" in said
    with robot(ARM) as plant:
        assert "begins" not in plant.ffi.string(plant.info.text).decode()


@pytest.mark.parametrize(("angle", "said"), [
    ("degree", ", bend may turn from -2 to 2 degrees)"), ("radian", "(simulated):"),
])  # fmt: skip
def test_a_range_that_looks_like_radians_in_a_file_of_degrees_is_told(
    tmp_path: Path, angle: str, said: str
) -> None:
    """Its joint tripped at 0.035 rad, and nothing said why."""
    file = tmp_path / "arm.xml"
    file.write_text(
        f'<mujoco><compiler angle="{angle}"/><worldbody><body><joint name="bend" range="-2 2"/>'
        '<geom size="0.1"/></body></worldbody><actuator><motor joint="bend"/></actuator></mujoco>'
    )
    with robot(file) as plant:
        assert said in plant.ffi.string(plant.info.text).decode()


def test_an_impossible_inertia_of_a_base_that_stands_plays_no_part(tmp_path: Path) -> None:
    """For example a base_link with 1e-6 in all six places, as many files have it."""
    dummy = """<link name="base"><inertial><mass value="1e-6"/><inertia ixx="1e-6" iyy="1e-6"
    izz="1e-6" ixy="1e-6" ixz="1e-6" iyz="1e-6"/></inertial>"""
    with robot(with_shapes(tmp_path, ('<link name="base">', dummy))) as plant:
        assert plant.info.joint[0].inertia == pytest.approx(0.02 + 2 * 0.3**2)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            'izz="0.001"', 'izz="1"',
            r"'pole'.*correct the inertia of that link, or write below <robot>: "
            r'<mujoco><compiler balanceinertia="true"/></mujoco>',
        ),
        (
            'ixx="0.02" iyy="0.02" izz="0.001"', 'ixx="0" iyy="0" izz="0"',
            r"'pole'.*give that link a mass and an inertia, or write below <robot>: .*boundinertia",
        ),
        ('ixz="0"', 'ixz="0.01"', r"'pole'.*no link has such an inertia, correct it"),
    ],
)  # fmt: skip
def test_a_link_that_mujoco_does_not_take_is_named_with_what_to_do_though_meshes_are_missing_too(
    tmp_path: Path, old: str, new: str, says: str
) -> None:
    file = tmp_path / "pole.urdf"
    assert old in URDF
    file.write_text(URDF.replace(old, new))
    with pytest.raises(Refused, match=says) as refused:
        look_at(Settings(str(file), {"model": str(file)}), tmp_path)
    assert "were fused" not in str(refused.value)
    if "compiler" in says or "bound" in says:  # what it says is done: then it runs
        line = re.search(r"<mujoco>.*</mujoco>", str(refused.value))
        assert line
        head = '<robot name="pole">'
        file.write_text(file.read_text().replace(head, head + line[0]))
        with robot(file):
            pass


def test_without_mujoco_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name, *more: None if name == "mujoco" else find(name, *more),
    )
    with pytest.raises(CompileFailed, match=r"pip install 'zendsp\[mujoco\]'"):
        build_machine(str(ARM))


HAND = """<link name="{0}"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01"
ixy="0" ixz="0" iyz="0"/><origin xyz="0.2 0 0"/></inertial></link><joint name="{0}" type="revolute">
<parent link="pole"/><child link="{0}"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>{1}
<limit lower="-1" upper="1" effort="9" velocity="2"/></joint></robot>"""


def test_joints_of_a_urdf_that_are_not_chosen_are_held_as_the_diagnosis_assumes(
    tmp_path: Path
) -> None:
    """Each of them is held by a motor; otherwise the rest of the robot would hang from the arm."""
    file = tmp_path / "pole.urdf"
    file.write_text(URDF.replace("</robot>", HAND.format("bend", "")))
    with robot(file, "joints = swing") as plant:
        said = plant.ffi.string(plant.info.text).decode()
        assert "1 of its 2 joints, 1 with a drive (simulated, the others stand at 0" in said
        # both bodies turn as one: about the joint, and half a metre out
        whole = 0.02 + 2 * 0.3**2 + 0.01 + 1 * (0.3**2 + 0.2**2)
        assert plant.info.joint[0].inertia == pytest.approx(whole)
        for _ in range(20):
            plant.torque([0.0])
        assert plant.qd[0] == pytest.approx(9.81 * 0.2 / whole * 0.02, rel=0.02)
    with pytest.raises(ValueError, match="no joint 'swng'; there are swing,bend"):
        robot(file, "joints = swng")


def test_a_joint_that_mimics_a_chosen_one_follows_it(tmp_path: Path) -> None:
    file = tmp_path / "pole.urdf"
    follower = HAND.format("bend", '<mimic joint="swing" multiplier="-1"/>')
    file.write_text(URDF.replace("</robot>", follower))
    with robot(file, "joints = swing") as plant:
        assert "1 of its 2 joints, 1 with a drive (simulated" in (
            said := plant.ffi.string(plant.info.text).decode()
        )
        assert "stand" not in said


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("pole.urdf.xacro", "", ""),
        ("pole.urdf", "</robot>", '<xacro:arm name="left"/></robot>'),
        ("pole.urdf", 'xyz="0 0 0.3"', 'xyz="$(optenv POLE_XYZ 0 0 0.3)"'),
        ("pole.urdf", 'value="2"', 'value="${mass}"'),
    ],
)
def test_a_description_with_xacro_left_in_it_is_to_be_expanded_first(
    tmp_path: Path, name: str, old: str, new: str
) -> None:
    file = tmp_path / name
    assert old in URDF
    file.write_text(URDF.replace(old, new))
    says = r"xacro has to make a URDF of it first: .* > pole.*\.urdf'"
    with pytest.raises(CompileFailed, match=says):
        build_machine(str(file))


def test_xacro_in_a_comment_is_ignored(tmp_path: Path) -> None:
    file = tmp_path / "pole.urdf"
    file.write_text(URDF + '<!-- made by xacro of <xacro:pole mass="${mass}"/> -->')
    assert build_machine(str(file)).suffix == ".so"


def test_a_urdf_limits_the_speed_of_its_joints_unless_others_are_given(tmp_path: Path) -> None:
    def speed(limit: str, *options: str) -> float:
        file = tmp_path / "pole.urdf"
        file.write_text(URDF.replace('velocity="2"', limit))
        with zendsp.local(str(file), clock="fast", options=options) as target:
            target.download("joint_pd.c")
            return target.machine().joints[0].speed_max

    assert speed('velocity="2"') == 2.0
    assert speed('velocity="20"') == 20.0
    assert speed('velocity="2"', "--machine-option", "speed_max=3") == 3.0
    for says_nothing in ("", 'velocity="0"', 'velocity="-1"', 'velocity="inf"', 'velocity="two"'):
        assert speed(says_nothing) == pytest.approx(2 * np.pi)
