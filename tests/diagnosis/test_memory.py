"""What a diagnosis has computed goes with it: a notebook asks for hundreds."""

from __future__ import annotations

import gc
import pickle
from pathlib import Path

import reality
from reality import RATE

from zendsp.diagnosis import diagnose
from zendsp.physics.calibration import joint
from zendsp.physics.calibration.joint import JointRecord


def _alive(first: int) -> list[JointRecord]:
    """The records with numbers from ``first`` on, without those that other tests keep."""
    every = (one for one in gc.get_objects() if isinstance(one, JointRecord))
    return [one for one in every if one.number >= first]


def test_no_recording_outlives_its_diagnosis(tmp_path: Path) -> None:
    """Caches kept their own records alive in a circle, which the garbage collector, which counts
    objects and no bytes, left for long: ten diagnoses in one process held 1.6 GB.
    """
    made = reality.simulate(reality.Machine(coulomb=0.03), reality.multisine(4.0, RATE, 1), RATE)
    columns = {"t": made["t"], "q": made["q"], "u": made["u"]}
    run = reality.save(tmp_path / "run.csv", columns)
    model = {
        "name": "bench", "sample_time": 1.0 / RATE,
        "mechanism": {"kind": "rotary", "parameters": {"inertia": reality.Machine().inertia}},
        "columns": {"time": "t", "position": "q", "command": "u"},
    }  # fmt: skip
    first = next(joint._numbers)
    gc.collect()
    gc.disable()
    try:
        found = diagnose(run, model, jobs=1)
        left = sum(len(pickle.dumps((r.fits, r.runs, r.traces, r.shapes))) for r in _alive(first))
        assert _alive(first) and left < 10_000, "what can be computed again is gone, too"
        del found
        assert not _alive(first)
    finally:
        gc.enable()


def test_a_record_has_a_number_of_its_own_in_any_process() -> None:
    """The caches that copies share would take one record for another."""
    plain = JointRecord.__new__(JointRecord)
    plain.__dict__["number"] = 0
    copies = [pickle.loads(pickle.dumps(plain)) for _ in range(2)]
    numbers = {plain.number, *(c.number for c in copies)}
    assert len(numbers) == 3
