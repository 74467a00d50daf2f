"""What was recorded before a target was killed is not lost."""

from __future__ import annotations

import json
import os
import signal
import time

from journey import PATIENCE_S, Installed, until

RECORD = """
import time, zendsp
with zendsp.connect('killed') as t:
    t.download('pd.c')
    t.update(Kp1=321.0)
    t.acquire_configure(['tick', 'q', 'tau'], seconds=%(seconds)s, continuous=%(ring)s)
    t.acquire_start(); t.start()
    deadline = time.monotonic() + 150
    while t.acquire_status().count < 400 and time.monotonic() < deadline: time.sleep(0.02)
    print(t.acquire_status().count)
"""
LOOK = """
import numpy as np, sys
from zendsp import Recording
rec = Recording.load(sys.argv[1])
assert len(rec) >= int(sys.argv[2]), len(rec)
assert (np.diff(rec['tick']) == 1).all() and rec['tick'][0] == rec.start_tick
assert np.allclose(rec.t, rec['tick'] / 1000.0) and rec.lost == 0
assert rec.columns == ('tick', 'q[0]', 'q[1]', 'tau[0]', 'tau[1]'), rec.columns
assert rec.parameters['Kp1'] == 321.0 and 'UserISR_INT2' in rec.sources['pd.c'] and rec.target == 'killed'
assert 'not known' in rec.extra['salvaged']
"""  # noqa: E501


def _killed(installed: Installed, seconds: float, ring: bool) -> int:
    """Rows that the host had seen when the target was killed."""
    process = installed.target("killed")
    done = installed.script(RECORD % {"seconds": seconds, "ring": ring})
    assert done.returncode == 0, done.stderr
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    return int(done.stdout)


def test_rows_of_a_killed_target_are_saved_before_and_after_its_next_start(
    installed: Installed,
) -> None:
    seen = _killed(installed, 60.0, False)
    assert "killed" in installed.run("salvage").stdout
    done = installed.run("salvage", "-t", "killed", "-o", "shot.mat", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["rows"] >= seen
    looked = installed.script(LOOK, "shot.mat", str(seen))
    assert looked.returncode == 0, looked.stderr
    done = installed.run("salvage", "-t", "killed")
    assert (
        done.returncode == 1 and "no recording of a killed target" in done.stdout
    ), "saved, and freed"

    _killed(installed, 0.3, True)
    again = installed.target("killed")
    assert "killed" in installed.run("salvage").stdout, "the next start keeps it"
    done = installed.run("salvage", "-t", "killed", "-o", "ring.npz")
    assert done.returncode == 0, done.stderr
    looked = installed.script(LOOK, "ring.npz", "300")
    assert looked.returncode == 0, looked.stderr
    os.kill(again.pid, signal.SIGTERM)
    again.wait()
    assert again.stdout is not None
    assert "zendsp salvage -t killed" in again.stdout.read(), "and says so"
    assert installed.run("salvage", "-t", "killed").returncode == 1, "a clean end leaves nothing"


ROWS = """
import sys, time, zendsp
with zendsp.connect('killed') as t:
    deadline = time.monotonic() + 150
    while t.acquire_status().count < 100 and time.monotonic() < deadline: time.sleep(0.02)
    sys.exit(t.acquire_status().count < 100)
"""


def test_a_recording_host_is_told_at_once_that_its_target_was_killed_and_what_was_kept(
    installed: Installed
) -> None:
    target = installed.target("killed")
    assert installed.run("run", "pd.c", "-t", "killed").returncode == 0
    recording = installed.start("zendsp", "acquire", "q", "-s", "600", "-o", "q.mat")
    assert installed.script(ROWS).returncode == 0
    began = time.monotonic()
    target.kill()
    said, _ = recording.communicate(timeout=PATIENCE_S)
    assert recording.returncode == 2 and "is gone" in said
    # a broken link is waited for for 30 s, a process that has ended is not
    assert time.monotonic() - began < 20
    assert "zendsp salvage -t killed -o FILE" in said
    assert installed.run("salvage", "-t", "killed", "-o", "q.mat").returncode == 0


def test_dropped_salvage_is_gone(installed: Installed) -> None:
    _killed(installed, 60.0, False)
    assert installed.run("salvage", "-t", "killed", "--drop").returncode == 0
    until(lambda: installed.run("salvage", "-t", "killed").returncode == 1, "gone")
