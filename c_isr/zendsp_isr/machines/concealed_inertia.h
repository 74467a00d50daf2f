/* concealed_inertia.h: more inertia than the machine's own law knows.
 *
 *     (M + dM) qdd = tau - bias,   given qdd0 = M^-1 (tau - bias) as a black box
 *
 * Columns of M^-1 are the answers to one more N m on each joint; then (1 + M^-1 dM) qdd = qdd0 is a
 * small linear system.
 */
#ifndef ZENDSP_CONCEALED_INERTIA_H
#define ZENDSP_CONCEALED_INERTIA_H

#include "concealed_laws.h"

static inline void concealed_acceleration(void *self, const double *q, const double *qd,
                                          const double *torque, double *qdd) {
    concealed *c = self;
    const int n = c->plant->joints;
    c->acceleration(c->self, q, qd, torque, qdd);
    if (!c->massive)
        return;
    double W[PLANT_JOINTS][PLANT_JOINTS], A[PLANT_JOINTS][PLANT_JOINTS] = {{0}}, push[PLANT_JOINTS],
                                          moved[PLANT_JOINTS];
    for (int k = 0; k < n; k++) { /* column k of M^-1: the answer to one more N m on joint k */
        memcpy(push, torque, sizeof(double) * (size_t)n);
        push[k] += 1.0;
        c->acceleration(c->self, q, qd, push, moved);
        for (int i = 0; i < n; i++)
            W[i][k] = moved[i] - qdd[i];
    }
    for (int i = 0; i < n; i++)
        for (int k = 0; k < n; k++) {
            A[i][k] = i == k;
            for (int m = 0; m < n; m++)
                A[i][k] += W[i][m] * c->dM[m][k];
        }
    for (int k = 0; k < n; k++) { /* Gauss–Jordan with pivoting: n is small */
        int best = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(A[i][k]) > fabs(A[best][k]))
                best = i;
        for (int m = 0; m < n; m++) {
            const double swap = A[k][m];
            A[k][m] = A[best][m];
            A[best][m] = swap;
        }
        const double swap = qdd[k];
        qdd[k] = qdd[best];
        qdd[best] = swap;
        for (int i = 0; i < n; i++) {
            if (i == k)
                continue;
            const double share = A[i][k] / A[k][k];
            for (int m = k; m < n; m++)
                A[i][m] -= share * A[k][m];
            qdd[i] -= share * qdd[k];
        }
    }
    for (int k = 0; k < n; k++)
        qdd[k] /= A[k][k];
    /* what moves beside the joints feels the reaction: the same answer once more, with dM qdd as a
     * load */
    if (c->plant->others) {
        for (int i = 0; i < n; i++) {
            push[i] = torque[i];
            for (int m = 0; m < n; m++)
                push[i] -= c->dM[i][m] * qdd[m];
        }
        c->acceleration(c->self, q, qd, push, moved);
    }
}

#endif
