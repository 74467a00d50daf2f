"""A MuJoCo model is given, MuJoCo simulates a changed one, and the diagnosis names the change."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import zendsp
from zendsp.diagnosis import Diagnosis
from zendsp.diagnosis.report import html
from zendsp.diagnosis.report.files import write_report
from zendsp.diagnosis.report.summary import summary
from zendsp.errors import ModelError, RecordingError
from zendsp.physics.files.model_file import load_model
from zendsp.proof.untouched import errors

mujoco = pytest.importorskip("mujoco")
pytestmark = pytest.mark.timeout(600)  # seconds of work, minutes on a machine that has other work

RATE, SUB, SECONDS = 250, 20, 6.0
RESOLUTION = 2e-5  # rad, m

# two hanging links, and a tool that slides along the second one
TWO = """<mujoco model="two">
  <compiler angle="radian"/>
  <option timestep="{step}" integrator="implicitfast" iterations="100" tolerance="1e-12"/>
  <default><joint armature="0.05" damping="0.5" frictionloss="{dry}"
    solreffriction="0.0005 1" solimpfriction="0.999 0.9999 0.001"/></default>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="{viscous}"/>
      <inertial pos="0 0 -0.2" mass="3" diaginertia="0.04 0.04 0.005"/>
      <body name="fore" pos="0 0 -0.4">
        <joint name="elbow" axis="0 1 0"/>
        <inertial pos="0 0 -0.15" mass="1.5" diaginertia="0.015 0.015 0.002"/>
        {tool}{slide}
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="shoulder" gear="4" ctrlrange="-20 20"/><motor joint="elbow"/>{motor}
  </actuator>
</mujoco>
"""
TOOL = (
    '<body pos="0.12 0 -0.35"><inertial pos="0 0 0" mass="1" diaginertia="1e-9 1e-9 1e-9"/></body>'
)
SLIDE = (
    '<body name="tool" pos="0 0 -0.3"><joint name="reach" type="slide" axis="1 0 0" armature="0.3"'
    ' damping="4"/><inertial pos="0 0 0" mass="0.7" diaginertia="0.001 0.001 0.001"/></body>'
)
COLUMNS = '[columns]\ntime = "t"\nposition = "q"\ncommand = "u"\n'


def xml(**change: object) -> str:
    known = {"step": 1.0 / RATE / SUB, "dry": 0.0, "viscous": 0.5, "tool": "", "slide": "",
             "motor": ""}  # fmt: skip
    return TWO.format(**{**known, **change})


def record(text: str, path: Path, seed: int, command: str = "torque", tones: int = 5) -> Path:
    """Seconds of a machine that MuJoCo simulates, under PD control with some gravity."""
    m = mujoco.MjModel.from_xml_string(text)
    data, n, rng = mujoco.MjData(m), m.nv, np.random.default_rng(seed)
    f, phase = (rng.uniform(*ends, (n, 5))[:, :tones] for ends in ((0.15, 1.1), (0, 6.28)))
    size = np.array([0.5, 0.6, 0.1])[:n, None] * 0.5 / f**0.5
    kp, kd = np.array([120.0, 40.0, 90.0])[:n], np.array([12.0, 4.0, 12.0])[:n]
    gear = np.array(m.actuator_gear[:, 0])
    data.qpos[:] = (size * np.sin(phase)).sum(1)
    last, rows = data.qpos.copy(), []
    for k in range(int(SECONDS * RATE)):
        goal = (size * np.sin(2 * np.pi * f * k / RATE + phase)).sum(1)
        noise = rng.normal(0, RESOLUTION / 3, n)
        y = RESOLUTION * np.round((data.qpos + noise) / RESOLUTION)
        u = goal if command == "set value" else (kp * (goal - y) - kd * (y - last) * RATE) / gear
        last = y
        rows.append([k / RATE, *y, *u])
        data.ctrl[:] = u
        mujoco.mj_step(m, data, SUB)
    table = np.array(rows)
    np.savez(path, t=table[:, 0], q=table[:, 1 : n + 1], u=table[:, n + 1 :])
    return path


@pytest.fixture(scope="module")
def diagnosed(
    tmp_path_factory: pytest.TempPathFactory,
) -> Callable[[str, str, str, str], tuple[Diagnosis, Path]]:
    """Diagnose (once) what one MJCF gives against another."""
    done: dict[str, tuple[Diagnosis, Path]] = {}

    def make(name: str, real: str, given: str, command: str = "torque") -> tuple[Diagnosis, Path]:
        if name not in done:
            folder = tmp_path_factory.mktemp(name.replace(" ", "_"))
            runs = [record(real, folder / f"{k}.npz", k, command) for k in (1, 2)]
            (folder / "given.xml").write_text(given)
            (folder / "model.toml").write_text(
                f'name = "two"\nsample_time = {1 / RATE}\n[mechanism]\nkind = "mjcf"\n'
                f'file = "given.xml"\n[sensor]\nposition_resolution = {RESOLUTION}\n{COLUMNS}'
            )
            d = zendsp.diagnose(runs[0], folder / "model.toml", runs[1], jobs=1)
            done[name] = d, folder
        return done[name]

    return make


def names(d: Diagnosis) -> set[tuple[str, int]]:
    return {(f.effect, f.joint) for f in d.findings}


def test_nothing_is_missing_from_the_model_that_was_simulated(diagnosed) -> None:  # type: ignore[no-untyped-def]
    d, _ = diagnosed("nothing", xml(), xml())
    assert (d.verdict, names(d)) == ("complete", set()), d


@pytest.mark.usefixtures("sizes_unasked")
def test_friction_of_all_joints_is_found_and_written_as_frictionloss(diagnosed) -> None:  # type: ignore[no-untyped-def]
    d, folder = diagnosed("friction", xml(dry=0.6), xml())
    assert names(d) == {("coulomb", 1), ("coulomb", 2)}, d
    write_report(d, folder / "out", pictures=False)
    m = mujoco.MjModel.from_xml_path(str(folder / "out" / "model.mjcf"))
    assert list(m.dof_frictionloss) == pytest.approx([0.6, 0.6], rel=0.03)
    assert load_model(folder / "out" / "model.toml").robot.take == "all"
    again = zendsp.diagnose(folder / "1.npz", folder / "out" / "model.toml", folder / "2.npz",
                            jobs=1)  # fmt: skip
    assert (again.verdict, names(again)) == ("complete", set()), again


@pytest.mark.usefixtures("sizes_unasked")
def test_wrong_damping_is_calibrated_or_named_and_nothing_else_is(diagnosed) -> None:  # type: ignore[no-untyped-def]
    d, folder = diagnosed("viscous", xml(viscous=1.5), xml())
    assert names(d) <= {("viscous", 1)}, d
    write_report(d, folder / "out", pictures=False)
    m = mujoco.MjModel.from_xml_path(str(folder / "out" / "model.mjcf"))
    assert list(m.dof_damping) == pytest.approx([1.5, 0.5], rel=0.05)


@pytest.mark.long("test_diagnosis.py names a spring; lost: of an MJCF")
def test_a_spring_is_found_where_joints_only_sway(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At one frequency a spring looks like an inertia, and a coarse encoder does not show a rotor's
    size. While the spring was missing the rotor had grown to 1e8 kg m² and hidden everything.
    """
    monkeypatch.setitem(globals(), "RESOLUTION", 3e-4)
    given = xml(dry=0.2).replace('armature="0.05"', 'armature="0.01"')
    real = given.replace('axis="0 1 0"/>', 'axis="0 1 0" stiffness="3"/>')
    run = record(real, tmp_path / "run.npz", 1, tones=1)
    (tmp_path / "given.xml").write_text(given)
    (tmp_path / "model.toml").write_text(
        f'name = "two"\nsample_time = {1 / RATE}\n[mechanism]\nkind = "mjcf"\n'
        f'file = "given.xml"\n[sensor]\nposition_resolution = {RESOLUTION}\n{COLUMNS}'
    )
    d = zendsp.diagnose(run, tmp_path / "model.toml", jobs=1)
    assert names(d) == {("stiffness", 2)}, d
    spring = d.findings[0].parameters["coefficient"]
    # a rotor that may be 0.02 kg m² too heavy at 0.5 Hz is 0.2 N m/rad of it
    assert abs(spring.value - 3.0) < 3 * spring.std < 0.6


@pytest.mark.long("a sealed case has such a payload; lost: that it is written into the MJCF")
def test_a_payload_is_one_body_by_mujocos_name_and_goes_into_the_mjcf(diagnosed) -> None:  # type: ignore[no-untyped-def]
    d, folder = diagnosed("payload", xml(tool=TOOL), xml())
    first = d.findings[0]
    assert (first.effect, first.joint, first.as_dict()["body"]) == ("payload", 2, "fore"), d
    assert first.parameters["mass"].value == pytest.approx(1.0, rel=0.03)
    assert len(d.findings) == 1
    write_report(d, folder / "out", pictures=False)
    m = mujoco.MjModel.from_xml_path(str(folder / "out" / "model.mjcf"))
    assert m.body("fore").mass[0] == pytest.approx(2.5, rel=0.02)
    again = zendsp.diagnose(folder / "1.npz", folder / "out" / "model.toml", folder / "2.npz",
                            jobs=1)  # fmt: skip
    assert (again.verdict, names(again)) == ("complete", set()), again


@pytest.mark.usefixtures("sizes_unasked")
def test_a_slide_joint_is_in_newton_and_metres(diagnosed) -> None:  # type: ignore[no-untyped-def]
    motor = '<motor joint="reach"/>'
    dry = SLIDE.replace('damping="4"', 'damping="4" frictionloss="2.5"')
    d, _ = diagnosed("slide", xml(slide=dry, motor=motor), xml(slide=SLIDE, motor=motor))
    assert names(d) == {("coulomb", 3)}, d
    level = d.findings[0].parameters["level"]
    assert level.unit == "N" and level.value == pytest.approx(2.5, rel=0.03)
    turning, sliding = d.errors
    assert (turning.unit, turning.joints) == ("rad", (1, 2))
    assert (sliding.unit, sliding.joints) == ("m", (3,))
    assert sliding.test.improved < 0.5 * sliding.test.calibrated
    assert turning.test.improved == pytest.approx(turning.test.calibrated, rel=0.2)
    assert d.report()["fit_other_unit"][0]["unit"] == "m"
    for told in (summary(d), html._fit_table(d)):
        assert "[rad]" in told and "[m]" in told and "joints 1, 2" in told and "joint 3" in told
    many = replace(d, others=(replace(sliding, joints=(3, 4, 5, 6)),))
    assert re.search(r"untouched recordings, joints 3, 4, 5, 6 +\d", summary(many)), summary(many)


@pytest.mark.usefixtures("sizes_unasked")
def test_the_set_value_of_a_servo_is_not_taken_for_a_torque(diagnosed) -> None:  # type: ignore[no-untyped-def]
    servos = '<position joint="shoulder" kp="150" kv="14"/><position joint="elbow" kp="60" kv="5"/>'

    def servoed(text: str) -> str:
        return text[: text.index("<actuator>")] + f"<actuator>{servos}</actuator></mujoco>"

    d, _ = diagnosed("servo", servoed(xml(dry=0.6)), servoed(xml()), "set value")
    assert {f.joint: f.mechanism for f in d.findings} == {1: "dry_friction", 2: "dry_friction"}, d
    assert any("set value of a servo" in note for note in d.notes)


def test_a_recording_with_other_joints_is_refused(tmp_path: Path) -> None:
    run = record(xml(), tmp_path / "run.npz", 1)
    (tmp_path / "given.xml").write_text(xml(slide=SLIDE, motor='<motor joint="reach"/>'))
    (tmp_path / "model.toml").write_text(
        f'sample_time = 0.004\n[mechanism]\nkind = "mjcf"\nfile = "given.xml"\n{COLUMNS}'
    )
    with pytest.raises(RecordingError, match="has 2 columns; the model has 3 joints"):
        zendsp.diagnose(run, tmp_path / "model.toml")
    with pytest.raises(ModelError, match="no joint 'wrist'"):
        zendsp.diagnose(
            run,
            {"mechanism": {"kind": "mjcf", "file": str(tmp_path / "given.xml"),
                           "joints": ["wrist"]}},
        )  # fmt: skip


def test_the_proof_judges_bodies_in_a_report_by_the_file_that_holds_them(tmp_path: Path) -> None:
    """The improved model had been simulated with the calibrated one's bodies, so that a right
    payload counted as worse.
    """
    run = record(xml(tool=TOOL), tmp_path / "run.npz", 3)
    for name, tool in (("given", ""), ("improved", TOOL)):
        (tmp_path / f"{name}.xml").write_text(xml(tool=tool))
        (tmp_path / f"{name}.toml").write_text(
            f'name = "two"\nsample_time = {1 / RATE}\n[mechanism]\nkind = "mjcf"\n'
            f'file = "{name}.xml"\n[sensor]\nposition_resolution = {RESOLUTION}\n{COLUMNS}'
        )
    given, improved = (tmp_path / f"{name}.toml" for name in ("given", "improved"))
    before, after = errors(run, given, given, improved)
    assert after < 0.05 * before
