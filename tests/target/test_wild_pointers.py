"""User code with a wild pointer may write over all shared memory: the monitor survives it, and the
next load is as good as new.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import numpy as np
import pytest
from samples import run

from zendsp_protocol.errors import RunnerDied, ZendspError
from zendsp_protocol.messages import Trigger
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime

# Finds the shared mappings in /proc/self/maps, and fills them at sample 50 with a byte, or with
# noise.
WILD = """
#include "isr.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
static double x, gain; static table ref;
static unsigned char *from[8]; static size_t bytes[8]; static int found;
static uint32_t noise = 1u;
void UserInit(void) {
    PARAMETER(gain, 1.0, "", NO_MIN, NO_MAX, ""); SIGNAL(x, "", ""); TABLE(ref, 100, 2, "", "");
}
static void search(void) {
    char line[1024];
    FILE *maps = fopen("/proc/self/maps", "r");
    while (maps && found < 8 && fgets(line, sizeof line, maps)) {
        unsigned long a, b;
        if ((strstr(line, "/control-") || strstr(line, "/data-") || strstr(line, "/stream-")) && sscanf(line, "%lx-%lx", &a, &b) == 2) {
            from[found] = (unsigned char *)a; bytes[found] = b - a; found++;
        }
    }
    if (maps) fclose(maps);
}
void UserISR_INT2(void) {
    x += 1.0;
    if (SAMPLE_TICK != 50) return;
    search();
    for (int i = 0; i < found; i++)
        for (size_t k = 0; k < bytes[i]; k++) { noise = noise * 1664525u + 1013904223u; from[i][k] = FILL; }
    for (;;) noise++;
}
"""  # noqa: E501


@pytest.mark.parametrize("fill", ["0x00", "0xff", "0x01", "(unsigned char)(noise >> 24)"])
def test_the_monitor_survives_shared_memory_full_of_rubbish(
    make_runtime: Callable[..., Runtime],
    wait_for: Callable[..., None],
    load: Callable[[Runtime, str], None],
    fill: str,
) -> None:
    runtime = make_runtime(WILD.replace("FILL", fill), hang_s=0.2)
    runtime.acquire_configure(0, AcquireConfig(("x", "enc"), seconds=0.2, continuous=True))
    runtime.acquire_configure(
        1, AcquireConfig(("x",), seconds=0.2, trigger=Trigger("x", 10.0, "rising", 0.005))
    )
    for stream in (0, 1):
        runtime.acquire_start(stream)
    runtime.write({"gain": 2.0, "ref": np.ones((10, 2))}, "me")
    with contextlib.suppress(RunnerDied):  # sample 50 comes soon
        runtime.start()
    calls: list[Callable[[], object]] = [
        runtime.status,
        lambda: runtime.read(["x", "gain", "ref", "enc"]),
        lambda: runtime.write({"gain": 3.0}, "me"),
        lambda: runtime.write({"ref": np.zeros((5, 2))}, "me"),
        runtime.limits,
        runtime.machine,
        runtime.variables,
        runtime.log,
        lambda: runtime.acquire_status(0),
        lambda: runtime.acquire_status(1),
        lambda: runtime.acquire_read(0, 0, 1000),
        lambda: runtime.acquire_read(1, 5, 1000),
        lambda: runtime.acquire_read(0, max(0, runtime.acquire_status(0).first), 10),
        runtime.stop,
    ]

    def ended() -> bool:
        for call in calls:
            try:
                call()
            except ZendspError:
                continue  # a clear refusal is a fine answer; anything else fails the test
        return runtime.programs.session is not None and runtime.programs.session.crash != ""

    wait_for(ended)
    for call in calls:
        try:
            call()
        except ZendspError:
            continue
    assert runtime.status().state == "crashed"
    assert runtime.machine().name == "imi_planar"
    runtime.acknowledge()  # the STOP among the calls
    load(
        runtime,
        '#include "isr.h"\nstatic double x;\nvoid UserInit(void) { SIGNAL(x, "", ""); }\n'
        "void UserISR_INT2(void) { x += 1.0; }\n",
    )
    run(runtime, 10)
    assert runtime.read(["x"])[1]["x"] == 10.0
