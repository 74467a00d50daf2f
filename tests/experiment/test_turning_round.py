"""A joint with large dry friction turns round without being held and let go, and what was measured
of one that is too fast nevertheless is kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import zendsp
from zendsp.errors import Refused, Unmeasured
from zendsp.experiment import Lab, Result, any_friction, gentle, run_experiment
from zendsp.experiment.demand import Felt
from zendsp.experiment.lab import Bench
from zendsp.experiment.watch import BEARS, LOOP
from zendsp.link import Target
from zendsp.physics import parse_model
from zendsp.reference import Reference
from zendsp_protocol.messages import JointInfo

ARM = """<mujoco model="dry"><compiler angle="radian"/><worldbody><body pos="0 0 0.4">
<joint name="j1" axis="0 1 0" range="-1.8 1.8" armature="0.05" damping="0.5" frictionloss="9"/>
<geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.04" mass="2"/></body></worldbody>
<actuator><motor joint="j1" ctrlrange="-60 60"/></actuator></mujoco>"""
DRY = {
    "name": "dry",
    "sample_time": 0.001,
    "sensor": {"position_resolution": 1.6e-5},
    "actuator": {"delay": 0.001, "limit": 60.0},
    "mechanism": {"kind": "rotary", "parameters": {"inertia": 0.3}},
    "effect": [{"kind": "coulomb", "joint": 1, "level": 9.0}],
}


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[Target]:
    (tmp_path / "dry.xml").write_text(ARM)
    slow = ["--machine-option", "speed_max=0.3", "--machine-option", "substep=5e-4"]
    with zendsp.local(str(tmp_path / "dry.xml"), clock="fast", options=slow) as target:
        yield target


@pytest.mark.parametrize("name", ["friction", "mechanical"])
def test_a_slow_joint_with_large_dry_friction_is_measured(
    name: str, arm: Target, tmp_path: Path
) -> None:
    """At a reversal friction held it until the integral let it go at 0.321 of 0.3 rad/s."""
    found = run_experiment(name, Lab(tmp_path, arm))
    level, slope = found.values["coulomb1"], found.values["viscous1"]
    assert abs(level.value - 9.0) < 4.0 * level.std < 0.04
    assert abs(slope.value - 0.5) < 4.0 * slope.std < 0.4


def test_what_was_measured_of_a_joint_is_kept_where_it_trips_on_its_way(
    arm: Target, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without what the loop learns: nine of twelve moves were made."""
    real = Bench.record
    monkeypatch.setattr(
        Bench, "record", lambda *given, **values: real(*given, learns=False, **values)
    )
    lab = Lab(tmp_path, arm)
    said = r"joint 1 \(j1\) was to move at up to 0.12 rad/s and came to 0.3.*larger inertia"
    with pytest.raises(Refused, match=said):
        run_experiment("friction", lab)
    early = Result.load(tmp_path / "friction" / "result_ended.toml")
    level = early.values["coulomb1"]
    assert abs(level.value - 9.0) < 4.0 * level.std < 0.2
    assert "of its 12 moves" in " ".join(early.warnings)
    assert "result_ended.toml" in lab.left


def swaying(**values: Any) -> zendsp.Recording:
    """A joint with dry friction that sways."""
    sway = {"amplitude": 0.2, "period": 4.0, "J": 0.3, **values}
    model = parse_model(DRY)
    return zendsp.simulate(
        "joint_pd.c", model, seconds=20.0, parameters=sway, channels=["e", "tau"]
    )


def test_friction_is_turned_round_once_it_is_known() -> None:
    alone, learns = (swaying(learns=x) for x in (False, True))
    late = alone.t > 8.0  # the first reversals show what the friction is
    assert np.abs(alone["e"][late]).max() > 5.0 * np.abs(learns["e"][late]).max()
    assert np.abs(learns["tau"][late]).max() < np.abs(alone["tau"][late]).max()


def test_a_loop_is_no_stiffer_than_its_sampling_bears_at_the_declared_inertia(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Friction that depends on the place had looked like 21 times the inertia: the command went
    from one limit to the other 175 times a second, for 50 s.
    """
    own = JointInfo(
        name="j", unit="rad", position_min=-2.0, position_max=2.0, speed_max=1.0, torque_max=30.0
    )
    rec = SimpleNamespace(parameters={"J": [0.313]})
    bench: Any = SimpleNamespace(
        machine=SimpleNamespace(joints=[own]), inertias=np.array([0.313]), seen={},
        target=SimpleNamespace(status=lambda: SimpleNamespace(rate_hz=1000.0)),
        record=lambda *_, **__: rec,
    )  # fmt: skip
    felt = Felt(6.6, 0.0, np.zeros(5), np.zeros((5, 5)))
    for name, value in (("_followed", 1.0), ("firmer", []), ("_felt", felt)):
        monkeypatch.setattr(gentle, name, lambda *_, v=value: v)
    taken, found = gentle.gentle_first(bench, 1, np.zeros(1), 0.0, 1.0)
    assert found is felt and LOOP * taken[0] / 0.313 == pytest.approx(BEARS * 1000.0)


def test_a_part_of_a_joints_moves_that_tells_nothing_hides_no_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rec: Any = {"play_time": np.array([9.0])}
    bench: Any = SimpleNamespace(
        part=(Path("joint1_ended.npz"), rec), machine=SimpleNamespace(joints=[])
    )
    reference = Reference(np.zeros((900, 1)), 0.01, kind="moves", machine="")
    monkeypatch.setattr(any_friction, "_steady", lambda *_: [(k, k + 1) for k in range(9)])

    def nothing(*_: object) -> None:
        raise Unmeasured("joint 1: moves too little")

    monkeypatch.setattr(any_friction, "look", nothing)
    result: Any = SimpleNamespace(warnings=[])
    any_friction._of_part(result, bench, reference, 1)
    assert not result.warnings
