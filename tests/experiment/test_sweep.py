"""Sweeps: many sets of parameters, measured on a real target."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from waiting import until

import zendsp
from zendsp.errors import AcquisitionError, VariableError
from zendsp.experiment.sweep import _unit, announced, tried_of, values_of
from zendsp.experiment.sweep_result import Sweep, SweepRun
from zendsp.link import Target, local
from zendsp_protocol.messages import VariableInfo


def test_the_unit_of_an_element_is_its_own() -> None:
    """A sweep wrote `rms e[0] [rad, rad, m]`."""
    infos = {"e": VariableInfo("e", "double", 3, unit="rad, rad, m")}
    assert [_unit(infos, f"e[{k}]") for k in range(3)] == ["rad", "rad", "m"]
    assert _unit(infos, "none") == "" and _unit(infos, "e[7]") == "rad, rad, m"


def test_values_are_read_as_they_are_typed() -> None:
    assert values_of("1,2.5") == [1.0, 2.5] and values_of("0:1:3") == [0.0, 0.5, 1.0]
    for text in ("", "1:2", "a", "1:2:0", "1:2:x"):
        with pytest.raises(VariableError, match="FIRST:LAST:COUNT"):
            values_of(text)
    with pytest.raises(VariableError, match="one value 2500 times"):
        values_of("500:500:2500")  # as MATLAB would count: from, step, to
    tried = tried_of(["Kp1=500:2500:5", "Kd1=60,120"])
    assert announced(tried, 2.0, 0.5, False) == (
        "sweep of 10 runs, 42 s at the least: Kp1 = 500 … 2500, Kd1 = 60 … 120"
    )
    assert tried_of(["Kp1=1,2", "Kd1=3"]) == {"Kp1": [1.0, 2.0], "Kd1": [3.0]}
    for text in ("1e999:5:3", "1,nan"):  # the dialog keeps open: the target would refuse it
        with pytest.raises(VariableError, match=r"^Kp1 = '.*': (1e999|nan) is no finite number"):
            tried_of([f"Kp1={text}"])
    with pytest.raises(VariableError, match="NAME=VALUES"):
        tried_of(["Kp1"])


@pytest.fixture(scope="module")
def fast() -> Iterator[Target]:
    with local("imi_planar", clock="fast", options=["--ideal", "--speed", "100"]) as target:
        yield target


def test_a_sweep_can_be_interrupted_within_a_measurement(fast: Target) -> None:
    shares: list[float] = []

    def interrupt(share: float) -> None:
        shares.append(share)
        if share > 0.6:
            raise KeyboardInterrupt

    fast.download("pd.c")
    fast.start()
    with pytest.raises(KeyboardInterrupt):
        zendsp.sweep(fast, {"Kp1": [700.0, 800.0]}, ["e1"], seconds=60.0, progress=interrupt)
    assert 0.5 < shares[-1] < 1.0 and fast["Kp1"] == 2000.0


def test_a_sweep_measures_every_combination_and_puts_the_parameters_back(
    fast: Target, tmp_path: Path
) -> None:
    fast.download("pd.c")
    fast.update(turn_time=2.0)
    fast.start()
    until(lambda: fast.status().t > 2.0, "the arm is on its circle")
    before = fast.parameters().values
    found = zendsp.sweep(  # one turn each
        fast, {"Kp1": [500.0, 2000.0], "Kd1": [60.0, 120.0]}, ["e1"], seconds=2.0, settle=0.5,
        keep=tmp_path / "kept",
    )  # fmt: skip
    assert [(r["Kp1"], r["Kd1"]) for r in found.rows] == [
        (500.0, 60.0), (500.0, 120.0), (2000.0, 60.0), (2000.0, 120.0)
    ]  # fmt: skip
    assert found.results == ("rms e1", "max e1") and found.best()["Kp1"] == 2000.0
    assert fast.parameters().values == before
    kept = zendsp.Recording.load(tmp_path / "kept" / "003.mat")
    assert kept.parameters["Kp1"] == 2000.0 and len(kept) == 2500
    assert found.rows[2]["rms e1"] == pytest.approx(np.sqrt(np.mean(kept["e1"][500:] ** 2)))
    assert found.save(tmp_path / "s.csv").read_text().startswith("Kp1,Kd1,rms e1,max e1,ended\n")
    assert "4 runs: rms e1 is least" in repr(found) and "<table>" in found._repr_html_()
    assert " rad, at Kp1 = 2000" in repr(found), "with its unit"
    assert found.header == [
        "Kp1 [N m/rad]", "Kd1 [N m s/rad]", "rms e1 [rad]", "max e1 [rad]", "ended"
    ]  # fmt: skip
    with pytest.raises(AcquisitionError, match="no result 'x'"):
        found.best("x")
    with pytest.raises(AcquisitionError, match="4 recordings of another sweep"):
        zendsp.sweep(fast, {"Kp1": [500.0]}, ["e1"], seconds=2.0, keep=tmp_path / "kept")


def test_equal_gains_are_not_ranked_and_different_ones_are(fast: Target) -> None:
    fast.download("pd.c")
    fast.update(turn_time=2.0)
    fast.start()
    until(lambda: fast.status().t > 2.0, "the arm is on its circle")
    alike = [1999.9, 1999.95, 2000.0, 2000.05, 2000.1]
    found = zendsp.sweep(fast, {"Kp1": alike}, ["e1"], seconds=0.3, settle=0.2)
    assert len(found.again) == 2
    assert [row[0] for row in found.cells()] == ["1999.9", "1999.95", "2000", "2000.05", "2000.1"]
    gains = {"Kp1": [500.0, 1000.0, 2000.0]}
    found = zendsp.sweep(fast, gains, ["e1"], seconds=2.0, settle=1.0)  # one turn
    assert "rms e1 is least" in repr(found) and "at Kp1 = 2000; its values" in repr(found)
    assert len(found.rows) == 3 and len(found.again) == 2
    assert found.spread() < 0.05 * found.best().results["rms e1"] and found.best_rows() == [2]


def test_the_best_of_a_sweep_is_named_although_the_worst_varies_more(fast: Target) -> None:
    """The poor repeatability at bad gains had been taken for that of good ones."""
    fast.download("pd.c")
    fast.update(turn_time=2.0)
    fast.start()
    until(lambda: fast.status().t > 2.0, "the arm is on its circle")
    found = zendsp.sweep(fast, {"Kp1": [300.0, 1500.0, 4000.0]}, ["e1"], seconds=2.0, settle=0.2)
    assert found.again_of == found.best_row() == 2
    most = found.rows[0].results["rms e1"]
    assert all(row["rms e1"] < most for row in found.again), "it is that one, again"


@pytest.mark.parametrize(("second", "rows"), [(0.0041, [0, 1]), (0.0049, [0])])
def test_a_difference_within_the_repeatability_is_no_difference(
    second: float, rows: list[int]
) -> None:
    """The first value, measured three times, varies by 0.0002."""
    measured = [
        SweepRun({"Kp1": gain}, {"rms e1": rms})
        for gain, rms in ((2000.0, 0.0040), (1500.0, second))
    ]
    again = ({"rms e1": 0.0039}, {"rms e1": 0.0041})
    found = Sweep(("Kp1",), ("rms e1",), tuple(measured), again)
    assert found.spread() == pytest.approx(0.0002) and found.best_rows() == rows
    assert ("rms e1 of the best 2 differs by no more than chance" in repr(found)) is (len(rows) > 1)


def test_every_value_is_checked_before_the_first_run(fast: Target) -> None:
    fast.download("pd.c")
    fast.start()
    with pytest.raises(VariableError, match="Kp1"):
        zendsp.sweep(fast, {"Kp1": [600.0, 1e9]}, ["e1"], seconds=0.1)
    assert fast["Kp1"] == 2000.0 and 600.0 not in [c.new for c in fast.log()]
    with pytest.raises(AcquisitionError, match="2 of Kp1, 1 of Kd1"):
        zendsp.sweep(fast, {"Kp1": [1, 2], "Kd1": [1]}, ["e1"], seconds=0.1, together=True)
    with pytest.raises(AcquisitionError, match="no measure 'median'"):
        zendsp.sweep(fast, {"Kp1": [1]}, ["e1"], seconds=0.1, measures=["median"])


def test_a_run_that_trips_ends_the_sweep_and_says_why(fast: Target) -> None:
    fast.download("pd.c")
    fast.start()
    until(lambda: fast.status().t > 2.0, "the arm is on its circle")
    fast.update(approach_time=0.1)
    try:
        # 1.3 rad within 0.1 s ask for more than 245 N m
        found = zendsp.sweep(
            fast, {"center1": [0.2, 1.5, 0.2]}, ["e1"], seconds=1.0, settle=0.0, fade=0.0
        )
        assert len(found.rows) == 2 and "exceeds the limit" in found.rows[1].ended
        assert found.best()["center1"] == 0.2 and fast["center1"] == 0.2
        assert found.ended == f"run 2: {found.rows[1].ended}" and found.ended in repr(found)
    finally:
        fast.acknowledge()


def test_a_trip_while_parameters_are_put_back_is_reported(fast: Target) -> None:
    fast.download("pd.c")
    fast.start()
    until(lambda: fast.status().t > 2.0, "the arm is on its circle")
    fast.update(approach_time=0.1)  # 1.3 rad back within 0.1 s ask for more than 245 N m
    there = {"center1": [1.5], "approach_time": [3.0]}
    try:
        found = zendsp.sweep(fast, there, ["e1"], seconds=0.5, settle=3.0, fade=0.0)
        assert found.rows[0].ended == "" and fast["center1"] == 0.2
        assert found.ended.startswith("the parameters were put back: ")
        assert "exceeds the limit" in found.ended and found.ended in repr(found)
    finally:
        fast.acknowledge()


def test_a_sweep_without_a_complete_run_says_why() -> None:
    rows = (SweepRun({"Kp1": 1.0}, ended="joint 1: too fast"),)
    found = Sweep(("Kp1",), ("rms e1",), rows, ended="run 1: joint 1: too fast")
    assert "no run came to its end" in repr(found) and "joint 1: too fast" in repr(found)


def test_a_sweep_may_change_several_parameters_together(fast: Target) -> None:
    fast.download("pd.c")
    fast.start()
    found = zendsp.sweep(
        fast, {"Kp1": [500.0, 1500.0], "Kd1": [60.0, 90.0]}, ["q"], seconds=0.2, settle=0.0,
        measures=["p2p"], together=True,
    )  # fmt: skip
    assert [(r["Kp1"], r["Kd1"]) for r in found.rows] == [(500.0, 60.0), (1500.0, 90.0)]
    assert found.results == ("p2p q[0]", "p2p q[1]")
