"""Run samples, and read the rows that they recorded."""

from __future__ import annotations

import numpy as np

from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime


def run(runtime: Runtime, ticks: int) -> None:
    """Run so many samples, or fewer where it trips."""
    runtime.start(ticks=ticks)
    runtime.wait_paused()


def rows_of(runtime: Runtime, channels: tuple[str, ...], ticks: int) -> np.ndarray:
    """Run so many samples of 1 ms; what each of them recorded."""
    runtime.acquire_configure(0, AcquireConfig(channels, seconds=ticks / 1000.0))
    runtime.acquire_start(0)
    run(runtime, ticks)
    return runtime.acquire_read(0, 0, ticks)
