/* mujoco_model.h: reads a MuJoCo model: which joints have a drive, where they begin, their limits,
 * inertia, friction, and sensors. */
#ifndef ZENDSP_MUJOCO_MODEL_H
#define ZENDSP_MUJOCO_MODEL_H

#include <math.h>   /* fabs, fmax, fmin, fmod, pow, sqrt */
#include <stdio.h>  /* snprintf */
#include <string.h> /* memcpy, strsep, strtok */

#include <mujoco/mujoco.h>

#include "machine.h"
#include "machine_config.h"
#include "mujoco_robot.h"
#include "plant.h"

enum { POSES = 24 }; /* at which inertia is looked at */
/* mV, command that gives the torque limit (or speed limit) */
static const double full_scale = 10000.0;
static const double two_pi = 6.283185307179586;
/* encoder, counts a turn: 17 bits, usual on the joint side */
static const double turn_counts = 131072.0;
static const double metre_counts = 1e6; /* encoder of a slide, counts a metre */
static const double give = 2e-6;        /* rad or m, of the bristles: none that shows */


static int turns(const mjModel *m, int joint) {
    return m->jnt_type[joint] == mjJNT_HINGE || m->jnt_type[joint] == mjJNT_SLIDE;
}

static int drives(const mjModel *m, int actuator, int joint) {
    return (m->actuator_trntype[actuator] == mjTRN_JOINT ||
            m->actuator_trntype[actuator] == mjTRN_JOINTINPARENT) &&
           m->actuator_trnid[2 * actuator] == joint;
}

static int actuator_of(const mjModel *m, int joint) {
    for (int a = 0; a < m->nactuator; a++)
        if (drives(m, a, joint))
            return a;
    return -1;
}

static int drivable(const mjModel *m, int joint) {
    return turns(m, joint) && (actuator_of(m, joint) >= 0 || m->nactuator == 0);
}

/* Names of the joints with a drive, the first of them by a comma, as many as there is room for;
 * where nothing has a drive, those of all joints. Returns how many have one. */
static int list_joints(const mjModel *m, char *text, size_t size) {
    int driven = 0, named = 0;
    size_t used = 0;
    for (int k = 0; k < m->njnt; k++)
        driven += drivable(m, k);
    text[0] = 0;
    for (int k = 0; k < m->njnt && named < PLANT_JOINTS; k++) {
        const char *name = name_of(m, m->name_jntadr[k], "?");
        if (driven && !drivable(m, k))
            continue;
        if (used + strlen(name) + 2 > size)
            break;
        used += (size_t)snprintf(text + used, size - used, "%s%s", named++ ? "," : "", name);
    }
    return driven;
}

static int add_joint(robot *r, int joint, char *error, size_t size, const char *file) {
    const mjModel *m = r->model;
    char text[400], names[240];
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
        const int driven = list_joints(m, names, sizeof names);
        snprintf(text, sizeof text,
                 "%d joints with a drive, a machine has %d at most: choose, such as "
                 "--machine-option joints=%s",
                 driven, PLANT_JOINTS, names);
        return refuse(error, size, file, text);
    }
    r->joint[r->plant.joints++] = joint;
    return 0;
}

/* Actuators, but none at a hinge or slide. */
static int nothing_driven(const mjModel *m, char *error, size_t size, const char *file) {
    char text[256];
    const char *on = "what is no joint", *joint = "…";
    for (int a = m->nactuator - 1; a >= 0; a--)
        on = m->actuator_trntype[a] == mjTRN_TENDON ? "tendons"
             : m->actuator_trntype[a] == mjTRN_SITE ? "sites"
             : m->actuator_trntype[a] == mjTRN_BODY ? "bodies"
                                                    : on;
    for (int k = m->njnt - 1; k >= 0; k--)
        joint = turns(m, k) ? name_of(m, m->name_jntadr[k], "…") : joint;
    if (m->nactuator == 0)
        snprintf(text, sizeof text, "no hinge or slide joint: a machine needs one at least");
    else
        snprintf(text, sizeof text,
                 "no hinge or slide joint that an actuator drives, its actuators act on %s: where "
                 "a motor moves a joint, give it <motor joint=\"%.32s\"/> in the file",
                 on, joint);
    return refuse(error, size, file, text);
}

static int choose_joints(robot *r, const char *config, char *error, size_t size, const char *file) {
    const mjModel *m = r->model;
    char wanted[1024], text[400], names[240];
    if (machine_config_text(config, "joints", wanted, sizeof wanted) == 0) {
        for (char *name = strtok(wanted, ", "); name; name = strtok(NULL, ", ")) {
            const int joint = mj_name2id(m, mjOBJ_JOINT, name);
            if (joint < 0) {
                list_joints(m, names, sizeof names);
                snprintf(text, sizeof text, "no joint '%.64s'; there are %s", name, names);
                return refuse(error, size, file, text);
            }
            if (add_joint(r, joint, error, size, file) != 0)
                return -1;
        }
    } else {
        for (int k = 0; k < m->njnt; k++)
            if (actuator_of(m, k) >= 0 || drivable(m, k))
                if (add_joint(r, k, error, size, file) != 0)
                    return -1;
    }
    if (r->plant.joints == 0)
        return nothing_driven(m, error, size, file);
    for (int j = 0; j < r->plant.joints; j++) {
        r->position[j] = m->jnt_qposadr[r->joint[j]];
        r->speed[j] = m->jnt_dofadr[r->joint[j]];
    }
    return 0;
}

/* The range of a joint; NULL where it has none. */
static const double *range_of(const mjModel *m, int joint) {
    const double *range = &m->jnt_range[2 * joint];
    return m->jnt_limited[joint] && range[1] > range[0] ? range : NULL;
}

/* Where a joint starts: at the end of its range or beyond it would trip, so in the middle then. */
static double inside(const double *range, double q) {
    const double edge = range ? 0.01 * (range[1] - range[0]) : 0.0;
    return !range || (q > range[0] + edge && q < range[1] - edge) ? q : 0.5 * (range[0] + range[1]);
}

/* What equality constraints tie to the joints of the machine goes where those have been put: the
 * rest of a gripper's linkage, say, which would be flung there. Gauss-Newton on their errors, each
 * step by conjugate gradients; what they do not tie stays. */
static void assemble(robot *r) {
    enum { ROUNDS = 20, STEPS = 60 };
    const mjModel *m = r->model;
    mjData *d = r->data;
    const int nv = (int)m->nv;
    double *x = calloc(3 * (size_t)nv, sizeof(double)), *way = x + nv, *slope = x + 2 * nv;
    for (int round = 0; x && round < ROUNDS; round++) {
        mj_fwdPosition(m, d);
        const int rows = (int)d->nefc, ties = (int)d->ne;
        double *error = calloc(2 * (size_t)rows + 1, sizeof(double)), *moved = error + rows;
        if (!error)
            break;
        mju_scl(error, d->efc_pos, -1.0, ties); /* limits and contacts are no errors */
        const double most = mju_norm(error, ties);
        double before = 0.0;
        mju_zero(x, nv);
        for (int k = 0; most > 1e-9 && k < STEPS; k++) {
            mj_mulJacTVec(m, d, slope, error);
            for (int j = 0; j < r->plant.joints; j++)
                slope[r->speed[j]] = 0.0; /* the machine's own joints stay */
            const double steep = mju_dot(slope, slope, nv);
            if (steep < 1e-20)
                break;
            mju_addScl(way, slope, way, k ? steep / before : 0.0, nv);
            mj_mulJacVec(m, d, moved, way);
            const double far = steep / fmax(mju_dot(moved, moved, ties), 1e-30);
            mju_addToScl(x, way, far, nv);
            mju_addToScl(error, moved, -far, ties);
            before = steep;
        }
        free(error);
        if (most <= 1e-9)
            break;
        mj_integratePos(m, d->qpos, x, 1.0);
    }
    free(x);
}

/* Start: the keyframe named, else "home", else the first one, else qpos0, inside the ranges; then
 * q1, q2, … */
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
    int elsewhere = 0;
    for (int j = 0; j < r->plant.joints; j++) {
        snprintf(key_name, sizeof key_name, "q%d", j + 1);
        double *q = &r->data->qpos[r->position[j]];
        const double start =
            machine_config_double(config, key_name, inside(range_of(m, r->joint[j]), *q));
        elsewhere = elsewhere || start != *q;
        *q = start;
    }
    if (elsewhere)
        assemble(r);
    return 0;
}

/* Of every joint, over poses spread through its range (a low-discrepancy sequence). */
typedef struct look {
    double least[PLANT_JOINTS], here[PLANT_JOINTS]; /* inertia: the smallest, and at the start */
    double heaviest[PLANT_JOINTS];                  /* largest weight, springs with it, N m */
} look;

static void look_at(robot *r, double *now, double *heaviest) {
    const mjData *d = r->data;
    inertia_here(r, now);
    for (int j = 0; j < r->plant.joints; j++) {
        const int dof = r->speed[j];
        heaviest[j] = fmax(heaviest[j], fabs(d->qfrc_bias[dof] - d->qfrc_passive[dof]));
    }
}

static void look_around(robot *r, look *seen) {
    mjData *d = r->data;
    double start[PLANT_JOINTS], now[PLANT_JOINTS], loss[PLANT_JOINTS];
    *seen = (look){0};
    for (int j = 0; j < r->plant.joints; j++) {
        start[j] = d->qpos[r->position[j]];
        loss[j] = r->model->dof_frictionloss[r->speed[j]];
        r->model->dof_frictionloss[r->speed[j]] = 0.0; /* a joint that it holds seems heavy */
    }
    look_at(r, seen->here, seen->heaviest);
    memcpy(seen->least, seen->here, sizeof seen->least);
    for (int i = 1; i <= POSES; i++) {
        for (int j = 0; j < r->plant.joints; j++) {
            const double *range = range_of(r->model, r->joint[j]);
            const double low = range ? range[0] : -3.0, high = range ? range[1] : 3.0;
            const double share = fmod(i * pow(1.2207440846, -(j + 1.0)), 1.0);
            d->qpos[r->position[j]] = low + share * (high - low);
        }
        look_at(r, now, seen->heaviest);
        for (int j = 0; j < r->plant.joints; j++)
            seen->least[j] = fmin(seen->least[j], now[j]);
    }
    for (int j = 0; j < r->plant.joints; j++) {
        d->qpos[r->position[j]] = start[j];
        r->model->dof_frictionloss[r->speed[j]] = loss[j];
    }
    mju_zero(d->qvel, (int)r->model->nv);
    mju_zero(d->qfrc_applied, (int)r->model->nv);
    mju_zero(d->qacc_warmstart, (int)r->model->nv);
    r->known = 0;
}

/* Inertia to begin gains from: the diagonal of the mass matrix, what each joint turns while the
 * others stand. (Where these give way, axes in one line of a straight arm turn next to nothing.)
 * Less of it where joints together are so much lighter than alone that a filtered velocity would
 * not damp them: the largest eigenvalue of M^-1 diag(inertia), found by power iteration. */
static void begin_gains(robot *r) {
    enum { ROUNDS = 60 };
    const double most = 10.0;
    const int joints = r->plant.joints, nv = (int)r->model->nv;
    double *out = r->qpos, *in = r->qvel, x[PLANT_JOINTS], largest = 0.0;
    for (int j = 0; j < joints; j++) {
        mju_zero(in, nv);
        in[r->speed[j]] = 1.0;
        mj_mulM(r->model, r->data, out, in);
        r->info.joint[j].inertia = out[r->speed[j]];
        x[j] = 1.0 + 0.1 * j;
    }
    for (int i = 0; i < ROUNDS; i++) {
        mju_zero(in, nv);
        for (int j = 0; j < joints; j++)
            in[r->speed[j]] = r->info.joint[j].inertia * x[j];
        mj_solveM(r->model, r->data, out, in, 1);
        largest = 0.0;
        for (int j = 0; j < joints; j++)
            largest = fmax(largest, fabs(out[r->speed[j]]));
        for (int j = 0; j < joints; j++)
            x[j] = out[r->speed[j]] / largest;
    }
    for (int j = 0; j < joints; j++)
        r->info.joint[j].inertia *= fmin(1.0, most / largest);
}

/* Largest torque that an actuator gives, N m at the joint; 0 where the model does not say. */
static double torque_of(const mjModel *m, int actuator) {
    const double gear = m->actuator_gear[6 * m->actuator_outadr[actuator]];
    const double *force = &m->actuator_forcerange[2 * actuator];
    const int control = m->actuator_ctrladr[actuator];
    if (m->actuator_forcelimited[actuator])
        return fmax(fabs(force[0]), fabs(force[1])) * fabs(gear);
    if (m->actuator_biastype[actuator] == mjBIAS_NONE &&
        m->actuator_gaintype[actuator] == mjGAIN_FIXED && m->actuator_ctrlnum[actuator] == 1 &&
        m->actuator_ctrllimited[control])
        return fmax(fabs(m->actuator_ctrlrange[2 * control]),
                    fabs(m->actuator_ctrlrange[2 * control + 1])) *
               fabs(m->actuator_gainprm[mjNGAIN * actuator] * gear);
    return 0.0;
}

/* The same of all actuators of a joint together: they are one drive. */
static double joint_torque(const mjModel *m, int joint) {
    double most = 0.0, own = 0.0;
    int known = 1;
    for (int a = 0; a < m->nactuator; a++)
        if (drives(m, a, joint)) {
            own += torque_of(m, a);
            known = known && torque_of(m, a) > 0.0;
        }
    own = known ? own : 0.0;
    if (m->jnt_actfrclimited[joint])
        most = fmax(fabs(m->jnt_actfrcrange[2 * joint]), fabs(m->jnt_actfrcrange[2 * joint + 1]));
    return most > 0.0 && own > 0.0 ? fmin(most, own) : most > 0.0 ? most : own;
}

/* The speed that a URDF limits a joint to, which MuJoCo does not read: `speeds` has names and
 * numbers, parted by tabs. */
static double speed_stated(const char *config, const char *name, double otherwise) {
    char stated[4096];
    if (machine_config_text(config, "speeds", stated, sizeof stated) != 0)
        return otherwise;
    for (char *rest = stated, *one, *speed;
         (one = strsep(&rest, "\t")) && (speed = strsep(&rest, "\t"));)
        if (strcmp(one, name) == 0)
            return strtod(speed, NULL);
    return otherwise;
}

static void describe_joint(robot *r, int j, const char *config, const look *seen) {
    mjModel *m = r->model;
    const int joint = r->joint[j], actuator = actuator_of(m, joint),
              slide = m->jnt_type[joint] == mjJNT_SLIDE;
    const double *range = range_of(m, joint);
    const double inertia = seen->here[j];
    machine_joint *info = &r->info.joint[j];
    char text[MACHINE_NAME];
    snprintf(text, sizeof text, "joint %d", j + 1);
    snprintf(info->name, sizeof info->name, "%.31s", name_of(m, m->name_jntadr[joint], text));
    snprintf(info->unit, sizeof info->unit, slide ? "m" : "rad");
    r->gear[j] = actuator >= 0 ? m->actuator_gear[6 * m->actuator_outadr[actuator]] : 1.0;
    /* a model that names no limit gets what lifts it twice over, anywhere, and 50 rad/s² (m/s²)
     * besides */
    r->fits[j] = 2.0 * (seen->heaviest[j] + m->dof_frictionloss[r->speed[j]]) + 50.0 * inertia;
    double torque = joint_torque(m, joint);
    if (torque <= 0.0)
        torque = r->fits[j];
    torque = machine_config_double(config, "torque_max", torque);
    const double speed = machine_config_double(
        config, "speed_max",
        speed_stated(config, name_of(m, m->name_jntadr[joint], text),
                     slide   ? 2.0
                     : range ? two_pi
                             : 50.0));
    const double counts =
        machine_config_double(config, "counts", slide ? metre_counts : turn_counts);
    const int passive = actuator < 0 && m->nactuator > 0; /* an encoder without a motor */
    snprintf(info->command, sizeof info->command, passive ? "none" : slide ? "force" : "torque");
    info->counts_per_unit = slide ? counts : counts / two_pi;
    info->mv_per_torque = passive ? 0.0 : full_scale / torque;
    info->mv_per_speed = full_scale / speed;
    info->command_max = full_scale;
    info->position_min = range ? range[0] : -1000.0;
    info->position_max = range ? range[1] : 1000.0;
    info->speed_max = speed;
    info->torque_max = torque;
    info->home = r->data->qpos[r->position[j]];
    /* the drive is ours from here on */
    for (int a = 0; a < m->nactuator; a++)
        if (drives(m, a, joint)) {
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
    /* A model has no bristles, so theirs must be stiff; but a swing of 5000 rad/s, half a radian in
     * a step of 0.1 ms, creeps where joints are coupled. One of 1600 stands still, gives way by
     * half a count at most, and a diagnosis finds nothing of it. */
    const double stiffest = 2.5e6 * least;
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

/* Integrates in steps of so long. Damping of what has no drive acts within a step, as MuJoCo's own
 * integrator has it (M + h D for M): on a light finger it is faster than any step. */
static void step_by(robot *r, double step) {
    mjModel *m = r->model;
    for (int i = 0; i < m->nv; i++) {
        int driven = 0;
        for (int j = 0; j < r->plant.joints; j++)
            driven |= r->speed[j] == i;
        if (!driven)
            m->dof_armature[i] += (step - r->plant.substep) * m->dof_damping[i];
    }
    m->opt.timestep = r->plant.substep = step;
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
    look seen;
    look_around(r, &seen);
    mj_forward(m, r->data);
    begin_gains(r);
    r->longest = 5e-4;
    for (int j = 0; j < r->plant.joints; j++) {
        describe_joint(r, j, config, &seen);
        r->longest = fmin(r->longest, take_friction(r, j, seen.least[j]));
    }
    step_by(r, machine_config_double(config, "substep", fmax(fmin(r->longest, 1e-4), 2e-6)));
    name_sensors(r);
}

#endif
