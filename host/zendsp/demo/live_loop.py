"""The live loop: an arm moves on a circle under C code while its gains are changed, and is recorded meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from zendsp.errors import Refused
from zendsp.link import Target
from zendsp.recording import Recording

CHANNELS = ("q", "r1", "r2", "e", "tau", "exec_us", "late_us")
SECONDS = 14.0
POLL_S = 0.005


@dataclass(frozen=True)
class Change:
    """A change of gains while the arm moves."""

    at_s: float
    gains: dict[str, float]
    why: str


# Stiffer, then a quarter of what pd.c starts with. In the other order the large error would trip the torque limit.
CHANGES = (
    Change(5.0, {"Kp1": 5000.0, "Kp2": 750.0}, "2.5 times the stiffness"),
    Change(9.5, {"Kp1": 500.0, "Kp2": 75.0}, "a quarter of the stiffness"),
)


def run_live_loop(target: Target, folder: Path, say: Callable[[str], None]) -> Recording:
    """Compile and download ``pd.c``, move, change gains on the way, record, save and draw.

    Parameters
    ----------
    target : Target
        With the machine ``imi_planar``.
    folder : Path
        Receives ``circle.mat`` and ``circle.png``.
    say : callable
        Told what happens, a line at a time.

    Returns
    -------
    Recording
    """
    from zendsp.demo.picture import draw

    built = target.compile("pd.c")
    say(f"compiled pd.c on the target {'from its cache' if built.cached else f'in {built.seconds:.2f} s'}")
    target.load(built.key)
    status = target.status()
    say(f"loaded; the loop runs at {status.rate_hz:g} Hz, {status.clock} clock: {status.scheduling}")
    target.acquire_configure(list(CHANNELS), seconds=SECONDS)
    target.acquire_start()
    ticks = round(SECONDS * status.rate_hz)
    if status.clock == "fast":
        _change_ahead(target, status.rate_hz, say)
        target.start(ticks)
    else:
        target.start(ticks)
        say("started: both joints go onto a circle")
        _change_meanwhile(target, say)
    recording = target.acquire_finish(
        timeout=4.0 * SECONDS, note="zendsp demo: a circle, and gains changed on the way"
    )
    end = target.wait()
    if end.trip is not None:
        raise Refused(f"the machine tripped: {end.trip.text}")
    say(f"recorded {len(recording)} samples of {len(recording.columns)} signals, {recording.lost} lost")
    recording.save(folder / "circle.mat")
    draw(recording, CHANGES, folder / "circle.png")
    return recording


def _change_meanwhile(target: Target, say: Callable[[str], None]) -> None:
    """Change the gains when their time has come, all of one set in one sample."""
    for change in CHANGES:
        while (status := target.status()).state == "running" and status.t < change.at_s:
            time.sleep(POLL_S)
        tick = target.update(None, **change.gains)
        say(f"sample {tick}: {change.why} ({_listed(change.gains)})")


def _change_ahead(target: Target, rate_hz: float, say: Callable[[str], None]) -> None:
    """Say beforehand at which samples the gains shall change: simulated time does not wait for a host."""
    for change in CHANGES:
        tick = target.update(round(change.at_s * rate_hz), **change.gains)
        say(f"set for sample {tick}: {change.why} ({_listed(change.gains)})")


def _listed(gains: dict[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in gains.items())
