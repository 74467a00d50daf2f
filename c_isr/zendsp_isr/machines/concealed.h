/* concealed.h: physics that a simulated machine carries and does not tell: what the diagnosis has
 * to find.
 *
 * concealed_attach() enters the hooks of a plant and wraps its rigid-body law. The equations are
 * those of the effects table in the contract of the diagnosis; how they are solved is this file's
 * own: nothing is shared with the models on the host.
 *
 *     dry friction   levels of the plant's own bristle friction, set anew every step
 *     torque         added on the load side at every evaluation
 *     inertia        M + dM, through the inverse of M that the machine's law already is
 *     transmission   the link behind a spring or a gap; sensor and friction stay on the motor
 *     actuator       what the command loses on its way, in the order of the list
 *     sensor         what the encoder shows
 *     body           a payload: the machine's own law takes it up
 */
#ifndef ZENDSP_CONCEALED_H
#define ZENDSP_CONCEALED_H

#include "concealed_inertia.h"
#include "concealed_laws.h"
#include "concealed_spec.h"
#include "plant.h"

/* ---- hooks ---- */

static inline void concealed_on_actuator(void *self, double t, double dt, double *torque) {
    concealed *c = self;
    if (c->before.actuator)
        c->before.actuator(c->before.self, t, dt, torque);
    else
        concealed_command(c, t, dt, torque);
    concealed_levels(c, t, torque);
}

static inline void concealed_on_load(void *self, double t, const double *q, const double *qd,
                                     const double *torque, double *extra) {
    concealed *c = self;
    if (c->before.load)
        c->before.load(c->before.self, t, q, qd, torque, extra);
    for (int i = 0; i < c->count; i++)
        extra[c->effect[i].joint] += concealed_torque(&c->effect[i], t, q, qd);
}

static inline void concealed_on_advance(void *self, double t, double dt, const double *q,
                                        const double *qd) {
    concealed *c = self;
    if (c->before.advance)
        c->before.advance(c->before.self, t, dt, q, qd);
    for (int i = 0; i < c->count; i++)
        concealed_advance_one(&c->effect[i], dt, qd);
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

/* ---- setting up ---- */

/* Effects that are constants of the friction law, or of M; and the start of those that have states.
 */
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
        f->damping *= sqrt(e->p[0] / f->stiffness); /* the damping ratio of the bristles stays */
        f->stiffness = e->p[0];
        break;
    case INERTIA:
        c->dM[e->joint][e->joint] += e->p[0];
        break;
    case ELASTICITY:
    case BACKLASH: /* both have load_inertia third */
        concealed_divide(c, e);
        break;
    case COUPLING:
        if (e->p[1] == 0.0)
            c->dM[e->joint][(int)e->p[0] - 1] += e->p[2];
        break;
    default:
        break;
    }
}

/* The same friction that a simple model has: viscous and Coulomb, equal in both directions, no
 * breakaway, and bristles so stiff that no reversal shows them. Less than an encoder count of give
 * is not enough for that: while the bristles turn over, the friction's impulse is missing, and it
 * moves the joint for as long as its speed lasts. With 200 times the stiffness that was two counts
 * of imi_planar at each reversal, which is physics that a diagnosis finds; with 2000 times it is
 * less than one. */
static inline void concealed_plain(plant_friction *f) {
    f->viscous_pos = f->viscous_neg = 0.5 * (f->viscous_pos + f->viscous_neg);
    f->coulomb_pos = f->coulomb_neg = 0.5 * (f->coulomb_pos + f->coulomb_neg);
    f->breakaway_pos = f->breakaway_neg = f->coulomb_pos;
    f->vary = 0.0;
    f->stiffness *= 2000.0;
    /* half the damping ratio: enough to come to rest, little beside the level at a reversal */
    f->damping *= 22.0;
}

/* Call at the end of open(), when the plant is complete. Config keys: effect1, effect2, … and
 * friction = full | plain. Returns 0, or -1 with a sentence. */
static inline int concealed_attach(concealed *c, plant *p, const char *config, char *error,
                                   size_t error_size) {
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
    for (int i = 0; i < c->count; i++) {
        const concealed_effect *e = &c->effect[i];
        if (e->kind == PAYLOAD &&
            (!p->carry || p->carry(p->carry_self, e->joint, e->p[0], &e->p[1]) != 0)) {
            snprintf(error, error_size,
                     "concealed: this machine can carry no payload there (joint %d)", e->joint + 1);
            return -1;
        }
    }
    memcpy(c->base, p->friction, sizeof c->base);
    c->acceleration = p->acceleration;
    c->self = p->self;
    c->others = p->others;
    c->others_self = p->others_self;
    for (int i = 0; i < c->count; i++)
        concealed_prepare(c, &c->effect[i]);
    for (int i = 0; i < c->count; i++) {
        const concealed_effect *e = &c->effect[i];
        if (!concealed_divides(e))
            continue;
        if (!(e->p[2] > 0.0 && e->motor > 0.0)) {
            snprintf(error, error_size,
                     "concealed: load_inertia of joint %d is %g kg m^2; expected above 0 and below"
                     " the joint's %g",
                     e->joint + 1, e->p[2], e->motor + e->p[2]);
            return -1;
        }
        p->others = concealed_others;
        p->others_self = c;
        break;
    }
    for (int i = 0; i < p->joints; i++)
        for (int k = 0; k < p->joints; k++)
            c->massive |= c->dM[i][k] != 0.0;
    memcpy(p->friction, c->base, sizeof c->base);
    c->massive |= p->others == concealed_others;
    c->before = p->hooks;
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
