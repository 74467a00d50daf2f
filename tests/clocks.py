"""Clocks that a test can set for processes that it starts, and for no others: the time of day, and
the one that goes on while a computer is asleep.
"""

from __future__ import annotations

import mmap
import os
import struct
import subprocess
from pathlib import Path

from zendsp_isr.compiler import find_compiler

_SHIM = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static const volatile int64_t nothing[2];
static const volatile int64_t *ahead = nothing; /* s: of the time of day, since the start */
static int (*get)(clockid_t, struct timespec *);
static int (*nap)(clockid_t, int, const struct timespec *, struct timespec *);

__attribute__((constructor)) static void begin(void) {
    get = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    nap = (int (*)(clockid_t, int, const struct timespec *, struct timespec *))dlsym(
        RTLD_NEXT, "clock_nanosleep");
    const int file = open(getenv("TEST_CLOCKS"), O_RDONLY | O_CLOEXEC);
    void *page = mmap(NULL, sizeof nothing, PROT_READ, MAP_SHARED, file, 0);
    if (page != MAP_FAILED)
        ahead = page;
    close(file);
}

static time_t shift(clockid_t clock) {
    return clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE ? ahead[0]
           : clock == CLOCK_BOOTTIME ? ahead[1] : 0;
}

int clock_gettime(clockid_t clock, struct timespec *t) {
    if (!get)
        begin();
    const int answer = get(clock, t);
    t->tv_sec += shift(clock);
    return answer;
}

int clock_nanosleep(clockid_t clock, int flags, const struct timespec *t, struct timespec *left) {
    struct timespec real = *t;
    if (flags & TIMER_ABSTIME)
        real.tv_sec -= shift(clock);
    return nap(clock, flags, &real, left);
}

int gettimeofday(struct timeval *restrict t, void *restrict zone) {
    struct timespec now;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &now);
    *t = (struct timeval){now.tv_sec, now.tv_nsec / 1000};
    return 0;
}

time_t time(time_t *t) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (t)
        *t = now.tv_sec;
    return now.tv_sec;
}
"""


class Clocks:
    """Two clocks of all processes that have `env` in their environment.

    Parameters
    ----------
    folder : Path
        Where the library goes.
    """

    def __init__(self, folder: Path) -> None:
        source, library, page = (folder / f"clocks.{end}" for end in ("c", "so", "page"))
        source.write_text(_SHIM)
        compiler = [*find_compiler().command, "-shared", "-fPIC", "-O1", "-o", str(library)]
        subprocess.run([*compiler, str(source), "-ldl"], check=True)
        page.write_bytes(bytes(16))
        file = os.open(page, os.O_RDWR)
        self._page = mmap.mmap(file, 16)
        os.close(file)
        self.env = {"LD_PRELOAD": str(library), "TEST_CLOCKS": str(page)}

    def set(self, day_s: int = 0, since_start_s: int = 0) -> None:
        """Set them ahead of the true ones, or behind, by whole seconds."""
        struct.pack_into("=qq", self._page, 0, day_s, since_start_s)
