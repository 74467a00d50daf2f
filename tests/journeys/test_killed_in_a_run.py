"""A host that is killed in the middle of a run leaves the program as it was before."""

from __future__ import annotations

import json
import os
import signal

import pytest
from journey import Installed, until

PREPARE = """
import zendsp
with zendsp.connect('imi') as t:
    t.download('pd.c')
    t.update(row_rate=777, approach_time=1.25, hold=False, ref=[[0.1, 0.2], [0.12, 0.21]])
"""
RUNS = {
    "frequency response": (
        "zendsp.frequency_response(t, f_min=4.0, f_max=20.0, lines=4, periods=200,"
        " amplitude=0.004, rehearsed=False)"
    ),
    "sweep": "zendsp.sweep(t, {'Kp1': [1900.0, 1800.0]}, ['q'], seconds=60.0)",
}
ENDS = {"frequency response": ["stopped", "host lost"], "sweep": ["running", ""]}
LOOK = """
import json, zendsp
with zendsp.connect('imi') as t:
    kinds = ('parameter', 'table')
    names = [i.name for i in t.variables().values() if i.kind in kinds]
    values = {n: getattr(v, 'tolist', lambda v=v: v)() for n, v in t.read(names).values.items()}
    s = t.status()
    print(json.dumps([[s.drive, s.trip.reason if s.trip else ''], values]))
"""


MORE = pytest.mark.long("tests/experiment/test_put_back.py has both; lost: a killed process")


@MORE
@pytest.mark.parametrize("run", RUNS)
def test_a_killed_host_leaves_the_program_as_it_was(installed: Installed, run: str) -> None:
    installed.target("imi")
    assert installed.script(PREPARE).returncode == 0
    (_, before) = json.loads(installed.script(LOOK).stdout)
    text = f"import zendsp\nt = zendsp.connect('imi')\nt.start()\n{RUNS[run]}\n"
    process = installed.start("python", installed.write("run.py", text))

    def look() -> tuple[list[str], dict[str, object]]:
        state, values = json.loads(installed.script(LOOK).stdout)
        return state, values

    until(lambda: look()[1] != before, "the run has set something")
    os.kill(process.pid, signal.SIGKILL)
    until(lambda: look() == (ENDS[run], before), "all is as it was")
