/* Two motors behind voltages: a shaft of +-3 rad, and a slide of +-0.2 m that stands upright. Each
 * tells its current and its voltage through 12 bits.
 *
 *     L di/dt = v - R i - k qd,   m qdd = k i - weight - coulomb sign(qd) - viscous qd
 */
#include <math.h>   /* floor, tanh */
#include <stdio.h>  /* snprintf */
#include <stdlib.h> /* calloc, free */

#include "machine.h"

static const double R[2] = {2.0, 3.0}, k[2] = {0.05, 8.0}, L[2] = {1e-3, 2e-3}; /* ohm, N m/A, H */
static const double mass[2] = {2e-4, 0.5}, weight[2] = {0.0, 4.905};            /* kg m^2, N */
static const double coulomb[2] = {0.01, 1.0}, viscous[2] = {1e-4, 2.0};
static const double counts[2] = {16384 / 6.283185307179586, 1e6}, supply = 24.0;

typedef struct motors {
    double q[2], qd[2], i[2], v[2];
} motors;

static void joint(machine_joint *j, const char *name, const char *unit, double range,
                  double speed) {
    snprintf(j->name, sizeof j->name, "%s", name);
    snprintf(j->unit, sizeof j->unit, "%s", unit);
    snprintf(j->command, sizeof j->command, "voltage");
    j->command_max = 10000.0;
    j->position_min = -range;
    j->position_max = range;
    j->speed_max = speed;
}

static int motors_open(void **handle, const char *config, double period, machine_info *info,
                       char *error, size_t size) {
    (void)config;
    (void)period;
    motors *m = calloc(1, sizeof *m);
    if (!m) {
        snprintf(error, size, "out of memory");
        return -1;
    }
    snprintf(info->name, sizeof info->name, "motors");
    info->simulated = 1;
    info->joints = 2;
    info->adcs = 4;
    info->stop_input = -1;
    for (int a = 0; a < 4; a++) {
        snprintf(info->adc_name[a], sizeof info->adc_name[a], a < 2 ? "current %d" : "voltage %d",
                 a % 2 + 1);
        snprintf(info->adc_unit[a], sizeof info->adc_unit[a], a < 2 ? "A" : "V");
    }
    joint(&info->joint[0], "shaft", "rad", 3.0, 100.0);
    joint(&info->joint[1], "slide", "m", 0.2, 1.5);
    for (int j = 0; j < 2; j++)
        info->joint[j].counts_per_unit = counts[j];
    *handle = m;
    return 0;
}

static double seen(double x, double range) {
    return floor(x / range * 2048.0 + 0.5) / 2048.0 * range;
}

static void motors_read(void *handle, machine_sensors *s) {
    motors *m = handle;
    for (int j = 0; j < 2; j++) {
        s->enc[j] = (int32_t)floor(m->q[j] * counts[j]);
        s->adc[j] = seen(m->i[j], 10.0);
        s->adc[2 + j] = seen(m->v[j], 30.0);
    }
}

static void motors_write(void *handle, const machine_actuators *u) {
    motors *m = handle;
    for (int j = 0; j < 2; j++)
        m->v[j] = u->mode == MACHINE_TORQUE ? u->aout[j] * supply / 10000.0 : 0.0;
}

static void motors_step(void *handle, double dt) {
    motors *m = handle;
    for (int n = 0; n < 20; n++)
        for (int j = 0; j < 2; j++) {
            m->i[j] += dt / 20 * (m->v[j] - R[j] * m->i[j] - k[j] * m->qd[j]) / L[j];
            const double dry = coulomb[j] * tanh(1e3 * m->qd[j]);
            m->qd[j] += dt / 20 * (k[j] * m->i[j] - weight[j] - dry - viscous[j] * m->qd[j])
                / mass[j];
            m->q[j] += dt / 20 * m->qd[j];
        }
}

static void motors_safe(void *handle) {
    motors *m = handle;
    m->v[0] = m->v[1] = 0.0;
}

const machine_ops zendsp_machine = {.abi = MACHINE_ABI, .open = motors_open, .read = motors_read,
    .write = motors_write, .step = motors_step, .safe = motors_safe, .close = free};
