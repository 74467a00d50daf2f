/* concealed_inertia.h: what concealed effects make of the machine's own law: more inertia than it
 * knows, and links that stand behind a transmission.
 *
 *     (M + dM) qdd = tau - bias,   given qdd0 = M^-1 (tau - bias) as a black box
 *
 * Columns of M^-1 are the answers to one more N m on each joint; then (1 + M^-1 dM) qdd = qdd0 is a
 * small linear system.
 *
 * Behind a spring or a gap the link has a place of its own: weight, coupling and all inertia but
 * the motor's act there (Spong 1987); the sensor, friction and the drive are the motor's.
 */
#ifndef ZENDSP_CONCEALED_INERTIA_H
#define ZENDSP_CONCEALED_INERTIA_H

#include "concealed_laws.h"

typedef double concealed_matrix[PLANT_JOINTS][PLANT_JOINTS];

static inline int concealed_divides(const concealed_effect *e) {
    return e->kind == ELASTICITY || e->kind == BACKLASH;
}

/* A x = b, x in the place of b, A is lost: Gauss–Jordan with pivoting, n is small. */
static inline void concealed_solve(int n, concealed_matrix A, double *b) {
    for (int k = 0; k < n; k++) {
        int best = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(A[i][k]) > fabs(A[best][k]))
                best = i;
        for (int m = 0; m < n; m++) {
            const double swap = A[k][m];
            A[k][m] = A[best][m];
            A[best][m] = swap;
        }
        const double swap = b[k];
        b[k] = b[best];
        b[best] = swap;
        for (int i = 0; i < n; i++) {
            if (i == k)
                continue;
            const double share = A[i][k] / A[k][k];
            for (int m = k; m < n; m++)
                A[i][m] -= share * A[k][m];
            b[i] -= share * b[k];
        }
    }
    for (int k = 0; k < n; k++)
        b[k] /= A[k][k];
}

/* The machine's own answer, and column by column M^-1. */
static inline void concealed_columns(concealed *c, const double *q, const double *qd,
                                     const double *torque, double *qdd, concealed_matrix W) {
    const int n = c->plant->joints;
    double push[PLANT_JOINTS], moved[PLANT_JOINTS];
    c->acceleration(c->self, q, qd, torque, qdd);
    for (int k = 0; k < n; k++) { /* the answer to one more N m on joint k */
        memcpy(push, torque, sizeof(double) * (size_t)n);
        push[k] += 1.0;
        c->acceleration(c->self, q, qd, push, moved);
        for (int i = 0; i < n; i++)
            W[i][k] = moved[i] - qdd[i];
    }
}

/* A transmission where the machine is opened: the motor has what the load has not of the joint's
 * inertia (what the machine says it is, or what it is here), and the link hangs at rest on it. */
static inline void concealed_divide(concealed *c, concealed_effect *e) {
    const plant *p = c->plant;
    const int j = e->joint;
    double still[PLANT_JOINTS] = {0}, weight[PLANT_JOINTS], row[PLANT_JOINTS] = {0};
    concealed_matrix W, A;
    concealed_columns(c, p->q, still, still, weight, W);
    memcpy(A, W, sizeof A);
    row[j] = 1.0;
    concealed_solve(p->joints, A, row);
    e->motor = (p->inertia[j] > 0.0 ? p->inertia[j] : row[j]) - e->p[2];
    concealed_solve(p->joints, W, weight); /* less by what the links weigh, N m */
    const double bend = -weight[j] / (e->kind == ELASTICITY ? e->p[0] : e->p[1]);
    const double open = e->kind == BACKLASH ? 0.5 * e->p[0] * concealed_sign(bend) : 0.0;
    e->s[0] = p->q[j] - bend - open;
}

/* Accelerations of the links at (q, qd). */
static inline void concealed_links(concealed *c, const double *q, const double *qd,
                                   const double *torque, double *qdd) {
    const int n = c->plant->joints;
    if (!c->massive) {
        c->acceleration(c->self, q, qd, torque, qdd);
        return;
    }
    concealed_matrix W, A = {{0}}, dM;
    concealed_columns(c, q, qd, torque, qdd, W);
    memcpy(dM, c->dM, sizeof dM);
    for (int i = 0; i < c->count; i++) {
        concealed_effect *e = &c->effect[i];
        if (!concealed_divides(e))
            continue;
        /* folded, a link may have less inertia than its motor was taken to have: a fiftieth of what
         * the joint turns freely stays the link's, or M would not be one of a machine */
        const int j = e->joint;
        e->now = e->motor < 0.98 / W[j][j] ? e->motor : 0.98 / W[j][j];
        dM[j][j] -= e->now;
    }
    for (int i = 0; i < n; i++)
        for (int k = 0; k < n; k++) {
            A[i][k] = i == k;
            for (int m = 0; m < n; m++)
                A[i][k] += W[i][m] * dM[m][k];
        }
    concealed_solve(n, A, qdd);
    /* what moves beside the joints feels the reaction: the same answer once more, with dM qdd as a
     * load */
    if (c->others) {
        double push[PLANT_JOINTS], moved[PLANT_JOINTS];
        for (int i = 0; i < n; i++) {
            push[i] = torque[i];
            for (int m = 0; m < n; m++)
                push[i] -= dM[i][m] * qdd[m];
        }
        c->acceleration(c->self, q, qd, push, moved);
    }
}

static inline void concealed_acceleration(void *self, const double *q, const double *qd,
                                          const double *torque, double *qdd) {
    concealed *c = self;
    const int n = c->plant->joints;
    double x[PLANT_JOINTS], v[PLANT_JOINTS], push[PLANT_JOINTS];
    memcpy(x, q, sizeof(double) * (size_t)n);
    memcpy(v, qd, sizeof(double) * (size_t)n);
    memcpy(push, torque, sizeof(double) * (size_t)n);
    for (int i = 0; i < c->count; i++) {
        const concealed_effect *e = &c->effect[i];
        if (!concealed_divides(e))
            continue;
        x[e->joint] = e->s[0];
        v[e->joint] = e->s[1];
        push[e->joint] = concealed_spring(e, q[e->joint], qd[e->joint]);
    }
    concealed_links(c, x, v, push, qdd);
    for (int i = 0; i < c->count; i++) {
        concealed_effect *e = &c->effect[i];
        if (!concealed_divides(e))
            continue;
        e->s[2] = qdd[e->joint];
        qdd[e->joint] = (torque[e->joint] - push[e->joint]) / e->now;
    }
}

/* Links behind a transmission move as the plant's joints do: by the midpoint rule. */
static inline void concealed_others(void *self, int stage, double h) {
    concealed *c = self;
    if (c->others)
        c->others(c->others_self, stage, h);
    for (int i = 0; i < c->count; i++) {
        concealed_effect *e = &c->effect[i];
        if (!concealed_divides(e))
            continue;
        if (stage == 0) {
            e->from[0] = e->s[0];
            e->from[1] = e->s[1];
        }
        const double speed = e->s[1], part = stage == 0 ? 0.5 * h : h;
        e->s[0] = e->from[0] + part * speed;
        e->s[1] = e->from[1] + part * e->s[2];
    }
}

#endif
