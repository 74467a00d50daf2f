"""A machine is taken over where it stands, whatever it weighs there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import zendsp
from zendsp.errors import Refused
from zendsp.experiment import Lab
from zendsp.experiment.gentle import CHANNELS, PROGRAM
from zendsp.experiment.standing import standing
from zendsp.link import Target

# a rod that carries 7.4 N m where it lies level, with a friction of 0.5 N m, and upright none
ROD = """<mujoco model="rod"><compiler angle="radian"/><worldbody><body><joint name="shoulder"
axis="0 1 0" armature="0.1" damping="1" frictionloss="0.5" range="-1.8 1.8"/><inertial
pos="0 0 {end}" mass="2.5" diaginertia="0.02 0.02 0.003"/></body></worldbody>
<actuator><motor joint="shoulder" ctrlrange="-30 30"/></actuator></mujoco>"""


def rod(folder: Path, end: float, **options: float) -> Target:
    file = folder / "rod.xml"
    file.write_text(ROD.format(end=end))
    given = {"substep": 5e-4, **options}
    words = [x for k, v in given.items() for x in ("--machine-option", f"{k}={v}")]
    return zendsp.local(str(file), clock="fast", options=["--speed", "100", *words])


def test_a_slow_joint_does_not_sink_when_the_loop_takes_its_weight_over(tmp_path: Path) -> None:
    """It tripped at 0.18 rad/s, 25 ms after the loop began."""
    with rod(tmp_path, -0.3, q1=1.0, speed_max=0.15) as target:
        with Lab(tmp_path, target).bench("friction") as bench:
            place = standing(bench)
            assert place == pytest.approx([1.0], abs=0.02)
            again = bench.record("again", PROGRAM, CHANNELS, seconds=0.2)
        assert target.status().trip is None
    # from then on a recording begins with what holds it; without that it sinks by 20 mrad
    assert np.ptp(again["q"]) < 2e-3
    assert again["tau"][5] == pytest.approx(2.5 * 9.81 * 0.3 * np.sin(1.0), abs=0.5 + 0.3)


def test_what_a_slow_joint_lacks_is_said_and_a_models_weight_is_begun_with(tmp_path: Path) -> None:
    with rod(tmp_path, -0.3, q1=1.0, speed_max=0.02) as target:
        lab = Lab(tmp_path, target)
        said = r"shoulder sinks while the loop takes its weight over.*Give a model of the machine"
        with lab.bench("low-speed") as bench, pytest.raises(Refused, match=said):
            standing(bench, takes_model=True)
        target.acknowledge()
        with lab.bench("friction") as bench, pytest.raises(Refused) as refused:
            standing(bench)
        assert "--model" not in str(refused.value), "friction takes none"
    with rod(tmp_path, -0.3, q1=1.0, speed_max=0.02) as target:
        with Lab(tmp_path, target).bench("low-speed") as bench:
            weight = np.array([2.5 * 9.81 * 0.3 * np.sin(1.0)])
            assert standing(bench, weight) == pytest.approx([1.0], abs=1e-3)
        assert target.status().trip is None


def test_a_joint_beside_its_limit_is_held_and_moved_off_it(tmp_path: Path) -> None:
    """It hangs over: it fell beyond the limit, or gave way to it later, and nothing was measured.
    """
    with rod(tmp_path, 0.3, q1=1.795) as target:
        with Lab(tmp_path, target).bench("friction") as bench:
            place = standing(bench)
        assert target.status().trip is None
    assert place == pytest.approx([1.8 - 0.02 * 3.6], abs=0.01)
