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
uint32_t monitor_fit(const update_part *part, uint32_t parts, const double *values,
                     uint32_t *wrong);
uint64_t monitor_pack(const update_part *part, uint32_t parts, const double *values,
                      unsigned char *to);
int monitor_write(control *c, int pidfd, const update_part *part, uint32_t parts,
                  const double *values, batch *b, uint32_t index, uint64_t sequence,
                  uint64_t at_tick, uint64_t fade);
int monitor_read_again(const uint32_t *ended, const control *c, const unsigned char *data,
                       uint64_t slots_at, uint64_t stride, uint64_t from, uint64_t bytes,
                       unsigned char *values, uint32_t count, const uint32_t *places,
                       unsigned char *reply, uint32_t tick_at);
int monitor_write_again(const uint32_t *ended, control *c, int pidfd, const update_part *part,
                        uint32_t value_at, unsigned char *reply, uint32_t sequence_at,
                        const unsigned char *request, batch *b, uint32_t index, uint64_t sequence);
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
