/* runner.h: the private state of the runner process, and what its files offer each other.
 *
 * Threads: the loop (main thread, real-time where permitted), service (maps streams, watches the
 * monitor) and background (UserBackground). loop.c, batch.c, stream.c and safety.c run inside the
 * sample: no malloc, lock, print or unbounded loop there.
 */
#ifndef ZENDSP_RUNNER_H
#define ZENDSP_RUNNER_H

#include <stdbool.h>
#include <stdint.h>

#include "isr.h"
#include "layout.h"
#include "machine.h"

enum { SPEED_WINDOW = 256, RANGES = LAYOUT_VARIABLES };
/* counts that a way may seem longer by than it is: one of rounding, three of an interpolated sensor
 * with half a count rms of noise (0.7 in a difference) */
#define SPEED_COUNTS 4.0
/* mV per N m of a joint that takes none: no command in mV is as large as a torque becomes by it. */
#define NO_TORQUE_MV 1e30
enum { ORPHAN_S = 12 }; /* that a machine may take to be made safe; longer than the monitor waits */

/* What every program can read and record without declaring it; doubles, so that channels treat all
 * alike. */
typedef struct builtins {
    double tick, t;
    double exec_us;              /* from the start of this sample to its command */
    double late_us;              /* start of this sample behind its deadline */
    double drive;                /* MACHINE_OFF | MACHINE_TORQUE | MACHINE_VELOCITY */
    double enc[MACHINE_JOINTS];  /* counts */
    double aout[MACHINE_JOINTS]; /* mV, the command that acts from this sample on */
    double cmd[MACHINE_JOINTS];  /* mV, computed in this sample: acts from the next */
    double adc[MACHINE_ADCS];
    double din, dout;
} builtins;

/* What the host may set through the same synchronous updates as parameters. */
typedef struct settings {
    double position_min[MACHINE_JOINTS], position_max[MACHINE_JOINTS]; /* rad */
    double speed_max[MACHINE_JOINTS];                                  /* rad/s */
    double torque_max[MACHINE_JOINTS];                                 /* N m */
    double command_max[MACHINE_JOINTS];                                /* mV */
    int32_t torque_clamp;   /* 1: clamp the command instead of tripping */
    double ramp;            /* s, soft start and soft stop */
    int32_t overrun_policy; /* OVERRUN_… */
    int32_t overrun_limit;  /* overruns in a row that trip */
    int32_t stop_input;     /* digital input, -1: none */
    int32_t stop_level;
} settings;

/* One contiguous piece of user memory that goes into the snapshot. */
typedef struct range {
    const unsigned char *from;
    uint32_t to, size; /* offset in the snapshot, bytes */
} range;

/* A mapped stream and the loop's place in it. */
typedef struct stream {
    stream_head *head;
    double *rows;
    uint64_t bytes;
    const void *pointer[LAYOUT_CHANNELS];
    int32_t type[LAYOUT_CHANNELS];
    const void *trigger;
    int32_t trigger_type;
    uint32_t countdown;
    uint32_t arm_seen, disarm_seen, force_seen;
    uint64_t place;  /* row index within the buffer, count mod capacity */
    uint64_t finish; /* row count at which a shot is complete */
    double before;   /* trigger source one sample earlier */
} stream;

/* Configuration: settled once, while machine and program are loaded; the loop only reads it. */
typedef struct runner_config {
    const machine_ops *machine;
    void *handle; /* of the machine, from its open() */
    void (*isr)(void);
    void (*background)(void);
    uint64_t image, image_end; /* where the program is loaded */
    range ranges[RANGES];      /* what a snapshot holds */
    int ranges_used;
    uint32_t speed_window; /* samples over which a large speed is measured */
} runner_config;

/* State: what one sample leaves to the next. The loop's alone. */
typedef struct runner_state {
    machine_actuators held;         /* computed in the sample before, acts from this one */
    double lowest[MACHINE_JOINTS];  /* rad, limits in force: wider while a joint is brought back */
    double highest[MACHINE_JOINTS]; /* rad */
    double least_seen[MACHINE_JOINTS], most_seen[MACHINE_JOINTS]; /* rad, the limits they are of */
    uint32_t speed_place;           /* row of counts_before that is written next */
    uint32_t speed_known;           /* rows of it that hold */
    uint32_t overruns_in_row;
    uint64_t lag_ns; /* by which the sample before ended too late */
    bool anew;       /* the program begins afresh at its next sample: FIRST_SAMPLE, and a run-in */
    uint32_t run_in; /* samples left of the run-in, in which outputs are not taken */
    uint32_t off_seen, cancels_seen;
    bool asked;    /* STOP came by the stop page, and is not answered there yet */
    uint64_t busy_ns;               /* a sample, machine included; smoothed over eight samples */
    bool acquired;                  /* Acquire() was called in this sample */
    bool unseen;   /* something was taken that the newest snapshot does not show */
    uint32_t din;  /* digital inputs, as the machine itself has them */
    stream *active[LAYOUT_STREAMS]; /* what rows are written into */
} runner_state;

/* Buffers: what values pass through, within a sample or from another thread. */
typedef struct runner_buffers {
    zendsp_io io; /* what the program sees */
    machine_sensors sensors;
    machine_actuators acting; /* what acts in this sample */
    builtins now;
    int32_t counts_before[SPEED_WINDOW][MACHINE_JOINTS]; /* a ring */
    batch *waiting[LAYOUT_BATCHES];                      /* sorted by at_tick */
    batch *fading[LAYOUT_BATCHES];                       /* begun, first come first */
    int waiting_used, fading_used;
    stream *streams[LAYOUT_STREAMS];  /* by the service thread: what to work with next (atomic) */
    uint32_t offered[LAYOUT_STREAMS]; /* generation of streams[i] */
} runner_buffers;

typedef struct runner {
    control *control;    /* shared with the monitor */
    stop_page *page;     /* shared with hosts of the same user */
    unsigned char *data; /* shared: snapshots, batches, tables */
    runner_config config;
    settings set; /* by synchronous updates, between two samples */
    runner_state state;
    runner_buffers buffers;
} runner;

/* The only one: UserInit's declarations and signal handlers are given no context. */
extern runner the_runner;
extern _Thread_local int32_t
    this_thread_is; /* WITHIN_BACKGROUND in the background thread, else 0 */
extern _Thread_local uint64_t this_stack_begins; /* address in the first frame of the thread */

/* dictionary.c */
void dictionary_declare(
    const zendsp_declaration *declaration); /* called by user code in UserInit */
void dictionary_builtins(runner *r);
int dictionary_finish(
    runner *r); /* lays out and maps the data file; 0, or -1 with control->error set */

/* promises.c: 0, or what a machine says of itself and cannot be meant, in `why` */
int promises_check(const machine_info *info, char *why, size_t size);

/* realtime.c */
void realtime_enter(runner *r); /* waits for what the monitor gives the loop */
bool realtime_granted(void);
void realtime_stay_awake(bool wanted); /* between runs only: opens or closes a file */

/* service.c */
int service_start(runner *r);

/* contain.c */
void *contain_map(int file, size_t bytes);
void contain_unmap(void *at, size_t bytes);
void contain_enter(control *c);
void contain_thread(void);
void contain_say(control *c);
void contain_hear_of_end(const control *c, int signal);
void contain_end_within(int seconds);
void contain_end_group(void);
int contain_hold(int process);
void contain_end_runner(int handle, int seconds);
void contain_end_children(void);

/* loop.c */
void loop(runner *r);

/* batch.c */
void batch_collect(runner *r);
void batch_apply(runner *r, uint64_t tick);

/* stream.c */
void stream_exchange(runner *r);
void stream_sample(runner *r);
void stream_idle(runner *r);
void stream_skip(runner *r, uint64_t samples);

/* safety.c */
void safety_reset(runner *r);
void safety_anew(runner *r);
void safety_requests(runner *r, bool paused);
void safety_output(runner *r);
void safety_acted(runner *r);
void safety_panel(runner *r);
bool safety_inputs(runner *r);
void safety_command(runner *r);
void safety_home(runner *r, int answer);
void safety_trip(runner *r, uint32_t reason, int joint, double value, double limit);

static inline uint32_t load32(const uint32_t *word) {
    return __atomic_load_n(word, __ATOMIC_ACQUIRE);
}
static inline uint64_t load64(const uint64_t *word) {
    return __atomic_load_n(word, __ATOMIC_ACQUIRE);
}
static inline void store32(uint32_t *word, uint32_t value) {
    __atomic_store_n(word, value, __ATOMIC_RELEASE);
}
static inline void store64(uint64_t *word, uint64_t value) {
    __atomic_store_n(word, value, __ATOMIC_RELEASE);
}

#endif
