/* One joint seen through an observer: predicts every position sample, returns the normalised innovations.
 *
 * The file is completed at build time: the line EFFECT_FUNCTIONS is replaced by one small function per physical effect
 * (see effects/), the line EFFECT_CASES_* by the switch that calls them. Scheme per inner step h: half drift, two evaluations of the
 * smooth torque at mid position (second order), dry friction as a set-valued law (exact sticking at any step),
 * bristle and hysteresis states implicitly. Units: rad or m, s, N m or N.
 */
#include <math.h>
#include <string.h>

enum { MAXFX = 24, MAXP = 6 };

typedef struct { /* what an effect may look at */
    double q, qd, qdd, t;     /* state of the joint; qdd only where a trace is asked for */
    double u, tau;            /* command (its own unit) and actuator torque */
    double oq, oqd, oqdd;     /* the other joint, for couplings */
    double lag_t;             /* length of an inner step, s */
} zs;

typedef struct {
    int n;                    /* samples */
    int sub;                  /* inner steps per sample */
    double T;                 /* sample period, s */
    const double *ucum;       /* n + 1: integral of the command, unit s */
    double delay;             /* s */
    double gain;              /* torque per command unit */
    double limit;             /* command units, 0 = none */
    const double *m;          /* n: measured position, quantiser edges where it is a code change */
    const double *half;       /* n: half width of the interval in which a measurement says nothing */
    const double *k1, *k2;    /* n: observer gains, 0 where the sample says nothing */
    const double *w;          /* n: weight 1 / sqrt(S), 0 where the sample says nothing */
    const double *inertia;    /* n: inertia of the joint along the record */
    const double *bias;       /* n: torque known from the measured motion of all joints; it acts on the load */
    double reference;         /* inertia that the inertia of a load is a part of: the rest is the motor's, at any pose */
    double gravity;           /* torque = gravity sin(q) evaluated on the predicted position */
    const double *other;      /* joints x 3 x n: measured q, qd, qdd of every joint */
    const double *extra;      /* n: torque added from outside, may be 0 */
    int nfx;
    const int *kind;          /* nfx */
    const double *p;          /* nfx x MAXP */
    double q0, qd0, a0;       /* initial state, and its acceleration: it says how far a spring is bent when the recording begins */
    int load_sensor;          /* 1: the sensor sits on the load */
    int reset;                /* free run: restart from (rq, rqd) every so many samples, no correction; 0 = observer */
    const double *rq, *rqd;   /* n: states to restart from */
    double t0;                /* time of the first sample, s */
    double kp, kd;            /* closed loop: command = kp (ref - position) - kd velocity; 0 = recorded command */
    const double *ref;        /* n: reference of that loop */
    double resolution;        /* of the sensor in that loop, 0 = none */
    double *uloop;            /* n + 1: integral of the loop's command, written; must be what ucum points to */
} zk_model;

static inline double sgn(double x) { return (x > 0) - (x < 0); }
static inline double soft(double v, double lim) { return v > lim ? v - lim : v < -lim ? v + lim : 0.0; }

/* the other joint's measured motion at sample k, for couplings */
static inline void look_at(const zk_model *M, int joint, int k, zs *o)
{
    const double *j = M->other + (size_t)joint * 3 * M->n + k;
    o->oq = j[0]; o->oqd = j[M->n]; o->oqdd = j[2 * (size_t)M->n];
}

/* EFFECT_FUNCTIONS */

typedef struct { double torque, dry_pos, dry_neg, dry_scale, visc_scale; } forces;

static inline void gather(const zk_model *M, const zs *s, int k, forces *f, int dry)
{
    f->torque = 0; f->dry_pos = 0; f->dry_neg = 0; f->dry_scale = 1; f->visc_scale = 1;
    double visc = 0;
    zs o = *s;
    for (int i = 0; i < M->nfx; i++) {
        const double *p = M->p + i * MAXP;
        switch (M->kind[i]) {
/* EFFECT_CASES_FORCE */
        default: break;
        }
    }
    f->torque += visc * f->visc_scale;
    (void)k; (void)dry; (void)o;
}

static inline double act(const zk_model *M, double u, const zs *s)
{
    if (M->limit > 0) u = u > M->limit ? M->limit : u < -M->limit ? -M->limit : u;
    for (int i = 0; i < M->nfx; i++) {
        const double *p = M->p + i * MAXP;
        switch (M->kind[i]) {
/* EFFECT_CASES_ACTUATOR */
        default: break;
        }
    }
    (void)s;
    return M->gain * u;
}

static inline double sense(const zk_model *M, double q)
{
    zs s; memset(&s, 0, sizeof s); s.q = q;
    double out = q;
    for (int i = 0; i < M->nfx; i++) {
        const double *p = M->p + i * MAXP;
        switch (M->kind[i]) {
/* EFFECT_CASES_SENSOR */
        default: break;
        }
    }
    return out;
}

static inline double cum(const zk_model *M, double t) /* integral of the held command up to t */
{
    double x = t / M->T;
    if (x <= 0) return M->ucum[0] + x * (M->ucum[1] - M->ucum[0]);
    if (x >= M->n) return M->ucum[M->n] + (x - M->n) * (M->ucum[M->n] - M->ucum[M->n - 1]);
    int i = (int)x;
    if (i >= M->n) i = M->n - 1;
    return M->ucum[i] + (x - i) * (M->ucum[i + 1] - M->ucum[i]);
}

/* Motor and load of a joint: the motor's inertia is the same at every pose, the load's is what the pose makes of it. */
static void share_inertia(const zk_model *M, double J, double extra, double load, double *jm, double *jl)
{
    *jm = M->reference + extra - load;
    if (*jm < 0.02 * J) *jm = 0.02 * J;
    if (*jm > 0.98 * J) *jm = 0.98 * J;
    *jl = J - *jm;
}

/* Steps of a gap's contact for each of the others: a contact begins and ends within a step. */
enum { CONTACT_STEPS = 2 };

/* Innovations r[n] (weighted); where asked for, the corrected states x[2 n] and the actuator torque. Returns 0, or 1 + the sample
 * at which the prediction ran away. */
int zk_run(const zk_model *M, double *r, double *xq, double *xqd, double *torque)
{
    double q = M->q0, qd = M->qd0, ql = M->q0, qdl = M->qd0, z = 0, zh = 0, a = 0;
    double h;
    double delay = M->delay, lag = 0, k_spring = 0, c_spring = 0, j_load = 0, gap = 0;
    double s0 = 0, s1 = 0, bw_force = 0, bw_a = 0, bw_n = 1;
    double j_extra = 0, rub = 0; /* rub: dry friction in the step before */
    int two_mass = 0, lag_on = 0;
    double yloop = M->q0, vloop = 0;
    for (int i = 0; i < M->nfx; i++) {
        const double *p = M->p + i * MAXP;
        switch (M->kind[i]) {
/* EFFECT_CASES_SETUP */
        default: break;
        }
    }
    if (two_mass && !(gap > 0)) { /* a load in a gap may be anywhere in it */
        double J = M->inertia[0] + j_extra, jm, jl;
        share_inertia(M, J, j_extra, j_load, &jm, &jl);
        double push = jl * M->a0 + M->bias[0] + (M->gravity != 0 ? M->gravity * sin(M->q0) : 0.0);
        double bent = k_spring > 0 ? push / k_spring : 0.0;
        if (M->load_sensor) q += bent;
        else ql -= bent;
    }
    const int sub = gap > 0 ? CONTACT_STEPS * M->sub : M->sub;
    h = M->T / sub;
    for (int k = 0; k < M->n; k++) {
        if (M->kp > 0) { /* simulated in closed loop: the innovations are the measured position */
            double y = sense(M, M->load_sensor ? ql : q);
            if (M->resolution > 0) y = M->resolution * floor(y / M->resolution + 0.5);
            r[k] = y;
            vloop += 0.2 * ((y - yloop) / M->T - vloop);
            yloop = y;
            double u = M->kp * (M->ref[k] - y) - M->kd * vloop;
            if (M->limit > 0) u = u > M->limit ? M->limit : u < -M->limit ? -M->limit : u;
            M->uloop[k + 1] = M->uloop[k] + u * M->T;
        } else if (M->reset > 0) {
            if (k % M->reset == 0) {
                double dq = M->rq[k] - (M->load_sensor ? ql : q), dv = M->rqd[k] - (M->load_sensor ? qdl : qd);
                q += dq; ql += dq; qd += dv; qdl += dv;
            }
            r[k] = M->w[k] * (M->m[k] - sense(M, M->load_sensor ? ql : q));
        } else {
            double e = 0;
            if (M->w[k] > 0) {
                e = soft(M->m[k] - sense(M, M->load_sensor ? ql : q), M->half[k]);
                r[k] = M->w[k] * e;
            } else r[k] = 0;
            double dq = M->k1[k] * e, dv = M->k2[k] * e;
            const int apart = gap > 0 && fabs(q - ql) < 0.5 * gap; /* then what pushes one side does not reach the other */
            q += dq; ql += dq;
            if (!apart || !M->load_sensor) qd += dv;
            if (!apart || M->load_sensor) qdl += dv;
        }
        double lead = M->load_sensor ? ql : q;
        if (!(fabs(lead - (M->kp > 0 ? M->ref[k] : M->m[k])) < 1e3) || !(fabs(qd) < 1e5)) { for (; k < M->n; k++) r[k] = 1e9; return 1 + k; }
        if (xq) xq[k] = lead;
        if (xqd) xqd[k] = M->load_sensor ? qdl : qd;
        if (k == M->n - 1) { if (torque) torque[k] = k ? torque[k - 1] : 0; break; }
        double J = M->inertia[k] + j_extra, added = M->extra ? M->extra[k] : 0;
        zs s; memset(&s, 0, sizeof s);
        s.lag_t = h;
        double usum = 0, u = 0, tau = 0;
        int steady = !lag_on && delay == 0.0; /* the command is held over the sample */
        if (steady) { u = (M->ucum[k + 1] - M->ucum[k]) / M->T; s.t = M->t0 + k * M->T; tau = act(M, u, &s); }
        for (int i = 0; i < sub; i++) {
            double tl = k * M->T + i * h; /* record time for the command, absolute time for effects */
            s.t = M->t0 + tl + 0.5 * h;
            if (!steady) {
                u = (cum(M, tl + h - delay) - cum(M, tl - delay)) / h;
                if (lag_on) { if (k == 0 && i == 0) a = u; double ex = exp(-h / lag); double mean = u + (a - u) * (lag / h) * (1 - ex); a = u + (a - u) * ex; u = mean; }
                tau = act(M, u, &s);
            }
            usum += tau;
            s.u = u; s.tau = tau;
            forces f;
            s.q = q + 0.5 * h * qd;
            s.qd = qd;
            double fixed = tau - added - (two_mass ? 0 : M->bias[k]), jm = J, spring = 0;
            if (two_mass) {
                double jl;
                share_inertia(M, J, j_extra, j_load, &jm, &jl);
                double dv = qd - qdl, d = q - ql, e0 = soft(d, 0.5 * gap), e1 = soft(d + h * dv, 0.5 * gap);
                double g = 0.5 * (e0 + e1), on = 1.0; /* mean deflection, and share of the step in contact */
                if (gap > 0) {
                    double moved = h * dv;
                    on = fabs(moved) > 1e-12 * gap ? (e1 - e0) / moved : e0 != 0.0;
                    g = on < 1.0 && on > 0.0 ? 0.5 * (e1 * e1 - e0 * e0) / moved : g;
                }
                spring = k_spring * g + c_spring * on * dv;
                spring /= 1.0 + 0.5 * h * c_spring * on * (1 / jm + 1 / jl); /* damped by the mean speed of the step */
                if (gap > 0 && spring * g < 0) spring = 0; /* a contact pushes only */
                double lq = ql + 0.5 * h * qdl;
                double fl = spring - M->bias[k] - (M->gravity != 0 ? M->gravity * sin(lq) : 0.0);
                double vl = qdl + h * fl / jl;
                ql += 0.5 * h * (qdl + vl);
                qdl = vl;
            }
            double grav = (!two_mass && M->gravity != 0) ? M->gravity * sin(s.q) : 0.0;
            gather(M, &s, k, &f, 0);
            double acc = (fixed - grav - spring - f.torque - rub) / jm;
            s.qd = qd + 0.5 * h * acc;
            gather(M, &s, k, &f, 1);
            double free = fixed - grav - spring - f.torque;
            if (bw_force > 0) { /* Bouc-Wen, |z| <= 1 */
                double az = pow(fabs(zh), bw_n);
                double rate = bw_a * (s.qd - 0.5 * fabs(s.qd) * (zh == 0 ? 0 : az * sgn(zh)) - 0.5 * s.qd * az);
                double zn = zh + h * rate;
                zn = zn > 1 ? 1 : zn < -1 ? -1 : zn;
                free -= bw_force * 0.5 * (zh + zn);
                zh = zn;
            }
            double vfree = qd + h * free / jm, vn;
            double level = (vfree > 0 ? f.dry_pos : f.dry_neg) * f.dry_scale;
            if (level < 0) level = 0;
            if (s0 > 0 && level > 0) { /* bristle: z' = qd - s0 |qd| z / level, implicit in z and qd */
                double D = 1 + h * s0 * fabs(s.qd) / level;
                double st = s0 + s1 / h;
                vn = (vfree + (h / jm) * (-st * z / D + s1 * z / h)) / (1 + (h / jm) * st * h / D);
                z = (z + h * vn) / D;
            } else
                vn = soft(vfree, h * level / jm);
            rub = (vfree - vn) * jm / h;
            q += 0.5 * h * (qd + vn);
            qd = vn;
            if (!two_mass) { ql = q; qdl = qd; }
        }
        if (torque) torque[k] = usum / sub;
    }
    return 0;
}

/* Resisting torque of one effect along a measured motion (dry friction with sign smoothed over v0): the column that a screen needs. */
void zk_trace(const zk_model *M, const double *motion, const double *u, double v0, double *out)
{
    for (int k = 0; k < M->n; k++) {
        zs s; memset(&s, 0, sizeof s);
        s.q = motion[k]; s.qd = motion[M->n + k]; s.qdd = motion[2 * (size_t)M->n + k];
        s.t = M->t0 + k * M->T; s.u = u[k]; s.tau = M->gain * u[k];
        forces f;
        gather(M, &s, k, &f, 1);
        double sg = tanh(s.qd / v0);
        double level = sg > 0 ? f.dry_pos : f.dry_neg;
        out[k] = f.torque + f.dry_scale * level * sg + (M->gain * u[k] - act(M, u[k], &s));
    }
}

/* What added torque columns d (cols x n) do to the innovations, to first order: the observer's error dynamics, out (cols x n).
 * meas: columns act on the measurement instead. */
void zk_filter(int n, double T, const double *k1, const double *k2, const double *w, const double *e_active,
               const double *inertia, const double *damp, int cols, const double *d, int meas, double *out)
{
    for (int c = 0; c < cols; c++) {
        double q = 0, v = 0;
        const double *dc = d + (size_t)c * n;
        double *oc = out + (size_t)c * n;
        for (int k = 0; k < n; k++) {
            double e = 0;
            if (w[k] > 0 && e_active[k] != 0.0) e = (meas ? dc[k] : 0.0) - q;
            oc[k] = w[k] * e;
            q += k1[k] * e; v += k2[k] * e;
            double a = (meas ? 0.0 : -dc[k]) / inertia[k];
            double ex = 1.0 / (1.0 + damp[k] * T / inertia[k]);
            double vn = (v + a * T) * ex;
            q += 0.5 * T * (v + vn);
            v = vn;
        }
    }
}
