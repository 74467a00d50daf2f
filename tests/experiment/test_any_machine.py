"""The experiments on machines that zendsp does not know: they need what a machine declares, not its
name.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import zendsp
from zendsp.cli.experiment import command
from zendsp.errors import ModelError, Refused
from zendsp.experiment import (
    EXPERIMENTS,
    Estimate,
    Lab,
    Result,
    fit_model,
    put_into,
    run_experiment,
)
from zendsp.experiment.any_friction import _moves
from zendsp.experiment.estimates import bump_means
from zendsp.experiment.gentle import ROWS
from zendsp.experiment.knowing import with_values
from zendsp.experiment.lab import needed, told
from zendsp.experiment.mechanics import _durations, _way
from zendsp.experiment.motor import sensor_step
from zendsp.experiment.names import FORMER, result_file
from zendsp.experiment.needs import Needs
from zendsp.experiment.swing import NEEDED, Joint, _ends
from zendsp.link import Target
from zendsp.recording import Recording
from zendsp_protocol.messages import JointInfo, MachineInfo

LIFT = """<mujoco model="lift"><worldbody><body><joint name="lift" type="slide" axis="0 0 1"
frictionloss="6" damping="20" range="-1 1"/><geom size="0.1" mass="3"/></body></worldbody>
<actuator><motor joint="lift" ctrlrange="-150 150"/></actuator></mujoco>"""
BAR = """<mujoco model="bar"><compiler angle="radian"/><worldbody><body><joint name="shaft"
axis="0 1 0" armature="0.002" frictionloss="0.15" damping="0.03" range="-2 2"/><geom type="capsule"
fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.8"/></body></worldbody>
<actuator><motor joint="shaft" ctrlrange="-4 4"/></actuator></mujoco>"""
MODEL = """name = "lift"
sample_time = 0.001
[mechanism]
kind = "mjcf"
file = "lift.xml"
[actuator]
hold = 0.001
delay = 0.00116
[columns]
position = "q"
"""
SHAFT = JointInfo(name="shaft", position_min=-3.0, position_max=3.0, speed_max=10.0, torque_max=2.0)
ARM = MachineInfo(name="arm", joints=(SHAFT, SHAFT))


@contextmanager
def started(folder: Path, xml: str, name: str, seed: int = 1) -> Iterator[Target]:
    file = folder / f"{name}.xml"
    file.write_text(xml)
    options = ["--speed", "100", "--machine-option", f"seed={seed}"]
    with zendsp.local(str(file), clock="fast", options=options) as target:
        yield target


def keeps_within(folder: Path, limit: float, speed: float) -> None:
    """Every recording stays off the ends of the range, and below the largest speed."""
    files = list(folder.glob("*.npz"))
    assert files
    for file in files:
        q = np.atleast_2d(Recording.load(file)["q"].T)
        # 20 ms: a count of the encoder is no speed
        assert np.abs(q).max() < limit and np.abs(q[:, 20:] - q[:, :-20]).max() / 0.02 < speed, file


def near(found: dict[str, Estimate], truth: dict[str, float], share: float) -> None:
    """Within four stated deviations, which are at most a share of the value."""
    for name, true in truth.items():
        e = found[name]
        assert abs(e.value - true) < 4 * e.std < 4 * share * max(abs(true), 0.1), (name, e)


def test_what_a_machine_lacks_is_said_in_a_sentence() -> None:
    volts = replace_joints(ARM, command="voltage")
    sensed = MachineInfo(name="arm", joints=volts.joints, adc_units=("A", "A", "V"))
    for needs, machine, said in (
        (Needs("voltage"), ARM, "a machine whose command is a voltage, at shaft it is a torque"),
        (Needs(), volts, "a machine whose command is a torque, at shaft it is a voltage"),
        (Needs(), replace_joints(ARM, command="none"), "a joint with a motor, and this machine"),
        (Needs(most=1), ARM, "a machine of 1 joint, and this one has 2 joints"),
        (Needs(least=3), ARM, "3 joints with a drive, and this machine has 2 joints"),
        (Needs("voltage", sensed=True), volts, "of 2 joints with a drive this machine tells none"),
        (Needs("voltage", sensed=True), sensed, r"the voltage of each motor .* tells 1"),
        (Needs(model="with friction"), ARM, "a model file of the machine.*--model FILE"),
    ):
        with pytest.raises(Refused, match=said):
            raise Refused(needs.lacking(machine, False))
    assert Needs(model="with friction").lacking(ARM, True) == Needs().lacking(ARM, False) == ""
    assert Needs().lacking(replace_joints(ARM, command="force"), False) == ""


def replace_joints(machine: MachineInfo, command: str) -> MachineInfo:
    joints = tuple(
        JointInfo(name=j.name, command=command, position_min=-3.0, position_max=3.0)
        for j in machine.joints
    )
    return MachineInfo(name=machine.name, joints=joints)


def test_a_machine_of_one_slide_gets_all_that_fit_and_is_told_what_it_lacks(
    tmp_path: Path,
) -> None:
    (tmp_path / "lift.toml").write_text(MODEL)
    with started(tmp_path, LIFT, "lift") as target:
        lab = Lab(tmp_path, target)
        found = run_experiment("mechanical", lab)
        truth = {"mass1": 3.0, "coulomb1": 6.0, "viscous1": 20.0, "weight1": 29.43}
        near(found.values, truth, 0.01)
        assert {(e.kind, e.joint) for e in found.effects} == {("coulomb", 1), ("viscous", 1)}
        keeps_within(tmp_path / "mechanical", 0.6, 0.8 * 2.0)
        swung = run_experiment("swing", lab).values
        # planned with numbers that are right to 0.1 %
        assert all(swung[f"{run}_final_error"].value < 0.01 for run in ("open_loop", "closed_loop"))
        assert swung["open_loop_final_error"].unit == "m"
        keeps_within(tmp_path / "swing", 0.95, 0.8 * 2.0)
        followed = run_experiment(
            "wam-tracking", Lab(tmp_path, target, model=tmp_path / "lift.toml")
        )
        assert followed.name == "tracking" and followed.machine == target.info.machine
        apart = followed.values["joint1_alone_apart"]
        assert apart.value < 3.0, "the model is the machine"
        assert followed.values["joint1_alone_machine"].unit == "m"
        assert "joint1_all_machine" not in followed.values, "it is the only one"
        with pytest.raises(Refused, match=r"command is a voltage, at lift it is a force$"):
            run_experiment("electrical", lab)
        with pytest.raises(Refused, match="experiment tracking needs a model file"):
            run_experiment("tracking", Lab(tmp_path, target))


def test_a_mujoco_model_that_is_called_as_a_shipped_machine_is_not_taken_for_it(
    tmp_path: Path,
) -> None:
    """Its torques would be the pendulum's, whatever the model is."""
    with started(tmp_path, BAR, "pendulum") as target:
        assert target.info.machine == "pendulum"
        assert Lab(tmp_path, target).shipped("mechanical") == ""
        assert EXPERIMENTS["electrical"].lacking(told(target)).endswith("it is a torque")
        tracking = EXPERIMENTS["tracking"]
        assert "model" in replace(tracking, shipped="pendulum").lacking(told(target))
    assert Lab(tmp_path).shipped("mechanical") == "pendulum"


# of the file, by mujoco: 0.8 kg on 0.15 m; the capsule's caps belong to the inertia
OF_THE_BAR = {"inertia1": 0.026569, "weight_sine1": 1.1772, "weight_cosine1": 0.0,
              "coulomb1": 0.15, "viscous1": 0.03}  # fmt: skip


def test_a_bar_that_may_not_go_round_is_measured_and_swung_within_its_range(
    tmp_path: Path,
) -> None:
    with started(tmp_path, BAR, "bar", 3) as target:
        lab = Lab(tmp_path, target)
        found = run_experiment("mechanical", lab)
        assert found.mechanism["gravity"].value == found.values["weight_sine1"].value
        swung = run_experiment("swing", lab).values
        assert swung["closed_loop_final_error"].value < 0.05
        for name in ("mechanical", "swing"):
            keeps_within(tmp_path / name, 2.0, 0.8 * 2 * np.pi)
    near(found.values, OF_THE_BAR, 0.03)


@pytest.mark.long("one copy of the noise is held to the same above; lost: two more of them")
def test_a_bar_is_measured_within_what_is_stated_whatever_the_noise(tmp_path: Path) -> None:
    copies = []
    for seed in (1, 2, 3):  # what is stated of it differs by three from copy to copy
        with started(tmp_path, BAR, "bar", seed) as target:
            copies.append(run_experiment("mechanical", Lab(tmp_path / str(seed), target)).values)
    for name, true in OF_THE_BAR.items():
        each = sorted((copy[name] for copy in copies), key=lambda e: e.std)
        assert all(abs(e.value - true) < 4 * e.std for e in each), (name, each)
        near({name: each[1]}, {name: true}, 0.03)


def test_each_motor_behind_a_voltage_is_measured_within_its_range(tmp_path: Path) -> None:
    motors = Path(__file__).parent / "motors.c"
    with zendsp.local(str(motors), clock="fast", options=["--speed", "100"]) as target:
        found = run_experiment("electrical", Lab(tmp_path, target)).values
        near(found, {"k_a1": 0.05, "R_a1": 2.0, "k_a2": 8.0, "R_a2": 3.0}, 0.01)
        assert found["k_a2"].unit == "N/A" and found["k_a1"].unit == "N m/A"
        assert target.status().trip is None
    for file in (tmp_path / "electrical").glob("*.npz"):
        q = np.abs(Recording.load(file)["q"]).max(axis=0)
        assert q[0] < 3.0 and q[1] < 0.2, f"{file.name}: the slide is held, or turned back in time"


def test_a_motor_whose_shaft_turns_freely_is_let_turn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The pendulum, measured as a machine that nobody knows."""
    monkeypatch.setattr(Lab, "shipped", lambda self, name: "")
    options = ["--machine-option", "drive=voltage", "--speed", "100"]
    with zendsp.local("pendulum", clock="fast", options=options) as target:
        found = run_experiment("electrical", Lab(tmp_path, target)).values
    near(found, {"k_a1": 0.1762, "R_a1": 5.54}, 0.01)
    keeps_within(tmp_path / "electrical", 1000.0, 0.8 * 100.0)


def test_a_light_joint_with_much_friction_gets_a_loop_that_moves_it(tmp_path: Path) -> None:
    """As the WAM's wrist: its inertia asks for 0.4 N m/rad, its friction for 0.46 N m."""
    wrist = BAR.replace("0.8", "0.01").replace('armature="0.002"', 'armature="0.001"')
    wrist = wrist.replace('"0.15"', '"0.46"').replace('"0.03"', '"0.5"')
    with started(tmp_path, wrist, "wrist") as target:
        for name in ("mechanical", "friction"):
            found = run_experiment(name, Lab(tmp_path, target)).values
            near(found, {"coulomb1": 0.46, "viscous1": 0.5}, 0.03)
    keeps_within(tmp_path / "mechanical", 2.0, 0.8 * 2 * np.pi)
    loop = Recording.load(tmp_path / "mechanical" / "joint1.npz").parameters["J"]
    assert np.ravel(loop)[0] > 2 * 0.0013, "kg m^2: twice what the bar turns, at least"


def test_moves_are_as_fast_as_speed_and_torque_allow_and_a_table_holds_them() -> None:
    lift = JointInfo(name="lift", unit="m", position_min=-1, position_max=1, speed_max=2.0,
                     torque_max=150.0)  # fmt: skip
    for own, inertia in (
        (lift, 3.0),
        (replaced(lift, speed_max=0.2), 3.0),
        (replaced(lift, torque_max=2.0), 3.0),
        (replaced(lift, torque_max=2.0), 300.0),
    ):
        durations, way = _durations(own, _way(own, 0.0)[0], inertia)
        assert durations == sorted(durations, reverse=True), "slow to fast"
        assert 1.875 * way / durations[-1] <= 0.4 * own.speed_max * 1.001
        assert 5.78 * way * inertia / durations[-1] ** 2 <= 0.3 * own.torque_max * 1.01
        assert 2 * (sum(durations) + 0.3 * len(durations)) <= 55.0, "of 60 s"


def replaced(joint: JointInfo, **fields: float) -> JointInfo:
    return JointInfo(**{name: getattr(joint, name) for name in joint.__struct_fields__} | fields)


def test_a_shape_of_samples_averages_a_polynomial_and_its_derivatives() -> None:
    """Exactly those of its middle where they are linear, whatever the offset."""
    t = 0.001 * np.arange(-20, 21)
    place, speed, turn = bump_means(1e3 + 2.0 * t + 1.5 * t**2, 0.001)
    # 1e-6 of what the integrals are made of
    assert place == pytest.approx(1e3, abs=1e-3)
    assert speed == pytest.approx(2.0, rel=1e-6) and turn == pytest.approx(3.0, rel=1e-4)


def test_the_step_of_a_sensor_is_read_off_its_readings() -> None:
    step, rng = 30 / 2048, np.random.default_rng(1)
    few = np.array([35, 53, 80, 121, -35, -53]) * step
    assert sensor_step(few) == pytest.approx(step), "though no two are neighbours"
    assert sensor_step(np.round(rng.normal(size=500) / step) * step) == pytest.approx(step)
    assert sensor_step(rng.normal(size=500)) < 1e-6 and sensor_step(np.ones(9)) == 0.0


def test_a_swing_goes_upright_where_the_range_allows_and_else_as_far_as_it_may() -> None:
    free = JointInfo(name="shaft", position_min=-1000.0, position_max=1000.0)
    bar = Joint(free, 0.02, 0.1, 0.0, sine=0.0, cosine=1.0, constant=0.0)
    start, goal = _ends(bar, 0.0)
    assert start == pytest.approx(-np.pi / 2) and abs(goal) == pytest.approx(np.pi / 2)
    start, goal = _ends(replace(bar, own=SHAFT, sine=1.0, cosine=0.0), 0.0)
    assert start == 0.0 and abs(goal) == pytest.approx(2.4), "0.6 off the end of 3"
    start, goal = _ends(replace(bar, own=SHAFT, cosine=0.0), 2.0)
    assert (start, goal) == (2.0, pytest.approx(1.2)), "nothing hangs: 0.8 rad, away from the end"


def test_the_result_of_another_machine_is_made_again_and_a_former_name_is_found(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "wam-friction"
    folder.mkdir()
    Result("wam-friction", "before", "wam7").save(folder / "result.toml")
    assert result_file(tmp_path, "friction") == folder / "result.toml"
    lab = Lab(tmp_path)
    before = needed(lab, "friction", lambda lab: Result("friction", "now", "wam7"))
    assert (before.title, before.name) == ("before", "friction")
    (tmp_path / "friction").mkdir()
    Result("friction", "x", "arm").save(tmp_path / "friction" / "result.toml")
    assert needed(lab, "friction", lambda lab: Result("friction", "now", "wam7")).title == "now"
    assert set(FORMER.values()) == set(EXPERIMENTS)


def test_a_truncated_result_is_made_again_with_a_word(tmp_path: Path) -> None:
    """A swing took what a result lacked for zero: without its weight it was planned to 0.8 rad."""
    said: list[str] = []
    lab = Lab(tmp_path, say=said.append)
    whole = Result("mechanical", "now", "pendulum")
    whole.values = {one[0]: Estimate(1.0) for one in NEEDED}
    cut = Result("mechanical", "before", "pendulum", values={"inertia1": Estimate(1.0)})
    (tmp_path / "mechanical").mkdir()
    cut.save(tmp_path / "mechanical" / "result.toml")
    assert with_values(lab, "mechanical", lambda lab: whole, NEEDED).title == "now"
    assert "lacks coulomb1, viscous1, weight1 or weight_sine1" in said[-1]
    assert with_values(lab, "mechanical", lambda lab: cut, NEEDED).title == "now", "it was kept"


def test_slow_moves_fit_into_the_table_of_a_program(tmp_path: Path) -> None:
    """Refused they were, with 1424340 elements for 180000."""
    for speed_max in (10.0, 0.15, 0.02):
        slow = replaced(SHAFT, speed_max=speed_max)
        moves = _moves(slow, np.zeros(3), 1, 6, 1e-3)
        assert moves.samples <= ROWS and round(1.0 / moves.sample_time, 9).is_integer()
        assert np.abs(moves.qd).max() == pytest.approx(min(0.4 * speed_max, 0.8 / 0.6), rel=0.01)


def test_a_model_that_an_experiment_makes_nothing_of_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "lift.toml"
    file.write_text(MODEL)
    for name in ("friction", "mechanical", "swing"):
        refused = CliRunner().invoke(command, [name, "--model", str(file)])
        assert isinstance(refused.exception, Refused)
        assert f"{name} takes no model" in str(refused.exception)
        with pytest.raises(Refused, match=f"{name} takes no model"):
            run_experiment(name, Lab(tmp_path, model=file))
    assert EXPERIMENTS["low-speed"].takes_model


def test_a_name_that_is_mistyped_is_answered_with_the_nearest(tmp_path: Path) -> None:
    file = tmp_path / "lift.toml"
    file.write_text(MODEL)
    for words in (["frction"], ["frction", "--model", str(file)], ["frction", "-t", "nobody"]):
        refused = CliRunner().invoke(command, words)
        said = "no experiment 'frction'; did you mean friction? There are friction, breakaway"
        assert isinstance(refused.exception, Refused) and said in str(refused.exception), words
    with pytest.raises(Refused, match="no experiment 'zzz'; there are friction"):
        run_experiment("zzz", Lab(tmp_path))


def test_the_command_tells_what_each_needs_and_the_present_name(tmp_path: Path) -> None:
    shown = CliRunner().invoke(command, []).output
    assert "current and voltage sensed" in shown and "torque, --model" in " ".join(shown.split())
    model = Path(__file__).parents[2] / "examples" / "models" / "imi_planar.toml"
    words = ["pendulum-mechanical", "--into", str(model), "--out", str(tmp_path)]
    asked = CliRunner().invoke(command, words)
    assert "pendulum-mechanical is called mechanical now" in asked.output
    assert "2 joints and pendulum, which was measured, 1" in str(asked.exception)


def test_a_model_takes_in_what_its_mechanism_has_and_of_as_many_joints(tmp_path: Path) -> None:
    (tmp_path / "lift.xml").write_text(LIFT)
    model = tmp_path / "lift.toml"
    model.write_text(MODEL)
    one = MachineInfo(name="x", joints=(SHAFT,))
    assert fit_model(["mechanical"], model, one) == ["mechanical"]
    with pytest.raises(ModelError, match="has 1 joint and arm, which was measured, 2"):
        fit_model(["friction"], model, ARM)
    result = Result("mechanical", "of a lift", "lift", mechanism={"mass": Estimate(3.0)})
    with pytest.raises(ModelError, match="mass"):
        put_into(result, model)  # masses of a MuJoCo model are its file's
