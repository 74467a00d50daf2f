"""Any robot that somebody has described is run within a minute: an MJCF file, two commands, a
recording.
"""

from __future__ import annotations

import importlib.util

import pytest
from journey import Installed

pytestmark = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="needs mujoco")

LEG = """<mujoco model="leg">
  <default><joint armature="0.02" damping="0.3" frictionloss="0.5"/></default>
  <worldbody>
    <body pos="0 0 1">
      <joint name="hip" axis="0 1 0" range="-100 100"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.04" mass="2"/>
      <body pos="0 0 -0.4">
        <joint name="knee" axis="0 1 0" range="-120 120"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03" mass="1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="hip" gear="20" ctrlrange="-3 3"/><position joint="knee" kp="80" forcerange="-25 25"/></actuator>
</mujoco>
"""  # noqa: E501


def test_a_model_file_is_run_moved_recorded_and_stopped(installed: Installed) -> None:
    installed.write("leg.xml", LEG)
    target = installed.target("leg", "leg.xml", "--clock", "fast", "--speed", "3")
    ran = installed.run("run", "joint_pd.c", "--set", "amplitude=0.3")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    made = installed.run("acquire", "q", "r", "tau", "--seconds", "8", "--out", "leg.npz")
    assert made.returncode == 0, made.stdout + made.stderr
    looked = installed.script("""
import numpy as np, zendsp
rec = zendsp.Recording.load("leg.npz")
print(rec["q"].shape[1], np.ptp(rec["q"], axis=0).min() > 0.4, np.abs(rec["q"] - rec["r"]).max() < 0.15)
""")  # noqa: E501
    assert looked.stdout.split() == ["2", "True", "True"], looked.stdout + looked.stderr
    stopped = installed.run("stop")
    assert stopped.returncode == 0, stopped.stderr
    assert target.poll() is None


def test_a_model_that_does_not_parse_ends_the_target_with_the_line_of_the_file(
    installed: Installed,
) -> None:
    installed.write("leg.xml", LEG.replace("<worldbody>", "<worldbdy>"))
    said = installed.run("target", "--machine", "leg.xml")
    assert said.returncode == 2
    assert "leg.xml" in said.stderr and "line" in said.stderr.lower()


def test_a_payload_that_the_model_does_not_know_is_concealed_and_revealed(
    installed: Installed,
) -> None:
    installed.write("leg.xml", LEG)
    installed.write("hidden.toml", '[[effect]]\nkind = "coulomb"\njoint = 2\nlevel = 1.5\n')
    installed.target(
        "leg", "leg.xml", "--clock", "fast", "--speed", "3", "--concealed", "hidden.toml"
    )
    assert "coulomb" in installed.run("reveal").stdout
