/* A machine as its model file describes it, forward in time: coupled rigid bodies and every effect
 * of the library. Before it go tree.h, state.h, solve.h, effects.h and step.h.
 *
 * Units: rad or m, s, N m or N. Joints from 0.
 */

/* A machine at rest at its start. room: samples to come. NULL: out of memory. */
sim *sim_new(const sim_config *c, int room) {
    sim *S = calloc(1, sizeof *S);
    double *ucum = calloc((size_t)(room + 1) * (size_t)c->joints, sizeof *ucum);
    if (!S || !ucum) {
        free(S);
        free(ucum);
        return 0;
    }
    S->c = *c;
    S->ucum = ucum;
    S->room = room;
    S->dof = c->joints;
    for (int i = 0; i < c->effects; i++)
        for (int k = c->effect_joint[i]; k < c->joints; k++)
            S->first[k + 1]++;
    double M[SIM_MAX * SIM_MAX];
    tree_pose pose;
    inertia(S, c->q0, &pose, M);
    for (int i = 0; i < c->joints; i++) {
        setup_joint(S, i);
        S->x[i] = c->q0[i];
        S->v[i] = c->qd0[i];
        sim_joint *j = &S->j[i];
        /* the motor has what the load has not, of the inertia that is the same at every pose, as in
         * kernel.c */
        if (j->two_mass) {
            const double all = j->j_links > 0             ? j->j_links
                               : c->kind == SIM_PLANAR2R ? (i == 0 ? c->p1 : c->p2)
                                                         : M[i * c->joints + i],
                         least = 0.02 * (all + j->j_extra) - j->j_extra;
            if (j->j_load <=
                0) /* nobody says how much of the inertia is the load, nor what damps it */
                j->j_load = 0.5 * all;
            if (j->c_spring < 0)
                j->c_spring = 0.1 * sqrt(j->k_spring * j->j_load);
            j->j_motor = all - j->j_load > least ? all - j->j_load : least;
            j->motor = S->dof++;
            S->x[j->motor] = c->q0[i];
            S->v[j->motor] = c->qd0[i];
            double slope, unused;
            S->x[i] = through(j, c->q0[i], &slope, &unused);
            S->v[i] = slope * c->qd0[i];
        }
        S->uneven |= j->w_amp != 0 && j->motor == i;
        S->filtered |= j->filter > 0;
        double speed;
        const double at = side(S, i, &speed);
        j->seen = at - j->filter * speed; /* as if it had always moved so */
    }
    for (int i = 0; i < c->effects; i++) {
        const double *p = c->effect_p + i * SIM_P;
        const int joint = c->effect_joint[i];
        switch (c->effect[i]) {
/* EFFECT_CASES_ACROSS */
        default: break;
        }
        (void)p, (void)joint;
    }
    return S;
}

void sim_free(sim *S) {
    if (S)
        free(S->ucum);
    free(S);
}

/* True motion of the side that the sensor sees, and the torque of the last sample. */
void sim_truth(const sim *S, double *q, double *qd, double *torque) {
    for (int i = 0; i < S->c.joints; i++) {
        q[i] = side(S, i, &qd[i]);
        torque[i] = S->torque[i];
    }
}

/* By how many seconds the recorded command of a joint is late. */
double sim_column_late(const sim *S, int joint) { return S->j[joint].column_late; }

/* What the sensors say: measured (own coordinates, quantised), counts (0 where continuous). */
void sim_measure(const sim *S, double *measured, int32_t *counts) {
    const int n = S->c.joints;
    double joint[SIM_MAX], unused;
    for (int i = 0; i < n; i++)
        joint[i] = sense(S, i, S->j[i].filter > 0 ? S->j[i].seen : side(S, i, &unused)) -
                   S->c.sensor_offset[i];
    for (int i = 0; i < n; i++) {
        double m = 0;
        for (int k = 0; k < n; k++)
            m += S->c.sensor_matrix[i * n + k] * joint[k];
        const double step = S->c.resolution[i];
        counts[i] = step > 0 ? (int32_t)floor(m / step + 0.5) : 0;
        measured[i] = step > 0 ? counts[i] * step : m;
    }
}

/* One sample with a command (own unit and coordinates). Returns 0, or 1 where the motion ran away.
 */
int sim_advance(sim *S, const double *command) {
    const int n = S->c.joints, k = S->ticks;
    if (k >= S->room)
        return 2;
    if (k % S->c.hold == 0)
        for (int i = 0; i < n; i++) {
            double u = 0;
            for (int l = 0; l < n; l++)
                u += S->c.command_matrix[i * n + l] * command[l];
            S->held[i] = u;
        }
    for (int i = 0; i < n; i++) {
        S->ucum[(size_t)(k + 1) * n + i] = S->ucum[(size_t)k * n + i] + S->held[i] * S->c.period;
        S->torque[i] = 0;
    }
    S->ticks++;
    const double h = S->c.period / S->c.inner;
    for (int i = 0; i < S->c.inner; i++)
        inner_step(S, k * S->c.period + i * h, h);
    for (int i = 0; i < n; i++)
        if (S->j[i].keep > 0) {
            double unused;
            S->j[i].seen += (1 - S->j[i].keep) * (side(S, i, &unused) - S->j[i].seen);
        }
    for (int i = 0; i < n; i++)
        S->torque[i] /= S->c.inner;
    for (int i = 0; i < S->dof; i++)
        if (!(fabs(S->x[i]) < 1e5 && fabs(S->v[i]) < 1e7))
            return 1;
    return 0;
}

/* Closed loop: command = ff + kp (r - y) - kd rate + ki sum, rate the filtered difference of what
 * the sensor says (cutoff in Hz, 0: unfiltered), limited at `most` where that is above 0. Rows of
 * n. Returns the rows completed. */
int sim_loop(sim *S, int rows, const double *r, const double *ff, const double *kp,
             const double *kd, const double *ki, double cutoff, const double *most,
             double *measured, double *command, double *q, double *qd, double *torque) {
    const int n = S->c.joints;
    const double T = S->c.period, mix = cutoff > 0 ? 1 - exp(-6.283185307179586 * cutoff * T) : 1;
    double rate[SIM_MAX] = {0}, last[SIM_MAX] = {0}, sum[SIM_MAX] = {0};
    int32_t counts[SIM_MAX];
    for (int k = 0; k < rows; k++) {
        const size_t at = (size_t)k * n;
        double *y = measured + at, *u = command + at;
        sim_measure(S, y, counts);
        double unused[SIM_MAX];
        sim_truth(S, q + at, qd + at, unused);
        for (int i = 0; i < n; i++) {
            if (k)
                rate[i] += mix * ((y[i] - last[i]) / T - rate[i]);
            last[i] = y[i];
            sum[i] += ki[i] * T * (r[at + i] - y[i]);
            u[i] = ff[at + i] + kp[i] * (r[at + i] - y[i]) - kd[i] * rate[i] + sum[i];
            if (most[i] > 0)
                u[i] = u[i] > most[i] ? most[i] : u[i] < -most[i] ? -most[i] : u[i];
        }
        const int bad = sim_advance(S, u);
        memcpy(torque + at, S->torque, sizeof(double) * (size_t)n);
        if (bad)
            return k + 1;
    }
    return rows;
}
