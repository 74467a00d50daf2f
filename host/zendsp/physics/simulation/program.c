/* The user's own program in the place of the controller: what isr.h asks of a runtime, around one
 * simulated machine.
 *
 * Runs in a child process of the simulator's, so that code that crashes or never returns takes
 * nothing else with it.
 */
#include <dlfcn.h> /* dlopen, dlsym */
#include <stdio.h> /* snprintf */

#include "declared.h"
#include "isr.h"

enum { HOST_VARIABLES = 512 };

typedef struct host_variable {
    char name[64], unit[32], text[192];
    void *address;
    double minimum, maximum;
    int32_t kind, type, length, columns;
} host_variable;

typedef struct host_channel { /* one column of the recording */
    const void *address;
    int32_t type, pad;
} host_channel;

typedef struct host {
    zendsp_io io;
    double measured[8], q[8], qd[8], torque[8]; /* of the simulated machine */
    double tick, t;
    double enc[8];
    int32_t variables, stored;
    host_variable variable[HOST_VARIABLES];
    char problem[256];
    void (*isr)(void), (*background)(void);
    /* while it runs */
    const host_channel *channel;
    int32_t channels, rows;
    double *out;
    double low_q[8], high_q[8]; /* positions reached, rad or m */
    double most_aout[8];        /* largest magnitude, mV */
    int32_t beyond[8];          /* first tick at which aout exceeded what the joint takes, or -1 */
} host;

static host the_host;

static void declare(const zendsp_declaration *d) {
    static const int32_t size_of[] = {0, 8, 4, 4, 1};
    host *h = &the_host;
    if (h->problem[0])
        return;
    if (h->variables >= HOST_VARIABLES) {
        snprintf(h->problem, sizeof h->problem, "variable '%s': more than %d variables", d->name,
                 HOST_VARIABLES);
        return;
    }
    for (int32_t i = 0; i < h->variables; i++)
        if (strcmp(h->variable[i].name, d->name) == 0) {
            snprintf(h->problem, sizeof h->problem, "variable '%s' is declared twice", d->name);
            return;
        }
    const int32_t length =
        d->kind == ZENDSP_TABLE || !d->type ? 0 : d->bytes / size_of[d->type];
    const char *why = d->kind != ZENDSP_SIGNAL && is_constant(d->address)
                          ? "it is const, so nobody could write it: leave const out"
                          : no_parameter(d, length);
    if (why) {
        snprintf(h->problem, sizeof h->problem, "variable '%s': %s", d->name, why);
        return;
    }
    host_variable *v = &h->variable[h->variables++];
    snprintf(v->name, sizeof v->name, "%s", d->name);
    snprintf(v->unit, sizeof v->unit, "%s", d->unit ? d->unit : "");
    snprintf(v->text, sizeof v->text, "%s", d->text ? d->text : "");
    v->address = d->address;
    v->minimum = d->minimum;
    v->maximum = d->maximum;
    v->kind = d->kind;
    v->type = d->type;
    v->columns = d->columns > 1 ? d->columns : 1; /* of a matrix */
    if (d->kind == ZENDSP_TABLE) {
        v->length = d->rows;
        v->columns = d->columns;
        *(table *)d->address = (table){.columns = d->columns};
        return;
    }
    v->length = d->bytes / size_of[d->type];
    for (int32_t i = 0; d->set && i < v->length; i++)
        switch (d->type) {
        case ZENDSP_DOUBLE:
            ((double *)d->address)[i] = d->initial;
            break;
        case ZENDSP_FLOAT:
            ((float *)d->address)[i] = (float)d->initial;
            break;
        case ZENDSP_INT32:
            ((int32_t *)d->address)[i] = (int32_t)d->initial;
            break;
        default:
            ((bool *)d->address)[i] = d->initial != 0;
            break;
        }
}

/* One row of the recording, at most one a sample. */
static void acquire(void) {
    host *h = &the_host;
    if (h->stored || !h->out)
        return;
    h->stored = 1;
    double *row = h->out + (size_t)h->rows++ * (size_t)h->channels;
    for (int32_t i = 0; i < h->channels; i++) {
        const host_channel *c = &h->channel[i];
        switch (c->type) {
        case ZENDSP_DOUBLE:
            row[i] = *(const double *)c->address;
            break;
        case ZENDSP_FLOAT:
            row[i] = *(const float *)c->address;
            break;
        case ZENDSP_INT32:
            row[i] = *(const int32_t *)c->address;
            break;
        default:
            row[i] = *(const bool *)c->address;
            break;
        }
    }
}

/* Bytes of a host: whoever declares the struct again holds its copy against this. */
int host_size(void) { return (int)sizeof(host); }

/* Load a program and let it declare its variables. Returns the host, whose `problem` is empty when
 * all is well. */
host *host_open(const char *path, int joints, double period, const double *counts_per_unit,
                const double *mv_per_torque, const double *torque_max,
                const double *inertia) {
    host *h = &the_host;
    memset(h, 0, sizeof *h);
    h->io.period = period;
    h->io.joints = joints;
    h->io.enabled = 1;
    h->io.declare = declare;
    h->io.acquire = acquire;
    for (int i = 0; i < joints; i++) {
        h->io.counts_per_unit[i] = counts_per_unit[i];
        h->io.mv_per_torque[i] = mv_per_torque[i];
        h->io.torque_max[i] = torque_max[i];
        h->io.inertia[i] = inertia[i];
    }
    for (int i = joints; i < 8; i++)
        h->io.counts_per_unit[i] = h->io.mv_per_torque[i] = 1.0;
    void *program = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!program) {
        snprintf(h->problem, sizeof h->problem, "%s", dlerror());
        return h;
    }
    zendsp_io **io = (zendsp_io **)dlsym(program, "zendsp");
    void (*init)(void);
    *(void **)&init = dlsym(program, "UserInit");
    *(void **)&h->isr = dlsym(program, "UserISR_INT2");
    *(void **)&h->background = dlsym(program, "UserBackground");
    if (!io || !init || !h->isr) {
        snprintf(h->problem, sizeof h->problem,
                 "the program lacks %s: see template.c for the sections of a program",
                 !io     ? "#include \"isr.h\""
                 : !init ? "UserInit"
                         : "UserISR_INT2");
        return h;
    }
    *io = &h->io;
    init();
    return h;
}

/* What the run reached, joint by joint; also the outputs that no joint of the machine has. */
static void note_extremes(host *h, int n) {
    for (int i = 0; i < n; i++) {
        if (h->q[i] < h->low_q[i])
            h->low_q[i] = h->q[i];
        if (h->q[i] > h->high_q[i])
            h->high_q[i] = h->q[i];
    }
    for (int i = 0; i < 8; i++) {
        const double mv = fabs(h->io.aout[i]);
        const double most = i < n ? h->io.torque_max[i] * h->io.mv_per_torque[i] : 0.0;
        if (mv > h->most_aout[i])
            h->most_aout[i] = mv;
        /* a joint without a limit has 0; a millionth, as sums are rounded */
        if (h->beyond[i] < 0 && mv > most * (1.0 + 1e-6) && (most > 0.0 || i >= n))
            h->beyond[i] = (int32_t)h->io.tick;
    }
}

/* Whether a target would stop here, as the code names a joint or channel that is not there. */
static int names_none(const host *h, int n) {
    int found = h->io.outside != 0;
    for (int i = n; i < 8; i++)
        found |= h->beyond[i] >= 0;
    return found;
}

/* Run `ticks` samples; UserBackground is called `background` times between two of them. progress[0]
 * is the tick being computed. Returns the samples completed; motion (when it ran away) stops it
 * early, and so does code that names a joint that is not there. */
int host_run(host *h, sim *S, int ticks, int decimation, int background,
             const host_channel *channel, int channels, double *out, volatile int32_t *progress) {
    const int n = S->c.joints;
    h->channel = channel;
    h->channels = channels;
    h->out = 0;
    h->rows = 0;
    for (int i = 0; i < 8; i++) {
        h->low_q[i] = INFINITY;
        h->high_q[i] = -INFINITY;
        h->beyond[i] = -1;
    }
    int k = 0;
    for (; k < ticks; k++) {
        if (progress)
            progress[0] = k;
        int32_t counts[SIM_MAX];
        sim_measure(S, h->measured, counts);
        sim_truth(S, h->q, h->qd, h->torque);
        for (int i = 0; i < n; i++) {
            h->io.enc[i] = S->c.resolution[i] > 0
                               ? counts[i]
                               : (int32_t)floor(h->measured[i] * h->io.counts_per_unit[i] + 0.5);
            h->enc[i] = h->io.enc[i];
        }
        h->io.tick = (uint64_t)k;
        h->io.t = k * S->c.period;
        h->io.first = k == 0;
        h->tick = k;
        h->t = h->io.t;
        h->stored = 0;
        h->out = k % decimation == 0 ? out : 0;
        h->isr();
        acquire();
        note_extremes(h, n);
        if (names_none(h, n)) {
            k++;
            break;
        }
        double command[SIM_MAX];
        /* WRITE_TORQUE counts in torque, the model's commands in their own unit */
        for (int i = 0; i < n; i++)
            command[i] = h->io.aout[i] / h->io.mv_per_torque[i] / S->c.gain[i];
        if (sim_advance(S, command)) {
            k++;
            break;
        }
        for (int i = 0; i < background && h->background; i++)
            h->background();
    }
    return k;
}
