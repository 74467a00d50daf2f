"""Machines that a user describes: their dynamics, limits and files."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import zendsp
import zendsp_isr
from zendsp.cli.planned_for import machine_for
from zendsp.cli.reference import command
from zendsp.errors import ReferenceError_
from zendsp.reference import (
    Reference,
    check_fits,
    load_machine,
    make_from_file,
    make_reference,
    plot_reference,
    save_reference,
)
from zendsp.reference.machine import EXAMPLE


def test_dynamics_of_the_wam_are_pinocchios_to_1e_9(wam_of_pinocchio: Any) -> None:
    import pinocchio as pin

    machine = load_machine("wam7")
    friction = machine.dynamics.inverse
    data, still = wam_of_pinocchio.createData(), np.zeros((1, 7))
    for q, qd, qdd in np.random.default_rng(4).normal(size=(20, 3, 1, 7)):
        rubs = friction(still, qd, still) - _rnea(pin, wam_of_pinocchio, data, still, qd, still)
        rigid = machine.dynamics.inverse(q, qd, qdd) - rubs
        assert np.abs(rigid - _rnea(pin, wam_of_pinocchio, data, q, qd, qdd)).max() < 1e-9
        tau = machine.dynamics.inverse(q, qd, qdd)[0]
        assert machine.dynamics.acceleration(q[0], qd[0], tau) == pytest.approx(qdd[0], abs=1e-6)
    assert np.abs(rubs).max() > 0.01, "the model carries friction too"


def _rnea(pin: Any, model: Any, data: Any, *motion: np.ndarray) -> np.ndarray:
    return np.array([pin.rnea(model, data, *(row[0] for row in motion))])


def test_a_machine_of_ones_own_is_a_toml_file_of_the_same_form(tmp_path: Path) -> None:
    file = tmp_path / "slow_arm.toml"
    file.write_text(
        'name = "slow_arm"\nkind = "planar2r"\njoints = 2\nsample_time = 0.002\nhome = [0, 0]\n'
        "[limits]\nposition_min = [-1, -1]\nposition_max = [1, 1]\nspeed = [0.5, 0.5]\n"
        "acceleration = [2, 2]\ntorque = [50, 50]\n[parameters]\np1 = 1.0\np2 = 0.2\np3 = 0.1\n"
        "l1 = 0.5\nl2 = 0.5\nviscous = [0, 0]\ncoulomb = [0, 0]\n"
    )
    machine = load_machine(str(file))
    reference = make_reference("point_to_point", machine, duration=0.0, headroom=1.0, goal=0.8)
    machine.check(reference)
    assert (
        reference.sample_time == 0.002 and 0.45 < abs(reference.qd).max() <= 0.5
    ), "the shortest within its limits"
    file.write_text(file.read_text().replace("coulomb", "colomb"))
    with pytest.raises(ReferenceError_, match=r"no machine.*zendsp tui"):
        load_machine(str(tmp_path / "other.toml"))


@pytest.mark.parametrize(
    ("line", "key", "meant"),
    [("torqe = [1.0, 1.0]", "torqe", "torque"), ("viscus = [0.1, 0.1]", "viscus", "viscous")],
)
def test_a_key_of_a_machine_that_nobody_reads_is_refused(
    tmp_path: Path, line: str, key: str, meant: str
) -> None:
    shipped = (
        resources.files("zendsp.reference").joinpath("machines", "imi_planar.toml").read_text()
    )
    table = "[limits]" if meant == "torque" else "[parameters]"
    path = tmp_path / "mine.toml"
    path.write_text(shipped.replace(table, f"{table}\n{line}"))
    with pytest.raises(
        ReferenceError_, match=rf"mine\.toml: \{table[:-1]}.*{key}.*did you mean {meant}\?"
    ):
        load_machine(str(path))


def test_a_machine_without_a_model_is_planned_for_by_its_limits_alone(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        'name = "mine"\nkind = "limits"\njoints = 2\nsample_time = 0.001\nhome = [0, 0]\n'
        "[limits]\nposition_min = [-1, -1]\nposition_max = [1, 1]\nspeed = [2, inf]\n"
        "acceleration = [inf, inf]\ntorque = [5, 5]\n"
    )
    machine = load_machine(str(file))
    reference = make_reference("point_to_point", machine, goal=[0.5, 0.5], duration=0, headroom=1)
    assert machine.torque(reference) is None and not machine.find_violations(reference)
    peaks = np.abs(reference.qd).max(), np.abs(reference.qdd).max()
    assert 0.9 < peaks[0] <= 1.0 and peaks[1] <= 10.0, "moderate where no limit is known"
    with pytest.raises(ReferenceError_, match="torque is not predicted"):
        make_reference("step", machine, quantity="torque")
    pushed = Reference(reference.q, 0.001, tau=np.full(reference.q.shape, 6.0))
    assert [v.quantity for v in machine.find_violations(pushed)] == ["torque", "torque"]
    assert len(plot_reference(reference, machine).axes) == 3
    said = CliRunner().invoke(command, ["trapezoid", "--machine", str(file)])
    assert said.exit_code == 0 and "torque is not predicted" in said.output, said.output


def test_a_reference_of_another_machine_is_refused_or_told(tmp_path: Path) -> None:
    slide = tmp_path / "slide.toml"
    slide.write_text(
        'name = "slide"\nkind = "limits"\nunit = "m"\njoints = 1\nsample_time = 0.001\n'
        "home = [0.0]\n[limits]\nposition_min = [-1]\nposition_max = [1]\nspeed = [1.0]\n"
        "acceleration = [9.0]\ntorque = [20.0]\n"
    )
    moved = make_reference("point_to_point", load_machine(str(slide)), goal="0.2")
    assert moved.unit == "m"
    with pytest.raises(ReferenceError_, match=r"planned for slide and is in m, pendulum is in rad"):
        load_machine("pendulum").check(moved)
    with pytest.raises(ReferenceError_, match=r"imi_planar and has 2 joints, wam7 has 7: choose"):
        load_machine("wam7").check(make_reference("circle", "imi_planar"))
    told = check_fits(replace(moved, machine="other"), "slide", ["m"])
    assert told.startswith("the reference was planned for other, not for slide: its limits")
    assert "says rad, slide is in m" in check_fits(Reference(moved.q, 0.001), "slide", ["m"])
    assert not check_fits(moved, "slide", ["m"])

    file = str(save_reference(moved, tmp_path / "moved.mat"))
    shown = CliRunner().invoke(command, ["show", file])
    words = "--target NAME of one that runs, or --machine FILE"
    assert isinstance(shown.exception, ReferenceError_) and words in str(shown.exception)
    shown = CliRunner().invoke(command, ["show", file, "--machine", str(slide)])
    assert "q max m" in shown.output and "rad" not in shown.output, shown.output
    with pytest.raises(ReferenceError_, match="is in m, pendulum is in rad"):
        make_from_file(load_machine("pendulum"), path=file)
    assert make_from_file(replace(load_machine(str(slide)), name="b"), path=file).machine == "b"


def test_a_description_that_lacks_keys_is_refused_with_all_of_them_and_a_whole_one(
    tmp_path: Path,
) -> None:
    file = tmp_path / "part.toml"
    file.write_text('name = "x"\n[limits]\nspeed = [1.0]\n')
    with pytest.raises(ReferenceError_) as refused:
        load_machine(str(file))
    said = str(refused.value)
    lacks = "kind, joints, sample_time, home, [limits] position_min, [limits] position_max,"
    assert f"lacks {lacks} [limits] acceleration, [limits] torque." in said
    assert "--target NAME" in said and "arm.urdf" in said
    assert EXAMPLE in said
    whole = tmp_path / "whole.toml"
    whole.write_text(EXAMPLE)
    assert load_machine(str(whole)).joints == 2, "the example is one"
    model = tmp_path / "model.toml"
    model.write_text('name = "arm"\n[mechanism]\nkind = "planar2r"\n')
    with pytest.raises(ReferenceError_, match=r"model of a diagnosis.*--target NAME"):
        load_machine(str(model))


def _limits(*words: str) -> dict[str, list[float | None]]:
    """Those that a motion was planned within, as ``zendsp reference KIND --json`` says."""
    done = CliRunner().invoke(command, ["point-to-point", "--goal", "0.1", "--json", *words])
    assert done.exit_code == 0, done.output
    said: dict[str, list[float | None]] = json.loads(done.stdout)["limits"]
    return said


def test_a_running_target_tells_the_limits_to_plan_within(tmp_path: Path) -> None:
    shipped = Path(zendsp_isr.__file__).parent / "machines"
    own = tmp_path / "own.c"
    text = (shipped / "pendulum.c").read_text()
    for header in shipped.glob("*.h"):
        shutil.copy(header, tmp_path)
    own.write_text(text.replace('"pendulum"', '"own"'))
    with zendsp.local(str(own), clock="fast") as target:
        declared = _limits("--target", target.name)
        assert target.status().state == "empty", "nothing is left loaded"
        target.download("torque_steps.c")
        target.set_limits(speed_max=[3.0])
        joint = target.machine().joints[0]
        running = _limits("--target", target.name)
    assert declared["speed"] == [joint.speed_max] and declared["torque"] == [joint.torque_max]
    assert running == {**declared, "speed": [3.0]}
    both = CliRunner().invoke(command, ["step", "--machine", "wam7", "--target", "any"])
    assert both.exit_code == 2 and "give one of them" in both.output


URDF = """<robot name="arm"><link name="base"/>
<link name="l1"><inertial><origin xyz="0.2 0 0"/><mass value="1"/>
<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1.2" velocity="2.5" effort="30"/></joint></robot>
"""


def test_a_urdf_tells_the_limits_to_plan_within(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    file = tmp_path / "arm.urdf"
    file.write_text(URDF)
    assert _limits("--machine", str(file)) == {
        "position_min": [-1.0], "position_max": [1.2], "speed": [2.5], "acceleration": [None],
        "torque": [30.0],
    }  # fmt: skip
    absent = CliRunner().invoke(command, ["step", "--machine", str(tmp_path / "absent.urdf")])
    assert isinstance(absent.exception, ReferenceError_)
    assert "no such file" in str(absent.exception)


FORK = """<robot name="fork"><link name="base"/>
<link name="l1"><inertial><origin xyz="0.1 0 0.2"/><mass value="3"/>
<inertia ixx=".02" iyy=".03" izz=".02" ixy=".001" ixz="0" iyz="0"/></inertial></link>
<link name="l2"><inertial><origin xyz="0 0.1 0.1"/><mass value="1"/>
<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="l3"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
<inertia ixx=".01" iyy=".02" izz=".02" ixy="0" ixz=".001" iyz="0"/></inertial></link>
<joint name="root" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="9" effort="90"/></joint>
<joint name="zeta" type="revolute"><parent link="l1"/><child link="l2"/><axis xyz="1 0 0"/>
<origin xyz="0 0.1 0.3"/><limit lower="-2" upper="2" velocity="9" effort="90"/>
<dynamics damping="0.5" friction="0.8"/></joint>
<joint name="alpha" type="prismatic"><parent link="l1"/><child link="l3"/><axis xyz="0 0 1"/>
<origin xyz="0 -0.1 0.3"/><limit lower="-1" upper="1" velocity="9" effort="90"/></joint></robot>
"""


def test_a_urdf_tells_the_torque_of_a_motion_in_its_own_order_of_joints(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    pin = pytest.importorskip("pinocchio")
    file = tmp_path / "fork.urdf"
    file.write_text(FORK)
    machine = machine_for(str(file), "", None)
    assert machine is not None and machine.modelled
    rng = np.random.default_rng(0)
    q, qd, qdd = (rng.uniform(-1.0, 1.0, (20, 3)) for _ in range(3))
    told = machine.torque(Reference(q, 0.001, qd, qdd))
    model = pin.buildModelFromXML(FORK)
    data, names = model.createData(), ["root", "zeta", "alpha"]
    at = [model.idx_vs[model.getJointId(name)] for name in names]
    for k in range(20):
        full = [np.zeros(3) for _ in range(3)]
        for vector, column in zip(full, (q, qd, qdd), strict=True):
            vector[at] = column[k]
        rigid = pin.rnea(model, data, *full)[at]
        rigid[1] += 0.5 * qd[k, 1] + 0.8 * np.tanh(100.0 * qd[k, 1])
        assert told is not None and told[k] == pytest.approx(rigid, abs=1e-9)


def test_a_motion_beyond_the_torque_of_a_urdf_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    file = tmp_path / "arm.urdf"
    file.write_text(URDF.replace('xyz="0 0 1"', 'xyz="0 1 0"').replace('effort="30"', 'effort="2"'))
    held = CliRunner().invoke(
        command, ["point_to_point", "--machine", str(file), "--start", "0", "--goal", "0.5"]
    )
    assert isinstance(held.exception, ReferenceError_) and "torque" in str(held.exception)


def test_a_urdf_that_is_no_tree_of_the_joints_tells_its_limits_alone(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    file = tmp_path / "fork.urdf"
    follows = '<mimic joint="root" multiplier="1"/></joint></robot>'
    turns = FORK.replace('type="prismatic"', 'type="revolute"')
    file.write_text(turns.replace("</joint></robot>", follows))
    machine = machine_for(str(file), "", None)
    assert machine is not None and not machine.modelled


def test_a_reference_of_no_named_machine_is_shown_without_limits(tmp_path: Path) -> None:
    """The next_reference.mat of a diagnosis was refused: it names no machine."""
    path = save_reference(Reference(np.linspace(0.0, 0.5, 100), 0.01), tmp_path / "next.mat")
    shown = CliRunner().invoke(command, ["show", str(path)])
    assert shown.exit_code == 0, shown.output
    assert "checked against no limits: --machine or --target says whose" in shown.output
    assert "only the limits are known" not in shown.output
    assert "0.5000" in shown.output
    checked = CliRunner().invoke(command, ["show", str(path), "--machine", "pendulum"])
    assert checked.exit_code == 0 and "within 100 % of the limits" in checked.output
    drawn = CliRunner().invoke(command, ["show", str(path), "--plot", str(tmp_path / "x.png")])
    assert isinstance(drawn.exception, ReferenceError_)
    assert "whose limits to draw" in str(drawn.exception)
