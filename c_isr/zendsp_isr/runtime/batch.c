/* batch.c: synchronous updates: taken from the monitor's ring, applied whole at the start of one
 * sample; or faded in over several, where a step of the numbers would be one of the torque. */
#include <string.h> /* memcpy */

#include "runner.h"

/* Batches taken from the ring in one sample; the rest waits for the next, so a flood cannot stretch
 * a sample. */
enum { TAKEN_AT_ONCE = 16 };

/* Move committed batches from the ring into the list that is sorted by at_tick (first come first
 * where equal). */
void batch_collect(runner *r) {
    control *c = r->control;
    const uint64_t head = load64(&c->ring_head);
    uint64_t tail = c->ring_tail;
    for (int taken = 0;
         tail != head && taken < TAKEN_AT_ONCE && r->buffers.waiting_used < LAYOUT_BATCHES;
         taken++, tail++) {
        const uint32_t index = c->ring[tail % LAYOUT_BATCHES] % LAYOUT_BATCHES;
        batch *b = (batch *)(void *)(r->data + c->batch_offset + index * c->batch_stride);
        int place = r->buffers.waiting_used++;
        for (; place > 0 && r->buffers.waiting[place - 1]->at_tick > b->at_tick; place--)
            r->buffers.waiting[place] = r->buffers.waiting[place - 1];
        r->buffers.waiting[place] = b;
    }
    store64(&c->ring_tail, tail);
}

/* What is done with an entry of a batch. */
typedef void visit(runner *r, batch *b, batch_entry *e, const void *with);

/* Visit the entries of a batch, as far as they and `more` bytes after each fit into it; returns
 * whether all do. */
static bool each(runner *r, batch *b, uint64_t more, visit *what, const void *with) {
    const uint64_t room = r->control->batch_stride;
    uint64_t at = sizeof *b;
    for (uint32_t i = 0; i < b->entries; i++) {
        batch_entry *e = (batch_entry *)(void *)((unsigned char *)b + at);
        if (at + sizeof *e > room || e->size < 0 || more > room ||
            at + sizeof *e + (uint64_t)e->size + more > room)
            return false;
        what(r, b, e, with);
        at += sizeof *e + (uint64_t)((e->size + 7) & ~7);
    }
    return true;
}

/* Where the numbers of an entry stand in the program; NULL of a table, or beyond its variable. */
static unsigned char *place_of(const runner *r, const batch_entry *e) {
    const control *c = r->control;
    if (e->variable < 0 || e->variable >= c->variables)
        return NULL;
    const variable_entry *v = &c->variable[e->variable];
    const bool within = v->kind != KIND_TABLE && e->offset >= 0 && e->offset + e->size <= v->size;
    return within ? (unsigned char *)(uintptr_t)v->pointer + e->offset : NULL;
}

/* Give a table its new bank and length. */
static void switch_table(runner *r, variable_entry *v, int32_t *value) {
    table *t = (table *)(uintptr_t)v->pointer;
    const int32_t bank = value[0] & 1, rows = value[1];
    const uint64_t old = v->table;
    t->data = (const double *)(r->data + v->bank[bank]);
    t->rows = rows < 0 ? 0 : rows > v->length ? v->length : rows;
    t->version++;
    store64(&v->table, (uint64_t)(uint32_t)bank << 32 | (uint32_t)t->rows);
    value[0] = (int32_t)(old >> 32);
    value[1] = (int32_t)(uint32_t)old;
}

/* Exchange `size` bytes in pieces; the old value stays in the batch, for the log. */
static void exchange(unsigned char *mine, unsigned char *theirs, int32_t size) {
    unsigned char piece[64];
    for (int32_t at = 0; at < size; at += (int32_t)sizeof piece) {
        const size_t n =
            (size_t)(size - at < (int32_t)sizeof piece ? size - at : (int32_t)sizeof piece);
        memcpy(piece, mine + at, n);
        memcpy(mine + at, theirs + at, n);
        memcpy(theirs + at, piece, n);
    }
}

/* Give what an entry names its new value. */
static void take(runner *r, batch *b, batch_entry *e, const void *with) {
    unsigned char *value = (unsigned char *)(e + 1), *mine = place_of(r, e);
    const bool known = e->variable >= 0 && e->variable < r->control->variables;
    (void)with;
    if (e->left) { /* for the log */
        memcpy(value, value + b->old, (size_t)e->size);
        return;
    }
    if (mine && b->fade > 0)
        memcpy(mine, value + b->old, (size_t)e->size);
    if (mine)
        exchange(mine, value, e->size);
    else if (known && r->control->variable[e->variable].kind == KIND_TABLE && e->size == 8)
        switch_table(r, &r->control->variable[e->variable], (int32_t *)(void *)value);
}

/* What a later update has is faded no more. */
static void leave(runner *r, batch *b, batch_entry *e, const void *with) {
    const batch_entry *later = with;
    (void)r, (void)b;
    if (e->variable == later->variable && e->offset < later->offset + later->size &&
        later->offset < e->offset + e->size)
        e->left = 1;
}

static void outdo(runner *r, batch *b, batch_entry *e, const void *with) {
    (void)b, (void)with;
    for (int i = 0; i < r->buffers.fading_used; i++)
        each(r, r->buffers.fading[i], 0, leave, e);
}

static void apply(runner *r, batch *b, uint64_t tick) {
    each(r, b, b->fade > 0 ? b->old : 0, take, NULL);
    b->applied = tick;
    b->shown = r->control->newest + 1;
    r->state.unseen = true;
    store32(&b->state, BATCH_APPLIED);
}

/* What is there when a fade begins. */
static void remember(runner *r, batch *b, batch_entry *e, const void *with) {
    const unsigned char *mine = place_of(r, e);
    (void)with;
    e->left = 0;
    if (mine)
        memcpy((unsigned char *)(e + 1) + b->old, mine, (size_t)e->size);
}

/* A share of the way, which begins slowly: a machine that lags behind weak gains comes along before
 * they are strong; and ends without a step of its speed, which may be one of a reference. Whole
 * numbers, flags and tables switch at the end. */
static void lead(runner *r, batch *b, batch_entry *e, const void *with) {
    const double part = *(const double *)with, share = part * part * part * (4.0 - 3.0 * part);
    unsigned char *mine = place_of(r, e);
    if (!mine || e->left)
        return;
    const unsigned char *value = (unsigned char *)(e + 1), *old = value + b->old;
    const int32_t type = r->control->variable[e->variable].type;
    const int32_t step = type == TYPE_DOUBLE ? (int32_t)sizeof(double) : (int32_t)sizeof(float);
    for (int32_t k = 0; k + step <= e->size; k += step) {
        if (type == TYPE_DOUBLE) {
            double from, to;
            memcpy(&from, old + k, sizeof from);
            memcpy(&to, value + k, sizeof to);
            to = from + share * (to - from);
            memcpy(mine + k, &to, sizeof to);
        } else if (type == TYPE_FLOAT) {
            float from, to;
            memcpy(&from, old + k, sizeof from);
            memcpy(&to, value + k, sizeof to);
            to = (float)(from + share * ((double)to - from));
            memcpy(mine + k, &to, sizeof to);
        }
    }
}

/* Lead what is being faded on by a sample; what has come to its end is applied. Until then
 * `applied` is the sample of its beginning. */
static void go_on(runner *r, uint64_t tick) {
    runner_buffers *f = &r->buffers;
    const int used = f->fading_used;
    f->fading_used = 0;
    for (int i = 0; i < used; i++) {
        batch *b = f->fading[i];
        const double part = (double)(tick - b->applied) / (double)b->fade;
        if (part < 1.0 && each(r, b, b->old, lead, &part))
            f->fading[f->fading_used++] = b;
        else
            apply(r, b, tick);
    }
}

static void begin(runner *r, batch *b, uint64_t tick) {
    if (r->buffers.fading_used > 0)
        each(r, b, 0, outdo, NULL);
    if (b->fade > 0 && each(r, b, b->old, remember, NULL)) {
        b->applied = tick;
        r->buffers.fading[r->buffers.fading_used++] = b;
        return;
    }
    b->fade = 0;
    apply(r, b, tick);
}

/* Give back what shall wait for its sample no more; what is due now is no longer in time. */
static void cancel(runner *r, uint64_t tick) {
    control *c = r->control;
    const uint32_t cancels = load32(&c->cancels);
    if (cancels == r->state.cancels_seen)
        return;
    for (int round = 0; round < LAYOUT_BATCHES / TAKEN_AT_ONCE; round++)
        batch_collect(r);
    int left = 0;
    for (int i = 0; i < r->buffers.waiting_used; i++) {
        batch *b = r->buffers.waiting[i];
        if (b->at_tick <= tick || !load32(&b->cancel)) {
            r->buffers.waiting[left++] = b;
            continue;
        }
        b->applied = tick;
        b->shown = 0;
        store32(&b->state, BATCH_CANCELLED);
    }
    r->buffers.waiting_used = left;
    r->state.cancels_seen = cancels;
}

/* Apply what is due at this sample, in order. */
void batch_apply(runner *r, uint64_t tick) {
    cancel(r, tick);
    batch_collect(r);
    if (r->buffers.fading_used > 0)
        go_on(r, tick);
    int done = 0;
    while (done < r->buffers.waiting_used && r->buffers.waiting[done]->at_tick <= tick)
        begin(r, r->buffers.waiting[done++], tick);
    if (done > 0) {
        r->buffers.waiting_used -= done;
        for (int i = 0; i < r->buffers.waiting_used; i++)
            r->buffers.waiting[i] = r->buffers.waiting[i + done];
    }
}
