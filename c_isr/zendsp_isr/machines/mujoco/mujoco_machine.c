/* mujoco_machine: any MuJoCo model (MJCF, or URDF as MuJoCo reads it) as a simulated machine:
 * zendsp target --machine arm.xml
 *
 *     M(q) qdd + c(q, qd) + contacts, springs, … (MuJoCo) = tau_drive − friction − concealed
 * effects (plant.h)
 *
 * MuJoCo gives the acceleration. The joints with a motor are integrated by the plant that all
 * simulated machines share, so that drives, electronics, friction and concealed effects are the
 * same as theirs; what else moves is integrated beside them (`others`). Two things are taken out of
 * MuJoCo's hands:
 *
 *     frictionloss, damping   become friction of the plant: MuJoCo's own dry friction is
 * regularised and creeps under load actuators at the joints become torque drives; gains, servos and
 * activation are dropped, limits and gear are kept
 *
 * Joints of the machine: those with an actuator, in the order of the file; without any actuator all
 * hinges and slides; or those that the key `joints` names. Actuators that are not taken over hold
 * the control of the keyframe.
 *
 * Analog inputs: the scalars of the model's sensors, in the order of the file, the first eight.
 *
 * Config keys: model (path), clock, joints (names, by comma), keyframe (name), q1 … (start), counts
 * (encoder, a turn or a metre), speed_max, torque_max (of every joint), substep (s), din (bits),
 * those of plant.h and concealed.h.
 */
#include <float.h>  /* DBL_MAX */
#include <setjmp.h> /* MuJoCo's errors while it loads */
#include <stdio.h>  /* snprintf */
#include <stdlib.h> /* calloc, abort */
#include <string.h> /* memcpy, strcmp */
#include <time.h>   /* clock_gettime */

#include <mujoco/mujoco.h>

#include "concealed.h"
#include "machine.h"
#include "machine_config.h"
#include "plant.h"

enum { POSES = 24 };                        /* at which inertia is looked at */
enum { TRIALS = 40 };                       /* samples that are timed at the start */
/* mV, command that gives the torque limit (or speed limit) */
static const double full_scale = 10000.0;
static const double two_pi = 6.283185307179586;
/* encoder, counts a turn: 17 bits, usual on the joint side */
static const double turn_counts = 131072.0;
static const double metre_counts = 1e6;     /* encoder of a slide, counts a metre */
static const double give = 0.002;           /* rad or m, after which bristles break away */

/* 16-bit analog output, a millivolt of noise on the line, current loop of 1 kHz, interpolated
 * encoder: usual, chosen here. */
static const plant_electronics usual = {.dac_step = 20000.0 / 65536.0,
                                        .dac_noise = 1.0,
                                        .current_loop = 1.6e-4,
                                        .encoder_noise = {0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5}};

typedef struct robot {
    plant plant;
    machine_info info;
    concealed concealed;
    mjModel *model;
    mjData *data;
    double *qpos, *qvel;           /* of everything, at the beginning of a step */
    int joint[PLANT_JOINTS];       /* of the model */
    int position[PLANT_JOINTS];    /* place in qpos */
    int speed[PLANT_JOINTS];       /* place in qvel */
    double gear[PLANT_JOINTS];     /* joint torque a unit of actuator force */
    double net[PLANT_JOINTS];      /* N m, last torque on the joints */
    int sensor[MACHINE_ADCS];      /* of the model */
    int element[MACHINE_ADCS];     /* of the sensor */
    double longest;                /* s, step that is stable */
    int known;                     /* 1: data holds the kinematics of its qpos and qvel */
    uint32_t din;
} robot;

/* ---- MuJoCo's errors ---- */

/* where an error while loading returns to; NULL: the loop runs */
static _Thread_local jmp_buf *loading;
static _Thread_local char complaint[512];

static void on_error(const char *text) {
    snprintf(complaint, sizeof complaint, "%s", text);
    if (loading)
        longjmp(*loading, 1);
    abort(); /* may not return: the runner ends as in any crash, and the monitor says where */
}

static void on_warning(const char *text) { (void)text; } /* MuJoCo would write a file */

/* MuJoCo's sentence on one line. */
static int refuse(char *error, size_t size, const char *file, const char *text) {
    const char *name = strrchr(file, '/');
    int n = snprintf(error, size, "%s: %s", name ? name + 1 : file, text);
    for (int i = 0; i < n && (size_t)i < size; i++)
        if (error[i] == '\n')
            error[i] = ' ';
    return -1;
}

static const char *name_of(const mjModel *m, int address, const char *otherwise) {
    const char *name = m->names + address;
    return name[0] ? name : otherwise;
}

/* ---- dynamics ---- */

static void acceleration(void *self, const double *q, const double *qd, const double *torque,
                         double *qdd) {
    robot *r = self;
    mjData *d = r->data;
    int same = r->known;
    for (int j = 0; j < r->plant.joints; j++) {
        same = same && d->qpos[r->position[j]] == q[j] && d->qvel[r->speed[j]] == qd[j];
        d->qpos[r->position[j]] = q[j];
        d->qvel[r->speed[j]] = qd[j];
        d->qfrc_applied[r->speed[j]] = r->net[j] = torque[j];
    }
    /* another torque alone moves no body */
    mj_forwardSkip(r->model, d, same ? mjSTAGE_VEL : mjSTAGE_NONE, 1);
    r->known = 1;
    for (int j = 0; j < r->plant.joints; j++)
        qdd[j] = d->qacc[r->speed[j]];
}

/* A point mass on the body of a joint, in the frame of that body. */
static int carry(void *self, int joint, double mass, const double *place) {
    robot *r = self;
    mjModel *m = r->model;
    const int body = m->jnt_bodyid[r->joint[joint]];
    double turn[9], full[9] = {0}, half[9], own[9], away[3], axes[9];
    double *centre = &m->body_ipos[3 * body], *quat = &m->body_iquat[4 * body],
           *moments = &m->body_inertia[3 * body];
    const double before = m->body_mass[body], after = before + mass,
                 reduced = before * mass / after;
    for (int i = 0; i < 3; i++)
        full[4 * i] = moments[i];
    mju_quat2Mat(turn, quat);
    mju_mulMatMat(half, turn, full, 3, 3, 3);
    mju_mulMatMatT(own, half, turn, 3, 3, 3); /* about the centre of mass, axes of the body */
    mju_sub3(away, place, centre);
    const double square = mju_dot3(away, away);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            own[3 * i + k] += reduced * ((i == k ? square : 0.0) - away[i] * away[k]);
    mju_addToScl3(centre, away, mass / after);
    mju_eig3(moments, axes, quat, own);
    m->body_mass[body] = after;
    mjData *kept = mj_copyData(NULL, m, r->data); /* setConst() looks at the zero position */
    mj_setConst(m, r->data);
    mj_copyData(r->data, m, kept);
    mj_deleteData(kept);
    r->known = 0;
    return 0;
}

/* What moves beside the joints of the machine, by the same explicit midpoint. */
static void others(void *self, int stage, double h) {
    robot *r = self;
    const mjModel *m = r->model;
    mjData *d = r->data;
    if (stage == 0) {
        memcpy(r->qpos, d->qpos, sizeof(double) * (size_t)m->nq);
        memcpy(r->qvel, d->qvel, sizeof(double) * (size_t)m->nv);
        mj_integratePos(m, d->qpos, r->qvel, 0.5 * h);
        mju_addScl(d->qvel, r->qvel, d->qacc, 0.5 * h, (int)m->nv);
    } else {
        for (int i = 0; i < m->na; i++)
            d->act[i] += h * d->act_dot[i];
        double *middle = d->qvel;
        memcpy(d->qpos, r->qpos, sizeof(double) * (size_t)m->nq);
        mj_integratePos(m, d->qpos, middle, h);
        mju_addScl(d->qvel, r->qvel, d->qacc, h, (int)m->nv);
        d->time += h;
    }
    r->known = 0;
}

/* 1 / (M^-1)_jj of every joint at the present pose: what the joint's own torque has to turn. */
static void inertia_here(robot *r, double *inertia) {
    double zero[PLANT_JOINTS] = {0}, rest[PLANT_JOINTS], push[PLANT_JOINTS], q[PLANT_JOINTS],
           moved[PLANT_JOINTS];
    for (int j = 0; j < r->plant.joints; j++)
        q[j] = r->data->qpos[r->position[j]];
    r->known = 0;
    acceleration(r, q, zero, zero, rest);
    for (int j = 0; j < r->plant.joints; j++) {
        memset(push, 0, sizeof push);
        push[j] = 1.0;
        acceleration(r, q, zero, push, moved);
        const double ease = moved[j] - rest[j];
        inertia[j] = ease > 1e-12 ? 1.0 / ease : 1e12;
    }
}

/* ---- reading the model ---- */

static int turns(const mjModel *m, int joint) {
    return m->jnt_type[joint] == mjJNT_HINGE || m->jnt_type[joint] == mjJNT_SLIDE;
}

static int actuator_of(const mjModel *m, int joint) {
    for (int a = 0; a < m->nactuator; a++)
        if ((m->actuator_trntype[a] == mjTRN_JOINT ||
             m->actuator_trntype[a] == mjTRN_JOINTINPARENT) &&
            m->actuator_trnid[2 * a] == joint)
            return a;
    return -1;
}

static int add_joint(robot *r, int joint, char *error, size_t size, const char *file) {
    const mjModel *m = r->model;
    char text[256];
    const char *name = name_of(m, m->name_jntadr[joint], "(without a name)");
    if (!turns(m, joint)) {
        snprintf(text, sizeof text,
                 "joint '%s' is a %s joint; a drive moves a hinge or a slide. Name others with "
                 "--machine-option joints=…",
                 name, m->jnt_type[joint] == mjJNT_BALL ? "ball" : "free");
        return refuse(error, size, file, text);
    }
    for (int j = 0; j < r->plant.joints; j++)
        if (r->joint[j] == joint)
            return 0;
    if (r->plant.joints == PLANT_JOINTS) {
        int driven = 0;
        for (int k = 0; k < m->njnt; k++)
            driven += turns(m, k) && (actuator_of(m, k) >= 0 || m->nactuator == 0);
        snprintf(text, sizeof text,
                 "%d joints with a drive, a machine has %d at most: choose with --machine-option "
                 "joints=NAME,NAME,…",
                 driven, PLANT_JOINTS);
        return refuse(error, size, file, text);
    }
    r->joint[r->plant.joints++] = joint;
    return 0;
}

static int choose_joints(robot *r, const char *config, char *error, size_t size, const char *file) {
    const mjModel *m = r->model;
    char wanted[1024], text[256];
    if (machine_config_text(config, "joints", wanted, sizeof wanted) == 0) {
        for (char *name = strtok(wanted, ", "); name; name = strtok(NULL, ", ")) {
            const int joint = mj_name2id(m, mjOBJ_JOINT, name);
            if (joint < 0) {
                int n = snprintf(text, sizeof text, "no joint '%s'; there are", name);
                for (int k = 0; k < m->njnt && n > 0 && (size_t)n < sizeof text; k++)
                    n += snprintf(text + n, sizeof text - (size_t)n, "%s %s", k ? "," : "",
                                  name_of(m, m->name_jntadr[k], "?"));
                return refuse(error, size, file, text);
            }
            if (add_joint(r, joint, error, size, file) != 0)
                return -1;
        }
    } else {
        for (int k = 0; k < m->njnt; k++)
            if (actuator_of(m, k) >= 0 || (m->nactuator == 0 && turns(m, k)))
                if (add_joint(r, k, error, size, file) != 0)
                    return -1;
    }
    if (r->plant.joints == 0)
        return refuse(
            error, size, file,
            "no hinge or slide joint that an actuator drives: a machine needs one at least");
    for (int j = 0; j < r->plant.joints; j++) {
        r->position[j] = m->jnt_qposadr[r->joint[j]];
        r->speed[j] = m->jnt_dofadr[r->joint[j]];
    }
    return 0;
}

/* Start: the keyframe named, else "home", else the first one, else qpos0; then q1, q2, … */
static int place(robot *r, const char *config, char *error, size_t size, const char *file) {
    const mjModel *m = r->model;
    char name[64] = "home", key_name[16], text[160];
    const int given = machine_config_text(config, "keyframe", name, sizeof name) == 0;
    int key = mj_name2id(m, mjOBJ_KEY, name);
    if (key < 0 && given) {
        snprintf(text, sizeof text, "no keyframe '%s' among its %d", name, (int)m->nkey);
        return refuse(error, size, file, text);
    }
    if (key < 0 && m->nkey > 0)
        key = 0;
    if (key >= 0)
        mj_resetDataKeyframe(m, r->data, key);
    else
        mj_resetData(m, r->data);
    for (int j = 0; j < r->plant.joints; j++) {
        snprintf(key_name, sizeof key_name, "q%d", j + 1);
        double *q = &r->data->qpos[r->position[j]];
        *q = machine_config_double(config, key_name, *q);
    }
    return 0;
}

/* Smallest and present inertia of every joint, over poses spread through its range (a
 * low-discrepancy sequence). */
static void look_at_inertia(robot *r, double *least, double *here) {
    mjData *d = r->data;
    double start[PLANT_JOINTS], now[PLANT_JOINTS];
    for (int j = 0; j < r->plant.joints; j++)
        start[j] = d->qpos[r->position[j]];
    inertia_here(r, here);
    memcpy(least, here, sizeof(double) * PLANT_JOINTS);
    for (int i = 1; i <= POSES; i++) {
        for (int j = 0; j < r->plant.joints; j++) {
            const double *range = &r->model->jnt_range[2 * r->joint[j]];
            const int limited = r->model->jnt_limited[r->joint[j]] && range[1] > range[0];
            const double low = limited ? range[0] : -3.0, high = limited ? range[1] : 3.0;
            const double share = fmod(i * pow(1.2207440846, -(j + 1.0)), 1.0);
            d->qpos[r->position[j]] = low + share * (high - low);
        }
        inertia_here(r, now);
        for (int j = 0; j < r->plant.joints; j++)
            if (now[j] < least[j])
                least[j] = now[j];
    }
    for (int j = 0; j < r->plant.joints; j++)
        d->qpos[r->position[j]] = start[j];
    mju_zero(d->qvel, (int)r->model->nv);
    mju_zero(d->qfrc_applied, (int)r->model->nv);
    mju_zero(d->qacc_warmstart, (int)r->model->nv);
    r->known = 0;
}

/* Largest torque that an actuator gives, N m at the joint; 0 where the model does not say. */
static double torque_of(const mjModel *m, int joint, int actuator, double gear) {
    double most = 0.0;
    if (m->jnt_actfrclimited[joint])
        most = fmax(fabs(m->jnt_actfrcrange[2 * joint]), fabs(m->jnt_actfrcrange[2 * joint + 1]));
    if (actuator < 0)
        return most;
    double own = 0.0;
    const double *force = &m->actuator_forcerange[2 * actuator];
    const int control = m->actuator_ctrladr[actuator];
    if (m->actuator_forcelimited[actuator])
        own = fmax(fabs(force[0]), fabs(force[1])) * fabs(gear);
    else if (m->actuator_biastype[actuator] == mjBIAS_NONE &&
             m->actuator_gaintype[actuator] == mjGAIN_FIXED && m->actuator_ctrlnum[actuator] == 1 &&
             m->actuator_ctrllimited[control])
        own = fmax(fabs(m->actuator_ctrlrange[2 * control]),
                   fabs(m->actuator_ctrlrange[2 * control + 1])) *
              fabs(m->actuator_gainprm[mjNGAIN * actuator] * gear);
    return most > 0.0 && own > 0.0 ? fmin(most, own) : most > 0.0 ? most : own;
}

static void describe_joint(robot *r, int j, const char *config, double inertia, double gravity) {
    mjModel *m = r->model;
    const int joint = r->joint[j], actuator = actuator_of(m, joint),
              slide = m->jnt_type[joint] == mjJNT_SLIDE;
    const double *range = &m->jnt_range[2 * joint];
    const int limited = m->jnt_limited[joint] && range[1] > range[0];
    machine_joint *info = &r->info.joint[j];
    char text[MACHINE_NAME];
    snprintf(text, sizeof text, "joint %d", j + 1);
    snprintf(info->name, sizeof info->name, "%.31s", name_of(m, m->name_jntadr[joint], text));
    snprintf(info->unit, sizeof info->unit, slide ? "m" : "rad");
    r->gear[j] = actuator >= 0 ? m->actuator_gear[6 * m->actuator_outadr[actuator]] : 1.0;
    /* a model that names no limit gets what lifts it twice over and 50 rad/s² (m/s²) besides */
    double torque = torque_of(m, joint, actuator, r->gear[j]);
    if (torque <= 0.0)
        torque = 2.0 * fabs(gravity) + 50.0 * inertia;
    torque = machine_config_double(config, "torque_max", torque);
    const double speed = machine_config_double(config, "speed_max",
                                               slide     ? 2.0
                                               : limited ? two_pi
                                                         : 50.0);
    const double counts =
        machine_config_double(config, "counts", slide ? metre_counts : turn_counts);
    const int passive = actuator < 0 && m->nactuator > 0; /* an encoder without a motor */
    snprintf(info->command, sizeof info->command, passive ? "none" : slide ? "force" : "torque");
    info->counts_per_unit = slide ? counts : counts / two_pi;
    info->mv_per_torque = passive ? 0.0 : full_scale / torque;
    info->mv_per_speed = full_scale / speed;
    info->command_max = full_scale;
    info->position_min = limited ? range[0] : -1000.0;
    info->position_max = limited ? range[1] : 1000.0;
    info->speed_max = speed;
    info->torque_max = torque;
    info->inertia = inertia;
    info->home = r->data->qpos[r->position[j]];
    /* the drive is ours from here on */
    for (int a = 0; a < m->nactuator; a++)
        if (m->actuator_trnid[2 * a] == joint && (m->actuator_trntype[a] == mjTRN_JOINT ||
                                                  m->actuator_trntype[a] == mjTRN_JOINTINPARENT)) {
            m->actuator_gaintype[a] = mjGAIN_FIXED;
            m->actuator_biastype[a] = mjBIAS_NONE;
            mju_zero(&m->actuator_gainprm[mjNGAIN * a], mjNGAIN);
            mju_zero(&m->actuator_biasprm[mjNBIAS * a], mjNBIAS);
        }
    r->plant.drive[j] = (plant_drive){.torque_limit = passive ? 0.0 : torque,
                                      .speed_gain = passive ? 0.0 : 60.0 * inertia,
                                      .speed_integral = passive ? 0.0 : 1200.0 * inertia,
                                      .brake = passive ? 0.0 : 5.0 * inertia};
}

/* Friction of the model becomes friction of the plant; returns the longest step that is stable with
 * it, s. */
static double take_friction(robot *r, int j, double least) {
    mjModel *m = r->model;
    const int dof = r->speed[j];
    const double level = m->dof_frictionloss[dof], viscous = m->dof_damping[dof];
    const double firm = (level > 0.0 ? level : 0.01 * r->info.joint[j].torque_max) / give;
    /* a swing of 5000 rad/s, half a radian in a step of 0.1 ms */
    const double stiffest = 2.5e7 * least;
    const double bristle = firm < stiffest ? firm : stiffest;
    r->plant.friction[j] = (plant_friction){.coulomb_pos = level,
                                            .coulomb_neg = level,
                                            .breakaway_pos = level,
                                            .breakaway_neg = level,
                                            .stribeck = 0.03,
                                            .stiffness = bristle,
                                            .damping = 0.6 * sqrt(bristle * least),
                                            .viscous_pos = viscous,
                                            .viscous_neg = viscous};
    m->dof_frictionloss[dof] = 0.0;
    m->dof_damping[dof] = 0.0;
    r->plant.stop_min[j] = -HUGE_VAL; /* MuJoCo has the stops */
    r->plant.stop_max[j] = HUGE_VAL;
    const double brake = viscous + r->plant.drive[j].brake + 60.0 * least;
    return fmin(0.5 * least / brake, 0.5 / sqrt(bristle / least));
}

static void name_sensors(robot *r) {
    const mjModel *m = r->model;
    for (int s = 0; s < m->nsensor; s++)
        for (int e = 0; e < m->sensor_dim[s] && r->info.adcs < MACHINE_ADCS; e++) {
            const int i = r->info.adcs++;
            const char *name = name_of(m, m->name_sensoradr[s], "sensor");
            const char *unit =
                m->sensor_type[s] == mjSENS_JOINTVEL   ? "rad/s"
                : m->sensor_type[s] == mjSENS_JOINTPOS ? "rad"
                : m->sensor_type[s] == mjSENS_TORQUE || m->sensor_type[s] == mjSENS_JOINTACTFRC
                    ? "N m"
                : m->sensor_type[s] == mjSENS_FORCE || m->sensor_type[s] == mjSENS_TOUCH ? "N"
                : m->sensor_type[s] == mjSENS_GYRO                                       ? "rad/s"
                : m->sensor_type[s] == mjSENS_ACCELEROMETER                              ? "m/s^2"
                                                                                         : "";
            r->sensor[i] = s;
            r->element[i] = e;
            if (m->sensor_dim[s] == 1)
                snprintf(r->info.adc_name[i], MACHINE_NAME, "%.31s", name);
            else
                snprintf(r->info.adc_name[i], MACHINE_NAME, "%.27s %d", name, e);
            snprintf(r->info.adc_unit[i], MACHINE_UNIT, "%s", unit);
        }
}

static void describe(robot *r, const char *config) {
    const mjModel *m = r->model;
    r->info.simulated = 1;
    r->info.joints = r->plant.joints;
    r->info.dins = 8;
    r->info.douts = 8;
    r->info.stop_input = 0;
    r->info.stop_level = 1;
    snprintf(r->info.name, sizeof r->info.name, "%.31s", name_of(m, 0, "mujoco"));
    double least[PLANT_JOINTS], here[PLANT_JOINTS];
    look_at_inertia(r, least, here);
    mj_forward(m, r->data);
    r->longest = 5e-4;
    for (int j = 0; j < r->plant.joints; j++) {
        describe_joint(r, j, config, here[j], r->data->qfrc_bias[r->speed[j]]);
        r->longest = fmin(r->longest, take_friction(r, j, least[j]));
    }
    r->plant.substep = machine_config_double(config, "substep", fmax(fmin(r->longest, 1e-4), 2e-6));
    r->model->opt.timestep = r->plant.substep;
    name_sensors(r);
}

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

static int check_time(robot *r, const char *config, double period, char *error, size_t size,
                      const char *file) {
    char clock[8] = "", text[320];
    double takes = time_sample(r, period);
    machine_config_text(config, "clock", clock, sizeof clock);
    /* a coarser step that is stable too */
    if (takes > 0.5 * period && r->plant.substep < r->longest) {
        r->plant.substep = fmin(r->longest, 0.5 * period);
        r->model->opt.timestep = r->plant.substep;
        takes = time_sample(r, period);
    }
    snprintf(r->info.text, sizeof r->info.text,
             "MuJoCo model %.60s, %d joints with a drive of %d (simulated): steps of %.3g us, %.3g "
             "us for a sample of %.4g us.",
             r->info.name, r->plant.joints, (int)r->model->njnt, 1e6 * r->plant.substep,
             1e6 * takes, 1e6 * period);
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
    char why[512] = "";
    r->model = mj_loadXML(file, NULL, why, sizeof why);
    if (!r->model)
        return refuse(error, size, file, why[0] ? why : "MuJoCo cannot read it");
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
    for (int j = 0; j < r->plant.joints; j++)
        r->plant.q[j] = r->data->qpos[r->position[j]];
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
