"""What two sensors on both sides of a transmission show, and what they do not."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import reality

from zendsp.diagnosis import diagnose
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.data.used import columns_beside_a_call, used_columns
from zendsp.diagnosis.decide.confidence import SUREST
from zendsp.diagnosis.decide.findings import Estimate, Finding
from zendsp.diagnosis.decide.remember import remembered
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.transmission import one_sensor
from zendsp.diagnosis.transmission.claims import Claim
from zendsp.diagnosis.transmission.findings import findings_of
from zendsp.diagnosis.transmission.measured import (
    Measured,
    in_figures,
    measured_transmissions,
    without_guesses,
)
from zendsp.diagnosis.transmission.torque_sensor import Sides, _with_sides, on_both_sides, sides_of
from zendsp.errors import RecordingError
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model, Quantity, Term
from zendsp.recording import Recording

RATE, SECONDS = 500.0, 8.0
FINE = 2 * np.pi / 2**20  # rad: an absolute encoder of 20 bits


def model(**columns: object) -> Model:
    friction = [
        {"kind": "viscous", "joint": 1, "coefficient": 0.004},
        {"kind": "coulomb", "joint": 1, "level": 0.03},
    ]
    return parse_model(
        {
            "name": "bench",
            "sample_time": 1 / RATE,
            "mechanism": {"kind": "rotary", "parameters": {"inertia": 0.010}},
            "effect": friction,
            "columns": {"time": "t", "position": "q", "command": "u", **columns},
        }
    )


@cache
def columns(machine: tuple[tuple[str, float], ...], seed: int) -> dict[str, np.ndarray]:
    found = reality.Machine(both_sides=True, **dict(machine))  # type: ignore[arg-type]
    motion = reality.multisine(SECONDS, RATE, seed, size=1.0, high=8.0)
    return reality.simulate(found, motion, RATE)


def recording(made: dict[str, np.ndarray]) -> Recording:
    return Recording.from_columns({k: v for k, v in made.items() if k != "t"}, sample_time=1 / RATE)


def measured(late: int = 0, **machine: float) -> list[Measured]:
    given = model(position_load="ql")
    sets = []
    for seed in (1, 2, 3):
        made = dict(columns(tuple(sorted(machine.items())), seed))
        made["ql"] = np.r_[np.repeat(made["ql"][:1], late), made["ql"][: len(made["ql"]) - late]]
        sets.append(prepare([read_signals(recording(made), given)], given, 64.0))
    return measured_transmissions(Parts(*sets), given, 1)


def only(found: list[Measured]) -> Measured:
    assert len(found) == 1
    return found[0]


def test_two_sensors_measure_the_stiffness_of_a_spring() -> None:
    spring = only(measured(soft=40.0, load=0.006, resolution=FINE))
    assert [f.effect for f in spring.findings] == ["elasticity"]
    numbers = spring.findings[0].parameters
    assert numbers["stiffness"].value == pytest.approx(40.0, rel=0.05)  # differentiated signals
    assert numbers["load_inertia"].value == pytest.approx(0.006, rel=0.1)
    assert spring.terms[0].effect == "elasticity"


def test_the_oscillation_of_a_measured_spring_is_fitted_to_the_motors_position() -> None:
    """Two sensors do not show it. A spring held at a guess predicted no better than none, was left
    out, and the motion of its load became a disturbance. A stiffness of 300 ± 30 N m/rad, held,
    predicted the position half as well as a free one.
    """
    (term,) = only(measured(soft=40.0, load=0.006, resolution=FINE)).terms
    free = {key for key, number in term.parameters.items() if number.free}
    assert free == {"damping", "stiffness", "load_inertia"}


def test_a_spring_is_measured_through_the_counts_of_usual_encoders() -> None:
    spring = only(measured(soft=15.0, load=0.006))
    assert [f.effect for f in spring.findings] == ["elasticity"]
    # torsion of 20 mrad against counts of 0.38 mrad
    assert spring.findings[0].parameters["stiffness"].value == pytest.approx(15.0, rel=0.1)


def test_a_spring_is_measured_by_a_torque_sensor_where_there_is_one() -> None:
    made = columns((("load", 0.006), ("resolution", FINE), ("soft", 40.0)), 1)
    given = model(position_load="ql", torque_measured="ts")
    data = prepare([read_signals(recording(made), given)], given, 64.0)
    spring = only(measured_transmissions(Parts(data, data, data), given, 1))
    stiffness = spring.findings[0].parameters["stiffness"]
    # the sensor says the torque itself; by the motor's the stiffness is known to 5 % only
    assert stiffness.value == pytest.approx(40.0, rel=0.005)
    assert spring.findings[0].parameters["load_inertia"].value == pytest.approx(0.006, rel=0.1)


def test_of_a_pure_inertia_load_only_its_ratio_to_the_stiffness_is_reported() -> None:
    """The motor's torque is proportional to the load's, so that noise would decide how the inertia
    is shared. 184 ± 17 N m/rad had been reported for 300.
    """
    numbers = only(measured(soft=300.0, load=0.006)).findings[0].parameters
    stiffness, load = numbers["stiffness"], numbers["load_inertia"]
    assert abs(stiffness.value - 300.0) < 2.0 * stiffness.std
    assert abs(load.value - 0.006) < 2.0 * load.std
    assert stiffness.value / load.value == pytest.approx(300.0 / 0.006, rel=0.02)


def test_a_claim_that_leaves_nothing_has_the_highest_confidence() -> None:
    size, left = 1e-4, 0.0  # rad: all of the torsion within the sensors' own noise
    claim = Claim("step", -2e-5, 1e-7, Evidence(9.0, 9.0, np.ones(9)), 9.0, size, left)
    found, _ = findings_of(None, model(), 1, 1.0, [claim], (0.0, 0.0))  # type: ignore[arg-type]
    assert found[0].confidence == SUREST


def test_what_two_sensors_show_of_a_known_spring_has_its_unit_and_is_a_stiffness_too() -> None:
    shown = Evidence(9.0, 9.0, np.ones(9))
    spring, step = (
        Claim(name, value, 1e-7, shown, 9.0, 1e-4, 0.0)
        for name, value in (("spring", -5e-6), ("step", -2e-5))
    )
    said = in_figures([spring, step], "m/N")
    assert said == "spring 5e-06 m/N, a stiffness of 2e+05, step 2e-05"
    assert in_figures([], "m/N") == "nothing beyond it"


def test_a_stiff_transmission_is_no_finding_and_the_detectable_compliance_is_reported() -> None:
    nothing = only(measured(resolution=FINE))
    assert nothing.findings == ()
    assert [d.effect for d in nothing.detectable] == ["elasticity", "hysteresis"]
    assert all(0 < d.size < 1e-3 for d in nothing.detectable)
    assert any("compliance" in note and "would be sure" in note for note in nothing.notes)


def test_two_sensors_measure_backlash() -> None:
    gap = only(measured(gap=0.02, load=0.006, resolution=FINE))
    assert [f.effect for f in gap.findings] == ["backlash"]
    assert gap.findings[0].parameters["gap"].value == pytest.approx(0.02, rel=0.1)


@pytest.mark.long("a gap is measured, and guessed ones only refine: two quicker tests")
def test_a_soft_contact_and_its_gap_are_both_fitted_to_the_motors_position() -> None:
    """The contacts yield by a fifth of the gap. When their stiffness was held a sixth off, all
    numbers came out a sixth too small, beside a torque gain of -17 %.
    """
    machine = {"gap": 0.02, "load": 0.006, "resolution": FINE}
    recordings = [recording(columns(tuple(sorted(machine.items())), seed)) for seed in (1, 2, 3)]
    found = diagnose(recordings[:2], model(position_load="ql"), recordings[2:], jobs=1)
    (gap,) = found.findings
    assert gap.effect == "backlash"
    assert abs(gap.parameters["gap"].value - 0.02) < 2 * gap.parameters["gap"].std
    (term,) = [t for t in found.improved.terms if t.effect == "backlash"]
    assert term.parameters["gap"].value == pytest.approx(0.02, rel=0.01)
    assert term.parameters["stiffness"].value == pytest.approx(120.0, rel=0.02)
    # what two sensors measure is no calibration
    assert "backlash" not in [t.effect for t in found.calibrated.terms]


def test_beside_a_measured_transmission_a_guessed_one_only_refines_the_fit() -> None:
    def finding(effect: str, mechanism: str, joint: int) -> Finding:
        return Finding(effect, joint, {}, 0.9, 1.0, (), (), "", {}, mechanism)

    gap, friction = finding("backlash", "transmission", 1), finding("coulomb", "dry_friction", 1)
    elsewhere = finding("elasticity", "transmission", 2)
    measured_there = Measured(1, findings=(finding("elasticity", "transmission", 1),))
    kept, guessed = without_guesses((gap, friction, elsewhere), [measured_there, Measured(2)])
    assert (kept, guessed) == ((friction, elsewhere), (gap,))


def test_two_sensors_measure_a_stiffening_transmission() -> None:
    bent = only(measured(soft=15.0, hard=8e3, load=0.006, resolution=FINE))
    assert [f.effect for f in bent.findings] == ["stiffening"]
    numbers = bent.findings[0].parameters
    assert numbers["stiffness"].value == pytest.approx(15.0, rel=0.2)  # the first two terms of a
    assert numbers["stiffness3"].value == pytest.approx(8e3, rel=0.6)  # series in the torque


def test_a_late_second_sensor_is_corrected_and_reported() -> None:
    spring = only(measured(late=2, soft=40.0, load=0.006, resolution=FINE))
    assert [f.effect for f in spring.findings] == ["elasticity"]
    assert spring.findings[0].parameters["stiffness"].value == pytest.approx(40.0, rel=0.1)
    assert any("4 ms late" in note or "4.0" in note or "3.9" in note for note in spring.notes)


def test_motor_friction_that_looks_like_an_early_second_sensor_is_reported() -> None:
    spring = only(measured(viscous=0.04, soft=40.0, load=0.006, resolution=FINE))
    (note,) = (n for n in spring.notes if "early" in n)
    assert "or viscous friction of 0.0" in note and "N m s/rad acts before the transmission" in note


def test_a_joint_without_a_second_sensor_is_left_alone() -> None:
    made = dict(columns((), 1))
    made["ql"] = np.zeros_like(made["q"])
    given = model(position_load="ql")
    signals = read_signals(recording(made), given)
    assert any("position_load of joint 1 was not used: it is constant" in n for n in signals.notes)
    data = prepare([signals], given, 64.0)
    assert measured_transmissions(Parts(data, data, data), given, 1) == []


@pytest.mark.parametrize(
    ("factor", "why"),
    [(-1.0, "it runs against the position column"), (57.3, "it moves 57")],
)
def test_a_second_sensor_of_another_sign_or_unit_is_named_and_not_used(
    factor: float, why: str
) -> None:
    made = dict(columns((("load", 0.006), ("soft", 40.0)), 1))
    made["ql"] = factor * made["ql"]
    signals = read_signals(recording(made), model(position_load="ql"))
    assert any(f"position_load of joint 1 was not used: {why}" in n for n in signals.notes)


def test_half_a_column_is_refused() -> None:
    made = dict(columns((), 1))
    made["ql"] = np.where(np.arange(len(made["q"])) < 100, np.nan, made["q"])
    with pytest.raises(RecordingError, match="position_load of joint 1 has 100 values"):
        read_signals(recording(made), model(position_load="ql"))


@pytest.mark.parametrize(
    ("role", "column", "why"),
    [
        ("velocity", lambda c: np.gradient(c["q"], c["t"]), "difference of the position column"),
        ("velocity", lambda c: 57.3 * _speed(c), "times the velocity of the position column"),
        ("velocity", lambda c: np.roll(_speed(c), 6), "12 ms late, as behind a filter"),
        ("velocity", lambda c: np.roll(_speed(c), -6), "12 ms early"),
        ("current", lambda c: 3.0 * c["u"], "no measurement of its own"),
        ("current", lambda c: np.clip(c["u"], -0.2, 0.2), "does not do what it is told"),
        ("torque_measured", lambda c: 0 * c["u"], "it is constant"),
    ],
)
def test_a_column_that_is_not_used_says_why(role: str, column: object, why: str) -> None:
    made = dict(columns((), 1))
    assert callable(column)
    made["x"] = column(made)
    signals = read_signals(recording(made), model(**{role: "x"}))
    assert any(f"{role} of joint 1 was not used" in n and why in n for n in signals.notes)
    assert np.isnan(signals.extra[role]).all()


def _speed(made: dict[str, np.ndarray]) -> np.ndarray:
    noise = np.random.default_rng(0).normal(0, 0.02, len(made["q"]))
    return np.gradient(made["q"], made["t"]) + noise


def test_a_column_that_the_recording_lacks_is_named() -> None:
    signals = read_signals(recording(dict(columns((), 1))), model(current="i"))
    assert any("current was not used: no column 'i'" in note for note in signals.notes)


def test_of_every_column_that_is_named_it_is_said_how_it_is_used_or_that_it_is_not() -> None:
    """A current, a temperature, a torque and a reference passed without a word."""
    made = dict(columns((), 1))
    noise = 1e-3 * np.random.default_rng(1).normal(size=(2, len(made["q"])))
    made |= {"i": 3.0 * made["u"] + noise[0], "tau": made["u"] + noise[1], "r": made["q"]}
    made |= {"warm": 20.0 + made["t"], "none": np.full(len(made["q"]), np.nan)}
    roles = {"reference": "r", "current": "i", "temperature": "warm", "torque_measured": "tau"}
    roles["position_load"] = "none"
    given = model(**roles)
    read = read_signals(recording(made), given)
    assert used_columns([read], given) == [
        "reference was used to check the position",
        "current of joint 1 was used: it follows the command (3 times it), so there is no"
        " dead_zone, saturation or voltage_limit, and none was tried",
        f"temperature was used (20 to {20 + made['t'][-1]:.4g}): friction_temperature reads it",
        "torque_measured of joint 1 was used: it parts what acts before the sensor from what acts"
        " after it",
        "position_load was not used: it holds no numbers",
    ]
    cold = read_signals(recording({**made, "warm": np.full(len(made["q"]), 20.0)}), given)
    assert (
        "temperature was not used: it is constant (20), and only friction_temperature reads it"
        in used_columns([cold], given)
    )
    assert len(columns_beside_a_call([read], given)) == len(roles), "or that no call takes it"
    lacking = model(reference="x")
    assert used_columns([read_signals(recording(made), lacking)], lacking) == [
        "reference was not used: no recording has its column"
    ]
    assert not used_columns([read], model()), "of columns that it does not name nothing is said"


@pytest.mark.parametrize(("motor", "load", "side"), [(0.03, 0.0, "before"), (0.0, 0.03, "after")])
def test_friction_before_and_after_a_torque_sensor_is_told_apart(
    motor: float, load: float, side: str
) -> None:
    machine = {"soft": 200.0, "load": 0.006, "resolution": FINE, "viscous": 0.0}
    machine |= {"coulomb": motor, "dry_load": load}
    given = model(torque_measured="ts")
    made = columns(tuple(sorted(machine.items())), 1)
    data = prepare([read_signals(recording(made), given)], given, 64.0)
    sides = sides_of(Parts(data, data, data), given, 1)
    assert sides is not None and sides.side == side
    (before, _), (after, _) = sides.dry
    (said,) = on_both_sides([], Parts(data, data, data), given)
    assert f"dry friction of {before:.2g} ± " in said
    behind = recording({**made, "ts": 4.0 * made["ts"]})
    geared = prepare([read_signals(behind, given)], given, 64.0)
    assert "a gear between" in on_both_sides([], Parts(geared, geared, geared), given)[0]
    assert f"N m before it and of {after:.2g}" in said
    assert before == pytest.approx(motor, abs=0.003)  # a tenth: the direction is smoothed
    assert after == pytest.approx(load, abs=0.003)


def test_each_kind_of_friction_has_its_own_sides_of_a_torque_sensor() -> None:
    dry, viscous = ((0.2, 0.001), (0.01, 0.001)), ((0.001, 0.001), (0.04, 0.001))
    sides = Sides(dry, viscous, (1.0, 0.01), (0.03, 0.001))
    said = [
        _with_sides(Finding("", 1, {}, 0.9, 1.0, (), (), "F.", {}, kind), sides, unit).sentence
        for kind, unit in (("dry_friction", "N m"), ("fluid_friction", "N m s/rad"))
    ]
    assert "motor's side: dry friction of 0.2 N m before it and of 0.01 N m after it." in said[0]
    assert "friction of 0.001 N m s/rad before it and of 0.04 N m s/rad after it." in said[1]


def test_friction_over_temperature_between_recordings_that_are_each_at_one_temperature() -> None:
    def at(temperature: float, seed: int) -> Recording:
        level = 0.04 * (1 - 0.02 * (temperature - 20.0))
        motion = reality.multisine(SECONDS, RATE, seed)
        made = reality.simulate(reality.Machine(coulomb=level), motion, RATE)
        warm = np.full(len(motion), temperature)
        return Recording.from_columns(
            {"q": made["q"], "u": made["u"], "warm": warm}, sample_time=1 / RATE
        )

    held = [at(22, 3), at(38, 4)]
    found = diagnose([at(20, 1), at(40, 2)], model(temperature="warm"), held, jobs=1)
    assert [f.effect for f in found.findings] == ["friction_temperature"]
    coefficient = found.findings[0].parameters["coefficient"].value
    assert coefficient == pytest.approx(-0.02, rel=0.05)


@pytest.mark.parametrize(
    ("rows", "travel", "told"), [(700, 1.0, 0), (3000, 1.0, 1), (3000, 1e-9, 0)]
)
def test_no_compliance_is_reported_from_too_short_a_recording_or_beyond_the_travel(
    rows: int, travel: float, told: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the first and the last half second feel the filter, so of 0.7 s nothing is left
    record = SimpleNamespace(
        columns={}, sample_time=1e-3, inertia_and_bias=lambda model: (1.0, 0.0),
        scale=SimpleNamespace(position=travel),
    )  # fmt: skip
    arm = SimpleNamespace(joint_kind=lambda joint: "rotary", kind="urdf")
    parts = SimpleNamespace(test=SimpleNamespace(records=[[record]]))
    decision = SimpleNamespace(joint=1, after=SimpleNamespace(value=1e-3), scale=1.0)
    swing = np.sin(0.02 * np.arange(rows))
    monkeypatch.setattr(one_sensor, "has_bodies", lambda model: True)
    monkeypatch.setattr(one_sensor, "of_bodies", lambda record, model: swing)
    monkeypatch.setattr(one_sensor, "compliance_unit", lambda model, joint: "rad/(N m)")
    found = one_sensor.by_one_sensor(parts, arm, [decision])  # type: ignore[arg-type]
    assert len(found) == told and all(d.size < 1.0 for d in found)


@pytest.mark.parametrize(("sure", "kept"), [(1e9, False), (2.0, True)])
def test_the_improved_model_holds_the_stiffness_that_only_two_sensors_know(
    sure: float, kept: bool
) -> None:
    """Of a KUKA the report said 5.07e6, its model 1.7e6 ± 16e6, and the next diagnosis 4567."""
    fitted = Term("elasticity", 1, {"stiffness": Quantity(30.0, std=sure)})
    improved = model().with_terms((fitted,))
    measured = {"stiffness": Estimate(50.0, 5.0, "N m/rad")}
    told = Finding("elasticity", 1, measured, 0.9, 1.0, (), (), "", {}, "transmission")
    decision = SimpleNamespace(
        final=SimpleNamespace(model=improved), refinements=(), scale=1.0,
        after=SimpleNamespace(value=0.0), state=SimpleNamespace(size=0.0),
    )  # fmt: skip
    (term,) = remembered(improved, model(), [decision], [told]).terms  # type: ignore[list-item]
    stiffness = term.parameters["stiffness"]
    assert (stiffness.value, stiffness.free) == ((30.0, True) if kept else (50.0, False))
