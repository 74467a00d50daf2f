/* imi_planar: planar arm, two direct-drive revolute joints on vertical axes (IMI Corp., NSK
 * Megatorque motors).
 *
 *     M(q) qdd + C(q, qd) qd + friction = tau,
 *     M = [[p1 + 2 p3 cos q2, p2 + p3 cos q2], [p2 + p3 cos q2, p2]]
 *
 * No gravity (vertical axes). Total length, position limits, modes of the drives: the paper of
 * Bona, Indri and Smaldone. Inertias, viscous and Coulomb levels: the model of the IMI arm in the
 * adaptive-control literature; the paper prints none. Torque limits: NSK Megatorque class. Chosen
 * here: speed limits; breakaway, Stribeck speed, bristle stiffness, asymmetry, so that the
 * published experiments find what they found; how friction varies with place (5 %, 14 waves a turn,
 * their phase by the seed); electronics, as such parts have: 16-bit analog output over ±10 V with 1
 * mV rms on the line, current loop of 1 kHz (the paper: much faster than the sample), a resolver
 * that is interpolated to a third of a count rms.
 *
 * Config keys: q1, q2 (start position, rad), substep (s), din (digital inputs, bits); ideal, seed,
 * … (plant.h); friction, effect1, … (concealed.h).
 */
#include <stdio.h>  /* snprintf */
#include <stdlib.h> /* calloc, free */

#include "concealed.h"
#include "machine.h"
#include "machine_config.h"
#include "plant.h"

static const double p1 = 3.473, p2 = 0.196, p3 = 0.242; /* kg m^2 */
static const double length[2] = {0.36, 0.34};           /* m */
static const plant_electronics usual = {.dac_step = 20000.0 / 65536.0,
                                        .dac_noise = 1.0,
                                        .current_loop = 1.6e-4,
                                        .encoder_noise = {0.33, 0.33}};
/* resolver, interpolated to encoder signals by the drive box */
static const double counts_per_turn = 153600.0;
/* mV, command that gives the torque limit (or speed limit) */
static const double full_scale = 10000.0;
static const double two_pi = 6.283185307179586;

typedef struct imi {
    plant plant;
    machine_info info;
    uint32_t din;
    concealed concealed;
    double p1, p2, p3, p4; /* kg m^2, with what it carries; p4 goes with sin q2 */
} imi;

static void acceleration(void *self, const double *q, const double *qd, const double *torque,
                         double *qdd) {
    const imi *m = self;
    const double c = m->p3 * cos(q[1]) - m->p4 * sin(q[1]),
                 s = m->p3 * sin(q[1]) + m->p4 * cos(q[1]);
    const double m11 = m->p1 + 2.0 * c, m12 = m->p2 + c, m22 = m->p2;
    /* Coriolis and centrifugal: [-s qd2 (2 qd1 + qd2), s qd1^2] */
    const double b1 = torque[0] + s * qd[1] * (2.0 * qd[0] + qd[1]);
    const double b2 = torque[1] - s * qd[0] * qd[0];
    const double det = m11 * m22 - m12 * m12;
    qdd[0] = (m22 * b1 - m12 * b2) / det;
    qdd[1] = (m11 * b2 - m12 * b1) / det;
}

/* A point mass on a link: x along it from its joint, y across. */
static int carry(void *self, int joint, double mass, const double *place) {
    imi *m = self;
    const double x = place[0], y = place[1], square = mass * (x * x + y * y);
    if (joint == 0) {
        m->p1 += square;
    } else {
        m->p1 += mass * length[0] * length[0] + square;
        m->p2 += square;
        m->p3 += mass * length[0] * x;
        m->p4 += mass * length[0] * y;
    }
    return 0;
}

static void describe(machine_info *info) {
    static const double torque_max[2] = {245.0, 39.2}, speed_max[2] = {9.0, 15.0};
    snprintf(info->name, sizeof info->name, "imi_planar");
    snprintf(info->text, sizeof info->text,
             "Planar arm, two direct-drive revolute joints on vertical axes (simulated).");
    info->simulated = 1;
    info->joints = 2;
    info->dins = 8;
    info->douts = 8;
    info->stop_input = 0;
    info->stop_level = 1;
    for (int j = 0; j < 2; j++) {
        machine_joint *joint = &info->joint[j];
        snprintf(joint->name, sizeof joint->name, "joint %d", j + 1);
        snprintf(joint->unit, sizeof joint->unit, "rad");
        snprintf(joint->command, sizeof joint->command, "torque");
        joint->counts_per_unit = counts_per_turn / two_pi;
        joint->mv_per_torque = full_scale / torque_max[j];
        joint->mv_per_speed = full_scale / speed_max[j];
        joint->command_max = full_scale;
        joint->position_min = -2.15;
        joint->position_max = 2.15;
        joint->speed_max = speed_max[j];
        joint->torque_max = torque_max[j];
        joint->length = length[j];
        joint->inertia = j == 0 ? p1 + 2.0 * p3 : p2;
    }
}

static void make_plant(plant *p, const machine_info *info, const char *config) {
    static const plant_friction friction[2] = {
        {.coulomb_pos = 8.45 * 1.05,
         .coulomb_neg = 8.45 * 0.95,
         .breakaway_pos = 11.4 * 1.05,
         .breakaway_neg = 11.4 * 0.95,
         .stribeck = 0.08,
         .stiffness = 12000.0,
         .damping = 60.0,
         .viscous_pos = 5.3 * 1.02,
         .viscous_neg = 5.3 * 0.98},
        {.coulomb_pos = 2.35 * 0.96,
         .coulomb_neg = 2.35 * 1.04,
         .breakaway_pos = 3.1 * 0.96,
         .breakaway_neg = 3.1 * 1.04,
         .stribeck = 0.10,
         .stiffness = 1500.0,
         .damping = 6.0,
         .viscous_pos = 1.1 * 0.97,
         .viscous_neg = 1.1 * 1.03},
    };
    static const double speed_gain[2] = {400.0, 30.0};
    const int ideal = machine_config_double(config, "ideal", 0.0) != 0.0;
    p->joints = 2;
    p->acceleration = acceleration;
    plant_equip(p, config, &usual, 2.0 * full_scale);
    for (int j = 0; j < 2; j++) {
        p->friction[j] = friction[j];
        if (!ideal) {
            p->friction[j].vary = 0.05;
            p->friction[j].turns = 14.0 / two_pi;
            p->friction[j].phase = two_pi * plant_copy(config, j + 1);
        }
        p->drive[j] = (plant_drive){.torque_limit = info->joint[j].torque_max,
                                    .speed_gain = speed_gain[j],
                                    .speed_integral = 10.0 * speed_gain[j],
                                    .brake = 0.0};
        p->stop_min[j] = info->joint[j].position_min - 0.1;
        p->stop_max[j] = info->joint[j].position_max + 0.1;
        p->stop_stiffness[j] = 100.0 * info->joint[j].torque_max;
        p->stop_damping[j] = 2.0 * info->joint[j].torque_max;
    }
}

static int imi_open(void **handle, const char *config, double period, machine_info *info,
                    char *error, size_t error_size) {
    (void)period;
    imi *m = calloc(1, sizeof *m);
    if (!m) {
        snprintf(error, error_size, "imi_planar: out of memory");
        return -1;
    }
    describe(&m->info);
    make_plant(&m->plant, &m->info, config);
    m->plant.self = m->plant.carry_self = m;
    m->plant.carry = carry;
    m->plant.inertia[0] = p1;
    m->plant.inertia[1] = p2;
    m->p1 = p1;
    m->p2 = p2;
    m->p3 = p3;
    m->plant.q[0] = machine_config_double(config, "q1", 0.0);
    m->plant.q[1] = machine_config_double(config, "q2", 0.0);
    m->plant.substep = machine_config_double(config, "substep", 1e-4);
    m->din = (uint32_t)machine_config_double(config, "din", 0.0);
    if (concealed_attach(&m->concealed, &m->plant, config, error, error_size) != 0) {
        free(m);
        return -1;
    }
    *info = m->info;
    *handle = m;
    return 0;
}

static void imi_read(void *handle, machine_sensors *sensors) {
    imi *m = handle;
    double measured[PLANT_JOINTS];
    plant_measure(&m->plant, measured);
    for (int j = 0; j < 2; j++)
        sensors->enc[j] = plant_counts(&m->plant, &m->info, j, measured[j]);
    sensors->din = m->din;
    sensors->fault = 0;
}

static void imi_write(void *handle, const machine_actuators *actuators) {
    imi *m = handle;
    plant_command(&m->plant, &m->info, actuators);
}

static void imi_step(void *handle, double dt) { plant_step(&((imi *)handle)->plant, dt); }

static void imi_safe(void *handle) {
    const machine_actuators stand_still = {.mode = MACHINE_VELOCITY};
    imi_write(handle, &stand_still);
}

/* Homing: both joints at a gentle speed to their home position. */
static int imi_home(void *handle, const machine_sensors *sensors, machine_actuators *actuators) {
    return plant_home(&((imi *)handle)->info, 2, 4.0, 0.5, 1e-3, sensors, actuators);
}

static void imi_close(void *handle) { free(handle); }

const machine_ops zendsp_machine = {
    .abi = MACHINE_ABI,
    .open = imi_open,
    .read = imi_read,
    .write = imi_write,
    .step = imi_step,
    .safe = imi_safe,
    .home = imi_home,
    .close = imi_close,
};
