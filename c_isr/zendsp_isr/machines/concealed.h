/* concealed.h: physics that a simulated machine carries and does not tell: what the diagnosis has to find.
 *
 * concealed_attach() enters the hooks of a plant and wraps its rigid-body law. The equations are those of the effects table in the
 * contract of the diagnosis; how they are solved is this file's own: nothing is shared with the models on the host.
 *
 *     dry friction   levels of the plant's own bristle friction, set anew every step
 *     torque         added on the load side at every evaluation
 *     inertia        M + dM, through the inverse of M that the machine's law already is
 *     transmission   a load of its own behind a spring or a gap; the sensor stays on the motor
 *     actuator       what the command loses on its way, in the order of the list
 *     sensor         what the encoder shows
 */
#ifndef ZENDSP_CONCEALED_H
#define ZENDSP_CONCEALED_H

#include <math.h> /* sin, tanh, exp */

#include "concealed_spec.h"
#include "plant.h"

enum { CONCEALED_HISTORY = 8192 }; /* steps of the command that a delay can look back */

typedef struct concealed {
    plant *plant;
    int count;
    concealed_effect effect[CONCEALED_EFFECTS];
    plant_friction base[PLANT_JOINTS]; /* friction before effects that vary */
    plant_hooks before;                /* hooks that the machine had set itself */
    void (*acceleration)(void *self, const double *q, const double *qd, const double *torque, double *qdd);
    void *self; /* of the machine's own law */
    int massive; /* 1: dM is not zero */
    double dM[PLANT_JOINTS][PLANT_JOINTS];
    long written; /* entries ever put into the history */
    double when[CONCEALED_HISTORY], past[CONCEALED_HISTORY][PLANT_JOINTS];
} concealed;

static inline double concealed_sign(double x) { return (x > 0.0) - (x < 0.0); }

/* ---- dry friction: levels of this step ------------------------------------------------------------------------------------- */

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
            *level[k] = changed > 0.0 ? changed : 0.0; /* a ripple deeper than the friction itself leaves none */
        }
        f->viscous_pos *= scale;
        f->viscous_neg *= scale;
    }
}

/* ---- actuator: command (N m; V where the command is a voltage) → what arrives ---------------------------------------------- */

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
    while (e->cursor + 1 < c->written && c->when[(e->cursor + 1) % CONCEALED_HISTORY] <= t - e->p[0] + 1e-9)
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
        case TORQUE_OFFSET:
            *u += e->p[0];
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

/* ---- torque on the load side ------------------------------------------------------------------------------------------------ */

/* Torque of the spring (or gap) behind motor angle q: k dz(q - ql) + damping while in contact, never pulling across a gap. */
static inline double concealed_spring(const concealed_effect *e, double q, double qd, double ql, double qdl) {
    const double bend = q - ql, rate = qd - qdl;
    if (e->kind == ELASTICITY)
        return e->p[0] * bend + e->p[1] * rate;
    const double half = 0.5 * e->p[0], in = fabs(bend) - half, side = concealed_sign(bend);
    if (in <= 0.0)
        return 0.0;
    const double push = e->p[1] * in + 0.1 * sqrt(e->p[1] * e->p[2]) * rate * side; /* damping ratio 0.05 of load on spring */
    return push > 0.0 ? push * side : 0.0;
}

/* Laws that the contract does not name. */
static inline double concealed_foreign(const concealed_effect *e, double t, double q, double qd) {
    switch ((int)e->p[0]) {
    case 0: /* drag that a strap gives only while it is taut */
        return q > 0.0 ? e->p[1] * qd * cos(7.0 * q) : 0.0;
    case 1: /* a parametric torque: depends on place and on the direction of travel at high speed only */
        return e->p[1] * tanh(qd * qd * q * 3.0) * cos(3.0 * q);
    default: /* friction that breathes with time and place at once */
        return e->p[1] * tanh(qd / 0.05) * sin(2.0 * q) * sin(1.7 * t);
    }
}

static inline double concealed_torque(const concealed *c, const concealed_effect *e, double t, const double *q, const double *qd) {
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
    case ELASTICITY:
    case BACKLASH: {
        const double ahead = t - c->plant->t;
        return concealed_spring(e, q[j], qd[j], e->s[0] + ahead * e->s[1], e->s[1]);
    }
    case FOREIGN:
        return concealed_foreign(e, t, q[j], qd[j]);
    default:
        return 0.0;
    }
}

/* States: z of Bouc–Wen, bristle of a coupled friction, the load behind a spring; midpoint rule like the plant. */
static inline void concealed_advance_one(concealed_effect *e, double h, const double *q, const double *qd) {
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
    } else if (e->kind == COUPLING && e->p[1] == 3.0) { /* Dahl: z from -1 to 1 within 1 mrad of common travel */
        const double v = qd[j] + qd[(int)e->p[0] - 1], end = concealed_sign(v);
        e->s[0] = end + (e->s[0] - end) * exp(-fabs(v) * h / 1e-3);
    } else if (e->kind == ELASTICITY || e->kind == BACKLASH) {
        const double push = concealed_spring(e, q[j], qd[j], e->s[0] + 0.5 * h * e->s[1], e->s[1]);
        const double after = e->s[1] + h * push / e->p[2]; /* both have load_inertia third */
        e->s[0] += 0.5 * h * (e->s[1] + after);
        e->s[1] = after;
    }
}

/* ---- inertia: (M + dM) qdd = tau − bias, given qdd0 = M^-1 (tau − bias) as a black box ---------------------------------------- */

static inline void concealed_acceleration(void *self, const double *q, const double *qd, const double *torque, double *qdd) {
    concealed *c = self;
    const int n = c->plant->joints;
    c->acceleration(c->self, q, qd, torque, qdd);
    if (!c->massive)
        return;
    double W[PLANT_JOINTS][PLANT_JOINTS], A[PLANT_JOINTS][PLANT_JOINTS] = {{0}}, push[PLANT_JOINTS], moved[PLANT_JOINTS];
    for (int k = 0; k < n; k++) { /* column k of M^-1: the answer to one more N m on joint k */
        memcpy(push, torque, sizeof push);
        push[k] += 1.0;
        c->acceleration(c->self, q, qd, push, moved);
        for (int i = 0; i < n; i++)
            W[i][k] = moved[i] - qdd[i];
    }
    for (int i = 0; i < n; i++)
        for (int k = 0; k < n; k++) {
            A[i][k] = i == k;
            for (int m = 0; m < n; m++)
                A[i][k] += W[i][m] * c->dM[m][k];
        }
    for (int k = 0; k < n; k++) { /* Gauss–Jordan with pivoting: n is small */
        int best = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(A[i][k]) > fabs(A[best][k]))
                best = i;
        for (int m = 0; m < n; m++) {
            const double swap = A[k][m];
            A[k][m] = A[best][m];
            A[best][m] = swap;
        }
        const double swap = qdd[k];
        qdd[k] = qdd[best];
        qdd[best] = swap;
        for (int i = 0; i < n; i++) {
            if (i == k)
                continue;
            const double share = A[i][k] / A[k][k];
            for (int m = k; m < n; m++)
                A[i][m] -= share * A[k][m];
            qdd[i] -= share * qdd[k];
        }
    }
    for (int k = 0; k < n; k++)
        qdd[k] /= A[k][k];
}

/* ---- hooks -------------------------------------------------------------------------------------------------------------------- */

static inline void concealed_on_actuator(void *self, double t, double dt, double *torque) {
    concealed *c = self;
    if (c->before.actuator)
        c->before.actuator(c->before.self, t, dt, torque);
    else
        concealed_command(c, t, dt, torque);
    concealed_levels(c, t, torque);
}

static inline void concealed_on_load(void *self, double t, const double *q, const double *qd, const double *torque, double *extra) {
    concealed *c = self;
    if (c->before.load)
        c->before.load(c->before.self, t, q, qd, torque, extra);
    for (int i = 0; i < c->count; i++)
        extra[c->effect[i].joint] += concealed_torque(c, &c->effect[i], t, q, qd);
}

static inline void concealed_on_advance(void *self, double t, double dt, const double *q, const double *qd) {
    concealed *c = self;
    if (c->before.advance)
        c->before.advance(c->before.self, t, dt, q, qd);
    for (int i = 0; i < c->count; i++)
        concealed_advance_one(&c->effect[i], dt, q, qd);
}

static inline void concealed_on_sensor(void *self, double t, double *measured) {
    concealed *c = self;
    if (c->before.sensor)
        c->before.sensor(c->before.self, t, measured);
    for (int i = 0; i < c->count; i++) {
        const concealed_effect *e = &c->effect[i];
        if (e->kind == ENCODER_ECCENTRICITY)
            measured[e->joint] += e->p[0] * sin(measured[e->joint] + e->p[1]);
    }
}

/* ---- setting up --------------------------------------------------------------------------------------------------------------- */

/* Effects that are constants of the friction law, or of M; and the start of those that have states. */
static inline void concealed_prepare(concealed *c, concealed_effect *e) {
    plant_friction *f = &c->base[e->joint];
    switch (e->kind) {
    case VISCOUS:
        f->viscous_pos += e->p[0];
        f->viscous_neg += e->p[0];
        break;
    case VISCOUS_ASYMMETRY:
        f->viscous_pos += e->p[0];
        f->viscous_neg += e->p[1];
        break;
    case COULOMB: /* with it the breakaway level: what stood above Coulomb still does */
        f->coulomb_pos += e->p[0], f->breakaway_pos += e->p[0];
        f->coulomb_neg += e->p[0], f->breakaway_neg += e->p[0];
        break;
    case COULOMB_ASYMMETRY:
        f->coulomb_pos += e->p[0], f->breakaway_pos += e->p[0];
        f->coulomb_neg += e->p[1], f->breakaway_neg += e->p[1];
        break;
    case STRIBECK: /* breakaway is the level at rest, Fs, of both directions */
        f->breakaway_pos = f->breakaway_neg = e->p[0];
        f->stribeck = e->p[1];
        break;
    case PRESLIDING:
        f->stiffness = e->p[0];
        break;
    case INERTIA:
        c->dM[e->joint][e->joint] += e->p[0];
        break;
    case ELASTICITY:
    case BACKLASH: /* the load is taken out of the joint and hangs behind the spring */
        c->dM[e->joint][e->joint] -= e->p[2];
        e->s[0] = c->plant->q[e->joint];
        break;
    case COUPLING:
        if (e->p[1] == 0.0)
            c->dM[e->joint][(int)e->p[0] - 1] += e->p[2];
        break;
    default:
        break;
    }
}

/* The same friction that a simple model has: viscous and Coulomb, equal in both directions, no breakaway. */
static inline void concealed_plain(plant_friction *f) {
    f->viscous_pos = f->viscous_neg = 0.5 * (f->viscous_pos + f->viscous_neg);
    f->coulomb_pos = f->coulomb_neg = 0.5 * (f->coulomb_pos + f->coulomb_neg);
    f->breakaway_pos = f->breakaway_neg = f->coulomb_pos;
}

/* Call at the end of open(), when the plant is complete. Config keys: effect1, effect2, … and
 * friction = full | plain. Returns 0, or -1 with a sentence. */
static inline int concealed_attach(concealed *c, plant *p, const char *config, char *error, size_t error_size) {
    char friction[16] = "full";
    machine_config_text(config, "friction", friction, sizeof friction);
    if (strcmp(friction, "full") != 0 && strcmp(friction, "plain") != 0) {
        snprintf(error, error_size, "friction is '%s'; expected full or plain", friction);
        return -1;
    }
    for (int j = 0; j < p->joints && strcmp(friction, "plain") == 0; j++)
        concealed_plain(&p->friction[j]);
    memset(c, 0, sizeof *c);
    c->plant = p;
    c->count = concealed_parse_all(config, p->joints, c->effect, error, error_size);
    if (c->count < 0)
        return -1;
    if (c->count == 0)
        return 0; /* nothing concealed: nothing costs time */
    memcpy(c->base, p->friction, sizeof c->base);
    for (int i = 0; i < c->count; i++)
        concealed_prepare(c, &c->effect[i]);
    for (int i = 0; i < p->joints; i++)
        for (int k = 0; k < p->joints; k++)
            c->massive |= c->dM[i][k] != 0.0;
    memcpy(p->friction, c->base, sizeof c->base);
    c->before = p->hooks;
    c->acceleration = p->acceleration;
    c->self = p->self;
    p->acceleration = concealed_acceleration;
    p->self = c;
    p->hooks = (plant_hooks){.self = c,
                             .actuator = concealed_on_actuator,
                             .load = concealed_on_load,
                             .advance = concealed_on_advance,
                             .sensor = concealed_on_sensor};
    return 0;
}

#endif
