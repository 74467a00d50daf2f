"""Many recordings, each on its own: local processes, and a Dask cluster where it is installed."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import reality
from reality import KNOWN, RATE

from zendsp import cluster
from zendsp.diagnosis.fleet import Item, diagnose_each, stems, table
from zendsp.errors import LinkError, ZendspError


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three machines of one kind: healthy, with more friction than the model knows, and with a
    broken recording.
    """
    folder = tmp_path_factory.mktemp("fleet")
    for name, machine in (("one", reality.Machine()), ("two", reality.Machine(drag=0.005))):
        reality.save(
            folder / f"{name}.csv", reality.simulate(machine, reality.multisine(6.0, RATE, 4), RATE)
        )
    (folder / "three.csv").write_text("t,q,u\n0,0,0\n")
    reality.model_file(folder / "model.toml", RATE, *KNOWN)
    return folder


@pytest.fixture(scope="module")
def here(fleet: Path) -> list[Item]:
    """All three, diagnosed in this process."""
    runs = [fleet / f"{name}.csv" for name in ("one", "two", "three")]
    return diagnose_each(runs, fleet / "model.toml")


def test_each_recording_gets_its_own_diagnosis_in_its_own_process(
    fleet: Path, tmp_path: Path, typed: Callable[..., tuple[object, str, str]]
) -> None:
    runs = [fleet / f"{n}.csv" for n in ("one", "two", "three")]
    options = ("--each", "--jobs", 2, "--out", tmp_path, "--no-figures", "--json")
    status, out, _ = typed("diagnose", *runs, "--model", fleet / "model.toml", *options)
    assert status == 0
    rows = json.loads(out)
    assert [Path(r["recording"]).name for r in rows] == ["one.csv", "two.csv", "three.csv"]
    assert [r["report"] and r["report"]["verdict"] for r in rows] == ["complete", "missing", None]
    assert rows[1]["report"]["findings"][0]["effect"] == "quadratic_drag"
    assert "three.csv" in rows[2]["error"] and "samples" in rows[2]["error"]
    assert all((tmp_path / name / "report.json").exists() for name in ("one", "two"))
    assert not (tmp_path / "three").exists()


def test_table_has_one_line_a_recording(here: list[Item]) -> None:
    lines = table(here[1:]).splitlines()
    assert "quadratic_drag (joint 1) coefficient 0.00" in lines[1] and "missing" in lines[1]
    assert "unusable" in lines[2]
    assert lines[-1] == "quadratic_drag, joint 1: in 1 of 1 recordings"


def test_recordings_of_the_same_name_get_folders_of_their_own() -> None:
    assert stems(["/a/run.csv", "/b/run.csv", "/c/other.csv.gz"]) == ["1_run", "2_run", "other"]


def test_all_recordings_unusable_is_an_error(
    fleet: Path, typed: Callable[..., tuple[object, str, str]]
) -> None:
    words = ("--model", fleet / "model.toml", "--each")
    status, _, err = typed("diagnose", fleet / "three.csv", *words)
    assert status == 2 and "three.csv" in err


def test_without_dask_the_scheduler_option_says_what_to_install(
    fleet: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)  # as if it were not installed
    with pytest.raises(ZendspError, match=r"zendsp\[fleet\]"):
        diagnose_each([fleet / "one.csv"], fleet / "model.toml", scheduler="tcp://127.0.0.1:8786")


def test_on_a_dask_cluster_the_outcome_is_the_same(fleet: Path, here: list[Item]) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        there = diagnose_each(
            [fleet / "two.csv"], fleet / "model.toml",
            scheduler=cluster.scheduler_address,
        )
    (a,), b = there, here[1]
    assert a.report is not None and b.report is not None
    assert {**a.report, "seconds": 0} == {**b.report, "seconds": 0}


def test_a_scheduler_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(cluster, "ANSWER_S", 0.5)
    with pytest.raises(LinkError, match=r"127\.0\.0\.1:9' within 0\.5 s"):
        diagnose_each(["x.csv"], "m.toml", scheduler="tcp://127.0.0.1:9")


def test_a_process_that_searches_a_joint_ends_with_the_one_that_started_it() -> None:
    """After a diagnosis was killed, two of its processes had gone on, one of them waiting for ever.
    """
    code = (
        "import os, time; from zendsp.diagnosis.explain import joints; parent = os.getpid()\n"
        "if os.fork() == 0:\n"
        "    joints._inherit(parent, None, None, print); print(1, flush=True)\n"
        "time.sleep(60)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    assert parent.stdout.readline()
    parent.kill()
    parent.wait()
    begin = time.monotonic()
    parent.stdout.read()  # ends with the child
    assert time.monotonic() - begin < 20.0
