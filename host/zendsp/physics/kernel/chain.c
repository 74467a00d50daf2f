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

/* out[r x c] = a[r x k] b[k x c]. */
static void times(int r, int k, int c, const double *a, const double *b, double *out)
{
    memset(out, 0, sizeof(double) * (size_t)(r * c));
    for (int i = 0; i < r; i++)
        for (int l = 0; l < k; l++)
            for (int j = 0; j < c; j++) out[i * c + j] += a[i * k + l] * b[l * c + j];
}

static const double *pose(const zf_chain *C, const double *of, int columns, int k)
{
    return of + (size_t)(k / C->every) * (size_t)(C->d * columns);
}

/* Matrices whose rows are whole vectors of LANE numbers: zeros follow the first d. */
enum { LANE = 8 };
typedef double square[MOST_STATES * MOST_STATES];

/* y += a x. */
static inline void add_row(int width, double a, const double *x, double *y)
{
    for (int j = 0; j < width; j += LANE)
        for (int l = 0; l < LANE; l++) y[j + l] += a * x[j + l];
}

/* out[r x width] += a[r x k] x[k x width], a vector of sums at a time. */
static void add_product(int r, int k, int width, const double *a, const double *x, double *out)
{
    for (int i = 0; i < r; i++, a += width, out += width)
        for (int j = 0; j < width; j += LANE) {
            double sum[LANE];
            for (int l = 0; l < LANE; l++) sum[l] = out[j + l];
            for (int h = 0; h < k; h++)
                for (int l = 0; l < LANE; l++) sum[l] += a[h] * x[h * width + j + l];
            for (int l = 0; l < LANE; l++) out[j + l] = sum[l];
        }
}

/* What the filter carries from sample to sample, and the matrices of one pose. */
typedef struct {
    double x[MOST_STATES]; /* state */
    square P;              /* its covariance */
    square A, turned;      /* A and its transpose */
    square Q;              /* G s2 G' */
    square B, D;           /* for products */
} chain_filter;

/* State and covariance after the measurements of sample k; keeps gain (d), variance and error of
 * each sensor. Returns its part of -2 log-likelihood. */
static double chain_measure(const zf_chain *C, int k, chain_filter *F, int width, double *kept)
{
    const int d = C->d;
    double nll = 0;
    for (int i = 0; i < C->m; i++) {
        const size_t at = (size_t)k * C->m + i;
        double *g = kept + (size_t)i * (d + 2), gain[MOST_STATES];
        const int s = C->at[i];
        g[d] = -1;
        if (!(C->R[at] > 0)) continue;
        double e = C->value[at] - F->x[s];
        e = e > C->half[at] ? e - C->half[at] : e < -C->half[at] ? e + C->half[at] : 0;
        const double S = F->P[s * width + s] + C->R[at];
        for (int j = 0; j < width; j++) gain[j] = F->P[s * width + j] / S;
        memcpy(g, gain, sizeof(double) * (size_t)d);
        g[d] = S; g[d + 1] = e;
        nll += log(S) + e * e / S;
        add_row(width, e, gain, F->x);
        for (int j = 0; j < d; j++) add_row(width, -gain[j] * S, gain, F->P + j * width);
    }
    return nll;
}

/* The matrices of sample k, where they are others than those of the one before. */
static void chain_matrices(const zf_chain *C, int k, chain_filter *F, int width)
{
    const int d = C->d, c = C->c, posed = k % C->every == 0;
    const double *A = pose(C, C->A, d, k), *G = pose(C, C->G, c, k);
    const double *s2 = C->s2 + (size_t)k * c;
    if (posed)
        for (int i = 0; i < d; i++)
            for (int j = 0; j < d; j++)
                F->A[i * width + j] = F->turned[j * width + i] = A[i * d + j];
    if (!posed && !memcmp(s2, s2 - c, sizeof(double) * (size_t)c)) return;
    for (int i = 0; i < d; i++)
        for (int l = 0; l < c; l++) {
            F->B[i * width + l] = G[i * c + l] * s2[l];
            F->D[l * width + i] = G[i * c + l];
        }
    memset(F->Q, 0, sizeof(double) * (size_t)(d * width));
    add_product(d, c, width, F->B, F->D, F->Q);
}

/* The filter over all samples. Keeps what ``chain_measure`` does of each, of the last one alone
 * where ``all`` is 0. Returns -2 log-likelihood. */
static double chain_forward(const zf_chain *C, int all, double *kept)
{
    const int d = C->d, c = C->c, width = (d + LANE - 1) / LANE * LANE;
    const size_t each = all ? (size_t)C->m * (d + 2) : 0;
    chain_filter F;
    memset(&F, 0, sizeof F);
    double y[MOST_STATES] = {0}, nll = 0;
    for (int i = 0; i < d; i++) { F.P[i * width + i] = C->p0[i]; F.x[i] = C->x0[i]; }
    for (int k = 0; k < C->n; k++) {
        nll += chain_measure(C, k, &F, width, kept + each * (size_t)k);
        chain_matrices(C, k, &F, width);
        times(d, c, 1, pose(C, C->G, c, k), C->f + (size_t)k * c, y);
        for (int j = 0; j < d; j++) add_row(width, F.x[j], F.turned + j * width, y);
        memcpy(F.x, y, sizeof y);
        memset(F.B, 0, sizeof(double) * (size_t)(d * width));
        add_product(d, d, width, F.A, F.P, F.B);
        memcpy(F.P, F.Q, sizeof(double) * (size_t)(d * width));
        add_product(d, d, width, F.B, F.turned, F.P);
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
            times(1, d, d, r, pose(C, C->A, d, k), y);
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
 * this finds (Koopman 1993). Where ``out`` is NULL nothing is smoothed. work: n (m (d + 2) + d), or
 * m (d + 2) without ``out``. Returns -2 log-likelihood; NaN where there are too many states. */
double zf_smooth_chain(const zf_chain *C, double *work, double *out)
{
    const int d = C->d, c = C->c;
    if (d > MOST_STATES || c > d) return NAN;
    double *kept = work, *adjoint = kept + (size_t)C->n * C->m * (d + 2),
           f[MOST_STATES], y[MOST_STATES];
    const double nll = chain_forward(C, out != NULL, kept);
    if (!out) return nll;
    chain_backward(C, kept, adjoint);
    for (int j = 0; j < d; j++) out[j] = C->x0[j] + C->p0[j] * adjoint[j];
    for (int k = 0; k + 1 < C->n; k++) {
        double *next = out + (size_t)(k + 1) * d;
        const double *G = pose(C, C->G, c, k);
        times(1, d, c, adjoint + (size_t)(k + 1) * d, G, f);
        for (int l = 0; l < c; l++)
            f[l] = C->f[(size_t)k * c + l] + C->s2[(size_t)k * c + l] * f[l];
        times(d, c, 1, G, f, y);
        times(d, d, 1, pose(C, C->A, d, k), next - d, next);
        for (int j = 0; j < d; j++) next[j] += y[j];
    }
    return nll;
}
