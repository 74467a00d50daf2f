/* Mathematics of simulate.c: the set-valued law of dry friction coupled through the mass matrix,
 * and closed forms of one step. */

/* Gaussian elimination without pivoting (A is positive definite up to the effects' couplings); rows
 * and columns of joints that friction holds are left out. Solution in v. */
static void eliminate(int n, const double *A, const double *b, const int8_t *stuck, double *v) {
    int at[SIM_DOF], m = 0;
    for (int i = 0; i < n; i++) {
        v[i] = 0;
        if (!stuck[i])
            at[m++] = i;
    }
    double B[SIM_DOF * SIM_DOF], r[SIM_DOF];
    for (int i = 0; i < m; i++) {
        r[i] = b[at[i]];
        for (int k = 0; k < m; k++)
            B[i * m + k] = A[at[i] * n + at[k]];
    }
    for (int i = 0; i < m; i++)
        for (int k = i + 1; k < m; k++) {
            const double f = B[k * m + i] / B[i * m + i];
            if (f == 0)
                continue;
            for (int l = i + 1; l < m; l++)
                B[k * m + l] -= f * B[i * m + l];
            r[k] -= f * r[i];
        }
    for (int i = m - 1; i >= 0; i--) {
        for (int l = i + 1; l < m; l++)
            r[i] -= B[i * m + l] * r[l];
        r[i] /= B[i * m + i];
    }
    for (int i = 0; i < m; i++)
        v[at[i]] = r[i];
}

/* A v + λ = b, λ_i = up_i for v_i > 0, -down_i for v_i < 0, between them at rest; of a friction
 * that gives way λ_i = give_i v_i + from_i, between the same limits. v comes in as a guess. */
static void solve(int n, const double *A, const double *b, const double *up, const double *down,
                  const double *give, const double *from, double *v) {
    if (n == 1) {
        const double rub = (give[0] * b[0] + A[0] * from[0]) / (A[0] + give[0]);
        const double at = give[0] > 0 ? rub : b[0];
        v[0] = (b[0] - (at > up[0] ? up[0] : at < -down[0] ? -down[0] : at)) / A[0];
        return;
    }
    int8_t side[SIM_DOF], stuck[SIM_DOF];
    double r[SIM_DOF], B[SIM_DOF * SIM_DOF];
    int dry = 0;
    for (int i = 0; i < n; i++) {
        dry |= up[i] > 0 || down[i] > 0;
        side[i] = give[i] > 0 ? 0 : v[i] > 0 ? 1 : v[i] < 0 ? -1 : 0;
        if (up[i] <= 0 && down[i] <= 0)
            side[i] = 2; /* free: no sign to keep */
    }
    for (int trial = 0; trial < 12; trial++) {
        memcpy(B, A, sizeof(double) * (size_t)(n * n));
        for (int i = 0; i < n; i++) {
            const int gives = side[i] == 0 && give[i] > 0;
            stuck[i] = side[i] == 0 && !gives;
            B[i * n + i] += gives ? give[i] : 0;
            r[i] = b[i] - (side[i] == 1 ? up[i] : side[i] == -1 ? -down[i] : gives ? from[i] : 0);
        }
        eliminate(n, B, r, stuck, v);
        if (!dry)
            return;
        int changed = 0;
        for (int i = 0; i < n; i++) {
            if (side[i] == 2)
                continue;
            const double rub = give[i] * v[i] + from[i];
            if (side[i] != 0) {
                if (give[i] > 0 ? rub * side[i] < (side[i] > 0 ? up[i] : down[i])
                                : v[i] * side[i] < 0) {
                    side[i] = 0;
                    changed = 1;
                }
                continue;
            }
            double load = b[i];
            for (int k = 0; k < n; k++)
                load -= A[i * n + k] * v[k];
            if (load > up[i])
                side[i] = 1, changed = 1;
            else if (load < -down[i])
                side[i] = -1, changed = 1;
        }
        if (!changed)
            return;
    }
    /* it cycled (many joints at the edge at once): converge slowly but surely */
    for (int sweep = 0; sweep < 200; sweep++) {
        double change = 0, size = 0;
        for (int i = 0; i < n; i++) {
            double load = b[i], next;
            for (int k = 0; k < n; k++)
                if (k != i)
                    load -= A[i * n + k] * v[k];
            solve(1, &A[i * n + i], &load, &up[i], &down[i], &give[i], &from[i], &next);
            change = fmax(change, fabs(next - v[i]));
            size = fmax(size, fabs(next));
            v[i] = next;
        }
        if (change <= 1e-14 * size)
            return;
    }
}

/* Bouc-Wen variable after h at constant speed, and its mean on the way. */
static double hysteresis(const sim_joint *j, double z, double speed, double h, double *mean) {
    const double way = j->bw_a * fabs(speed) * h;
    const int steps = 1 + (way > 8 ? 63 : (int)(8 * way));
    double sum = 0;
    for (int i = 0; i < steps; i++) {
        const double d = h / steps;
        double rate = 0, at = z;
        for (int stage = 0; stage < 2; stage++) {
            const double size = pow(fabs(at), j->bw_n);
            rate = j->bw_a * (speed - 0.5 * fabs(speed) * size * sgn(at) - 0.5 * speed * size);
            at = z + 0.5 * d * rate;
        }
        double next = z + d * rate;
        next = next > 1 ? 1 : next < -1 ? -1 : next;
        sum += 0.5 * (z + next);
        z = next;
    }
    *mean = sum / steps;
    return z;
}

/* (1 - exp(-x)) / x and (1 - that) / x, without cancellation near 0. */
static void decay(double x, double *phi, double *psi) {
    if (x < 1e-4) {
        *phi = 1 - 0.5 * x + x * x / 6;
        *psi = 0.5 - x / 6 + x * x / 24;
    } else {
        *phi = -expm1(-x) / x;
        *psi = (1 - *phi) / x;
    }
}
