/* plant.h: what all simulated machines share: joints with real friction, drives, hard stops, and
 * the integrator.
 *
 * A machine gives its rigid-body law as `acceleration`; friction, drive modes and end stops act on
 * top of it at torque level:
 *
 *     M(q) qdd + … = tau_drive − friction(qd, z) − stops(q, qd) − hooks.load(…)
 *
 * Friction is LuGre with Stribeck curve (Canudas de Wit, Olsson, Åström, Lischinsky 1995), with
 * levels of its own for each direction and a bristle damping that fades with speed (keeps the law
 * passive).
 *
 *     dz/dt = qd − stiffness |qd| z / g(qd)
 *     g = coulomb + (breakaway − coulomb) exp(−(qd/stribeck)²)
 *     torque = stiffness z + damping exp(−(qd/stribeck)²) dz/dt + viscous qd
 *
 * In sliding the bristle equation is stiff (rate stiffness |qd| / g, 10⁵/s and more), so an
 * explicit method would need steps of microseconds. The step here is an exponential midpoint rule:
 * the bristle is advanced by its exact solution for constant speed, the rest by the explicit
 * midpoint; second order, stable, two evaluations a step.
 */
#ifndef ZENDSP_PLANT_H
#define ZENDSP_PLANT_H

#include <math.h>   /* exp, ceil, log */
#include <string.h> /* memcpy */

#include "machine.h"
#include "machine_config.h"

enum { PLANT_JOINTS = MACHINE_JOINTS };

typedef struct plant_friction {
    double coulomb_pos, coulomb_neg;     /* N m, sliding level for qd > 0 and qd < 0 */
    double breakaway_pos, breakaway_neg; /* N m, level at rest */
    double stribeck;                     /* rad/s */
    double stiffness;                    /* N m/rad, bristle */
    double damping;                      /* N m s/rad, bristle */
    double viscous_pos, viscous_neg;     /* N m s/rad */
    /* level varies with place: 1 + vary sin(2 pi turns q + phase); turns in 1/rad */
    double vary, turns, phase;
    double here;                         /* that factor at the present place */
} plant_friction;

typedef struct plant_drive {
    double torque_limit;  /* N m */
    double speed_gain;    /* N m s/rad: the drive's own speed loop (velocity mode) */
    double speed_integral;/* N m/rad */
    double brake;         /* N m s/rad with power off (shorted windings) */
} plant_drive;

/* What stands between numbers and torque, and between motion and numbers. All zero: ideal. */
typedef struct plant_electronics {
    double dac_step;                    /* mV, resolution of the analog command */
    double dac_noise;                   /* mV rms on the analog command, new in every sample */
    double finer[PLANT_JOINTS];         /* part of both that a joint's own drive has; 0: all */
    double current_loop;                /* s, time constant of the drive's current loop */
    double encoder_noise[PLANT_JOINTS]; /* counts rms, of a sensor that is interpolated */
} plant_electronics;

/* Where concealed effects enter; each may be NULL. All arrays have one entry per joint. */
typedef struct plant_hooks {
    void *self;
    /* Once a step: command torque (N m) → torque that the actuator really gives, in place. */
    void (*actuator)(void *self, double t, double dt, double *torque);
    /* Every evaluation: torque that opposes the drive, added into `extra` (N m). `torque` is the
     * drive's. Must not change state. */
    void (*load)(void *self, double t, const double *q, const double *qd, const double *torque,
                 double *extra);
    /* Once a step, after it: advance own states by dt with the speed of the middle of the step. */
    void (*advance)(void *self, double t, double dt, const double *q, const double *qd);
    /* Once a sample: true position → measured position (rad), in place. */
    void (*sensor)(void *self, double t, double *measured);
} plant_hooks;

typedef struct plant {
    int joints;
    double substep; /* s, longest integration step */
    double t;       /* s since open */
    double q[PLANT_JOINTS], qd[PLANT_JOINTS];
    double z[PLANT_JOINTS];        /* rad, bristle deflection */
    double integral[PLANT_JOINTS]; /* rad, of the drive's speed loop */
    double command[PLANT_JOINTS];  /* N m in torque mode, rad/s in velocity mode */
    int mode;                      /* MACHINE_OFF | MACHINE_TORQUE | MACHINE_VELOCITY */
    double current[PLANT_JOINTS];  /* N m, torque behind the current loop */
    uint64_t random;               /* state of the noise: the same seed and load give the same */
    plant_electronics electronics;
    plant_friction friction[PLANT_JOINTS];
    plant_drive drive[PLANT_JOINTS];
    /* rad, rubber stops beyond the position limits */
    double stop_min[PLANT_JOINTS], stop_max[PLANT_JOINTS];
    double stop_stiffness[PLANT_JOINTS], stop_damping[PLANT_JOINTS]; /* N m/rad, N m s/rad */
    /* Rigid-body law: net joint torque → acceleration. */
    void (*acceleration)(void *self, const double *q, const double *qd, const double *torque,
                         double *qdd);
    void *self;
    /* kg m^2: of a joint, the same at every pose; 0 where the law has no such figure */
    double inertia[PLANT_JOINTS];
    /* What moves beside the joints (may be NULL): stage 0 after the first evaluation, to the middle
     * of the step of h seconds; stage 1 after the second, to its end. */
    void (*others)(void *self, int stage, double h);
    void *others_self;
    /* Hang a point mass on the link of a joint, at `place` in the link's frame (may be NULL).
     * Returns 0, or -1: it cannot hang there. */
    int (*carry)(void *self, int joint, double mass, const double *place);
    void *carry_self;
    plant_hooks hooks;
} plant;

/* ---- noise ---- */

/* splitmix64 (Steele, Lea, Flood 2014): 2^64 different numbers from any seed; uniform in (0, 1). */
static inline double plant_uniform(plant *p) {
    uint64_t z = (p->random += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    z ^= z >> 31;
    return ((double)(z >> 12) + 0.5) / 4503599627370496.0;
}

/* Normal with the given standard deviation (Box and Muller 1958). */
static inline double plant_noise(plant *p, double std) {
    if (std <= 0.0)
        return 0.0;
    const double radius = sqrt(-2.0 * log(plant_uniform(p)));
    return std * radius * cos(6.283185307179586 * plant_uniform(p));
}

/* A number in (0, 1) that belongs to this copy of the machine, by its seed: the same at every
 * opening. */
static inline double plant_copy(const char *config, int which) {
    plant p = {.random =
                   (uint64_t)machine_config_double(config, "seed", 1.0) + ((uint64_t)which << 48)};
    return plant_uniform(&p);
}

/* Config keys load (which opening this is: noise does not begin again), seed, ideal, dac_bits,
 * dac_noise (mV), current_loop (s), encoder_noise (counts); what is not given is `usual`. `range`
 * is the span of the analog output, mV. */
static inline void plant_equip(plant *p, const char *config, const plant_electronics *usual,
                               double range) {
    plant_electronics *e = &p->electronics;
    p->random = (uint64_t)machine_config_double(config, "seed", 1.0)
        + ((uint64_t)machine_config_double(config, "load", 1.0) << 32);
    *e = (plant_electronics){0};
    if (machine_config_double(config, "ideal", 0.0) != 0.0)
        return;
    const double bits = machine_config_double(config, "dac_bits", 0.0);
    e->dac_step = bits > 0.0 ? range / pow(2.0, bits) : usual->dac_step;
    e->dac_noise = machine_config_double(config, "dac_noise", usual->dac_noise);
    e->current_loop = machine_config_double(config, "current_loop", usual->current_loop);
    for (int j = 0; j < p->joints; j++)
        e->encoder_noise[j] =
            machine_config_double(config, "encoder_noise", usual->encoder_noise[j]);
}

/* ---- friction ---- */

/* Sliding level g(qd), N m. */
static inline double plant_level(const plant_friction *f, double qd) {
    const double coulomb = qd >= 0.0 ? f->coulomb_pos : f->coulomb_neg;
    const double breakaway = qd >= 0.0 ? f->breakaway_pos : f->breakaway_neg;
    const double r = f->stribeck > 0.0 ? qd / f->stribeck : 1e3;
    return f->here * (coulomb + (breakaway - coulomb) * exp(-r * r));
}

/* Friction torque, N m, for speed qd and bristle z. */
static inline double plant_friction_torque(const plant_friction *f, double qd, double z) {
    const double viscous = (qd >= 0.0 ? f->viscous_pos : f->viscous_neg) * qd;
    if (f->stiffness <= 0.0)
        return viscous;
    const double g = plant_level(f, qd);
    const double zd = g > 0.0 ? qd - f->stiffness * fabs(qd) * z / g : 0.0;
    const double r = f->stribeck > 0.0 ? qd / f->stribeck : 1e3;
    return f->stiffness * z + f->damping * exp(-r * r) * zd + viscous;
}

/* Exact bristle after h seconds at constant speed. */
static inline double plant_bristle(const plant_friction *f, double qd, double z, double h) {
    const double g = plant_level(f, qd);
    if (f->stiffness <= 0.0 || g <= 0.0)
        return 0.0;
    const double rate = f->stiffness * fabs(qd) / g * h;
    if (rate < 1e-12)
        return z + qd * h;
    const double end = (qd >= 0.0 ? g : -g) / f->stiffness;
    return end + (z - end) * exp(-rate);
}

/* Torque that the drive gives, N m, before concealed effects. */
static inline void plant_drive_torque(const plant *p, const double *qd, double *torque) {
    for (int j = 0; j < p->joints; j++) {
        const plant_drive *d = &p->drive[j];
        double tau = 0.0;
        if (p->mode == MACHINE_TORQUE)
            tau = p->command[j];
        else if (p->mode == MACHINE_VELOCITY)
            tau = d->speed_gain * (p->command[j] - qd[j]) + d->speed_integral * p->integral[j];
        else
            tau = -d->brake * qd[j];
        torque[j] = tau > d->torque_limit    ? d->torque_limit
                    : tau < -d->torque_limit ? -d->torque_limit
                                             : tau;
    }
}

/* Acceleration for state (q, qd, z) under drive torque. */
static inline void plant_evaluate(plant *p, double t, const double *q, const double *qd,
                                  const double *z, const double *torque, double *qdd) {
    double net[PLANT_JOINTS], extra[PLANT_JOINTS] = {0};
    if (p->hooks.load)
        p->hooks.load(p->hooks.self, t, q, qd, torque, extra);
    for (int j = 0; j < p->joints; j++) {
        net[j] = torque[j] - extra[j] - plant_friction_torque(&p->friction[j], qd[j], z[j]);
        if (q[j] > p->stop_max[j])
            net[j] -= p->stop_stiffness[j] * (q[j] - p->stop_max[j]) + p->stop_damping[j] * qd[j];
        else if (q[j] < p->stop_min[j])
            net[j] -= p->stop_stiffness[j] * (q[j] - p->stop_min[j]) + p->stop_damping[j] * qd[j];
    }
    p->acceleration(p->self, q, qd, net, qdd);
}

/* Torque of the drives behind their current loops, N m: the mean over a step of h seconds. */
static inline void plant_current_loop(plant *p, double h, double *torque) {
    const double time = p->electronics.current_loop;
    for (int j = 0; j < p->joints; j++) {
        if (time > 0.0) {
            const double r = h / time, gone = exp(-r), wanted = torque[j];
            torque[j] = wanted + (p->current[j] - wanted) * (1.0 - gone) / r;
            p->current[j] = wanted + (p->current[j] - wanted) * gone;
        } else {
            p->current[j] = torque[j];
        }
    }
}

/* One integration step of h seconds. */
static inline void plant_substep(plant *p, double h) {
    double torque[PLANT_JOINTS], qdd[PLANT_JOINTS], qm[PLANT_JOINTS], vm[PLANT_JOINTS],
        zm[PLANT_JOINTS];
    plant_drive_torque(p, p->qd, torque);
    plant_current_loop(p, h, torque);
    if (p->hooks.actuator)
        p->hooks.actuator(p->hooks.self, p->t, h, torque);
    for (int j = 0; j < p->joints; j++) {
        plant_friction *f = &p->friction[j];
        f->here =
            1.0 + (f->vary != 0.0 ? f->vary * sin(6.283185307179586 * f->turns * p->q[j] + f->phase)
                                  : 0.0);
    }
    plant_evaluate(p, p->t, p->q, p->qd, p->z, torque, qdd);
    for (int j = 0; j < p->joints; j++) {
        vm[j] = p->qd[j] + 0.5 * h * qdd[j];
        qm[j] = p->q[j] + 0.5 * h * p->qd[j];
        zm[j] = plant_bristle(&p->friction[j], vm[j], p->z[j], 0.5 * h);
    }
    if (p->others)
        p->others(p->others_self, 0, h);
    plant_evaluate(p, p->t + 0.5 * h, qm, vm, zm, torque, qdd);
    if (p->others)
        p->others(p->others_self, 1, h);
    for (int j = 0; j < p->joints; j++) {
        p->z[j] = plant_bristle(&p->friction[j], vm[j], p->z[j], h);
        p->q[j] += h * vm[j];
        p->qd[j] += h * qdd[j];
        if (p->mode == MACHINE_VELOCITY) {
            /* conditional integration: a saturated drive does not wind up */
            if (fabs(torque[j]) < p->drive[j].torque_limit)
                p->integral[j] += h * (p->command[j] - vm[j]);
        } else {
            p->integral[j] = 0.0;
        }
    }
    p->t += h;
    if (p->hooks.advance)
        p->hooks.advance(p->hooks.self, p->t, h, qm, vm);
}

/* Let dt seconds pass with the command held. */
static inline void plant_step(plant *p, double dt) {
    const int steps = dt > p->substep ? (int)ceil(dt / p->substep - 1e-9) : 1;
    const double h = dt / steps;
    for (int i = 0; i < steps; i++)
        plant_substep(p, h);
}

/* Measured position of every joint, with sensor effects. */
static inline void plant_measure(plant *p, double *measured) {
    memcpy(measured, p->q, sizeof(double) * (size_t)p->joints);
    if (p->hooks.sensor)
        p->hooks.sensor(p->hooks.self, p->t, measured);
}

/* Encoder counts of the position of joint j: a real encoder counts whole lines passed (floor), not
 * the nearest. */
static inline int32_t plant_counts(plant *p, const machine_info *info, int j, double position) {
    const machine_joint *joint = &info->joint[j];
    const double noise = plant_noise(p, p->electronics.encoder_noise[j]);
    return (int32_t)floor(position * joint->counts_per_unit + joint->zero_counts + noise);
}

/* What the analog output of joint j makes of a number, mV. */
static inline double plant_analog(plant *p, int j, double mv) {
    const plant_electronics *e = &p->electronics;
    const double part = e->finer[j] > 0.0 ? e->finer[j] : 1.0, step = part * e->dac_step;
    const double shown = step > 0.0 ? step * floor(mv / step + 0.5) : mv;
    return shown + plant_noise(p, part * e->dac_noise);
}

/* Take over the actuators: mV → N m or rad/s. A drive that changes into velocity mode starts its
 * loop afresh. */
static inline void plant_command(plant *p, const machine_info *info, const machine_actuators *a) {
    for (int j = 0; j < p->joints; j++) {
        const machine_joint *joint = &info->joint[j];
        const double scale =
            a->mode == MACHINE_VELOCITY ? joint->mv_per_speed : joint->mv_per_torque;
        p->command[j] =
            a->mode == MACHINE_OFF || scale == 0.0 ? 0.0 : plant_analog(p, j, a->aout[j]) / scale;
        if (a->mode != p->mode)
            p->integral[j] = 0.0;
    }
    p->mode = a->mode;
}

/* Homing in the drives' velocity mode: every joint goes to its home position at `gain` (1/s) times
 * the way that is left, `fastest` (rad/s) at most, and is there within `near` (rad). */
static inline int plant_home(const machine_info *info, int joints, double gain, double fastest,
                             double near, const machine_sensors *sensors,
                             machine_actuators *actuators) {
    int there = 1;
    actuators->mode = MACHINE_VELOCITY;
    for (int j = 0; j < joints; j++) {
        const machine_joint *joint = &info->joint[j];
        const double error =
            joint->home - (sensors->enc[j] - joint->zero_counts) / joint->counts_per_unit;
        const double speed = fmin(fmax(gain * error, -fastest), fastest);
        actuators->aout[j] = speed * joint->mv_per_speed;
        if (fabs(error) > near)
            there = 0;
    }
    return there ? MACHINE_HOME_DONE : MACHINE_HOME_BUSY;
}

#endif
