"""The equation of a load behind a spring, by two position sensors, and what the fit makes of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import reality

from zendsp.diagnosis import diagnose
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.data.sensors import judged
from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.transmission import measured
from zendsp.diagnosis.transmission.claims import Claim
from zendsp.diagnosis.transmission.measured import (
    Measured,
    measured_transmissions,
    upon,
    with_ties,
)
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model
from zendsp.recording import Recording

RATE, SECONDS = 500.0, 8.0
FINE = 2 * np.pi / 2**20  # rad
LOAD, SOFT, DRY = 0.006, 40.0, 0.03
BELT = {"soft": SOFT, "load": LOAD, "dry_load": DRY, "coulomb": 0.02, "resolution": FINE}


def model(*effects: dict[str, object], coulomb: float = 0.05, **columns: object) -> Model:
    friction = [
        {"kind": "viscous", "joint": 1, "coefficient": 0.004},
        {"kind": "coulomb", "joint": 1, "level": coulomb},
    ]
    return parse_model(
        {
            "name": "bench",
            "sample_time": 1 / RATE,
            "mechanism": {"kind": "rotary", "parameters": {"inertia": 0.010}},
            "effect": [*friction, *effects],
            "columns": {"time": "t", "position": "q", "command": "u", **columns},
        }
    )


def spring(**numbers: float) -> dict[str, object]:
    of_spring = {"stiffness": SOFT, "damping": 0.02, "load_inertia": LOAD, **numbers}
    return {"kind": "elasticity", "joint": 1, **of_spring}


@cache
def recording(machine: tuple[tuple[str, float], ...], seed: int) -> Recording:
    found = reality.Machine(both_sides=True, **dict(machine))  # type: ignore[arg-type]
    motion = reality.multisine(SECONDS, RATE, seed, size=1.0, high=8.0)
    made = reality.simulate(found, motion, RATE)
    columns = {k: v for k, v in made.items() if k != "t"}
    return Recording.from_columns(columns, sample_time=1 / RATE)


def seen(given: Model, **machine: float) -> tuple[Parts, Measured]:
    made = (recording(tuple(sorted(machine.items())), seed) for seed in (1, 2, 3))
    parts = Parts(*(prepare([read_signals(rec, given)], given, 64.0) for rec in made))
    (found,) = measured_transmissions(parts, given, 1)
    return parts, found


def test_two_sensors_tell_stiffness_and_dry_friction_for_each_unit_of_the_load() -> None:
    _, found = seen(model(position_load="ql"), **BELT)
    assert found.side is not None
    (tie,) = found.side.ties
    # of twelve belts 0.8 % off at most, of the friction of six 1.2 %; here it holds by a tanh
    assert tie.key == "stiffness" and tie.ratio == pytest.approx(SOFT / LOAD, rel=0.01)
    assert abs(tie.ratio - SOFT / LOAD) < 2 * tie.std
    assert found.side.dry == pytest.approx(DRY / LOAD, rel=0.03)


def test_nothing_that_the_drive_lacks_bends_what_they_tell() -> None:
    """The torque of the drive is not in the load's equation: a Stribeck curve at the motor and a
    gain a tenth off do not move it.
    """
    _, plain = seen(model(position_load="ql"), **BELT)
    given = model(position_load="ql")
    given = replace(given, actuator=replace(given.actuator, gain=(1.1,)))
    _, lacks = seen(given, **BELT, breakaway=0.08)
    assert plain.side is not None and lacks.side is not None
    assert lacks.side.ties[0].ratio == pytest.approx(plain.side.ties[0].ratio, rel=0.005)


def test_both_stiffnesses_of_a_spring_that_hardens_are_told() -> None:
    machine = {"soft": 15.0, "hard": 8e3, "load": LOAD, "resolution": FINE}
    _, found = seen(model(position_load="ql", coulomb=0.03), **machine)
    assert found.side is not None
    ratios = {t.key: t.ratio for t in found.side.ties}
    assert ratios["stiffness"] == pytest.approx(15.0 / LOAD, rel=0.01)
    assert ratios["stiffness3"] == pytest.approx(8e3 / LOAD, rel=0.05)
    # from a series of the compliance it had come out at a half, with a hundredth of that as std
    number = found.findings[0].parameters["stiffness3"]
    assert abs(number.value - 8e3) < 2 * number.std


def test_a_gap_is_measured_by_the_loads_own_acceleration() -> None:
    machine = {"gap": 0.02, "load": LOAD, "resolution": FINE}
    _, found = seen(model(position_load="ql", coulomb=0.03), **machine)
    assert found.side is not None and found.side.gap is not None
    width, std = found.side.gap
    # by the motor's torque, of which only a part reaches the load, 18.96 mrad
    assert width == pytest.approx(0.02, rel=0.02) and abs(width - 0.02) < 2 * std + 0.01 * width
    (tie,) = found.side.ties
    assert tie.gap and abs(tie.ratio - 120.0 / LOAD) < 2 * tie.std


def test_a_fit_holds_the_ratio_that_two_sensors_tell() -> None:
    """A known belt moved by 71 % where the motor's friction lacked, and the sensor behind it said
    nothing about it.
    """
    given = model(spring(stiffness=1.7 * SOFT), position_load="ql")
    parts, found = seen(given, **BELT, breakaway=0.08)
    assert found.side is not None
    (tie,) = found.side.ties
    told = with_ties(parts, [found])
    fitted = calibrate_joint(told.fit, upon(given, [found]), 1)
    (term,) = (t for t in fitted.model.terms if t.effect == "elasticity")
    low, high = tie.within
    ratio = term.value("stiffness") / term.value("load_inertia")
    assert low * (1 - 1e-9) <= ratio <= high * (1 + 1e-9)
    alone = calibrate_joint(parts.fit, given, 1).model
    (term,) = (t for t in alone.terms if t.effect == "elasticity")
    off = term.value("stiffness") / term.value("load_inertia") / tie.ratio - 1.0
    assert abs(off) > 5 * tie.std / tie.ratio  # by the motor's position alone it takes in friction


def test_the_friction_of_a_load_behind_a_known_spring_is_told_from_the_motors() -> None:
    given = model(spring(), position_load="ql")
    parts, found = seen(given, **BELT)
    assert any("acts on the load, behind the spring" in note for note in found.notes)
    fitted = calibrate_joint(with_ties(parts, [found]).fit, upon(given, [found]), 1).model
    plain = calibrate_joint(parts.fit, given, 1)
    (belt,) = (t for t in fitted.terms if t.effect == "elasticity")
    (motor,) = (t for t in fitted.terms if t.effect == "coulomb")
    assert belt.value("load_dry") == pytest.approx(DRY, rel=0.05)
    assert motor.value("level") == pytest.approx(0.02, rel=0.05)
    (motor,) = (t for t in plain.model.terms if t.effect == "coulomb")
    assert motor.value("level") > 0.04  # both frictions at the motor, as the model had them


def test_an_error_over_the_angle_is_measured_beside_a_known_spring() -> None:
    given = model(
        spring(stiffness=4000.0, load_inertia=0.0098), position_load="ql", coulomb=0.03
    )
    data = []
    for seed in (1, 2, 3):
        rec = recording((("resolution", FINE), ("wobble", 0.01)), seed)
        columns = {k: np.array(rec[k]) for k in ("q", "u")}
        columns["ql"] = columns["q"] + 0.01 * np.sin(5 * columns["q"] + 0.6)
        one = Recording.from_columns(columns, sample_time=1 / RATE)
        data.append(prepare([read_signals(one, given)], given, 64.0))
    (found,) = measured_transmissions(Parts(*data), given, 1)
    assert [f.effect for f in found.findings] == ["transmission_error"]
    assert found.findings[0].parameters["order"].value == pytest.approx(5.0, rel=0.01)


def test_what_the_motor_does_not_feel_is_no_error_beside_a_known_spring(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A torque ripple of 6 N shook a load by 15 µm at its order, which was named as an error of the
    transmission; with it the motor's position is predicted no better.
    """
    told = Claim("wave", 1e-3, 1e-6, Evidence(9.0, 9.0, np.ones(9)), 9.0, 1e-3, 1e-6, 11.0, 0.6)
    monkeypatch.setattr(measured, "_in_time", lambda raw, *_: (0.0, [told], raw))
    given = model(spring(), position_load="ql", coulomb=0.03)
    machine = {"soft": SOFT, "load": LOAD, "resolution": FINE}
    _, found = seen(given, **machine)
    assert not found.terms and not found.stated(given)


@pytest.mark.long("the ratio, the load's friction and a fit that holds both: tests above")
def test_a_second_sensor_does_not_hide_what_the_motor_lacks() -> None:
    """With it Stribeck's curve was lost and a belt of 400 000 N/m was known to 160 000."""
    train = [recording(tuple(sorted({**BELT, "breakaway": 0.06}.items())), s) for s in (1, 2)]
    held = [recording(tuple(sorted({**BELT, "breakaway": 0.06}.items())), 3)]
    found = diagnose(train, model(position_load="ql"), held, jobs=1)
    named = {f.effect: f.parameters for f in found.findings}
    assert set(named) == {"elasticity", "stribeck"}
    belt = named["elasticity"]
    assert belt["stiffness"].value == pytest.approx(SOFT, rel=0.02)
    assert belt["stiffness"].std < 0.05 * SOFT
    assert belt["load_dry"].value == pytest.approx(DRY, rel=0.1)
    alone = diagnose(train, model(), held, jobs=1)
    assert found.test is not None and alone.test is not None
    assert found.test.improved < 1.05 * alone.test.improved


def sensor(drops: slice, to: float | None) -> tuple[np.ndarray, np.ndarray]:
    """A motor's position and its load's, which reads ``to`` in some rows (None: the row before)."""
    t = np.arange(4000) / RATE
    q = 0.4 * np.sin(2 * np.pi * 0.7 * t) + 0.1
    load = np.round((q + 1e-3 * np.cos(2 * np.pi * 0.7 * t)) / FINE) * FINE
    load[drops] = load[drops.start - 1] if to is None else to
    return q, load


@pytest.mark.parametrize("to", [0.0, None])
def test_rows_at_which_the_second_sensor_drops_out_are_filled_in_and_told(
    to: float | None,
) -> None:
    q, load = sensor(slice(1500, 1520), to)
    _, whole = sensor(slice(1, 1), None)
    used, (note,) = judged("position_load", load[:, None], q[:, None], q[:, None], 1 / RATE)
    assert "dropped out in 2" in note and "(first in row 150" in note
    # the torsion of 1 mrad is interpolated over 40 ms
    assert np.max(np.abs(used[:, 0] - whole)) < 2e-5


def test_a_second_sensor_that_loses_many_rows_is_not_used() -> None:
    q, load = sensor(slice(1500, 1600), 0.0)
    used, (note,) = judged("position_load", load[:, None], q[:, None], q[:, None], 1 / RATE)
    assert np.isnan(used).all() and "it drops out in 2.5 % of its rows (first in row 150" in note


def test_a_load_that_stands_while_its_motor_is_jerked_has_not_dropped_out() -> None:
    q, load = sensor(slice(1, 1), None)
    q[3000:], load[3000:] = q[3000], load[3000]
    ramp = np.clip(np.arange(1000) - 490, 0, 20) * 5e-4  # rad; the load follows 20 rows later
    q[3000:] += ramp
    load[3020:] += ramp[:-20]
    used, notes = judged("position_load", load[:, None], q[:, None], q[:, None], 1 / RATE)
    assert not notes and np.all(used[:, 0] == load)
