"""A parameter that the program itself sets is told once: what a host writes to it may not last."""

from __future__ import annotations

import time
from collections.abc import Callable

from zendsp_target.runtime.runtime import Runtime

SETS = """
#include "isr.h"
static double gain, kept, adapted;
void UserInit(void) {
    PARAMETER(gain, 400.0, "", 0.0, 5000.0, "");
    PARAMETER(kept, 1.0, "", 0.0, 10.0, "");
    PARAMETER(adapted, 0.0, "", 0.0, 1.0, "");
}
void UserISR_INT2(void) { gain = 400.0; if (SAMPLE_TICK > 100) adapted = 2.0; }
"""


def test_what_the_program_itself_sets_is_told_once_and_what_the_host_writes_is_not(
    make_runtime: Callable[..., Runtime], wait_for: Callable[..., None]
) -> None:
    runtime = make_runtime(SETS, clock="real")
    runtime.write({"kept": 2.0}, "test")
    runtime.start()
    wait_for(lambda: len(runtime.status().own) == 1, lambda: runtime.status().own)
    assert runtime.status().own == (
        "adapted: the program itself sets it, past its limits of 0 and 1 (2.)",
    )
    runtime.write({"gain": 450.0, "kept": 3.0}, "test")
    wait_for(lambda: len(runtime.status().own) == 2, lambda: runtime.status().own)
    for k in range(12):  # between looks and across them
        runtime.write({"kept": 4.0 + 0.1 * k, "gain": 500.0}, "test")
        time.sleep(0.1)
    own = runtime.status().own
    assert len(own) == 2 and own[1].startswith("gain: the program itself sets it, so that"), own
