/* Time stepping: drift - kick - drift with set-valued friction (Moreau). A joint whose friction can
   hold it has velocity exactly zero after the kick; no slope at zero, no threshold. Forces are
   taken at the middle of the step, so the smooth part is of second order. The controller, the
   sensor and the actuator's hold run at the sample time around it. */

typedef struct {
    const Machine *m;
    int free;              /* coordinates: n links, then one motor per compliant joint */
    int motor[7];          /* coordinate that carries joint i's motor: i itself where rigid */
    double x[14], w[14];   /* positions, velocities */
    Hidden hidden[7];
    double t;
} State;

static int compliant(const Joint *j) { return j->trans_stiffness > 0.0; }

/* mass matrix and smooth force of all coordinates at positions x and velocities w */
static void forces(const State *s, const double *x, const double *w, const Hidden *hidden,
                   const double *torque, const double *outside, double t, double A[14][14],
                   double *f) {
    const Machine *m = s->m;
    double M[7][7], bias[7];
    mechanism(m, x, w, M, bias);
    for (int i = 0; i < s->free; i++)
        for (int k = 0; k < s->free; k++) A[i][k] = i < m->n && k < m->n ? M[i][k] : 0.0;
    for (int i = 0; i < m->n; i++) {
        const Joint *j = &m->joint[i];
        int c = s->motor[i];
        f[i] = -bias[i] - resist_load(j, x[i], w[i]) - outside[i];
        double drive = torque[i] - resist_motor(j, &hidden[i], x[c], w[c], torque[i], t);
        if (c == i) {
            f[i] += drive;
        } else {
            double through = transmission(j, x[c] - x[i], w[c] - w[i]);
            A[c][c] = j->motor_inertia;
            f[c] = drive - through;
            f[i] += through;
        }
    }
    for (int k = 0; k < m->couplings; k++) {
        const Coupling *c = &m->coupling[k];
        double v = w[c->from];
        if (c->law == 1) f[c->to] -= c->coefficient * v * v;
        if (c->law == 2) f[c->to] -= c->coefficient * v;
        if (c->law == 3) f[c->to] -= c->coefficient * tanh((v + w[c->to]) / 1e-3);
    }
}

/* A y = b for symmetric positive A, with B = A^-1 as well where friction needs it */
static void invert(int n, double A[14][14], double B[14][14]) {
    if (n == 1) {
        B[0][0] = 1.0 / A[0][0];
        return;
    }
    double L[14][14];
    for (int i = 0; i < n; i++)
        for (int k = 0; k <= i; k++) {
            double sum = A[i][k];
            for (int r = 0; r < k; r++) sum -= L[i][r] * L[k][r];
            L[i][k] = i == k ? sqrt(sum) : sum / L[k][k];
        }
    for (int c = 0; c < n; c++) {
        double y[14];
        for (int i = 0; i < n; i++) {
            double sum = i == c;
            for (int r = c; r < i; r++) sum -= L[i][r] * y[r];
            y[i] = i < c ? 0.0 : sum / L[i][i];
        }
        for (int i = n - 1; i >= 0; i--) {
            double sum = y[i];
            for (int r = i + 1; r < n; r++) sum -= L[r][i] * B[r][c];
            B[i][c] = sum / L[i][i];
        }
    }
}

/* w = w0 + h A^-1 f, then the friction impulse that opposes it within its bounds (projected
 * Gauss-Seidel) */
static void kick(const State *s, double h, double A[14][14], const double *f, const double *x,
                 const double *seen, const double *torque, double t, double *w) {
    double B[14][14], high[14], low[14], impulse[14] = {0};
    int n = s->free, rough = 0;
    invert(n, A, B);
    for (int i = 0; i < n; i++) {
        double sum = 0.0;
        for (int k = 0; k < n; k++) sum += B[i][k] * f[k];
        w[i] = s->w[i] + h * sum;
        high[i] = low[i] = 0.0;
    }
    for (int i = 0; i < s->m->n; i++) {
        const Joint *j = &s->m->joint[i];
        int c = s->motor[i];
        if (j->bristle_stiffness != 0.0) continue;
        low[c] = -h * friction_level(j, x[c], seen[c], torque[i], t, 1);
        high[c] = h * friction_level(j, x[c], seen[c], torque[i], t, -1);
        rough |= high[c] > 0 || low[c] < 0;
    }
    for (int sweep = 0; rough && sweep < (n == 1 ? 1 : 60); sweep++) {
        double moved = 0.0;
        for (int i = 0; i < n; i++) {
            if (high[i] == 0.0 && low[i] == 0.0) continue;
            double wish = impulse[i] - w[i] / B[i][i];
            wish = fmax(low[i], fmin(high[i], wish));
            double change = wish - impulse[i];
            if (change == 0.0) continue;
            for (int k = 0; k < n; k++) w[k] += B[k][i] * change;
            impulse[i] = wish;
            moved = fmax(moved, fabs(change) / (high[i] - low[i]));
        }
        if (moved < 1e-12) break;
    }
    for (int i = 0; rough && i < n;
         i++) /* held: the friction needed is within its bounds, what moves is rounding */
        if (impulse[i] > low[i] && impulse[i] < high[i]) w[i] = 0.0;
}

static void step(State *s, double h, const double *torque, const double *outside) {
    double x[14], w[14], mid[14], A[14][14], f[14], tm = s->t + 0.5 * h;
    Hidden hidden[7];
    const Machine *m = s->m;
    for (int i = 0; i < s->free; i++) x[i] = s->x[i] + 0.5 * h * s->w[i];
    forces(s, x, s->w, s->hidden, torque, outside, tm, A, f);
    kick(s, h, A, f, x, s->w, torque, tm, w);
    for (int i = 0; i < s->free; i++) mid[i] = 0.5 * (s->w[i] + w[i]);
    for (int i = 0; i < m->n; i++)
        hidden[i] = advance(&m->joint[i], s->hidden[i], x[s->motor[i]], mid[s->motor[i]], torque[i],
                            0.5 * h);
    forces(s, x, mid, hidden, torque, outside, tm, A, f);
    kick(s, h, A, f, x, mid, torque, tm, w);
    for (int i = 0; i < s->free; i++) {
        mid[i] = 0.5 * (s->w[i] + w[i]);
        s->w[i] = w[i];
        s->x[i] = x[i] + 0.5 * h * w[i];
    }
    for (int i = 0; i < m->n; i++)
        s->hidden[i] =
            advance(&m->joint[i], s->hidden[i], x[s->motor[i]], mid[s->motor[i]], torque[i], h);
    s->t += h;
}

static double sense(const Joint *j, double q, double noise) {
    double y = q + noise;
    if (j->eccentricity != 0.0) y += j->eccentricity * sin(q + j->eccentricity_phase);
    if (j->resolution <= 0.0) return y;
    y /= j->resolution;
    return j->resolution * (j->floor_counts != 0.0 ? floor(y) : rint(y));
}

/* torque of joint i averaged over [t, t+h]: the delayed hold changes value inside the step at most
 * once */
static double held(const Machine *m, const double *command, int i, double t, double h) {
    const Joint *j = &m->joint[i];
    double a = (t - j->delay) / m->sample_time, b = a + h / m->sample_time;
    double ka = floor(a + 1e-9), kb = floor(b - 1e-9);
    double first = ka < 0 ? 0.0 : actuator(j, command[(int)ka * m->n + i]);
    if (kb <= ka) return first;
    double second = kb < 0 ? 0.0 : actuator(j, command[(int)kb * m->n + i]);
    double share = (b - kb) / (b - a);
    return (1 - share) * first + share * second;
}

static double mechanical_energy(const State *s) {
    double M[7][7], bias[7], e = 0.0;
    const Machine *m = s->m;
    mechanism(m, s->x, s->w, M, bias);
    for (int i = 0; i < m->n; i++) {
        const Joint *j = &m->joint[i];
        for (int k = 0; k < m->n; k++) e += 0.5 * s->w[i] * M[i][k] * s->w[k];
        e += 0.5 * j->stiffness * pow(s->x[i] - j->neutral, 2) +
             0.25 * j->cubic * pow(s->x[i] - j->cubic_neutral, 4);
        e -= j->gravity * cos(s->x[i] - j->gravity_angle);
        int c = s->motor[i];
        if (c == i) continue;
        double twist = s->x[c] - s->x[i], out = fmax(0.0, fabs(twist) - 0.5 * j->trans_gap);
        e += 0.5 * j->motor_inertia * s->w[c] * s->w[c] + 0.5 * j->trans_stiffness * out * out;
    }
    if (m->kind == 0) e -= m->p[1] * cos(s->x[0]);
    return e;
}

int simulate(const Machine *m, int rows, const double *reference, const double *feedforward,
             const double *torque, const double *noise, double *measured, double *command,
             double *q, double *v, double *energy) {
    State s = {.m = m, .free = m->n};
    int n = m->n;
    double last[7], rate[7] = {0}, sum[7] = {0}, h = m->sample_time / m->substeps;
    for (int i = 0; i < n; i++) {
        s.motor[i] = compliant(&m->joint[i]) ? s.free++ : i;
        s.x[i] = s.x[s.motor[i]] = m->q0[i];
        s.w[i] = s.w[s.motor[i]] = m->v0[i];
    }
    for (int k = 0; k < rows; k++) {
        energy[k] = mechanical_energy(&s);
        for (int i = 0; i < n; i++) {
            const Joint *j = &m->joint[i];
            int c = j->sensor_on_load != 0.0 ? i : s.motor[i], at = k * n + i;
            q[at] = s.x[c];
            v[at] = s.w[c];
            double y = measured[at] = sense(j, s.x[c], noise[at]);
            double slope = k == 0 ? 0.0 : (y - last[i]) / m->sample_time;
            double blend =
                m->velocity_filter > 0 ? 1 - exp(-m->sample_time / m->velocity_filter) : 1.0;
            rate[i] += blend * (slope - rate[i]);
            last[i] = y;
            sum[i] += m->ki[i] * m->sample_time * (reference[at] - y);
            double u =
                feedforward[at] + m->kp[i] * (reference[at] - y) - m->kd[i] * rate[i] + sum[i];
            if (j->limit > 0) u = fmax(-j->limit, fmin(j->limit, u));
            command[at] = u;
            if (!(fabs(s.x[c]) < 1e4)) return k + 1;
        }
        for (int r = 0; r < m->substeps; r++) {
            double drive[7], outside[7], mix = (r + 0.5) / m->substeps,
                                         t = k * m->sample_time + r * h;
            s.t = t;
            for (int i = 0; i < n; i++) {
                const Joint *j = &m->joint[i];
                int at = k * n + i, next = k + 1 < rows ? at + n : at;
                double steady = held(m, command, i, t, h);
                if (j->lag > 0) {
                    double old = s.hidden[i].torque, decay = exp(-h / j->lag);
                    s.hidden[i].torque = steady + (old - steady) * decay;
                    drive[i] = steady + (old - steady) * (1 - decay) * j->lag / h;
                } else {
                    drive[i] = s.hidden[i].torque = steady;
                }
                outside[i] = (1 - mix) * torque[at] + mix * torque[next];
            }
            step(&s, h, drive, outside);
        }
    }
    return 0;
}
