"""Two targets on one computer: what one does wrong is not the end of the other."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from zendsp_target.runtime import Runtime

Make = Callable[..., Runtime]
Wait = Callable[..., None]

HANGS_S = 3.0  # before its watchdog ends it
PROGRAM = """
#include "isr.h"
static double n;
void UserInit(void) {{ SIGNAL(n, "", ""); }}
void UserISR_INT2(void) {{ n += 1.0; {what} }}
void UserBackground(void) {{}}
"""


def test_a_program_that_hangs_leaves_the_other_target_its_cpu(
    make_runtime: Make, wait_for: Wait
) -> None:
    other = make_runtime(PROGRAM.format(what=""), clock="real")
    if "normal scheduling" in other.status().scheduling:
        pytest.skip("needs the right to real-time scheduling")
    other.start()
    hanging = make_runtime(
        PROGRAM.format(what='if (n > 100.0) for (;;) __asm__ volatile("");'),
        clock="real",
        hang_s=HANGS_S,
    )
    hanging.start()
    wait_for(lambda: hanging.status().crash != "", hanging.status)
    assert "watchdog" in hanging.status().crash
    assert other.status().crash == "" and other.status().state == "running"
    longest = 1e-9 * other.status().timing.late_max_ns
    assert longest < 0.5 * HANGS_S, "its turn comes, by slices of 0.1 s, while the other hangs"
