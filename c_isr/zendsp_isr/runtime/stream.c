/* stream.c: acquisition: one row a sample into each running stream, in constant time. */
#include "runner.h"

/* A value of any type as a double. */
static inline double value_of(const void *pointer, int32_t type) {
    switch (type) {
    case TYPE_FLOAT:
        return (double)*(const float *)pointer;
    case TYPE_INT32:
        return (double)*(const int32_t *)pointer;
    case TYPE_BOOL:
        return *(const unsigned char *)pointer ? 1.0 : 0.0;
    default:
        return *(const double *)pointer;
    }
}

/* Take over streams that the service thread has mapped since. */
void stream_exchange(runner *r) {
    for (int i = 0; i < LAYOUT_STREAMS; i++) {
        const uint32_t generation = load32(&r->buffers.offered[i]);
        if (generation == r->control->stream[i].mapped)
            continue;
        r->state.active[i] = __atomic_load_n(&r->buffers.streams[i], __ATOMIC_ACQUIRE);
        store32(&r->control->stream[i].mapped, generation);
    }
}

static void begin(stream *s, uint64_t tick) {
    stream_head *h = s->head;
    h->count = 0;
    h->fired = -1;
    h->missed = 0;
    h->gaps = 0;
    h->first_tick = tick;
    s->place = 0;
    s->countdown = 0;
    s->finish = h->wanted;
    s->force_seen = load32(&h->force); /* what was forced before does not fire this one */
    if (s->trigger)
        s->before = value_of(s->trigger, s->trigger_type);
    store32(&h->state, h->edge == EDGE_NONE ? STREAM_RUNNING : STREAM_ARMED);
}

/* Answer requests that came since the last sample. */
static void requests(stream *s, uint64_t tick) {
    stream_head *h = s->head;
    const uint32_t arm = load32(&h->arm), disarm = load32(&h->disarm);
    if (disarm != s->disarm_seen) {
        s->disarm_seen = disarm;
        if (h->state == STREAM_ARMED || h->state == STREAM_RUNNING)
            store32(&h->state, STREAM_DONE);
    }
    if (arm != s->arm_seen) {
        s->arm_seen = arm;
        begin(s, tick);
        store32(&h->answered, arm);
    }
}

/* Has somebody fired the trigger by hand? */
static bool forced(stream *s) {
    const uint32_t force = load32(&s->head->force), seen = s->force_seen;
    s->force_seen = force;
    return force != seen;
}

/* Has the trigger fired in this sample? */
static bool fires(stream *s) {
    const stream_head *h = s->head;
    bool fired = forced(s);
    if (s->trigger) {
        const double now = value_of(s->trigger, s->trigger_type);
        const bool up = s->before < h->level && now >= h->level;
        const bool down = s->before > h->level && now <= h->level;
        fired = fired || (up && h->edge & EDGE_RISING) || (down && h->edge & EDGE_FALLING);
        s->before = now;
    }
    return fired;
}

/* The row that is stored next is the first at or after the trigger. */
static void fire(stream *s) {
    stream_head *h = s->head;
    const uint64_t pre = h->count < h->pre ? h->count : h->pre;
    h->fired = (int64_t)h->count;
    s->finish = h->count - pre + h->wanted;
    store32(&h->state, STREAM_RUNNING);
}

static void store_row(stream *s) {
    stream_head *h = s->head;
    double *row = s->rows + s->place * h->channels;
    for (uint32_t i = 0; i < h->channels; i++)
        row[i] = value_of(s->pointer[i], s->type[i]);
    if (++s->place == h->capacity)
        s->place = 0;
    store64(&h->count, h->count + 1);
}

static void advance(stream *s, uint64_t tick) {
    stream_head *h = s->head;
    requests(s, tick);
    if (h->state != STREAM_ARMED && h->state != STREAM_RUNNING)
        return;
    if (h->state == STREAM_ARMED && fires(s))
        fire(s);
    if (s->countdown > 0) {
        s->countdown--;
        return;
    }
    s->countdown = h->decimation - 1;
    if (h->count == 0)
        h->first_tick = tick;
    store_row(s);
    if (h->state == STREAM_RUNNING && h->wanted > 0 && h->count >= s->finish)
        store32(&h->state, STREAM_DONE);
}

/* One row into every running stream; once a sample, by Acquire() or after the ISR. */
void stream_sample(runner *r) {
    if (r->state.acquired)
        return;
    r->state.acquired = true;
    for (int i = 0; i < LAYOUT_STREAMS; i++)
        if (r->state.active[i])
            advance(r->state.active[i], r->control->tick);
}

/* While paused: requests are answered, nothing is stored. */
void stream_idle(runner *r) {
    stream_exchange(r);
    for (int i = 0; i < LAYOUT_STREAMS; i++) {
        stream *s = r->state.active[i];
        if (!s)
            continue;
        requests(s, r->control->tick);
        if (s->head->state == STREAM_ARMED && forced(s))
            fire(s);
    }
}

/* From the next row on, time is later by all rows that are missing. */
static void note_gap(stream_head *h) {
    stream_gap *last = &h->gap[(h->gaps - 1) % LAYOUT_GAPS];
    if (h->gaps > 0 && last->row == h->count) {
        store64(&last->missed, h->missed);
        return;
    }
    stream_gap *gap = &h->gap[h->gaps % LAYOUT_GAPS];
    gap->row = h->count;
    gap->missed = h->missed;
    store64(&h->gaps, h->gaps + 1);
}

/* Samples that never ran: say how many rows are not there, and where. */
void stream_skip(runner *r, uint64_t samples) {
    for (int i = 0; i < LAYOUT_STREAMS; i++) {
        stream *s = r->state.active[i];
        if (!s || (s->head->state != STREAM_ARMED && s->head->state != STREAM_RUNNING))
            continue;
        const uint64_t every = s->head->decimation;
        const uint64_t rows = samples > s->countdown ? 1 + (samples - s->countdown - 1) / every : 0;
        s->countdown = (uint32_t)(rows * every + s->countdown - samples);
        if (rows > 0 && s->head->count > 0) { /* row 0 stands where it was taken */
            s->head->missed += rows;
            note_gap(s->head);
        }
    }
}
