/* One step of the machine in time.
 *
 * Scheme: implicit midpoint in two stages. Position halfway is q + h/2 v; a half step from there
 * gives the speed halfway, at which all forces are taken for the full step. Linear damping, springs
 * in the transmission and bristles are implicit (stable at any step). Dry friction is set-valued
 * and coupled through M(q): the speed at the end solves A v + h λ = b, λ in friction's interval,
 * exactly (a joint that friction can hold does not move). Second order in h away from impacts.
 */

/* What a transmission makes of a motor's position x; slope: of the load's speed to the motor's,
 * bend: what that changes by with x. */
static double through(const sim_joint *j, double x, double *slope, double *bend) {
    if (j->w_amp == 0)
        return *slope = 1, *bend = 0, x;
    const double at = j->w_order * x + j->w_phase;
    *slope = 1 + j->w_amp * j->w_order * cos(at);
    *bend = -j->w_amp * j->w_order * j->w_order * sin(at);
    return x + j->w_amp * sin(at);
}

/* Position and speed of a joint on the side that its sensor sees. */
static double side(const sim *S, int joint, double *speed) {
    const sim_joint *j = &S->j[joint];
    const int at = S->c.load_sensor ? joint : j->motor;
    double slope = 1, bend, x = S->x[at];
    if (S->c.load_sensor && j->motor == joint)
        x = through(j, x, &slope, &bend);
    *speed = slope * S->v[at];
    return x;
}

/* Positions y of the links where the joints' coordinates are x: motors' where a transmission is
 * rigid. */
static void links(const sim *S, const double *x, double *y, double *slope, double *bend) {
    for (int i = 0; i < S->c.joints; i++) {
        y[i] = x[i], slope[i] = 1, bend[i] = 0;
        if (S->j[i].w_amp != 0 && S->j[i].motor == i)
            y[i] = through(&S->j[i], x[i], &slope[i], &bend[i]);
    }
}

/* Rigid-body inertia M (n x n) of the joints at x. */
static void inertia(const sim *S, const double *x, tree_pose *pose, double *M) {
    const int n = S->c.joints;
    if (S->c.kind == SIM_TREE) {
        tree_place(n, S->c.tree, x, pose);
        tree_mass(n, S->c.tree, pose, M);
    } else if (S->c.kind == SIM_PLANAR2R) {
        const double c = S->c.p3 * cos(x[1] + S->c.p3_angle);
        M[0] = S->c.p1 + 2 * c;
        M[1] = M[2] = S->c.p2 + c;
        M[3] = S->c.p2;
    } else {
        for (int i = 0; i < n * n; i++)
            M[i] = i % (n + 1) == 0 ? S->c.inertia[i / (n + 1)] : 0.0;
    }
}

/* Coriolis, centrifugal and gravity torque. */
static void bias(const sim *S, const double *x, const double *v, const tree_pose *pose,
                 double *out) {
    if (S->c.kind == SIM_TREE)
        tree_torque(S->c.joints, S->c.tree, pose, S->c.gravity, v, 0, out);
    else if (S->c.kind == SIM_PLANAR2R) {
        const double s = S->c.p3 * sin(x[1] + S->c.p3_angle);
        out[0] = -s * v[1] * (2 * v[0] + v[1]);
        out[1] = s * v[0] * v[0];
    } else
        for (int i = 0; i < S->c.joints; i++)
            out[i] = S->c.weight[i] != 0 ? S->c.weight[i] * sin(x[i]) : 0.0;
}

/* Friction's impulse over H, give v_next + from, where it grows with the speed ahead, and that of
 * the step is taken so that one that falls exponentially is exact. */
static void give_way(const sim_joint *j, double H, double mass, double level, double v,
                     double *give, double *from) {
    const double slope = level / j->creep;
    double phi, psi;
    decay(H * slope / (mass + slope * j->creep_lead), &phi, &psi);
    *give = slope * (H * psi / phi + j->creep_lead);
    *from = slope * (H * (1 - psi / phi) - j->creep_lead) * v;
}

/* Speeds after H seconds from speeds v, forces at (xm, ve). M: the links' inertia at xm. keep: also
 * advance bristles and hysteresis. */
static void stage(sim *S, double H, double t, const double *M, const tree_pose *pose,
                  const double *xm, const double *v, const double *ve, double *out, int keep) {
    const int n = S->c.joints, N = S->dof;
    double A[SIM_DOF * SIM_DOF], b[SIM_DOF], up[SIM_DOF], down[SIM_DOF], g[SIM_MAX];
    double give[SIM_DOF], from[SIM_DOF], E[SIM_MAX], phi[SIM_MAX], zh[SIM_MAX], y[SIM_MAX],
        yd[SIM_MAX], slope[SIM_MAX], bend[SIM_MAX];
    if (S->uneven) {
        links(S, xm, y, slope, bend);
        for (int i = 0; i < n; i++)
            yd[i] = slope[i] * ve[i];
        bias(S, y, yd, pose, g);
        /* in the joints' coordinates, with what an uneven turn accelerates */
        for (int i = 0; i < n; i++) {
            for (int k = 0; k < n; k++)
                g[i] += M[i * n + k] * bend[k] * ve[k] * ve[k];
            g[i] *= slope[i];
        }
    } else
        bias(S, xm, ve, pose, g);
    for (int i = 0; i < N; i++) {
        up[i] = down[i] = give[i] = from[i] = 0;
        for (int k = 0; k < N; k++)
            A[i * N + k] = 0;
    }
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < n; k++)
            A[i * N + k] = (S->uneven ? slope[i] * slope[k] : 1) * M[i * n + k] + S->across[i][k];
        const sim_joint *j = &S->j[i];
        if (j->motor != i) {
            A[i * N + i] -= j->j_motor;
            A[j->motor * N + j->motor] = j->j_motor;
        }
        A[j->motor * N + j->motor] += j->j_extra;
    }
    for (int i = 0; i < N; i++) {
        b[i] = i < n ? -H * g[i] : 0;
        for (int k = 0; k < N; k++)
            b[i] += A[i * N + k] * v[k];
    }
    for (int i = 0; i < n; i++) {
        const sim_joint *j = &S->j[i];
        const int m = j->motor;
        zs s = {.q = xm[m],
                .qd = ve[m],
                .t = t,
                .u = j->u,
                .tau = j->tau,
                .load = j->load,
                .lag_t = H,
                .temp = warmth(S)};
        sim_force f;
        gather(S, i, xm, ve, s, &f);
        /* damp: implicit, taken at the mean of old and new speed */
        double damp = f.visc, push = j->tau - f.smooth;
        if (keep)
            S->torque[i] += f.tau;
        if (j->bw_force > 0) {
            double mean;
            zh[i] = hysteresis(j, j->hyst, ve[m], H, &mean);
            push -= j->bw_force * mean;
        }
        const double level = ve[m] > 0 || (ve[m] == 0 && j->z > 0) ? f.dry_pos : f.dry_neg;
        if (j->s0 > 0 && level > 0) {
            double psi;
            const double x = H * j->s0 * fabs(ve[m]) / level;
            decay(x, &phi[i], &psi);
            E[i] = exp(-x);
            push -= j->s0 * j->z * phi[i] + j->s1 * j->z * (E[i] - 1) / H;
            damp += j->s0 * H * psi + j->s1 * phi[i];
        } else if (j->creep > 0 && j->straight) {
            give_way(j, H, A[m * N + m], level, v[m], &give[m], &from[m]);
            up[m] = H * f.dry_pos;
            down[m] = H * f.dry_neg;
            E[i] = phi[i] = 0;
        } else if (j->creep > 0) {
            damp += ve[m] != 0 ? level * tanh(ve[m] / j->creep) / ve[m] : level / j->creep;
            E[i] = phi[i] = 0;
        } else {
            up[m] = H * f.dry_pos;
            down[m] = H * f.dry_neg;
            E[i] = phi[i] = 0;
        }
        A[m * N + m] += 0.5 * H * damp;
        b[m] += H * (push - 0.5 * damp * v[m]);
        b[i] -= H * f.load;
        if (m != i) { /* spring between motor and load, contact judged halfway */
            up[i] = down[i] = H * j->dry_load;
            double turn, unused;
            const double twist = through(j, S->x[m], &turn, &unused) - S->x[i];
            through(j, xm[m], &turn, &unused);
            const double rate = turn * v[m] - v[i];
            const double open = soft(twist + 0.5 * H * rate, 0.5 * j->gap);
            /* a contact pushes only */
            if (j->gap <= 0 || open * (j->k_spring * open + j->c_spring * rate) > 0) {
                /* measured from the edge of the gap */
                const double rest = twist - (twist + 0.5 * H * rate - open);
                const double hard = j->k_cubic * rest * rest,
                             c = 0.5 * H * (j->k_spring + 3 * hard) + j->c_spring;
                const double pull = (j->k_spring + hard) * rest + 0.5 * c * rate;
                A[m * N + m] += 0.5 * H * c * turn * turn;
                A[i * N + i] += 0.5 * H * c;
                A[m * N + i] -= 0.5 * H * c * turn;
                A[i * N + m] -= 0.5 * H * c * turn;
                b[m] -= H * pull * turn;
                b[i] += H * pull;
            }
        }
    }
    memcpy(out, v, sizeof(double) * (size_t)N);
    solve(N, A, b, up, down, give, from, out);
    if (!keep)
        return;
    for (int i = 0; i < n; i++) {
        sim_joint *j = &S->j[i];
        const double mean = 0.5 * (v[j->motor] + out[j->motor]);
        j->load = g[i];
        for (int k = 0; k < n; k++)
            j->load += M[i * n + k] * (out[k] - v[k]) / H;
        if (j->bw_force > 0)
            j->hyst = zh[i];
        if (j->s0 > 0)
            j->z = j->z * E[i] + phi[i] * H * mean;
    }
}

/* Integral of the held command of a joint up to time t since the first sample; no command before
 * it. */
static double cum(const sim *S, int joint, double t) {
    const double x = t / S->c.period;
    if (x <= 0)
        return 0;
    int i = (int)x;
    if (i >= S->ticks)
        i = S->ticks - 1;
    const double *u = S->ucum + (size_t)i * S->c.joints + joint;
    return u[0] + (x - i) * (u[S->c.joints] - u[0]);
}

static void inner_step(sim *S, double tl, double h) {
    const int n = S->c.joints;
    for (int i = 0; i < n; i++) {
        sim_joint *j = &S->j[i];
        double u = j->delay == 0 ? S->held[i]
                                 : (cum(S, i, tl + h - j->delay) - cum(S, i, tl - j->delay)) / h;
        j->u = u;
        double tau = act(S, i, u, tl + 0.5 * h);
        if (j->lag_on) { /* a current loop or a winding: it is asked for what the drive gives */
            const double ex = exp(-h / j->lag), asked = tau;
            tau = asked + (j->a - asked) * (j->lag / h) * (1 - ex);
            j->a = asked + (j->a - asked) * ex;
        }
        j->tau = tau;
    }
    double M[SIM_MAX * SIM_MAX], xm[SIM_DOF], vm[SIM_DOF], vn[SIM_DOF], y[SIM_MAX], slope[SIM_MAX],
        bend[SIM_MAX], from[SIM_MAX], unused;
    tree_pose pose;
    for (int i = 0; i < S->dof; i++)
        xm[i] = S->x[i] + 0.5 * h * S->v[i];
    if (S->uneven)
        links(S, xm, y, slope, bend);
    inertia(S, S->uneven ? y : xm, &pose, M);
    for (int i = 0; i < n && S->filtered; i++)
        from[i] = side(S, i, &unused);
    const double t = tl + 0.5 * h;
    stage(S, 0.5 * h, t, M, &pose, xm, S->v, S->v, vm, 0);
    stage(S, h, t, M, &pose, xm, S->v, vm, vn, 1);
    for (int i = 0; i < S->dof; i++) {
        S->x[i] += 0.5 * h * (S->v[i] + vn[i]);
        S->v[i] = vn[i];
    }
    /* filtered sensors, exactly for a position that moves evenly within the step */
    for (int i = 0; i < n && S->filtered; i++) {
        sim_joint *j = &S->j[i];
        if (j->filter <= 0 || j->keep > 0)
            continue;
        const double to = side(S, i, &unused), lag = (to - from[i]) / h * j->filter;
        j->seen = to - lag + (j->seen - from[i] + lag) * exp(-h / j->filter);
    }
}

