/* dictionary.c: the variables that the running code declares, and where each stands in the data
 * file. Runs before the loop. */
#define _GNU_SOURCE
#include <errno.h>    /* errno */
#include <fcntl.h>    /* open */
#include <stdio.h>    /* snprintf */
#include <stdlib.h>   /* qsort */
#include <string.h>   /* strcmp, strerror, memcpy */
#include <unistd.h>   /* ftruncate, close */

#include "declared.h"
#include "runner.h"

static const int32_t size_of_type[] = {0, sizeof(double), sizeof(float), sizeof(int32_t),
                                       sizeof(bool)};

static void refuse(control *c, const char *name, const char *why) {
    if (c->error[0] == 0)
        snprintf(c->error, sizeof c->error, "variable '%.63s': %s", name ? name : "?", why);
}

static void refuse_one_too_many(control *c, const char *name) {
    char why[160];
    int own = 0;
    for (int32_t i = 0; i < c->variables; i++)
        own += c->variable[i].kind == KIND_BUILTIN || c->variable[i].kind == KIND_SETTING;
    snprintf(why, sizeof why,
             "one too many: a program has at most %d variables; declare arrays, each of which is"
             " one variable of up to %d elements",
             LAYOUT_VARIABLES - own, LAYOUT_ELEMENTS);
    refuse(c, name, why);
}

static variable_entry *new_entry(control *c, const char *name) {
    if (!name || !name[0] || strlen(name) >= LAYOUT_NAME) {
        refuse(c, name, "a name has 1 to 63 characters");
        return NULL;
    }
    for (int32_t i = 0; i < c->variables; i++)
        if (strcmp(c->variable[i].name, name) == 0) {
            refuse(c, name,
                   c->variable[i].kind == KIND_BUILTIN
                       ? "the name is taken by a built-in signal; choose another"
                       : "declared twice");
            return NULL;
        }
    if (c->variables >= LAYOUT_VARIABLES) {
        refuse_one_too_many(c, name);
        return NULL;
    }
    variable_entry *v = &c->variable[c->variables++];
    snprintf(v->name, sizeof v->name, "%s", name);
    return v;
}

static void set_every(void *address, int32_t type, int32_t length, double value) {
    for (int32_t i = 0; i < length; i++) {
        if (type == TYPE_DOUBLE)
            ((double *)address)[i] = value;
        else if (type == TYPE_FLOAT)
            ((float *)address)[i] = (float)value;
        else if (type == TYPE_INT32)
            ((int32_t *)address)[i] = (int32_t)value;
        else
            ((bool *)address)[i] = value != 0.0;
    }
}

/* Whether this is of a function that has called us: the loop's thread has its stack above here. */
static bool is_local(const void *address) {
    const uintptr_t here = (uintptr_t)__builtin_frame_address(0), at = (uintptr_t)address;
    return at > here && at - here < (64u << 20);
}

/* What is wrong with a declaration, NULL where nothing is; the text lasts until the next call. */
static const char *objection(const zendsp_declaration *d) {
    if (d->kind != KIND_SIGNAL && is_constant(d->address))
        return "it is const, so nobody could write it: leave const out";
    if (d->kind < KIND_PARAMETER || d->kind > KIND_TABLE || d->type < TYPE_DOUBLE ||
        d->type > TYPE_BOOL || !d->address)
        return "not a declaration of isr.h";
    if (is_local(d->address))
        return "it ends with its function: declare it static, or outside of functions";
    if (d->kind == KIND_TABLE && (d->rows < 1 || d->columns < 1))
        return "a table needs at least one row and one column";
    if (d->kind == KIND_TABLE && (double)d->rows * d->columns > 67108864.0)
        return "a table holds at most 64 million values";
    if (d->kind != KIND_TABLE && d->bytes < size_of_type[d->type])
        return "it has no element";
    if (d->kind != KIND_TABLE && d->bytes / size_of_type[d->type] > LAYOUT_ELEMENTS)
        return "more than 4096 elements: declare it as a TABLE";
    return no_parameter(d, d->kind == KIND_TABLE ? 0 : d->bytes / size_of_type[d->type]);
}

/* What PARAMETER, SIGNAL and TABLE do. */
void dictionary_declare(const zendsp_declaration *d) {
    control *c = the_runner.control;
    if (c->phase != PHASE_INIT)
        return; /* variables are declared in UserInit only; elsewhere there is nothing to do */
    const char *why = objection(d);
    if (why) {
        refuse(c, d->name, why);
        return;
    }
    variable_entry *v = new_entry(c, d->name);
    if (!v)
        return;
    snprintf(v->unit, sizeof v->unit, "%s", d->unit ? d->unit : "");
    snprintf(v->text, sizeof v->text, "%s", d->text ? d->text : "");
    v->minimum = d->minimum;
    v->maximum = d->maximum;
    v->pointer = (uint64_t)(uintptr_t)d->address;
    v->address = v->pointer - the_runner.config.image;
    v->type = d->type;
    v->kind = d->kind;
    if (d->kind == KIND_TABLE) {
        v->length = d->rows;
        v->columns = d->columns;
        *(table *)d->address = (table){.columns = d->columns};
    } else {
        v->length = d->bytes / size_of_type[d->type];
        v->columns = d->columns > 1 ? d->columns : 1; /* a program built before matrices says 0 */
        v->size = d->bytes;
        if (d->set)
            set_every(d->address, d->type, v->length, d->initial);
    }
}

static void own(control *c, int32_t kind, const char *name, const char *unit, const char *text,
                void *at, int32_t type, int32_t length) {
    variable_entry *v = new_entry(c, name);
    if (!v)
        return;
    snprintf(v->unit, sizeof v->unit, "%s", unit);
    snprintf(v->text, sizeof v->text, "%s", text);
    v->minimum = -INFINITY;
    v->maximum = INFINITY;
    v->pointer = (uint64_t)(uintptr_t)at;
    v->type = type;
    v->kind = kind;
    v->length = length;
    v->columns = 1;
    v->size = length * size_of_type[type];
}

/* The unit of the analog inputs; where they differ, that of each: "A, V". */
static void analog_units(const machine_info *info, char *text, size_t room) {
    size_t used = 0;
    int alike = 1;
    for (int i = 1; i < info->adcs; i++)
        alike = alike && strcmp(info->adc_unit[i], info->adc_unit[0]) == 0;
    for (int i = 0; i < (alike ? 1 : info->adcs) && used < room; i++)
        used += (size_t)snprintf(text + used, room - used, "%s%s", i ? ", " : "",
                                 info->adc_unit[i]);
}

/* Signals that exist without being declared, and the settings. */
void dictionary_builtins(runner *r) {
    control *c = r->control;
    builtins *b = &r->buffers.now;
    settings *s = &r->set;
    const int32_t joints = c->info.joints, adcs = c->info.adcs;
    char analog[MACHINE_ADCS * (MACHINE_UNIT + 2)] = "";
    analog_units(&c->info, analog, sizeof analog);
    const int D = TYPE_DOUBLE, I = TYPE_INT32, B = KIND_BUILTIN, S = KIND_SETTING;
    own(c, B, "tick", "", "index of the sample", &b->tick, D, 1);
    own(c, B, "t", "s", "time since load", &b->t, D, 1);
    own(c, B, "exec_us", "us", "from the start of the sample to its command", &b->exec_us, D, 1);
    own(c, B, "late_us", "us", "start of the sample behind its deadline", &b->late_us, D, 1);
    own(c, B, "drive", "", "drive mode: 0 off, 1 torque, 2 velocity", &b->drive, D, 1);
    own(c, B, "enc", "counts", "encoders", b->enc, D, joints);
    own(c, B, "aout", "mV", "analog outputs: the command that acts from this sample on", b->aout, D,
        joints);
    own(c, B, "cmd", "mV", "command computed in this sample; acts from the next", b->cmd, D,
        joints);
    if (adcs > 0)
        own(c, B, "adc", analog, "analog inputs", b->adc, D, adcs);
    own(c, B, "din", "", "digital inputs, one bit each", &b->din, D, 1);
    own(c, B, "dout", "", "digital outputs, one bit each", &b->dout, D, 1);
    own(c, S, "limit.position_min", "{q}", "trip below", s->position_min, D, joints);
    own(c, S, "limit.position_max", "{q}", "trip above", s->position_max, D, joints);
    own(c, S, "limit.speed_max", "{q}/s", "trip above", s->speed_max, D, joints);
    own(c, S, "limit.torque_max", "{tau}", "trip above, or clamp", s->torque_max, D, joints);
    own(c, S, "limit.command_max", "mV", "trip above, or clamp", s->command_max, D, joints);
    own(c, S, "limit.torque_clamp", "", "1: clamp commands at their limits instead of tripping",
        &s->torque_clamp, I, 1);
    own(c, S, "drive.ramp", "s", "soft start and soft stop", &s->ramp, D, 1);
    own(c, S, "overrun.policy", "", "0 count, 1 skip, 2 trip", &s->overrun_policy, I, 1);
    own(c, S, "overrun.limit", "", "overruns in a row that trip", &s->overrun_limit, I, 1);
    own(c, S, "stop.input", "", "digital input that stops, -1 none", &s->stop_input, I, 1);
    own(c, S, "stop.level", "", "level of that input which stops", &s->stop_level, I, 1);
}

static int by_pointer(const void *a, const void *b) {
    const variable_entry *x = *(variable_entry *const *)a, *y = *(variable_entry *const *)b;
    return (x->pointer > y->pointer) - (x->pointer < y->pointer);
}

/* Neighbouring variables are copied together: few long pieces instead of many short ones. */
static uint32_t lay_out_snapshot(runner *r) {
    static variable_entry *sorted[LAYOUT_VARIABLES];
    control *c = r->control;
    size_t used = 0;
    uint32_t at = 0;
    for (int32_t i = 0; i < c->variables; i++) {
        c->variable[i].snapshot = -1;
        if (c->variable[i].kind != KIND_TABLE)
            sorted[used++] = &c->variable[i];
    }
    qsort(sorted, used, sizeof sorted[0], by_pointer);
    for (size_t i = 0; i < used; i++) {
        variable_entry *v = sorted[i];
        range *last =
            r->config.ranges_used > 0 ? &r->config.ranges[r->config.ranges_used - 1] : NULL;
        const uint64_t end = last ? (uint64_t)(uintptr_t)last->from + last->size : 0;
        if (last && v->pointer <= end + 32 && v->pointer + (uint64_t)v->size >= end) {
            last->size =
                (uint32_t)(v->pointer + (uint64_t)v->size - (uint64_t)(uintptr_t)last->from);
        } else {
            at = last ? (last->to + last->size + 15u) & ~15u : 0;
            last = &r->config.ranges[r->config.ranges_used++];
            /* keep the alignment of the source, so that values are aligned in the snapshot too */
            *last = (range){.from = (const unsigned char *)(uintptr_t)v->pointer,
                            .to = at + (uint32_t)(v->pointer & 7u),
                            .size = (uint32_t)v->size};
        }
        v->snapshot =
            (int32_t)(last->to + (uint32_t)(v->pointer - (uint64_t)(uintptr_t)last->from));
        at = last->to + last->size;
    }
    return (at + 63u) & ~63u;
}

/* Room for an update of everything at once, element by element. */
static uint64_t batch_bytes(const control *c) {
    uint64_t bytes = sizeof(batch);
    for (int32_t i = 0; i < c->variables; i++) {
        const variable_entry *v = &c->variable[i];
        if (v->kind == KIND_TABLE)
            bytes += sizeof(batch_entry) + 8;
        else if (v->kind == KIND_PARAMETER || v->kind == KIND_SETTING)
            bytes += v->length <= 64
                         ? (uint64_t)v->length * (sizeof(batch_entry) + 8)
                         : sizeof(batch_entry) + 2u * (((uint64_t)v->size + 7u) & ~7ull);
    }
    return (bytes + 63u) & ~63ull;
}

static uint64_t page(uint64_t bytes) { return (bytes + 4095u) & ~4095ull; }

static int map_data(runner *r) {
    control *c = r->control;
    const int file = open(c->data_path, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
    /* allocate now: a full /dev/shm shall be an error here, not a SIGBUS in the loop */
    const int failed = file < 0 ? errno : posix_fallocate(file, 0, (off_t)c->data_bytes);
    if (failed) {
        snprintf(c->error, sizeof c->error,
                 "shared memory: %llu bytes for variables and tables: %s",
                 (unsigned long long)c->data_bytes, strerror(failed));
        if (file >= 0)
            close(file);
        return -1;
    }
    r->data = contain_map(file, c->data_bytes);
    close(file);
    if (!r->data) {
        snprintf(c->error, sizeof c->error, "shared memory: %s", strerror(errno));
        return -1;
    }
    return 0;
}

/* After UserInit: lay out the data file, map it, and keep the initial values. */
int dictionary_finish(runner *r) {
    control *c = r->control;
    if (c->error[0])
        return -1;
    const uint32_t values = lay_out_snapshot(r);
    c->snapshot_bytes = (int32_t)values;
    c->initial_offset = 0;
    c->snapshot_offset = page(values);
    c->snapshot_stride = (sizeof(snapshot) + values + 63u) & ~63ull;
    c->batch_offset = page(c->snapshot_offset + LAYOUT_SNAPSHOTS * c->snapshot_stride);
    c->batch_stride = batch_bytes(c);
    uint64_t at = page(c->batch_offset + LAYOUT_BATCHES * c->batch_stride);
    for (int32_t i = 0; i < c->variables; i++) {
        variable_entry *v = &c->variable[i];
        for (int bank = 0; v->kind == KIND_TABLE && bank < 2; bank++) {
            v->bank[bank] = at;
            at = page(at + (uint64_t)v->length * (uint64_t)v->columns * sizeof(double));
        }
    }
    c->data_bytes = at;
    if (map_data(r) != 0)
        return -1;
    for (int i = 0; i < r->config.ranges_used; i++)
        memcpy(r->data + r->config.ranges[i].to, r->config.ranges[i].from,
               r->config.ranges[i].size);
    return 0;
}
