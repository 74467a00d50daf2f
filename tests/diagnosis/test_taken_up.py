"""A load that an arm takes up or puts down within a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_arms import Arm, recorded

from zendsp.diagnosis import diagnose
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.explain.taken_up import AROUND_S, cut_where_taken

MASS, SECONDS = 1.5, 12.0  # kg, s


@pytest.mark.parametrize("carried", [(6.0, np.inf), (0.0, 6.0), (4.0, 8.0), (0.0, np.inf)])
def test_a_recording_is_cut_where_its_load_changes(
    carried: tuple[float, float], tmp_path: Path
) -> None:
    arm = Arm(mass=MASS, carried=carried)
    given, paths = recorded(tmp_path, "arm", arm, friction=True, seconds=SECONDS)
    one, other = (read_signals(p, given) for p in paths)
    pieces, *same = cut_where_taken([[one], [other], [other]], given, 1)
    assert [s.name for s in same[0]] == [s.name for s in same[1]]
    changes = [t for t in carried if 0.0 < t < SECONDS]
    if not changes:
        assert pieces == [one]
        return
    assert len(pieces) == len(changes) + 1
    assert pieces[0].name.startswith(f"{one.name} until ") and pieces[-1].name.endswith(" s on")
    for t, before, after in zip(changes, pieces, pieces[1:], strict=False):
        assert before.time[-1] < t <= after.time[0] < before.time[-1] + 3 * AROUND_S
        assert after.whole == after.name, "a recording of its own"


@pytest.mark.parametrize("held", [True, False])
def test_a_load_taken_up_in_each_recording_is_one_finding(held: bool, tmp_path: Path) -> None:
    """In three recordings of a six-axis arm it was a push, a drifting gain, and torques without a
    name at all other joints; in one of 20 s a load of half its mass.
    """
    arm = Arm(mass=MASS, carried=(5.0, np.inf))
    given, paths = recorded(tmp_path, "arm", arm, friction=True, seconds=SECONDS)
    d = diagnose(paths[:1], given, paths[1:] if held else None, jobs=1)
    (found,) = d.findings
    assert found.effect == "payload" and found.is_elsewhere
    assert abs(found.parameters["mass"].value - MASS) < 3.0 * found.parameters["mass"].std < 0.15
    assert all(" from " in name for name in found.numbers["recordings"])
