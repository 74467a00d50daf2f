/* What a pass over a recording knows, for LANES parameter sets at once (see effects.c), and the
 * state that it begins with. */

typedef struct { /* a pass; what no lane has is a constant 0, and costs nothing */
    const zk_model *M;
    const OF(numbers) *N;
    OF(state) *S;
    int two_mass, hidden, wavy, filtered, drives, looped;
    int geared; /* a rigid transmission with an error */
    int side;   /* 1: the sensor is on the load; no matter where motor and load are one */
    int steady; /* the command acts as it is held */
    double h, per_h, per_T; /* of a step and of a sample, s */
} OF(task);

typedef struct { /* what is predicted, [LANES] each; pointers, so that the lanes are registers */
    double *q, *qd, *ql, *qdl;           /* motor and load */
    double *seen, *y;                    /* behind the filter; what the sensor says of it */
    double *z, *zh, *rub;                /* bristle, hysteresis, dry friction in the step before */
    double *u, *a, *past, *tau;          /* command, lagged torque, command's integral; torque */
    double *early;                       /* see drive */
    double *jm, *per_jm, *per_jl, *bias; /* of the sample: inertias, torque of the rigid body */
    double *load, *wave, *slope, *bend;  /* where a lane is wavy: the load's inertia; the error */
    double *push, *spring;               /* torques of the step, but friction and effects */
    double *ex, *mean, *fade;            /* constants of the lag and of the filter */
} OF(motion);
typedef struct { /* series along the recording, of which several lanes may have the same */
    const double *of[LANES];
    long long has[LANES][LANES]; /* -1 where a lane has it, else 0 */
    int count;
} OF(series);

/* The series of all lanes, by where a model has its pointer. */
static void OF(collect)(const zk_model *M, size_t offset, OF(series) *out)
{
    memset(out, 0, sizeof *out);
    for (int l = 0; l < LANES; l++) {
        const double *own = *(const double *const *)((const char *)&M[l] + offset);
        int i = 0;
        while (i < out->count && out->of[i] != own) i++;
        if (i == out->count) out->of[out->count++] = own;
        out->has[i][l] = -1;
    }
}

/* Their values at sample k. */
INLINE void OF(value)(const OF(series) *from, int k, OF(lane) *out)
{
    const double first = from->of[0][k];
    EACH (*out)[l] = first;
    for (int i = 1; LANES > 1 && i < from->count; i++) {
        const double other = from->of[i][k];
        EACH (*out)[l] = from->has[i][l] ? other : (*out)[l];
    }
}

#define LANES_AT(lane) ((double *)&(lane))
#define LANES_OF(name) ((OF(lane) *)X->name)

/* Positions and speeds of motor and load from those of the side that the sensor is on, where the
 * transmission has an error; returns how the load turns for each turn of the motor. */
static __attribute__((noinline)) double OF(begin_wavy)(const OF(numbers) *N, int side, int l,
                                                       double start[4])
{
    const double amp = N->w_amp[l], order = N->w_order[l], phase = N->w_phase[l];
    double q = start[0];
    for (int i = 0; i < 10 && side; i++)
        q -= (q + amp * sin(order * q + phase) - start[2]) /
             (1 + amp * order * cos(order * q + phase));
    const double slope = 1 + amp * order * cos(order * q + phase);
    start[0] = q;
    if (side) start[1] /= slope;
    else {
        start[2] += amp * sin(order * q + phase);
        start[3] *= slope;
    }
    return slope;
}

/* A spring is bent by what the load needs, or not at all. */
INLINE void OF(begin_bent)(const OF(task) *O, OF(motion) *X, int l, double hangs)
{
    const zk_model *M = &O->M[l];
    const double k = O->N->k_spring[l], k3 = O->N->k_cubic[l], extra = O->N->j_extra[l];
    double jm, jl;
    share_inertia(O->N->j_links[l] + extra, M->inertia[0] + extra, O->N->j_load[l], &jm, &jl);
    const double push = jl * M->a0 + M->bias[0] + O->N->gravity[l] * sin(M->q0) + hangs +
                        O->N->dry_load[l] * sgn(M->qd0);
    double bent = k > 0 ? push / k : 0.0;
    /* k x + k3 x^3 = push by Newton's method, which converges from above */
    for (int i = 0; i < 20 && k3 > 0; i++)
        bent -= (k * bent + k3 * bent * bent * bent - push) / (k + 3 * k3 * bent * bent);
    bent *= 1 - M->unbent;
    if (O->side) { X->q[l] += bent + M->b0; X->qd[l] += M->bd0; }
    else { X->ql[l] += M->b0 - bent; X->qdl[l] += M->bd0; }
}

#define SIDE_Q (O->side ? X->ql[l] : X->q[l]) /* of the side that the sensor is on */

INLINE void OF(look)(const OF(task) *O, OF(motion) *X)
{
    OF(lane) at;
    EACH at[l] = O->filtered ? X->seen[l] : SIDE_Q;
    OF(sense)(O->M, O->N, O->S, &at, (OF(lane) *)X->y);
}

/* Moved to where the sensor would say what it said first: it may err by many counts there. */
INLINE void OF(begin_sensed)(const OF(task) *O, OF(motion) *X)
{
    OF(lane) off, e;
    for (int i = 0; i < 4; i++) {
        OF(look)(O, X);
        EACH {
            const double dq = O->M[l].q0 - X->y[l];
            X->q[l] += dq; X->ql[l] += dq; X->seen[l] += dq;
        }
    }
    OF(look)(O, X);
    EACH off[l] = (O->filtered ? X->seen[l] : SIDE_Q) + 1e-5;
    OF(sense)(O->M, O->N, O->S, &off, &e);
    EACH {
        const double slower = 1e-5 / (e[l] - X->y[l]);
        X->qd[l] *= slower; X->qdl[l] *= slower;
    }
}

INLINE void OF(begin)(const OF(task) *O, OF(motion) *X)
{
    OF(lane) hangs = {0};
    if (O->two_mass && O->N->hung) {
        EACH O->S->q[l] = O->M[l].q0;
        OF(hang)(O->M, O->N, O->S, &hangs);
    }
    for (int l = 0; l < LANES; l++) {
        const double late = O->N->filter[l], lag = O->N->lag[l];
        X->q[l] = X->ql[l] = O->M[l].q0; X->qd[l] = X->qdl[l] = O->M[l].qd0;
        X->z[l] = X->zh[l] = X->a[l] = X->rub[l] = 0;
        X->wave[l] = X->bend[l] = X->load[l] = 0;
        X->slope[l] = 1;
        X->seen[l] = X->q[l];
        X->fade[l] = exp(-O->h / late);
        if (O->filtered) { /* what is seen is late by the filter */
            X->q[l] += late * X->qd[l]; X->ql[l] = X->q[l];
            X->qd[l] += late * O->M[l].a0; X->qdl[l] = X->qd[l];
        }
        if (O->wavy) {
            double start[4] = {X->q[l], X->qd[l], X->ql[l], X->qdl[l]};
            X->slope[l] = OF(begin_wavy)(O->N, O->side, l, start);
            X->q[l] = start[0]; X->qd[l] = start[1]; X->ql[l] = start[2]; X->qdl[l] = start[3];
        }
        X->ex[l] = exp(-O->h / lag); X->mean[l] = lag / O->h * (1 - X->ex[l]);
        /* in a gap it may be anywhere */
        if (O->two_mass && !O->N->gapped) OF(begin_bent)(O, X, l, hangs[l]);
    }
    if (O->N->senses) OF(begin_sensed)(O, X);
}

/* A state of which the sensor would say what is recorded. */
INLINE void OF(restart)(const OF(task) *O, OF(motion) *X, int k)
{
    const zk_model *M = O->M;
    const OF(numbers) *N = O->N;
    OF(lane) rate, off, e;
    for (int i = 0; i < (N->senses ? 4 : 1); i++) {
        EACH {
            double dq = M->rq[k] + N->shift[l] - X->y[l];
            X->q[l] += dq;
            X->ql[l] += dq;
            X->seen[l] += dq;
        }
        if (N->senses) OF(look)(O, X);
    }
    EACH rate[l] = M->rqd[k];
    if (N->senses) {
        EACH off[l] = (O->filtered ? X->seen[l] : SIDE_Q) + 1e-5;
        OF(sense)(M, N, O->S, &off, &e);
        EACH rate[l] = M->rqd[k] * 1e-5 / (e[l] - X->y[l]);
    }
    if (O->filtered) { /* the joint is ahead of what is seen of it */
        const int before = k > 0 ? k - 1 : k, after = k + 1 < M->n ? k + 1 : k;
        const double grows = (M->rqd[after] - M->rqd[before]) / ((after - before) * M->T);
        EACH {
            double dq = X->seen[l] + N->filter[l] * rate[l] - SIDE_Q;
            X->q[l] += dq; X->ql[l] += dq; rate[l] += N->filter[l] * grows;
        }
    }
    EACH {
        double dv = rate[l] - (O->side ? X->qdl[l] : X->qd[l]);
        X->qd[l] += dv; X->qdl[l] += dv;
    }
    if (O->two_mass && M->rb) EACH {
        if (O->side) { X->q[l] = X->ql[l] + M->rb[k]; X->qd[l] = X->qdl[l] + M->rbd[k]; }
        else { X->ql[l] = X->q[l] + M->rb[k]; X->qdl[l] = X->qd[l] + M->rbd[k]; }
    }
}
