/* The pass of the kernel over a recording, for LANES parameter sets at once (see effects.c). */

/* Innovations r[n x LANES] (weighted); of one lane, where asked for, the corrected states (n) and
 * the actuator torque. Returns 0, or 1 + the sample at which the last lane's prediction ran away.
 * What no lane has is a constant 0 where it is called (see pass), and costs nothing. */
static inline __attribute__((always_inline)) int OF(predict)(const zk_model *M, OF(numbers) * N,
                                                             double *r, double *xq, double *xqd,
                                                             double *torque, const int two_mass,
                                                             const int hidden, const int wavy,
                                                             const int filtered, const int drives,
                                                             const int looped) {
    OF(state) state, *S = &state;
    memset(S, 0, sizeof *S);
    /* rub: dry friction in the step before */
    OF(lane) q, qd, ql, qdl, z, zh, a, rub;
    /* see below, where any lane is wavy or filtered */
    OF(lane) wave, slope, bend, load, from, seen, fade;
    OF(lane) usum, u = {0}, tau = {0}, f, scale, level, y, e, ex, mean, past, at;
    double inertias[BLOCK][LANES], biases[BLOCK][LANES];
    int gone[LANES], left = LANES;
    const int geared = wavy && !two_mass; /* a rigid transmission with an error */
    const int sub = N->gapped ? CONTACT_STEPS * M->sub : M->sub, n = M->n;
    /* where motor and load are one, it does not matter which the sensor sees */
    const int side = (two_mass || wavy) && M->load_sensor;
    const double h = M->T / sub, per_h = 1.0 / h, per_T = 1.0 / M->T;
    double yloop = M->q0, vloop = 0;
    for (int l = 0; l < LANES; l++) {
        q[l] = ql[l] = M[l].q0; qd[l] = qdl[l] = M[l].qd0;
        z[l] = zh[l] = a[l] = rub[l] = 0; gone[l] = 0;
        wave[l] = bend[l] = load[l] = 0;
        slope[l] = 1;
        seen[l] = q[l];
        fade[l] = exp(-h / N->filter[l]);
        if (filtered) { /* what is seen is late by the filter */
            q[l] += N->filter[l] * qd[l]; ql[l] = q[l];
            qd[l] += N->filter[l] * M[l].a0; qdl[l] = qd[l];
        }
        if (wavy) { /* the motor where the load is known, and the other way round */
            for (int i = 0; i < 10 && side; i++)
                q[l] -=
                    (q[l] + N->w_amp[l] * sin(N->w_order[l] * q[l] + N->w_phase[l]) - ql[l]) /
                    (1 + N->w_amp[l] * N->w_order[l] * cos(N->w_order[l] * q[l] + N->w_phase[l]));
            slope[l] = 1 + N->w_amp[l] * N->w_order[l] * cos(N->w_order[l] * q[l] + N->w_phase[l]);
            if (side) qd[l] /= slope[l];
            else {
                ql[l] += N->w_amp[l] * sin(N->w_order[l] * q[l] + N->w_phase[l]);
                qdl[l] *= slope[l];
            }
        }
        ex[l] = exp(-h / N->lag[l]); mean[l] = N->lag[l] / h * (1 - ex[l]);
        if (two_mass && !N->gapped) { /* a load in a gap may be anywhere in it */
            double jm, jl;
            share_inertia(&M[l], M[l].inertia[0] + N->j_extra[l], N->j_extra[l], N->j_load[l], &jm,
                          &jl);
            double push = jl * M[l].a0 + M[l].bias[0] + N->gravity[l] * sin(M[l].q0);
            double bent = N->k_spring[l] > 0 ? push / N->k_spring[l] : 0.0;
            for (int i = 0; i < 20 && N->k_cubic[l] > 0;
                 i++) /* k x + k3 x^3 = push by Newton's method, which converges from above */
                bent -= (N->k_spring[l] * bent + N->k_cubic[l] * bent * bent * bent - push) /
                        (N->k_spring[l] + 3 * N->k_cubic[l] * bent * bent);
            if (side) q[l] += bent;
            else ql[l] -= bent;
        }
    }
    for (int k = 0; k < n; k++) {
        double *out = r + (size_t)k * LANES;
        EACH at[l] = filtered ? seen[l] : side ? ql[l] : q[l];
        OF(sense)(M, N, S, &at, &y);
        if (looped && M->kp > 0) { /* a closed loop: the innovations are the measured position */
            const double read =
                M->resolution > 0 ? M->resolution * floor(y[0] / M->resolution + 0.5) : y[0];
            out[0] = read;
            vloop += 0.2 * ((read - yloop) / M->T - vloop);
            yloop = read;
            M->uloop[k + 1] =
                M->uloop[k] + clip(M->kp * (M->ref[k] - read) - M->kd * vloop, N->limit[0]) * M->T;
        } else if (looped && M->reset > 0) {
            if (k % M->reset == 0) { /* a state of which the sensor would say what is recorded */
                OF(lane) rate, off;
                for (int i = 0; i < (N->senses ? 4 : 1); i++) {
                    EACH {
                        double dq = M->rq[k] + N->shift[l] - y[l];
                        q[l] += dq;
                        ql[l] += dq;
                        seen[l] += dq;
                    }
                    EACH at[l] = filtered ? seen[l] : side ? ql[l] : q[l];
                    if (N->senses) OF(sense)(M, N, S, &at, &y);
                }
                EACH rate[l] = M->rqd[k];
                if (N->senses) {
                    EACH off[l] = (filtered ? seen[l] : side ? ql[l] : q[l]) + 1e-5;
                    OF(sense)(M, N, S, &off, &e);
                    EACH rate[l] = M->rqd[k] * 1e-5 / (e[l] - y[l]);
                }
                if (filtered) { /* the joint is ahead of what is seen of it */
                    const int before = k > 0 ? k - 1 : k, after = k + 1 < n ? k + 1 : k;
                    const double grows =
                        (M->rqd[after] - M->rqd[before]) / ((after - before) * M->T);
                    EACH {
                        double dq = seen[l] + N->filter[l] * rate[l] - (side ? ql[l] : q[l]);
                        q[l] += dq; ql[l] += dq; rate[l] += N->filter[l] * grows;
                    }
                }
                EACH { double dv = rate[l] - (side ? qdl[l] : qd[l]); qd[l] += dv; qdl[l] += dv; }
                if (two_mass && M->rb) EACH {
                    if (side) { q[l] = ql[l] + M->rb[k]; qd[l] = qdl[l] + M->rbd[k]; }
                    else { ql[l] = q[l] + M->rb[k]; qdl[l] = qd[l] + M->rbd[k]; }
                }
            }
            EACH at[l] = filtered ? seen[l] : side ? ql[l] : q[l];
            OF(sense)(M, N, S, &at, &y);
            EACH out[l] = M->w[k] * (M->m[k] + N->shift[l] - y[l]);
        } else {
            const double w = M->w[k], half = M->half[k], k1 = M->k1[k], k2 = M->k2[k], m = M->m[k];
            EACH {
                e[l] = w > 0 ? soft(m + N->shift[l] - y[l], half) : 0.0;
                out[l] = w * e[l];
                /* in a gap, what pushes one side does not reach the other */
                double dq = k1 * e[l], dv = k2 * e[l],
                       apart = fabs(q[l] - ql[l]) < 0.5 * N->gap[l] ? 0.0 : 1.0;
                q[l] += dq; ql[l] += dq;
                qd[l] += side ? apart * dv : dv;
                qdl[l] += side ? dv : apart * dv;
            }
            if (filtered) EACH seen[l] += k1 * e[l];
        }
        const double near = looped && M->kp > 0 ? M->ref[k] : M->m[k];
        double lost = 0;
        _Pragma("omp simd reduction(+ : lost)") for (int l = 0; l < LANES; l++)
            lost += (fabs((side ? ql[l] : q[l]) - near) < 1e3) & (fabs(qd[l]) < 1e5) ? 0.0 : 1.0;
        if (lost > 0)
            for (int l = 0; l < LANES; l++)
                if (!gone[l] &&
                    (!(fabs((side ? ql[l] : q[l]) - near) < 1e3) || !(fabs(qd[l]) < 1e5))) {
                    gone[l] = 1 + k;
                    left--;
                }
        if (!left) {
            for (int l = 0; l < LANES; l++)
                for (int i = gone[l] - 1; i < n; i++) r[(size_t)i * LANES + l] = 1e9;
            return 1 + k;
        }
        const int shown = M->beyond ? !side : side; /* the load */
        if (xq) xq[k] = shown ? ql[0] : q[0];
        if (xqd) xqd[k] = shown ? qdl[0] : qd[0];
        if (k == n - 1) { if (torque) torque[k] = k ? torque[k - 1] : 0; break; }
        const double added = M->extra ? M->extra[k] : 0;
        OF(lane) jm, jl, per_jm, per_jl, bias;
        const int ahead = k % BLOCK;
        if (ahead == 0) /* written long before it is read: a lane at a time, read all at once */
            for (int l = 0; l < LANES; l++)
                for (int i = 0; i < BLOCK && k + i < n; i++) {
                    inertias[i][l] = M[l].inertia[k + i];
                    biases[i][l] = M[l].bias[k + i];
                }
        EACH { jm[l] = inertias[ahead][l] + N->j_extra[l]; bias[l] = biases[ahead][l]; }
        if (geared) EACH load[l] = jm[l] - N->j_extra[l];
        if (two_mass && M->bias_slope) /* the load is not where the motor was measured */
            for (int l = 0; l < LANES; l++)
                bias[l] += M[l].bias_slope[k] * (ql[l] - M[l].rq[k] - M[l].shift);
        if (two_mass)
            for (int l = 0; l < LANES; l++) {
                double motor, beyond;
                share_inertia(&M[l], jm[l], N->j_extra[l], N->j_load[l], &motor, &beyond);
                jm[l] = motor; jl[l] = beyond;
                per_jl[l] = 1.0 / beyond;
            }
        EACH { per_jm[l] = 1.0 / jm[l]; usum[l] = 0; }
        /* the command is held over the sample */
        const int steady = !hidden || (!N->lag_on && !N->late);
        if (!steady) EACH past[l] = cum(M, k * M->T - N->delay[l], per_T);
        if (steady) {
            const double held = (M->ucum[k + 1] - M->ucum[k]) / M->T, now = M->t0 + (k + 0.5) * M->T;
            EACH { u[l] = held; S->t[l] = now; }
            OF(act)(M, N, S, &u, &tau);
        }
        for (int i = 0; i < sub; i++) {
            /* record time for the command, absolute time for effects */
            const double tl = k * M->T + i * h;
            EACH S->t[l] = M->t0 + tl + 0.5 * h;
            if (!steady) {
                EACH {
                    const double next = cum(M, tl + h - N->delay[l], per_T);
                    u[l] = (next - past[l]) * per_h;
                    past[l] = next;
                }
                if (hidden && N->lag_on)
                    EACH {
                        double before = k == 0 && i == 0 ? u[l] : a[l], held = u[l];
                        u[l] = held + (before - held) * mean[l];
                        a[l] = held + (before - held) * ex[l];
                    }
                OF(act)(M, N, S, &u, &tau);
            }
            OF(lane) push, vfree, spring, free, vn;
            if (filtered) EACH from[l] = side ? ql[l] : q[l];
            EACH {
                S->u[l] = u[l]; S->tau[l] = tau[l];
                S->q[l] = q[l] + 0.5 * h * qd[l];
                S->qd[l] = qd[l];
                push[l] = tau[l] - added - (two_mass ? 0.0 : bias[l]);
                spring[l] = 0;
            }
            if (wavy) /* the load turns by slope for each turn of the motor */
                EACH {
                    double at = N->w_order[l] * S->q[l] + N->w_phase[l];
                    slope[l] = 1 + N->w_amp[l] * N->w_order[l] * cosine(at);
                    wave[l] =
                        N->w_amp[l] * sin(two_mass ? N->w_order[l] * q[l] + N->w_phase[l] : at);
                    bend[l] = -N->w_amp[l] * N->w_order[l] * N->w_order[l] * sin(at) * slope[l] *
                              load[l]; /* times the speed squared */
                }
            if (geared)
                EACH {
                    jm[l] = load[l] * slope[l] * slope[l] + N->j_extra[l]; per_jm[l] = 1.0 / jm[l];
                    push[l] = tau[l] - added - slope[l] * bias[l];
                }
            if (geared && N->pulled)
                EACH push[l] = tau[l] - added -
                               slope[l] * (bias[l] + N->gravity[l] * sin(S->q[l] + wave[l]));
            if (two_mass) {
                OF(lane) fall;
                EACH fall[l] = bias[l];
                if (N->pulled) EACH fall[l] += N->gravity[l] * sin(ql[l] + 0.5 * h * qdl[l]);
                EACH {
                    double dv = (wavy ? slope[l] * qd[l] : qd[l]) - qdl[l],
                           d = q[l] - ql[l] + (wavy ? wave[l] : 0.0), gap = N->gap[l],
                           moved = h * dv;
                    double e0 = soft(d, 0.5 * gap), e1 = soft(d + moved, 0.5 * gap),
                           g = 0.5 * (e0 + e1); /* mean deflection */
                    int moves = fabs(moved) > 1e-12 * gap;
                    double per = 1.0 / (moves ? moved : 1.0),
                           on = moves       ? (e1 - e0) * per
                                : e0 != 0.0 ? 1.0
                                            : 0.0; /* share of the step in contact */
                    on = gap > 0 ? on : 1.0;
                    g = (on < 1.0) & (on > 0.0) & (gap > 0) ? 0.5 * (e1 * e1 - e0 * e0) * per : g;
                    double c = N->c_spring[l] * on,
                           pull = (wavy ? N->k_spring[l] + N->k_cubic[l] * g * g : N->k_spring[l]) *
                                      g +
                                  c * dv;
                    /* damped by the mean speed of the step */
                    pull /= 1.0 + 0.5 * h * c * (per_jm[l] + per_jl[l]);
                    spring[l] = (gap > 0) & (pull * g < 0) ? 0.0 : pull; /* a contact pushes only */
                    double vl = qdl[l] + h * (spring[l] - fall[l]) * per_jl[l];
                    ql[l] += 0.5 * h * (qdl[l] + vl);
                    qdl[l] = vl;
                }
            } else if (N->pulled && !geared)
                EACH push[l] -= N->gravity[l] * sin(S->q[l]);
            EACH push[l] -= wavy ? slope[l] * spring[l] : spring[l];
            OF(gather)(M, N, S, k, 0, &f, &scale);
            if (geared) EACH f[l] += bend[l] * S->qd[l] * S->qd[l];
            EACH S->qd[l] = qd[l] + 0.5 * h * (push[l] - f[l] - rub[l]) * per_jm[l];
            if (drives) EACH S->tau[l] = tau[l];
            OF(gather)(M, N, S, k, 0, &f, &scale);
            if (geared) EACH f[l] += bend[l] * S->qd[l] * S->qd[l];
            EACH free[l] = push[l] - f[l];
            if (hidden && N->bent) /* Bouc-Wen, |z| <= 1 */
                EACH {
                    double az = pow(fabs(zh[l]), N->bw_n[l]), v = S->qd[l];
                    double zn = zh[l] + h * N->bw_a[l] *
                                            (v - 0.5 * fabs(v) * az * sgn(zh[l]) - 0.5 * v * az);
                    zn = zn > 1 ? 1 : zn < -1 ? -1 : zn;
                    free[l] -= N->bw_force[l] * 0.5 * (zh[l] + zn);
                    zh[l] = zn;
                }
            EACH vfree[l] = qd[l] + h * free[l] * per_jm[l];
            OF(dry)(M, N, S, &vfree, &scale, &level);
            EACH {
                level[l] = level[l] > 0 ? level[l] : 0.0;
                vn[l] = soft(vfree[l], h * level[l] * per_jm[l]);
            }
            if (hidden && N->creeps) /* v + most tanh(v / slow) = vfree: Newton, from below */
                EACH {
                    double most = h * level[l] * per_jm[l], slow = N->creep[l];
                    int on = (slow > 0) & (most > 0);
                    slow = on ? slow : 1.0;
                    double v = fabs(vfree[l]) < most + slow ? vfree[l] * slow / (most + slow)
                                                            : vn[l];
                    for (int turn = 0; turn < CREEP_STEPS; turn++) {
                        double sign = tanh(v / slow);
                        v -= (v + most * sign - vfree[l]) / (1 + most / slow * (1 - sign * sign));
                    }
                    vn[l] = on ? v : vn[l];
                }
            if (hidden &&
                N->bristled) /* bristle: z' = qd - s0 |qd| z / level, implicit in z and qd */
                EACH {
                    int on = (N->s0[l] > 0) & (level[l] > 0);
                    double D = 1 + h * N->s0[l] * fabs(S->qd[l]) / (on ? level[l] : 1.0),
                           st = N->s0[l] + N->s1[l] * per_h, w = h * per_jm[l];
                    double v = (vfree[l] + w * (N->s1[l] * per_h * z[l] - st * z[l] / D)) /
                               (1 + w * st * h / D);
                    vn[l] = on ? v : vn[l];
                    z[l] = on ? (z[l] + h * v) / D : z[l];
                }
            EACH {
                rub[l] = (vfree[l] - vn[l]) * jm[l] * per_h;
                q[l] += 0.5 * h * (qd[l] + vn[l]);
                qd[l] = vn[l];
                usum[l] += S->tau[l];
            }
            if (!two_mass) EACH { ql[l] = q[l]; qdl[l] = qd[l]; }
            if (geared && (side || M->beyond)) /* or else nobody looks at it */
                EACH {
                    ql[l] += N->w_amp[l] * sin(N->w_order[l] * q[l] + N->w_phase[l]);
                    qdl[l] *= slope[l];
                }
            if (filtered) /* exact for a position that moves evenly within the step */
                EACH {
                    double to = side ? ql[l] : q[l], lag = (to - from[l]) * per_h * N->filter[l];
                    seen[l] = to - lag + (seen[l] - from[l] + lag) * fade[l];
                }
        }
        if (torque) torque[k] = usum[0] / sub;
    }
    for (int l = 0; l < LANES; l++)
        if (gone[l])
            for (int i = gone[l] - 1; i < n; i++) r[(size_t)i * LANES + l] = 1e9;
    return 0;
}

/* predict for models of one sort; each a function of its own, which the compiler sees through
 * sooner */
#define SORT(sort, two_mass, hidden, wavy, filtered, drives, looped)                              \
    static __attribute__((noinline)) int OF(sort)(const zk_model *M, OF(numbers) * N, double *r,  \
                                                  double *xq, double *xqd, double *torque) {      \
        return OF(predict)(M, N, r, xq, xqd, torque, two_mass, hidden, wavy, filtered, drives,    \
                           looped);                                                               \
    }
SORT(plain, 0, 0, 0, 0, 0, 0)
SORT(hidden, 0, 1, 0, 0, 0, 0)
SORT(geared, 0, N->hidden, 1, 0, 0, 0)
SORT(sprung, 1, N->hidden, 0, 0, 0, 0)
SORT(any, N->two_mass, 1, N->wavy, N->filtered, N->drives, LANES == 1)
#undef SORT

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
