"""The drive sequence in every order, with every shipped program on every machine: no trip without a
reason.

Fast clock by default; ``ZENDSP_JOURNEYS=all`` runs the whole matrix on the real clock too. One
target takes all programs of its machine, one after the other: every order, and every program in
some of them; the long tests have each program in each order.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from journey import Installed

PROGRAMS = [
    (
        "imi_planar",
        ("pd.c", "inverse_dynamics.c", "torque_steps.c", "constant_torque.c", "template.c"),
    ),
    (
        "pendulum",
        (
            "pendulum_track.c", "pendulum_compensation.c", "pendulum_torque.c",
            "constant_torque.c", "template.c", "joint_pd.c",
        ),
    ),
    ("pendulum", ("pendulum_current.c",)),  # its drive takes a voltage
    ("wam7", ("wam_pd_gravity.c",)),
]
# On the real clock each order takes seconds of real time: one program of a machine with one joint
# and one of a machine with two, unless all are asked for.
REAL = (
    [(machine, program) for machine, programs in PROGRAMS for program in programs]
    if os.environ.get("ZENDSP_JOURNEYS") == "all"
    else [("imi_planar", "pd.c"), ("pendulum", "pendulum_track.c")]
)
# seven joints take four times as long to simulate; a run is over the first rows of the way
RUN_MS = {"imi_planar": 700, "pendulum": 700, "wam7": 300}

SCRIPT = r"""
import itertools, sys, time
import numpy as np
import zendsp
from zendsp.errors import Refused

machine, clock, ms, *programs = sys.argv[1], sys.argv[2], int(sys.argv[3]), *sys.argv[4:]
options = ["--spin", "0"]  # the loop sleeps until each sample
if programs == ["pendulum_current.c"]:
    options += ["--machine-option", "drive=voltage"]

clock, *which = clock.split()
target = zendsp.local(machine, clock=clock, options=options)


def load():
    flags = ["-DN=1"] if (machine, program) == ("pendulum", "constant_torque.c") else []
    target.download(program, flags)
    names = target.variables()
    if "ref" in names:  # away from home, and back
        n = names["ref"].columns
        t = np.arange(2001) / 2000
        target.upload("ref_tau", np.zeros((1, n))) if "ref_tau" in names else None
        target.upload("ref", 0.15 * (1 - np.cos(2 * np.pi * t))[:, None] * np.ones(n))
        if "row_rate" in names:
            target.update(use_table=True, row_rate=1000)
    if "go" in names:
        target.update(go=1, **({"level": 12.0} if program == "constant_torque.c" and machine != "pendulum" else {}))


def run():
    target.start(ms)
    said = target.wait()
    assert said.trip is None, f"{said.trip.text}"


def pressed(what):
    # a reason is given: STOP, or the emergency stop of the machine where it has one
    pin = target.machine().stop_input
    target.start()
    target.stop() if what == "stop" or pin < 0 else target.set_inputs(1 << pin)
    end = time.monotonic() + 150
    while target.status().trip is None and time.monotonic() < end:
        time.sleep(0.002)
    assert target.status().trip.reason in ("stop", "stop input")
    target.set_inputs(0)
    refused(target.start, "acknowledge")
    target.acknowledge()


def refused(call, word):
    try:
        call()
    except Refused as error:
        assert word in str(error), f"refused, but without saying {word!r}: {error}"
    else:
        raise AssertionError(f"not refused: {call}, expected a word of {word!r}")


def reload():
    load()
    refused(target.start, "enable")


MIDDLES = {
    "nothing": lambda: None,
    "stop": lambda: pressed("stop"),
    "trip": lambda: pressed("trip"),
    "disable": target.disable,
    "reload": reload,
    "power": lambda: (target.power_off(), refused(target.enable, "power"), target.power_on()),
}
BEFORE = {"fresh": lambda: None, "started": lambda: (target.start(ms), target.wait())}
HOMED = {"not homed": lambda: None, "homed": target.home_and_wait,
         "homed twice": lambda: (target.home_and_wait(), target.home_and_wait())}
bad = []
orders = [  # each thing that may come between two runs, with and without homing before and after it
    (before, home, middle, again)
    for middle in MIDDLES
    for before, home, again in (("started", "homed", "not homed"), ("fresh", "not homed", "homed twice"))
]
pairs = list(itertools.product(programs, orders))
if which == ["some"]:  # each order once, and each program in some of them
    many = len(programs)
    pairs = [(programs[(n + n // many) % many], order) for n, order in enumerate(orders)]
for program, order in pairs:
    try:
        load()
        if target.drive_status().explicit:
            target.drive_auto()
        BEFORE[order[0]]()
        assert target.status().trip is None, "before the sequence: " + target.status().trip.text
        target.power_on()
        HOMED[order[1]]()
        refused(target.start, "enable")
        target.enable()
        run()
        MIDDLES[order[2]]()
        HOMED[order[3]]()
        target.enable()
        run()
        target.disable(), target.enable()
        run()
    except Exception as error:
        bad.append(f"{program}: {' / '.join(order)}: {type(error).__name__}: {error}")
        if target.status().trip is not None:
            target.acknowledge()
print(f"{len(pairs)} runs of {len(orders)} orders, {len(bad)} bad")
print("\n".join(bad))
target.close()
sys.exit(bool(bad))
"""  # noqa: E501


@pytest.mark.parametrize(("machine", "programs"), PROGRAMS)
@pytest.mark.parametrize(
    "which", ["some", pytest.param("all", marks=pytest.mark.long("some of each; lost: the rest"))]
)
def test_no_order_of_the_sequence_trips_a_shipped_program(
    installed: Installed, machine: str, programs: tuple[str, ...], which: str
) -> None:
    said = installed.script(
        SCRIPT, machine, f"fast {which}", str(RUN_MS[machine]), *programs, timeout=300.0
    )
    assert said.returncode == 0, said.stdout + said.stderr


@pytest.mark.long("every order on the fast clock above; tests/target keeps time on the real one")
def test_no_order_of_the_sequence_trips_a_shipped_program_on_the_real_clock(
    installed: Installed
) -> None:
    """All at once: they wait for the time to pass."""
    script = installed.write("orders.py", SCRIPT)
    running = {
        (machine, program): installed.start("python", script, machine, "real", "300", program)
        for machine, program in REAL
    }
    for which, process in running.items():
        said, _ = process.communicate(timeout=300.0)
        assert process.returncode == 0, f"{which}: {said}"


def test_every_shipped_program_is_in_a_journey() -> None:
    here = Path(__file__).parent
    journeys = "".join(path.read_text() for path in here.glob("test_*.py"))
    programs = {
        path.name for path in (here.parents[1] / "c_isr" / "zendsp_isr" / "programs").glob("*.c")
    }
    assert len(programs) >= 10 and [name for name in programs if name not in journeys] == []
