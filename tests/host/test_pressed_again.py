"""Ctrl-C that is pressed again does not end what brings the machine to rest."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

import zendsp
import zendsp.experiment.lab
import zendsp.experiment.player
from zendsp.experiment import Lab
from zendsp.experiment.gentle import CHANNELS, PROGRAM
from zendsp.here import uninterrupted as here
from zendsp.here.uninterrupted import uninterrupted
from zendsp.link import Target, local
from zendsp.recording import Recording


@pytest.fixture(scope="module")
def arm() -> Iterator[Target]:
    with local("imi_planar", clock="fast", options=["--ideal", "--speed", "100"]) as target:
        yield target


def test_signals_are_dropped_while_a_machine_is_brought_to_rest_and_heard_after() -> None:
    assert not ends(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
    own = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:  # as every command has it
        assert not ends(signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, own)


def ends(number: int) -> bool:
    """Whether a signal ends what brings a machine to rest."""
    try:
        with uninterrupted():
            os.kill(os.getpid(), number)
    except KeyboardInterrupt:
        return True
    return False


def test_a_rest_that_never_comes_is_interrupted_at_last(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(here, "PATIENCE_S", 0.0)
    with pytest.raises(KeyboardInterrupt), uninterrupted():
        os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_experiment_that_is_interrupted_twice_brakes_and_keeps_what_it_recorded(
    arm: Target, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second Ctrl-C took the program away while the loop still braked, and the recording with
    it.
    """
    stop = zendsp.experiment.lab._stop

    def first(fraction: float) -> None:
        if fraction > 0.02:
            raise KeyboardInterrupt

    def again(target: Target) -> None:
        stop(target)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(zendsp.experiment.lab, "_stop", again)
    monkeypatch.setattr(zendsp.experiment.lab, "ending", lambda target, done: first)
    arm.download("pd.c")
    lab = Lab(tmp_path, arm)
    with pytest.raises(KeyboardInterrupt), lab.bench("friction") as bench:
        bench.record("moves", PROGRAM, CHANNELS, seconds=20.0)
    trip = arm.status().trip
    assert trip is not None and trip.reason == "stop"
    assert len(Recording.load(tmp_path / "friction" / "moves_ended.npz")) > 100
    arm.acknowledge()


def test_a_frequency_response_that_is_interrupted_twice_leaves_the_machine_at_rest(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second Ctrl-C left the machine running, with the parameters of before."""
    position = zendsp.experiment.player.position

    def again(target: Target) -> object:
        os.kill(os.getpid(), signal.SIGINT)
        return position(target)

    def first(fraction: float) -> None:
        if fraction > 0.0:
            raise KeyboardInterrupt

    monkeypatch.setattr(zendsp.experiment.player, "position", again)
    with local("imi_planar", options=["--ideal", "--spin", "0"]) as target:
        target.download("pd.c")
        with pytest.raises(KeyboardInterrupt):
            zendsp.frequency_response(
                target, f_min=4.0, f_max=20.0, lines=4, periods=200, amplitude=0.004,
                rehearsed=False, progress=first,
            )  # fmt: skip
        assert target.status().state == "paused"
