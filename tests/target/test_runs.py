"""Parameters that a run has set are restored by its own host, or when that host is lost."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from samples import run

from zendsp_protocol import verbs
from zendsp_protocol.errors import Refused, VariableError
from zendsp_target.runtime import Runtime
from zendsp_target.serving.drives import Drives
from zendsp_target.serving.guard import COMMANDING, Guard
from zendsp_target.serving.runs import MOST, Runs

PROGRAM = """
#include "isr.h"
static double k;
void UserInit(void) { PARAMETER(k, 1.0, "", NO_MIN, NO_MAX, ""); }
void UserISR_INT2(void) { }
"""


def test_nobody_ends_the_run_of_another_or_keeps_others_from_theirs(
    make_runtime: Callable[..., Runtime]
) -> None:
    """A host with the role `tune` had restored another's sweep, and used up all runs."""
    runtime = make_runtime(PROGRAM)
    runs = Runs(runtime, Drives(runtime))
    begin = verbs.RunBegin(names=("k",), moves=False, fade=0.0)
    number = runs.do_run_begin(begin, "anna").run
    runtime.write({"k": 5.0}, "anna")
    run(runtime, 3)
    with pytest.raises(Refused, match="own host, anna"):
        runs.do_run_end(verbs.RunEnd(run=number), "mallory")
    for _ in range(MOST):
        runs.do_run_begin(begin, "mallory")
    with pytest.raises(Refused, match="of your runs"):
        runs.do_run_begin(begin, "mallory")
    assert runs.do_run_begin(begin, "bob").run
    assert runtime.read(["k"])[1] == {"k": 5.0}
    runs.do_run_end(verbs.RunEnd(run=number), "anna")
    run(runtime, 3)
    assert runtime.read(["k"])[1] == {"k": 1.0}


def test_a_run_ends_where_another_commands_and_its_host_may_leave_then(
    make_runtime: Callable[..., Runtime]
) -> None:
    """The end had been refused: the run stayed open, and when its host left, the program that the
    other one had started meanwhile was stopped as "host lost".
    """
    runtime = make_runtime(PROGRAM)
    drives = Drives(runtime)
    runs = Runs(runtime, drives)
    handlers = dict.fromkeys((*COMMANDING, "run_end"), runs.do_run_end)
    Guard(drives).enter(handlers)
    number = runs.do_run_begin(verbs.RunBegin(names=("k",), moves=True), "anna").run
    runtime.write({"k": 5.0}, "anna")
    run(runtime, 3)
    drives.act(verbs.Drive(action="take"), "bob")
    with pytest.raises(Refused, match="bob has the exclusive right"):
        handlers["run_end"](verbs.RunEnd(run=number), "anna")
    assert drives.status().moved_by == ""
    drives.act(verbs.Drive(action="release"), "bob")
    runtime.write({"k": 7.0}, "bob")
    run(runtime, 3)
    runs.host_gone("anna")
    assert runtime.read(["k"])[1] == {"k": 7.0}
    assert runtime.status().trip is None


OWN = """
#include "isr.h"
static double k, adapts, x;
void UserInit(void) {
    PARAMETER(k, 1.0, "", NO_MIN, NO_MAX, "");
    PARAMETER(adapts, 1.0, "", 0.0, 10.0, "");
    SIGNAL(x, "", "");
}
void UserISR_INT2(void) { if (k == 1.0) adapts = 20.0; }
"""


def test_a_parameter_that_cannot_be_restored_does_not_keep_others_from_it(
    make_runtime: Callable[..., Runtime]
) -> None:
    """A parameter that the program itself had set beyond its limits; a signal."""
    runtime = make_runtime(OWN)
    runs = Runs(runtime, Drives(runtime))
    with pytest.raises(Refused, match="no signals: x"):
        runs.do_run_begin(verbs.RunBegin(names=["k", "x"]), "anna")
    run(runtime, 3)
    number = runs.do_run_begin(verbs.RunBegin(names=["adapts", "k"]), "anna").run
    runtime.write({"k": 5.0, "adapts": 2.0}, "anna")
    run(runtime, 3)
    with pytest.raises(VariableError, match=r"adapts: 20 is outside .* put back: k"):
        runs.do_run_end(verbs.RunEnd(run=number), "anna")
    run(runtime, 1)
    assert runtime.read(["k"])[1] == {"k": 1.0}
