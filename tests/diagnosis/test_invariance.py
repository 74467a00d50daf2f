"""What is found does not change with units, the origin of time, unnamed columns, the width of
numbers, or a recording given twice.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import reality
from reality import KNOWN, RATE

from zendsp.diagnosis import Diagnosis, diagnose
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.search.bodies import find_bodies
from zendsp.physics import inverse_dynamics, load_model
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect

MACHINES = {
    "two effects": reality.Machine(ripple=0.02, drag=0.004),
    "a foreign torque": reality.Machine(wave=0.05),
    "nothing": reality.Machine(),
    "friction that falls with time": reality.Machine(thin=0.03),
}
Columns = dict[str, np.ndarray]


def _milli(columns: Columns) -> Columns:
    return {**columns, "u": 1e3 * columns["u"]}


def _stored(columns: Columns) -> Columns:
    narrow = {k: v if k == "t" else v.astype(np.float32) for k, v in columns.items()}
    other = np.random.default_rng(0).standard_normal(len(columns["t"]))
    return {**narrow, "t": columns["t"] + 1.7e9, "other": other}


# two at a time: one that fails is tried alone
CHANGES: dict[str, Callable[[Columns], Columns]] = {
    "command in thousandths, origin of time, width of numbers, an unnamed column": lambda c: (
        _stored(_milli(c))
    ),
    "torque in mN m, twice": _milli,
}
# numbers of the model file that a torque in mN m multiplies
TORQUES = r"(inertia = \{ value|coefficient = \{ value|level = \{ value|limit) = ([0-9.]+)"


def _model(text: str, change: str) -> str:
    if change.startswith("command in thousandths"):
        return text.replace("gain = { value = 1.0", "gain = { value = 0.001").replace(
            "limit = 3.0", "limit = 3000.0"
        )
    if change.startswith("torque in mN m"):
        text, changed = re.subn(TORQUES, lambda m: f"{m[1]} = {1e3 * float(m[2])!r}", text)
        assert changed == 4
    return text


@cache
def _recorded(name: str, seconds: float, seed: int) -> Columns:
    return reality.simulate(MACHINES[name], reality.multisine(seconds, RATE, seed), RATE, seed)


def _diagnosed(folder: Path, name: str, change: str) -> Diagnosis:
    files = []
    for seconds, seed in ((6.0, 1), (6.0, 2)):
        columns = CHANGES[change](_recorded(name, seconds, seed))
        files.append(folder / f"run{seed}.npz")
        np.savez(files[-1], **columns)
    resolution = MACHINES[name].resolution
    model = Path(reality.model_file(folder / "model.toml", RATE, *KNOWN, resolution=resolution))
    model.write_text(_model(model.read_text(), change))
    train = [files[0]] * (2 if change.endswith("twice") else 1)
    return diagnose(train, model, files[1], jobs=1)


# each machine with one change: any two with both
CASES = [
    pytest.param(
        name,
        change,
        marks=[]
        if (at + which) % 2 == 0
        else pytest.mark.long("the machine with another change, the change with other machines"),
    )
    for at, name in enumerate(MACHINES)
    for which, change in enumerate(CHANGES)
]


@pytest.mark.usefixtures("sizes_unasked")
@pytest.mark.parametrize(("name", "change"), CASES)
def test_nothing_that_is_found_changes_with(
    name: str, change: str, bench: Callable[..., Diagnosis], tmp_path: Path
) -> None:
    before, after = bench(MACHINES[name]), _diagnosed(tmp_path, name, change)
    assert after.verdict == before.verdict
    assert [f.effect for f in after.findings] == [f.effect for f in before.findings]
    scale = 1e3 if change.startswith("torque in mN m") else 1.0
    for one, other in zip(before.findings, after.findings, strict=True):
        for key, value in one.parameters.items():
            of_torque = scale if "N" in value.unit else 1.0
            assert other.parameters[key].value == pytest.approx(
                of_torque * value.value, rel=2e-3, abs=2e-3 * of_torque * 0.03
            )
            assert other.parameters[key].std == pytest.approx(of_torque * value.std, rel=0.1)
    assert after.discrepancy[0].share == pytest.approx(
        before.discrepancy[0].share, rel=0.05, abs=2e-4
    )
    assert after.test is not None and before.test is not None
    assert after.test.improved == pytest.approx(before.test.improved, rel=0.02)


def _arm(folder: Path, friction: str) -> Path:
    """A model of two light joints, heavily damped, with its friction in one of two forms."""
    joint = (
        '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin'
        ' xyz="{3}"/><axis xyz="0 1 0"/><limit lower="-9" upper="9"'
        ' effort="99" velocity="9"/></joint><link name="{2}"><inertial><origin xyz="0.1 0 0"/>'
        '<mass value="{4}"/><inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/>'
        "</inertial></link>"
    )
    bodies = joint.format("j1", "base", "upper", "0 0 0.5", 1.0)
    bodies += joint.format("j2", "upper", "fore", "0.2 0 0", 0.3)
    (folder / "arm.urdf").write_text(f'<robot name="arm"><link name="base"/>{bodies}</robot>')
    model = folder / "arm.toml"
    model.write_text(
        f'name = "arm"\nsample_time = {1 / RATE}\n[mechanism]\nkind = "urdf"\nfile = "arm.urdf"\n'
        f'{friction}\n[sensor]\nposition_resolution = 1e-5\n[columns]\ntime = "t"\nposition = "q"\n'
        'command = "u"\n'
    )
    return model


def test_a_body_does_not_depend_on_how_the_same_friction_is_written(tmp_path: Path) -> None:
    """Viscous friction with a number for each direction had been ignored in a joint's response to
    torque: a Barrett WAM's payload became a gain or a coupling.
    """
    each = '[[effect]]\nkind = "viscous{0}"\njoint = {1}\n{2}\n'
    both = "".join(each.format("", j, "coefficient = { value = 2.0 }") for j in (1, 2))
    sides = "coefficient_pos = { value = 2.0 }\ncoefficient_neg = { value = 2.0 }"
    apart = "".join(each.format("_asymmetry", j, sides) for j in (1, 2))
    given = load_model(_arm(tmp_path, both))
    t = np.arange(0.0, 12.0, 1 / RATE)
    waves = np.array([[[2.1, 5.3], [3.7, 1.3]]])  # rad/s, of each joint
    q, qd, qdd = (
        np.sum(0.4 * waves**k * np.sin(waves * t[:, None, None] + k * np.pi / 2), axis=2)
        for k in (0, 1, 2)
    )
    load = {"mass": 0.8, "com_x": 0.1, "com_y": 0.0, "com_z": 0.0, "inertia": 0.0}
    true = given.with_terms((*given.terms, make_term(get_effect("payload"), 2, load)))
    file = tmp_path / "run.npz"
    np.savez(file, t=t, q=1e-5 * np.round(q / 1e-5), u=inverse_dynamics(true, q, qd, qdd))
    found = []
    for friction in (both, apart):
        model = load_model(_arm(tmp_path, friction))
        parts = [prepare([read_signals(file, model)], model, 64.0) for _ in range(2)]
        (body,) = find_bodies(*parts, model, 1, lambda _text: None).found
        found.append([body.term.value(key) for key in load])
    assert found[0][0] == pytest.approx(0.8, rel=0.01)
    assert found[1] == pytest.approx(found[0], rel=1e-6, abs=1e-9)
