"""Plan with the defaults, play with the default program, look: no trip; and what would trip is said
before it moves.
"""

from __future__ import annotations

import pytest
from journey import Installed

DEFAULT = {"imi_planar": "pd.c", "pendulum": "pendulum_track.c", "wam7": "wam_pd_gravity.c"}

SCRIPT = r"""
import importlib.util, sys
import zendsp
from zendsp.errors import ReferenceError_
from zendsp.reference import make_reference
from zendsp.reference.registry import KINDS

machine, program = sys.argv[1:]
OPEN_LOOP = {("pendulum", "torque_law"): "pendulum_torque.c"}  # the torque is the motion; the tracking programs play what it predicts
played, bad = [], []
with zendsp.local(machine, clock="fast") as target:
    for kind in KINDS:
        if kind == "from_file" or (kind == "swing" and importlib.util.find_spec("casadi") is None):
            continue
        try:
            reference = make_reference(kind, machine)
        except ReferenceError_ as error:
            assert "is planned for machines of kind" in str(error), error
            continue
        played.append(kind)
        target.download(OPEN_LOOP.get((machine, kind), program))
        names = target.variables()
        for name, rows in reference.tables().items():
            if name in names:
                target.upload(name, rows)
        target.update(use_table=True, row_rate=round(1 / reference.sample_time))
        approach = target["approach_time"] if "approach_time" in names else 0.0
        status = target.run_for(approach + reference.duration + 0.5, timeout=250)
        if status.trip is not None:
            bad.append(f"{kind}: {status.trip.text}")
            target.acknowledge()
print(*played)
print("\n".join(bad), file=sys.stderr)
sys.exit(bool(bad))
"""  # noqa: E501


MORE = pytest.mark.long("tests/reference plans its defaults within its limits; lost: their play")


@MORE
@pytest.mark.parametrize("machine", DEFAULT)
def test_default_motions_do_not_trip_the_default_program(
    installed: Installed, machine: str
) -> None:
    if machine == "wam7":
        pytest.importorskip("pinocchio")
    said = installed.script(SCRIPT, machine, DEFAULT[machine], timeout=300.0)
    assert said.returncode == 0, said.stdout + said.stderr
    assert len(said.stdout.split()) >= 8, "every kind that the machine can move was played"


REHEARSE = r"""
import dataclasses, subprocess, sys
import zendsp
from zendsp.reference import make_reference, save_reference

save_reference(make_reference("point_to_point", "imi_planar", duration=0), "gentle.mat")
save_reference(make_reference("point_to_point", "imi_planar", duration=0, headroom=1), "hasty.mat")
target = zendsp.connect()
target.download("pd.c")
before = target.status().tick
other = dataclasses.replace(zendsp.reference.load_reference("gentle.mat"), machine="other")
save_reference(other, "other.mat")
meant = {"other.mat": "was planned for other, not for imi_planar"}
for name, expected in (("hasty.mat", 1), ("other.mat", 0)):
    said = subprocess.run(["zendsp", "rehearse", name], capture_output=True, text=True)
    print(name, said.returncode, said.stdout, said.stderr)
    assert said.returncode == expected, name
    assert meant.get(name, "") in said.stderr and bool(said.stderr) == (name in meant), name
    if expected == 1:
        for word in ("in the simulation", "exceeds the limit of", " s, ", "headroom"):
            assert word in said.stdout, word
assert target.status().tick == before and target.status().trip is None
target.close()
"""


def test_what_would_trip_is_said_before_it_moves(installed: Installed) -> None:
    installed.target("imi", "imi_planar", "--clock", "fast")
    said = installed.script(REHEARSE)
    assert said.returncode == 0, said.stdout + said.stderr
