"""Recordings are made once a session: tests alter copies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import reality
from reality import KNOWN, RATE

from zendsp.diagnosis import Diagnosis, diagnose


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
    return reality.model_file(tmp_path / "model.toml", RATE, *KNOWN)


@pytest.fixture
def recorded(tmp_path: Path) -> Callable[..., list[Path]]:
    """Write run1.csv of a machine, and run2.csv of another or the same one."""

    def write(fit: reality.Machine, held: reality.Machine | None = None) -> list[Path]:
        machines = ((fit, 9.0, 1), (held or fit, 12.0, 2))
        return [
            reality.save(
                tmp_path / f"run{seed}.csv",
                reality.simulate(m, reality.multisine(s, RATE, seed), RATE, seed),
            )
            for m, s, seed in machines
        ]

    return write


@pytest.fixture
def decided(tmp_path: Path, recorded: Callable[..., list[Path]]) -> Callable[..., Diagnosis]:
    """Diagnose run1.csv of a machine, with run2.csv of another or the same one held out."""

    def run(fit: reality.Machine, held: reality.Machine | None = None, *effects: str) -> Diagnosis:
        files = recorded(fit, held)
        model = reality.model_file(
            tmp_path / "model.toml", RATE, *(effects or KNOWN), resolution=fit.resolution
        )
        return diagnose(files[0], model, files[1], jobs=1)  # threads cost more than they gain

    return run


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
