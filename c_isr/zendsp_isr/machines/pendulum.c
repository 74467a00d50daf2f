/* pendulum: a steel bar on the shaft of a brushed DC motor with an adjustable rim brake (Hardware
 * 2025, 3(3), 11).
 *
 *     J qdd + G sin q + friction = k_a i,     v = k_b qd + R_a i,  |v| <= 24 V,  k_b = k_a
 *
 * Motor, supply, current loop, bar, encoder and range and bits of the current sensor, torque limit:
 * figures of the paper. Rotor inertia, bearing friction, breakaway, Stribeck speed, bristle and
 * asymmetry: chosen here, and so are the electronics, as such parts have: a 12-bit command with 1
 * mV rms on the line, one step rms of noise in the current sensor, a bridge that makes voltage in
 * 1024 steps of 47 mV.
 *
 * The drive's own PI current loop runs once a sample, on the current that the 10-bit sensor shows;
 * its voltage is held over the sample. With kp = 5 V/A, ki = 5000 V/(A s) and R_a = 5.54 ohm it
 * settles in two samples.
 *
 * Config keys: ideal, seed, … (plant.h); q1 (rad, 0 hangs down), substep (s), drive (torque: aout
 * is a torque reference for the current loop; voltage: aout is the motor's voltage and the current
 * loop is the user's), brake (N m, level of the rim brake), friction, effect1, effect2, … Analog
 * inputs: 0 current, A; 1 voltage, V.
 */
#include <stdio.h>  /* snprintf */
#include <stdlib.h> /* calloc, free */

#include "concealed.h"
#include "machine.h"
#include "machine_config.h"
#include "plant.h"

static const double k_a = 0.1762, R_a = 5.54;             /* N m/A = V s/rad; ohm */
static const double supply = 24.0;                        /* V */
static const double loop_kp = 5.0, loop_ki = 5000.0;      /* V/A, V/(A s) */
static const double torque_max = 0.8;                     /* N m */
static const double inertia = 2.07e-3, gravity = 0.16677; /* kg m^2, bar and rotor; N m, m g L/2 */
static const double bearing = 0.02;                       /* N m, Coulomb without the brake */
/* mV for torque_max, or for the supply voltage */
static const double full_scale = 10000.0;
static const double turn_counts = 4096.0, two_pi = 6.283185307179586;
static const double sensor_range = 5.0, sensor_steps = 1024.0; /* A, from -5 to 5 in 10 bits */

/* its current loop is its own */
static const plant_electronics usual = {.dac_step = 20000.0 / 4096.0, .dac_noise = 1.0};
static const double bridge_steps = 1024.0; /* of the supply, both signs */

typedef struct pendulum {
    plant plant;
    machine_info info;
    concealed concealed;
    double inertia, gravity; /* kg m^2, N m, with what it carries */
    int ideal;
    double period;   /* s */
    int by_voltage;  /* 1: the command is a voltage */
    double voltage;  /* V, held over the sample */
    double integral; /* V, of the current loop */
    double current;  /* A, at the last conversion */
} pendulum;

static void acceleration(void *self, const double *q, const double *qd, const double *torque,
                         double *qdd) {
    const pendulum *m = self;
    (void)qd;
    qdd[0] = (torque[0] - m->gravity * sin(q[0])) / m->inertia;
}

/* A point mass on the bar, x along it from the shaft. */
static int carry(void *self, int joint, double mass, const double *place) {
    pendulum *m = self;
    (void)joint;
    if (place[1] != 0.0)
        return -1;
    m->inertia += mass * place[0] * place[0];
    m->gravity += 9.81 * mass * place[0];
    return 0;
}

static int powered(const pendulum *m) { return m->plant.mode != MACHINE_OFF; }

static double true_current(const pendulum *m) {
    return powered(m) ? (m->voltage - k_a * m->plant.qd[0]) / R_a : 0.0;
}

/* What 10 bits make of it. */
static double measured_current(pendulum *m) {
    const double step = 2.0 * sensor_range / sensor_steps;
    const double seen = true_current(m) + (m->ideal ? 0.0 : plant_noise(&m->plant, step));
    const double i = floor(seen / step + 0.5) * step;
    return i > sensor_range - step ? sensor_range - step : i < -sensor_range ? -sensor_range : i;
}

static double clip(double x, double limit) { return x > limit ? limit : x < -limit ? -limit : x; }

/* What the bridge makes of a voltage. */
static double bridge(const pendulum *m, double voltage) {
    const double step = 2.0 * supply / bridge_steps;
    return m->ideal ? clip(voltage, supply) : clip(step * floor(voltage / step + 0.5), supply);
}

/* Hooks of the plant: the stall torque of the held voltage, and what the back-EMF takes off it. */
static void stall_torque(void *self, double t, double dt, double *torque) {
    (void)t;
    (void)dt;
    const pendulum *m = self;
    torque[0] = powered(m) ? k_a * m->voltage / R_a : 0.0;
}

static void back_emf(void *self, double t, const double *q, const double *qd, const double *torque,
                     double *extra) {
    (void)t;
    (void)q;
    (void)torque;
    if (powered(self))
        extra[0] += k_a * k_a / R_a * qd[0];
}

/* Once a sample: the command's way through the drive to a voltage. */
static void drive(pendulum *m) {
    double u[PLANT_JOINTS] = {0};
    if (!powered(m)) {
        m->voltage = m->integral = 0.0;
        return;
    }
    if (m->by_voltage && m->plant.mode == MACHINE_TORQUE) {
        u[0] = m->plant.command[0];
        concealed_command(&m->concealed, m->plant.t, m->period, u);
        m->voltage = bridge(m, u[0]);
        m->integral = 0.0;
        return;
    }
    plant_drive_torque(&m->plant, m->plant.qd, u); /* N m: the command, or that of the speed loop */
    concealed_command(&m->concealed, m->plant.t, m->period, u);
    const double error = clip(u[0], torque_max) / k_a - m->current;
    const double wanted = loop_kp * error + m->integral;
    m->voltage = bridge(m, wanted);
    if (fabs(wanted) < supply) /* the integrator rests while the voltage is at its limit */
        m->integral += loop_ki * m->period * error;
}

static void describe(machine_info *info, int by_voltage) {
    machine_joint *joint = &info->joint[0];
    snprintf(info->name, sizeof info->name, "pendulum");
    snprintf(info->text, sizeof info->text,
             "Pendulum on a DC motor with a rim brake (simulated); the command is a %s.",
             by_voltage ? "voltage" : "torque");
    info->simulated = 1;
    info->joints = 1;
    info->adcs = 2;
    info->dins = 8;
    info->douts = 8;
    info->stop_input = -1;
    snprintf(info->adc_name[0], sizeof info->adc_name[0], "current");
    snprintf(info->adc_unit[0], sizeof info->adc_unit[0], "A");
    snprintf(info->adc_name[1], sizeof info->adc_name[1], "voltage");
    snprintf(info->adc_unit[1], sizeof info->adc_unit[1], "V");
    snprintf(joint->name, sizeof joint->name, "joint 1");
    snprintf(joint->unit, sizeof joint->unit, "rad");
    snprintf(joint->command, sizeof joint->command, by_voltage ? "voltage" : "torque");
    joint->counts_per_unit = turn_counts / two_pi;
    joint->mv_per_torque = by_voltage ? 0.0 : full_scale / torque_max;
    joint->mv_per_speed = full_scale / 100.0;
    joint->command_max = full_scale;
    joint->position_min = -1000.0; /* the shaft turns freely: a bound against runaway only */
    joint->position_max = 1000.0;
    joint->speed_max = 100.0;
    joint->torque_max = torque_max;
    joint->length = 0.170;
    joint->inertia = inertia;
}

static void make_plant(pendulum *m, double brake) {
    plant *p = &m->plant;
    const double level = bearing + (brake > 0.0 ? brake : 0.0);
    p->joints = 1;
    p->acceleration = acceleration;
    p->friction[0] = (plant_friction){.coulomb_pos = 1.04 * level,
                                      .coulomb_neg = 0.96 * level,
                                      .breakaway_pos = 1.27 * level,
                                      .breakaway_neg = 1.19 * level,
                                      .stribeck = 0.35,
                                      .stiffness = 200.0 * level,
                                      .damping = 0.05,
                                      .viscous_pos = 0.0052,
                                      .viscous_neg = 0.0048};
    p->drive[0] =
        (plant_drive){.torque_limit = torque_max, .speed_gain = 0.05, .speed_integral = 0.5};
    p->stop_min[0] = -HUGE_VAL;
    p->stop_max[0] = HUGE_VAL;
    p->hooks = (plant_hooks){.self = m, .actuator = stall_torque, .load = back_emf};
}

static int pendulum_open(void **handle, const char *config, double period, machine_info *info,
                         char *error, size_t error_size) {
    char command[16] = "torque";
    machine_config_text(config, "drive", command, sizeof command);
    if (strcmp(command, "torque") != 0 && strcmp(command, "voltage") != 0) {
        snprintf(error, error_size, "pendulum: drive is '%s'; expected torque or voltage", command);
        return -1;
    }
    pendulum *m = calloc(1, sizeof *m);
    if (!m) {
        snprintf(error, error_size, "pendulum: out of memory");
        return -1;
    }
    m->period = period;
    m->by_voltage = strcmp(command, "voltage") == 0;
    describe(&m->info, m->by_voltage);
    m->inertia = inertia;
    m->gravity = gravity;
    m->ideal = machine_config_double(config, "ideal", 0.0) != 0.0;
    make_plant(m, machine_config_double(config, "brake", 0.08));
    m->plant.self = m->plant.carry_self = m;
    m->plant.carry = carry;
    plant_equip(&m->plant, config, &usual, 2.0 * full_scale);
    m->plant.q[0] = machine_config_double(config, "q1", 0.0);
    m->plant.substep = machine_config_double(config, "substep", 1e-4);
    if (concealed_attach(&m->concealed, &m->plant, config, error, error_size) != 0) {
        free(m);
        return -1;
    }
    *info = m->info;
    *handle = m;
    return 0;
}

static void pendulum_read(void *handle, machine_sensors *sensors) {
    pendulum *m = handle;
    double measured[PLANT_JOINTS];
    plant_measure(&m->plant, measured);
    m->current = measured_current(m);
    sensors->enc[0] = plant_counts(&m->plant, &m->info, 0, measured[0]);
    sensors->adc[0] = m->current;
    sensors->adc[1] = m->voltage;
    sensors->din = 0;
    sensors->fault = 0;
}

static void pendulum_write(void *handle, const machine_actuators *actuators) {
    pendulum *m = handle;
    plant_command(&m->plant, &m->info, actuators);
    if (m->by_voltage && actuators->mode == MACHINE_TORQUE)
        m->plant.command[0] = plant_analog(&m->plant, 0, actuators->aout[0]) * supply / full_scale;
}

static void pendulum_step(void *handle, double dt) {
    pendulum *m = handle;
    drive(m);
    plant_step(&m->plant, dt);
}

static void pendulum_safe(void *handle) {
    const machine_actuators stand_still = {.mode = MACHINE_VELOCITY};
    pendulum_write(handle, &stand_still);
}

static void pendulum_close(void *handle) { free(handle); }

const machine_ops zendsp_machine = {
    .abi = MACHINE_ABI,
    .open = pendulum_open,
    .read = pendulum_read,
    .write = pendulum_write,
    .step = pendulum_step,
    .safe = pendulum_safe,
    .home = NULL, /* the bar hangs down when the encoder is switched on */
    .close = pendulum_close,
};
