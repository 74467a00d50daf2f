"""Any MuJoCo model as a machine: its motion against MuJoCo's own integrator, its limits, what it
refuses, what it allocates.
"""

from __future__ import annotations

import importlib.util
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plants import OFF, VELOCITY, Plant

from zendsp_isr.build import build, source_root
from zendsp_isr.parts import build_machine
from zendsp_protocol.errors import CompileFailed, Refused
from zendsp_target.runtime.process.runner import look_at
from zendsp_target.runtime.process.settings import Settings

mujoco: Any = pytest.importorskip("mujoco")
MODELS = Path(__file__).parent / "models"
URDF = """<robot name="pole"><link name="base"><visual><geometry>
<mesh filename="package://somewhere/base.stl"/></geometry></visual></link>
<link name="pole"><inertial><origin xyz="0 0 0.3"/><mass value="2"/>
<inertia ixx="0.02" iyy="0.02" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><mesh filename="package://somewhere/pole.stl"/></geometry></collision></link>
<joint name="swing" type="revolute"><parent link="base"/><child link="pole"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="20" velocity="2"/></joint></robot>"""
ARM, ACROBOT = MODELS / "bench_arm.xml", MODELS / "acrobot_and_ball.xml"


def robot(model: Path, *lines: str, ideal: bool = True, clock: str = "fast") -> Plant:
    """The machine of a model, opened as the runner opens it."""
    config = [f"model = {model}", f"clock = {clock}", *(["ideal = 1"] if ideal else []), *lines]
    return Plant(str(model), "\n".join(config) + "\n")


def edited(tmp_path: Path, model: Path, *changes: tuple[str, str]) -> Path:
    """A model with words replaced."""
    text = model.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / model.name
    path.write_text(text)
    return path


def own_motion(
    model: Path, torque: Sequence[float], seconds: float, by: str = "mjINT_RK4"
) -> Any:
    """MuJoCo's own integrator, with torques held on the actuators."""
    m = mujoco.MjModel.from_xml_path(str(model))
    m.opt.integrator = getattr(mujoco.mjtIntegrator, by)
    m.opt.timestep = 1e-4
    d = mujoco.MjData(m)
    d.ctrl[:] = torque
    for _ in range(round(seconds / m.opt.timestep)):
        mujoco.mj_step(m, d)
    return d


def test_a_driven_arm_without_friction_moves_as_mujocos_own_integrator_moves_it(
    tmp_path: Path,
) -> None:
    model = edited(
        tmp_path,
        ARM,
        ('damping="0.5" frictionloss="0.8"', ""),
        ("<position joint", "<motor joint"),
        ('kp="300"', 'ctrlrange="-30 30"'),
    )
    with robot(model) as plant:
        for _ in range(300):
            plant.torque([3.0, -6.0, 0.5])
        truth = own_motion(model, [3.0, -6.0 / 50.0, 0.5], 0.3)
        # both of second order or better at 0.1 ms: what is left is the step of the explicit
        # midpoint
        assert plant.q == pytest.approx(truth.qpos, abs=2e-5)
        assert plant.qd == pytest.approx(truth.qvel, abs=2e-4)
        assert np.abs(plant.q).min() > 0.05, "every joint has moved"


def test_what_no_drive_moves_goes_its_way_beside_the_joints() -> None:
    """The passive joint of an acrobot and a ball that falls: neither is a joint of the machine."""
    with robot(ACROBOT) as plant:
        assert plant.joints == 1
        for _ in range(250):
            plant.torque([4.0])
        truth = own_motion(ACROBOT, [4.0], 0.25)
        assert plant.q[0] == pytest.approx(truth.qpos[1], abs=2e-5)
        plant.torque([4.0])
        ball, top = plant.sensors.adc[2], plant.sensors.adc[3]
        assert ball == pytest.approx(truth.xpos[3][2], abs=2e-4) and ball < 0.3
        assert top == pytest.approx(truth.qpos[0], abs=2e-5) and abs(top) > 0.05
        for _ in range(1500):
            plant.torque([0.0])
        assert plant.sensors.adc[2] == pytest.approx(0.1, abs=0.01), "it lies on the plane"


def test_a_light_finger_with_much_damping_beside_the_drives_does_not_blow_up(
    tmp_path: Path,
) -> None:
    """Damping over inertia of 60000/s, as in dm_control's manipulator: MuJoCo takes it in steps."""
    model = tmp_path / "finger.xml"
    model.write_text(
        """<mujoco><worldbody><body><joint name="arm" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.5"/>
        <body pos="0.2 0 0"><joint name="finger" axis="0 1 0" damping="0.5"/>
        <geom size="0.01" pos="0.03 0 0" mass="0.01"/></body></body></worldbody>
        <actuator><motor joint="arm" ctrlrange="-5 5"/></actuator>
        <sensor><jointpos joint="finger"/></sensor></mujoco>"""
    )
    with robot(model) as plant:
        for _ in range(300):
            plant.torque([2.0])
        truth = own_motion(model, [2.0], 0.3, "mjINT_EULER")  # damping implicit
        # a step of 0.1 ms of first order, at 60 rad/s
        assert plant.q[0] == pytest.approx(truth.qpos[0], rel=1e-3)
        plant.torque([2.0])
        assert plant.sensors.adc[0] == pytest.approx(truth.qpos[1], rel=0.02)


def test_the_reaction_of_concealed_inertia_reaches_what_is_not_driven(tmp_path: Path) -> None:
    """More inertia at the elbow is a rotor there: the same as an armature in the model."""
    heavier = edited(tmp_path, ACROBOT, ('name="elbow" axis', 'name="elbow" armature="0.05" axis'))
    with robot(ACROBOT, "effect1 = inertia joint=1 amount=0.05") as plant:
        for _ in range(250):
            plant.torque([4.0])
        truth = own_motion(heavier, [4.0], 0.25)
        assert plant.q[0] == pytest.approx(truth.qpos[1], abs=2e-5)
        plant.torque([4.0])
        assert plant.sensors.adc[3] == pytest.approx(truth.qpos[0], abs=2e-5)


def test_dry_friction_of_the_model_holds_a_joint_against_its_weight_without_creeping(
    tmp_path: Path,
) -> None:
    model = edited(tmp_path, ARM, ('frictionloss="0.8"', 'frictionloss="40"'))
    with robot(model, "q2 = 0.6") as plant:
        for _ in range(300):
            plant.torque([0.0, 0.0, 0.0])
        rest = plant.q
        for _ in range(3000):
            plant.torque([0.0, 0.0, 0.0])
        assert plant.q == pytest.approx(rest, abs=1e-6)
        assert plant.q[1] == pytest.approx(0.6, abs=1e-4), "no give that a reversal would show"


def test_sliding_friction_is_the_models_loss_and_damping() -> None:
    with robot(ARM) as plant:
        for _ in range(3000):
            plant.sample(np.array([0.3 * plant.info.joint[0].mv_per_speed, 0.0, 0.0]), VELOCITY)
        assert plant.qd[0] == pytest.approx(0.3, abs=1e-3)
        steady = plant.truth_current(0)
        assert steady == pytest.approx(0.8 + 0.5 * 0.3, rel=0.01)


def test_names_units_and_limits_come_from_the_model() -> None:
    with robot(ARM) as plant:
        joint = [plant.info.joint[j] for j in range(3)]
        assert [plant.ffi.string(j.name).decode() for j in joint] == ["turn", "shoulder", "elbow"]
        # ctrlrange; ctrlrange x gear; forcerange
        assert [j.torque_max for j in joint] == [40.0, 80.0, 30.0]
        assert [(j.position_min, j.position_max) for j in joint] == [
            (-2.5, 2.5), (-1.8, 1.8), (-2.4, 2.4),
        ]
        assert plant.ffi.string(plant.info.name) == b"bench_arm"
        assert [plant.ffi.string(plant.info.adc_name[i]) for i in range(2)] == [
            b"elbow speed", b"elbow torque",
        ]


def test_a_joint_that_would_start_at_the_end_of_its_range_starts_inside_it(tmp_path: Path) -> None:
    """Most published arms have no keyframe, and a zero position beyond a range: they would trip."""
    model = edited(
        tmp_path, ARM, ('"-2.5 2.5"', '"0 2.5"'), ('"-1.8 1.8"', '"-1.8 -0.3"'),
    )  # fmt: skip
    with robot(model) as plant:
        assert plant.q == pytest.approx([1.25, -1.05, 0.0]), "in the middle of the range"
    with robot(model, "q1 = 0.0") as plant:
        assert plant.q[0] == 0.0, "what somebody asked for stays"


def test_a_linkage_follows_a_joint_that_starts_inside_its_range(tmp_path: Path) -> None:
    """As a gripper's, whose driven joint begins shut: its rod was flung to where it belongs."""
    model = tmp_path / "linkage.xml"
    model.write_text(
        """<mujoco><option gravity="0 0 0"/><default><joint axis="0 1 0"/><geom contype="0"
        conaffinity="0"/></default><worldbody>
        <body name="crank"><joint name="crank" range="0 85" limited="true"/>
        <geom type="capsule" fromto="0 0 0 0.04 0 0" size="0.005" mass="0.1"/></body>
        <body pos="0 0 0.02"><joint name="knuckle"/>
        <geom type="capsule" fromto="0 0 0 0.04 0 0" size="0.005" mass="0.1"/>
        <body name="rod" pos="0.04 0 0"><joint name="rod"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.02" size="0.005" mass="0.1"/></body></body>
        </worldbody><equality><connect body1="rod" body2="crank" anchor="0 0 -0.02"/></equality>
        <actuator><motor joint="crank" ctrlrange="-1 1"/></actuator>
        <sensor><jointpos joint="knuckle"/></sensor></mujoco>"""
    )
    with robot(model) as plant:
        for _ in range(20):
            plant.sample([0.0], VELOCITY)
            assert abs(plant.qd[0]) < 0.01
        assert plant.q[0] == pytest.approx(np.radians(42.5), abs=1e-3)
        assert plant.sensors.adc[0] == pytest.approx(plant.q[0], abs=1e-3), "a parallelogram"


def test_gains_from_the_inertia_that_the_machine_says_are_stable_where_an_arm_stands_straight(
    tmp_path: Path,
) -> None:
    """Axes of a straight arm in one line: alone, each of them turns next to nothing."""
    axes, length = ("0 0 1", "0 1 0") * 3 + ("0 0 1",), (0.3, 0.2, 0.2, 0.2, 0.2, 0.1, 0.05)
    links = "".join(
        f'<body pos="0 0 {before}"><joint name="j{k}" axis="{axis}" range="-2 2"/>'
        f'<geom type="capsule" fromto="0 0 0 0 0 {long}" size="0.04" mass="{10 * long}"/>'
        for k, (axis, before, long) in enumerate(zip(axes, (0.1, *length), length, strict=False))
    )
    motors = "".join(f'<motor joint="j{k}" ctrlrange="-100 100"/>' for k in range(7))
    arm = tmp_path / "straight.xml"
    arm.write_text(f"<mujoco><worldbody>{links}{'</body>' * 7}</worldbody>"
                   f"<actuator>{motors}</actuator></mujoco>")  # fmt: skip
    model = mujoco.MjModel.from_xml_path(str(arm))
    data, mass = mujoco.MjData(model), np.zeros((7, 7))
    with robot(arm) as plant:
        inertia = np.diag([plant.info.joint[j].inertia for j in range(7)])
    for pose in (0.0, 0.2, -0.2):
        data.qpos[:] = pose * np.cos(np.arange(7.0))
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        ratio = np.linalg.eigvals(np.linalg.solve(mass, inertia)).real
        # the integral of joint_pd.c is stable above 1 / (2 damping w reset), its velocity filter
        # of 80 Hz with 1.5 ms of delay below 15
        assert ratio.min() > 0.088 and ratio.max() < 15.0


def test_two_motors_of_a_joint_are_one_drive_as_strong_as_both(tmp_path: Path) -> None:
    second = '<actuator><motor joint="turn" gear="5" ctrlrange="-4 4"/>'
    with robot(edited(tmp_path, ARM, ("<actuator>", second))) as plant:
        assert plant.info.joint[0].torque_max == 40.0 + 5 * 4
    unlimited = '<actuator><motor joint="shoulder"/>'
    with robot(edited(tmp_path, ARM, ("<actuator>", unlimited))) as plant:
        assert plant.info.joint[1].torque_max != 80.0, "one of the two has no limit"


def test_a_slide_is_in_metres_and_joints_without_a_motor_have_an_encoder_when_named() -> None:
    with robot(MODELS / "cart.xml", "joints = slider,pole", "q2 = 0.1") as plant:
        assert [plant.ffi.string(plant.info.joint[j].unit) for j in range(2)] == [b"m", b"rad"]
        assert [plant.ffi.string(plant.info.joint[j].command) for j in range(2)] == [
            b"force", b"none",
        ]
        for _ in range(300):
            measured = plant.sample([5000.0, 5000.0])
        assert measured[0] > 0.2, "10 N push the cart"
        assert measured[1] < 0.0 or measured[1] > 0.2, "and the pole falls"


def test_the_encoder_is_noisy_unless_ideal_and_the_seed_repeats_it() -> None:
    def still(*lines: str, ideal: bool) -> list[int]:
        # not at zero, which lies between two counts
        with robot(ARM, "q1 = 0.1", *lines, ideal=ideal) as plant:
            counts = []
            for _ in range(200):
                plant.sample(np.zeros(3), VELOCITY)
                counts.append(plant.sensors.enc[0])
            return counts[100:]

    assert np.ptp(still(ideal=True)) == 0
    noisy = still(ideal=False)
    assert 1 <= np.ptp(noisy) <= 6
    assert noisy == still("seed = 1", ideal=False) and noisy != still("seed = 2", ideal=False)


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
def test_what_cannot_be_a_machine_is_refused_in_a_sentence(
    tmp_path: Path, change: tuple[str, str], lines: tuple[str, ...], says: str
) -> None:
    model = edited(tmp_path, ARM, change)
    with pytest.raises(ValueError, match=says):
        robot(model, *lines)


def test_more_joints_than_a_machine_has_are_counted_and_a_choice_is_asked_for(
    tmp_path: Path,
) -> None:
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


def test_bodies_that_begin_in_one_another_are_named(tmp_path: Path) -> None:
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


def test_an_impossible_inertia_of_a_base_that_stands_plays_no_part(tmp_path: Path) -> None:
    """As of many a base_link: 1e-6 in all six places."""
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


def test_a_model_that_is_too_slow_for_the_real_clock_says_how_slow(tmp_path: Path) -> None:
    # time constants of microseconds
    stiff = edited(tmp_path, ARM, ('damping="0.5"', 'damping="20000"'))
    with pytest.raises(ValueError, match=r"simulating 1 ms takes .* ms here, in steps of .* us"):
        robot(stiff, clock="real")
    with robot(stiff):
        pass  # the fast clock waits for nobody


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


def test_joints_of_a_urdf_that_are_not_chosen_stand_as_the_diagnosis_takes_them_to(
    tmp_path: Path,
) -> None:
    """Each has a motor: without it the rest of a robot would hang limp from the arm."""
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


def test_xacro_in_a_comment_alone_is_none(tmp_path: Path) -> None:
    file = tmp_path / "pole.urdf"
    file.write_text(URDF + '<!-- made by xacro of <xacro:pole mass="${mass}"/> -->')
    assert build_machine(str(file)).suffix == ".so"


def test_a_model_that_takes_too_long_to_open_says_what_helps(tmp_path: Path) -> None:
    settings = Settings(str(ARM), {"model": str(ARM)}, load_s=1e-3)
    with pytest.raises(Refused, match=r"did not open within 0\.001 s, .* smaller meshes or none$"):
        look_at(settings, tmp_path)


HARNESS = rb"""
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include "machine.h"
extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t), __libc_free(void *);
extern void *__libc_memalign(size_t, size_t);
static int armed; static long calls;
void *malloc(size_t n) { calls += armed; return __libc_malloc(n); }
void *calloc(size_t n, size_t m) { calls += armed; return __libc_calloc(n, m); }
void *realloc(void *p, size_t n) { calls += armed; return __libc_realloc(p, n); }
void *aligned_alloc(size_t a, size_t n) { calls += armed; return __libc_memalign(a, n); }
int posix_memalign(void **p, size_t a, size_t n) { calls += armed; *p = __libc_memalign(a, n); return *p ? 0 : 12; }
void free(void *p) { calls += armed; __libc_free(p); }
int main(int count, char **word) {
    void *library = dlopen(word[1], RTLD_NOW), *handle;
    const machine_ops *m = library ? dlsym(library, "zendsp_machine") : NULL;
    static machine_info info; static machine_sensors s; static machine_actuators a;
    char error[512];
    armed = 1;
    if (!m || m->open(&handle, word[2], 1e-3, &info, error, sizeof error)) { printf("%s\n", m ? error : dlerror()); return 1; }
    const long works = calls; calls = 0; /* opening allocates, in MuJoCo's library too */
    for (int k = 0; k < 3000; k++) {
        a.mode = k < 2000 ? MACHINE_TORQUE : k < 2500 ? MACHINE_VELOCITY : MACHINE_OFF;
        for (int j = 0; j < info.joints; j++) a.aout[j] = 3000.0 * ((k / 150) % 3 - 1);
        m->write(handle, &a); m->read(handle, &s); m->step(handle, 1e-3);
    }
    armed = 0;
    printf("%ld %ld\n", works, calls);
    return count == 0;
}
"""  # noqa: E501


@pytest.mark.parametrize("model", [ARM, ACROBOT], ids=["arm", "ball"])
def test_the_loop_of_a_mujoco_machine_allocates_nothing(model: Path) -> None:
    """With contacts (arm and ball meet the plane), stops, all drive modes and sensors; the counter
    is seen to count.
    """
    built = build(
        "test", {"count.c": HARNESS}, [source_root() / "include"], shared=False, libraries=("-ldl",)
    )
    assert built.path is not None, built.messages
    config = f"model = {model}\nclock = fast\neffect1 = delay joint=1 time=0.003\n"
    done = subprocess.run(
        [built.path, build_machine(str(model)), config], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
    works, calls = map(int, done.stdout.split())
    assert works > 100
    assert calls == 0


def test_power_off_lets_the_arm_sink_and_the_models_stops_hold_it() -> None:
    with robot(ARM, "q2 = 0.8") as plant:
        for _ in range(6000):
            plant.sample(np.zeros(3), OFF)
        assert 1.75 < plant.q[1] < 1.85
        assert np.abs(plant.qd).max() < 1e-3
