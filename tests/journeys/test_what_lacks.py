"""What a model lacks, found by `zendsp diagnose` in recordings of a robot that slides."""

from __future__ import annotations

import importlib.util
import json

import pytest
from journey import Installed

GANTRY = """<mujoco model="gantry">
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0" range="-1 1" damping="4"/>
      <geom type="box" size="0.1 0.1 0.1" mass="5"/>
    </body>
  </worldbody>
  <actuator><motor joint="rail" ctrlrange="-80 80"/></actuator>
</mujoco>
"""


@pytest.mark.long("a sealed case slides, test_any_robot.py runs an MJCF; lost: both at once")
@pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="needs mujoco")
def test_an_mjcf_with_a_joint_that_slides_is_diagnosed_in_newton_and_metres(
    installed: Installed,
) -> None:
    installed.write("gantry.xml", GANTRY)
    installed.write("hidden.toml", '[[effect]]\nkind = "coulomb"\njoint = 1\nlevel = 5.0\n')
    installed.target(
        "gantry", "gantry.xml", "--clock", "fast", "--speed", "10", "--concealed", "hidden.toml"
    )
    ran = installed.run("run", "joint_pd.c", "--set", "amplitude=0.3", "period=1.3")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    for name, seconds in (("run1.mat", 5), ("run2.mat", 4)):
        made = installed.run(
            "acquire", "q", "tau", "--seconds", str(seconds), "--decimation", "4", "--out", name
        )
        assert made.returncode == 0, made.stdout + made.stderr
    assert installed.run("pause").returncode == 0  # a simulation costs half a processor
    begun = installed.run("model", "new", "run1.mat", "--out", "gantry.toml")
    assert begun.returncode == 0 and "no questions" in begun.stdout, begun.stdout + begun.stderr
    said = installed.run(
        "diagnose", "run1.mat", "--heldout", "run2.mat", "--model", "gantry.toml", "--json"
    )
    assert said.returncode == 0, said.stderr
    report = json.loads(said.stdout)
    dry = next(f for f in report["findings"] if f["mechanism"] == "dry_friction")
    assert dry["joint"] == 1 and report["fit"]["unit"] == "m", said.stdout
    assert {p["unit"] for p in dry["parameters"].values()} <= {"N", "m/s", "m"}, dry
