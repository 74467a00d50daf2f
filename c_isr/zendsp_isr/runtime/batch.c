/* batch.c: synchronous updates: taken from the monitor's ring, applied whole at the start of one
 * sample. */
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
        const batch *b = (const batch *)(r->data + c->batch_offset + index * c->batch_stride);
        int place = r->buffers.waiting_used++;
        for (; place > 0 && r->buffers.waiting[place - 1]->at_tick > b->at_tick; place--)
            r->buffers.waiting[place] = r->buffers.waiting[place - 1];
        r->buffers.waiting[place] = b;
    }
    store64(&c->ring_tail, tail);
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

static void apply(runner *r, batch *b, uint64_t tick) {
    control *c = r->control;
    unsigned char *at = (unsigned char *)(b + 1);
    const unsigned char *end = (unsigned char *)b + c->batch_stride;
    for (uint32_t i = 0; i < b->entries && at + sizeof(batch_entry) <= end; i++) {
        const batch_entry *entry = (const batch_entry *)(void *)at;
        const int32_t size = entry->size, offset = entry->offset;
        unsigned char *value = at + sizeof *entry;
        if (size < 0 || value + size > end)
            break;
        if (entry->variable >= 0 && entry->variable < c->variables) {
            variable_entry *v = &c->variable[entry->variable];
            if (v->kind == KIND_TABLE && size == 8)
                switch_table(r, v, (int32_t *)(void *)value);
            else if (offset >= 0 && offset + size <= v->size)
                exchange((unsigned char *)(uintptr_t)v->pointer + offset, value, size);
        }
        at = value + ((size + 7) & ~7);
    }
    b->applied = tick;
    b->shown = c->newest + 1;
    r->state.unseen = true;
    store32(&b->state, BATCH_APPLIED);
}

/* Apply what is due at this sample, in order. */
void batch_apply(runner *r, uint64_t tick) {
    batch_collect(r);
    int done = 0;
    while (done < r->buffers.waiting_used && r->buffers.waiting[done]->at_tick <= tick)
        apply(r, (batch *)(uintptr_t)r->buffers.waiting[done++], tick);
    if (done > 0) {
        r->buffers.waiting_used -= done;
        for (int i = 0; i < r->buffers.waiting_used; i++)
            r->buffers.waiting[i] = r->buffers.waiting[i + done];
    }
}
