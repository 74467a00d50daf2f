/* concealed_laws.h: the equation of every concealed effect: dry friction, what the command loses on
 * its way, torque on the load.
 *
 * Equations and names are those of the effects table in the contract of the diagnosis; how they are
 * solved is this file's own.
 */
#ifndef ZENDSP_CONCEALED_LAWS_H
#define ZENDSP_CONCEALED_LAWS_H

#include <math.h>   /* sin, tanh, exp, pow */
#include <string.h> /* memcpy */

#include "concealed_spec.h"
#include "plant.h"

enum { CONCEALED_HISTORY = 8192 }; /* steps of the command that a delay can look back */

typedef struct concealed {
    plant *plant;
    int count;
    concealed_effect effect[CONCEALED_EFFECTS];
    plant_friction base[PLANT_JOINTS]; /* friction before effects that vary */
    plant_hooks before;                /* hooks that the machine had set itself */
    void (*acceleration)(void *self, const double *q, const double *qd, const double *torque,
                         double *qdd);
    void *self; /* of the machine's own law */
    void (*others)(void *self, int stage, double h); /* what moved beside the joints before */
    void *others_self;
    int massive; /* 1: dM is not zero, or a link stands behind a transmission */
    double dM[PLANT_JOINTS][PLANT_JOINTS];
    long written; /* entries ever put into the history */
    double when[CONCEALED_HISTORY], past[CONCEALED_HISTORY][PLANT_JOINTS];
} concealed;

static inline double concealed_sign(double x) { return (x > 0.0) - (x < 0.0); }

/* ---- dry friction: levels of this step ---- */

static inline void concealed_levels(concealed *c, double t, const double *torque) {
    plant *p = c->plant;
    for (int j = 0; j < p->joints; j++)
        p->friction[j] = c->base[j];
    for (int i = 0; i < c->count; i++) {
        const concealed_effect *e = &c->effect[i];
        plant_friction *f = &p->friction[e->joint];
        double more = 0.0, scale = 1.0;
        if (e->kind == LOAD_FRICTION)
            more = e->p[0] * fabs(torque[e->joint]);
        else if (e->kind == POSITION_FRICTION)
            more = e->p[0] * sin(6.283185307179586 * p->q[e->joint] / e->p[1] + e->p[2]);
        else if (e->kind == FRICTION_DRIFT)
            scale = 1.0 + e->p[0] * (1.0 - exp(-t / e->p[1]));
        else
            continue;
        double *level[] = {&f->coulomb_pos, &f->coulomb_neg, &f->breakaway_pos, &f->breakaway_neg};
        for (int k = 0; k < 4; k++) {
            const double changed = (*level[k] + more) * scale;
            /* a ripple deeper than the friction itself leaves none */
            *level[k] = changed > 0.0 ? changed : 0.0;
        }
        f->viscous_pos *= scale;
        f->viscous_neg *= scale;
    }
}

/* ---- actuator: command (N m; V where the command is a voltage) → what arrives ---- */

static inline void concealed_remember(concealed *c, double t, const double *torque) {
    const long at = c->written % CONCEALED_HISTORY;
    c->when[at] = t;
    memcpy(c->past[at], torque, sizeof(double) * (size_t)c->plant->joints);
    c->written++;
}

/* Command of `time` ago; the cursor only moves forward, so this costs the same every step. */
static inline double concealed_delayed(concealed *c, concealed_effect *e, double t) {
    if (e->cursor < c->written - CONCEALED_HISTORY)
        e->cursor = c->written - CONCEALED_HISTORY;
    while (e->cursor + 1 < c->written &&
           c->when[(e->cursor + 1) % CONCEALED_HISTORY] <= t - e->p[0] + 1e-9)
        e->cursor++;
    const long at = e->cursor % CONCEALED_HISTORY;
    return c->when[at] <= t - e->p[0] + 1e-9 ? c->past[at][e->joint] : 0.0;
}

static inline void concealed_command(concealed *c, double t, double dt, double *torque) {
    concealed_remember(c, t, torque);
    for (int i = 0; i < c->count; i++) {
        concealed_effect *e = &c->effect[i];
        double *u = &torque[e->joint];
        switch (e->kind) {
        case TORQUE_GAIN:
            *u *= 1.0 + e->p[0];
            break;
        case TORQUE_OFFSET: /* as every effect, on the left of M qdd + … + effect = command */
            *u -= e->p[0];
            break;
        case DEAD_ZONE:
            *u = fabs(*u) < e->p[0] ? 0.0 : *u - e->p[0] * concealed_sign(*u);
            break;
        case SATURATION:
            *u = *u > e->p[0] ? e->p[0] : *u < -e->p[0] ? -e->p[0] : *u;
            break;
        case LAG: { /* mean of the exact first-order answer over the step */
            const double h = dt / e->p[0], mean = 1.0 - (1.0 - exp(-h)) / h;
            const double arrives = e->s[0] + (*u - e->s[0]) * mean;
            e->s[0] += (*u - e->s[0]) * (1.0 - exp(-h));
            *u = arrives;
            break;
        }
        case DELAY:
            *u = concealed_delayed(c, e, t);
            break;
        default:
            break;
        }
    }
}

/* ---- torque on the load side ---- */

/* Torque of the spring (or gap) between motor, at angle q, and link: k dz(q - ql) + damping while
 * in contact, never pulling across a gap. */
static inline double concealed_spring(const concealed_effect *e, double q, double qd) {
    const double bend = q - e->s[0], rate = qd - e->s[1];
    if (e->kind == ELASTICITY)
        return e->p[0] * bend + e->p[1] * rate;
    const double half = 0.5 * e->p[0], in = fabs(bend) - half, side = concealed_sign(bend);
    if (in <= 0.0)
        return 0.0;
    /* damping ratio 0.05 of load on spring */
    const double push = e->p[1] * in + 0.1 * sqrt(e->p[1] * e->p[2]) * rate * side;
    return push > 0.0 ? push * side : 0.0;
}

/* Laws that the contract does not name. */
static inline double concealed_foreign(const concealed_effect *e, double t, double q, double qd) {
    switch ((int)e->p[0]) {
    case 0: /* drag that a strap gives only while it is taut */
        return q > 0.0 ? e->p[1] * qd * cos(7.0 * q) : 0.0;
    /* a parametric torque: depends on place and on the direction of travel at high speed only */
    case 1:
        return e->p[1] * tanh(qd * qd * q * 3.0) * cos(3.0 * q);
    default: /* friction that breathes with time and place at once */
        return e->p[1] * tanh(qd / 0.05) * sin(2.0 * q) * sin(1.7 * t);
    }
}

static inline double concealed_torque(const concealed_effect *e, double t, const double *q,
                                      const double *qd) {
    const int j = e->joint;
    const double away = q[j] - e->p[1];
    switch (e->kind) {
    case QUADRATIC_DRAG:
        return e->p[0] * qd[j] * fabs(qd[j]);
    case GRAVITY:
        return e->p[0] * sin(q[j] - e->p[1]);
    case STIFFNESS:
        return e->p[0] * away;
    case CUBIC_STIFFNESS:
        return e->p[0] * away * away * away;
    case RIPPLE:
        return e->p[1] * sin(e->p[0] * q[j] + e->p[2]);
    case HYSTERESIS:
        return e->p[0] * e->s[0];
    case DISTURBANCE: /* a smooth bump, opposing where the level is positive */
        if (t <= e->p[1] || t >= e->p[1] + e->p[2])
            return 0.0;
        return e->p[0] * pow(sin(3.141592653589793 * (t - e->p[1]) / e->p[2]), 2.0);
    case COUPLING: {
        const int from = (int)e->p[0] - 1;
        if (e->p[1] == 1.0)
            return e->p[2] * qd[from] * qd[from];
        if (e->p[1] == 2.0)
            return e->p[2] * qd[from];
        return e->p[1] == 3.0 ? e->p[2] * e->s[0] : 0.0; /* law 0 is in dM */
    }
    case FOREIGN:
        return concealed_foreign(e, t, q[j], qd[j]);
    default:
        return 0.0;
    }
}

/* States: z of Bouc–Wen, bristle of a coupled friction; midpoint rule like the plant. */
static inline void concealed_advance_one(concealed_effect *e, double h, const double *qd) {
    const int j = e->joint;
    if (e->kind == HYSTERESIS) { /* A = stiffness / force, beta = gamma = A / 2: |z| <= 1 */
        const double A = e->p[1] / e->p[0], n = e->p[2], v = qd[j];
        double z = e->s[0], zm = z;
        for (int k = 0; k < 2; k++) {
            const double size = pow(fabs(zm), n);
            const double zd = A * (v - 0.5 * (fabs(v) * size * concealed_sign(zm) + v * size));
            zm = z + (k ? h : 0.5 * h) * zd;
        }
        e->s[0] = zm > 1.0 ? 1.0 : zm < -1.0 ? -1.0 : zm;
    /* Dahl: z from -1 to 1 within 1 mrad of common travel */
    } else if (e->kind == COUPLING && e->p[1] == 3.0) {
        const double v = qd[j] + qd[(int)e->p[0] - 1], end = concealed_sign(v);
        e->s[0] = end + (e->s[0] - end) * exp(-fabs(v) * h / 1e-3);
    }
}

#endif
