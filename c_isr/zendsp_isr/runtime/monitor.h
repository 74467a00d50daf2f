/* monitor.h: what the monitor calls in monitor.c; Python reads it through cffi. */
#ifndef ZENDSP_MONITOR_H
#define ZENDSP_MONITOR_H

#include <stdint.h> /* uint32_t, uint64_t */

#include "layout.h"

/* One part of an update: where its numbers go, and what they keep to. */
typedef struct update_part {
    batch_entry entry;
    int32_t type; /* TYPE_… */
    uint32_t count; /* numbers */
    double least, greatest;
} update_part;

/* An update of always the same variables: what does not change between one and the next. */
typedef struct update_plan {
    control *to;
    const update_part *part;
    uint32_t parts;
    int32_t pidfd; /* of the runner; -1 where the kernel has none */
} update_plan;

/* A write of doubles that came before: of the next one, all but these is as it was. */
typedef struct repeated_write {
    const uint32_t *ended; /* not 0: the program is not loaded any more */
    const update_plan *plan;
    const unsigned char *request; /* the first one */
    uint32_t length;              /* of it, bytes */
    const uint32_t *places;       /* of the doubles in it, one a part, rising; bytes */
    double *values;               /* room for them */
    unsigned char *reply;         /* in which only numbers are missing */
    uint32_t sequence_at;         /* of the write's number in the reply, bytes */
} repeated_write;

/* A reading of doubles that came before, and its reply, in which only numbers are missing. */
typedef struct repeated_read {
    const uint32_t *ended; /* as above */
    const control *of;
    const unsigned char *data;
    uint64_t slots_at, stride; /* of the snapshots in the data; from one to the next; bytes */
    uint64_t from, bytes;      /* what is copied of each */
    unsigned char *values;     /* where it is copied to */
    const uint32_t *places;    /* two for each double: in `values` and in the reply, bytes */
    uint32_t count;            /* doubles */
    uint32_t tick_at;          /* in the reply, bytes */
    unsigned char *reply;
} repeated_read;

/* Why a number is no value of a part: NaN or infinite; outside its limits; not whole (of
 * TYPE_INT32); neither 0 nor 1 (of TYPE_BOOL); beyond the range of TYPE_FLOAT. */
enum {
    FIT = 0,
    FIT_NOT_FINITE = 1,
    FIT_OUTSIDE = 2,
    FIT_NOT_WHOLE = 3,
    FIT_NO_FLAG = 4,
    FIT_TOO_LARGE = 5
};

int monitor_snapshot(const uint64_t *newest_word, const unsigned char *slots, uint64_t stride,
                     uint64_t from, uint64_t bytes, unsigned char *values, uint64_t *tick);
int monitor_ended(int pidfd);
void monitor_outlive_lost_pages(void);
uint32_t monitor_fit(const update_part *part, uint32_t parts, const double *values,
                     uint32_t *wrong);
uint64_t monitor_pack(const update_part *part, uint32_t parts, const double *values,
                      unsigned char *to);
int monitor_write(const update_plan *plan, const double *values, batch *b, uint32_t index,
                  uint64_t sequence, uint64_t at_tick, uint64_t fade);
int monitor_read_again(const repeated_read *r);
int monitor_write_again(const repeated_write *w, const unsigned char *request, batch *b,
                        uint32_t index, uint64_t sequence);
uint32_t monitor_load32(const uint32_t *word);
uint64_t monitor_load64(const uint64_t *word);
void monitor_store32(uint32_t *word, uint32_t value);
void monitor_store64(uint64_t *word, uint64_t value);
void monitor_run(control *c, uint32_t run);
uint64_t monitor_round(const control *c);
int monitor_shown(const control *c, const batch *b);
int monitor_wait_shown(const control *c, const batch *b, uint64_t timeout_ns, uint64_t awake_ns);
uint64_t monitor_rows(const uint64_t *count_word, const double *rows, uint64_t capacity,
                      uint64_t channels, uint64_t first, uint64_t count, double *to,
                      uint64_t *fold);

#endif
