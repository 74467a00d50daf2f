"""Recordings are made once a session: tests alter copies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import reality

RATE = 500.0


@pytest.fixture(scope="session")
def good() -> dict[str, np.ndarray]:
    """Ten seconds of a machine with Coulomb and viscous friction."""
    return reality.simulate(reality.Machine(), reality.multisine(10.0, RATE, 1), RATE)


@pytest.fixture(scope="session")
def other() -> dict[str, np.ndarray]:
    """The same machine along another reference."""
    return reality.simulate(reality.Machine(), reality.multisine(8.0, RATE, 2), RATE)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A complete model of it, inertia off by 2 %."""
    return reality.model_file(
        tmp_path / "model.toml",
        RATE,
        reality.effect("viscous", coefficient=0.004),
        reality.effect("coulomb", level=0.03),
    )


@pytest.fixture
def refuse(typed: Callable[..., tuple[object, str, str]]) -> Callable[..., str]:
    """Run `zendsp diagnose` and give the one sentence that it ends with."""

    def run(*args: object) -> str:
        status, out, err = typed("diagnose", *args)
        assert status == 2, out + err
        assert "Traceback" not in err and out == ""
        lines = err.strip().splitlines()
        assert len(lines) == 1 and lines[0].startswith("zendsp: "), err
        return lines[0]

    return run
