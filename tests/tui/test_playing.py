"""What is played, and the runs that are kept, without a screen."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from steps import nobody, short_run
from waiting import PATIENCE_S

from zendsp.errors import LinkError, ReferenceError_
from zendsp.reference import Reference, load_machine, make_reference
from zendsp.tui import play_job
from zendsp.tui.play_job import PlayJob
from zendsp.tui.playing import Player, Setup, make_playlist, smooth_move
from zendsp.tui.runs import compare, discard_run, list_runs, rename_run, store_run
from zendsp.tui.session import Session
from zendsp.tui.snapshot import Snapshot


def _player(capacity: int = 10**6, torque: str = "") -> Player:
    return Player("ref", 2, capacity, torque, ("use_table", "row_rate"))


def test_a_torque_law_needs_a_program_that_takes_torque() -> None:
    machine = load_machine("imi_planar")
    law = Reference(np.zeros((100, 2)), 1e-3, tau=np.ones((100, 2)), mode="torque")
    with pytest.raises(ReferenceError_, match="ref_tau"):
        make_playlist([law], machine, np.zeros(2), Setup(), _player())
    playlist = make_playlist([law], machine, np.zeros(2), Setup(), _player(torque="ref_tau"))
    begin, end = (round(t * playlist.rate) for t in playlist.play)
    assert (playlist.torque[begin:end] == 1.0).all()
    assert not playlist.torque[:begin].any() and not playlist.torque[end:].any()


def test_a_playlist_has_no_jump_and_keeps_within_the_limits() -> None:
    machine = load_machine("imi_planar")
    reference = make_reference("circle", machine)
    start = np.array([-0.5, 0.9])
    setup = Setup(cycles=3, share=0.25)
    playlist = make_playlist([reference, reference], machine, start, setup, _player())
    assert np.allclose(playlist.rows[0], start) and np.allclose(playlist.rows[-1], machine.home)
    speed = np.abs(np.diff(playlist.rows, axis=0)) * playlist.rate
    fastest = np.maximum(np.abs(reference.qd).max(axis=0), 0.25 * machine.limits.speed)
    assert (speed <= fastest * 1.01).all()
    names = [name for name, _, _ in playlist.phases]
    assert (
        names[0] == "pre-position"
        and names[-1] == "go home"
        and sum(n.startswith("play") for n in names) == 6
    )
    begin, end = playlist.play
    assert (
        playlist.phase(begin + 0.01).startswith("play") and playlist.phase(end + 1e3) == "holding"
    )


def test_a_move_between_positions_is_at_rest_at_both_ends() -> None:
    machine = load_machine("imi_planar")
    rows = smooth_move(np.zeros(2), np.array([1.0, -2.0]), machine, 0.5, 1e-3)
    speed = np.gradient(rows, 1e-3, axis=0)
    assert np.abs(speed[[0, -1]]).max() < 0.01 * np.abs(speed).max()
    assert (np.abs(speed) <= 0.5 * machine.limits.speed * 1.001).all()
    assert (
        np.abs(np.gradient(speed, 1e-3, axis=0))[2:-2] <= 0.5 * machine.limits.acceleration * 1.01
    ).all()


def test_rows_that_do_not_fit_are_thinned_not_cut() -> None:
    machine = load_machine("imi_planar")
    reference = make_reference("circle", machine)
    full = make_playlist([reference], machine, reference.q[0], Setup(), _player())
    small = make_playlist(
        [reference], machine, reference.q[0], Setup(), _player(len(full.rows) // 3)
    )
    assert len(small.rows) <= len(full.rows) // 3 and small.rate == round(small.rate)
    assert small.duration == pytest.approx(full.duration, abs=4 / small.rate)
    assert np.allclose(small.rows[-1], full.rows[-1])
    at = np.arange(len(small.rows) - 1) / small.rate
    again = np.stack(
        [np.interp(at, np.arange(len(full.rows)) / full.rate, full.rows[:, j]) for j in range(2)],
        axis=1,
    )
    assert np.abs(small.rows[:-1] - again).max() < 1e-12


def test_without_pre_positioning_an_arm_elsewhere_is_refused() -> None:
    machine = load_machine("imi_planar")
    reference = make_reference("circle", machine)
    with pytest.raises(ReferenceError_, match="rad away from the start"):
        make_playlist(
            [reference], machine, reference.q[0] + 0.1, Setup(preposition=False), _player()
        )


def test_runs_survive_renaming_and_a_broken_neighbour(tmp_path: Path) -> None:
    run = store_run(tmp_path, "a b/c", short_run(1.0))
    (tmp_path / "20260101-000000-broken").mkdir()
    (tmp_path / "20260101-000000-broken" / "run.json").write_text("{")
    assert [r.name for r in list_runs(tmp_path)] == ["a b/c"]
    again = rename_run(run, "other")
    assert again.folder == run.folder and list_runs(tmp_path)[0].name == "other"
    assert not [p for p in tmp_path.iterdir() if p.name.endswith(".part")]
    place = discard_run(again)
    assert place.is_dir() and list_runs(tmp_path) == []


def test_compare_shows_errors_parameters_and_source(tmp_path: Path) -> None:
    runs = [store_run(tmp_path, n, short_run(g)) for n, g in (("soft", 100.0), ("stiff", 400.0))]
    text = compare(runs)
    assert "Kp1" in text and "Kd1" not in text
    assert "-/* 100.0 */" in text and "+/* 400.0 */" in text


@pytest.mark.parametrize("link", ["lost", "ended"])
def test_a_run_whose_link_was_lost_says_how_its_rows_come_home(
    link: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Nothing said that the target still held them, and the next Start replaced them."""

    def gone(*_: object) -> None:
        raise LinkError("the connection to 'imi' is closed")

    session = Session(nobody)
    session.snapshot = Snapshot(link=link, target="imi")  # type: ignore[arg-type]
    port = SimpleNamespace(
        snapshot=Snapshot, before=lambda names: SimpleNamespace(put_back=str),
        arm=lambda shot: None, start=gone,
    )
    session.require = lambda: port  # type: ignore[method-assign, return-value, assignment]
    found = SimpleNamespace(trip=None, simulated=True, good=True, text="as planned")
    playlist = SimpleNamespace(play=(0.0, 1.0), duration=1.0, rows=())
    plan = SimpleNamespace(values={}, tables={}, playlist=playlist, lead=0.0, seconds=1.0)
    monkeypatch.setattr(play_job, "make_plan", lambda *_: plan)
    job = PlayJob(
        session, [], [], load_machine("imi_planar"), Setup(), tmp_path, {},
        SimpleNamespace(found=lambda plan: found),  # type: ignore[arg-type]
    )  # fmt: skip
    job.start()
    error = str(job.result.exception(PATIENCE_S))
    assert error.startswith("the link was lost before it was done")
    assert ("zendsp acquire --last -t imi -o FILE brings home" in error) == (link == "lost")
    assert ("the next recording replaces it" in job.progress.why) == (link == "lost")
