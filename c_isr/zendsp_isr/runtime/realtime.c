/* realtime.c: ask the system for what a real-time thread needs, and say what was granted. */
#define _GNU_SOURCE
#include <errno.h>      /* errno */
#include <fcntl.h>      /* open */
#include <sched.h>      /* sched_setscheduler, CPU_SET */
#include <stdarg.h>     /* va_list */
#include <stdio.h>      /* vsnprintf */
#include <string.h>     /* strerror, strlen */
#include <sys/mman.h>   /* mlockall */
#include <sys/prctl.h>  /* PR_SET_TIMERSLACK */
#include <unistd.h>     /* write, close */

#include "runner.h"

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

/* The last CPU that we may use: interrupts and most other work gather on the first. */
static int choose_cpu(int wanted) {
    cpu_set_t allowed;
    CPU_ZERO(&allowed);
    if (sched_getaffinity(0, sizeof allowed, &allowed) != 0 || CPU_COUNT(&allowed) < 2)
        return -1;
    if (wanted >= 0 && wanted < CPU_SETSIZE && CPU_ISSET((size_t)wanted, &allowed))
        return wanted;
    for (int cpu = CPU_SETSIZE - 1; cpu >= 0; cpu--)
        if (CPU_ISSET((size_t)cpu, &allowed))
            return cpu;
    return -1;
}

static void own_cpu(control *c) {
    const int cpu = choose_cpu(c->cpu);
    cpu_set_t one;
    if (cpu < 0) {
        say(c, ", no CPU of its own");
        return;
    }
    CPU_ZERO(&one);
    CPU_SET((size_t)cpu, &one);
    if (sched_setaffinity(0, sizeof one, &one) == 0)
        say(c, ", on CPU %d", cpu);
    else
        say(c, ", CPU %d refused (%s)", cpu, strerror(errno));
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

/* Called by the loop's thread, after the other threads have been started with normal scheduling. */
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
    const struct sched_param priority = {.sched_priority = c->priority};
    /* not SCHED_FIFO: there, a program that hangs keeps the CPU from every other target on it until
     * its watchdog ends it */
    granted = sched_setscheduler(0, SCHED_RR | SCHED_RESET_ON_FORK, &priority) == 0;
    if (granted)
        say(c, "SCHED_RR %d", c->priority);
    else
        say(c, "normal scheduling (SCHED_RR refused: %s)", strerror(errno));
    touch_stack();
    /* not MCL_FUTURE: under a limit, mapping an acquisition later would fail; service.c locks each
     * by itself */
    if (mlockall(MCL_CURRENT | MCL_ONFAULT) == 0)
        say(c, ", memory locked");
    else
        say(c, ", memory not locked (%s)", strerror(errno));
    if (granted)
        own_cpu(c);
    say(c, prctl(PR_SET_TIMERSLACK, 1ul) == 0 ? ", timer slack 1 ns" : "");
    realtime_stay_awake(true);
    if (granted)
        say(c,
            awake >= 0 ? ", processors kept from deep sleep while it runs"
                       : ", processors may sleep (/dev/cpu_dma_latency: %s)",
            strerror(errno));
    realtime_stay_awake(false);
}
