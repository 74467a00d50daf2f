"""The proof over the link: a target conceals physics, the host diagnoses it over Zenoh, and only
then asks for the truth.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from matplotlib.figure import Figure
from story_cases import Answer, live_case
from waiting import PATIENCE_S

import zendsp
from zendsp.demo.controller import not_cancelled, plan_update, slots, sources
from zendsp.demo.evidence import Judged, compare_tracking, judge
from zendsp.demo.narrator import Narrator
from zendsp.demo.picture import FOUND, _error, _missing, _position
from zendsp.demo.run import concealment
from zendsp.demo.runs import prepare_machine
from zendsp.demo.stage import get_stage, nominal_model
from zendsp.demo.story import Recorded, Told, _named_beside, _within_limits
from zendsp.diagnosis import Diagnosis
from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.measure.where import Missing
from zendsp.errors import Refused
from zendsp.experiment.separating import run_reference
from zendsp.link import Target
from zendsp.link.concealed import TrueEffect
from zendsp.physics.model import Quantity, Term
from zendsp.recording import Recording
from zendsp.reference import Reference

SEEDS = range(1, 4)  # the first three: fixed before the first run, none was left out
# Everything that a target draws by name, but for what the given model has itself (calibration finds
# it, nothing is missing), and what saturates the drive so that the machine trips.
POOL = (
    "viscous_asymmetry/coulomb_asymmetry/stribeck/presliding/quadratic_drag/load_friction/position_friction/friction_drift/stiffness/"
    "elasticity/backlash/hysteresis/ripple/torque_gain/torque_offset/dead_zone/lag/delay/encoder_eccentricity"
)


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Answer]:
    folder = tmp_path_factory.mktemp("missed")
    return cache(lambda seed: live_case(seed, POOL, folder))


@pytest.mark.timeout(300)  # some seconds of CPU, on machines that may be busy with everything else
@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(s, marks=pytest.mark.long("as the first")) for s in SEEDS[1:])]
)
def test_a_concealed_effect_is_diagnosed_over_the_link_and_revealed_after(
    seed: int, answer: Callable[[int], Answer]
) -> None:
    came = answer(seed)
    assert came.sealed_before and len(came.truth.effects) == 1
    held = came.diagnosis.heldout
    if came.diagnosis.findings:  # what is claimed must predict data that it has not seen
        assert held.improved < held.calibrated, came.line()
    else:
        assert came.diagnosis.verdict in ("complete", "unexplained")


@pytest.mark.long("prove counts it of more cases; lost: of those that a target draws")
@pytest.mark.timeout(600)  # where it is run alone, it makes all
def test_most_seeds_are_named_right_and_wrong_answers_are_not_confident(
    answer: Callable[[int], Answer],
) -> None:
    answers = [answer(seed) for seed in SEEDS]
    lines = "\n".join(a.line() for a in answers)
    right = sum(a.named for a in answers)
    confident_and_wrong = [a for a in answers if not a.named and a.confident > 0.9]
    # Measured of the first ten: seven; two drifts of friction are called unexplained, one backlash
    # within the noise of the encoder is not seen.
    assert right >= 2, lines
    assert len(confident_and_wrong) <= 1, lines


def test_the_host_cannot_know_what_the_target_draws(tmp_path: Path) -> None:
    spec = concealment(get_stage("imi_planar").pool, None, None)
    assert spec.startswith("seed:random,") and spec.count("/") >= 5
    with zendsp.local("imi_planar", clock="fast", options=["--concealed", spec]) as one, \
         zendsp.local("imi_planar", clock="fast", options=["--concealed", spec]) as two:
        assert one.seal() != two.seal()
        assert one.reveal().source != two.reveal().source  # 2^31 seeds: equal once in a lifetime


def test_the_control_program_with_every_effect_at_zero_changes_no_command() -> None:
    stage = get_stage("imi_planar")
    motion = _swing(2, 0.3)
    with zendsp.local("imi_planar", clock="fast") as target:
        machine, _ = prepare_machine(target, stage)
        target.load(machine.key)
        names = target.variables()
        recording = machine.run(motion, "nothing found")
    assert all(
        any(name.startswith(f"comp_{t.effect}{t.joint}") for name in names) for t in slots(2)
    )
    assert not recording["tau_comp"].any() and np.isfinite(recording["tau"]).all()
    assert np.abs(recording["e"][1000:2000]).max() < 0.02


def test_an_update_carries_the_improved_model_into_the_running_program() -> None:
    stage = get_stage("pendulum")
    given = nominal_model(stage, (651.9,), 0.001)
    kept = [t for t in given.terms if t.effect != "viscous"]
    found = Term("quadratic_drag", 1, {"coefficient": Quantity(0.004)})
    lagging = Term("lag", 1, {"time_constant": Quantity(0.01)})
    improved = given.with_terms((*kept, found, lagging))
    names = [
        f"model_{key}" for key in ("viscous1_coefficient", "coulomb1_level", "inertia1", "gravity1")
    ]
    names += ["comp_quadratic_drag1_coefficient", "comp_lag1_time_constant"]
    update = plan_update(given, improved, names)
    assert update.values["comp_quadratic_drag1_coefficient"] == 0.004 and update.joints == (1,)
    assert update.values["model_viscous1_coefficient"] == 0.0  # replaced
    assert update.values["model_coulomb1_level"] == 0.1
    assert update.left_out == (lagging,)
    lag, other = (SimpleNamespace(effect=name, joint=1) for name in ("lag", "quadratic_drag"))
    assert not_cancelled(update, [lag, other])[0].startswith("lag of joint 1: ")  # type: ignore[list-item]
    assert not_cancelled(update, [other]) == ()  # type: ignore[list-item]
    assert "comp_quadratic_drag1_coefficient" in sources(given)["compensation.h"]


def test_a_payload_goes_into_the_numbers_of_an_arm_that_has_no_links() -> None:
    from zendsp.demo.controller import bearing

    stage = get_stage("imi_planar")
    given = nominal_model(stage, (4e-5, 4e-5), 0.001)
    numbers = {"mass": 2.0, "com_x": 0.25, "com_y": 0.0, "com_z": 0.0, "inertia": 0.0}
    load = Term("payload", 2, {name: Quantity(value) for name, value in numbers.items()})
    improved = given.with_terms((*given.terms, load))
    update = plan_update(given, improved, ["model_p1", "model_p2", "model_p3"])
    more = {"model_p1": 2.0 * (0.36**2 + 0.25**2), "model_p2": 0.125, "model_p3": 2.0 * 0.36 * 0.25}
    for name, value in more.items():
        bare = given.mechanism[name.removeprefix("model_")][0].value
        assert update.values[name] == pytest.approx(bare + value)
    assert not update.left_out
    assert 2 in bearing(given, improved, stage.work(stage.plan), stage.Kp)


def test_a_synchronous_update_of_the_true_physics_lowers_the_tracking_error() -> None:
    from zendsp.demo.evidence import compare_tracking

    stage = get_stage("imi_planar")
    with zendsp.local(
        "imi_planar",
        clock="fast",
        options=["--concealed", "seed:3,effect=stiffness,joint=2,friction=plain"],
    ) as target:
        machine, _ = prepare_machine(target, stage)
        truth = target.reveal().effects[0]  # here the diagnosis is taken as perfect
        machine.target.load(machine.key)
        numbers = {name: Quantity(p["value"]) for name, p in truth["parameters"].items()}
        improved = machine.model.with_terms((*machine.model.terms, Term("stiffness", 2, numbers)))
        update = plan_update(machine.model, improved, target.variables())
        work = machine.run(stage.work(stage.plan), "half-way", (7.0, update.values))
    ticks = {change.tick for change in work.log if change.tick > 0}
    assert ticks == {7000}
    tracking = compare_tracking(work, 7000, 2.0, 12.5)
    # A spring of some N m/rad against a gain of 300 N m/rad leaves mrad; what remains without it is
    # the lag of the loop.
    assert tracking.after[1] < 0.3 * tracking.before[1] and tracking.fell([2])


@pytest.mark.long("a spring is taken up by two joints above; lost: a body, by seven")
def test_the_true_payload_is_taken_up_while_the_seven_joint_arm_moves(tmp_path: Path) -> None:
    from zendsp.demo.controller import bearing
    from zendsp.demo.evidence import compare_tracking, in_model_frame

    stage = get_stage("wam7")
    spec = concealment(stage.pool, None, 1)
    with zendsp.local("wam7", clock="fast", options=["--concealed", spec]) as target:
        machine, _ = prepare_machine(target, stage, tmp_path)
        truth = in_model_frame(target.reveal().effects[0], stage.plan)
        numbers = {name: Quantity(p["value"]) for name, p in truth["parameters"].items()}
        improved = machine.model.with_terms((*machine.model.terms, Term("payload", 7, numbers)))
        machine.target.load(machine.key)
        update = plan_update(machine.model, improved, target.variables())
        whole = stage.work(stage.plan)
        work = machine.run(whole, "half-way", (6.0, update.values))
    joints = bearing(machine.model, improved, whole, stage.Kp)
    tracking = compare_tracking(work, 6000, 4.0, 8.5)
    assert set(joints) >= {4, 6, 7} and not update.left_out
    # `zendsp demo --machine wam7 --seed 1` left 2 to 8 % over twice the time, the swing of the
    # exchange included.
    assert all(tracking.after[j - 1] < 0.3 * tracking.before[j - 1] for j in joints), tracking


def test_an_asymmetry_is_compared_as_the_sum_that_the_machine_has() -> None:
    from types import SimpleNamespace

    from zendsp.demo.story import compared
    from zendsp.diagnosis import Estimate, Finding

    given = nominal_model(get_stage("pendulum"), (651.9,), 0.001)  # viscous 0.005 N m s/rad
    improved = given.with_terms(tuple(t for t in given.terms if t.effect != "viscous"))
    numbers = {"coefficient_pos": Estimate(0.011, 1e-5, "N m s/rad")}
    finding = Finding("viscous_asymmetry", 1, numbers, 0.9, 0.8, (), ("viscous",), "")
    diagnosis = cast(
        Diagnosis,
        SimpleNamespace(
            findings=(finding,), verdict="missing", given=given, calibrated=given, improved=improved
        ),
    )
    truth = {
        "effect": "viscous_asymmetry",
        "joint": 1,
        "parameters": {"coefficient_pos": {"value": 0.006, "unit": "N m s/rad"}},
    }
    (row,) = judge(diagnosis, [truth]).parameters
    assert row == ("coefficient_pos", 0.011, 1e-5, pytest.approx(0.011), "N m s/rad", 0.005)
    assert compared(*row).endswith(
        "true 0.011 N m s/rad: the concealed 0.006 and the given model's 0.005"
    )


@pytest.mark.parametrize(("level", "right"), [(0.148, True), (0.1, False), (0.16, False)])
def test_what_calibration_took_up_is_found_where_all_of_it_was_taken_up(
    level: float, right: bool
) -> None:
    given = nominal_model(get_stage("pendulum"), (651.9,), 0.001)  # Coulomb friction of 0.1 N m
    fitted = Term("coulomb", 1, {"level": Quantity(level, std=1e-4)})
    terms = [fitted if t.effect == "coulomb" else t for t in given.terms]
    calibrated = given.with_terms(tuple(terms))
    diagnosis = cast(
        Diagnosis,
        SimpleNamespace(
            findings=(), verdict="complete", given=given, calibrated=calibrated, improved=calibrated
        ),
    )
    truth: TrueEffect = {
        "effect": "coulomb", "joint": 1, "parameters": {"level": {"value": 0.048, "unit": "N m"}},
    }  # fmt: skip
    judged = judge(diagnosis, [truth])
    assert judged.named is judged.exact is right
    assert bool(judged.parameters) is right
    told = Told(cast(Recorded, None), diagnosis)
    assert [r.effect for r in told.refits] == (["coulomb"] if level != 0.1 else [])


def test_a_disturbance_is_no_concealed_effect_and_ends_no_story() -> None:
    given = nominal_model(get_stage("pendulum"), (651.9,), 0.001)
    finding = Finding("disturbance", 1, {}, 0.85, 0.5, (), (), "")
    diagnosis = cast(
        Diagnosis,
        SimpleNamespace(
            findings=(finding,), verdict="missing", given=given, calibrated=given, improved=given
        ),
    )
    truth: TrueEffect = {
        "effect": "coulomb", "joint": 1, "parameters": {"level": {"value": 0.05, "unit": "N m"}},
    }  # fmt: skip
    judged = judge(diagnosis, [truth])
    assert not judged.named and judged.extra == (finding,)


@pytest.mark.parametrize(
    ("effect", "verdict", "right"),
    [("unknown", "missing", True), ("", "unexplained", True), ("", "complete", False),
     ("stiffness", "missing", False)],
)  # fmt: skip
def test_a_concealed_torque_without_a_law_is_found_where_none_is_claimed(
    effect: str, verdict: str, right: bool
) -> None:
    """The story said of 'depends on the position, no law': not found."""
    given = nominal_model(get_stage("pendulum"), (651.9,), 0.001)
    findings = (Finding(effect, 1, {}, 0.93, 0.5, (), (), ""),) if effect else ()
    diagnosis = cast(
        Diagnosis,
        SimpleNamespace(
            findings=findings, verdict=verdict, given=given, calibrated=given, improved=given
        ),
    )
    truth: TrueEffect = {"effect": "foreign", "joint": 1, "parameters": {}}
    judged = judge(diagnosis, [truth])
    assert judged.named is right and not judged.exact
    assert bool(judged.extra) is (effect == "stiffness")


def test_what_was_found_is_told_with_what_it_cannot_be_told_from() -> None:
    """The picture of a true story said: concealed coulomb asymmetry, found torque offset."""
    finding = Finding("torque_offset", 1, {}, 0.97, 0.5, ("coulomb_asymmetry",), (), "")
    diagnosis = cast(Diagnosis, SimpleNamespace(findings=(finding,)))
    told = Told(cast(Recorded, None), diagnosis)
    assert told.found == "torque offset or coulomb asymmetry on joint 1"


def test_a_machine_without_a_story_is_named() -> None:
    with pytest.raises(Refused, match=r"ur5.*imi_planar, pendulum, wam7"):
        get_stage("ur5")


def test_a_quiet_narrator_keeps_its_lines(capsys: pytest.CaptureFixture[str]) -> None:
    narrator = Narrator(quiet=True)
    with narrator.step("something"):
        narrator.say("[rad] stays", good=True)
    assert narrator.said == ["[rad] stays"] and capsys.readouterr().out == ""
    Narrator().say("[rad] stays", good=True)
    assert "[rad] stays" in capsys.readouterr().out


def _swing(joints: int, size: float) -> Reference:
    t = np.linspace(0.0, 1.0, 1001)
    return Reference(
        np.outer(size * np.sin(np.pi * t) ** 2, np.ones(joints)), 0.001, kind="separating"
    )


def test_a_proposed_reference_is_played_and_recorded_under_the_names_of_the_model(
    fast: Target,
) -> None:
    model = nominal_model(get_stage("imi_planar"), (24446.2, 24446.2), 0.001)
    fast.download("pd.c")
    made = run_reference(fast, _swing(2, 0.4), model)
    # pd.c has no vector r: the reference is optional
    assert made.names == ("q", "tau") and made.lost == 0
    assert abs(made["q"].max() - 0.4) < 0.02
    assert fast["use_table"] == 0  # as before


@pytest.mark.long("others load programs; lost: a recording's")
def test_an_empty_target_gets_the_program_of_the_first_recording(
    start: Callable[..., Target],
) -> None:
    stage = get_stage("imi_planar")
    first = start(clock="fast")
    machine, _ = prepare_machine(first, stage)
    earlier = machine.run(_swing(2, 0.2), "first")
    second = start(clock="fast")
    made = run_reference(second, _swing(2, 0.4), machine.model, earlier)
    assert made["q"][:, 0].max() > 0.39 and made.parameters["Kp"] == earlier.parameters["Kp"]


def test_a_reference_is_refused_with_the_reason_where_it_cannot_be_played(fast: Target) -> None:
    model = nominal_model(get_stage("imi_planar"), (24446.2, 24446.2), 0.001)
    with pytest.raises(Refused, match="no program that follows a table 'ref' of 2 columns"):
        run_reference(fast, _swing(2, 0.4), model)
    fast.download("pd.c")
    with pytest.raises(Refused, match=r"joint 1 to .* 2\.5 rad; the target allows -2\.15 … 2\.15"):
        run_reference(fast, _swing(2, 2.5), model)


def test_the_picture_is_scaled_by_what_it_draws() -> None:
    """Torques where the recording hardly determines them are not drawn and do not set the scale."""
    t = np.arange(4000) / 500.0
    q, v = np.sin(t), np.cos(t)
    torque, std = np.sign(v) * np.sin(5 * q), np.full(4000, 0.02)
    torque[::100], std[::100] = 60.0, 1e3
    variables = {"position": q, "velocity": v, "acceleration": -q, "command": torque}
    parts = {1: [Missing(t, torque, std, variables)]}
    found = Finding(
        "position_friction", 1, {}, 0.9, 1.0, (), (), "", {}, mechanism="dry_friction"
    )
    told = SimpleNamespace(
        tracking=None,
        diagnosis=SimpleNamespace(findings=[found], missing=parts, remaining=parts, unit="rad"),
    )
    axis = Figure().add_subplot()
    _missing(axis, told, 1)  # type: ignore[arg-type]
    low, high = axis.get_ylim()
    assert -2 < low < -1 and 1 < high < 2
    line = axis.get_lines()[2]  # dots, their colour in the legend, the curve: of one direction
    apart = np.asarray(line.get_ydata()) - np.sin(5 * np.asarray(line.get_xdata()))
    assert line.get_lw() > 1 and np.median(np.abs(apart)) < 0.1


@pytest.mark.parametrize("far", [1.6, 1e6])
def test_the_picture_shows_a_simulation_that_goes_farther_beneath_its_legend(far: float) -> None:
    """That of a pendulum that its spring held back ran through the legend. One that runs away does
    not make the machine's motion a flat line.
    """
    t = np.arange(1000) / 500.0
    q = np.sin(2 * np.pi * t)

    class Rows(dict[str, np.ndarray]):
        sample_time = 0.002

        def __len__(self) -> int:
            return len(t)

    hidden = SimpleNamespace(position=np.array([0.3]), hides=lambda joint: False)
    recorded = SimpleNamespace(train=Rows(q=q), simulated=Rows(q=far * q), hidden=hidden)
    axis = Figure().add_subplot()
    _position(axis, SimpleNamespace(recorded=recorded, diagnosis=SimpleNamespace(unit="rad")), 1)  # type: ignore[arg-type]
    low, high = axis.get_ylim()
    assert low < -min(far, 3.0) and min(far, 3.0) + 0.3 * min(2.0 * far, 6.0) < high < 6.0


def test_the_picture_colours_the_errors_that_its_number_counts() -> None:
    """The half second in which a loop settles after the update was drawn as counted: 20 mrad above
    "0.41 mrad RMS".
    """
    t = np.arange(4000) * 0.001
    e = np.where((t > 2.0) & (t < 2.3), 0.02, 0.001)[:, None]

    class Rows(dict[str, np.ndarray]):
        sample_time, start_tick = 0.001, 0

        def __len__(self) -> int:
            return len(t)

    work = cast(Recording, Rows(e=e))
    tracking = compare_tracking(work, 2000, 0.5, 3.8)
    diagnosis = SimpleNamespace(unit="rad")
    told = SimpleNamespace(work=work, tracking=tracking, compensated=(1,), diagnosis=diagnosis)
    axis = Figure().add_subplot()
    _error(axis, told, 1)  # type: ignore[arg-type]
    (line,) = [line for line in axis.get_lines() if line.get_color() == FOUND]
    drawn = np.asarray(line.get_ydata())
    counted = drawn[np.isfinite(drawn)]
    assert np.sqrt(np.mean(counted**2)) == pytest.approx(1e3 * tracking.after[0])


def test_run_needs_a_folder_for_the_new_recording() -> None:
    import subprocess

    command = [
        sys.executable, "-c", "from zendsp.cli import main; main()", "diagnose", "a.csv",
        "--model", "m.toml", "--run", "imi",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 2 and "--run needs --out" in done.stderr


@pytest.mark.parametrize(("limit", "size"), [(2.0, 1.0), (0.7, 0.6), (0.1, None)])
def test_a_proposed_motion_is_played_as_large_as_the_machine_may(
    limit: float, size: float | None
) -> None:
    """A chirp of 151 rad/s² had been proposed to an arm limited to 140, so that nothing was played.
    """

    def violations(motion: Reference) -> list[str]:
        return ["too far"] if np.abs(motion.q - 0.2).max() > limit else []

    plan = SimpleNamespace(find_violations=violations)
    machine = SimpleNamespace(stage=SimpleNamespace(plan=plan, machine="pendulum"))
    q = 0.2 + np.sin(np.linspace(0.0, 2 * np.pi, 1001))[:, None]
    played = _within_limits(machine, q, 0.001, Narrator(quiet=True))  # type: ignore[arg-type]
    assert (played is None) == (size is None)
    if played is not None and size is not None:
        assert np.ptp(played.q) == pytest.approx(2 * size, rel=1e-3)


@pytest.mark.parametrize(("machine", "there"), [("pendulum", True), ("imi_planar", False)])
def test_what_the_machine_has_besides_is_not_called_wrong(machine: str, there: bool) -> None:
    """The pendulum's supply of 24 V is not in its nominal model. A story of a concealed drag said
    of the saturation that was found: not there.
    """
    finding = Finding("saturation", 1, {}, 0.96, 0.02, ("voltage_limit",), (), "")
    told = Told(cast(Recorded, None), cast(Diagnosis, None))
    narrator = Narrator(quiet=True)
    _named_beside(get_stage(machine), Judged(True, True, (), (finding,), ()), told, narrator)
    assert ("true of this machine" in narrator.said[-1]) is there
    assert bool(told.failures) is not there
