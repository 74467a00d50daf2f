"""Updates whose numbers move gradually to their new values."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from samples import rows_of, run

from zendsp_protocol.errors import NotYet
from zendsp_target.runtime import Runtime

Make = Callable[..., Runtime]

FADES = """#include "isr.h"
static double a, list[3];
static float f;
static int32_t n;
void UserInit(void) {
    PARAMETER(a, 0.0, "", -100.0, 100.0, ""); PARAMETER(list, 0.0, "", NO_MIN, NO_MAX, "");
    PARAMETER(f, 0.0f, "", NO_MIN, NO_MAX, ""); PARAMETER(n, 0, "", 0, 100, "");
}
void UserISR_INT2(void) {}
"""


def faded(part: np.ndarray | float) -> np.ndarray:
    """The share of the way after a part of the time."""
    x = np.clip(part, 0.0, 1.0)
    return x**3 * (4.0 - 3.0 * x)


def test_a_faded_update_begins_slowly_and_is_logged_when_it_is_there(make_runtime: Make) -> None:
    runtime = make_runtime(FADES)
    goal = np.array([8.0, -8.0, 16.0])
    sequence = runtime.write({"a": 80.0, "list": goal, "f": 4.0, "n": 7}, "anna", 10, 40)
    rows = rows_of(runtime, ("a", "list", "f", "n"), 100)
    share = faded((np.arange(100) - 10) / 40)
    assert np.allclose(rows[:, 0], 80.0 * share)
    assert np.allclose(rows[:, 1:4], share[:, None] * goal)
    assert np.allclose(rows[:, 4], 4.0 * share)
    assert rows[:, 5].tolist() == [0.0] * 50 + [7.0] * 50, "whole numbers switch at its end"
    assert runtime.wait_applied(sequence, 1.0) == 50
    line = next(line for line in runtime.log() if line.name == "a")
    assert (line.tick, line.old, line.new, line.fade) == (50, 0.0, 80.0, 40)


def test_what_is_written_later_ends_the_fade_of_that_variable_alone(make_runtime: Make) -> None:
    runtime = make_runtime(FADES)
    runtime.write({"a": 80.0, "list[1]": 40.0}, "anna", 0, 40)
    runtime.write({"a": 5.0}, "ben", 20)
    runtime.write({"list[1]": 0.0}, "ben", 30, 10)
    rows = rows_of(runtime, ("a", "list"), 60)
    k = np.arange(60)
    first, second = 40.0 * faded(k / 40), 29.53125 * (1.0 - faded((k - 30) / 10))
    assert np.allclose(rows[:, 0], np.where(k < 20, 2.0 * first, 5.0)), "it is not lost again"
    there = np.select([k < 30, k < 40], [first, second], 0.0)
    assert np.allclose(rows[:, 2], there), "from where it was"
    assert [(c.tick, c.name, c.old, c.new) for c in runtime.log()] == [
        (20, "a", 25.0, 5.0), (40, "list[1]", 29.53125, 0.0),
    ], "what was never reached is no change"  # fmt: skip


def test_a_fade_that_was_cut_short_is_not_taken_for_the_programs_own_write(
    make_runtime: Make,
) -> None:
    runtime = make_runtime(FADES)
    session = runtime.programs.session
    assert session is not None
    session._look()
    runtime.write({"a": 80.0, "list": [40.0, 30.0, 20.0]}, "anna", 0, 40)
    runtime.write({"a": 5.0, "list[1]": 0.0}, "ben", 20)
    run(runtime, 60)
    session._look()
    assert runtime.status().own == () and runtime.read(["a"])[1]["a"] == 5.0


def test_a_fade_stands_while_the_time_of_the_machine_stands(make_runtime: Make) -> None:
    runtime = make_runtime(FADES)
    sequence = runtime.write({"a": 80.0}, "anna", 0, 40)
    run(runtime, 20)
    with pytest.raises(NotYet):
        runtime.wait_applied(sequence, 0.05)
    assert runtime.read(["a"])[1]["a"] == pytest.approx(80.0 * faded(19 / 40))
    rows = rows_of(runtime, ("a",), 40)
    assert np.allclose(rows[:, 0], 80.0 * faded((np.arange(40) + 20) / 40))
    runtime.write({"n": 3}, "anna", None, 1)
    assert rows_of(runtime, ("n",), 3)[:, 0].tolist() == [0.0, 3.0, 3.0]
