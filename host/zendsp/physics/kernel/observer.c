/* The pass over a recording: predict, compare with what was measured, correct. All of it, motion.c
 * and step.c too, is inlined into one function for each sort of model (see SORT). */

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
        e[l] = w > 0 ? OF(soft)(m + N->shift[l] - X->y[l], half) : 0.0;
        out[l] = w * e[l];
        /* in a gap, what pushes one side does not reach the other */
        double dq = k1 * e[l], dv = k2 * e[l],
               apart = fabs(X->q[l] - X->ql[l]) < 0.5 * N->gap[l] ? 0.0 : 1.0;
        X->q[l] += dq; X->ql[l] += dq;
        X->qd[l] += O->side ? apart * dv : dv;
        X->qdl[l] += O->side ? dv : apart * dv;
    }
    if (O->filtered) EACH { /* what is seen is corrected as it would be without the filter */
        const double ahead = N->filter[l] * k2 * e[l];
        X->seen[l] += k1 * e[l]; X->q[l] += ahead; X->ql[l] += ahead;
    }
}

enum { OF(LOOK) = LANES > 1 ? BLOCK : 1 }; /* samples from look to look at who ran away */

/* Lanes that ran away by sample k are noted; returns how many have not. away: 1 where they have, of
 * the samples since the last look. */
INLINE int OF(count)(const OF(task) *O, const OF(motion) *X, int k, int left,
                     OF(lane) away[OF(LOOK)], int *gone)
{
    const double near = O->looped && O->M->kp > 0 ? O->M->ref[k] : O->M->m[k];
    const int at = k % OF(LOOK);
    EACH away[at][l] =
        (fabs(SIDE_Q - near) < 1e3) & (fabs(X->qd[l]) < 1e5) ? 0.0 : 1.0;
    if (at < OF(LOOK) - 1 && k < O->M->n - 1) return left;
    OF(lane) sum = {0};
    for (int i = 0; i <= at; i++) EACH sum[l] += away[i][l];
    for (int l = 0; l < LANES; l++)
        if (sum[l] > 0 && !gone[l]) {
            for (gone[l] = 1 + k - at; away[gone[l] - 1 - k + at][l] == 0; gone[l]++) { }
            left--;
        }
    return left;
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
    OF(lane) q, qd, ql, qdl, seen, y, z, zh, rub, u = {0}, a, past, tau = {0}, early = {0};
    OF(lane) jm, per_jm, per_jl, bias, load, wave, slope, bend, push, spring, ex, mean, fade;
    OF(motion) motion = {
        LANES_AT(q),      LANES_AT(qd),     LANES_AT(ql),   LANES_AT(qdl),   LANES_AT(seen),
        LANES_AT(y),      LANES_AT(z),      LANES_AT(zh),   LANES_AT(rub),   LANES_AT(u),
        LANES_AT(a),      LANES_AT(past),   LANES_AT(tau),  LANES_AT(early), LANES_AT(jm),
        LANES_AT(per_jm),
        LANES_AT(per_jl), LANES_AT(bias),   LANES_AT(load), LANES_AT(wave),  LANES_AT(slope),
        LANES_AT(bend),   LANES_AT(push),   LANES_AT(spring), LANES_AT(ex),  LANES_AT(mean),
        LANES_AT(fade)}, *X = &motion;
    double loop[2] = {M->q0, 0};
    OF(series) rigid[2];
    OF(lane) away[OF(LOOK)];
    int gone[LANES] = {0}, k = 0, left = LANES;
    const int sub = O->N->gapped ? CONTACT_STEPS * M->sub : M->sub, n = M->n;
    O->geared = O->wavy && !O->two_mass;
    O->side = (O->two_mass || O->wavy) && M->load_sensor;
    O->steady = !O->hidden || (!O->N->lag_on && !O->N->late);
    O->h = M->T / sub; O->per_h = 1.0 / O->h; O->per_T = 1.0 / M->T;
    const int shown = M->beyond ? !O->side : O->side; /* the load */
    memset(O->S, 0, sizeof *O->S);
    OF(begin)(O, X);
    OF(collect)(M, offsetof(zk_model, inertia), &rigid[0]);
    OF(collect)(M, offsetof(zk_model, bias), &rigid[1]);
    for (; k < n; k++) {
        OF(innovate)(O, X, k, loop, r + (size_t)k * LANES);
        left = OF(count)(O, X, k, left, away, gone);
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
        if (O->filtered && O->N->by_rows) /* a filter that is computed once a row */
            EACH X->seen[l] += O->N->keep[l] > 0 ? (1 - O->N->keep[l]) * (SIDE_Q - X->seen[l]) : 0;
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
    OF(begin_numbers)(M, N);
    const int looped = LANES == 1 && (M->kp > 0 || M->reset > 0);
    const int any = looped || N->filtered || N->drives || (N->wavy && N->two_mass);
    return (any           ? OF(any)
            : N->wavy     ? OF(geared)
            : N->two_mass ? OF(sprung)
            : N->hidden   ? OF(hidden)
                          : OF(plain))(M, N, r, xq, xqd, torque);
}
