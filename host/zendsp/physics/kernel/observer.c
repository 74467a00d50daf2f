/* The pass of the kernel over a recording, for LANES parameter sets at once (see effects.c). All of
 * it is inlined into one function for each sort of model (see SORT). */

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
    double *u, *a, *past, *tau;          /* command, behind a lag, its integral; torque */
    double *jm, *per_jm, *per_jl, *bias; /* of the sample: inertias, torque of the rigid body */
    double *load, *wave, *slope, *bend;  /* where a lane is wavy: the load's inertia; the error */
    double *push, *spring;               /* torques of the step, but friction and effects */
    double *ex, *mean, *fade;            /* constants of the lag and of the filter */
} OF(motion);
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

/* A spring is bent by what the load needs. */
INLINE void OF(begin_bent)(const OF(task) *O, OF(motion) *X, int l, double hangs)
{
    const zk_model *M = &O->M[l];
    const double k = O->N->k_spring[l], k3 = O->N->k_cubic[l], extra = O->N->j_extra[l];
    double jm, jl;
    share_inertia(M, M->inertia[0] + extra, extra, O->N->j_load[l], &jm, &jl);
    const double push = jl * M->a0 + M->bias[0] + O->N->gravity[l] * sin(M->q0) + hangs;
    double bent = k > 0 ? push / k : 0.0;
    /* k x + k3 x^3 = push by Newton's method, which converges from above */
    for (int i = 0; i < 20 && k3 > 0; i++)
        bent -= (k * bent + k3 * bent * bent * bent - push) / (k + 3 * k3 * bent * bent);
    if (O->side) X->q[l] += bent;
    else X->ql[l] -= bent;
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
}

#define SIDE_Q (O->side ? X->ql[l] : X->q[l]) /* of the side that the sensor is on */

INLINE void OF(look)(const OF(task) *O, OF(motion) *X)
{
    OF(lane) at;
    EACH at[l] = O->filtered ? X->seen[l] : SIDE_Q;
    OF(sense)(O->M, O->N, O->S, &at, (OF(lane) *)X->y);
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

/* A free run: restarts, and how far it is from what is recorded. */
INLINE void OF(run_free)(const OF(task) *O, OF(motion) *X, int k, double *out)
{
    const zk_model *M = O->M;
    if (k % M->reset == 0) OF(restart)(O, X, k);
    OF(look)(O, X);
    EACH out[l] = M->w[k] * (M->m[k] + O->N->shift[l] - X->y[l]);
}

/* A closed loop: the innovations are the measured position. loop: it and its speed before. */
INLINE void OF(close_loop)(const zk_model *M, const OF(numbers) *N, int k, double y, double *loop,
                           double *out)
{
    const double read = M->resolution > 0 ? M->resolution * floor(y / M->resolution + 0.5) : y;
    out[0] = read;
    loop[1] += 0.2 * ((read - loop[0]) / M->T - loop[1]);
    loop[0] = read;
    M->uloop[k + 1] =
        M->uloop[k] + clip(M->kp * (M->ref[k] - read) - M->kd * loop[1], N->limit[0]) * M->T;
}

/* The observer corrects the state by what it did not expect. */
INLINE void OF(correct)(const OF(task) *O, OF(motion) *X, int k, double *out)
{
    const zk_model *M = O->M;
    const OF(numbers) *N = O->N;
    const double w = M->w[k], half = M->half[k], k1 = M->k1[k], k2 = M->k2[k], m = M->m[k];
    OF(lane) e;
    EACH {
        e[l] = w > 0 ? soft(m + N->shift[l] - X->y[l], half) : 0.0;
        out[l] = w * e[l];
        /* in a gap, what pushes one side does not reach the other */
        double dq = k1 * e[l], dv = k2 * e[l],
               apart = fabs(X->q[l] - X->ql[l]) < 0.5 * N->gap[l] ? 0.0 : 1.0;
        X->q[l] += dq; X->ql[l] += dq;
        X->qd[l] += O->side ? apart * dv : dv;
        X->qdl[l] += O->side ? dv : apart * dv;
    }
    if (O->filtered) EACH X->seen[l] += k1 * e[l];
}

/* Lanes that ran away by sample k are noted; returns how many have not. */
INLINE int OF(count)(const OF(task) *O, const OF(motion) *X, int k, int left, int *gone)
{
    const double near = O->looped && O->M->kp > 0 ? O->M->ref[k] : O->M->m[k];
    double lost = 0;
    _Pragma("omp simd reduction(+ : lost)") for (int l = 0; l < LANES; l++)
        lost += (fabs(SIDE_Q - near) < 1e3) & (fabs(X->qd[l]) < 1e5) ? 0.0 : 1.0;
    for (int l = 0; lost > 0 && l < LANES; l++)
        if (!gone[l] && (!(fabs(SIDE_Q - near) < 1e3) || !(fabs(X->qd[l]) < 1e5))) {
            gone[l] = 1 + k;
            left--;
        }
    return left;
}

/* What the rigid body does at sample k. rigid: BLOCK samples of its inertia and torque, written
 * long before they are read: a lane at a time, read all at once. */
INLINE void OF(rigid_body)(const OF(task) *O, OF(motion) *X, int k, double rigid[][BLOCK][LANES])
{
    const zk_model *M = O->M;
    const OF(numbers) *N = O->N;
    const int ahead = k % BLOCK;
    if (ahead == 0)
        for (int l = 0; l < LANES; l++)
            for (int i = 0; i < BLOCK && k + i < M->n; i++) {
                rigid[0][i][l] = M[l].inertia[k + i];
                rigid[1][i][l] = M[l].bias[k + i];
            }
    EACH { X->jm[l] = rigid[0][ahead][l] + N->j_extra[l]; X->bias[l] = rigid[1][ahead][l]; }
    if (O->geared) EACH X->load[l] = X->jm[l] - N->j_extra[l];
    if (O->two_mass && M->bias_slope) /* the load is not where the motor was measured */
        for (int l = 0; l < LANES; l++)
            X->bias[l] += M[l].bias_slope[k] * (X->ql[l] - M[l].rq[k] - M[l].shift);
    if (O->two_mass)
        for (int l = 0; l < LANES; l++) {
            double motor, beyond;
            share_inertia(&M[l], X->jm[l], N->j_extra[l], N->j_load[l], &motor, &beyond);
            X->jm[l] = motor;
            X->per_jl[l] = 1.0 / beyond;
        }
    EACH X->per_jm[l] = 1.0 / X->jm[l];
}

/* The command, held over sample k, and what the actuator makes of it: at once, or step by step. */
INLINE void OF(hold)(const OF(task) *O, OF(motion) *X, int k)
{
    const zk_model *M = O->M;
    if (!O->steady) {
        EACH X->past[l] = cum(M, k * M->T - O->N->delay[l], O->per_T);
        return;
    }
    const double held = (M->ucum[k + 1] - M->ucum[k]) / M->T, now = M->t0 + (k + 0.5) * M->T;
    EACH { X->u[l] = held; O->S->t[l] = now; }
    OF(act)(M, O->N, O->S, LANES_OF(u), (OF(lane) *)X->tau);
}

/* The same over a step that begins at tl, for a command that lags or is late. */
INLINE void OF(drive)(const OF(task) *O, OF(motion) *X, double tl, int first)
{
    const OF(numbers) *N = O->N;
    EACH {
        const double next = cum(O->M, tl + O->h - N->delay[l], O->per_T);
        X->u[l] = (next - X->past[l]) * O->per_h;
        X->past[l] = next;
    }
    if (O->hidden && N->lag_on)
        EACH {
            double before = first ? X->u[l] : X->a[l], held = X->u[l];
            X->u[l] = held + (before - held) * X->mean[l];
            X->a[l] = held + (before - held) * X->ex[l];
        }
    OF(act)(O->M, N, O->S, LANES_OF(u), (OF(lane) *)X->tau);
}

/* The error of a transmission: the load turns by slope for each turn of the motor. */
INLINE void OF(gear)(const OF(task) *O, OF(motion) *X, double added)
{
    const OF(numbers) *N = O->N;
    const OF(state) *S = O->S;
    EACH {
        double at = N->w_order[l] * S->q[l] + N->w_phase[l];
        X->slope[l] = 1 + N->w_amp[l] * N->w_order[l] * cosine(at);
        X->wave[l] =
            N->w_amp[l] * sin(O->two_mass ? N->w_order[l] * X->q[l] + N->w_phase[l] : at);
        X->bend[l] = -N->w_amp[l] * N->w_order[l] * N->w_order[l] * sin(at) * X->slope[l] *
                     X->load[l]; /* times the speed squared */
    }
    if (O->geared)
        EACH {
            X->jm[l] = X->load[l] * X->slope[l] * X->slope[l] + N->j_extra[l];
            X->per_jm[l] = 1.0 / X->jm[l];
            X->push[l] = X->tau[l] - added - X->slope[l] * X->bias[l];
        }
    if (O->geared && N->pulled)
        EACH X->push[l] =
            X->tau[l] - added -
            X->slope[l] * (X->bias[l] + N->gravity[l] * sin(S->q[l] + X->wave[l]));
}

/* The spring between motor and load, and the load's step. */
INLINE void OF(stretch)(const OF(task) *O, OF(motion) *X)
{
    const OF(numbers) *N = O->N;
    const double h = O->h;
    OF(lane) fall, at, motor;
    EACH { fall[l] = X->bias[l]; at[l] = X->ql[l] + 0.5 * h * X->qdl[l]; }
    if (N->pulled) EACH fall[l] += N->gravity[l] * sin(at[l]);
    if (N->hung) {
        EACH { motor[l] = O->S->q[l]; O->S->q[l] = at[l]; }
        OF(hang)(O->M, N, O->S, &fall);
        EACH O->S->q[l] = motor[l];
    }
    EACH {
        double dv = (O->wavy ? X->slope[l] * X->qd[l] : X->qd[l]) - X->qdl[l],
               d = X->q[l] - X->ql[l] + (O->wavy ? X->wave[l] : 0.0), gap = N->gap[l],
               moved = h * dv;
        double e0 = soft(d, 0.5 * gap), e1 = soft(d + moved, 0.5 * gap),
               g = 0.5 * (e0 + e1); /* mean deflection */
        int moves = fabs(moved) > 1e-12 * gap;
        double per = 1.0 / (moves ? moved : 1.0),
               on = moves ? (e1 - e0) * per : e0 != 0.0 ? 1.0 : 0.0; /* part of it in contact */
        on = gap > 0 ? on : 1.0;
        g = (on < 1.0) & (on > 0.0) & (gap > 0) ? 0.5 * (e1 * e1 - e0 * e0) * per : g;
        double c = N->c_spring[l] * on,
               pull = (O->wavy ? N->k_spring[l] + N->k_cubic[l] * g * g : N->k_spring[l]) * g +
                      c * dv;
        pull /= 1.0 + 0.5 * h * c * (X->per_jm[l] + X->per_jl[l]); /* damped by its mean speed */
        X->spring[l] = (gap > 0) & (pull * g < 0) ? 0.0 : pull; /* a contact pushes only */
        double vl = X->qdl[l] + h * (X->spring[l] - fall[l]) * X->per_jl[l];
        X->ql[l] += 0.5 * h * (X->qdl[l] + vl);
        X->qdl[l] = vl;
    }
}

/* The step's torques on the motor but friction and effects, at its middle. */
INLINE void OF(pushes)(const OF(task) *O, OF(motion) *X, double added)
{
    OF(state) *S = O->S;
    const OF(numbers) *N = O->N;
    EACH {
        S->u[l] = X->u[l]; S->tau[l] = X->tau[l];
        S->q[l] = X->q[l] + 0.5 * O->h * X->qd[l];
        S->qd[l] = X->qd[l];
        X->push[l] = X->tau[l] - added - (O->two_mass ? 0.0 : X->bias[l]);
        X->spring[l] = 0;
    }
    if (O->wavy) OF(gear)(O, X, added);
    if (O->two_mass) OF(stretch)(O, X);
    else if (N->pulled && !O->geared) EACH X->push[l] -= N->gravity[l] * sin(S->q[l]);
    EACH X->push[l] -= O->wavy ? X->slope[l] * X->spring[l] : X->spring[l];
}

/* What effects resist at the middle of the step, by the speed there. */
INLINE void OF(resist)(const OF(task) *O, const OF(motion) *X, int k, OF(lane) *f, OF(lane) *scale)
{
    OF(gather)(O->M, O->N, O->S, k, 0, f, scale);
    if (O->geared) EACH (*f)[l] += X->bend[l] * O->S->qd[l] * O->S->qd[l];
}

/* Hysteresis by Bouc and Wen, |z| <= 1. */
INLINE void OF(remember)(const OF(task) *O, OF(motion) *X, OF(lane) *free)
{
    const OF(numbers) *N = O->N;
    EACH {
        double az = pow(fabs(X->zh[l]), N->bw_n[l]), v = O->S->qd[l];
        double zn = X->zh[l] + O->h * N->bw_a[l] *
                                   (v - 0.5 * fabs(v) * az * sgn(X->zh[l]) - 0.5 * v * az);
        zn = zn > 1 ? 1 : zn < -1 ? -1 : zn;
        (*free)[l] -= N->bw_force[l] * 0.5 * (X->zh[l] + zn);
        X->zh[l] = zn;
    }
}

/* Dry friction that creeps: v + most tanh(v / slow) = vfree. In units of slow, u + a tanh u = f, by
 * Newton's method from below: with e = exp(2 u), one division a step. */
INLINE void OF(creep)(const OF(task) *O, const OF(motion) *X, const OF(lane) *level,
                      const OF(lane) *vfree, OF(lane) *vn)
{
    EACH {
        double most = O->h * (*level)[l] * X->per_jm[l], slow = O->N->creep[l];
        int on = (slow > 0) & (most > 0);
        double per = 1.0 / (on ? slow : 1.0), f = (*vfree)[l] * per, a = most * per,
               u = fabs(f) < a + 1 ? f / (a + 1) : (*vn)[l] * per;
        for (int turn = 0; turn < CREEP_STEPS; turn++) {
            double e = exp(clip(2 * u, 40.0)), sum = e + 1;
            u -= ((u - f) * sum * sum + a * (e - 1) * sum) / (sum * sum + 4 * a * e);
        }
        (*vn)[l] = on ? u * slow : (*vn)[l];
    }
}

/* Bristles: z' = qd - s0 |qd| z / level, implicit in z and qd. */
INLINE void OF(bristle)(const OF(task) *O, OF(motion) *X, const OF(lane) *level,
                        const OF(lane) *vfree, OF(lane) *vn)
{
    const OF(numbers) *N = O->N;
    const double h = O->h, per_h = O->per_h;
    EACH {
        int on = (N->s0[l] > 0) & ((*level)[l] > 0);
        double D = 1 + h * N->s0[l] * fabs(O->S->qd[l]) / (on ? (*level)[l] : 1.0),
               st = N->s0[l] + N->s1[l] * per_h, w = h * X->per_jm[l];
        double v = ((*vfree)[l] + w * (N->s1[l] * per_h * X->z[l] - st * X->z[l] / D)) /
                   (1 + w * st * h / D);
        (*vn)[l] = on ? v : (*vn)[l];
        X->z[l] = on ? (X->z[l] + h * v) / D : X->z[l];
    }
}

/* The motor's step, of which all but dry friction and its kin are known. */
INLINE void OF(slide)(const OF(task) *O, OF(motion) *X, const OF(lane) *f, const OF(lane) *scale)
{
    OF(lane) free, vfree, level, vn;
    EACH free[l] = X->push[l] - (*f)[l];
    if (O->hidden && O->N->bent) OF(remember)(O, X, &free);
    EACH vfree[l] = X->qd[l] + O->h * free[l] * X->per_jm[l];
    OF(dry)(O->M, O->N, O->S, &vfree, scale, &level);
    EACH {
        level[l] = level[l] > 0 ? level[l] : 0.0;
        vn[l] = soft(vfree[l], O->h * level[l] * X->per_jm[l]);
    }
    if (O->hidden && O->N->creeps) OF(creep)(O, X, &level, &vfree, &vn);
    if (O->hidden && O->N->bristled) OF(bristle)(O, X, &level, &vfree, &vn);
    if (O->N->loaded)
        EACH O->S->load[l] =
            O->two_mass ? X->spring[l]
                        : X->jm[l] * (vn[l] - X->qd[l]) * O->per_h + X->bias[l] +
                              O->N->gravity[l] * sin(O->S->q[l]);
    EACH {
        X->rub[l] = (vfree[l] - vn[l]) * X->jm[l] * O->per_h;
        X->q[l] += 0.5 * O->h * (X->qd[l] + vn[l]);
        X->qd[l] = vn[l];
    }
}

/* One step of sample k, which begins tl s after the first sample. */
INLINE void OF(step)(const OF(task) *O, OF(motion) *X, int k, double tl, double added)
{
    const zk_model *M = O->M;
    const OF(numbers) *N = O->N;
    OF(state) *S = O->S;
    OF(lane) from, f, scale;
    EACH S->t[l] = M->t0 + tl + 0.5 * O->h; /* absolute, for effects */
    if (!O->steady) OF(drive)(O, X, tl, k == 0 && tl == 0);
    if (O->filtered) EACH from[l] = SIDE_Q;
    OF(pushes)(O, X, added);
    OF(resist)(O, X, k, &f, &scale);
    EACH S->qd[l] =
        X->qd[l] + 0.5 * O->h * (X->push[l] - f[l] - X->rub[l]) * X->per_jm[l];
    if (O->drives) EACH S->tau[l] = X->tau[l];
    OF(resist)(O, X, k, &f, &scale);
    OF(slide)(O, X, &f, &scale);
    if (!O->two_mass) EACH { X->ql[l] = X->q[l]; X->qdl[l] = X->qd[l]; }
    if (O->geared && (O->side || M->beyond)) /* or else nobody looks at it */
        EACH {
            X->ql[l] += N->w_amp[l] * sin(N->w_order[l] * X->q[l] + N->w_phase[l]);
            X->qdl[l] *= X->slope[l];
        }
    if (O->filtered) /* exact for a position that moves evenly within the step */
        EACH {
            double to = SIDE_Q, lag = (to - from[l]) * O->per_h * N->filter[l];
            X->seen[l] = to - lag + (X->seen[l] - from[l] + lag) * X->fade[l];
        }
}

/* Innovations of sample k, out[LANES], and the state corrected by them; or, where asked for, of a
 * loop or a free run. */
INLINE void OF(innovate)(const OF(task) *O, OF(motion) *X, int k, double *loop, double *out)
{
    OF(look)(O, X);
    if (O->looped && O->M->kp > 0) OF(close_loop)(O->M, O->N, k, X->y[0], loop, out);
    else if (O->looped && O->M->reset > 0) OF(run_free)(O, X, k, out);
    else OF(correct)(O, X, k, out);
}

/* Innovations r[n x LANES] (weighted); of one lane, where asked for, the corrected states (n) and
 * the actuator torque. Returns 0, or 1 + the sample at which the last lane ran away. */
INLINE int OF(predict)(OF(task) *O, double *r, double *xq, double *xqd, double *torque)
{
    const zk_model *M = O->M;
    OF(lane) q, qd, ql, qdl, seen, y, z, zh, rub, u = {0}, a, past, tau = {0};
    OF(lane) jm, per_jm, per_jl, bias, load, wave, slope, bend, push, spring, ex, mean, fade;
    OF(motion) motion = {
        LANES_AT(q),      LANES_AT(qd),     LANES_AT(ql),   LANES_AT(qdl),   LANES_AT(seen),
        LANES_AT(y),      LANES_AT(z),      LANES_AT(zh),   LANES_AT(rub),   LANES_AT(u),
        LANES_AT(a),      LANES_AT(past),   LANES_AT(tau),  LANES_AT(jm),    LANES_AT(per_jm),
        LANES_AT(per_jl), LANES_AT(bias),   LANES_AT(load), LANES_AT(wave),  LANES_AT(slope),
        LANES_AT(bend),   LANES_AT(push),   LANES_AT(spring), LANES_AT(ex),  LANES_AT(mean),
        LANES_AT(fade)}, *X = &motion;
    double rigid[2][BLOCK][LANES], loop[2] = {M->q0, 0};
    int gone[LANES] = {0}, k = 0, left = LANES;
    const int sub = O->N->gapped ? CONTACT_STEPS * M->sub : M->sub, n = M->n;
    O->geared = O->wavy && !O->two_mass;
    O->side = (O->two_mass || O->wavy) && M->load_sensor;
    O->steady = !O->hidden || (!O->N->lag_on && !O->N->late);
    O->h = M->T / sub; O->per_h = 1.0 / O->h; O->per_T = 1.0 / M->T;
    const int shown = M->beyond ? !O->side : O->side; /* the load */
    memset(O->S, 0, sizeof *O->S);
    OF(begin)(O, X);
    for (; k < n; k++) {
        OF(innovate)(O, X, k, loop, r + (size_t)k * LANES);
        left = OF(count)(O, X, k, left, gone);
        if (!left) break;
        if (xq) xq[k] = shown ? X->ql[0] : X->q[0];
        if (xqd) xqd[k] = shown ? X->qdl[0] : X->qd[0];
        if (k == n - 1) { if (torque) torque[k] = k ? torque[k - 1] : 0; break; }
        OF(rigid_body)(O, X, k, rigid);
        OF(hold)(O, X, k);
        const double added = M->extra ? M->extra[k] : 0;
        OF(lane) usum = {0};
        for (int i = 0; i < sub; i++) {
            OF(step)(O, X, k, k * M->T + i * O->h, added);
            EACH usum[l] += O->S->tau[l];
        }
        if (torque) torque[k] = usum[0] / sub;
    }
    for (int l = 0; l < LANES; l++) /* what has run away is far from everything */
        for (int i = gone[l] - 1; gone[l] && i < n; i++) r[(size_t)i * LANES + l] = 1e9;
    return left ? 0 : 1 + k;
}

/* predict for models of one sort; each a function of its own, which the compiler sees through
 * sooner */
#define SORT(sort, ...)                                                                           \
    static __attribute__((noinline)) int OF(sort)(const zk_model *M, const OF(numbers) *N,        \
                                                  double *r, double *xq, double *xqd,             \
                                                  double *torque)                                 \
    {                                                                                             \
        OF(state) state;                                                                          \
        OF(task) task = {.M = M, .N = N, .S = &state, __VA_ARGS__};                               \
        return OF(predict)(&task, r, xq, xqd, torque);                                            \
    }
SORT(plain, .wavy = 0)
SORT(hidden, .hidden = 1)
SORT(geared, .hidden = N->hidden, .wavy = 1)
SORT(sprung, .two_mass = 1, .hidden = N->hidden)
SORT(any, .two_mass = N->two_mass, .hidden = 1, .wavy = N->wavy, .filtered = N->filtered,
     .drives = N->drives, .looped = LANES == 1)
#undef SORT
#undef SIDE_Q
#undef LANES_AT
#undef LANES_OF

static int OF(pass)(const zk_model *M, double *r, double *xq, double *xqd, double *torque)
{
    OF(numbers) numbers, *N = &numbers;
    OF(set_up)(M, N);
    const int looped = LANES == 1 && (M->kp > 0 || M->reset > 0);
    const int any = looped || N->filtered || N->drives || (N->wavy && N->two_mass);
    return (any           ? OF(any)
            : N->wavy     ? OF(geared)
            : N->two_mass ? OF(sprung)
            : N->hidden   ? OF(hidden)
                          : OF(plain))(M, N, r, xq, xqd, torque);
}
