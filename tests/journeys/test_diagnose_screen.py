"""Somebody's CSV, the fourth screen of the terminal, and a better model: by keys and by mouse."""

from __future__ import annotations

import tomllib
from math import sin, tanh
from pathlib import Path

import numpy as np
import pytest
from journey import BENCH, STEP, Installed
from screen import Screen
from waiting import until


def _record(path: Path, coulomb: float = 0.05, inner: int = 20) -> None:
    """A PD-controlled joint with dry friction that the model does not have."""
    h = STEP / inner
    q = qd = 0.0
    rows = []
    for k in range(1000):
        t = k * STEP
        r = sum(0.3 * sin(w * t + p) for w, p in ((2.1, 0.0), (5.3, 1.0), (9.7, 2.0)))
        seen = round(q / 1e-5) * 1e-5
        u = 4.0 * (r - seen) - 0.2 * qd
        rows.append((t, seen, u))
        for _ in range(inner):
            qd += h * (u - coulomb * tanh(qd / 1e-3)) / 0.01
            q += h * qd
    np.savetxt(path, rows, delimiter=",", header="t,q,u", comments="")


@pytest.mark.timeout(300)  # the diagnosis goes at low priority
def test_a_csv_is_diagnosed_in_the_terminal_and_the_better_model_saved(
    installed: Installed,
) -> None:
    _record(installed.folder / "run.csv")
    (installed.folder / "bench.toml").write_text(BENCH)
    screen = Screen(installed, (100, 32), "--screen", "diagnose")
    try:
        screen.until("model  ")
        screen.keys(b"a")
        screen.until("Add recordings")
        screen.keys(b"run.csv\r")
        screen.until("run.csv")
        screen.until("bench.toml")  # the model that lies here is taken
        screen.click("Start s")
        screen.until("reading the recordings")
        screen.keys(b"\x03")
        screen.until("— cancelled —")
        screen.click("Start s")
        screen.until("Missing physics: dry friction (coulomb")
        screen.until("without coulomb")
        until(
            lambda: any(0x2800 < ord(c) <= 0x28FF for c in screen.text()),
            "the curves, beside their names",
            screen.text,
        )
        kept = installed.folder / "diagnoses"  # it is there once its pictures are drawn
        until(lambda: list(kept.glob("[!.]*/report.html")), "the report is whole", screen.text)
        screen.until("Save w")
        screen.click("Save w")
        screen.until("Save the improved model")
        screen.keys(b"\r")
        screen.until("saved")  # what the short message says
        screen.keys(b"\x11")
        assert screen.ended() == 0
    finally:
        screen.end()
    model = tomllib.loads((installed.folder / "bench_improved.toml").read_text())
    found = {e["kind"]: e for e in model["effect"]}
    level = found["coulomb"]["level"]
    level = level["value"] if isinstance(level, dict) else level
    # the tanh over 1 mrad/s and the filter of the speed leave a per cent
    assert abs(level - 0.05) < 0.003
    assert len(list((installed.folder / "diagnoses").glob("*/report.html"))) == 1
