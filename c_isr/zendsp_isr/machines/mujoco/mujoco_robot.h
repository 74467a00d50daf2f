/* mujoco_robot.h: a MuJoCo model as the rigid body of a simulated machine: its errors, its
 * acceleration, and what moves beside its joints. */
#ifndef ZENDSP_MUJOCO_ROBOT_H
#define ZENDSP_MUJOCO_ROBOT_H

#include <math.h>   /* isnan */
#include <setjmp.h> /* MuJoCo's errors while it loads */
#include <stdio.h>  /* snprintf */
#include <stdlib.h> /* abort */
#include <string.h> /* memcpy, memset, strrchr */

#include <mujoco/mujoco.h>
#include <mujoco/mjxmacro.h> /* the arrays of a model by name */

#include "concealed.h"
#include "machine.h"
#include "plant.h"

typedef struct robot {
    plant plant;
    machine_info info;
    int shapeless; /* a URDF whose meshes are not here: without geoms */
    int held;      /* joints of a URDF that are not chosen: they stand */
    concealed concealed;
    mjModel *model;
    mjData *data;
    double *qpos, *qvel;           /* of everything, at the beginning of a step */
    int joint[PLANT_JOINTS];       /* of the model */
    int position[PLANT_JOINTS];    /* place in qpos */
    int speed[PLANT_JOINTS];       /* place in qvel */
    double gear[PLANT_JOINTS];     /* joint torque a unit of actuator force */
    double fits[PLANT_JOINTS];     /* N m, limit of a drive that fits the joint */
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

/* Name of the first array of the model with an entry that is no number, or NULL: MuJoCo reads "nan"
 * without a word. */
static const char *no_number(const mjModel *m) {
#undef MJ_M
#define MJ_M(size) m->size
#define X(type, name, rows, columns)                                                               \
    for (size_t i = 0; i < (size_t)m->rows * (size_t)(columns); i++)                               \
        if (isnan((double)m->name[i]))                                                             \
            return #name;
    MJMODEL_POINTERS
#undef X
    for (int i = 0; i < 3; i++)
        if (isnan(m->opt.gravity[i]))
            return "gravity";
    return NULL;
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

#endif
