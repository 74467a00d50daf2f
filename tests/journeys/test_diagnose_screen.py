"""Somebody's CSV, the fourth screen of the terminal, and a better model: by keys and by mouse."""

from __future__ import annotations

import tomllib

import pytest
from journey import BENCH, Installed, record_bench
from screen import Screen
from waiting import until


@pytest.mark.long("tests/tui has its keys and clicks in one process; lost: a real terminal")
@pytest.mark.timeout(300)  # the diagnosis goes at low priority
def test_a_csv_is_diagnosed_in_the_terminal_and_the_better_model_saved(
    installed: Installed,
) -> None:
    record_bench(installed.folder / "run.csv")
    (installed.folder / "bench.toml").write_text(BENCH)
    screen = Screen(installed, (100, 32), "--screen", "diagnose")
    try:
        screen.until("model  ")
        screen.keys(b"a")
        screen.until("Add recordings")
        screen.keys(b"run.csv\r")
        screen.until("run.csv")
        screen.until("bench.toml")  # the model that lies here is taken
        screen.keys(b"s")
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
