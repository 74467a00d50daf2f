"""User code may open the files that its target shares with it, as any file of its user."""

from __future__ import annotations

import subprocess
import sys

import pytest
from waiting import PATIENCE_S

from zendsp.errors import RunnerDied
from zendsp.link import Target

# cuts short what it shares with the target: each of these files, at sample 500
CUT = (
    "#define _GNU_SOURCE\n#include <stdio.h>\n#include <string.h>\n#include <unistd.h>\n"
    """#include "isr.h"
static int32_t n;
void UserInit(void) { SIGNAL(n, "", ""); }
static void cut(void) {
    char line[1024];
    FILE *maps = fopen("/proc/self/maps", "r");
    while (maps && fgets(line, sizeof line, maps)) {
        char *path = strchr(line, '/');
        if (path && (strstr(path, "/control-") || strstr(path, "/data-"))) {
            path[strcspn(path, "\\n")] = 0;
            n = truncate(path, 0);
        }
    }
}
void UserISR_INT2(void) { if (++n == 500) cut(); }
"""
)


def test_user_code_that_cuts_the_shared_memory_short_takes_down_the_runner_only(
    fast: Target,
) -> None:
    """Whoever reads a page that its file no longer has is ended by SIGBUS, but for the monitor."""
    fast.download({"cut.c": CUT})
    with pytest.raises(RunnerDied, match="SIGBUS"):
        fast.acquire(["n"], seconds=5.0, start=True)
    assert fast.status().state == "crashed"
    told = [sys.executable, "-m", "zendsp", "info", fast.name]
    done = subprocess.run(told, capture_output=True, text=True, timeout=PATIENCE_S, check=True)
    assert "SIGBUS" in done.stdout and "zendsp load FILE" in done.stdout
    fast.download("pd.c")
    assert fast.run_for(0.1).state == "paused"
