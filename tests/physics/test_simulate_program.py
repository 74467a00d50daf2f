"""User code in the loop on the host: what a target would do, without one."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from waiting import until

from zendsp.cli.simulate import command
from zendsp.errors import (
    AcquisitionError,
    CompileFailed,
    ReferenceError_,
    RunnerDied,
    VariableError,
)
from zendsp.physics import load_model, simulate
from zendsp.physics.simulation.program import compile_program
from zendsp.recording import Recording
from zendsp.reference import Reference, load_machine, make_circle, save_reference
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime

MODELS = Path(__file__).parents[2] / "examples" / "models"
HEAD = '#include "isr.h"\nstatic double a, k, v[3];\nstatic int32_t whole;\nstatic bool on;\n'
INIT = (
    'void UserInit(void) { PARAMETER(k, 2.0, "V", 0.0, 5.0, "gain"); PARAMETER(whole, 1, "", 0, 9,'
    ' "n"); PARAMETER(on, 0, "", 0, 1, "b"); PARAMETER_ARRAY(v, "", NO_MIN, NO_MAX, "x"); SIGNAL(a,'
    ' "rad", "angle"); }\n'
)


def program(body: str) -> dict[str, str]:
    return {
        "p.c": (
            HEAD + INIT + f"void UserISR_INT2(void) {{ {body} }}\nvoid UserBackground(void) {{}}\n"
        )
    }


@pytest.fixture(scope="module")
def pendulum() -> object:
    return load_model(MODELS / "pendulum.toml")


SEEN = """
#include "isr.h"
static double inertia[8], most[8], counts[8], scale[8], zero[8], period;
static int32_t joints;
void UserInit(void) {
    SIGNAL(inertia, "", ""); SIGNAL(most, "", ""); SIGNAL(counts, "", ""); SIGNAL(scale, "", "");
    SIGNAL(zero, "", ""); SIGNAL(period, "s", ""); SIGNAL(joints, "", "");
}
void UserISR_INT2(void) {
    for (int32_t j = 0; j < JOINTS; j++) {
        inertia[j] = JOINT_INERTIA(j), most[j] = TORQUE_MAX(j);
        IOGP_FU1_WRITE_AOUT_ENGU(j) = 0.0;
        counts[j] = zendsp->counts_per_unit[j], scale[j] = zendsp->mv_per_torque[j];
        zero[j] = zendsp->zero_counts[j];
    }
    period = SAMPLE_PERIOD, joints = JOINTS;
}
"""
FINGER = """<mujoco model="finger"><compiler angle="radian"/><worldbody>
  <body><joint name="lift" type="slide" axis="0 0 1" armature="1.5"/>
  <inertial pos="0.1 0 0" mass="2" diaginertia="0.01 0.02 0.02"/>
    <body pos="0.3 0 0"><joint name="arm" axis="0 0 1" armature="0.02"/>
    <inertial pos="0.2 0 0" mass="1" diaginertia="0.01 0.02 0.02"/>
      <body pos="0.3 0 0"><joint name="hand" axis="0 0 1"/>
      <inertial pos="0.02 0 0" mass="0.1" diaginertia="1e-5 2e-5 2e-5"/></body></body></body>
</worldbody><actuator>
  <motor joint="lift" ctrlrange="-60 60"/><motor joint="arm" ctrlrange="-9 9"/>
  <motor joint="hand" ctrlrange="-2 2"/>
</actuator></mujoco>"""
ARM = """name = "finger"
sample_time = 0.001
[mechanism]
kind = "mjcf"
file = "finger.xml"
[actuator]
gain = 1.0
limit = [60.0, 9.0, 2.0]
[sensor]
position_resolution = [1e-6, 4.79369e-05, 4.79369e-05]
"""


@pytest.mark.parametrize("machine", ["imi_planar", "pendulum", "finger.xml"])
def test_a_program_sees_the_same_numbers_of_the_machine_on_a_target_and_in_the_simulation(
    machine: str, tmp_path: Path
) -> None:
    """Of the inertia it saw 0, and a program that made its gains of it had others."""
    model = MODELS / f"{machine}.toml"
    if machine == "finger.xml":
        (tmp_path / machine).write_text(FINGER)
        machine, model = str(tmp_path / machine), tmp_path / "finger.toml"
        model.write_text(ARM)
    names = ["inertia", "most", "counts", "scale", "zero", "period", "joints"]
    with Runtime(machine, clock="fast") as runtime:
        runtime.load(runtime.compile({"seen.c": SEEN}).key)
        runtime.acquire_configure(0, AcquireConfig(tuple(names), seconds=0.01))
        runtime.acquire_start(0)
        runtime.start(ticks=10)
        until(lambda: runtime.acquire_status(0).state == "done", "rows")
        row = runtime.acquire_read(0, 0, 1)[0]
    here = simulate({"seen.c": SEEN}, model, seconds=0.01, channels=names)
    # a model file may round what the machine's counts are
    seen = np.concatenate([np.atleast_1d(here[name][0]) for name in names])
    assert seen == pytest.approx(row, rel=1e-5)
    assert (row[: int(row[-1])] > 0.0).all()


def test_a_target_and_the_simulation_agree_where_machine_and_model_do() -> None:
    """With friction = plain the machine has the Coulomb and viscous friction of the model file (and
    very stiff bristles).
    """
    values = {"Kp1": 2500.0, "radius": 0.3, "center1": 0.3}
    with Runtime("imi_planar", clock="fast", machine_config={"friction": "plain"}) as runtime:
        key = runtime.compile(compile_program("pd.c").sources).key
        runtime.load(key)
        runtime.write(values, "test")
        runtime.acquire_configure(0, AcquireConfig(("q", "tau"), seconds=3.0))
        runtime.acquire_start(0)
        runtime.start(ticks=3005)
        runtime.wait_paused()
        real = runtime.acquire_read(0, 0, 3000)
    sim = simulate(
        "pd.c", MODELS / "imi_planar.toml", seconds=3.0, parameters=values, channels=["q", "tau"]
    )
    assert np.ptp(real[:, :2], axis=0).max() > 0.5, "it moves"
    # a sample of delay more or less would be 1 mrad; here: counts (floor there, nearest here) and
    # bristles
    assert np.abs(sim["q"] - real[:, :2]).max() < 3e-4
    assert np.corrcoef(sim["tau"][200:, 0], real[200:, 2])[0, 1] > 0.99


def test_the_same_input_gives_the_same_recording_to_the_last_bit(pendulum: object) -> None:
    first, second = (simulate("pendulum_track.c", pendulum, seconds=1.0,
        position=1.0) for _ in range(2))  # type: ignore[arg-type]
    assert np.array_equal(first.data, second.data) and first.names == second.names


def test_a_reference_fills_the_tables_and_the_arm_follows_it(tmp_path: Path) -> None:
    circle = make_circle(load_machine("imi_planar"), radius=0.1, duration=2.0)
    file = save_reference(circle, tmp_path / "circle.mat")
    rec = simulate(
        "inverse_dynamics.c",
        MODELS / "imi_planar.toml",
        reference=file,
        parameters={"compensate": True, "approach_time": 0.3},
    )
    assert "play_time" in rec and len(rec) == circle.samples + 800
    begun = int(np.argmax(rec["play_time"] >= -1e-9))
    assert np.abs(rec["r"][begun : begun + circle.samples] - circle.q).max() < 1e-9
    assert np.abs(rec["e"]).max() < 0.02
    through_pd = simulate("pd.c", MODELS / "imi_planar.toml", reference=file)
    assert through_pd.parameters["use_table"] is True, "pd.c follows its own circle unless told"


def test_channels_are_those_of_an_acquisition_and_more(pendulum: object) -> None:
    rec = simulate(program("a = READ_POSITION(0); v[1] = k;"), pendulum, seconds=0.1, position=0.5,
        decimation=5, channels=["a", "v[1]", "tick", "t", "enc",
            "plant_q"])  # type: ignore[arg-type]
    assert (
        len(rec) == 20 and rec["v[1]"][3] == 2.0 and rec["tick"].tolist() == list(range(0, 100, 5))
    )
    assert rec["enc"][0] == round(0.5 / 1.5339807879e-3) and rec["a"][0] == pytest.approx(
        0.5, abs=1e-3
    )
    assert (
        rec.parameters == {"k": 2.0, "whole": 1, "on": False, "v": [0.0, 2.0, 0.0]}
        and "p.c" in rec.sources
    )


def test_acquire_in_the_code_fixes_the_moment_of_the_row(pendulum: object) -> None:
    rec = simulate(program("a = 1.0; Acquire(); a = 2.0;"), pendulum,
        seconds=0.01)  # type: ignore[arg-type]
    assert np.all(rec["a"] == 1.0)


@pytest.mark.parametrize(("body", "words"), [
    ("if (SAMPLE_TICK == 7) a = READ_POSITION(1);", "names joint or channel [1]"),
    ("a = READ_POSITION(SAMPLE_TICK == 7 ? -1 : 0);", "names joint or channel [-1]"),
    ("WRITE_TORQUE((int)SAMPLE_TICK / 7 * 12, 0.0);", "names joint or channel [12]"),
    ("if (SAMPLE_TICK == 7) WRITE_TORQUE(2, 0.1);", "commands joint 3; pendulum has 1"),
])  # fmt: skip
def test_a_run_stops_at_the_sample_that_names_a_joint_that_is_not_there(
    body: str, words: str, pendulum: object
) -> None:
    rec = simulate(program(body), pendulum, seconds=0.1)  # type: ignore[arg-type]
    (said,) = rec.extra["simulation"]["beyond"]
    assert "stopped in sample 7 (0.007 s), where a target would stop the machine" in said
    assert words in said and len(rec) == 8


def test_a_run_that_names_joints_that_are_there_ends_with_its_time(pendulum: object) -> None:
    rec = simulate(program("a = READ_POSITION(0);"), pendulum, seconds=0.1)  # type: ignore[arg-type]
    assert len(rec) == 100 and not rec.extra["simulation"]["beyond"]


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("for (;;) ;", "sample 0"),
        ("if (SAMPLE_TICK == 77) *(volatile int *)0 = 1;", "sample 77"),
        ("if (SAMPLE_TICK == 5) __builtin_trap();", "sample 5"),
    ],
)
def test_code_that_hangs_or_crashes_ends_alone(body: str, words: str, pendulum: object) -> None:
    with pytest.raises(RunnerDied, match=words):
        simulate(program(body), pendulum, seconds=1.0, timeout=2.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(("declared", "said"), [
    ('const double k = 4; PARAMETER(k, 4.0, "", 0, 9, "");', "'k': it is const"),
    ('int32_t k; PARAMETER(k, 1.5, "", 0, 9, "");', "'k': initial value 1.5 is not a 32-bit int"),
    ('double k; PARAMETER(k, 12.0, "", 0, 9, "");', "'k': initial value 12 is outside its limits"),
])  # fmt: skip
def test_a_declaration_that_a_target_refuses_is_refused_here(
    declared: str, said: str, pendulum: object
) -> None:
    code = '#include "isr.h"\nvoid UserInit(void) { static ' + declared + " }\n"
    with pytest.raises(CompileFailed, match=said):
        simulate({"p.c": code + "void UserISR_INT2(void) {}\n"}, pendulum)  # type: ignore[arg-type]


def test_one_element_of_an_array_is_set_as_on_a_target() -> None:
    rec = simulate(
        {**program("a = k;")}, MODELS / "pendulum.toml", seconds=0.01,
        parameters={"v[1]": 3.0, "v[2]": 4.0},
    )
    assert rec.parameters["v"] == [0.0, 3.0, 4.0]


def test_what_is_wrong_is_said_as_a_target_says_it(pendulum: object) -> None:
    ok = program("a = k;")
    with pytest.raises(CompileFailed, match=r"p\.c:6:\d+: error"):
        simulate(program("a = b;"), pendulum)  # type: ignore[arg-type]
    for values, words in (
        ({"k": 9.0}, "outside 0 … 5 V"),
        ({"nope": 1}, "no such parameter"),
        ({"a": 1}, "a signal"),
        ({"whole": 0.5}, "whole number"),
        ({"v": [1, 2]}, "2 numbers given, it has 3"),
        ({"v[3]": 1.0}, r"v\[3\]: v has 3 elements, the first is 0"),
        ({"w[0]": 1.0}, r"w\[0\]: no such parameter"),
        ({"v[1,2]": 1.0}, r"no parameter 'v\[1,2\]': v has 3 rows of 1"),
        ({"v[1]": [1.0, 2.0]}, r"v\[1\]: 2 numbers given, it has 1"),
    ):
        with pytest.raises(VariableError, match=words):
            simulate(ok, pendulum, parameters=values)  # type: ignore[arg-type]
    with pytest.raises(AcquisitionError, match="no channel 'x'"):
        simulate(ok, pendulum, channels=["x"])  # type: ignore[arg-type]
    with pytest.raises(ReferenceError_, match="has 2 joints, pendulum has 1"):
        simulate("inverse_dynamics.c", pendulum,
            reference=make_circle(load_machine("imi_planar"), radius=0.1))  # type: ignore[arg-type]


def test_the_command_line_simulates_checks_the_step_and_writes(tmp_path: Path) -> None:
    out = tmp_path / "sim.npz"
    done = CliRunner().invoke(
        command,
        [
            "pd.c",
            "--model",
            str(MODELS / "imi_planar.toml"),
            "--seconds",
            "0.5",
            "--set",
            "radius=0.2",
            "--check",
            "--out",
            str(out),
        ],
    )
    assert done.exit_code == 0, done.output
    assert re.search(
        r"step check: settled at \d+ steps a sample; halving it changes positions by \S+ rad at the"
        r" most \(joint [12]\)",
        done.output,
    )
    assert Recording.load(out)["q"].shape == (500, 2)


@pytest.mark.parametrize("model", ["pendulum", "single_pendulum"])
def test_a_program_that_does_not_fit_the_machine_is_told_and_fails(model: str) -> None:
    done = CliRunner().invoke(command, ["pd.c", "--model", str(MODELS / f"{model}.toml")])
    assert done.exit_code == 1, done.output
    said = rf"joint or channel \[1\], counted from 0, and {model} has 1 joint\. Is it a program for"
    assert re.search(r"zendsp: stopped in sample 0 \(0 s\), .*" + said, done.output), done.output


@pytest.mark.parametrize(
    ("model", "line"),
    [
        # a motor of 0.8 N m
        ("pendulum", r"joint 1: a command of \S+ N m, the limit is 0\.8 N m \(first"),
        # without any limit the motion itself is what ends it
        ("single_pendulum", r"joint 1 ran away: -?\S+ rad after \d+ of 10000 samples"),
    ],
)
def test_gains_that_are_too_large_are_told(model: str, line: str) -> None:
    body = "WRITE_TORQUE(0, 400.0 * (READ_POSITION(0) + 0.01));"
    told = simulate(program(body), MODELS / f"{model}.toml").extra["simulation"]["beyond"]
    assert any(re.search(line, one) for one in told), told


def test_a_run_that_leaves_the_models_positions_says_where(tmp_path: Path) -> None:
    narrow = tmp_path / "narrow.toml"
    text = (MODELS / "imi_planar.toml").read_text()
    narrow.write_text(text + "\n[limits]\nposition = [-0.5, 0.5]\n")
    rec = simulate("pd.c", narrow, seconds=3.0)
    told = rec.extra["simulation"]["beyond"]
    assert len(told) == 1 and told[0].startswith("joint 2 leaves its limits: 0.9"), told
    assert "allowed -0.5 … 0.5 rad" in told[0] and "--position" in told[0]
    assert not simulate("pd.c", narrow, seconds=0.1).extra["simulation"]["beyond"]


def test_the_reference_of_another_machine_is_told_or_refused(tmp_path: Path) -> None:
    arm = str(MODELS / "imi_planar.toml")
    for machine, words in (
        ("wam7", "the reference was planned for wam7 and has 7 joints, imi_planar has 2"),
        ("other", "zendsp: the reference was planned for other, not for imi_planar: its limits"),
    ):
        joints = 7 if machine == "wam7" else 2
        file = tmp_path / f"{machine}.mat"
        save_reference(Reference(np.zeros((50, joints)), 0.001, machine=machine), file, check=False)
        done = CliRunner().invoke(command, ["pd.c", "--model", arm, "--reference", str(file)])
        assert words in f"{done.output}{done.exception}" and bool(done.exit_code) == (joints == 7)


def test_seven_joints_follow_under_gravity_compensation() -> None:
    from zendsp.reference import make_lspb

    start = np.array([0, 0.5, 0, 1.5, -1.5, 0, 0])
    goal = np.array([0.5, 0.0, 0.5, 2.0, -1.0, 0.5, 0.5])
    reference = make_lspb(
        load_machine("wam7"), start=start, goal=goal, duration=4.0, blend_time=1.0
    )
    rec = simulate("wam_pd_gravity.c", MODELS / "wam7.toml", reference=reference, check=True)
    assert rec.extra["step_check"]["converged"]
    assert np.abs(rec["e"]).max() < 0.06


def test_a_coarse_reference_is_played_at_its_own_rate() -> None:
    from zendsp.physics import simulate_loop
    from zendsp.reference import Reference

    coarse = Reference(np.column_stack([np.linspace(0.0, 0.5, 51), np.zeros(51)]), 0.02)
    rec = simulate(
        "inverse_dynamics.c", MODELS / "imi_planar.toml", reference=coarse,
        parameters={"approach_time": 0.2},
    )
    assert rec.parameters["row_rate"] == 50 and len(rec) == 200 + 1020 + 500
    assert rec["r"][700, 0] == pytest.approx(0.25, abs=1e-9)
    loop = simulate_loop(MODELS / "imi_planar.toml", coarse)
    assert len(loop) == 1001 and loop["r"][500, 0] == pytest.approx(0.25, abs=1e-9)
