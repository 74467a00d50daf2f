"""Children of the proof end with their parent, however it ends, within their limit; a cluster may
run them.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path

import pytest
from waiting import PATIENCE_S, until

from zendsp.proof import children
from zendsp.proof.build_case import Request
from zendsp.proof.cases import write_all
from zendsp.proof.score import answers, diagnose
from zendsp.proof.seal import open_truth
from zendsp_isr.build import cache_root


def gone(pid: int) -> bool:
    """The process has ended; one that nobody has waited for is a zombie, and has."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def test_cpu_seconds_and_status_of_a_child_are_known(tmp_path: Path) -> None:
    busy = "import sys, time\nwhile time.process_time() < 0.3: pass\nsys.exit('no such column')"
    ended = children.run([sys.executable, "-c", busy], tmp_path, 60.0)
    assert ended.status == 1 and ended.last_words == "no such column"
    assert 0.3 <= ended.cpu <= ended.seconds + 0.5


def test_a_child_keeps_what_python_compiled_but_not_beside_the_sources(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    code = "import sys; print(sys.dont_write_bytecode, sys.pycache_prefix)"
    line = [sys.executable, "-c", code]
    said = subprocess.run(line, env=children.environment(), capture_output=True, text=True)
    assert said.stdout.split() == ["False", str(cache_root() / "python")]


def test_child_is_ended_at_its_limit_with_what_it_started(tmp_path: Path) -> None:
    note = tmp_path / "grandchild"
    code = (
        "import pathlib, subprocess, sys, time\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])\n"
        f"pathlib.Path({str(note)!r}).write_text(str(child.pid))\ntime.sleep(600)"
    )
    ended = children.run([sys.executable, "-c", code], tmp_path, 3.0)
    assert ended.status is None
    if note.exists():  # on a very busy machine it may not have come so far
        until(lambda: gone(int(note.read_text())), "the grandchild ends")


PARENT = """
import sys, time
from pathlib import Path
from zendsp.proof import children
from zendsp.proof.answer import Answer
from zendsp.proof.score import answers

root = Path(sys.argv[1])
sys.path.insert(0, str(root))

def ask(folder, out, limit):
    children.run(children.module("sleeper", str(root / folder.name)), out, limit)
    return Answer("complete")

list(answers([root / "a", root / "b", root / "c"], root / "log.json", 2, 600.0, ask))
"""
SLEEPER = (
    "import os, pathlib, sys, time\n"
    "pathlib.Path(sys.argv[-1]).write_text(str(os.getpid()))\n"
    "time.sleep(600)\n"
)


def started(tmp_path: Path) -> tuple[subprocess.Popen[bytes], list[int]]:
    """A proof with two children that sleep, and their process ids."""
    (tmp_path / "sleeper.py").write_text(SLEEPER)
    env = {**os.environ, "PYTHONPATH": str(tmp_path)}
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, str(tmp_path)], env=env, stderr=subprocess.PIPE
    )
    notes = [tmp_path / "a", tmp_path / "b"]
    until(lambda: all(n.exists() and n.read_text() for n in notes), "both children run")
    return parent, [int(n.read_text()) for n in notes]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the kernel's word is Linux's")
def test_children_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    parent, pids = started(tmp_path)
    parent.kill()
    parent.wait()
    for pid in pids:
        until(lambda pid=pid: gone(pid), "a child ends with its parent")  # type: ignore[misc]


def test_interrupt_ends_the_children_and_leaves_at_once(tmp_path: Path) -> None:
    parent, pids = started(tmp_path)
    parent.send_signal(signal.SIGINT)
    until(lambda: parent.poll() is not None, "the parent leaves")
    assert all(gone(pid) for pid in pids)
    assert not (tmp_path / "c").exists()  # what waited is never begun


def test_a_thread_that_comes_late_begins_no_child_once_all_are_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    late, end_all = threading.Event(), children.end_all

    def begin() -> None:
        late.wait(PATIENCE_S)
        children.run([sys.executable, "-c", "pass"], tmp_path / "late", 600.0)

    def ended() -> None:
        end_all()
        late.set()

    monkeypatch.setattr(children, "end_all", ended)
    begun = []

    def interrupted() -> None:
        with children.workers(children.threads(1)) as pool:
            begun.append(pool.submit(begin))
            until(begun[0].running, "a thread has it")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with pytest.raises(InterruptedError):
        begun[0].result()
    ended_well = children.run([sys.executable, "-c", "pass"], tmp_path / "after", 600.0)
    assert ended_well.status == 0, "the next run of the same process"


STAND_IN = """
import json, os, pathlib, sys
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
report = {"verdict": "complete", "findings": [], "where": {"time": [], "state": []},
          "fit": {"heldout": {"calibrated": 1.0, "improved": 1.0}, "noise_floor": float(os.getppid())}}
(out / "report.json").write_text(json.dumps(report))
"""  # noqa: E501


@pytest.mark.long("tests/diagnosis/test_fleet.py has a cluster; lost: that proof's work goes there")
def test_cases_are_made_and_asked_on_a_dask_cluster(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    wanted = [Request(71, "complete", "rotary"), Request(72, "complete", "pendulum")]
    here = write_all(wanted, tmp_path / "c", tmp_path / "t")
    (tmp_path / "stand_in.py").write_text(STAND_IN)
    ask = partial(diagnose, command=(sys.executable, str(tmp_path / "stand_in.py")))
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        address = cluster.scheduler_address
        there = write_all(wanted, tmp_path / "dc", tmp_path / "dt", scheduler=address)
        folders = sorted((tmp_path / "dc").iterdir())
        said = dict(answers(folders, tmp_path / "r.json", 1, PATIENCE_S, ask, scheduler=address))
    assert here == there and len(open_truth(tmp_path / "dt", there)) == 2
    assert set(said) == {f.name for f in folders}
    # the parent of the command, which it gave as its noise floor, is the worker
    assert all(a.verdict == "complete" and a.noise_floor != os.getpid() for a in said.values())
