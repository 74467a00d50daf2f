"""Laws beyond friction of a rigid joint: each is found with its numbers in a recording of
independent code.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import reality

from zendsp.diagnosis import diagnose
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.signals import Signals, unused_effects
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.search.rounds import Rounds
from zendsp.errors import RecordingError
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.loop import Looped, simulate_joint_loop
from zendsp.physics.effects import mechanism_of
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model

RATE, SECONDS = 500.0, 9.0
VISCOUS = {"kind": "viscous", "joint": 1, "coefficient": 0.004}
COULOMB = {"kind": "coulomb", "joint": 1, "level": 0.03}


@dataclass(frozen=True)
class Case:
    """What the machine has and the model has not: parameter -> true value, and how far off it may
    be found.
    """

    machine: reality.Machine
    true: dict[str, float]
    within: float = 0.05
    given: tuple[dict[str, object], ...] = ()
    reference: dict[str, float] = field(default_factory=dict)


FAST = {"high": 12.0}
CASES: dict[str, Case] = {
    "gain_drift": Case(reality.Machine(fade=-0.25), {"ratio": -0.25, "time_constant": 3.0}),
    "sensor_harmonic": Case(
        reality.Machine(oval=0.01), {"order": 2.0, "amplitude": 0.01}, reference={"size": 2.0}
    ),
    "position_filter": Case(reality.Machine(smear=0.006), {"time_constant": 0.006}, reference=FAST),
    "column_shift": Case(reality.Machine(late=2), {"time": 0.004}, reference=FAST),
    "voltage_limit": Case(
        reality.Machine(supply=0.7, back=0.08), {"level": 0.7, "slope": 0.08},
        reference={"size": 2.0, "high": 3.0},
    ),
    "stiffening": Case(
        reality.Machine(soft=15.0, hard=8e3, load=0.006),
        {"stiffness": 15.0, "stiffness3": 8e3, "load_inertia": 0.006},
        0.1,
        (
            {
                "kind": "elasticity",
                "joint": 1,
                "stiffness": 25.0,
                "damping": 0.02,
                "load_inertia": 0.005,
            },
        ),
        FAST,
    ),
    "transmission_error": Case(
        reality.Machine(wobble=0.01, gravity=0.2), {"order": 5.0, "amplitude": 0.01},
        reference={"size": 2.0, "high": 6.0},
    ),
    "friction_temperature": Case(reality.Machine(thin=0.03), {"coefficient": -0.03}),
}


@cache
def data_of(name: str) -> tuple[Data, Model]:
    """A recording of the machine, read for the model that lacks the law."""
    case = CASES[name]
    columns = reality.simulate(
        case.machine, reality.multisine(SECONDS, RATE, 1, **case.reference), RATE
    )
    model = parse_model(
        {
            "sample_time": 1.0 / RATE,
            "effect": [VISCOUS, COULOMB, *case.given],
            "mechanism": {
                "kind": "rotary",
                "parameters": {
                    "inertia": {"value": 0.0102},
                    "gravity": {"value": case.machine.gravity},
                },
            },
        }
    )
    extra = {"temperature": columns["warm"][:, None]} if "warm" in columns else {}
    q, u = columns["q"][:, None], columns["u"][:, None]
    signals = Signals(
        "run", columns["t"], 1.0 / RATE, q, u, None, np.array([reality.RESOLUTION]), extra=extra
    )
    return prepare([signals], model, 64.0), model


@pytest.mark.parametrize("name", CASES)
def test_law_is_first_in_a_search_with_its_numbers(name: str) -> None:
    data, model = data_of(name)
    case = CASES[name]
    base = calibrate_joint(data, model, 1)
    rivals = Rounds(data, 1, 1, lambda _: None).round(base)
    told = [(r.effect, round(base.deviance - r.value)) for r in rivals[:4]]
    first = rivals[0]
    assert mechanism_of(first.effect) == mechanism_of(name), told
    assert first.effect == name, told
    term = next(t for t in first.scored.model.at(1) if t.effect == name)
    for key, true in case.true.items():
        assert term.value(key) == pytest.approx(true, rel=case.within), (key, told)


def test_an_early_column_is_a_delay_and_a_part_of_a_row_is_no_shifted_column() -> None:
    def first(machine: reality.Machine) -> list[str]:
        columns = reality.simulate(machine, reality.multisine(SECONDS, RATE, 1, **FAST), RATE)
        model = parse_model({
            "sample_time": 1.0 / RATE, "effect": [VISCOUS, COULOMB],
            "mechanism": {"kind": "rotary", "parameters": {"inertia": {"value": 0.0102}}},
        })  # fmt: skip
        q, u = columns["q"][:, None], columns["u"][:, None]
        signals = Signals(
            "run", columns["t"], 1.0 / RATE, q, u, None, np.array([reality.RESOLUTION])
        )
        data = prepare([signals], model, 64.0)
        base = calibrate_joint(data, model, 1)
        rivals = Rounds(data, 1, 1, lambda _: None).round(base)
        return [r.effect for r in rivals if base.deviance - r.value > 40]

    assert first(reality.Machine(late=-2))[:2] == ["delay", "column_shift"]
    # the position of reality is half of an integration step, a fortieth of a row, ahead of its
    # torque
    assert "column_shift" not in first(reality.Machine())


def test_an_optional_column_is_mentioned_only_where_the_model_names_it() -> None:
    data, model = data_of("gain_drift")
    assert not data.records[0][0].columns
    signals = Signals(
        "run", np.zeros(2), 1.0, np.zeros((2, 1)), np.zeros((2, 1)), None, np.zeros(1)
    )
    assert "temperature" not in model.columns and unused_effects([signals], model) == []
    named = replace(model, columns={**model.columns, "temperature": "warm"})
    (note,) = unused_effects([signals], named)
    assert note == "friction_temperature was not considered: run: no column of temperature"


def test_an_optional_column_missing_in_one_recording_is_not_used(tmp_path: Path) -> None:
    machine = reality.Machine(thin=0.03)
    files = []
    for name, seed in (("train", 1), ("held", 2)):
        columns = reality.simulate(machine, reality.multisine(5.0, RATE, seed), RATE, seed)
        if name == "held":
            del columns["warm"]
        files.append(reality.save(tmp_path / f"{name}.csv", columns))
    model = reality.model_file(tmp_path / "model.toml", RATE, *reality.KNOWN)
    model.write_text(model.read_text() + 'temperature = "warm"\n')
    d = diagnose(files[0], model, files[1], jobs=1)
    assert "friction_temperature" not in {f.effect for f in (*d.findings, *d.refinements)}
    (note,) = (note for note in d.notes if "friction_temperature" in note)
    assert note.startswith("friction_temperature was not considered: ") and note.endswith(
        "held.csv: no column of temperature"
    )
    model.write_text(model.read_text() + reality.effect("friction_temperature", coefficient=-0.03))
    with pytest.raises(
        RecordingError, match="friction_temperature of joint 1 needs a column of temperature"
    ):
        diagnose(files[0], model, files[1], jobs=1)


def looped(*terms: dict[str, object], **more: float) -> Looped:
    """A joint of 0.01 kg m² in a loop that follows a sine."""
    parameters = {"inertia": {"value": 0.01}}
    model = parse_model(
        {
            "sample_time": 0.002,
            "mechanism": {"kind": "rotary", "parameters": parameters},
            "effect": list(terms),
        }
    )
    return simulate_joint_loop(
        model, 1, np.sin(6.0 * np.arange(1000) * 0.002), 0.002, kp=3.0, kd=0.1, inertia=0.01, **more
    )  # type: ignore[arg-type]


def test_a_simulated_loop_knows_temperature_load_and_what_is_written_of_its_command() -> None:
    warm = {"kind": "friction_temperature", "joint": 1, "coefficient": -0.05, "reference": 20.0}
    half = {**COULOMB, "level": 0.015}
    np.testing.assert_allclose(
        looped(COULOMB, warm, temperature=30.0).position, looped(half).position, atol=1e-12
    )
    plain = looped(COULOMB)
    late = looped(COULOMB, {"kind": "column_shift", "joint": 1, "time": 0.004})
    np.testing.assert_array_equal(plain.position, late.position)
    np.testing.assert_allclose(late.command[10:], plain.command[8:-2], atol=1e-12)
    hard = {
        "kind": "elasticity",
        "joint": 1,
        "stiffness": 3000.0,
        "damping": 0.2,
        "load_inertia": 0.005,
    }
    # 3000 N m/rad bend by 0.1 mrad under the torque of the load; the motor has the other half of
    # the inertia
    assert np.max(np.abs(looped(hard, VISCOUS).position - looped(VISCOUS).position)) < 2e-3
