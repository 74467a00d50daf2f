/* One joint seen through an observer: predicts every position sample, returns the normalised
 * innovations.
 *
 * The file is completed at build time: the lines OBSERVER are replaced by effects.c, motion.c,
 * step.c and observer.c, the line EFFECT_FUNCTIONS therein by one small function per physical
 * effect (see effects/), the lines EFFECT_CASES_* by the cases of the switches that call them.
 * Scheme per inner step h: half drift, two evaluations of the smooth torque at mid position (second
 * order), dry friction as a set-valued law (exact sticking at any step, and where a joint turns
 * round within one), bristles of second order, a lag and a late command exactly, but where the
 * joint turns round in that step. Units: rad or m, s, N m or N.
 */
#include <math.h>
#include <stddef.h>
#include <string.h>

#if defined(__GNUC__) && !defined(__clang__) && defined(__GLIBC__) && defined(__x86_64__)
/* the C library has it for several lanes at once */
double pow(double, double) __attribute__((simd("notinbranch"), const));
#endif

#define INLINE static inline __attribute__((always_inline))

enum { MAXFX = 24, MAXP = 6 };
/* where effects act: see effects.c */
enum { STILL, FORCE, LOAD, DRY, ACTUATOR, SENSOR, PLACES };

typedef struct {
    int n;                    /* samples */
    int sub;                  /* inner steps per sample */
    int stiff;                /* 1: what damps the joint is faster than they are */
    double T;                 /* sample period, s */
    const double *ucum;       /* n + 1: integral of the command, unit s */
    double delay;             /* s */
    double gain;              /* torque per command unit */
    double limit;             /* command units, 0 = none */
    const double *m;          /* n: measured position, quantiser edges where it is a code change */
    double shift;             /* of the sensor's zero: added to every measured position */
    /* n: half width of the interval in which a measurement says nothing */
    const double *half;
    const double *k1, *k2;    /* n: observer gains, 0 where the sample says nothing */
    const double *w;          /* n: weight 1 / sqrt(S), 0 where the sample says nothing */
    const double *inertia;    /* n: inertia of the joint along the record */
    /* n: torque known from the measured motion of all joints; it acts on the load */
    const double *bias;
    const double *bias_slope; /* n: its change with the load's position, or 0 */
    /* inertia that the inertia of a load is a part of: the rest is the motor's, at any pose */
    double reference;
    double gravity;           /* torque = gravity sin(q) evaluated on the predicted position */
    const double *other;      /* joints x 3 x n: measured q, qd, qdd of every joint */
    const double *temperature; /* n: degrees C, where an effect feels it */
    const double *extra;      /* n: torque added from outside, may be 0 */
    int nfx;
    const int *kind;          /* nfx */
    const double *p;          /* nfx x MAXP */
    /* initial state, and its acceleration: it says how far a spring is bent when the recording
     * begins */
    double q0, qd0, a0;
    double unbent;            /* 1: no spring is bent then, whatever its load needs */
    double b0, bd0;           /* by how much the unseen side is ahead of that, and faster */
    int load_sensor;          /* 1: the sensor sits on the load */
    int beyond;               /* 1: states are those of the side that the sensor does not see */
    /* free run: restart from (rq, rqd) every so many samples, no correction; 0 = observer */
    int reset;
    const double *rq, *rqd;   /* n: states to restart from */
    /* n: by how much the side of a spring that nobody sees is ahead there; 0: as it was */
    const double *rb, *rbd;
    double t0;                /* time of the first sample, s */
    /* closed loop: command = kp (ref - position) - kd velocity; 0 = recorded command */
    double kp, kd;
    const double *ref;        /* n: reference of that loop */
    double resolution;        /* of the sensor in that loop, 0 = none */
    /* n + 1: integral of the loop's command, written; must be what ucum points to */
    double *uloop;
} zk_model;

INLINE double clip(double v, double lim) { return v > lim ? lim : v < -lim ? -lim : v; }
/* exp, log, pow and sin without a call, which would put every lane aside and every register into
 * memory. exp: of |x| < 700, off by 1e-14 of itself */
INLINE double grown(double x)
{
    union { double d; long long i; } n = {.d = x * 1.4426950408889634 + 0x1.8p52}; /* rounded */
    const long long bits = (n.i + 1023) << 52;                                     /* 2^n */
    n.d -= 0x1.8p52;
    const double r = (x - n.d * 0x1.62e42fee00000p-1) - n.d * 0x1.a39ef35793c76p-33;
    double p = 1.0 / 39916800;
    p = p * r + 1.0 / 3628800; p = p * r + 1.0 / 362880; p = p * r + 1.0 / 40320;
    p = p * r + 1.0 / 5040; p = p * r + 1.0 / 720; p = p * r + 1.0 / 120; p = p * r + 1.0 / 24;
    p = p * r + 1.0 / 6; p = p * r + 0.5; p = p * r + 1.0; p = p * r + 1.0;
    union { long long i; double d; } two = {.i = bits};
    return p * two.d;
}
#define exp(x) grown(clip(x, 690.0))
INLINE double saturated(double x) { return 1.0 - 2.0 / (grown(clip(2.0 * x, 40.0)) + 1.0); }
#define tanh(x) saturated(x) /* off by 1e-14 */
/* log of a normal x > 0: x = 2^n m with m about 1, log m = 2 artanh f */
INLINE double logarithm(double x)
{
    union { double d; long long i; } m = {.d = x}, n;
    n.i = (m.i - 0x3fe6a09e667f3bcdLL) >> 52; /* m from sqrt(1/2) to sqrt(2) */
    m.i -= (long long)((unsigned long long)n.i << 52);
    const double whole = (double)n.i, f = (m.d - 1.0) / (m.d + 1.0), s = f * f;
    double p = 2.0 / 21;
    p = p * s + 2.0 / 19; p = p * s + 2.0 / 17; p = p * s + 2.0 / 15; p = p * s + 2.0 / 13;
    p = p * s + 2.0 / 11; p = p * s + 2.0 / 9; p = p * s + 2.0 / 7; p = p * s + 2.0 / 5;
    p = p * s + 2.0 / 3;
    return whole * 0x1.62e42fefa39efp-1 + (2.0 * f + f * s * p);
}
/* x^n of x >= 0; whole: n where all lanes have the same and it is 1 or 2, else 0 */
INLINE double raised(double x, double n, int whole)
{
    return whole == 2 ? x * x : whole == 1 ? x : x > 1e-300 ? exp(n * logarithm(x)) : 0.0;
}
/* x less the nearest multiple of pi, in three parts, then its series: |x| < 1e8, off by 1e-15 */
INLINE double sine(double x)
{
    union { double d; long long i; } n = {.d = x * 0.3183098861837907 + 0x1.8p52}; /* rounded */
    union { double d; unsigned long long i; } out;
    const unsigned long long odd = (unsigned long long)n.i << 63;
    n.d -= 0x1.8p52;
    const double r = ((x - n.d * 3.1415926218032837) - n.d * 3.1786509424591713e-08) -
                     n.d * 1.2246467864107189e-16, s = r * r, s2 = s * s, s4 = s2 * s2;
    const double low = (-1.0 / 6 + s * (1.0 / 120)) + s2 * (-1.0 / 5040 + s * (1.0 / 362880)),
                 high = (-1.0 / 39916800 + s * (1.0 / 6227020800)) +
                        s2 * (-1.0 / 1307674368000 + s * (1.0 / 355687428096000));
    out.d = r + r * s * (low + s4 * (high + s4 * (-1.0 / 121645100408832000)));
    out.i ^= odd;
    return out.d;
}
#define sin(x) sine(x)
#define cos(x) sine((x) + 1.5707963267948966)
INLINE double sgn(double x) { return x > 0 ? 1.0 : x < 0 ? -1.0 : 0.0; }
/* v beyond lim >= 0: of one lane by a branch, which is foreseen, of many by a minimum and a
 * maximum, for which nothing waits as long as for a choice */
INLINE double soft_1(double v, double lim)
{
    return v > lim ? v - lim : v < -lim ? v + lim : 0.0;
}
INLINE double soft_many(double v, double lim)
{
    const double low = v < lim ? v : lim;
    return v - (low > -lim ? low : -lim);
}

/* the other joint's measured motion, for couplings; S: a state of effects.c */
#define LOOK_AT(joint) for (int l = 0; l < LANES; l++) { \
        const double *j = M->other + (size_t)(joint) * 3 * M->n + k + stride * l; \
        S->oq[l] = j[0]; S->oqd[l] = j[M->n]; S->oqdd[l] = j[2 * (size_t)M->n]; }

/* the recorded temperature */
#define FEEL for (int l = 0; l < LANES; l++) S->temp[l] = M->temperature[k + stride * l];

/* integral of the held command up to t; without branches, for lanes */
INLINE double cum(const zk_model *M, double t, double per_T)
{
    const double x = t * per_T, last = M->n - 1;
    const int i = (int)(x < 0 ? 0 : x < last ? x : last);
    return M->ucum[i] + (x - i) * (M->ucum[i + 1] - M->ucum[i]);
}

/* Motor and load of a joint: the motor's inertia is the same at every pose, the load's is what the
 * pose makes of it. */
static void share_inertia(double whole, double J, double load, double *jm, double *jl) {
    *jm = whole - load;
    if (*jm < 0.02 * J) *jm = 0.02 * J;
    if (*jm > 0.98 * J) *jm = 0.98 * J;
    *jl = J - *jm;
}

/* Steps of a gap's contact for each of the others: a contact begins and ends within a step. */
enum { CONTACT_STEPS = 2 };

/* Parts of a step in which a joint whose friction creeps turns round. */
enum { TURN_STEPS = 8 };

/* Samples from look to look at whether lanes have run away. */
enum { BLOCK = 16 };

/* What is true of a lane is a _Bool: an int is half as wide as a double, so that vectors would be
 * halved. */
#define EACH _Pragma("omp simd") for (int l = 0; l < LANES; l++)

#define LANES 1
#define OF(name) name##_1
/* OBSERVER */
#undef LANES
#undef OF

#define LANES MANY /* given at build time: native.py has to know it too */
#define OF(name) name##_many
/* OBSERVER */

/* One parameter set: innovations r[n], and where asked for states and torque (see pass). */
int zk_run(const zk_model *M, double *r, double *xq, double *xqd, double *torque)
{
    return pass_1(M, r, xq, xqd, torque);
}

/* LANES parameter sets M[LANES] of one recording, by the observer (no loop, no restarts):
 * innovations r[n x LANES]. */
int zk_run_lanes(const zk_model *M, double *r)
{
    return pass_many(M, r, 0, 0, 0);
}

/* Resisting torque of some effects along a measured motion (dry friction with sign smoothed over
 * v0): the column that a screen needs. Nothing depends on the sample before, so the lanes are
 * samples of one parameter set. */
void zk_trace(const zk_model *M, const double *motion, const double *u, double v0, double *out)
{
    zk_model same[LANES];
    numbers_many numbers, *N = &numbers;
    state_many state, *S = &state;
    memset(S, 0, sizeof *S);
    for (int l = 0; l < LANES; l++) same[l] = *M;
    begin_numbers_many(same, N);
    const int n = M->n;
    for (int first = 0; first < n; first += LANES) {
        const int k = n < LANES           ? 0
                      : first < n - LANES ? first
                                          : n - LANES,
                  some = n < LANES ? n : LANES; /* the last ones twice */
        lane_many torque, scale, thick, level, acted, asked, in = {0};
        for (int l = 0; l < some; l++) {
            S->q[l] = motion[k + l];
            S->qd[l] = motion[n + k + l];
            S->qdd[l] = motion[2 * (size_t)n + k + l];
            S->t[l] = M->t0 + (k + l) * M->T;
            in[l] = S->u[l] = u[k + l];
            asked[l] = S->tau[l] = M->gain * u[k + l];
            S->load[l] =
                M->inertia[k + l] * S->qdd[l] + M->bias[k + l] + M->gravity * sin(S->q[l]);
        }
        gather_still_many(M, N, S, k, some == LANES, &torque, &scale, &thick);
        gather_many(M, N, S, k, some == LANES, &torque, &scale, &thick);
        dry_many(M, N, S, &S->qd, &scale, &level);
        act_many(M, N, S, &in, &acted);
        for (int l = 0; l < some; l++)
            out[k + l] = torque[l] + (level[l] != 0 ? level[l] * tanh(S->qd[l] / v0) : 0.0) +
                         (asked[l] - acted[l]);
    }
}

/* What the position sensor adds to a motion q[n]. */
void zk_sense(const zk_model *M, const double *q, double *out)
{
    zk_model same[LANES];
    numbers_many numbers, *N = &numbers;
    state_many state, *S = &state;
    memset(S, 0, sizeof *S);
    for (int l = 0; l < LANES; l++) same[l] = *M;
    begin_numbers_many(same, N);
    for (int first = 0; first < M->n; first += LANES) {
        const int some = M->n - first < LANES ? M->n - first : LANES;
        lane_many at = {0}, seen;
        for (int l = 0; l < some; l++) at[l] = q[first + l];
        sense_many(M, N, S, &at, &seen);
        for (int l = 0; l < some; l++) out[first + l] = seen[l] - at[l];
    }
}
/* What added torque columns d (cols x n; floats where single is 1) do to the innovations, to first
 * order: the observer's error dynamics, out (cols x n). meas: columns act on the measurement
 * instead; 2: and not at first, where the prediction begins as the sensor says. per: what each
 * innovation is multiplied by (n), or null; lag: samples by which out is earlier, its end 0. rows:
 * the samples of out that are wanted, ascending, below n - lag, so that out is (cols x wanted);
 * null: all. */
void zk_filter(int n, double T, const double *k1, const double *k2, const double *w,
               const double *e_active, const double *inertia, const double *damp, int cols,
               const void *d, int single, int meas, const double *per, int lag, const int *rows,
               int wanted, double *out) {
    /* columns side by side: each waits for itself only; and samples that are brought beside one
     * another: more columns, or shorter pieces of them, are more streams than a processor fetches
     * ahead (4 * LANES and 16 take 1.7 to 2 times as long for 64 columns of 20 000 samples) */
    enum { WIDE = 2 * LANES, SPAN = 128 };
    const size_t wide = rows ? wanted : n;
    for (int first = 0; first < cols; first += WIDE) {
        const int some = cols - first < WIDE ? cols - first : WIDE,
                  groups = (some + LANES - 1) / LANES;
        const double *dc = (const double *)d + (size_t)first * n;
        const float *fc = (const float *)d + (size_t)first * n;
        double *oc = out + first * wide, q[WIDE] = {0}, v[WIDE] = {0}, in[SPAN][WIDE] = {{0}},
               r[SPAN][WIDE];
        for (int begin = 0, row = 0; begin < n; begin += SPAN) {
            const int here = n - begin < SPAN ? n - begin : SPAN;
            for (int c = 0; c < some; c++)
                for (int i = 0; i < here; i++)
                    in[i][c] = single ? (double)fc[(size_t)c * n + begin + i]
                                      : dc[(size_t)c * n + begin + i];
            for (int c = 0; c < some && begin == 0 && meas == 2; c++) {
                q[c] = in[0][c];
                v[c] = here > 1 ? (in[1][c] - in[0][c]) / T : 0.0;
            }
            for (int i = 0; i < here; i++) {
                const int k = begin + i;
                const double on = w[k] > 0 && e_active[k] != 0.0 ? 1.0 : 0.0,
                             light = 1.0 / inertia[k], ex = 1.0 / (1.0 + damp[k] * T * light),
                             as = per ? per[k] : 1.0;
                for (int g = 0; g < groups * LANES; g += LANES)
                    EACH {
                        const int c = g + l;
                        double e = on * ((meas ? in[i][c] : 0.0) - q[c]);
                        r[i][c] = w[k] * e * as;
                        q[c] += k1[k] * e; v[c] += k2[k] * e;
                        double vn = (v[c] - (meas ? 0.0 : in[i][c]) * light * T) * ex;
                        q[c] += 0.5 * T * (v[c] + vn);
                        v[c] = vn;
                    }
            }
            if (rows) {
                for (; row < wanted && rows[row] + lag < begin + here; row++)
                    for (int c = 0; c < some; c++)
                        oc[c * wide + row] = r[rows[row] + lag - begin][c];
                continue;
            }
            for (int c = 0; c < some; c++)
                for (int i = begin < lag ? lag - begin : 0; i < here; i++)
                    oc[(size_t)c * n + begin + i - lag] = r[i][c];
        }
        for (int c = 0; !rows && c < some; c++)
            for (int k = n - lag; k < n; k++) oc[(size_t)c * n + k] = 0;
    }
}
/* The transpose of zk_filter for torques, with all rows and neither per nor lag: of innovations
 * r (n), the series g (n) with sum(g * d) = sum(r * out) for every torque d. */
void zk_filter_back(int n, double T, const double *k1, const double *k2, const double *w,
                    const double *inertia, const double *damp, const double *r, double *g) {
    double q = 0.0, v = 0.0;
    for (int k = n - 1; k >= 0; k--) {
        const double light = 1.0 / inertia[k], ex = 1.0 / (1.0 + damp[k] * T * light);
        const double vn = v + 0.5 * T * q;
        g[k] = -light * T * ex * vn;
        v = 0.5 * T * q + ex * vn;
        if (w[k] > 0) q -= k1[k] * q + k2[k] * v + w[k] * r[k];
    }
}
