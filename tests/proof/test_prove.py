"""`zendsp prove`: truth is sealed before and opened after, runs resume, and a page reports all."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from waiting import PATIENCE_S, status_of, until

from zendsp.proof import cases, programme, run_proof
from zendsp.proof.answer import Answer, Finding
from zendsp.proof.build_case import NoUsableCase, Request
from zendsp.proof.mujoco.programme import of_bodies
from zendsp.proof.programme import LACK_NOTHING, REALITIES, requests
from zendsp.proof.seal import BrokenSeal, open_truth, write_truth

FEW = [Request(71, "complete", "rotary"), Request(72, "single", "rotary", "ripple", 1.0)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> programme.Prepared:
    """The few cases, made once: tests look at copies."""
    return programme.prepare(tmp_path_factory.mktemp("few"), FEW, 1)


@pytest.fixture
def made(whole: programme.Prepared, tmp_path: Path) -> Path:
    """A folder in which they are made."""
    return Path(shutil.copytree(whole.folder, tmp_path / "made"))


def say(verdict: str, *effects: str) -> Answer:
    return Answer(verdict, tuple(Finding(e, 1, confidence=0.9) for e in effects), seconds=1.0)


def go(folder: Path) -> run_proof.Outcome:
    return run_proof.run_proof(
        programme.prepare(folder, FEW, 1), jobs=1, limit=1.0, with_peers=False,
        command="zendsp prove --quick", tell=lambda _: None,
    )


def answer_with(monkeypatch: pytest.MonkeyPatch, table: dict[str, Answer]) -> list[str]:
    asked: list[str] = []

    def fake(folders: list[Path], *_: object, **__: object) -> list[tuple[str, Answer]]:
        asked.extend(f.name for f in folders)
        return [(f.name, table[f.name]) for f in folders]

    monkeypatch.setattr(run_proof, "answers", fake)
    return asked


def test_run_counts_and_writes_the_page(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answer_with(monkeypatch, {"case_0001": say("complete"), "case_0002": say("missing", "ripple")})
    outcome = go(made)
    assert [j.alarm for j in outcome.judged] == [False, None] and outcome.judged[1].named is True
    page = outcome.page.read_text()
    assert (
        outcome.stamp in page and "zendsp prove --quick" in page and "Nothing in this run." in page
    )


def test_a_sample_is_drawn_before_anything_is_made_as_many_of_each_reality() -> None:
    few = requests(3, False, ("own", "mujoco"), 7)
    assert len(few) == 7 and sum(r.reality == "own" for r in few) == 4
    assert {r.reality for r in requests(3, False, REALITIES, 3)} == set(REALITIES)
    assert (
        few == requests(3, False, ("own", "mujoco"), 7) != requests(4, False, ("own", "mujoco"), 7)
    )
    every = requests(3, False, ("own", "mujoco"))
    assert all(r in every for r in few)
    assert len({r.seed for r in every}) == len(every)


def test_nulls_are_the_machines_that_lack_nothing_of_every_reality_600_and_more() -> None:
    nulls = requests(3, False, REALITIES, nulls=True)
    every = requests(3, False, REALITIES)
    assert {r.kind for r in every if r.kind in LACK_NOTHING} == set(LACK_NOTHING)
    assert nulls == [r for r in every if r.kind in LACK_NOTHING] and len(nulls) == 702
    assert {r.reality for r in requests(3, False, REALITIES, 9, nulls=True)} == set(REALITIES)


@pytest.mark.parametrize("seed", [0, 1, 7])
def test_a_small_sample_holds_every_sort_of_case(seed: int) -> None:
    few = requests(seed, True, REALITIES, 17)
    assert len(few) == 17 == len({(r.reality, r.seed) for r in few})
    for reality in REALITIES:
        kinds = lambda of, reality=reality: {r.kind for r in of if r.reality == reality}  # noqa: E731
        assert kinds(few) == kinds(requests(seed, True, (reality,)))
    assert any(of_bodies(r) for r in few)
    assert not any(of_bodies(r) for r in requests(seed, True, ("mujoco",), 1)), "no room for all"


def test_what_ci_judges_holds_an_effect_a_body_a_foreign_torque_and_a_complete_machine() -> None:
    script = (Path(__file__).parents[2] / ".ci" / "run").read_text()
    sample, seed = re.findall(r"--sample (\d+) --seed (\d+)", script)[0]
    few = requests(int(seed), True, REALITIES, int(sample))
    assert {r.reality for r in few} == set(REALITIES)
    assert {r.kind for r in few} == {"single", "foreign", "complete"}
    assert any(of_bodies(r) for r in few) and not all(of_bodies(r) for r in few)


def test_what_a_reality_cannot_fill_of_a_sample_goes_to_the_others() -> None:
    held = Counter(r.reality for r in requests(0, True, REALITIES, 30))
    assert held == {"machines": 4, "own": 14, "mujoco": 12}
    assert len(requests(0, True, REALITIES, 99)) == len(requests(0, True, REALITIES)) == 36


def test_the_same_body_cases_are_asked_given_as_mjcf_beside_urdf() -> None:
    plain = requests(0, False, ("own", "mujoco"))
    both = requests(0, False, ("own", "mujoco"), given="mjcf")
    twins = [r for r in both if r.given == "mjcf"]
    assert [r for r in both if not r.given] == plain and len(twins) > 8
    assert all(replace(r, given="") in plain for r in twins)
    names = {name for r in twins for name in r.effect.split("+")}
    assert {"payload", "heavier", "com", "base_tilt"} <= names and "lag" not in names
    assert {r.machine for r in twins} == {"mj_arm6", "mj_arm7"}
    # a sample is drawn first: its cases are those of a run without
    few = requests(3, False, ("mujoco",), 40, given="mjcf")
    assert [r for r in few if not r.given] == requests(3, False, ("mujoco",), 40)


def test_failures_are_on_the_page(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answer_with(monkeypatch, {"case_0001": say("missing", "coulomb"), "case_0002": say("complete")})
    page = go(made).page.read_text()
    assert "case_0001 rotary complete" in page and "truth ripple; said complete" in page


def test_truth_altered_while_diagnosing_stops_the_proof(
    made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def meddling(folders: list[Path], *_: object, **__: object) -> list[tuple[str, Answer]]:
        write_truth(made / "truth", "case_0002", {"case": "case_0002", "effects": []})
        return [(f.name, say("complete")) for f in folders]

    monkeypatch.setattr(run_proof, "answers", meddling)
    with pytest.raises(BrokenSeal):
        go(made)


def test_second_run_keeps_the_cases_and_other_cases_are_refused(made: Path) -> None:
    first = programme.prepare(made, FEW, 1)
    before = (made / "cases" / "case_0001" / "model.toml").stat().st_mtime_ns
    assert programme.prepare(made, FEW, 1) == first == programme.found(made)
    assert (made / "cases" / "case_0001" / "model.toml").stat().st_mtime_ns == before
    with pytest.raises(FileExistsError, match="another run"):
        programme.prepare(made, FEW[:1], 1)


def test_interrupted_making_goes_on_to_the_same_cases(
    whole: programme.Prepared, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, write = [], cases.write_case

    def cut(order: cases.Order) -> str:
        if made:
            raise KeyboardInterrupt
        made.append(order)
        return write(order)

    monkeypatch.setattr(cases, "write_case", cut)
    with pytest.raises(KeyboardInterrupt):
        programme.prepare(tmp_path / "cut", FEW, 1)
    with pytest.raises(FileNotFoundError, match="no finished cases"):
        programme.found(tmp_path / "cut")
    monkeypatch.setattr(cases, "write_case", write)
    assert programme.prepare(tmp_path / "cut", FEW, 1).stamp == whole.stamp


def test_programme_holds_what_is_promised() -> None:
    quick, full = requests(0, True), requests(0, False)
    assert {r.machine for r in full} == {"rotary", "linear", "pendulum", "planar2r", "urdf"}
    both = requests(0, False, REALITIES)
    silent = ("complete", "complete_slow", "nuisance", "hard_complete")
    for reality in ("own", "mujoco"):  # a bound of 2 % needs 149 silent
        assert sum(r.kind in silent for r in both if r.reality == reality) >= 250
        foreign = [r for r in both if r.kind == "foreign" and r.reality == reality]
        assert len({r.effect for r in foreign}) >= 30 and min(r.size for r in foreign) <= 0.02
    assert sum(r.kind in silent for r in both) >= 600
    assert not {r.seed for r in requests(1, False, REALITIES)} & {r.seed for r in both}
    assert len(quick) < 30 and len(requests(0, True, REALITIES)) <= 40
    kinds = {r.kind for r in requests(0, True, REALITIES)}
    assert {"single", "complete", "nuisance", "foreign", "pair", "replace"} <= kinds


def test_a_request_without_a_usable_draw_is_left_out_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    make = cases.make_case

    def refusing(request: Request) -> object:
        if request.effect == "ripple":
            raise NoUsableCase("the loop is nearly unstable")
        return make(request)

    monkeypatch.setattr(cases, "make_case", refusing)
    made = programme.prepare(tmp_path, FEW, 1)
    assert "case_0002 left out: the loop is nearly unstable" in capsys.readouterr().err
    assert [p.name for p in made.cases.iterdir()] == ["case_0001"]
    assert set(open_truth(made.truth, made.stamp)) == {"case_0001"}


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_proof_that_is_ended_says_what_is_kept_and_how_to_go_on(
    number: signal.Signals, made: Path
) -> None:
    line = (sys.executable, "-c", "from zendsp.__main__ import main; main()", "prove")
    process = subprocess.Popen(
        [*line, "--judge", str(made), "--jobs", "1"], stderr=subprocess.PIPE, text=True
    )
    reports = made / "zendsp_reports"
    until(lambda: list(reports.glob("*/stderr.txt")), "the first diagnosis runs")
    second = subprocess.run(
        [*line, "--judge", str(made)], capture_output=True, text=True, timeout=PATIENCE_S
    )
    said = " ".join(second.stderr.split())
    assert second.returncode == 2, said
    assert f":{process.pid}) writes there since" in said, said
    process.send_signal(number)
    said = process.communicate(timeout=PATIENCE_S)[1]
    assert status_of(process.returncode) == 128 + number
    kept = f"{made} keeps what is done (0 of 2 cases answered): the same command goes on there"
    assert kept in said, said
    running = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True, check=True)
    assert str(made) not in running.stdout, "a diagnosis goes on"
