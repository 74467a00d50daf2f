/* monitor.c: what the monitor does on shared memory that needs ordering: Python has no acquire and
 * release. Loaded by cffi. */
#define _GNU_SOURCE
#include <float.h>     /* DBL_MAX, FLT_MAX */
#include <math.h>      /* fabs */
#include <poll.h>      /* poll, on a pidfd */
#include <string.h>    /* memcpy */
#include <sys/prctl.h> /* PR_SET_TIMERSLACK */
#include <time.h>      /* nanosleep */

#include "monitor.h"
#include "timing.h" /* now_ns */

/* Copy `bytes` of values from byte `from` on, all of the newest sample. Returns 1 and its tick, or
 * 0 when the loop kept overwriting it (never seen). Place and size come from the monitor's own
 * memory: what user code may have scribbled over must not steer a copy. */
int monitor_snapshot(const uint64_t *newest_word, const unsigned char *slots, uint64_t stride,
                     uint64_t from, uint64_t bytes, unsigned char *values, uint64_t *tick) {
    for (int attempt = 0; attempt < 1000; attempt++) {
        const uint64_t newest = __atomic_load_n(newest_word, __ATOMIC_ACQUIRE);
        if (newest == 0)
            return 0;
        const uint64_t n = newest - 1;
        const unsigned char *place = slots + n % LAYOUT_SNAPSHOTS * stride;
        const snapshot *slot = (const snapshot *)(const void *)place;
        if (__atomic_load_n(&slot->sequence, __ATOMIC_ACQUIRE) != 2 * n + 2)
            continue;
        *tick = slot->tick;
        memcpy(values, place + sizeof *slot + from, bytes);
        __atomic_thread_fence(__ATOMIC_ACQUIRE);
        if (__atomic_load_n(&slot->sequence, __ATOMIC_RELAXED) == 2 * n + 2)
            return 1;
    }
    return 0;
}

/* Whether the process of a pidfd has ended. */
int monitor_ended(int pidfd) {
    struct pollfd process = {.fd = pidfd, .events = POLLIN};
    return poll(&process, 1, 0) > 0;
}

/* Make a filled batch visible to the loop: from here on it is applied whole, before here not at
 * all. Returns 0 and does nothing when the runner (its pidfd, or -1 where the kernel has none) has
 * ended. */
static int commit(control *c, batch *b, uint32_t index, int pidfd) {
    if (pidfd >= 0 && monitor_ended(pidfd))
        return 0;
    __atomic_store_n(&b->state, BATCH_COMMITTED, __ATOMIC_RELAXED);
    c->ring[c->ring_head % LAYOUT_BATCHES] = index;
    __atomic_store_n(&c->ring_head, c->ring_head + 1, __ATOMIC_RELEASE);
    return 1;
}

static uint32_t fit(const update_part *part, double v) {
    if (!(fabs(v) <= DBL_MAX))
        return FIT_NOT_FINITE;
    if (!(v >= part->least && v <= part->greatest))
        return FIT_OUTSIDE;
    switch (part->type) {
    case TYPE_INT32:
        return v >= INT32_MIN && v <= INT32_MAX && v == (double)(int32_t)v ? FIT : FIT_NOT_WHOLE;
    case TYPE_BOOL:
        return v >= 0.0 && v <= 1.0 && v == (double)(int32_t)v ? FIT : FIT_NO_FLAG;
    case TYPE_FLOAT:
        return fabs(v) <= (double)FLT_MAX ? FIT : FIT_TOO_LARGE;
    default:
        return FIT;
    }
}

/* Whether numbers may be written (NaN, limits, whole numbers): FIT, or why not, with the place of
 * the first that may not in its part. The one check of every update, by whatever road it came. */
uint32_t monitor_fit(const update_part *part, uint32_t parts, const double *values,
                     uint32_t *wrong) {
    for (uint32_t i = 0; i < parts; values += part[i++].count)
        for (uint32_t k = 0; k < part[i].count; k++) {
            const uint32_t why = fit(part + i, values[k]);
            if (why != FIT) {
                *wrong = k;
                return why;
            }
        }
    return FIT;
}

/* One number, in the type of its variable; returns where the next goes. */
static unsigned char *put(unsigned char *to, int32_t type, double v) {
    if (type == TYPE_DOUBLE) {
        memcpy(to, &v, sizeof v);
        return to + sizeof v;
    }
    if (type == TYPE_FLOAT) {
        const float f = (float)v;
        memcpy(to, &f, sizeof f);
        return to + sizeof f;
    }
    if (type == TYPE_INT32) {
        const int32_t n = (int32_t)v;
        memcpy(to, &n, sizeof n);
        return to + sizeof n;
    }
    *to = v != 0.0;
    return to + 1;
}

/* Lay numbers that fit out as the entries of a batch; returns their bytes. */
uint64_t monitor_pack(const update_part *part, uint32_t parts, const double *values,
                      unsigned char *to) {
    const unsigned char *begin = to;
    for (const update_part *p = part; p < part + parts; p++) {
        memcpy(to, &p->entry, sizeof p->entry);
        to += sizeof p->entry;
        unsigned char *at = to;
        for (uint32_t k = 0; k < p->count; k++)
            at = put(at, p->type, *values++);
        to += (p->entry.size + 7) & ~7;
    }
    return (uint64_t)(to - begin);
}

/* Fill and commit an update: `values` hold the numbers of its parts, one after another; `fade`, in
 * samples, is for batches with room for as many old ones. Returns 1; 0 when the runner has ended;
 * -1, nothing done, when one of them does not fit. */
int monitor_write(const update_plan *plan, const double *values, batch *b, uint32_t index,
                  uint64_t sequence, uint64_t at_tick, uint64_t fade) {
    uint32_t wrong;
    if (monitor_fit(plan->part, plan->parts, values, &wrong) != FIT)
        return -1;
    b->old = monitor_pack(plan->part, plan->parts, values, (unsigned char *)(b + 1));
    b->entries = plan->parts;
    b->cancel = 0;
    b->sequence = sequence;
    b->at_tick = at_tick;
    b->fade = fade;
    return commit(plan->to, b, index, plan->pidfd);
}

/* Numbers in a message: of eight bytes, the most significant first. */
static uint64_t from_message(const unsigned char *bytes) {
    uint64_t word = 0;
    for (int i = 0; i < 8; i++)
        word = word << 8 | bytes[i];
    return word;
}
static void to_message(unsigned char *bytes, uint64_t word) {
    for (int i = 7; i >= 0; i--, word >>= 8)
        bytes[i] = (unsigned char)word;
}

/* Answer a reading that came before: fill its doubles, all of the newest sample, and their tick
 * into the reply. Returns 0 when the program is not loaded any more or no longer runs (the long way
 * says why), or there is no sample. */
int monitor_read_again(const repeated_read *r) {
    uint64_t tick, word;
    if (__atomic_load_n(r->ended, __ATOMIC_ACQUIRE) ||
        __atomic_load_n(&r->of->trip.reason, __ATOMIC_ACQUIRE))
        return 0;
    if (!monitor_snapshot(&r->of->newest, r->data + r->slots_at, r->stride, r->from, r->bytes,
                          r->values, &tick))
        return 0;
    to_message(r->reply + r->tick_at, tick);
    for (uint32_t i = 0; i < r->count; i++) {
        memcpy(&word, r->values + r->places[2 * i], sizeof word);
        to_message(r->reply + r->places[2 * i + 1], word);
    }
    return 1;
}

/* Answer a write of doubles that came before, by a request as long as the first: its values go to
 * the loop, `sequence` to the reply. Returns what monitor_write does; 0 also when the program is
 * not loaded any more, or another byte of the request is not as it was. */
int monitor_write_again(const repeated_write *w, const unsigned char *request, batch *b,
                        uint32_t index, uint64_t sequence) {
    if (__atomic_load_n(w->ended, __ATOMIC_ACQUIRE))
        return 0;
    uint32_t at = 0;
    for (uint32_t i = 0; i < w->plan->parts; at = w->places[i++] + (uint32_t)sizeof(double)) {
        if (memcmp(request + at, w->request + at, w->places[i] - at) != 0)
            return 0;
        const uint64_t word = from_message(request + w->places[i]);
        memcpy(w->values + i, &word, sizeof word);
    }
    if (memcmp(request + at, w->request + at, w->length - at) != 0)
        return 0;
    to_message(w->reply + w->sequence_at, sequence);
    return monitor_write(w->plan, w->values, b, index, sequence, 0, 0);
}

uint32_t monitor_load32(const uint32_t *word) { return __atomic_load_n(word, __ATOMIC_ACQUIRE); }
uint64_t monitor_load64(const uint64_t *word) { return __atomic_load_n(word, __ATOMIC_ACQUIRE); }
void monitor_store32(uint32_t *word, uint32_t value) {
    __atomic_store_n(word, value, __ATOMIC_RELEASE);
}
void monitor_store64(uint64_t *word, uint64_t value) {
    __atomic_store_n(word, value, __ATOMIC_RELEASE);
}

/* RUN_… requested by the monitor, unless the runner is already quitting. */
void monitor_run(control *c, uint32_t run) {
    uint32_t now = __atomic_load_n(&c->run, __ATOMIC_ACQUIRE);
    while (now != RUN_QUIT && !__atomic_compare_exchange_n(&c->run, &now, run, 0, __ATOMIC_ACQ_REL,
                                                           __ATOMIC_ACQUIRE)) {
    }
}

/* What `heartbeat` will be once the loop has gone round whole, a sample or a look around while
 * paused, after all that was stored before this call. */
uint64_t monitor_round(const control *c) {
    __atomic_thread_fence(__ATOMIC_SEQ_CST); /* what was stored is there before this is read */
    return (__atomic_load_n(&c->heartbeat, __ATOMIC_ACQUIRE) | 1u) + 3u;
}

/* Whether a batch has been applied (or cancelled), and whoever reads from here on gets its
 * values. */
int monitor_shown(const control *c, const batch *b) {
    return __atomic_load_n(&b->state, __ATOMIC_ACQUIRE) >= BATCH_APPLIED &&
           __atomic_load_n(&c->newest, __ATOMIC_ACQUIRE) >= b->shown;
}

/* Wait until a batch is shown: awake for awake_ns, since falling asleep and waking take as long as
 * a short sample, then mostly asleep. Returns 1 when it is, 0 after timeout_ns. */
int monitor_wait_shown(const control *c, const batch *b, uint64_t timeout_ns, uint64_t awake_ns) {
    const struct timespec nap = {.tv_sec = 0, .tv_nsec = 20000};
    const uint64_t begin = now_ns();
    int asleep = 0;
    for (;;) {
        if (monitor_shown(c, b))
            return 1;
        const uint64_t passed = now_ns() - begin;
        if (passed >= timeout_ns)
            return 0;
        if (passed < awake_ns)
            continue;
        if (!asleep++)
            prctl(PR_SET_TIMERSLACK, 1ul); /* of this thread: naps of 20 us, not of 70 */
        nanosleep(&nap, 0);
    }
}

/* Chosen when it is loaded: one build serves every processor of its kind, and those of today do
 * this in two thirds of the time. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif
/* words, as in zendsp_protocol/chunks.py; bytes */
enum { FOLD = 4096 / sizeof(uint64_t), LINE = 64, AHEAD = 1024 };
typedef uint64_t lanes __attribute__((vector_size(32), aligned(8), may_alias));

/* Copy words, and join them into `fold`, the first into word `at` of it, by exclusive or: on the
 * way, since a second look at so many would cost half as much again. */
WIDE static void copy_folding(double *to, const double *from, uint64_t words, uint64_t *fold,
                              uint64_t at) {
    while (words > 0) {
        if (at == 0 && words >= FOLD) {
            lanes *t = (lanes *)(void *)to, *f = (lanes *)(void *)fold;
            const lanes *s = (const lanes *)(const void *)from;
            for (int i = 0; i < (int)(FOLD * sizeof(uint64_t) / sizeof(lanes));
                 i += (int)(LINE / sizeof(lanes))) {
                /* processors stop looking ahead where a page ends */
                __builtin_prefetch((const char *)(s + i) + AHEAD);
                const lanes v = s[i], w = s[i + 1];
                t[i] = v;
                t[i + 1] = w;
                f[i] ^= v;
                f[i + 1] ^= w;
            }
            to += FOLD, from += FOLD, words -= FOLD;
            continue;
        }
        uint64_t word;
        memcpy(&word, from, sizeof word);
        memcpy(to, &word, sizeof word);
        fold[at] ^= word;
        at = (at + 1) % FOLD;
        to++, from++, words--;
    }
}

/* Copy rows [first, first + count) of a ring of `capacity` rows, and join their bytes into `fold`
 * (4096 bytes, or 0). Returns how many leading rows may have been overwritten meanwhile. */
uint64_t monitor_rows(const uint64_t *count_word, const double *rows, uint64_t capacity,
                      uint64_t channels, uint64_t first, uint64_t count, double *to,
                      uint64_t *fold) {
    const uint64_t place = first % capacity;
    const uint64_t before_end = (capacity - place < count ? capacity - place : count) * channels;
    const uint64_t after = count * channels - before_end;
    if (fold) {
        copy_folding(to, rows + place * channels, before_end, fold, 0);
        copy_folding(to + before_end, rows, after, fold, before_end % FOLD);
    } else {
        memcpy(to, rows + place * channels, before_end * sizeof(double));
        memcpy(to + before_end, rows, after * sizeof(double));
    }
    __atomic_thread_fence(__ATOMIC_ACQUIRE);
    /* the row that the loop is writing now, and all before it by one round, are not to be trusted
     */
    const uint64_t written = __atomic_load_n(count_word, __ATOMIC_ACQUIRE) + 1;
    const uint64_t oldest = written > capacity ? written - capacity : 0;
    return oldest > first ? (oldest - first < count ? oldest - first : count) : 0;
}
