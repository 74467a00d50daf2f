/* wam7: the Barrett WAM, seven joints, without a hand unless it is asked for.
 *
 *     M(q) qdd + C(q, qd) qd + g(q) + friction = tau
 *
 * Links: Barrett AC-02; rotors: wam7_dynamics.h. Limits of position and torque: Barrett's figures
 * for the arm, not of the paper. Coulomb and viscous friction for each direction: the table of the
 * 7-DOF whole-arm paper; where its viscous value is negative (an artefact of its narrow speed
 * range) a value is chosen here, as are breakaway, Stribeck speed and bristle of every joint.
 *
 * An arm is never quite its data sheet: cables, screws and covers. Masses here differ from the
 * sheet by 1 to 5 %, centres of mass by 1 to 4 mm (chosen), so that a gravity compensation from the
 * sheet is off by some per cent. friction = plain, or ideal = 1: the sheet's arm, without rotors.
 * hand = 1 hangs the Barrett hand on link 7: 1.2 kg, taken as a point 58 mm before the flange
 * (chosen).
 *
 * Electronics, as such parts have: torque commands in 4096 steps, half a step of noise, current
 * loop of 1 kHz. The encoders are optical and count without noise.
 *
 * Encoders: 4096 counts a turn of the motor, on the motor side of the cable transmission, as on the
 * real arm: times the ratio of the drive (42, 28.25, 28.25, 18, 9.48, 9.48, 14.93), 27 380 to 6 180
 * counts a radian at the joint.
 *
 * Config keys: q1 … q7 (start position, rad), hand, substep (s); ideal, seed, … (plant.h);
 * friction, effect1, … (concealed.h).
 */
#include <stdio.h>  /* snprintf */
#include <stdlib.h> /* calloc, free */

#include "concealed.h"
#include "machine.h"
#include "machine_config.h"
#include "plant.h"
#include "wam7_dynamics.h"

/* mV, command that gives the torque limit (or the speed limit) */
static const double full_scale = 10000.0;
static const double two_pi = 6.283185307179586;

/* motor turns a joint turn */
static const double ratio[WAM7] = {42.0, 28.25, 28.25, 18.0, 9.48, 9.48, 14.93};
static const double position_min[WAM7] = {-2.6, -2.0, -2.8, -0.9, -4.76, -1.6, -3.0};
static const double position_max[WAM7] = {2.6, 2.0, 2.8, 3.1, 1.24, 1.6, 3.0};
static const double torque_max[WAM7] = {77.3, 160.6, 95.6, 29.4, 11.6, 11.6, 2.7};
static const double speed_max[WAM7] = {3.0, 3.0, 3.0, 3.0, 6.0, 6.0, 6.0};     /* rad/s, chosen */
static const double home[WAM7] = {0.0, -1.9, 0.0, 3.0, 0.0, 0.0, 0.0};         /* rad, folded */
/* kg m^2, what a joint turns: to tune drives */
static const double about[WAM7] = {1.0, 1.2, 0.05, 0.13, 7e-4, 7e-4, 7.4e-5};
/* chosen: what the drives' speed loops are tuned for, some of 3 kg in the hand; tuned for the arm
 * alone, the wrist swings with them and homing never ends */
static const double borne[WAM7] = {1.0, 1.2, 0.2, 0.5, 0.03, 0.03, 0.003};
static const double coulomb_pos[WAM7] = {4.4748, 2.6385, 1.7399, 1.5414, 0.2798, 0.4834, 0.0538};
static const double coulomb_neg[WAM7] = {4.3609, 3.5643, 2.3529, 0.7342, 0.1172, 0.4417, 0.1370};
/* joints 4, 5: chosen */
static const double viscous_pos[WAM7] = {1.3348, 3.5572, 0.3944, 0.50, 0.30, 0.8291, 1.0689};
/* joints 2, 4: chosen */
static const double viscous_neg[WAM7] = {0.8266, 2.80, 1.2075, 0.45, 1.467, 0.1836, 0.7954};

static const plant_electronics usual = {
    .dac_step = 20000.0 / 4096.0, .dac_noise = 2.44, .current_loop = 1.6e-4};
/* of the sheet's */
static const double more_mass[WAM7] = {0.012, -0.015, 0.02, 0.025, 0.05, -0.03, 0.04};
static const double moved[WAM7][3] = {
    {0.001, 0.002, -0.001}, {0.002, -0.001, 0.002}, {-0.001, 0.004, 0.001}, {0.002, 0.001, 0.004},
    {0.001, 0.0, -0.001},   {0.0, 0.002, 0.001},    {0.001, -0.001, 0.0}}; /* m */
/* kg; m, frame 7 */
static const double hand_mass = 1.2, hand_place[3] = {0.0, 0.0, 0.058};

typedef struct wam {
    plant plant;
    machine_info info;
    concealed concealed;
    wam7_arm arm;
} wam;

static void acceleration(void *self, const double *q, const double *qd, const double *torque,
                         double *qdd) {
    wam7_forward(&((const wam *)self)->arm, q, qd, torque, qdd);
}

static int carry(void *self, int joint, double mass, const double *place) {
    wam7_carry(&((wam *)self)->arm.link[joint], mass, place);
    return 0;
}

static int has_hand(const char *config) {
    return machine_config_double(config, "hand", 0.0) != 0.0;
}

/* The arm that stands there. */
static void make_arm(wam *m, const char *config) {
    char friction[16] = "full";
    machine_config_text(config, "friction", friction, sizeof friction);
    const int ideal = machine_config_double(config, "ideal", 0.0) != 0.0;
    m->arm = wam7_published;
    for (int k = 0; k < WAM7 && !ideal && strcmp(friction, "plain") != 0; k++) {
        m->arm.rotor[k] = wam7_rotor[k];
        m->arm.link[k].mass *= 1.0 + more_mass[k];
        for (int i = 0; i < 3; i++)
            m->arm.link[k].com[i] += moved[k][i];
    }
    if (has_hand(config))
        wam7_carry(&m->arm.link[WAM7 - 1], hand_mass, hand_place);
}

static void describe(machine_info *info, const char *config) {
    snprintf(info->name, sizeof info->name, "wam7");
    snprintf(info->text, sizeof info->text, "Barrett WAM, seven joints, %s hand (simulated).",
             has_hand(config) ? "with its" : "no");
    info->simulated = 1;
    info->joints = WAM7;
    info->dins = 8;
    info->douts = 8;
    info->stop_input = 0;
    info->stop_level = 1;
    for (int j = 0; j < WAM7; j++) {
        machine_joint *joint = &info->joint[j];
        snprintf(joint->name, sizeof joint->name, "joint %d", j + 1);
        snprintf(joint->unit, sizeof joint->unit, "rad");
        snprintf(joint->command, sizeof joint->command, "torque");
        joint->counts_per_unit = 4096.0 * ratio[j] / two_pi;
        joint->mv_per_torque = full_scale / torque_max[j];
        joint->mv_per_speed = full_scale / speed_max[j];
        joint->command_max = full_scale;
        joint->position_min = position_min[j];
        joint->position_max = position_max[j];
        joint->speed_max = speed_max[j];
        joint->torque_max = torque_max[j];
        joint->home = home[j];
        joint->inertia = about[j];
    }
}

static void make_plant(plant *p) {
    p->joints = WAM7;
    p->acceleration = acceleration;
    for (int j = 0; j < WAM7; j++) {
        const double level = 0.5 * (coulomb_pos[j] + coulomb_neg[j]);
        const double bristle = 1.3 * level / 0.004; /* N m/rad: breaks away after 4 mrad */
        const double stop = 20.0 * torque_max[j];
        p->friction[j] = (plant_friction){.coulomb_pos = coulomb_pos[j],
                                          .coulomb_neg = coulomb_neg[j],
                                          .breakaway_pos = 1.3 * coulomb_pos[j],
                                          .breakaway_neg = 1.3 * coulomb_neg[j],
                                          .stribeck = 0.03,
                                          .stiffness = bristle,
                                          .damping = 0.6 * sqrt(bristle * about[j]),
                                          .viscous_pos = viscous_pos[j],
                                          .viscous_neg = viscous_neg[j]};
        p->drive[j] = (plant_drive){.torque_limit = torque_max[j],
                                    .speed_gain = 60.0 * borne[j],
                                    .speed_integral = 1200.0 * borne[j],
                                    .brake = 5.0 * about[j]};
        p->stop_min[j] = position_min[j] - 0.05;
        p->stop_max[j] = position_max[j] + 0.05;
        p->stop_stiffness[j] = stop;
        p->stop_damping[j] = 0.6 * sqrt(stop * about[j]);
    }
}

static int wam_open(void **handle, const char *config, double period, machine_info *info,
                    char *error, size_t error_size) {
    (void)period;
    wam *m = calloc(1, sizeof *m);
    if (!m) {
        snprintf(error, error_size, "wam7: out of memory");
        return -1;
    }
    describe(&m->info, config);
    make_arm(m, config);
    make_plant(&m->plant);
    m->plant.self = m->plant.carry_self = m;
    m->plant.carry = carry;
    plant_equip(&m->plant, config, &usual, 2.0 * full_scale);
    for (int j = 0; j < WAM7; j++) {
        char key[8];
        snprintf(key, sizeof key, "q%d", j + 1);
        m->plant.q[j] = machine_config_double(config, key, home[j]);
    }
    /* joint 7 has a time constant of 70 us: 1.07 N m s/rad on 7.4e-5 kg m^2 */
    m->plant.substep = machine_config_double(config, "substep", 5e-5);
    if (concealed_attach(&m->concealed, &m->plant, config, error, error_size) != 0) {
        free(m);
        return -1;
    }
    *info = m->info;
    *handle = m;
    return 0;
}

static void wam_read(void *handle, machine_sensors *sensors) {
    wam *m = handle;
    double measured[PLANT_JOINTS];
    plant_measure(&m->plant, measured);
    for (int j = 0; j < WAM7; j++)
        sensors->enc[j] = plant_counts(&m->plant, &m->info, j, measured[j]);
    sensors->din = 0;
    sensors->fault = 0;
}

static void wam_write(void *handle, const machine_actuators *actuators) {
    wam *m = handle;
    plant_command(&m->plant, &m->info, actuators);
}

static void wam_step(void *handle, double dt) { plant_step(&((wam *)handle)->plant, dt); }

static void wam_safe(void *handle) {
    const machine_actuators stand_still = {.mode = MACHINE_VELOCITY};
    wam_write(handle, &stand_still);
}

/* Homing: all joints at a gentle speed to the folded position. */
static int wam_home(void *handle, const machine_sensors *sensors, machine_actuators *actuators) {
    return plant_home(&((wam *)handle)->info, WAM7, 3.0, 0.6, 2e-3, sensors, actuators);
}

static void wam_close(void *handle) { free(handle); }

const machine_ops zendsp_machine = {
    .abi = MACHINE_ABI,
    .open = wam_open,
    .read = wam_read,
    .write = wam_write,
    .step = wam_step,
    .safe = wam_safe,
    .home = wam_home,
    .close = wam_close,
};
