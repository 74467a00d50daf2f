/* Fixed-interval smoother of several bodies that hang together: a linear system whose matrices
 * change slowly, with a position sensor on some of its states. A sample that says nothing carries
 * R < 0. */

enum { MOST_STATES = 64 }; /* of a chain */

typedef struct {
    int n, d, c, m;      /* samples, states, torques, sensors */
    int every;           /* samples of one A and G */
    const double *A, *G; /* x <- A x + G f, [d x d] and [d x c] each */
    const double *f;     /* known torques, held over a sample, [n x c] */
    const double *s2;    /* variances of those that are not known, [n x c] */
    const double *value, *half, *R; /* measurement, its dead zone, its variance, [n x m] each */
    const int *at;                  /* the state that a sensor sees, [m] */
    const double *x0, *p0;          /* first state and its variances, [d] each */
} zf_chain;

/* out[r x c] = a[r x k] b[k x c]; turned: b is [c x k]. */
static void times(int r, int k, int c, const double *a, const double *b, int turned, double *out)
{
    memset(out, 0, sizeof(double) * (size_t)(r * c));
    for (int i = 0; i < r; i++)
        for (int j = 0; j < k; j++)
            for (int l = 0; l < c; l++)
                out[i * c + l] += a[i * k + j] * (turned ? b[l * k + j] : b[j * c + l]);
}

static const double *pose(const zf_chain *C, const double *of, int columns, int k)
{
    return of + (size_t)(k / C->every) * (size_t)(C->d * columns);
}

/* State x and covariance P[d x d] after the measurements of sample k; keeps gain (d), variance and
 * error of each sensor. Returns its part of -2 log-likelihood. */
static double chain_measure(const zf_chain *C, int k, double *x, double *P, double *kept)
{
    const int d = C->d;
    double nll = 0;
    for (int i = 0; i < C->m; i++) {
        const size_t at = (size_t)k * C->m + i;
        double *g = kept + at * (d + 2);
        const int s = C->at[i];
        g[d] = -1;
        if (!(C->R[at] > 0)) continue;
        double e = C->value[at] - x[s];
        e = e > C->half[at] ? e - C->half[at] : e < -C->half[at] ? e + C->half[at] : 0;
        const double S = P[s * d + s] + C->R[at];
        for (int j = 0; j < d; j++) g[j] = P[j * d + s] / S;
        g[d] = S; g[d + 1] = e;
        nll += log(S) + e * e / S;
        for (int j = 0; j < d; j++) {
            x[j] += g[j] * e;
            for (int l = 0; l < d; l++) P[j * d + l] -= g[j] * g[l] * S;
        }
    }
    return nll;
}

/* The filter over all samples. work: 3 d d. Returns -2 log-likelihood. */
static double chain_forward(const zf_chain *C, double *kept, double *work)
{
    const int d = C->d, c = C->c;
    double *P = work, *B = P + d * d, *D = B + d * d, nll = 0, x[MOST_STATES], y[MOST_STATES];
    memset(P, 0, sizeof(double) * (size_t)(d * d));
    for (int i = 0; i < d; i++) { P[i * d + i] = C->p0[i]; x[i] = C->x0[i]; }
    for (int k = 0; k < C->n; k++) {
        nll += chain_measure(C, k, x, P, kept);
        const double *A = pose(C, C->A, d, k), *G = pose(C, C->G, c, k);
        const double *f = C->f + (size_t)k * c, *s2 = C->s2 + (size_t)k * c;
        times(d, d, 1, A, x, 0, y);
        times(d, c, 1, G, f, 0, x);
        for (int j = 0; j < d; j++) x[j] += y[j];
        times(d, d, d, P, A, 1, B);
        times(d, d, d, A, B, 0, P);
        for (int j = 0; j < d; j++)
            for (int l = 0; l < c; l++) B[j * c + l] = G[j * c + l] * s2[l];
        times(d, c, d, B, G, 1, D);
        for (int j = 0; j < d * d; j++) P[j] += D[j];
    }
    return nll;
}

/* The adjoint before each sample's measurements, [n x d]. */
static void chain_backward(const zf_chain *C, const double *kept, double *adjoint)
{
    const int d = C->d, m = C->m;
    double r[MOST_STATES] = {0}, y[MOST_STATES];
    for (int k = C->n - 1; k >= 0; k--) {
        if (k < C->n - 1) {
            times(1, d, d, r, pose(C, C->A, d, k), 0, y);
            memcpy(r, y, sizeof(double) * (size_t)d);
        }
        for (int i = m - 1; i >= 0; i--) {
            const double *g = kept + ((size_t)k * m + i) * (d + 2);
            if (g[d] < 0) continue;
            double dot = 0;
            for (int j = 0; j < d; j++) dot += g[j] * r[j];
            r[C->at[i]] += g[d + 1] / g[d] - dot;
        }
        memcpy(adjoint + (size_t)k * d, r, sizeof(double) * (size_t)d);
    }
}

/* Smoothed states out[n x d]: a Kalman filter, its adjoint, and the motion under the torques that
 * this finds (Koopman 1993). work: n (m (d + 2) + d) + 3 d d. Returns -2 log-likelihood; NaN where
 * there are too many states. */
double zf_smooth_chain(const zf_chain *C, double *work, double *out)
{
    const int d = C->d, c = C->c;
    if (d > MOST_STATES || c > d) return NAN;
    double *kept = work, *adjoint = kept + (size_t)C->n * C->m * (d + 2),
           f[MOST_STATES], y[MOST_STATES];
    const double nll = chain_forward(C, kept, adjoint + (size_t)C->n * d);
    chain_backward(C, kept, adjoint);
    for (int j = 0; j < d; j++) out[j] = C->x0[j] + C->p0[j] * adjoint[j];
    for (int k = 0; k + 1 < C->n; k++) {
        double *next = out + (size_t)(k + 1) * d;
        const double *G = pose(C, C->G, c, k);
        times(1, d, c, adjoint + (size_t)(k + 1) * d, G, 0, f);
        for (int l = 0; l < c; l++)
            f[l] = C->f[(size_t)k * c + l] + C->s2[(size_t)k * c + l] * f[l];
        times(d, c, 1, G, f, 0, y);
        times(d, d, 1, pose(C, C->A, d, k), next - d, 0, next);
        for (int j = 0; j < d; j++) next[j] += y[j];
    }
    return nll;
}
