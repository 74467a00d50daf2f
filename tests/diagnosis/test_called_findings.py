"""What a diagnosis finds beside a simulator that can only be called."""

from __future__ import annotations

from pathlib import Path

import pytest
import reality
from test_simulator import OWN, files

from zendsp.diagnosis import diagnose


def test_a_wrong_rotor_is_one_finding(tmp_path: Path) -> None:
    """It had been four."""
    fixed = OWN.replace(" }", ", free = false }").replace("0.0102", "0.0085")
    fixed = fixed.replace("0.206", "0.2").replace("0.0042", "0.004")
    machine = reality.Machine(gravity=0.2, coulomb=0.0)
    # the reality's own commands of 250 Hz come 47 us late
    train, test, model = at_1_khz(tmp_path, machine, "simulate", fixed)
    d = diagnose(train, model, test, jobs=1)
    assert [f.effect for f in d.findings] == ["inertia"], d.findings
    amount = d.findings[0].parameters["amount"]
    assert amount.value == pytest.approx(0.0015, rel=0.01)


def at_1_khz(folder: Path, machine: reality.Machine, function: str, parameters: str) -> list[Path]:
    """Two recordings and a model, at the rate of the reality's own commands."""
    model = files(folder, machine, function, parameters)[2]
    model.write_text(model.read_text().replace("0.004\n[mech", "0.001\n[mech"))
    runs = [
        reality.save(
            folder / f"fast{seed}.csv",
            reality.simulate(machine, reality.multisine(5.0, 1000.0, seed), 1000.0),
        )
        for seed in (1, 2)
    ]
    return [*runs, model]


def test_what_lacks_beside_dry_friction_that_a_simulator_has_is_named(tmp_path: Path) -> None:
    """The simulator sticks, and what lacked there hid the rest: a function without a law was found
    in place of viscous friction.
    """
    own = {"inertia": 0.01, "gravity": 0.2, "viscous": 0.0, "dry": 0.06}
    parameters = "\n".join(f"{k} = {{ value = {v}, free = false }}" for k, v in own.items())
    machine = reality.Machine(gravity=0.2, coulomb=0.06)
    train, test, model = at_1_khz(tmp_path, machine, "sticks", parameters)
    d = diagnose(train, model, test, jobs=1)
    assert [f.effect for f in d.findings] == ["viscous"], d.findings
    assert d.findings[0].parameters["coefficient"].value == pytest.approx(0.004, rel=0.1)
    assert [t.effect for t in d.improved.terms] == ["viscous"], "the other is in the simulator"
    assert d.improved.mechanism["dry"][0].value == 0.06 and d.given.terms == ()


def test_more_inertia_and_weight_of_a_simulator_are_one_finding(tmp_path: Path) -> None:
    """A payload had been a gravity and an inertia."""
    own = {"inertia": 0.01, "gravity": 0.2, "viscous": 0.004, "dry": 0.03}
    parameters = "\n".join(f"{k} = {{ value = {v}, free = false }}" for k, v in own.items())
    machine = reality.Machine(gravity=0.3, inertia=0.0125, coulomb=0.03)
    train, test, model = at_1_khz(tmp_path, machine, "sticks", parameters)
    d = diagnose(train, model, test, jobs=1)
    assert [f.effect for f in d.findings] == ["inertia"], d.findings
    assert "It weighs: gravity grows by 0.100" in d.findings[0].sentence


def test_a_spring_is_one_finding(tmp_path: Path) -> None:
    """It had been gravity and a cubic spring."""
    machine = reality.Machine(gravity=0.2, coulomb=0.0, spring=0.1)
    train, test, model = files(tmp_path, machine)
    d = diagnose(train, model, test, jobs=1)
    assert [f.effect for f in d.findings] == ["stiffness"]
    assert d.findings[0].parameters["coefficient"].value == pytest.approx(0.1, rel=0.05)


def test_progress_is_told_while_the_simulator_is_asked(tmp_path: Path) -> None:
    train, test, model = files(tmp_path, reality.Machine(gravity=0.2, coulomb=0.0))
    said: list[str] = []
    d = diagnose(train, model, test, jobs=1, progress=said.append)
    assert d.verdict == "complete" and d.improved.called is None and d.improved.kind == "python"
    assert sum("█" in s or "░" in s for s in said) > 5
    assert any("simulations of a few rows" in note for note in d.notes)


def test_ctrl_c_reaches_a_diagnosis_that_asks_its_simulator(tmp_path: Path) -> None:
    train, test, model = files(tmp_path, reality.Machine(gravity=0.2))

    def stop(sentence: str) -> None:
        if "states" in sentence:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        diagnose(train, model, test, jobs=1, progress=stop, so_far=True)
