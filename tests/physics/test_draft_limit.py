"""Which commands show the limit of their drive to a model that is begun from a recording."""

from __future__ import annotations

import numpy as np
import pytest

from zendsp.physics.files.draft_limit import is_cut_off

T = np.arange(12000) * 0.001
SINE = 0.3 * np.sin(2 * np.pi * 0.7 * T)
NOISE = 0.02 * np.random.default_rng(1).normal(size=len(T))


def held(command: np.ndarray) -> np.ndarray:
    """Of a loop that is ten times as slow as its rows."""
    return np.repeat(command[::10], 10)


@pytest.mark.parametrize("command", [
    SINE, np.round(SINE, 3), np.round(SINE, 2), held(SINE), SINE + NOISE, np.zeros(len(T)),
    np.where(T < 4, np.minimum(1.3 * SINE, 0.3), 0.2 * SINE / 0.3)[T > 3],  # one visit
], ids=["smooth", "3 digits", "2 digits", "held", "noisy", "nothing", "once"])  # fmt: skip
def test_a_rounded_peak_is_no_limit(command: np.ndarray) -> None:
    """The smooth maximum of a sine became ``limit = 0.3``, for 20 samples were near it."""
    assert not is_cut_off(command)


@pytest.mark.parametrize("command", [
    1.3 * SINE, np.round(1.3 * SINE, 3), held(1.3 * SINE), 1.3 * SINE + NOISE,
    np.where(T < 1, np.nan, 1.3 * SINE),
], ids=["smooth", "3 digits", "held", "noisy", "gap"])  # fmt: skip
def test_a_command_that_is_cut_off_again_and_again_shows_the_limit(command: np.ndarray) -> None:
    assert is_cut_off(np.clip(command, -0.3, 0.3))
