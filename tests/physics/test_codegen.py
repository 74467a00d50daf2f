"""C made from models: the same torque as Python and Pinocchio, in a target and in a simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benches import MODELS, STRICT, every_effect, rotary, two_joints
from click.testing import CliRunner

from zendsp.cli.codegen import command
from zendsp.errors import ModelError
from zendsp.physics import (
    inverse_dynamics,
    library,
    load_effects,
    load_model,
    model_code,
    parse_model,
    simulate,
)
from zendsp.physics.codegen.terms import c_comment, compensable
from zendsp.physics.model import Model, Quantity, Term
from zendsp.physics.simulation.plant import Plant
from zendsp.physics.simulation.program import compile_program
from zendsp_isr.build import source_root
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime

PROBE = """#include "isr.h"
#include "model.c"
static double q[MODEL_JOINTS], qd[MODEL_JOINTS], qdd[MODEL_JOINTS], tau[MODEL_JOINTS], g[MODEL_JOINTS];
void UserInit(void) {
    ModelInit();
    SIGNAL(q, "rad", ""); SIGNAL(qd, "rad/s", ""); SIGNAL(qdd, "rad/s^2", ""); SIGNAL(tau, "N m", ""); SIGNAL(g, "N m", "");
}
void UserISR_INT2(void) {
    for (int j = 0; j < MODEL_JOINTS; j++) {
        q[j] = sin(3.0 * SAMPLE_TIME + j);
        qd[j] = 2.0 * cos(5.0 * SAMPLE_TIME + 2.0 * j);
        qdd[j] = 7.0 * sin(11.0 * SAMPLE_TIME + 3.0 * j);
    }
    ModelTorque(q, qd, qdd, tau);
    ModelGravity(q, g);
}
void UserBackground(void) {}
"""  # noqa: E501


def probe(model: Model) -> dict[str, str]:
    return {"probe.c": PROBE, "model.c": model_code(model)}


def wam_by_hand(q: Any, qd: Any, qdd: Any) -> Any:
    """Pinocchio and the friction of the model file, written out."""
    import pinocchio as pin

    robot = pin.buildModelFromUrdf(str(MODELS / "wam7.urdf"))
    data = robot.createData()
    tau = np.array([np.array(pin.rnea(robot, data, *row)) for row in zip(q, qd, qdd, strict=True)])
    for term in load_model(MODELS / "wam7.toml").terms:
        v = qd[:, term.joint - 1]
        pos, neg = (p.value for p in term.parameters.values())
        level = np.where(v > 0, pos, neg)
        tau[:, term.joint - 1] += level * (
            v if term.effect == "viscous_asymmetry" else np.tanh(v / 0.02)
        )
    return tau


def test_the_wam_in_c_is_pinocchio_plus_friction_to_1e_9_in_a_simulation_and_on_a_target() -> None:
    model = load_model(MODELS / "wam7.toml")
    sim = simulate(probe(model), model, seconds=0.3, flags=STRICT)
    assert np.abs(sim["tau"] - wam_by_hand(sim["q"], sim["qd"], sim["qdd"])).max() < 1e-9
    assert (
        np.abs(
            inverse_dynamics(model, sim["q"], sim["qd"], sim["qdd"], sign_speed=0.02) - sim["tau"]
        ).max()
        < 1e-9
    )
    with Runtime("wam7", clock="fast") as runtime:
        result = runtime.compile(probe(model), ("-Wall", "-Wextra"))
        assert result.ok and not result.diagnostics, result.diagnostics
        runtime.load(result.key)
        names = [f"{n}[{j}]" for n in ("q", "qd", "qdd", "tau") for j in range(7)]
        runtime.acquire_configure(0, AcquireConfig(tuple(names), seconds=0.2))
        runtime.acquire_start(0)
        runtime.start(ticks=205)
        runtime.wait_paused()
        q, qd, qdd, tau = np.split(runtime.acquire_read(0, 0, 200), 4, axis=1)
    assert np.abs(tau - wam_by_hand(q, qd, qdd)).max() < 1e-9


def test_c_of_a_tree_compiles_beside_a_motion_of_seven_joints() -> None:
    model = load_model(MODELS / "wam7.toml")
    head = "#define N 7\n#include \"motion.h\"\n#include \"model.h\"\n"
    user = "void UserInit(void) { MotionInit(); ModelInit(); }\n"
    isr = "void UserISR_INT2(void) { MotionStep(); double tau[N]; ModelTorque(r, rd, rdd, tau); }\n"
    text = f'#include "isr.h"\n{head}{user}{isr}void UserBackground(void) {{}}\n'
    motion = source_root() / "programs" / "motion.h"
    files = {"all.c": text, "motion.h": motion.read_text(), "model.h": model_code(model)}
    compile_program(files, ("-DF=1",))  # N and F are the user's names


def test_a_payload_and_a_tilted_base_are_in_the_c_of_the_wam() -> None:
    import pinocchio as pin

    carried = {"mass": 2.0, "com_x": 0.01, "com_y": -0.03, "com_z": 0.12, "inertia": 0.004}
    found = {"payload": (7, carried), "base_tilt": (1, {"angle_x": 0.1, "angle_y": -0.05})}
    terms = [
        Term(name, j, {k: Quantity(v) for k, v in values.items()})
        for name, (j, values) in found.items()
    ]
    model = load_model(MODELS / "wam7.toml").with_terms(tuple(terms))
    sim = simulate(probe(model), model, seconds=0.3, flags=STRICT)
    robot = pin.buildModelFromUrdf(str(MODELS / "wam7.urdf"))
    robot.inertias[7] += pin.Inertia(2.0, np.array([0.01, -0.03, 0.12]), 0.004 * np.eye(3))
    turn = pin.utils.rpyToMatrix(0.1, -0.05, 0.0)  # about x, then about y
    robot.gravity.linear = turn @ robot.gravity.linear
    data = robot.createData()
    rows = zip(sim["q"], sim["qd"], sim["qdd"], strict=True)
    assert np.abs(sim["tau"] - [pin.rnea(robot, data, *row) for row in rows]).max() < 1e-9
    assert (
        np.abs(sim["g"] - [pin.computeGeneralizedGravity(robot, data, q) for q in sim["q"]]).max()
        < 1e-9
    )
    assert "Not in it" not in model_code(model)


@pytest.mark.parametrize(("mass", "aside"), [(0.0, 0.0), (3.0, 0.0), (3.0, -0.05)])
def test_the_planar_arm_in_c_is_its_equation(mass: float, aside: float) -> None:
    """With a load of link 2, in a simulation too: it may lie beside the link's line."""
    model = load_model(MODELS / "imi_planar.toml")
    carried = {"mass": mass, "com_x": 0.25, "com_y": aside, "com_z": 0.0, "inertia": 0.0}
    load = Term("payload", 2, {k: Quantity(v) for k, v in carried.items()})
    model = model.with_terms((*model.terms, *([load] if mass else [])))
    rec = simulate(probe(model), model, seconds=0.5, flags=STRICT)
    (_q1, q2), (v1, v2), (a1, a2) = rec["q"].T, rec["qd"].T, rec["qdd"].T
    p3, beside, away = 0.242 + mass * 0.36 * 0.25, mass * 0.36 * aside, 0.25**2 + aside**2
    p1, p2 = 3.473 + mass * (0.36**2 + away), 0.196 + mass * away
    c, s = (p3 * np.cos(q2) - beside * np.sin(q2), p3 * np.sin(q2) + beside * np.cos(q2))
    first = (
        (p1 + 2 * c) * a1
        + (p2 + c) * a2
        - s * v2 * (2 * v1 + v2)
        + 5.3 * v1
        + 8.45 * np.tanh(v1 / 0.02)
    )
    second = (p2 + c) * a1 + p2 * a2 + s * v1**2 + 1.1 * v2 + 2.35 * np.tanh(v2 / 0.02)
    assert np.abs(rec["tau"] - np.stack([first, second], axis=1)).max() < 1e-9 and np.all(
        rec["g"] == 0
    )


def test_a_load_beside_the_line_of_a_planar_arm_moves_it_as_its_equation_says() -> None:
    model = load_model(MODELS / "imi_planar.toml")
    carried = {"mass": 3.0, "com_x": 0.25, "com_y": 0.05, "com_z": 0.0, "inertia": 0.0}
    load = Term("payload", 2, {k: Quantity(v) for k, v in carried.items()})
    plant = Plant(model.with_terms((load,)), 400, position=[0.2, 0.5], velocity=[1.0, -2.0])
    pushed, rows = np.array([3.0, 1.0]), []
    for _ in range(400):
        rows.append(np.stack(plant.truth()[:2]))
        plant.advance(pushed)
    (q, v), dt = np.stack(rows, axis=1), model.sample_time
    (a1, a2), (v1, v2), q2 = ((v[2:] - v[:-2]) / (2 * dt)).T, v[1:-1].T, q[1:-1, 1]
    p3, beside, away = 0.242 + 3.0 * 0.36 * 0.25, 3.0 * 0.36 * 0.05, 0.25**2 + 0.05**2
    p1, p2 = 3.473 + 3.0 * (0.36**2 + away), 0.196 + 3.0 * away
    c, s = (p3 * np.cos(q2) - beside * np.sin(q2), p3 * np.sin(q2) + beside * np.cos(q2))
    first = (p1 + 2 * c) * a1 + (p2 + c) * a2 - s * v2 * (2 * v1 + v2)
    second = (p2 + c) * a1 + p2 * a2 + s * v1**2
    late = 5  # samples until the command acts: see [actuator] delay
    assert np.stack([first, second], axis=1)[late:] == pytest.approx(
        np.tile(pushed, (len(first) - late, 1)), abs=1e-4
    )


def test_numbers_are_parameters_that_change_the_torque_while_it_runs() -> None:
    model = load_model(MODELS / "pendulum.toml")
    plain = simulate(probe(model), model, seconds=0.2)
    heavy = simulate(
        probe(model),
        model,
        seconds=0.2,
        parameters={"model_inertia1": 0.01, "model_coulomb1_level": 0.0},
    )
    expected = (0.01 - 2.07e-3) * plain["qdd"] - 0.1 * np.tanh(plain["qd"] / 0.02)
    assert np.abs(heavy["tau"] - plain["tau"] - expected).max() < 1e-12


def _friction_block(p: dict[str, float], speed: np.ndarray) -> np.ndarray:
    v, s = np.abs(speed), p["split"]
    w = v - s
    low = p["level"] + p["slope"] * v + p["curve"] * v**2 + p["cubic"] / s * v**3
    edge = p["level"] + p["slope"] * s + (p["curve"] + p["cubic"]) * s**2
    high = (
        edge + (p["slope"] + 2 * p["curve"] * s + 3 * p["cubic"] * s) * w + p["high_curve"] * w**2
    )
    return np.where(w <= 0, low, high)


LAWS = {  # p: parameters; s: the smooth sign of the speed; joint 1 of two, over the other's speed

    "friction_block": lambda p, q, qd, qdd, s, _: _friction_block(p, qd) * s,
    "viscous": lambda p, q, qd, qdd, s, _: p["coefficient"] * qd,
    "viscous_asymmetry": (
        lambda p, q, qd, qdd, s, _: qd
        * np.where(qd > 0, p["coefficient_pos"], p["coefficient_neg"])
    ),
    "coulomb": lambda p, q, qd, qdd, s, _: p["level"] * s,
    "coulomb_asymmetry": (
        lambda p, q, qd, qdd, s, _: np.where(qd > 0, p["level_pos"], p["level_neg"]) * s
    ),
    "coulomb_tanh": lambda p, q, qd, qdd, s, _: p["level"] * np.tanh(qd / p["speed"]),
    "stribeck": (
        lambda p, q, qd, qdd, s, _: p["breakaway"]
        * np.exp(-((np.abs(qd) / p["velocity"]) ** p.get("exponent", 2.0)))
        * s
    ),
    "position_friction": (
        lambda p, q, qd, qdd, s, _: p["amplitude"]
        * np.sin(2 * np.pi * q / p["period"] + p["phase"])
        * s
    ),
    "quadratic_drag": lambda p, q, qd, qdd, s, _: p["coefficient"] * qd * np.abs(qd),
    "gravity": lambda p, q, qd, qdd, s, _: p["torque"] * np.sin(q - p["angle"]),
    "stiffness": lambda p, q, qd, qdd, s, _: p["coefficient"] * (q - p["neutral"]),
    "cubic_stiffness": lambda p, q, qd, qdd, s, _: p["coefficient"] * (q - p["neutral"]) ** 3,
    "ripple": lambda p, q, qd, qdd, s, _: p["amplitude"] * np.sin(p["order"] * q + p["phase"]),
    "torque_offset": lambda p, q, qd, qdd, s, _: np.full_like(q, p["level"]),
    "inertia": lambda p, q, qd, qdd, s, _: p["amount"] * qdd,
    "coupling": lambda p, q, qd, qdd, s, other: p["coefficient"] * other**2,  # law 1
}


def test_every_effect_that_has_c_is_its_law_in_a_program_and_in_python() -> None:
    """Each effect alone; those of actuator and load need a command and are checked below."""
    checked = []
    for term in every_effect():
        if not compensable(term) or term.effect in ("torque_gain", "dead_zone", "load_friction"):
            continue
        model = two_joints().with_terms((term,))
        rec = simulate(probe(model), model, seconds=0.4)
        motion = q, v, a = rec["q"], rec["qd"], rec["qdd"]
        numbers = {p.name: term.value(p.name) for p in library()[term.effect].parameters}
        sign = np.tanh(v[:, 0] / 0.02)
        law = LAWS[term.effect](numbers, q[:, 0], v[:, 0], a[:, 0], sign, v[:, 1])
        assert np.abs(law).max() > 1e-3, f"{term.effect}: the test has power"
        expected = np.array([0.01, 0.02]) * a
        expected[:, 0] += law
        assert np.abs(rec["tau"] - expected).max() < 1e-9, term.effect
        assert np.abs(inverse_dynamics(model, *motion, sign_speed=0.02) - expected).max() < 1e-9
        checked.append(term.effect)
    assert set(checked) == set(LAWS)


def test_an_effect_of_ones_own_is_in_the_torque_of_a_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "air.py"
    path.write_text(
        "from zendsp.physics.effects import Effect, Parameter\n"
        "EFFECT = Effect(name='air', site='torque', parameters=(Parameter('size', 'torque'),),\n"
        "    c='return p[0] * s->qd * s->qd;', sentence='{size}', experiment='move',\n"
        "    compensable='p[0] * qd * qd')\n"
    )
    monkeypatch.setattr("zendsp.physics.effects.catalogue._extra", {})
    load_effects(path)
    model = rotary().with_terms((Term("air", 1, {"size": Quantity(0.5)}),))
    assert inverse_dynamics(model, [0.0], [3.0], [0.0]) == pytest.approx([4.5])


def test_a_name_neither_ends_the_comment_nor_reaches_the_terminal() -> None:
    text = c_comment("arm */ int evil; /* \x1b[2J")
    assert text == "/* arm * / int evil; / * \\x1b[2J"


def test_a_python_model_has_no_c() -> None:
    with pytest.raises(ModelError, match="python"):
        model_code(
            parse_model({"sample_time": 0.001, "mechanism": {"kind": "python", "entry": "m:f"}})
        )


def test_model2c_writes_what_the_function_gives(tmp_path: Path) -> None:
    out = tmp_path / "model.c"
    done = CliRunner().invoke(command, [str(MODELS / "imi_planar.toml"), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert out.read_text() == model_code(load_model(MODELS / "imi_planar.toml"))
    other = tmp_path / "arm.c"
    CliRunner().invoke(command, [str(MODELS / "imi_planar.toml"), "--out", str(other)])
    assert '#include "arm.c"' in other.read_text() and '"model.c"' not in other.read_text()
    shown = CliRunner().invoke(command, [str(MODELS / "imi_planar.toml"), "--effects-only"])
    assert "Compensation(int32_t joint" in shown.output and "comp_coulomb2_level" in shown.output
