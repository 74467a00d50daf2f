"""The C that compensates for what was found: it takes the effect out of the loop, fades, and says
what it leaves out.
"""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benches import MODELS, STRICT, effect, every_effect, rotary, two_joints

from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.report import files
from zendsp.physics import compensation, load_model, simulate
from zendsp.physics.codegen.compensation import compensates
from zendsp.physics.codegen.terms import compensable
from zendsp.physics.model import Actuator, Model, Quantity, Term
from zendsp.reference import Reference
from zendsp_isr.build import source_root

MOTION = (source_root() / "programs" / "motion.h").read_text()


def program(loop: str, compensation: str) -> dict[str, str]:
    return {"loop.c": loop, "motion.h": MOTION, "compensation.c": compensation}


LOOP = """#include "isr.h"
#define N 1
#include "motion.h"
#include "compensation.c"
static double tau[N];
void UserInit(void) { MotionInit(); CompensationInit(); SIGNAL(tau, "N m", ""); }
void UserISR_INT2(void) {
    MotionStep();
    tau[0] = 0.01 * rdd[0] + 20.0 * e[0] + 0.4 * (rd[0] - qd[0]);
    tau[0] += Compensation(0, r, rd, rdd, tau[0]); /* along the reference: it knows the reversals */
    WRITE_TORQUE(0, tau[0]);
}
void UserBackground(void) {}
"""


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("coulomb", {"level": 0.2}),
        ("gravity", {"torque": 0.5, "angle": 0.4}),
        ("stiffness", {"coefficient": 0.6, "neutral": 0.2}),
        ("ripple", {"order": 6.0, "amplitude": 0.2, "phase": 0.5}),
        ("torque_gain", {"ratio": -0.4}),
        ("dead_zone", {"width": 0.15}),
        ("quadratic_drag", {"coefficient": 0.05}),
        ("coulomb_asymmetry", {"level_pos": 0.1, "level_neg": 0.3}),
    ],
)
def test_compensation_takes_the_effect_out_of_the_loop(kind: str, values: dict[str, float]) -> None:
    model = rotary(effect(kind, **values))
    sources = program(LOOP, compensation(model.terms, actuator=model.actuator))
    t = 0.001 * np.arange(3000)
    reference = Reference((0.6 * np.sin(4.0 * t))[:, None], 0.001)
    error = {}
    for share in (0.0, 1.0):
        settings = {"comp_share": share, "approach_time": 0.2}
        rec = simulate(sources, model, reference=reference, parameters=settings)
        error[share] = float(np.sqrt(np.mean(rec["e"][700:3200] ** 2)))
    # what is left: a sign taken late, a sample of delay, quantised speed
    assert error[1.0] < 0.35 * error[0.0], error


FADING = """#include "isr.h"
#define N 1
#include "motion.h"
#undef TORQUE_MAX
#define TORQUE_MAX(ch) 4.0
#include "compensation.c"
static double added;
void UserInit(void) { MotionInit(); CompensationInit(); SIGNAL(added, "N m", ""); }
void UserISR_INT2(void) {
    const double still[N] = {0.0}, moving[N] = {1.0};
    MotionStep();
    if (SAMPLE_TICK == 500)
        comp_share = 0.0;
    if (SAMPLE_TICK == 1500)
        comp_share = 1.0;
    added = Compensation(0, still, moving, still, 0.0);
    (void)Compensation(0, still, moving, still, 0.0); /* a second joint's call moves nothing */
}
void UserBackground(void) {}
"""


@pytest.mark.parametrize(("level", "limit", "height"), [(1.0, 0.5, 1.0), (3.0, 0.5, 2.0)])
def test_compensation_fades_and_stays_within_its_limit(
    level: float, limit: float, height: float
) -> None:
    model = rotary(effect("coulomb", level=level))
    rec = simulate(
        program(FADING, compensation(model.terms)),
        model,
        seconds=2.2,
        channels=["added"],
        parameters={"comp_limit": limit, "comp_sign_speed": 0.0, "comp_fade": 0.5},
    )
    added = rec["added"]
    assert added[100] == pytest.approx(height), "there from the first sample, up to the limit"
    faded = np.minimum(level * np.clip(1.0 - np.arange(600) / 500.0, 0.0, 1.0), height)
    # a sample more or less: which one sees the new share is the loop's affair
    assert np.abs(added[500:1100] - faded).max() < 2.1 * level / 500.0
    assert np.abs(np.diff(added)).max() < 1.1 * level / 500.0, "no step anywhere"
    assert np.all(added[1010:1490] == 0.0) and added[2100] == pytest.approx(height)


UNDRIVEN = """#include "isr.h"
#include "compensation.c"
static double added, vel[2] = {1.0, 1.0};
void UserInit(void) { CompensationInit(); SIGNAL(added, "N m", ""); }
void UserISR_INT2(void) { added = Compensation(1, vel, vel, vel, 0.0); WRITE_TORQUE(0, 0.0); }
void UserBackground(void) {}
"""


def test_a_joint_without_a_motor_gets_no_torque_of_a_compensation() -> None:
    """Its limit was endless there, and the machine tripped: "to hinge, which has no motor"."""
    model = rotary(effect("coulomb", level=0.2))
    hinge = Term("coulomb", 2, {"level": Quantity(0.05)})
    for terms in ([hinge], model.terms):
        at = 1 if terms is not model.terms else 0
        loop = UNDRIVEN.replace("Compensation(1", f"Compensation({at}")
        files = {"loop.c": loop, "compensation.c": compensation(terms)}
        rec = simulate(files, model, seconds=0.1, channels=["added"])
        assert np.all((rec["added"] == 0.0) == (at == 1))


def test_what_a_torque_cannot_cancel_is_named_with_its_reason_and_valid_c_comes_out() -> None:
    terms = [t for t in every_effect() if not compensable(t)]
    assert {t.effect for t in terms} >= {
        "delay", "lag", "backlash", "elasticity", "presliding", "hysteresis", "saturation",
    }
    text = compensation(terms, title="a */ b", sentences=["Joint 1 lacks everything. */"])
    for term in terms:
        assert f"Not compensated: {term.effect} of joint 1 (" in text
    model = load_model(MODELS / "pendulum.toml")
    rec = simulate(program(LOOP, text), model, seconds=0.05, flags=STRICT)
    assert np.all(np.isfinite(rec["tau"]))


def test_a_compensation_without_a_torque_compensates_nothing() -> None:
    """``zendsp run`` said that the program adds its torque."""
    level = Term("coulomb", 1, {"level": Quantity(0.05)})
    lag = next(t for t in every_effect() if not compensable(t))
    for terms, does in (([level], True), ([lag], False), ([], False)):
        assert compensates(re.findall(r"PARAMETER\((comp_\w+)", compensation(terms))) is does
    assert not compensates(["Kp", "comp_level"]), "a user's own names"


def test_all_compensable_effects_together_compile_without_a_warning() -> None:
    terms = every_effect()
    text = compensation(
        [*terms, *[t for t in terms if t.effect == "ripple"]], actuator=Actuator(gain=(2.0,))
    )
    body = LOOP.replace("#define N 1", "#define N 2").replace(
        "tau[0] +=", "tau[1] = 0.0;\n    tau[0] +="
    )
    rec = simulate(program(body, text), two_joints(), seconds=0.02, flags=STRICT)
    assert "comp_ripple1_2_order" in rec.parameters and "comp_dead_zone1_width" in rec.parameters


def test_a_stribeck_term_alone_is_compensated_over_the_coulomb_level_of_its_model() -> None:
    friction = effect("coulomb", level=0.4), effect("stribeck", breakaway=0.7, velocity=0.02)
    mechanism = {"kind": "linear", "parameters": {"mass": 1.0}}
    model = rotary(*friction, name="axis", mechanism=mechanism, actuator={"unit": "V"})
    text = compensation([model.terms[1]], model=model, sentences=["Friction falls with speed."])
    assert (
        "comp_stribeck1_breakaway, 0.29999" in text
        and '"N"' in text
        and "physics found in axis" in text
        and "Friction falls" in text
    )
    assert "comp_coulomb1" not in text
    assert '"m/s", NO_MIN, NO_MAX, "speed over which dry friction' in text


def test_joint_pd_takes_a_compensation_that_lies_beside_it() -> None:
    model = rotary(effect("coulomb", level=0.2))
    programs = source_root() / "programs"
    own = (programs / "joint_pd.c").read_text()
    names = ("motion.h", "blocked.h", "reversal.h")
    beside = {name: (programs / name).read_text() for name in names}
    found = compensation(model.terms, actuator=model.actuator)
    error = {}
    for share in (0.0, 1.0):
        settings = {"comp_share": share, "amplitude": 0.4, "period": 2.0, "J": [0.01]}
        rec = simulate(
            {"joint_pd.c": own, **beside, "compensation.c": found}, model,
            seconds=6.0, parameters=settings,
        )  # fmt: skip
        error[share] = float(np.sqrt(np.mean(rec["e"][2500:] ** 2)))
    # its integral does a part of it; what is left: a sign taken late, a sample of delay
    assert error[1.0] < 0.5 * error[0.0], error


@pytest.mark.parametrize(
    ("name", "machine", "joint", "level"),
    [("wam_pd_gravity.c", "wam7", 4, 3.0), ("inverse_dynamics.c", "imi_planar", 2, 3.0)],
)
def test_the_programs_of_both_arms_take_a_compensation_too(
    name: str, machine: str, joint: int, level: float
) -> None:
    """Friction that the arm lacks in its model: found, it goes out of the tracking error."""
    model = load_model(MODELS / f"{machine}.toml")
    found = Term("coulomb", joint, {"level": Quantity(level)})
    rubbed = model.with_terms((*(t for t in model.terms if t.joint != joint), found))
    own = {
        file.name: file.read_text()
        for file in (source_root() / "programs").iterdir()
        if file.name in (name, "motion.h", "wam_gravity.h")
    }
    texts = {**own, "compensation.c": compensation([found], actuator=model.actuator)}
    t = 0.001 * np.arange(3000)
    rows = np.zeros((3000, model.joints))
    rows[:, joint - 1] = 1.0 + 0.3 * np.sin(2.5 * t)
    error = {}
    for share in (0.0, 1.0):
        rec = simulate(
            texts, rubbed, reference=Reference(rows, 0.001),
            parameters={"comp_share": share, "approach_time": 0.2},
        )  # fmt: skip
        error[share] = float(np.sqrt(np.mean(rec["e"][700:3200, joint - 1] ** 2)))
    # what is left: a sign taken late, a sample of delay
    assert error[1.0] < 0.4 * error[0.0], error


def test_where_a_command_is_no_torque_the_compensation_says_by_what_to_divide() -> None:
    terms = [Term("coulomb", 1, {"level": Quantity(0.05)})]
    assert "0.8 N m (N) per A: divide" in compensation(
        terms, actuator=Actuator(gain=(0.8,), unit="A")
    )
    assert "divide" not in compensation(terms, actuator=Actuator())


@pytest.mark.parametrize(("refinement", "offered"), [("coulomb", True), ("hysteresis", False)])
def test_no_code_is_offered_for_a_refinement_that_no_torque_cancels(
    refinement: str, offered: bool, tmp_path: Path
) -> None:
    """`model2c --effects-only` was to have it, and said "Not compensated" of it."""
    law = Term("viscous", 1, {"coefficient": Quantity(1.0)})
    report: Any = {
        "findings": [{"effect": "viscous", "joint": 1, "mechanism": "fluid_friction"}],
        "refinements": [{"effect": refinement, "joint": 1, "mechanism": "dry_friction"}],
    }
    model = Model("axis", None, "rotary", {}, terms=(law, Term(refinement, 1, {})))
    said = Finding("viscous", 1, {}, 0.97, 1.0, (), (), "", mechanism="fluid_friction")
    d: Any = SimpleNamespace(
        report=lambda: report, improved=model, findings=[said], refinements=[],
        notes=["joint 1: calibration moves coulomb level 5 to 11 N (+120 %)", "else"],
    )
    files._compensation(d, tmp_path)
    code = (tmp_path / "compensation.c").read_text()
    assert f"left out ({refinement})." in code
    assert ("--effects-only" in code) is offered
    said_of_it = " ".join(code.split())
    assert "gravity and inertia too, is left out as well; zendsp model2c" in said_of_it
    assert "Not compensated: joint 1: calibration moves coulomb level 5 to 11 N" in said_of_it


@pytest.mark.parametrize(("joint", "stands"), [(1, True), (2, False)])
def test_the_level_to_which_a_found_friction_falls_is_compensated_too(
    joint: int, stands: bool, tmp_path: Path
) -> None:
    # a gantry lacked 31 N at rest, 22 N in motion: the code had only the 9 N between them
    curve = {"breakaway": Quantity(31.0), "velocity": Quantity(0.02), "exponent": Quantity(2.0)}
    terms = (Term("coulomb", joint, {"level": Quantity(22.0)}), Term("stribeck", 1, curve))
    kinds: Any = [{"effect": "stribeck", "joint": 1, "mechanism": "dry_friction"}]
    level = {"effect": "coulomb", "joint": joint, "mechanism": "dry_friction"}
    report: Any = {"findings": kinds, "refinements": [level]}
    said = Finding("stribeck", 1, {}, 0.97, 1.0, (), (), "", mechanism="dry_friction")
    model = Model("axis", None, "linear", {}, terms=terms)
    d: Any = SimpleNamespace(
        report=lambda: report, improved=model, findings=[said], refinements=[],
        notes=["joint 1: calibration moves coulomb level 5 to 11 N (+120 %)", "else"],
    )
    files._compensation(d, tmp_path)
    code = (tmp_path / "compensation.c").read_text()
    assert (f"comp_coulomb{joint}_level, 22.0" in code) is stands
    assert ("What only refines the fit is left out (coulomb)" in code) is not stands
