"""Everyday work needs no extra; where one is needed, the refusal names it with its pip line."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from journey import Installed
from screen import Screen

MODELS = Path(__file__).parents[2] / "examples" / "models"
BLOCKED = ("casadi", "pyarrow", "pinocchio", "pin", "pandas", "xarray", "mujoco", "fmpy",
           "distributed", "dask", "pooch", "pysindy", "sysidentpy", "textual_serve",
           "sklearn", "h5py")  # fmt: skip
BLOCKER = f"""
import sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {BLOCKED!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Blocker())
"""

SHORT = ("--period", "4", "--f-max", "2", "--periods", "1")
RECORD = """
import sys, zendsp
from pathlib import Path
machine, program = sys.argv[1:]
rec = zendsp.simulate(program, f"{machine}.toml", reference="motion.mat",
                      channels=["measured", "plant_torque"])
names = {"measured": "q", "plant_torque": "tau"}
rec.save("raw.csv")
lines = [li for li in Path("raw.csv").read_text().splitlines() if li[0] != "#"]
for old, new in names.items():
    lines[0] = lines[0].replace(old, new)
Path("run.csv").write_text("\\n".join(lines))
"""


@pytest.fixture
def slim(installed: Installed) -> Installed:
    """The installed wheel where the packages of every extra are missing."""
    folder = installed.folder / "blocked"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(BLOCKER)
    installed.env["PYTHONPATH"] = str(folder)
    blocked = installed.script("import pinocchio")
    assert "No module named 'pinocchio'" in blocked.stderr
    return installed


# More joints take up to a minute of two processors' work. CI has what they are made of: effects and
# bodies that are found (tests/diagnosis, sealed cases of two and six joints), and what the running
# program takes up (tests/e2e/test_story.py).
MORE_JOINTS = pytest.mark.long("the pendulum tells the same story; the parts have quicker tests")


@pytest.mark.timeout(500)
@pytest.mark.parametrize(
    ("machine", "effect"),
    [
        ("pendulum", "ripple"),
        pytest.param("imi_planar", "ripple", marks=MORE_JOINTS),
        pytest.param("wam7", "payload", marks=MORE_JOINTS),
    ],
)
def test_the_demo_needs_no_extra(slim: Installed, machine: str, effect: str) -> None:
    words = ("--machine", machine, "--effect", effect, "--seed", "1", "--out", "demo", "--json")
    demo = slim.run("demo", *words, timeout=350.0)
    assert demo.returncode == 0, demo.stdout + demo.stderr
    told = json.loads(demo.stdout)
    assert told["true"] and not told["why"] and told["lost"] == 0
    assert told["truth"][0]["effect"] == effect
    before, after = (told["tracking"][f"{when}_rad"] for when in ("before", "after"))
    assert any(new < 0.9 * old for new, old in zip(after, before, strict=True))
    assert told["fit"]["heldout"]["improved"] < told["fit"]["heldout"]["calibrated"]
    for name in ("report.html", "story.png", "train.mat", "heldout.mat", "work.mat", "model.toml"):
        assert (slim.folder / "demo" / name).stat().st_size > 200


def test_an_experiment_needs_no_extra(slim: Installed) -> None:
    made = slim.run("experiment", "electrical")
    assert made.returncode == 0, made.stdout + made.stderr


def test_the_link_records_a_csv_and_refuses_parquet_by_name(slim: Installed) -> None:
    slim.target("imi")
    assert slim.run("run", "pd.c", "-t", "imi").returncode == 0
    for name in ("run.csv", "run.mat"):
        got = slim.run("acquire", "q", "--seconds", "0.1", "--out", name, "-t", "imi")
        assert got.returncode == 0, got.stderr
    read = "import zendsp; print(len(zendsp.Recording.load('run.csv')))"
    assert int(slim.script(read).stdout) >= 50
    refused = slim.script("import zendsp; zendsp.Recording.load('run.csv').save('run.parquet')")
    assert "a Parquet file needs pyarrow: pip install 'zendsp[parquet]'" in refused.stderr


@pytest.mark.long("the demo records and diagnoses, tests/physics simulates; lost: without extras")
@pytest.mark.parametrize(
    ("machine", "program", "amplitude"),
    [
        ("imi_planar", "pd.c", "0.05"),
        ("pendulum", "pendulum_track.c", "0.5"),
        ("wam7", "wam_pd_gravity.c", "0.05"),
    ],
)
def test_a_shipped_machine_is_simulated_and_diagnosed(
    slim: Installed, machine: str, program: str, amplitude: str
) -> None:
    for file in MODELS.glob(f"{machine}.*"):
        shutil.copy(file, slim.folder)
    plan = ("reference", "multisine", "--machine", machine, "--out", "motion.mat")
    planned = slim.run(*plan, "--amplitude", amplitude, *SHORT)
    assert planned.returncode == 0, planned.stderr
    made = slim.script(RECORD, machine, program)
    assert made.returncode == 0, made.stderr
    if machine == "pendulum":
        said = slim.run("diagnose", "run.csv", "--model", f"{machine}.toml", "--jobs", "1")
        assert said.returncode == 0, said.stdout + said.stderr


def test_the_optimal_swing_is_refused_with_its_pip_line(slim: Installed) -> None:
    refused = slim.run("reference", "swing", "--machine", "pendulum", "--out", "swing.mat")
    assert refused.returncode != 0
    assert "the optimal swing needs casadi: pip install 'zendsp[swing]'" in refused.stderr


def test_the_terminal_starts_a_machine_shows_its_screens_and_ends(slim: Installed) -> None:
    screen = Screen(slim, (100, 30), "--local", "imi_planar", "--source", "pd.c")
    try:
        screen.until("○ empty")
        screen.keys(b"b")
        screen.until("Kp1")
        # F3, F4, F2
        for key, shown in (
            (b"\x1bOR", "acquire    q"),
            (b"\x1bOS", "headroom"),
            (b"\x1bOQ", "Kp1"),
        ):
            screen.keys(key)
            screen.until(shown)
        screen.keys(b"\x11")  # Ctrl+Q
        assert screen.ended() == 0, screen.text()
    finally:
        screen.end()
