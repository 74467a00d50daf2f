/* Fixed-interval smoother of several bodies that hang together: a linear system whose matrices
 * change slowly, with a position sensor on some of its states. A sample that says nothing carries
 * R < 0. */

enum { MOST_STATES = 64 }; /* of a chain */

typedef struct {
    int n, d, c, m, s;   /* samples, states, torques, sensors, springs */
    int every;           /* samples of one A and G */
    double T;            /* sample time */
    const double *A, *G; /* x <- A x + G f, [d x d] and [d x c] each */
    /* A is that of free bodies but for torques of springs: A = [I TI; 0 I] + L F W, where L has
     * ``eased``, [c x s], for positions and for speeds, W has the twist of each spring and its
     * rate, and F is ``bent``, [2s x 2s] */
    const double *eased, *bent;
    const int *motor, *link; /* positions whose difference is the twist, [s] each */
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

/* Matrices whose rows are whole vectors of LANE numbers, as many as a register of the processor
 * holds: zeros follow the first d. (Vectors of eight where four fit go through memory: 6 joints and
 * a spring took 7.3 us a sample, and take 2.0.) */
#ifdef __AVX512F__
enum { LANE = 8 };
#else
enum { LANE = 4 };
#endif
/* so that the compiler knows the length of a row */
#define OF_A_WIDTH static inline __attribute__((always_inline))
typedef double square[MOST_STATES * MOST_STATES + MOST_STATES]; /* ``moved_row`` reads on */

typedef double lanes __attribute__((vector_size(LANE * sizeof(double)), aligned(8), may_alias));

/* y += a x. */
OF_A_WIDTH void add_row(int width, double a, const double *x, double *y)
{
    for (int j = 0; j < width; j += LANE) *(lanes *)(y + j) += a * *(const lanes *)(x + j);
}

/* out[r x width] += a[r x k] x[k x width], a vector of sums at a time. */
OF_A_WIDTH void add_product(int r, int k, int width, const double *a, const double *x, double *out)
{
    for (int i = 0; i < r; i++, a += width, out += width)
        for (int j = 0; j < width; j += LANE) {
            lanes sum = *(lanes *)(out + j);
            for (int h = 0; h < k; h++) sum += a[h] * *(const lanes *)(x + h * width + j);
            *(lanes *)(out + j) = sum;
        }
}

/* y = x + ``held`` of x from its c-th number on: positions after a sample at their speeds, where
 * ``held`` is the sample time for positions and 0 for speeds. */
OF_A_WIDTH void moved_row(int width, int c, const double *held, const double *x, double *y)
{
    for (int j = 0; j < width; j += LANE)
        *(lanes *)(y + j) = *(const lanes *)(x + j) +
                            *(const lanes *)(held + j) * *(const lanes *)(x + c + j);
}

/* What the filter carries from sample to sample, and the matrices of one pose. */
typedef struct {
    double x[MOST_STATES]; /* state */
    double held[MOST_STATES], moved[MOST_STATES]; /* see ``moved_row`` */
    square P;              /* its covariance */
    square turned, pushed; /* A' and G' */
    square L;              /* of springs, see ``zf_chain``: L' in its first rows */
    square Q;              /* G s2 G' */
    square B, W, Z;        /* for products */
} chain_filter;

/* State and covariance after the measurements of sample k; keeps gain (d), variance and error of
 * each sensor. Returns its part of -2 log-likelihood. */
OF_A_WIDTH double chain_measure(
    const zf_chain *C, int k, chain_filter *F, const int width, double *kept)
{
    const int d = C->d, m = C->m;
    const size_t row = sizeof(double) * (size_t)width;
    double nll = 0;
    int some = 0; /* sensors that say something: their gains are rows of Z, columns of B */
    for (int i = 0; i < m; i++) memcpy(F->W + i * width, F->P + C->at[i] * width, row);
    for (int i = 0; i < m; i++) {
        const size_t at = (size_t)k * m + i;
        double *g = kept + (size_t)i * (d + 2), *gain = F->Z + some * width;
        const double *seen = F->W + i * width; /* the sensor's row of P, after those before it */
        const int s = C->at[i];
        g[d] = -1;
        if (!(C->R[at] > 0)) continue;
        double e = C->value[at] - F->x[s];
        e = e > C->half[at] ? e - C->half[at] : e < -C->half[at] ? e + C->half[at] : 0;
        const double S = seen[s] + C->R[at], by = 1 / S;
        for (int j = 0; j < width; j++) gain[j] = seen[j] * by;
        memcpy(g, gain, sizeof(double) * (size_t)d);
        g[d] = S; g[d + 1] = e;
        nll += log(S) + e * e * by;
        add_row(width, e, gain, F->x);
        for (int j = i + 1; j < m; j++) add_row(width, -gain[C->at[j]] * S, gain, F->W + j * width);
        for (int j = 0; j < d; j++) F->B[j * width + some] = -gain[j] * S;
        some++;
    }
    add_product(d, some, width, F->B, F->Z, F->P);
    return nll;
}

/* The matrices of sample k, where they are others than those of the one before. */
OF_A_WIDTH void chain_matrices(const zf_chain *C, int k, chain_filter *F, const int width)
{
    const int d = C->d, c = C->c, posed = k % C->every == 0;
    const double *A = pose(C, C->A, d, k), *G = pose(C, C->G, c, k);
    const double *s2 = C->s2 + (size_t)k * c;
    if (posed) {
        const double *eased = C->eased + (size_t)(k / C->every) * (size_t)(c * C->s);
        for (int i = 0; i < d; i++)
            for (int j = 0; j < d; j++) F->turned[j * width + i] = A[i * d + j];
        for (int a = 0; a < C->s; a++)
            for (int i = 0; i < c; i++)
                F->L[a * width + i] = F->L[(C->s + a) * width + c + i] = eased[i * C->s + a];
    }
    if (!posed && !memcmp(s2, s2 - c, sizeof(double) * (size_t)c)) return;
    for (int i = 0; i < d; i++)
        for (int l = 0; l < c; l++) {
            F->B[i * width + l] = G[i * c + l] * s2[l];
            F->pushed[l * width + i] = G[i * c + l];
        }
    memset(F->Q, 0, sizeof(double) * (size_t)(d * width));
    add_product(d, c, width, F->B, F->pushed, F->Q);
}

/* P <- A P A' + Q, with few products: bodies but for springs are free. */
OF_A_WIDTH void chain_spread(const zf_chain *C, int k, chain_filter *F, const int width)
{
    const int d = C->d, c = C->c, s = C->s, twists = 2 * s;
    const double *bent = C->bent + (size_t)(k / C->every) * (size_t)(twists * twists);
    int motor[MOST_STATES], link[MOST_STATES];
    double *P = F->P, *W = F->W, *Z = F->Z, *B = F->B;
    for (int a = 0; a < twists; a++) {
        motor[a] = C->motor[a % s] + (a < s ? 0 : c), link[a] = C->link[a % s] + (a < s ? 0 : c);
        for (int j = 0; j < width; j++)
            W[a * width + j] = P[motor[a] * width + j] - P[link[a] * width + j];
    }
    memset(Z, 0, sizeof(double) * (size_t)(twists * width));
    for (int a = 0; a < twists; a++) /* F W P */
        for (int h = 0; h < twists; h++)
            add_row(width, bent[a * twists + h], W + h * width, Z + a * width);
    memset(W, 0, sizeof(double) * (size_t)(twists * width));
    for (int a = 0; a < twists; a++) /* F W P W' F' L' / 2 */
        for (int h = 0; h < twists; h++) {
            double both = 0;
            for (int g = 0; g < twists; g++)
                both += (Z[a * width + motor[g]] - Z[a * width + link[g]]) * bent[h * twists + g];
            add_row(width, 0.5 * both, F->L + h * width, W + a * width);
        }
    for (int a = 0; a < twists; a++) { /* and F W P times what free bodies do */
        double *z = Z + a * width;
        moved_row(width, c, F->held, z, F->moved);
        for (int j = 0; j < width; j += LANE)
            *(lanes *)(z + j) = *(lanes *)(F->moved + j) + *(lanes *)(W + a * width + j);
        memcpy(z + twists * width, F->L + a * width, sizeof(double) * (size_t)width);
        for (int i = 0; i < d; i++)
            B[i * width + a] = F->L[a * width + i], B[i * width + twists + a] = z[i];
    }
    for (int i = 0; i < d; i++) moved_row(width, c, F->held, P + i * width, P + i * width);
    for (int i = 0; i < c; i++) add_row(width, C->T, P + (c + i) * width, P + i * width);
    for (int i = 0; i < d; i++) add_row(width, 1.0, F->Q + i * width, P + i * width);
    add_product(d, 2 * twists, width, B, Z, P);
}

/* The filter over all samples. Keeps what ``chain_measure`` does of each, of the last one alone
 * where ``all`` is 0. Returns -2 log-likelihood. */
OF_A_WIDTH double chain_pass(const zf_chain *C, int all, double *kept, const int width)
{
    const int d = C->d, c = C->c;
    const size_t each = all ? (size_t)C->m * (d + 2) : 0;
    chain_filter F;
    memset(&F, 0, sizeof F);
    double y[MOST_STATES] = {0}, nll = 0;
    for (int i = 0; i < d; i++) { F.P[i * width + i] = C->p0[i]; F.x[i] = C->x0[i]; }
    for (int i = 0; i < c; i++) F.held[i] = C->T;
    for (int k = 0; k < C->n; k++) {
        nll += chain_measure(C, k, &F, width, kept + each * (size_t)k);
        chain_matrices(C, k, &F, width);
        memset(y, 0, sizeof y);
        for (int j = 0; j < d; j++) add_row(width, F.x[j], F.turned + j * width, y);
        const double *f = C->f + (size_t)k * c;
        for (int l = 0; l < c; l++) add_row(width, f[l], F.pushed + l * width, y);
        memcpy(F.x, y, sizeof y);
        chain_spread(C, k, &F, width);
    }
    return nll;
}

static double chain_forward(const zf_chain *C, int all, double *kept)
{
    switch ((C->d + LANE - 1) / LANE) {
    case 1: return chain_pass(C, all, kept, LANE);
    case 2: return chain_pass(C, all, kept, 2 * LANE);
    case 3: return chain_pass(C, all, kept, 3 * LANE);
    case 4: return chain_pass(C, all, kept, 4 * LANE); /* of four: six joints, a spring or two */
    case 5: return chain_pass(C, all, kept, 5 * LANE);
    case 6: return chain_pass(C, all, kept, 6 * LANE);
    default: return chain_pass(C, all, kept, MOST_STATES);
    }
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
    if (d > MOST_STATES || d != 2 * c || 4 * C->s > d) return NAN;
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
