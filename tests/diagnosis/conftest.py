"""Recordings are made once a session: tests alter copies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import reality
from reality import FAST, KNOWN, RATE

from zendsp.diagnosis import Diagnosis, diagnose, engine
from zendsp.diagnosis.measure.likelihood import Scored
from zendsp.diagnosis.search.forward import Searcher
from zendsp.diagnosis.search.hypothesis import JointSearch


@pytest.fixture(scope="session")
def good() -> dict[str, np.ndarray]:
    """Ten seconds of a machine with Coulomb and viscous friction."""
    return reality.simulate(reality.Machine(), reality.multisine(10.0, FAST, 1), FAST)


@pytest.fixture(scope="session")
def other() -> dict[str, np.ndarray]:
    """The same machine along another reference."""
    return reality.simulate(reality.Machine(), reality.multisine(8.0, FAST, 2), FAST)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A complete model of it, inertia off by 2 %."""
    return reality.model_file(tmp_path / "model.toml", FAST, *KNOWN)


@pytest.fixture
def seconds() -> tuple[float, float]:
    """Length of run1.csv and run2.csv: half of the second is to choose by, half to test on."""
    return 6.0, 9.0


@pytest.fixture
def recorded(tmp_path: Path, seconds: tuple[float, float]) -> Callable[..., list[Path]]:
    """Write run1.csv of a machine, and run2.csv of another or the same one."""

    def write(fit: reality.Machine, held: reality.Machine | None = None) -> list[Path]:
        machines = ((fit, seconds[0], 1), (held or fit, seconds[1], 2))
        return [
            reality.save(
                tmp_path / f"run{seed}.csv",
                reality.simulate(m, reality.multisine(s, RATE, seed), RATE, seed),
            )
            for m, s, seed in machines
        ]

    return write


@pytest.fixture
def sizes_unasked(monkeypatch: pytest.MonkeyPatch) -> None:
    """What could have been seen is asked after all is decided, and takes a fifth of a diagnosis:
    test_detectable.py asks for it.
    """
    monkeypatch.setattr(engine, "detectable", lambda *_: ())


@pytest.fixture
def decided(
    tmp_path: Path, recorded: Callable[..., list[Path]], sizes_unasked: None
) -> Callable[..., Diagnosis]:
    """Diagnose run1.csv of a machine, with run2.csv of another or the same one held out."""

    def run(fit: reality.Machine, held: reality.Machine | None = None, *effects: str) -> Diagnosis:
        files = recorded(fit, held)
        model = reality.model_file(
            tmp_path / "model.toml", RATE, *(effects or KNOWN), resolution=fit.resolution
        )
        return diagnose(files[0], model, files[1], jobs=1)  # threads cost more than they gain

    return run


@pytest.fixture(scope="session")
def searches() -> dict[tuple[object, ...], JointSearch]:
    """What was found, by model and recordings."""
    return {}


@pytest.fixture
def searched_once(
    searches: dict[tuple[object, ...], JointSearch], monkeypatch: pytest.MonkeyPatch
) -> None:
    """For tests that change only the decision: the search on the same recordings runs once a
    session.
    """
    search = Searcher.search

    def once(self: Searcher, base: Scored) -> JointSearch:
        records = (*self.rounds.data.records, *self.accept.choose.records)  # type: ignore[attr-defined]
        commands = (each.command.tobytes() for joints in records for each in joints)
        key = (repr(base.model), self.joint, *commands)
        if key not in searches:
            searches[key] = search(self, base)
        return replace(searches[key])

    monkeypatch.setattr(Searcher, "search", once)


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Diagnosis]:
    """Diagnose a machine along two motions, once a session for each machine and model. Tests only
    read the result.
    """
    done: dict[tuple[object, ...], Diagnosis] = {}

    def run(
        machine: reality.Machine,
        given: Sequence[str] = KNOWN,
        seconds: tuple[float, float] = (6.0, 6.0),
        rate: float = RATE,
        **reference: float,
    ) -> Diagnosis:
        motions = [
            reality.multisine(each, rate, seed, **reference) for seed, each in enumerate(seconds, 1)
        ]
        case = (repr(machine), *given, *(motion.tobytes() for motion in motions))
        if case not in done:
            folder, resolution = tmp_path_factory.mktemp("bench"), machine.resolution
            model = reality.model_file(folder / "m.toml", rate, *given, resolution=resolution)
            train, held = (
                reality.save(folder / f"{k}.csv", reality.simulate(machine, motion, rate, k))
                for k, motion in enumerate(motions, 1)
            )
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(engine, "detectable", lambda *_: ())  # as `sizes_unasked`
                done[case] = diagnose(train, model, held, jobs=1)
        return done[case]

    return run


@pytest.fixture
def refuse(typed: Callable[..., tuple[object, str, str]]) -> Callable[..., str]:
    """The one sentence with which `zendsp diagnose` refuses."""

    def run(*args: object) -> str:
        status, out, err = typed("diagnose", *args)
        assert status == 2, out + err
        assert "Traceback" not in err and out == ""
        lines = err.strip().splitlines()
        assert len(lines) == 1 and lines[0].startswith("zendsp: "), err
        return lines[0]

    return run
