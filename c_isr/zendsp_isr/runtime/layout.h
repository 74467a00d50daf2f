/* layout.h: the shared memory between the monitor (Python) and the runner (native), in one place.
 *
 * Four kinds of file in /dev/shm:
 *   stop     one per target: STOP by any program of the target's own user, with nothing between
 *            it and the loop
 *   control  one per load, of fixed size: settings, requests, answers, dictionary, timing
 *   data     one per load, sized by the runner after UserInit: snapshots, batches, table banks
 *   stream   one per configured acquisition, sized by the monitor: its head and its rows;
 *            outlives the runner
 *
 * Each word has one writer, named beside it. Words that order others are accessed with acquire and
 * release (the __atomic builtins in C; through runtime/monitor.c from Python). This file is also
 * read by Python (cffi): plain declarations only.
 */
#ifndef ZENDSP_LAYOUT_H
#define ZENDSP_LAYOUT_H

#include <stddef.h> /* offsetof, for the asserts */
#include <stdint.h> /* fixed-width integers */

#include "machine.h"

enum {
    LAYOUT_VERSION = 10,
    LAYOUT_MAGIC = 0x5a445350, /* "ZDSP" */
    STOP_PAGE_VERSION = 3, /* of its own: a host of another zendsp can still stop the loop */
    LAYOUT_VARIABLES = 1024,   /* entries of the dictionary, built-ins and settings included */
    LAYOUT_ELEMENTS = 4096,    /* longest array that is not a table */
    LAYOUT_CHANNELS = 1024,    /* of one stream */
    LAYOUT_STREAMS = 8,
    LAYOUT_GAPS = 256, /* of a stream: the newest that are known */
    LAYOUT_BATCHES = 128,  /* synchronous updates in flight */
    LAYOUT_SNAPSHOTS = 32, /* newest samples kept for readers */
    LAYOUT_BINS = 128,     /* histogram bins: four an octave, from 1 ns */
    LAYOUT_NAME = 64,
    LAYOUT_WHO = 96, /* of who asked for a STOP, and when */
    LAYOUT_TEXT = 192,
    LAYOUT_PATH = 512,
    LAYOUT_CONFIG = 8192
};

enum { CLOCK_REAL = 0, CLOCK_FAST = 1 };
enum { TYPE_DOUBLE = 1, TYPE_FLOAT = 2, TYPE_INT32 = 3, TYPE_BOOL = 4 }; /* as in isr.h */
/* 1 … 3 as in isr.h */
enum { KIND_PARAMETER = 1, KIND_SIGNAL = 2, KIND_TABLE = 3, KIND_BUILTIN = 4, KIND_SETTING = 5 };
enum { OVERRUN_COUNT = 0, OVERRUN_SKIP = 1, OVERRUN_TRIP = 2 };
enum {
    PHASE_STARTING = 0,
    PHASE_INIT = 1,
    PHASE_LOADED = 2, /* the loop waits for `scheduled` */
    PHASE_READY = 3,
    PHASE_ENDED = 4,
    PHASE_FAILED = 5
};
enum { RUN_PAUSED = 0, RUN_ISR = 1, RUN_HOME = 2, RUN_QUIT = 3 };
enum {
    WITHIN_RUNTIME = 0,
    WITHIN_LOADING = 1,
    WITHIN_INIT = 2,
    WITHIN_ISR = 3,
    WITHIN_BACKGROUND = 4,
    WITHIN_MACHINE = 5
};
enum { BATCH_FREE = 0, BATCH_COMMITTED = 1, BATCH_APPLIED = 2, BATCH_CANCELLED = 3 };
enum { STREAM_IDLE = 0, STREAM_ARMED = 1, STREAM_RUNNING = 2, STREAM_DONE = 3 };
enum { EDGE_NONE = 0, EDGE_RISING = 1, EDGE_FALLING = 2, EDGE_BOTH = 3 };

enum {
    TRIP_NONE = 0,
    TRIP_STOP = 1,       /* requested by a person */
    TRIP_STOP_INPUT = 2, /* the digital input */
    TRIP_HOST_LOST = 3,  /* requested by the monitor */
    TRIP_TORQUE = 4,     /* N m */
    TRIP_SPEED = 5,      /* rad/s */
    TRIP_POSITION = 6,   /* rad */
    TRIP_COMMAND = 7,    /* mV */
    TRIP_NAN = 8,
    TRIP_OVERRUN = 9, /* samples in a row */
    TRIP_SENSOR = 10,
    TRIP_HOMING = 11,
    TRIP_UNWATCHED = 12, /* s that the monitor stood still: it may have missed a host's loss */
    TRIP_STALL = 13,     /* s that the loop stood still on hardware */
    TRIP_OUTSIDE = 14    /* the code names a channel or joint that is not there: its index */
};

/* STOP past the monitor and the link: docs/protocol.md describes it for other languages. Made by
 * the monitor. */
typedef struct stop_page {
    uint32_t magic, version;
    uint32_t stop;   /* by any host: 1 asks for STOP; the loop clears it */
    uint32_t trips;  /* by the loop: trips latched, and STOPs asked while one was */
    uint64_t sample; /* by the loop, before it counts `taken`: that of the trip latched then */
    uint64_t taken;  /* by the loop: STOPs from here whose safe outputs the machine has */
    /* by whoever asks, before `stop`: who, and when; UTF-8, ended by 0. They clear `reason` */
    char by[LAYOUT_WHO - 8];
    uint32_t reason; /* by the loop, before it counts `taken`: TRIP_… of the trip latched then */
    uint32_t unused;
} stop_page;

/* One entry of the dictionary. Written by the runner before PHASE_READY, then constant; `table`
 * excepted. */
typedef struct variable_entry {
    char name[LAYOUT_NAME];
    char unit[LAYOUT_NAME];
    char text[LAYOUT_TEXT];
    double minimum, maximum;
    uint64_t pointer; /* address in the runner */
    uint64_t address; /* offset within the program's image, bytes */
    int32_t type, kind;
    /* elements, and how many in a row of a matrix; a table has `length` rows of `columns` */
    int32_t length, columns;
    int32_t size;            /* bytes of the value; 0 for a table */
    int32_t snapshot;        /* offset within a snapshot's values, bytes; -1 for a table */
    uint64_t bank[2];        /* table: offset of each bank in the data file, bytes */
    uint64_t table;          /* table, by the loop: bank in the upper 32 bits, rows in the lower */
} variable_entry;

/* One consistent sample of all small variables; `values` follow in the data file. Written by the
 * loop. */
typedef struct snapshot {
    uint64_t sequence; /* of the seqlock: 2 n + 1 while sample n is being written, 2 n + 2 after */
    uint64_t tick;
} snapshot;

/* One synchronous update; entries follow in the data file. */
typedef struct batch {
    uint32_t state;   /* COMMITTED by the monitor, APPLIED or CANCELLED by the loop, then FREE */
    uint32_t entries;
    uint32_t cancel; /* by the monitor, before it counts `cancels`: 1, not if it still waits */
    uint32_t unused;
    uint64_t sequence; /* by the monitor */
    uint64_t at_tick;  /* by the monitor: not before this sample */
    uint64_t applied;  /* by the loop: the sample at whose start it took effect */
    uint64_t shown;    /* by the loop: `newest`, once a snapshot has the new values */
    uint64_t fade;     /* by the monitor: samples over which numbers go to their new values */
    uint64_t old;      /* by the monitor: bytes from a value to room for what was before a fade */
} batch;

/* One value of an update; padded to 8 bytes. When applied, the loop leaves the old value in its
 * place. */
typedef struct batch_entry {
    int32_t variable;
    int32_t offset; /* bytes into the variable */
    int32_t size;   /* bytes that follow; a table: 8, bank and rows as two int32 */
    int32_t left;   /* by the loop: 1, a later update has it, this fade no more */
} batch_entry;

/* One channel of a stream. */
typedef struct channel {
    int32_t variable;
    int32_t element;
} channel;

/* Where rows of a stream are missing. */
typedef struct stream_gap {
    uint64_t row;    /* the first after it */
    uint64_t missed; /* rows up to there, all gaps together */
} stream_gap;

/* Head of a stream file; rows of double follow at `rows`. */
typedef struct stream_head {
    uint32_t magic, version;
    uint64_t bytes; /* whole file */
    uint64_t rows;  /* offset of row 0, bytes */
    /* by the monitor, before the runner maps it */
    uint32_t channels;
    uint32_t decimation;
    uint64_t capacity; /* rows held; row r stands at r mod capacity */
    uint64_t wanted;   /* rows of a shot; 0: ring */
    uint64_t pre;      /* rows wanted before the trigger */
    double level;
    int32_t edge; /* EDGE_NONE: starts at once */
    int32_t reserved;
    channel trigger;
    /* by the monitor, at any time: each increment is one request */
    uint32_t arm, disarm, force, pad;
    /* by the loop */
    uint32_t state;
    uint32_t answered; /* the value of `arm` that this state answers */
    uint64_t count;      /* rows written */
    uint64_t first_tick; /* tick of row 0 */
    int64_t fired;       /* row of the trigger, -1: not yet */
    uint64_t missed;     /* rows that fell on samples which never ran */
    uint64_t gaps;       /* so far; gap n stands at n mod LAYOUT_GAPS */
    stream_gap gap[LAYOUT_GAPS];
    channel channel[LAYOUT_CHANNELS];
} stream_head;

/* Where the runner finds a stream. */
typedef struct stream_slot {
    uint32_t requested; /* by the monitor: generation; odd: map `path`, even: none */
    uint32_t mapped;    /* by the loop: generation that it works with */
    int32_t failed;     /* by the runner: errno of a mapping that failed */
    int32_t reserved;
    char path[LAYOUT_PATH];
} stream_slot;

/* Counted by the loop, ns. */
typedef struct timing_counts {
    uint64_t samples, overruns, missed;
    uint64_t exec_sum, exec_max, late_sum, late_max;
    uint64_t exec_bins[LAYOUT_BINS], late_bins[LAYOUT_BINS];
} timing_counts;

/* The latched trip, by the loop; valid while reason is not TRIP_NONE. */
typedef struct trip_latch {
    uint32_t reason;
    int32_t joint; /* from 1; 0: none */
    uint64_t tick;
    uint64_t shown; /* `newest`, once a snapshot is of that sample */
    double value, limit;
    uint32_t acted; /* 1 once the machine was given the safe outputs: not to be told before */
    uint32_t idle;  /* of a limit of position or speed: 1 where the program commands 0 there */
    char by[LAYOUT_WHO]; /* of a STOP: who asked, and when */
} trip_latch;

typedef struct control {
    uint32_t magic, version;
    uint64_t bytes; /* sizeof(control): both sides must agree */

    /* settings: by the monitor, before the runner starts */
    double rate_hz;
    uint64_t period_ns;
    int32_t clock;
    int32_t realtime; /* 1: ask for SCHED_RR, locked memory and a CPU of its own */
    int32_t priority; /* of SCHED_RR */
    int32_t monitor;  /* process id of the monitor; when no longer the parent, nobody watches */
    int32_t contained; /* by the runner: 1, a filter of system calls holds user code */
    double spin_us;   /* wait awake at last; only under SCHED_RR, at most 0.6 of the period */
    double speed;     /* fast clock: at most so many machine seconds a second; 0: no limit */
    double hang_s;    /* a loop that stands still for longer is ended, or trips when it goes on */
    uint64_t memory;  /* bytes that user code may take beside the machine's, shared memory aside */
    char data_path[LAYOUT_PATH];
    char stop_path[LAYOUT_PATH];
    char program_path[LAYOUT_PATH];
    char machine_path[LAYOUT_PATH];
    char machine_config[LAYOUT_CONFIG];

    /* answers: by the runner */
    uint32_t phase;
    uint32_t within; /* WITHIN_…: whose code the loop is in */
    char error[LAYOUT_PATH];
    char scheduling[LAYOUT_PATH];
    machine_info info;
    int32_t variables;
    int32_t snapshot_bytes; /* of the values of one snapshot */
    uint64_t data_bytes;
    uint64_t initial_offset;  /* in the data file: values as UserInit left them */
    uint64_t snapshot_offset; /* in the data file: first snapshot */
    uint64_t snapshot_stride;
    uint64_t batch_offset;
    uint64_t batch_stride;
    int32_t crash_signal; /* by the signal handler */
    int32_t crash_within;
    uint64_t crash_address; /* of the instruction, offset in the program's image; 0: elsewhere */
    uint32_t crash_stack;   /* 1: it was the end of the thread's stack */
    uint32_t reserved;

    /* requests: by the monitor */
    uint32_t run;        /* RUN_…; the loop itself sets RUN_PAUSED at run_until */
    uint32_t stop;       /* TRIP_… to latch at the next sample; the loop clears it */
    uint32_t acknowledge; /* increments; the loop answers in `acknowledged` */
    uint32_t acknowledge_trip; /* before it: `trips` that were seen; of others none ends */
    int32_t drive;       /* MACHINE_OFF | MACHINE_TORQUE | MACHINE_VELOCITY */
    uint32_t scheduled;  /* in PHASE_LOADED: 1, the loop has SCHED_RR, or 1 + errno */
    uint64_t run_until;  /* pause when `tick` has come so far; 0: no end */
    uint32_t simulated_din; /* OR-ed into the digital inputs of a simulated machine */
    uint32_t off;           /* increments each time the drives are switched off */
    uint32_t watched;       /* increments while the monitor can see that a host is lost */
    uint32_t attended;      /* 1: the machine shall stop if that is not so */
    uint32_t cancels;       /* increments when updates that wait for a sample shall wait no more */
    uint32_t spare;

    /* batches: single producer, single consumer */
    uint64_t ring_head; /* by the monitor */
    uint64_t ring_tail; /* by the loop */
    uint32_t ring[LAYOUT_BATCHES];

    stream_slot stream[LAYOUT_STREAMS];

    /* state: by the loop */
    uint64_t tick;      /* samples done; also the index of the next one */
    uint64_t heartbeat; /* 2 n + 1 within sample n, 2 n + 2 after it; also moves while paused */
    uint32_t running;   /* RUN_… as the loop sees it */
    uint32_t acknowledged;
    int32_t drive_mode; /* what the drives are told */
    int32_t homed;
    uint32_t pressed; /* 1 while the machine's STOP input is active */
    uint32_t homings; /* that came to their end */
    uint32_t faults;  /* of hardware at rest: bit j, the sensor of joint j is not to be trusted */
    uint32_t unused;
    double gain; /* 0 … 1, soft start */
    uint64_t newest; /* snapshots written */
    trip_latch trip;
    timing_counts timing;

    variable_entry variable[LAYOUT_VARIABLES];
} control;

_Static_assert(sizeof(variable_entry) == 400,
               "variable_entry: layout changed, raise LAYOUT_VERSION");
_Static_assert(sizeof(stop_page) == 32 + LAYOUT_WHO, "hosts know it, raise STOP_PAGE_VERSION");
_Static_assert(sizeof(batch) == 64 && sizeof(batch_entry) == 16 && sizeof(snapshot) == 16,
               "layout changed, raise LAYOUT_VERSION");
_Static_assert(offsetof(control, ring_head) % 8 == 0 && offsetof(control, tick) % 8 == 0,
               "64-bit words must be aligned");
_Static_assert(sizeof(stream_head) % 8 == 0, "rows must be aligned");

#endif
