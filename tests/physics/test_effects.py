"""The library of effects: complete against the contract, documented, usable."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest
from waiting import PATIENCE_S

from zendsp.errors import ModelError, ZendspError
from zendsp.physics.effects import (
    MECHANISMS,
    get_effect,
    laws_of,
    library,
    load_effects,
    mechanism_of,
    unit_of,
)
from zendsp.physics.kernel.native import source_text

ROOT = Path(__file__).parents[2]
# what other programs read (docs/effects.md); a disturbance is a curve, found by what remains
CONTRACT = {
    "viscous": ["coefficient"],
    "coulomb": ["level"],
    "coulomb_asymmetry": ["level_pos", "level_neg"],
    "viscous_asymmetry": ["coefficient_pos", "coefficient_neg"],
    "stribeck": ["breakaway", "velocity", "exponent"],
    "presliding": ["stiffness", "damping"],
    "quadratic_drag": ["coefficient"],
    "load_friction": ["coefficient"],
    "position_friction": ["amplitude", "period", "phase"],
    "friction_drift": ["ratio", "time_constant"],
    "gravity": ["torque", "angle"],
    "stiffness": ["coefficient", "neutral"],
    "cubic_stiffness": ["coefficient"],
    "inertia": ["amount"],
    "coupling": ["from_joint", "law", "coefficient"],
    "elasticity": ["stiffness", "damping", "load_inertia"],
    "backlash": ["gap", "stiffness", "load_inertia"],
    "hysteresis": ["force", "stiffness", "exponent"],
    "ripple": ["order", "amplitude", "phase"],
    "torque_gain": ["ratio"],
    "torque_offset": ["level"],
    "dead_zone": ["width"],
    "saturation": ["level"],
    "lag": ["time_constant"],
    "delay": ["time"],
    "encoder_eccentricity": ["amplitude", "phase"],
    "payload": ["mass", "com_x", "com_y", "com_z", "inertia"],
    "body": ["mass", "com_x", "com_y", "com_z", "inertia"],
    "base_tilt": ["angle_x", "angle_y"],
    "gain_drift": ["ratio", "time_constant"],
    "friction_temperature": ["coefficient", "reference"],
    "transmission_error": ["order", "amplitude", "phase"],
    "stiffening": ["stiffness", "stiffness3"],
    "voltage_limit": ["level", "slope"],
    "sensor_harmonic": ["order", "amplitude", "phase"],
    "position_filter": ["time_constant"],
    "column_shift": ["time"],
}
MECHANISM = {
    "dry_friction": (
        "coulomb coulomb_asymmetry stribeck presliding hysteresis load_friction position_friction"
        " friction_drift friction_temperature"
    ),
    "fluid_friction": "viscous viscous_asymmetry quadratic_drag",
    "transmission": "elasticity stiffening backlash transmission_error",
    "position_torque": "gravity stiffness cubic_stiffness ripple",
    "inertia": "inertia payload body base_tilt coupling",
    "actuator": "torque_gain gain_drift torque_offset dead_zone saturation voltage_limit lag delay",
    "measurement": "encoder_eccentricity sensor_harmonic position_filter column_shift",
    "disturbance": "disturbance",
}
# laws of dry friction that the simulator knows and no diagnosis names
BESIDE = {"coulomb_tanh", "creep", "friction_block"}


@pytest.mark.parametrize("name", CONTRACT)
def test_effect_of_the_contract_has_its_parameters(name: str) -> None:
    assert set(CONTRACT[name]) <= set(get_effect(name).names)


@pytest.mark.parametrize("mechanism", MECHANISM)
def test_mechanism_of_the_contract_has_its_laws(mechanism: str) -> None:
    assert set(laws_of(mechanism)) - BESIDE == set(MECHANISM[mechanism].split())
    assert {mechanism_of(name) for name in MECHANISM[mechanism].split()} == {mechanism}
    assert tuple(MECHANISM) == MECHANISMS


def test_an_effect_of_an_unknown_mechanism_is_refused_and_one_of_none_is_a_mechanism_by_itself() -> (  # noqa: E501
    None
):
    with pytest.raises(ModelError, match=r"'mine': mechanism = 'magic'.*dry_friction"):
        replace(get_effect("viscous"), name="mine", mechanism="magic")
    assert replace(get_effect("viscous"), name="mine", mechanism="").mechanism == ""
    assert mechanism_of("mine") == "mine"


@pytest.mark.parametrize("name", library())
def test_effect_is_explained(name: str) -> None:
    effect = library()[name]
    assert effect.name == name and effect.equation and effect.experiment.endswith(".")
    assert "{joint}" in effect.sentence or name == "base_tilt"  # which is of no joint
    assert effect.sentence.endswith(".")
    assert "{" not in effect.experiment, "it is shown as it stands, after the finding's joint"
    for field in re.findall(r"{(\w+)}", effect.sentence):
        assert (
            field == "joint"
            or field in effect.names
            or (field == "repeats" and "order" in effect.names)
            or (field == "rings" and {"stiffness", "load_inertia"} <= set(effect.names))
            or (field == "compared" and "amount" in effect.names)
            or (field == "relative" and "ratio" in effect.names)
        )
    assert len(effect.parameters) <= 6  # what the kernel's table holds
    for p in effect.parameters:
        assert unit_of(p.size, "rotary") and unit_of(p.size, "linear") and p.lower < p.upper
    assert set(effect.linear) | set(effect.grid) <= set(effect.names)
    assert all(
        other in library() or other == "disturbance" for other in (*effect.rivals, *effect.replaces)
    )


def test_units_follow_the_kind_of_joint() -> None:
    assert (
        unit_of("torque/speed", "rotary") == "N m s/rad"
        and unit_of("torque/speed", "linear") == "N s/m"
    )
    assert unit_of("inertia", "rotary") == "kg m²" and unit_of("inertia", "linear") == "kg"
    assert unit_of("command", "rotary", "V") == "V"


def _generator() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "generate_effects", ROOT / "docs" / "generate_effects.py"
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_page_of_effects_is_the_library() -> None:
    assert (ROOT / "docs" / "effects.md").read_text(
        encoding="utf-8"
    ) == _generator().page(), "run python docs/generate_effects.py"


def test_unknown_effect_lists_the_known_ones() -> None:
    with pytest.raises(ModelError, match="coulomb"):
        get_effect("friktion")


@pytest.mark.parametrize(
    ("text", "words"), [("x = 1\n", "defines no"), ("1 / 0\n", "division"), (None, "no such")]
)
def test_files_without_effects_are_refused(text: str | None, words: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    if text is not None:
        file.write_text(text)
    with pytest.raises(ModelError, match=words):
        load_effects(file)


def test_c_of_an_effect_that_cannot_be_run_for_many_parameter_sets_is_refused_by_name() -> None:
    odd = replace(
        get_effect("viscous"), name="mine", c="const double *mine = p; return mine[0] * s -> qd;"
    )
    with pytest.raises(ZendspError, match=r"'mine': 'p' stands alone"):
        source_text({"mine": odd})
    assert "p[(0) * LANES + l] * s->qd[l]" in source_text(
        {"mine": replace(odd, c="return p [0] * s -> qd;")}
    )


@pytest.mark.parametrize(("order", "amplitude", "may"), [(4.0, 0.014, True), (4.9, 0.046, False)])
def test_the_scale_of_a_sensor_varies_no_more_than_with_its_disc_off_centre(
    order: float, amplitude: float, may: bool
) -> None:
    """Damping on one half of the travel had been called a sensor harmonic of 2.6 degrees, with 95 %
    confidence.
    """
    possible = get_effect("sensor_harmonic").possible
    assert possible is not None and possible({"order": order, "amplitude": amplitude}) is may


def test_processes_that_need_the_same_c_at_once_compile_it_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compiling the kernel takes half a minute; after an update each process of a fleet would do
    it.
    """
    calls, slow = tmp_path / "calls", tmp_path / "cc"
    slow.write_text(f"#!/bin/sh\necho called >>{calls}\nsleep 0.3\nexec cc \"$@\"\n")
    slow.chmod(0o755)
    monkeypatch.setenv("ZENDSP_CACHE", str(tmp_path / "cache"))
    code = (
        "import sys; from types import SimpleNamespace; from zendsp.physics.kernel import native\n"
        "native.find_compiler = lambda: SimpleNamespace(command=(sys.argv[1],))\n"
        "print(native.build('int one(void) { return 1; }', ('-shared', '-fPIC')))"
    )
    both = [
        subprocess.Popen([sys.executable, "-c", code, slow], stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    built = {process.communicate(timeout=PATIENCE_S)[0] for process in both}
    assert len(built) == 1 and Path(built.pop().strip()).exists()
    assert calls.read_text().count("called") == 1
