"""What a model lacks, found by `zendsp diagnose` in recordings as they are: with pushes in them, of
a robot that slides.
"""

from __future__ import annotations

import importlib.util
import json
import re
from math import sin, tanh
from pathlib import Path

import numpy as np
import pytest
from journey import BENCH, STEP, Installed

INNER = 20  # steps of the motion in a row
PUSHES = ((2.0, 2.6), (6.0, 6.6))  # s


def _record(path: Path, waves: tuple[tuple[float, float], ...]) -> None:
    """Nine seconds of a joint with dry friction that the model has not, and that is pushed."""
    h = STEP / INNER
    q = qd = 0.0
    rows = []
    for k in range(2250):
        t = k * STEP
        r = sum(0.3 * sin(w * t + p) for w, p in waves)
        seen = round(q / 1e-5) * 1e-5
        u = 4.0 * (r - seen) - 0.2 * qd
        rows.append((t, seen, u))
        push = 0.08 if any(a <= t < b for a, b in PUSHES) else 0.0
        for _ in range(INNER):
            qd += h * (u + push - 0.05 * tanh(qd / 1e-3)) / 0.01
            q += h * qd
    np.savetxt(path, rows, delimiter=",", header="t,q,u", comments="")


def test_pushes_and_a_friction_that_is_missing_are_both_reported(installed: Installed) -> None:
    _record(installed.folder / "run1.csv", ((2.1, 0.0), (5.3, 1.0), (9.7, 2.0)))
    _record(installed.folder / "run2.csv", ((2.7, 0.5), (4.9, 0.0), (8.3, 1.0)))
    installed.write("bench.toml", BENCH)
    said = installed.run(
        "diagnose", "run1.csv", "--heldout", "run2.csv", "--model", "bench.toml", "--json"
    )
    assert said.returncode == 0, said.stderr
    found = {f["effect"]: f for f in json.loads(said.stdout)["findings"]}
    assert set(found) == {"disturbance", "coulomb"}, said.stdout
    assert found["coulomb"]["parameters"]["level"]["value"] == pytest.approx(0.05, rel=0.05)
    told = found["disturbance"]["sentence"]
    times = [float(x) for span in re.findall(r"(\d+\.\d+)–(\d+\.\d+) s", told) for x in span]
    assert times == pytest.approx([x for span in 2 * PUSHES for x in span], abs=0.3), told


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
    for name, seconds in (("run1.mat", 10), ("run2.mat", 6)):
        made = installed.run(
            "acquire", "q", "tau", "--seconds", str(seconds), "--decimation", "4", "--out", name
        )
        assert made.returncode == 0, made.stdout + made.stderr
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
