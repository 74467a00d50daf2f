"""Updates for a later sample are cancelled when a trip is acknowledged, when their host is lost,
and when the right to command passes to another.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from samples import run

from zendsp_protocol.errors import Refused
from zendsp_target.runtime import Runtime
from zendsp_target.serving.drives import Drives

Make = Callable[..., Runtime]
PROGRAM = """
#include "isr.h"
static double a, b;
static table rows;
void UserInit(void) {
    PARAMETER(a, 1.0, "", NO_MIN, NO_MAX, "");
    PARAMETER(b, 1.0, "", NO_MIN, NO_MAX, "");
    TABLE(rows, 8, 1, "", "");
}
void UserISR_INT2(void) {}
"""


def _never(runtime: Runtime, *numbers: int) -> None:
    for number in numbers:
        with pytest.raises(Refused, match="was not applied, and will not be"):
            runtime.wait_applied(number, 10.0)


def test_an_acknowledgement_cancels_what_waits(make_runtime: Make) -> None:
    """Their slots are free again, and the log does not have them."""
    runtime = make_runtime(PROGRAM)
    run(runtime, 10)
    numbers = [runtime.write({"a": float(k)}, "anna", at_tick=500 + k) for k in range(64)]
    with pytest.raises(Refused, match="wait for a later sample"):
        runtime.write({"a": 0.0}, "anna", at_tick=900)
    runtime.stop()
    runtime.acknowledge()
    _never(runtime, *numbers)
    again = [runtime.write({"b": float(k)}, "anna", at_tick=500 + k) for k in range(64)]
    run(runtime, 1000)
    assert [runtime.wait_applied(n, 10.0) for n in again] == list(range(500, 564))
    assert runtime.read(["a", "b"])[1] == {"a": 1.0, "b": 63.0}
    assert {change.name for change in runtime.log()} == {"b"}


def test_the_bank_of_a_table_that_never_came_is_not_the_one_in_use(make_runtime: Make) -> None:
    runtime = make_runtime(PROGRAM)
    rows = [np.full((8, 1), float(k)) for k in range(4)]
    runtime.write({"rows": rows[0]}, "anna")
    run(runtime, 10)
    number = runtime.write({"rows": rows[1]}, "anna", at_tick=500)
    runtime.cancel(lambda author: author == "anna")
    _never(runtime, number)
    for k in (2, 3):
        number = runtime.write({"rows": rows[k]}, "bo", at_tick=runtime.status().tick + 5)
        assert runtime.read(["rows"])[1]["rows"] == pytest.approx(rows[0] if k == 2 else rows[2])
        run(runtime, 10)
        assert runtime.read(["rows"])[1]["rows"] == pytest.approx(rows[k])


@pytest.mark.parametrize("policy", ["stop", "hold", "finish"])
def test_a_lost_commander_leaves_nothing_for_later(make_runtime: Make, policy: str) -> None:
    """Unless the machine is to go on as it was set."""
    runtime = make_runtime(PROGRAM)
    drives = Drives(runtime)
    drives.take("anna@a:1", False)
    drives.set_policy(policy, "anna@a:1")
    run(runtime, 10)
    hers = runtime.write({"a": 7.0}, "anna@a:1", at_tick=100)
    other = runtime.write({"b": 7.0}, "bo@b:2", at_tick=100)
    drives.host_gone("anna@a:1")
    run(runtime, 200)
    assert runtime.wait_applied(other, 10.0) == 100
    if policy == "finish":
        assert runtime.wait_applied(hers, 10.0) == 100
    else:
        _never(runtime, hers)


def test_who_takes_the_right_is_not_disturbed_by_what_others_have_set(make_runtime: Make) -> None:
    runtime = make_runtime(PROGRAM)
    drives = Drives(runtime)
    drives.take("anna@a:1", False)
    run(runtime, 10)
    hers = runtime.write({"a": 7.0}, "anna@a:1", at_tick=100)
    his = runtime.write({"b": 7.0}, "bo@b:2", at_tick=100)
    drives.take("anna@a:1", False)  # she has it already
    drives.take("bo@b:2", True)
    run(runtime, 200)
    _never(runtime, hers)
    assert runtime.wait_applied(his, 10.0) == 100
