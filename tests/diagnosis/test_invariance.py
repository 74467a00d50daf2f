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

from zendsp.diagnosis import Diagnosis, diagnose

RATE = 500.0
GIVEN = [reality.effect("viscous", coefficient=0.004), reality.effect("coulomb", level=0.03)]
MACHINES = {
    "two effects": reality.Machine(ripple=0.02, drag=0.004),
    "a foreign torque": reality.Machine(wave=0.05),
    "nothing": reality.Machine(),
}
Columns = dict[str, np.ndarray]


def _milli(columns: Columns) -> Columns:
    return {**columns, "u": 1e3 * columns["u"]}


def _stored(columns: Columns) -> Columns:
    narrow = {k: v if k == "t" else v.astype(np.float32) for k, v in columns.items()}
    other = np.random.default_rng(0).standard_normal(len(columns["t"]))
    return {**narrow, "t": columns["t"] + 1.7e9, "other": other}


CHANGES: dict[str, Callable[[Columns], Columns]] = {
    "none": lambda c: c,
    "origin of time, width of numbers, an unnamed column": _stored,
    "command in thousandths": _milli,
    "torque in mN m": _milli,
    "twice": lambda c: c,
}
# numbers of the model file that a torque in mN m multiplies
TORQUES = r"(inertia = \{ value|coefficient = \{ value|level = \{ value|limit) = ([0-9.]+)"


def _model(text: str, change: str) -> str:
    if change == "command in thousandths":
        return text.replace("gain = { value = 1.0", "gain = { value = 0.001").replace(
            "limit = 3.0", "limit = 3000.0"
        )
    if change == "torque in mN m":
        text, changed = re.subn(TORQUES, lambda m: f"{m[1]} = {1e3 * float(m[2])!r}", text)
        assert changed == 4
    return text


@cache
def _recorded(name: str, seconds: float, seed: int) -> Columns:
    return reality.simulate(MACHINES[name], reality.multisine(seconds, RATE, seed), RATE, seed)


def _diagnosed(folder: Path, name: str, change: str) -> Diagnosis:
    files = []
    for seconds, seed in ((9.0, 1), (7.0, 2)):
        columns = CHANGES[change](_recorded(name, seconds, seed))
        files.append(folder / f"run{seed}.npz")
        np.savez(files[-1], **columns)
    resolution = MACHINES[name].resolution
    model = Path(reality.model_file(folder / "model.toml", RATE, *GIVEN, resolution=resolution))
    model.write_text(_model(model.read_text(), change))
    train = [files[0]] * (2 if change == "twice" else 1)
    return diagnose(train, model, files[1])


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Diagnosis]:
    return {
        name: _diagnosed(tmp_path_factory.mktemp("plain"), name, "none") for name in MACHINES
    }


@pytest.mark.parametrize("change", [c for c in CHANGES if c != "none"])
@pytest.mark.parametrize("name", MACHINES)
def test_nothing_that_is_found_changes_with(
    name: str, change: str, plain: dict[str, Diagnosis], tmp_path: Path
) -> None:
    before, after = plain[name], _diagnosed(tmp_path, name, change)
    assert after.verdict == before.verdict
    assert [f.effect for f in after.findings] == [f.effect for f in before.findings]
    scale = 1e3 if change == "torque in mN m" else 1.0
    for one, other in zip(before.findings, after.findings, strict=True):
        for key, value in one.parameters.items():
            of_torque = scale if "N" in value.unit else 1.0
            assert other.parameters[key].value == pytest.approx(
                of_torque * value.value, rel=2e-3, abs=2e-3 * of_torque * 0.03
            )
    assert after.discrepancy[0].share == pytest.approx(
        before.discrepancy[0].share, rel=0.05, abs=2e-4
    )
    assert after.test is not None and before.test is not None
    assert after.test.improved == pytest.approx(before.test.improved, rel=0.02)
