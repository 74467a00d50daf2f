/* realtime.c: ask the system for what a real-time thread needs, and say what was granted. */
#define _GNU_SOURCE
#include <errno.h>      /* errno */
#include <fcntl.h>      /* open */
#include <sched.h>      /* sched_getaffinity, CPU_SET */
#include <stdarg.h>     /* va_list */
#include <stdio.h>      /* vsnprintf */
#include <string.h>     /* strerror, strlen */
#include <sys/mman.h>   /* mlockall */
#include <sys/prctl.h>  /* PR_SET_TIMERSLACK */
#include <unistd.h>     /* write, close, getppid */

#include "runner.h"
#include "timing.h"

static bool granted;
static int awake = -1; /* the open request to keep the processors from sleeping deeply */

bool realtime_granted(void) { return granted; }

static void say(control *c, const char *format, ...) {
    const size_t used = strlen(c->scheduling);
    va_list arguments;
    va_start(arguments, format);
    if (used < sizeof c->scheduling)
        vsnprintf(c->scheduling + used, sizeof c->scheduling - used, format, arguments);
    va_end(arguments);
}

/* The CPU on which alone this thread runs; -1 where there are several. */
static int own_cpu(void) {
    cpu_set_t allowed;
    CPU_ZERO(&allowed);
    if (sched_getaffinity(0, sizeof allowed, &allowed) == 0 && CPU_COUNT(&allowed) == 1)
        for (int cpu = 0; cpu < CPU_SETSIZE; cpu++)
            if (CPU_ISSET((size_t)cpu, &allowed))
                return cpu;
    return -1;
}

/* The monitor makes the loop urgent, from outside: user code, which is loaded by now, may not make
 * anything so. 0, or why it could not. */
static int wait_for_priority(control *c) {
    store32(&c->phase, PHASE_LOADED);
    while (load32(&c->scheduled) == 0 && getppid() == c->monitor)
        sleep_ns(50000);
    const uint32_t answer = load32(&c->scheduled); /* 0 where the monitor is gone */
    granted = answer == 1;
    return (int)answer - 1;
}

/* Have the pages of the stack before the loop needs them. */
static void touch_stack(void) {
    volatile unsigned char pages[256 * 1024];
    for (size_t i = 0; i < sizeof pages; i += 4096)
        pages[i] = 0;
}

/* While it runs, the loop asks that no processor sleep so deeply that waking takes time; the kernel
 * drops the request with the process. */
void realtime_stay_awake(bool wanted) {
    if (!wanted && awake >= 0) {
        close(awake);
        awake = -1;
    } else if (wanted && granted && awake < 0) {
        const int32_t none_us = 0;
        awake = open("/dev/cpu_dma_latency", O_WRONLY | O_CLOEXEC);
        if (awake >= 0 && write(awake, &none_us, sizeof none_us) != sizeof none_us)
            realtime_stay_awake(false);
    }
}

/* Called by the loop's thread, after the program is loaded. */
void realtime_enter(runner *r) {
    control *c = r->control;
    c->scheduling[0] = 0;
    if (c->clock == CLOCK_FAST) {
        say(c, "fast clock: normal scheduling, as fast as the CPU allows");
        return;
    }
    if (!c->realtime) {
        prctl(PR_SET_TIMERSLACK, 1ul);
        say(c, "normal scheduling as asked, timer slack 1 ns");
        return;
    }
    const int why = wait_for_priority(c);
    if (granted)
        say(c, "SCHED_RR %d", c->priority);
    else
        say(c, "normal scheduling (SCHED_RR refused: %s)", strerror(why));
    touch_stack();
    /* not MCL_FUTURE: under a limit, mapping an acquisition later would fail; service.c locks each
     * by itself */
    if (mlockall(MCL_CURRENT | MCL_ONFAULT) == 0)
        say(c, ", memory locked");
    else
        say(c, ", memory not locked (%s)", strerror(errno));
    const int cpu = own_cpu();
    if (cpu >= 0)
        say(c, ", on CPU %d", cpu);
    else if (granted)
        say(c, ", no CPU of its own");
    say(c, prctl(PR_SET_TIMERSLACK, 1ul) == 0 ? ", timer slack 1 ns" : "");
    realtime_stay_awake(true);
    if (granted)
        say(c,
            awake >= 0 ? ", processors kept from deep sleep while it runs"
                       : ", processors may sleep (/dev/cpu_dma_latency: %s)",
            strerror(errno));
    realtime_stay_awake(false);
}
