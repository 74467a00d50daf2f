"""A MuJoCo model taken over: the same torques as MuJoCo's, what its joints and actuators state, and
plain refusals.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from zendsp.errors import ModelError
from zendsp.physics.files.model_file import load_model, parse_model
from zendsp.physics.files.model_write import model_text
from zendsp.physics.robots.mjcf import library
from zendsp.physics.robots.robot import mjcf_of, robot_tree
from zendsp.tree import inverse_dynamics

mujoco = pytest.importorskip("mujoco")

# two links with an anchor off the body's origin, a reference position, a turned inertia, a slide, a
# bracket without a joint, and a body with two joints
ARM = """<mujoco model="arm">
  <compiler angle="radian"/>
  <option gravity="0.3 -0.2 -9.7"/>
  <default><joint damping="0.4" armature="0.05"/></default>
  <worldbody>
    <body name="upper" pos="0.1 0 0.5" quat="0.9 0.1 0.2 0.3">
      <joint name="shoulder" axis="0 1 0" pos="0.05 0.02 -0.1" ref="0.3" frictionloss="0.7"/>
      <inertial pos="0.2 0.01 0.02" quat="0.8 0.3 0.1 0.2" mass="3" diaginertia="0.02 0.03 0.04"/>
      <body name="bracket" pos="0.3 0.1 0" euler="0.2 0.1 0.4">
        <geom type="box" size="0.05 0.02 0.03" mass="0.4"/>
        <body name="fore" pos="0.1 0 0">
          <joint name="elbow" axis="0 0.6 0.8" stiffness="3" springref="0.2" ref="-0.1"/>
          <joint name="reach" type="slide" axis="1 0 0" pos="0.1 0 0" ref="0.05"/>
          <geom type="capsule" fromto="0 0 0 0.3 0 0.1" size="0.03" mass="1.2"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="ms" joint="shoulder" gear="20" ctrlrange="-3 3" forcerange="-2 2"/>
    <general name="me" joint="elbow" gainprm="4" dyntype="filterexact" dynprm="0.02"/>
    <motor name="mr" joint="reach"/>
  </actuator>
</mujoco>
"""


def model_of(folder: Path, xml: str, **mechanism: object):  # type: ignore[no-untyped-def]
    (folder / "arm.xml").write_text(xml)
    return parse_model(
        {"mechanism": {"kind": "mjcf", "file": "arm.xml", **mechanism}}, str(folder / "arm.toml")
    )


def test_the_tree_has_mujocos_torques(tmp_path: Path) -> None:
    model = model_of(tmp_path, ARM)
    bodies, gravity = robot_tree(model)
    assert [b.name for b in bodies] == ["upper", "fore", "fore"]
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    m.opt.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    m.dof_damping[:], m.dof_armature[:], m.jnt_stiffness[:] = 0, 0, 0
    data, rng = mujoco.MjData(m), np.random.default_rng(0)
    for _ in range(20):
        q, qd, qdd = rng.normal(size=(3, 3))
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
        mujoco.mj_inverse(m, data)
        ours = inverse_dynamics(bodies, gravity, q[None], qd[None], qdd[None])[0]
        assert np.abs(ours - data.qfrc_inverse).max() < 1e-9  # rounding


def test_the_model_has_what_joints_and_actuators_state(tmp_path: Path) -> None:
    model = model_of(tmp_path, ARM)
    terms = {
        (t.effect, t.joint): {k: q.value for k, q in t.parameters.items()} for t in model.terms
    }
    assert terms == {
        **{("inertia", j): {"amount": 0.05} for j in (1, 2, 3)},
        **{("viscous", j): {"coefficient": 0.4} for j in (1, 2, 3)},
        ("coulomb", 1): {"level": 0.7},
        ("stiffness", 2): {"coefficient": 3.0, "neutral": 0.2},
        ("lag", 2): {"time_constant": 0.02},
    }
    assert model.actuator.gain == (20.0, 4.0, 1.0)
    assert model.actuator.limit == (2.0, 0.0, 0.0)  # of the command: force of 2 before the gear
    assert model.joint_kinds == ("rotary", "rotary", "linear")
    assert [model.torque_unit(j) for j in (1, 2, 3)] == ["N m", "N m", "N"]
    one = replace(model, actuator=replace(model.actuator, unit="N"))  # written for all of them
    assert [one.torque_unit(j) for j in (1, 2, 3)] == ["N m", "N m", "N"]


def test_the_users_model_file_overrides_the_actuators(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    model = parse_model(
        {"mechanism": {"kind": "mjcf", "file": "arm.xml"}, "actuator": {"gain": 2.5}},
        str(tmp_path / "arm.toml"),
    )
    assert model.actuator.gain == (2.5,) and model.actuator.limit == ()
    assert "lag" not in {t.effect for t in model.terms}


def test_the_model_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    model = model_of(tmp_path, ARM)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "model.toml").write_text(model_text(model))
    back = load_model(tmp_path / "out" / "model.toml")
    assert back.terms == model.terms and back.actuator == model.actuator
    assert np.array_equal(robot_tree(back)[0][2].inertia, robot_tree(model)[0][2].inertia)


def test_gravity_compensation_carries_the_links_and_nothing_else(tmp_path: Path) -> None:
    xml = ARM.replace('name="fore"', 'name="fore" gravcomp="0.8"')
    bodies, gravity = robot_tree(model_of(tmp_path, xml))  # compared with MuJoCo while it is read
    assert [bool(b.lifted) for b in bodies] == [False, False, True]
    none = robot_tree(model_of(tmp_path, ARM))[0]
    q, still = np.array([[0.1, 0.2, 0.0]]), np.zeros((1, 3))
    less = [inverse_dynamics(b, gravity, q, still, still)[0, 2] for b in (bodies, none)]
    assert less[0] == pytest.approx(0.2 * less[1], rel=1e-9)


def test_includes_and_named_joints(tmp_path: Path) -> None:
    (tmp_path / "tool.xml").write_text(
        '<mujoco><worldbody><body name="box" pos="1 0 0"><freejoint/><geom size="0.1"/></body>'
        "</worldbody></mujoco>"
    )
    xml = ARM.replace("<worldbody>", '<include file="tool.xml"/><worldbody>')
    with pytest.raises(ModelError, match=r"body 'box' is a free joint.*joints ="):
        model_of(tmp_path, xml)
    model = model_of(tmp_path, xml, joints=["shoulder", "reach"])
    assert [mjcf_of(model).model.joint(k).name for k in mjcf_of(model).joints] == [
        "shoulder", "reach",
    ]
    assert model.joints == 2


ROPE = '<tendon><fixed name="rope" stiffness="4"><joint joint="elbow" coef="1"/></fixed></tendon>'
TIED = '<equality><connect name="tie" body1="fore" body2="world" anchor="0 0 0"/></equality>'
REFUSED = {
    "a ball joint": (
        ARM.replace('<joint name="reach" type="slide" axis="1 0 0" pos="0.1 0 0" ref="0.05"/>', "")
        .replace('<motor name="mr" joint="reach"/>', "")
        .replace(
            '<body name="fore"',
            '<body name="wrist"><joint name="b" type="ball"/><geom size="0.1"/></body>'
            '<body name="fore"',
        ),
        "joint 'b' of body 'wrist' is a ball joint",
    ),
    "a closed loop": (
        ARM.replace("<actuator>", TIED + "<actuator>"),
        "'tie' closes a loop at .*leaves the joints of a loop out",
    ),
    "a tendon": (
        ARM.replace("<actuator>", ROPE + "<actuator>"),
        r"tendon 'rope' pulls at joint.*; name a copy of the file without it as \[mechanism\] file",
    ),
    "an include that is not there": (
        ARM.replace("<worldbody>", '<include file="gone.xml"/><worldbody>'),
        "gone.xml",
    ),
    "a joint without an actuator": (
        ARM.replace('<motor name="mr" joint="reach"/>', ""),
        "joint 'reach' of body 'fore' has no actuator.*joints =",
    ),
    "two actuators": (
        ARM.replace("</actuator>", '<position joint="reach" kp="3"/></actuator>'),
        "drive joint 'reach'.*gain",
    ),
    "a muscle": (
        ARM.replace(
            '<motor name="mr" joint="reach"/>',
            '<muscle name="mr" joint="reach" lengthrange="0.1 1"/>',
        ),
        "actuator 'mr' at joint 'reach'.*cannot be taken over",
    ),
    "water": (ARM.replace("<option ", '<option density="1000" '), "MuJoCo's torque is"),
    "a polynomial spring": (
        ARM.replace('stiffness="3"', 'stiffness="3 0.5 20"'),
        "joint 'elbow'.*MuJoCo's torque is",
    ),
    "no number": (re.sub('mass="[^"]*"', 'mass="nan"', ARM, count=1), "no finite number"),
    "no XML": ("robot: arm", "does not compile"),
    "no joint": ("<mujoco><worldbody/></mujoco>", "no joint that moves"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_mjcf_features_that_a_tree_lacks_are_refused_in_one_sentence(
    tmp_path: Path, name: str
) -> None:
    xml, words = REFUSED[name]
    with pytest.raises(ModelError, match=words) as said:
        model_of(tmp_path, xml)
    assert "\n" not in str(said.value) and "arm.xml" in str(said.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"file = 'none.xml': no such file"):
        parse_model({"mechanism": {"kind": "mjcf", "file": "none.xml"}}, str(tmp_path / "arm.toml"))


def test_a_warning_of_mujoco_leaves_no_file_in_the_folder_of_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    mj = library()
    model = mj.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint type='hinge' axis='0 1 0'/><geom size='.1' pos='1 0 0'/>"
        "</body></worldbody></mujoco>"
    )
    data = mj.MjData(model)
    data.qvel[0] = np.nan
    mj.mj_step(model, data)
    assert "unstable" in caplog.text and not list(tmp_path.iterdir())


def test_a_servo_becomes_the_torque_that_it_gave(tmp_path: Path) -> None:
    xml = ARM.replace(
        '<motor name="mr" joint="reach"/>',
        '<position name="mr" joint="reach" kp="300" kv="20" forcerange="-30 9" gear="2"/>',
    ).replace('name="ms" joint="shoulder" gear="20" ctrlrange="-3 3" forcerange="-2 2"',
              'name="ms" joint="shoulder" gear="20"')  # fmt: skip
    model = model_of(tmp_path, xml)
    drive = model.robot.servos[2]
    assert model.robot.servos[:2] == (None, None) and model.actuator.gain[2] == 1.0
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data, rng = mujoco.MjData(m), np.random.default_rng(3)
    for _ in range(20):
        data.qpos[:], data.qvel[:], data.ctrl[:] = rng.normal(size=(3, 3)) * 0.1
        mujoco.mj_forward(m, data)
        got = drive.applied(*(np.full(2, x[2]) for x in (data.ctrl, data.qpos, data.qvel)), 1e-3)
        assert got == pytest.approx(data.qfrc_actuator[2], abs=1e-9)


FOUND = [
    {"kind": "coulomb", "joint": 2, "level": {"value": 0.9}},
    {"kind": "viscous", "joint": 1, "coefficient": {"value": 0.25}},
    {"kind": "inertia", "joint": 3, "amount": {"value": 0.02}},
    {"kind": "torque_gain", "joint": 1, "ratio": {"value": -0.06}},
    {"kind": "stiffness", "joint": 2, "coefficient": {"value": 1.0}, "neutral": {"value": -0.4}},
    {"kind": "lag", "joint": 1, "time_constant": {"value": 0.004}},
    {"kind": "stribeck", "joint": 2, "breakaway": {"value": 1.3}, "velocity": {"value": 0.02}},
    {"kind": "ripple", "joint": 1, "order": 3.0, "amplitude": 0.2, "phase": 0.1},
    {"kind": "payload", "joint": 3, "mass": {"value": 1.5}, "com_x": {"value": 0.2},
     "com_y": {"value": 0.05}, "com_z": {"value": 0.01}, "inertia": {"value": 0.002}},
    {"kind": "body", "joint": 1, "mass": {"value": -0.3}, "com_x": {"value": 0.03},
     "com_y": {"value": 0.0}, "com_z": {"value": 0.0}, "inertia": {"value": 0.0}},
    {"kind": "base_tilt", "joint": 1, "angle_x": {"value": 0.03}, "angle_y": {"value": -0.02}},
]  # fmt: skip


def test_findings_are_written_into_the_mjcf_and_counted_once(tmp_path: Path) -> None:
    from zendsp.physics.robots.bodies import body_terms, changed, turned_gravity
    from zendsp.physics.robots.mjcf_write import inexpressible, write_mjcf

    (tmp_path / "arm.xml").write_text(ARM)
    whole = parse_model(
        {"mechanism": {"kind": "mjcf", "file": "arm.xml"}, "effect": FOUND},
        str(tmp_path / "arm.toml"),
    )
    assert sorted(t.effect for t in inexpressible(whole)) == ["ripple", "stribeck"]
    out = tmp_path / "out"
    out.mkdir()
    rest = write_mjcf(whole, out / "model.mjcf")
    assert rest is not None and sorted(t.effect for t in rest.terms) == ["ripple", "stribeck"]
    (out / "model.toml").write_text(model_text(rest, beside=True))
    back = load_model(out / "model.toml")
    bodies, gravity = robot_tree(whole)
    wanted = changed(bodies, body_terms(whole))
    got, down = robot_tree(back)
    assert body_terms(back) == ()
    assert down == pytest.approx(turned_gravity(gravity, body_terms(whole)), abs=1e-9)
    for a, b in zip(got, wanted, strict=True):
        assert a.mass == pytest.approx(b.mass, rel=1e-5, abs=1e-9)  # six digits of MuJoCo's
        assert a.com == pytest.approx(b.com, abs=1e-5) or a.mass == 0.0
        assert a.inertia == pytest.approx(b.inertia, abs=1e-5)
    assert back.actuator.gain == pytest.approx((20.0 * 0.94, 4.0, 1.0))
    assert back.actuator.limit == whole.actuator.limit
    terms = {(t.effect, t.joint): next(iter(t.parameters.values())).value for t in back.terms}
    assert terms == pytest.approx(
        {
            **{("inertia", j): 0.05 for j in (1, 2)}, ("inertia", 3): 0.07,
            **{("viscous", j): 0.4 for j in (2, 3)}, ("viscous", 1): 0.65,
            ("coulomb", 1): 0.7, ("coulomb", 2): 0.9,
            ("stiffness", 2): 4.0, ("lag", 1): 0.004, ("lag", 2): 0.02,
            ("stribeck", 2): 1.3, ("ripple", 1): 3.0,
        }
    )  # fmt: skip
    spring = next(t for t in back.terms if t.effect == "stiffness")
    assert spring.value("neutral") == pytest.approx((3 * 0.2 - 1 * 0.4) / 4)


def test_numbers_that_mjcf_cannot_hold_stay_in_the_model_file(tmp_path: Path) -> None:
    from zendsp.physics.robots.mjcf_write import write_mjcf

    (tmp_path / "arm.xml").write_text(ARM.replace('name="fore"', 'name="fore" gravcomp="1"'))
    effects = [
        {"kind": "viscous", "joint": 1, "coefficient": {"value": 0.2, "free": False}},
        {"kind": "inertia", "joint": 1, "amount": {"value": -0.09}},  # with the rotor below 0
        {"kind": "payload", "joint": 3, "mass": {"value": 1.5}},  # nothing carries its weight
    ]
    whole = parse_model(
        {"mechanism": {"kind": "mjcf", "file": "arm.xml"}, "effect": effects},
        str(tmp_path / "arm.toml"),
    )
    rest = write_mjcf(whole, tmp_path / "model.mjcf")
    assert rest is not None
    kept = sorted((t.effect, next(iter(t.parameters.values())).value) for t in rest.terms)
    assert kept == [("inertia", -0.09), ("inertia", 0.05), ("payload", 1.5), ("viscous", 0.2)]


def test_a_mass_is_written_where_its_inertia_about_one_axis_leaves_no_body(tmp_path: Path) -> None:
    from zendsp.diagnosis.report.files import left_out
    from zendsp.physics.robots.mjcf_write import write_mjcf

    (tmp_path / "arm.xml").write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="rod"><joint name="hinge"'
        ' axis="0 1 0"/><inertial pos="0 0 -0.15" mass="0.9" diaginertia="0.012 0.012 0.001"/>'
        '</body></worldbody><actuator><motor joint="hinge"/></actuator></mujoco>'
    )
    numbers = {"mass": {"value": 0.3}, "inertia": {"value": -0.004}}  # 1e-3 - 4e-3: below 0
    whole = parse_model(
        {
            "mechanism": {"kind": "mjcf", "file": "arm.xml"},
            "effect": [{"kind": "body", "joint": 1, **numbers}],
        },
        str(tmp_path / "arm.toml"),
    )
    rest = write_mjcf(whole, tmp_path / "model.mjcf")
    assert rest is not None and 'mass="1.2' in (tmp_path / "model.mjcf").read_text()
    (stays,) = (t for t in rest.terms if t.effect == "body")
    assert (stays.value("mass"), stays.value("inertia")) == (0.0, -0.004)
    assert "except the inertia of body (joint 1)" in left_out(whole)[0]


def test_a_mesh_is_still_found_from_where_the_model_is_written(tmp_path: Path) -> None:
    from zendsp.physics.robots.mjcf_write import write_mjcf

    (tmp_path / "meshes").mkdir()
    corners = ["0 0 0", "1 0 0", "0 1 0", "0 0 1"]
    (tmp_path / "meshes" / "t.obj").write_text(
        "".join(f"v {c}\n" for c in corners) + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    xml = ARM.replace('angle="radian"', 'angle="radian" meshdir="meshes"')
    xml = xml.replace("<worldbody>", '<asset><mesh name="t" file="t.obj"/></asset><worldbody>')
    xml = xml.replace('<geom type="box" size="0.05 0.02 0.03" mass="0.4"/>',
                      '<geom type="mesh" mesh="t" mass="0.4"/>')  # fmt: skip
    model = model_of(tmp_path, xml)
    out = tmp_path / "out"
    out.mkdir()
    assert write_mjcf(model, out / "model.mjcf") is not None
    mechanism = {"kind": "mjcf", "file": "model.mjcf"}
    again = parse_model({"mechanism": mechanism}, str(out / "model.toml"))
    assert write_mjcf(again, out / "again.mjcf") is not None, "what was written is a model again"
