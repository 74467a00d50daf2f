"""`zendsp prove`: sealed before, opened after, resumable, and a page that tells all."""

from __future__ import annotations

from pathlib import Path

import pytest

from zendsp.proof import programme, run_proof
from zendsp.proof.answer import Answer, Finding
from zendsp.proof.build_case import Request
from zendsp.proof.programme import FULL, QUICK, requests
from zendsp.proof.seal import BrokenSeal, write_truth

FEW = [Request(71, "complete", "rotary"), Request(72, "single", "rotary", "ripple", 1.0)]


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programme, "requests", lambda seed, quick: FEW)


def say(verdict: str, *effects: str) -> Answer:
    return Answer(verdict, tuple(Finding(e, 1, confidence=0.9) for e in effects), seconds=1.0)


def go(folder: Path, sample: int = 0) -> run_proof.Outcome:
    return run_proof.run_proof(
        folder,
        seed=0,
        quick=True,
        jobs=1,
        limit=1.0,
        with_peers=False,
        command="zendsp prove --quick",
        tell=lambda _: None,
        sample=sample,
    )


def answer_with(monkeypatch: pytest.MonkeyPatch, table: dict[str, Answer]) -> list[str]:
    asked: list[str] = []

    def fake(
        folders: list[Path], out: Path, jobs: int, limit: float, ask: object = None, code: str = ""
    ) -> list[tuple[str, Answer]]:
        asked.extend(f.name for f in folders)
        return [(f.name, table[f.name]) for f in folders]

    monkeypatch.setattr(run_proof, "answers", fake)
    return asked


def test_run_counts_and_writes_the_page(tmp_path: Path, few: None, monkeypatch: pytest.MonkeyPatch) -> None:
    answer_with(monkeypatch, {"case_0001": say("complete"), "case_0002": say("missing", "ripple")})
    outcome = go(tmp_path)
    assert [j.alarm for j in outcome.judged] == [False, None] and outcome.judged[1].named is True
    page = outcome.page.read_text()
    assert outcome.stamp in page and "zendsp prove --quick" in page and "Nothing in this run." in page


def test_a_sample_is_sealed_whole_and_asked_in_part(tmp_path: Path, few: None, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = answer_with(monkeypatch, {"case_0001": say("complete"), "case_0002": say("missing", "ripple")})
    assert [j.case for j in go(tmp_path, 1).judged] == asked and len(asked) == 1
    assert len(list((tmp_path / "truth").glob("case_*.json"))) == 2


def test_failures_are_on_the_page(tmp_path: Path, few: None, monkeypatch: pytest.MonkeyPatch) -> None:
    answer_with(monkeypatch, {"case_0001": say("missing", "coulomb"), "case_0002": say("complete")})
    page = go(tmp_path).page.read_text()
    assert "case_0001 rotary complete" in page and "truth ripple; said complete" in page


def test_truth_altered_while_diagnosing_stops_the_proof(
    tmp_path: Path, few: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def meddling(
        folders: list[Path], out: Path, jobs: int, limit: float, ask: object = None, code: str = ""
    ) -> list[tuple[str, Answer]]:
        write_truth(tmp_path / "truth", "case_0002", {"case": "case_0002", "effects": []})
        return [(f.name, say("complete")) for f in folders]

    monkeypatch.setattr(run_proof, "answers", meddling)
    with pytest.raises(BrokenSeal):
        go(tmp_path)


def test_second_run_keeps_the_cases_and_another_seed_is_refused(
    tmp_path: Path, few: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = programme.prepare(tmp_path, 0, True, 1)
    before = (tmp_path / "cases" / "case_0001" / "model.toml").stat().st_mtime_ns
    assert programme.prepare(tmp_path, 0, True, 1) == first
    assert (tmp_path / "cases" / "case_0001" / "model.toml").stat().st_mtime_ns == before
    monkeypatch.setattr(programme, "requests", lambda seed, quick: FEW[:1])
    with pytest.raises(FileExistsError, match="another run"):
        programme.prepare(tmp_path, 1, True, 1)


def test_programme_holds_what_is_promised() -> None:
    quick, full = requests(0, True), requests(0, False)
    assert len(quick) == 30 and 300 <= len(full) <= 600
    assert {r.machine for r in full} == {"rotary", "linear", "pendulum", "planar2r", "urdf"}
    assert (
        sum(r.kind in ("complete", "complete_slow", "nuisance", "hard_complete") for r in full) >= 140
    )  # a bound of 2 % needs 149 silent
    assert not {r.seed for r in requests(1, False)} & {r.seed for r in full}
    assert len(QUICK) < len(FULL)
