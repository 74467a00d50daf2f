"""What a joint touches at some places, told from a push."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import reality
from reality import KNOWN, RATE

from zendsp.diagnosis import diagnose
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.decide.thresholds import VISITED
from zendsp.diagnosis.measure.bursts import Bursts
from zendsp.diagnosis.measure.touched import other_visits
from zendsp.physics.files.model_file import load_model
from zendsp.physics.term_numbers import kernel_model

pytestmark = pytest.mark.usefixtures("sizes_unasked")

Recorded = Callable[[reality.Machine, tuple[int, int], float], tuple[list[Path], Path]]


@pytest.fixture
def along(tmp_path: Path) -> Recorded:
    """Recordings of a machine along two slow motions, and its given model."""

    def run(machine: reality.Machine, seeds: tuple[int, int], low: float) -> Any:
        seconds = 9.0 if low > 0.1 else 16.0
        motions = [
            reality.multisine(seconds, RATE, seed, low=low, high=20 * low) for seed in seeds
        ]
        files = [
            reality.save(tmp_path / f"{seed}.csv", reality.simulate(machine, motion, RATE, seed))
            for seed, motion in zip(seeds, motions, strict=True)
        ]
        return files, reality.model_file(tmp_path / "m.toml", RATE, *KNOWN)

    return run


@pytest.mark.parametrize(
    ("edge", "touch", "seeds", "low"), [(0.8, 0.2, (3, 4), 0.2), (0.5, 0.1, (5, 6), 0.1)]
)
def test_something_springy_that_the_joint_touches_is_no_push(
    edge: float, touch: float, seeds: tuple[int, int], low: float, along: Recorded
) -> None:
    """A rail, a table and a gantry that met something soft had been pushed, by 0.85 each."""
    files, model = along(reality.Machine(touch=touch, edge=edge), seeds, low)
    d = diagnose(files[0], model, files[1], jobs=1)
    assert (d.verdict, d.findings) == ("unexplained", ())


@pytest.mark.parametrize("touched", [True, False])
def test_other_visits_to_its_place_predict_what_is_touched_and_no_push(
    touched: bool, along: Recorded
) -> None:
    touches, pushed = {"touch": 0.1, "edge": 0.5}, {"push": (0.06, 2.0, 4.0)}
    machine = reality.Machine(**(touches if touched else pushed))  # type: ignore[arg-type]
    files, path = along(machine, (5, 6), 0.1)
    model = load_model(path)
    fit, held = (prepare([read_signals(file, model)], model, 64.0) for file in files)
    here = fit.records[0][0]
    spans = [(2.0, 4.0)]
    if touched:
        beyond = np.flatnonzero(here.motion.states[0] > 0.5) * here.sample_time
        each = np.split(beyond, np.flatnonzero(np.diff(beyond) > 0.3) + 1)
        spans = [(float(x[0]), float(x[-1])) for x in each]
        assert len(spans) > 1
    found = Bursts(
        tuple(spans), (here.recording,) * len(spans), 0.9, 0.1, 0.1, 0.0, 0.0, 1.0,
        (1.0,) * len(spans), 1.0,
    )  # fmt: skip
    visits = other_visits(found, (fit, held), kernel_model(model), 1)
    assert visits.share > VISITED
    assert (visits.predicted > 0.8) if touched else (visits.predicted < 0.2)
