/* service.c: the threads beneath the loop: service (maps streams, sees the monitor go) and
 * background (UserBackground). */
#define _GNU_SOURCE
#include <dirent.h>       /* opendir */
#include <errno.h>        /* errno */
#include <fcntl.h>        /* open */
#include <pthread.h>      /* threads */
#include <signal.h>       /* sigaltstack */
#include <stdio.h>        /* snprintf, fopen */
#include <stdlib.h>       /* calloc, free, abort */
#include <string.h>       /* strrchr */
#include <sys/mman.h>     /* mmap */
#include <sys/resource.h> /* setpriority */
#include <sys/stat.h>     /* fstat */
#include <unistd.h>       /* getppid, close */

#include "runner.h"
#include "timing.h"

/* Between two looks at what is wanted. Each wakes a processor: every ms took 9 ms of one in each
 * second, as much as a loop of 1 kHz. */
enum { SERVICE_NS = 5000000 };
/* That the monitor may stand still while a host commands the machine: a host that is lost is
 * noticed within about a second, and this is for a monitor that cannot. */
static const double unwatched_s = 3.0;

/* What the service remembers of the monitor. */
typedef struct watch {
    uint64_t last, silent_ns;
    uint32_t seen;
} watch;

static const void *source_of(const control *c, const channel *which, int32_t *type) {
    static const int32_t size_of_type[] = {0, sizeof(double), sizeof(float), sizeof(int32_t),
                                           sizeof(bool)};
    if (which->variable < 0 || which->variable >= c->variables)
        return NULL;
    const variable_entry *v = &c->variable[which->variable];
    if (v->kind == KIND_TABLE || which->element < 0 || which->element >= v->length)
        return NULL;
    *type = v->type;
    return (const unsigned char *)(uintptr_t)v->pointer + which->element * size_of_type[v->type];
}

/* Check the head against the file and find every channel's address. */
static int resolve(const control *c, stream *s) {
    stream_head *h = s->head;
    const uint64_t row = h->channels * sizeof(double);
    if (h->magic != LAYOUT_MAGIC || h->version != LAYOUT_VERSION || h->channels < 1 ||
        h->channels > LAYOUT_CHANNELS || h->decimation < 1 || h->capacity < 1 ||
        h->rows + h->capacity * row > s->bytes)
        return EINVAL;
    for (uint32_t i = 0; i < h->channels; i++) {
        s->pointer[i] = source_of(c, &h->channel[i], &s->type[i]);
        if (!s->pointer[i])
            return EINVAL;
    }
    s->trigger = h->edge == EDGE_NONE ? NULL : source_of(c, &h->trigger, &s->trigger_type);
    s->rows = (double *)(void *)((unsigned char *)h + h->rows);
    return 0;
}

static void unmap(stream *s) {
    if (s) {
        if (s->head)
            contain_unmap(s->head, s->bytes);
        free(s);
    }
}

/* Map a stream with all its pages present, so that the loop never faults on it. */
static stream *map(const control *c, const char *path, int *failed) {
    struct stat status;
    const int file = open(path, O_RDWR | O_CLOEXEC);
    if (file < 0 || fstat(file, &status) != 0) {
        *failed = errno;
        if (file >= 0)
            close(file);
        return NULL;
    }
    stream *s = calloc(1, sizeof *s);
    if (s) {
        s->bytes = (uint64_t)status.st_size;
        s->head = contain_map(file, s->bytes);
        *failed = s->head ? resolve(c, s) : errno;
        if (s->head && c->clock == CLOCK_REAL)
            mlock(s->head, s->bytes); /* refused beyond a limit: then present, though not locked */
    } else {
        *failed = ENOMEM;
    }
    close(file);
    if (*failed) {
        unmap(s);
        return NULL;
    }
    return s;
}

/* Offer each newly requested stream to the loop; take back the old one once the loop has let go of
 * it. */
static void serve_streams(runner *r) {
    for (int i = 0; i < LAYOUT_STREAMS; i++) {
        stream_slot *slot = &r->control->stream[i];
        const uint32_t wanted = load32(&slot->requested);
        if (wanted == r->buffers.offered[i])
            continue;
        stream *old = r->buffers.streams[i];
        int failed = 0;
        stream *next = wanted % 2 ? map(r->control, slot->path, &failed) : NULL;
        slot->failed = failed;
        __atomic_store_n(&r->buffers.streams[i], next, __ATOMIC_RELEASE);
        store32(&r->buffers.offered[i], wanted);
        while (load32(&slot->mapped) != wanted && load32(&r->control->run) != RUN_QUIT &&
               getppid() == r->control->monitor)
            sleep_ns(200000);
        if (load32(&slot->mapped) == wanted)
            unmap(old);
    }
}

/* An orphan has nobody to report to: the loop makes the machine safe and ends; if it cannot, user
 * code being stuck, we do; if the machine does not let us, the process ends all the same, and what
 * it has of a watchdog acts. */
static void end_orphan(runner *r) {
    contain_end_within(ORPHAN_S);
    store32(&r->control->run, RUN_QUIT);
    contain_end_children();
    sleep_ns(2000000000u);
    r->config.machine->safe(r->config.handle);
    contain_end_group();
    _exit(1);
}

/* Whether a thread of the monitor has a processor or waits for one, or for a disk. */
static bool monitor_waits(const control *c) {
    char name[64], stat[512];
    snprintf(name, sizeof name, "/proc/%d/task", (int)c->monitor);
    DIR *threads = opendir(name);
    bool found = false;
    for (struct dirent *one; threads && !found && (one = readdir(threads));) {
        snprintf(name, sizeof name, "/proc/%d/task/%.20s/stat", (int)c->monitor, one->d_name);
        FILE *file = fopen(name, "re");
        const char *end = file && fgets(stat, sizeof stat, file) ? strrchr(stat, ')') : NULL;
        found = end && (end[2] == 'R' || end[2] == 'D');
        if (file)
            fclose(file);
    }
    if (threads)
        closedir(threads);
    return found;
}

/* Nobody would see that the host is lost which commands the machine: it stops. For a simulated one
 * a busy computer is no reason. */
static void check_watched(runner *r, watch *w) {
    control *c = r->control;
    const uint32_t seen = load32(&c->watched);
    const uint64_t now = now_ns(), passed = now - w->last;
    w->last = now;
    if (seen != w->seen || !load32(&c->attended) || load32(&c->running) == RUN_PAUSED) {
        w->seen = seen;
        w->silent_ns = 0;
        return;
    }
    /* of a computer that stood still, a little: the monitor did so too */
    w->silent_ns += passed < 4 * SERVICE_NS ? passed : 4 * SERVICE_NS;
    if (1e-9 * (double)w->silent_ns < unwatched_s)
        return;
    if (!c->info.simulated || !monitor_waits(c)) {
        uint32_t none = TRIP_NONE;
        __atomic_compare_exchange_n(&c->stop, &none, TRIP_UNWATCHED, false, __ATOMIC_ACQ_REL,
                                    __ATOMIC_ACQUIRE);
    }
    w->silent_ns = 0;
}

static void *service(void *argument) {
    runner *r = argument;
    watch w = {.last = now_ns()};
    for (;;) {
        serve_streams(r);
        check_watched(r, &w);
        if (getppid() != r->control->monitor)
            end_orphan(r);
        sleep_ns(SERVICE_NS);
    }
    return NULL;
}

static uint32_t stepped_back; /* 1 once the background has its low priority */

/* User code that ends its thread (pthread_exit) would end the background in silence. */
static void thread_ended(void *unused) {
    (void)unused;
    abort();
}

static void *background(void *argument) {
    runner *r = argument;
    static unsigned char own_stack[65536];
    const stack_t stack = {.ss_sp = own_stack, .ss_size = sizeof own_stack};
    sigaltstack(&stack, NULL);
    this_stack_begins = (uint64_t)(uintptr_t)__builtin_frame_address(0);
    this_thread_is = WITHIN_BACKGROUND;
    /* of this thread alone, and beneath what the target as a whole was given (nice) */
    setpriority(PRIO_PROCESS, 0, getpriority(PRIO_PROCESS, 0) + 10);
    store32(&stepped_back, 1);
    while (load32(&r->control->phase) < PHASE_READY)
        sleep_ns(1000000);
    if (!r->config.background)
        return NULL;
    pthread_cleanup_push(thread_ended, NULL);
    for (;;) {
        if (load32(&r->control->running) == RUN_ISR)
            r->config.background();
        sleep_ns(1000000);
    }
    pthread_cleanup_pop(0);
    return NULL;
}

/* Start the threads, before user code is there and before no priority can be changed any more; 0,
 * or an errno. */
int service_start(runner *r) {
    pthread_t thread;
    int failed = pthread_create(&thread, NULL, service, r);
    if (!failed)
        failed = pthread_create(&thread, NULL, background, r);
    while (!failed && !load32(&stepped_back))
        sleep_ns(20000);
    return failed;
}
