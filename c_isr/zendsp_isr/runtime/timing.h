/* timing.h: the clock, and counting durations in constant time. */
#ifndef ZENDSP_TIMING_H
#define ZENDSP_TIMING_H

#include <stdint.h>
#include <time.h> /* clock_gettime, clock_nanosleep */

#include "layout.h"

/* CLOCK_MONOTONIC, or CLOCK_BOOTTIME, which goes on while the computer is asleep. Never the time of
 * day: it jumps. */
static inline uint64_t time_ns(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

static inline uint64_t now_ns(void) { return time_ns(CLOCK_MONOTONIC); }

static inline void sleep_until_ns(clockid_t clock, uint64_t deadline) {
    const struct timespec t = {.tv_sec = (time_t)(deadline / 1000000000u),
                               .tv_nsec = (long)(deadline % 1000000000u)};
    clock_nanosleep(clock, TIMER_ABSTIME, &t, 0);
}

static inline void sleep_ns(uint64_t duration) {
    const struct timespec t = {.tv_sec = (time_t)(duration / 1000000000u),
                               .tv_nsec = (long)(duration % 1000000000u)};
    clock_nanosleep(CLOCK_MONOTONIC, 0, &t, 0);
}

/* Histogram bin of a duration: four bins an octave. Bin b ≥ 4 begins at (4 + b mod 4) · 2^(b/4 − 1)
 * · … see histogram_edges. */
static inline uint32_t timing_bin(uint64_t ns) {
    if (ns < 4)
        return (uint32_t)ns;
    const uint32_t octave = 63u - (uint32_t)__builtin_clzll(ns); /* ≥ 2 */
    const uint32_t bin = 4u * (octave - 1u) + (uint32_t)(ns >> (octave - 2u) & 3u);
    return bin < LAYOUT_BINS ? bin : LAYOUT_BINS - 1u;
}

static inline void timing_count(timing_counts *timing, uint64_t late, uint64_t exec) {
    timing->samples++;
    timing->late_sum += late;
    timing->exec_sum += exec;
    if (late > timing->late_max)
        timing->late_max = late;
    if (exec > timing->exec_max)
        timing->exec_max = exec;
    timing->late_bins[timing_bin(late)]++;
    timing->exec_bins[timing_bin(exec)]++;
}

#endif
