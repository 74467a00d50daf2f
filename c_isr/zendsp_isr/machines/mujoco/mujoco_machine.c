/* mujoco_machine: any MuJoCo model (MJCF, or URDF as MuJoCo reads it) as a simulated machine:
 * zendsp target --machine arm.xml
 *
 *     M(q) qdd + c(q, qd) + contacts, springs, … = tau_drive − friction − concealed effects
 *     (left: MuJoCo, mujoco_robot.h)                (right: plant.h)
 *
 * MuJoCo gives the acceleration. The joints with a motor are integrated by the plant that all
 * simulated machines share, so that drives, electronics, friction and concealed effects are the
 * same as theirs; what else moves is integrated beside them (`others`). Two things are taken out of
 * MuJoCo's hands:
 *
 *     frictionloss, damping    become friction of the plant: MuJoCo's own dry friction is
 *                              regularised and creeps under load
 *     actuators at the joints  become torque drives; gains, servos and activation are dropped,
 *                              limits and gear are kept
 *
 * Joints of the machine: those with an actuator, in the order of the file; without any actuator all
 * hinges and slides; or those that the key `joints` names. Actuators that are not taken over hold
 * the control of the keyframe.
 *
 * Analog inputs: the scalars of the model's sensors, in the order of the file, the first eight.
 *
 * Config keys: model (path), clock, joints (names, by comma), keyframe (name), q1 … (start), counts
 * (encoder, a turn or a metre), speed_max, torque_max (of every joint), speeds (by name, as a URDF
 * states them), substep (s), din (bits),
 * those of plant.h and concealed.h.
 */
#include <float.h>  /* DBL_MAX */
#include <math.h>   /* fabs, fmin, isfinite */
#include <setjmp.h> /* MuJoCo's errors while it loads */
#include <stdio.h>  /* snprintf */
#include <stdlib.h> /* calloc, free */
#include <string.h> /* strcmp, strstr */
#include <time.h>   /* clock_gettime */

#include <mujoco/mujoco.h>

#include "concealed.h"
#include "machine.h"
#include "machine_config.h"
#include "mujoco_model.h"
#include "mujoco_read.h"
#include "mujoco_robot.h"
#include "plant.h"

enum { TRIALS = 40 }; /* samples that are timed at the start */

/* 16-bit analog output, a millivolt of noise on the line, current loop of 1 kHz, interpolated
 * encoder: usual, chosen here. */
static const plant_electronics usual = {.dac_step = 20000.0 / 65536.0,
                                        .dac_noise = 1.0,
                                        .current_loop = 1.6e-4,
                                        .encoder_noise = {0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5}};

/* ---- the time a sample takes ---- */

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void robot_read(void *handle, machine_sensors *sensors);

/* Shortest time of a sample, s; leaves no trace. */
static double time_sample(robot *r, double period) {
    mjData *kept = mj_copyData(NULL, r->model, r->data);
    const plant before = r->plant;
    machine_sensors sensors;
    double best = DBL_MAX;
    const double began = seconds();
    for (int i = 0; i < TRIALS && seconds() - began < 0.5; i++) {
        const double t = seconds();
        robot_read(r, &sensors);
        plant_step(&r->plant, period);
        best = fmin(best, seconds() - t);
    }
    r->plant = before;
    mj_copyData(r->data, r->model, kept);
    mj_deleteData(kept);
    r->known = 0;
    return best;
}

/* The two bodies that begin deepest in one another, where that is a millimetre: they jam a joint,
 * or fling it. */
static void name_jam(robot *r, char *text, size_t size) {
    const mjModel *m = r->model;
    const mjContact *deepest = NULL;
    r->known = 0;
    mj_fwdPosition(m, r->data);
    for (int i = 0; i < r->data->ncon; i++)
        if (r->data->contact[i].dist < (deepest ? deepest->dist : -1e-3))
            deepest = &r->data->contact[i];
    if (deepest)
        snprintf(text, size, ", %.31s begins %.3g mm inside %.31s",
                 name_of(m, m->name_bodyadr[m->geom_bodyid[deepest->geom[1]]], "a body"),
                 -1e3 * deepest->dist,
                 name_of(m, m->name_bodyadr[m->geom_bodyid[deepest->geom[0]]], "a body"));
}

/* A hinge whose range looks like radians, in a file that has degrees. */
static void name_narrow(const robot *r, char *text, size_t size) {
    const mjModel *m = r->model;
    const double degree = M_PI / 180.0, turn = 2.0 * M_PI;
    for (int32_t j = r->plant.joints - 1; j >= 0; j--) {
        const int joint = r->joint[j];
        const double *range = range_of(m, joint);
        if (range && m->jnt_type[joint] == mjJNT_HINGE &&
            fmax(fabs(range[0]), fabs(range[1])) <= turn * degree)
            snprintf(text, size, ", %.31s may turn from %.3g to %.3g degrees",
                     name_of(m, m->name_jntadr[joint], "a joint"), range[0] / degree,
                     range[1] / degree);
    }
}

static int check_time(robot *r, const char *config, double period, char *error, size_t size,
                      const char *file) {
    char clock[8] = "", text[320], odd[128] = "";
    name_narrow(r, odd, sizeof odd);
    name_jam(r, odd, sizeof odd);
    double takes = time_sample(r, period);
    int drives = 0;
    for (int32_t j = 0; j < r->plant.joints; j++)
        drives += r->plant.drive[j].torque_limit > 0.0;
    machine_config_text(config, "clock", clock, sizeof clock);
    /* a coarser step that is stable too */
    if (takes > 0.5 * period && r->plant.substep < r->longest) {
        step_by(r, fmin(r->longest, 0.5 * period));
        takes = time_sample(r, period);
    }
    snprintf(r->info.text, sizeof r->info.text,
             "MuJoCo model %.60s, %d of its %d joints, %d with a drive (simulated%s%s%s): "
              "steps of %.3g us, "
             "%.3g us for a sample of %.4g us.",
             r->info.name, r->plant.joints, (int)r->model->njnt + r->held, drives,
             r->held ? ", the others stand at 0" : "",
             r->shapeless ? ", without shapes: files of meshes are missing" : "", odd,
             1e6 * r->plant.substep, 1e6 * takes, 1e6 * period);
    if (strcmp(clock, "real") != 0 || takes < 0.9 * period)
        return 0;
    snprintf(text, sizeof text,
             "simulating %.4g ms takes %.4g ms here, in steps of %.3g us: give --clock fast, or a "
             "model with fewer contacts and "
             "less damping on light joints",
             1e3 * period, 1e3 * takes, 1e6 * r->plant.substep);
    return refuse(error, size, file, text);
}

/* ---- the machine ---- */

static void robot_close(void *handle) {
    robot *r = handle;
    if (r->data)
        mj_deleteData(r->data);
    if (r->model)
        mj_deleteModel(r->model);
    free(r->qpos);
    free(r->qvel);
    free(r);
}

static int load(robot *r, const char *config, double period, char *error, size_t size,
                const char *file) {
    char why[800] = "", joints[1024] = "";
    machine_config_text(config, "joints", joints, sizeof joints);
    r->model = read_model(file, joints, &r->shapeless, &r->held, why, sizeof why);
    if (!r->model && strstr(why, "'mujocoinclude'"))
        return refuse(error, size, file, "a part that another file includes: give that file");
    if (!r->model)
        return refuse(error, size, file, why);
    const char *array = no_number(r->model);
    if (array) {
        snprintf(why, sizeof why, "a number of %s is nan", array);
        return refuse(error, size, file, why);
    }
    r->data = mj_makeData(r->model);
    r->qpos = calloc((size_t)r->model->nq + 1, sizeof(double));
    r->qvel = calloc((size_t)r->model->nv + 1, sizeof(double));
    if (!r->data || !r->qpos || !r->qvel)
        return refuse(error, size, file, "out of memory");
    if (choose_joints(r, config, error, size, file) != 0 ||
        place(r, config, error, size, file) != 0)
        return -1;
    r->plant.acceleration = acceleration;
    r->plant.self = r;
    r->plant.others = others;
    r->plant.others_self = r;
    r->plant.carry = carry;
    r->plant.carry_self = r;
    describe(r, config);
    plant_equip(&r->plant, config, &usual, 2.0 * full_scale);
    for (int j = 0; j < r->plant.joints; j++) {
        r->plant.q[j] = r->data->qpos[r->position[j]];
        /* A limit far beyond what the joint needs (1000 N m stand in many a URDF) is no reason for
         * an analog output so coarse, and so noisy, that a diagnosis finds it. */
        r->plant.electronics.finer[j] = fmin(1.0, r->fits[j] / r->info.joint[j].torque_max);
    }
    if (concealed_attach(&r->concealed, &r->plant, config, error, size) != 0)
        return -1;
    return check_time(r, config, period, error, size, file);
}

static int robot_open(void **handle, const char *config, double period, machine_info *info,
                      char *error, size_t error_size) {
    char file[512];
    jmp_buf failed;
    if (machine_config_text(config, "model", file, sizeof file) != 0) {
        snprintf(error, error_size, "mujoco: no model; start it with --machine FILE.xml");
        return -1;
    }
    robot *volatile r = calloc(1, sizeof(robot));
    if (!r)
        return refuse(error, error_size, file, "out of memory");
    mju_user_error = on_error;
    mju_user_warning = on_warning;
    int result;
    loading = &failed;
    if (setjmp(failed) == 0)
        result = load(r, config, period, error, error_size, file);
    else
        result = refuse(error, error_size, file, complaint);
    loading = NULL;
    if (result != 0) {
        robot_close(r);
        return -1;
    }
    r->din = (uint32_t)machine_config_double(config, "din", 0.0);
    *info = r->info;
    *handle = r;
    return 0;
}

/* Scalars of the model's sensors, of the present state. What measures drives is answered here:
 * their torque is not MuJoCo's. */
static void read_sensors(robot *r, machine_sensors *sensors) {
    const mjModel *m = r->model;
    mjData *d = r->data;
    if (r->info.adcs == 0)
        return;
    for (int j = 0; j < r->plant.joints; j++) {
        d->qpos[r->position[j]] = r->plant.q[j];
        d->qvel[r->speed[j]] = r->plant.qd[j];
    }
    mj_forwardSkip(m, d, mjSTAGE_NONE, 0);
    r->known = 0;
    for (int i = 0; i < r->info.adcs; i++) {
        const int s = r->sensor[i];
        double value = d->sensordata[m->sensor_adr[s] + r->element[i]];
        for (int j = 0; j < r->plant.joints; j++) {
            const int joint = r->joint[j], object = m->sensor_objid[s];
            if (m->sensor_type[s] == mjSENS_JOINTACTFRC && object == joint)
                value = r->plant.current[j];
            else if (m->sensor_type[s] == mjSENS_ACTUATORFRC && actuator_of(m, joint) == object &&
                     r->gear[j] != 0.0)
                value = r->plant.current[j] / r->gear[j];
        }
        sensors->adc[i] = value + plant_noise(&r->plant, m->sensor_noise[s]);
    }
}

static void robot_read(void *handle, machine_sensors *sensors) {
    robot *r = handle;
    double measured[PLANT_JOINTS];
    plant_measure(&r->plant, measured);
    sensors->fault = 0;
    sensors->din = r->din;
    for (int j = 0; j < r->plant.joints; j++) {
        if (isfinite(measured[j]) && fabs(measured[j]) < 4000.0)
            sensors->enc[j] = plant_counts(&r->plant, &r->info, j, measured[j]);
        else
            sensors->fault |= 1u << j; /* the simulation has blown up: that trips */
    }
    read_sensors(r, sensors);
}

static void robot_write(void *handle, const machine_actuators *actuators) {
    robot *r = handle;
    plant_command(&r->plant, &r->info, actuators);
}

static void robot_step(void *handle, double dt) { plant_step(&((robot *)handle)->plant, dt); }

static void robot_safe(void *handle) {
    const machine_actuators stand_still = {.mode = MACHINE_VELOCITY};
    robot_write(handle, &stand_still);
}

const machine_ops zendsp_machine = {
    .abi = MACHINE_ABI,
    .open = robot_open,
    .read = robot_read,
    .write = robot_write,
    .step = robot_step,
    .safe = robot_safe,
    .home = NULL, /* positions are absolute */
    .close = robot_close,
};
