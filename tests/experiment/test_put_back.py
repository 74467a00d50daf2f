"""Whoever sets something in the program for a run puts it back: a later start does what it did."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from waiting import until as wait_for

import zendsp
from zendsp.experiment import Lab, run_experiment
from zendsp.experiment.separating import run_reference
from zendsp.link import Target, local
from zendsp.link.put_back import Before
from zendsp.physics import load_model
from zendsp.reference import make_reference

MODEL = Path(__file__).parents[2] / "examples" / "models" / "imi_planar.toml"
OWN_ROWS = np.array([[0.1, 0.2], [0.12, 0.21], [0.15, 0.25]])


@pytest.fixture(scope="module")
def arm() -> Iterator[Target]:
    with local("imi_planar", clock="fast", options=["--ideal", "--speed", "100"]) as target:
        yield target


def respond(target: Target, progress: Any = None) -> None:
    zendsp.frequency_response(
        target, f_min=4.0, f_max=20.0, lines=4, periods=2, amplitude=0.004, progress=progress
    )


def separate(target: Target, progress: Any = None) -> None:
    motion = make_reference("point_to_point", "imi_planar", start=0.0, goal=0.2, duration=0.5)
    run_reference(target, motion, load_model(MODEL))


def try_values(target: Target, progress: Any = None) -> None:
    target.start()
    name, values = ("Kp1", [1900.0]) if "Kp1" in target.variables() else ("bandwidth", [2.0])
    zendsp.sweep(target, {name: values}, ["q"], seconds=0.1, settle=0.0, progress=progress)
    target.pause()


def is_as(target: Target, values: dict[str, Any]) -> None:
    for name, value in values.items():
        assert np.array_equal(target[name], value), name


def all_values(target: Target) -> dict[str, Any]:
    names = [i.name for i in target.variables().values() if i.kind in ("parameter", "table")]
    return {name: target[name] for name in names}


@pytest.mark.parametrize("program", ["pd.c", "joint_pd.c"])
@pytest.mark.parametrize("run", [respond, separate, try_values])
@pytest.mark.parametrize("rows", [OWN_ROWS, OWN_ROWS[:0]], ids=["own-rows", "no-rows"])
def test_a_run_leaves_parameters_and_tables_as_they_were(
    run: Callable[[Target], None], program: str, rows: np.ndarray, arm: Target
) -> None:
    arm.download(program)
    arm.update(row_rate=777, approach_time=1.25, hold=False, ref=rows)
    before = all_values(arm)
    run(arm)
    assert arm.status().state == "paused"
    is_as(arm, before)


@pytest.mark.parametrize("run", [respond, try_values])
def test_so_does_one_that_is_interrupted(run: Callable[..., None], arm: Target) -> None:
    def interrupt(share: float) -> None:
        if share > 0.3:
            raise KeyboardInterrupt

    arm.download("pd.c")
    before = all_values(arm)
    with pytest.raises(KeyboardInterrupt):
        run(arm, interrupt)
    is_as(arm, before)


def test_a_program_that_holds_goes_on_holding_where_it_stood() -> None:
    with local("imi_planar", options=["--ideal"]) as target:
        target.download("joint_pd.c")
        target.update(ref=OWN_ROWS, row_rate=777, approach_time=0.2)
        target.start()
        target.acquire(["r"], 1.0)
        zendsp.frequency_response(
            target, f_min=4.0, f_max=20.0, lines=4, periods=2, amplitude=0.002, rehearsed=False
        )
        assert target.status().state == "running" and target["row_rate"] == 777
        held = target.acquire(["r"], 0.5).data
        assert np.ptp(held, axis=0).max() == 0.0, "its own rows would have begun anew"
        target.pause()
        target.start()
        again = target.acquire(["r"], 1.0).data
        assert np.abs(again - held[0]).max() < 1e-9, "nor does a start swing once more"


@pytest.mark.parametrize("interrupted", [False, True])
def test_an_experiment_leaves_the_program_that_was_loaded(
    interrupted: bool, arm: Target, tmp_path: Path
) -> None:
    arm.download("pd.c")
    arm.update(Kp1=1234.0, ref=OWN_ROWS)
    before = all_values(arm)
    said: list[str] = []

    def say(text: str) -> None:
        said.append(text)
        if interrupted and len(said) == 2:
            raise KeyboardInterrupt

    with warnings.catch_warnings(record=True) as warned:
        try:
            run_experiment("friction", Lab(tmp_path, arm, say))
        except KeyboardInterrupt:
            assert interrupted
    status = arm.status()
    if status.trip is None:
        assert list(arm.program().sources) == ["pd.c"] and status.state == "loaded"
        is_as(arm, before)
    else:
        assert status.state == "empty" and "pd.c is not loaded any more" in str(warned[-1])
        arm.acknowledge()


def test_nothing_is_written_into_another_program(arm: Target) -> None:
    arm.download("pd.c")
    before = Before(arm, ["use_table", "row_rate", "no_such_name"])
    arm.download("joint_pd.c")
    own = all_values(arm)
    assert before.put_back() == ""
    is_as(arm, own)


@pytest.mark.filterwarnings("ignore::zendsp.errors.EndedWarning")
@pytest.mark.parametrize(
    ("moves", "policy", "state", "row_rate"),
    [
        (True, "stop", "stopped", 777),
        (False, "stop", "running", 777),
        (True, "finish", "running", 1000),
    ],
)
def test_what_a_lost_host_had_set_is_put_back(
    moves: bool, policy: str, state: str, row_rate: int
) -> None:
    with local("imi_planar") as target:
        target.download("pd.c")
        target.update(row_rate=777, ref=OWN_ROWS)
        target.set_host_lost(policy)
        target.start()
        lost = zendsp.connect(target.name)
        Before(lost, ["row_rate", "ref"], moves=moves)
        lost.update(row_rate=1000, ref=OWN_ROWS[:2])
        lost.close()
        wait_for(lambda: len(target.status().hosts) == 1, "its host is gone")
        wait_for(lambda: target.status().drive == state, f"{state}: {target.status().drive}")
        wait_for(lambda: target["row_rate"] == row_rate, f"row_rate {row_rate}")
        assert target.status().drive == state
        assert np.array_equal(target["ref"], OWN_ROWS) == (row_rate == 777)


@pytest.mark.filterwarnings("ignore::zendsp.errors.EndedWarning")
def test_runs_of_a_lost_host_are_put_back_the_last_first_unless_another_commands() -> None:
    with local("imi_planar") as target:
        target.download("pd.c")
        for commands, left in ((False, 2000.0), (True, 1800.0)):
            lost = zendsp.connect(target.name)
            for value in (1900.0, 1800.0):
                before = Before(lost, ["Kp1"])
                lost.update(Kp1=value)
            if commands:
                target.take_command()
                assert "exclusive right" in before.put_back()
            lost.close()
            wait_for(lambda: len(target.status().hosts) == 1, "its host is gone")
            wait_for(lambda left=left: target["Kp1"] == left, f"Kp1 {left}")  # type: ignore[misc]


def test_what_cannot_be_put_back_is_said() -> None:
    with local("imi_planar", clock="fast") as target:
        target.download("pd.c")
        before = Before(target, ["use_table", "row_rate"])
        nothing = Before(target, ["absent"])
    assert before.put_back().startswith("not all of use_table, row_rate is put back: ")
    assert nothing.put_back().startswith("the target did not hear that the run ended: ")
