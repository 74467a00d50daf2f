/* tree.h: rigid-body dynamics of a tree of one-degree-of-freedom joints, in plain C.
 *
 *     M(q) qdd + C(q, qd) qd + g(q) = tau
 *
 * Newton-Euler in link coordinates (Luh, Walker, Paul 1980) for torques, composite bodies (Walker,
 * Orin 1982) for M. Used by the simulator and by generated control code. Parents come before their
 * children. Units: m, kg, s, rad (or m where prismatic).
 */
#ifndef ZENDSP_TREE_H
#define ZENDSP_TREE_H

#include <math.h> /* sin, cos */

enum { TREE_MAX = 8, TREE_ROW = 28 };

/* One joint and the link that it carries: TREE_ROW numbers. */
enum {
    TREE_PARENT = 0,    /* index of the joint before it, -1: the base */
    TREE_PRISMATIC = 1, /* 1: slides along its axis; 0: turns about it */
    TREE_AXIS = 2,      /* 3: unit vector in the joint's frame */
    TREE_R = 5,         /* 9: joint frame in the parent's, at q = 0, row by row */
    TREE_P = 14,        /* 3: its origin in the parent's frame, m */
    TREE_MASS = 17,     /* kg */
    TREE_COM = 18,      /* 3: m, in the joint's frame */
    TREE_I = 21,        /* 6: about the centre of mass, xx yy zz xy xz yz, kg m^2 */
    TREE_ROTOR = 27     /* kg m^2 (or kg) added at the joint */
};

/* Where every joint frame is in its parent's, for one q. */
typedef struct tree_pose {
    double R[TREE_MAX][9], p[TREE_MAX][3];
} tree_pose;

static inline void tree_cross(const double *a, const double *b, double *r) {
    r[0] = a[1] * b[2] - a[2] * b[1];
    r[1] = a[2] * b[0] - a[0] * b[2];
    r[2] = a[0] * b[1] - a[1] * b[0];
}

static inline double tree_dot(const double *a, const double *b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* r = R b, and r = transpose(R) b. */
static inline void tree_out(const double *R, const double *b, double *r) {
    for (int i = 0; i < 3; i++)
        r[i] = R[3 * i] * b[0] + R[3 * i + 1] * b[1] + R[3 * i + 2] * b[2];
}
static inline void tree_in(const double *R, const double *b, double *r) {
    for (int i = 0; i < 3; i++)
        r[i] = R[i] * b[0] + R[3 + i] * b[1] + R[6 + i] * b[2];
}

/* r = I b for a symmetric I: xx yy zz xy xz yz. */
static inline void tree_sym(const double *I, const double *b, double *r) {
    r[0] = I[0] * b[0] + I[3] * b[1] + I[4] * b[2];
    r[1] = I[3] * b[0] + I[1] * b[1] + I[5] * b[2];
    r[2] = I[4] * b[0] + I[5] * b[1] + I[2] * b[2];
}

static inline void tree_place(int n, const double *tree, const double *q, tree_pose *pose) {
    for (int k = 0; k < n; k++) {
        const double *link = tree + k * TREE_ROW, *a = link + TREE_AXIS, *R0 = link + TREE_R;
        for (int i = 0; i < 3; i++)
            pose->p[k][i] = link[TREE_P + i];
        if (link[TREE_PRISMATIC] != 0.0) {
            double way[3];
            tree_out(R0, a, way);
            for (int i = 0; i < 9; i++)
                pose->R[k][i] = R0[i];
            for (int i = 0; i < 3; i++)
                pose->p[k][i] += q[k] * way[i];
            continue;
        }
        /* Rodrigues: turn by q about a */
        const double c = cos(q[k]), s = sin(q[k]), d = 1.0 - c;
        const double T[9] = {
            c + d * a[0] * a[0],        d * a[0] * a[1] - s * a[2], d * a[0] * a[2] + s * a[1],
            d * a[0] * a[1] + s * a[2], c + d * a[1] * a[1],        d * a[1] * a[2] - s * a[0],
            d * a[0] * a[2] - s * a[1], d * a[1] * a[2] + s * a[0], c + d * a[2] * a[2]};
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                pose->R[k][3 * i + j] =
                    R0[3 * i] * T[j] + R0[3 * i + 1] * T[3 + j] + R0[3 * i + 2] * T[6 + j];
    }
}

/* tau = M qdd + C qd + g; qdd = NULL stands for zero. gravity: m/s^2 in the base frame. */
static inline void tree_torque(int n, const double *tree, const tree_pose *pose,
                               const double *gravity, const double *qd, const double *qdd,
                               double *tau) {
    double w[TREE_MAX][3], al[TREE_MAX][3], acc[TREE_MAX][3], force[TREE_MAX][3],
        moment[TREE_MAX][3];
    const double still[3] = {0.0, 0.0, 0.0}, lift[3] = {-gravity[0], -gravity[1], -gravity[2]};
    for (int k = 0; k < n; k++) {
        const double *link = tree + k * TREE_ROW, *a = link + TREE_AXIS, *R = pose->R[k],
                     *p = pose->p[k];
        const int parent = (int)link[TREE_PARENT], slides = link[TREE_PRISMATIC] != 0.0;
        const double *w0 = parent < 0 ? still : w[parent], *al0 = parent < 0 ? still : al[parent];
        const double *acc0 = parent < 0 ? lift : acc[parent];
        const double v = qd[k], v2 = qdd ? qdd[k] : 0.0;
        double t1[3], t2[3], at[3], x[3];
        tree_cross(w0, p, t1);
        tree_cross(w0, t1, at);
        tree_cross(al0, p, t1);
        for (int i = 0; i < 3; i++)
            at[i] += acc0[i] + t1[i];
        tree_in(R, w0, w[k]);
        tree_in(R, al0, al[k]);
        tree_in(R, at, acc[k]);
        if (slides) {
            tree_cross(w[k], a, t1);
            for (int i = 0; i < 3; i++)
                acc[k][i] += v2 * a[i] + 2.0 * v * t1[i];
        } else {
            tree_cross(w[k], a, t1);
            for (int i = 0; i < 3; i++) {
                al[k][i] += v2 * a[i] + v * t1[i];
                w[k][i] += v * a[i];
            }
        }
        const double *c = link + TREE_COM, m = link[TREE_MASS];
        tree_cross(w[k], c, t1);
        tree_cross(w[k], t1, t2);
        tree_cross(al[k], c, t1);
        for (int i = 0; i < 3; i++)
            force[k][i] = m * (acc[k][i] + t1[i] + t2[i]);
        tree_sym(link + TREE_I, w[k], x);
        tree_cross(w[k], x, t1);
        tree_sym(link + TREE_I, al[k], x);
        tree_cross(c, force[k], t2);
        for (int i = 0; i < 3; i++)
            moment[k][i] = x[i] + t1[i] + t2[i]; /* about the joint's origin */
    }
    for (int k = n - 1; k >= 0; k--) {
        const double *link = tree + k * TREE_ROW;
        const int parent = (int)link[TREE_PARENT];
        tau[k] = tree_dot(link + TREE_AXIS, link[TREE_PRISMATIC] != 0.0 ? force[k] : moment[k]) +
                 link[TREE_ROTOR] * (qdd ? qdd[k] : 0.0);
        if (parent >= 0) {
            double f[3], m[3], lever[3];
            tree_out(pose->R[k], force[k], f);
            tree_out(pose->R[k], moment[k], m);
            tree_cross(pose->p[k], f, lever);
            for (int i = 0; i < 3; i++) {
                force[parent][i] += f[i];
                moment[parent][i] += m[i] + lever[i];
            }
        }
    }
}

/* M(q), n x n, row by row. */
static inline void tree_mass(int n, const double *tree, const tree_pose *pose, double *M) {
    /* of each link with all it carries: mass, m c, inertia about the origin */
    double m[TREE_MAX], h[TREE_MAX][3], I[TREE_MAX][6];
    for (int k = 0; k < n; k++) {
        const double *link = tree + k * TREE_ROW, *c = link + TREE_COM, *J = link + TREE_I,
                     mass = link[TREE_MASS];
        const double cc = tree_dot(c, c);
        m[k] = mass;
        for (int i = 0; i < 3; i++) {
            h[k][i] = mass * c[i];
            I[k][i] = J[i] + mass * (cc - c[i] * c[i]);
        }
        I[k][3] = J[3] - mass * c[0] * c[1];
        I[k][4] = J[4] - mass * c[0] * c[2];
        I[k][5] = J[5] - mass * c[1] * c[2];
    }
    for (int k = n - 1; k >= 0; k--) {
        const double *link = tree + k * TREE_ROW, *R = pose->R[k], *p = pose->p[k];
        const int parent = (int)link[TREE_PARENT];
        if (parent < 0)
            continue;
        /* inertia in the parent's axes, about its origin: R I R' + moved by p */
        double g[3], X[9], col[3], in[3];
        tree_out(R, h[k], g);
        for (int j = 0; j < 3; j++) {
            for (int i = 0; i < 3; i++)
                in[i] = R[3 * j + i]; /* row j of R = column j of R' */
            tree_sym(I[k], in, col);
            double out[3];
            tree_out(R, col, out);
            for (int i = 0; i < 3; i++)
                X[3 * i + j] = out[i];
        }
        const double gp = tree_dot(g, p), pp = tree_dot(p, p), mass = m[k];
        static const int at[6][2] = {{0, 0}, {1, 1}, {2, 2}, {0, 1}, {0, 2}, {1, 2}};
        for (int s = 0; s < 6; s++) {
            const int i = at[s][0], j = at[s][1];
            I[parent][s] += X[3 * i + j] + (i == j ? 2.0 * gp + mass * pp : 0.0) - g[i] * p[j] -
                            p[i] * g[j] - mass * p[i] * p[j];
        }
        m[parent] += mass;
        for (int i = 0; i < 3; i++)
            h[parent][i] += g[i] + mass * p[i];
    }
    for (int i = 0; i < n * n; i++)
        M[i] = 0.0;
    for (int k = 0; k < n; k++) {
        const double *link = tree + k * TREE_ROW, *a = link + TREE_AXIS;
        double f[3], t[3]; /* force and moment at the origin for a unit acceleration of joint k */
        if (link[TREE_PRISMATIC] != 0.0) {
            for (int i = 0; i < 3; i++)
                f[i] = m[k] * a[i];
            tree_cross(h[k], a, t);
        } else {
            tree_cross(a, h[k], f);
            tree_sym(I[k], a, t);
        }
        M[k * n + k] = tree_dot(a, link[TREE_PRISMATIC] != 0.0 ? f : t) + link[TREE_ROTOR];
        for (int j = k, parent = (int)link[TREE_PARENT]; parent >= 0;
             j = parent, parent = (int)tree[j * TREE_ROW + TREE_PARENT]) {
            double fo[3], to[3], lever[3];
            tree_out(pose->R[j], f, fo);
            tree_out(pose->R[j], t, to);
            tree_cross(pose->p[j], fo, lever);
            for (int i = 0; i < 3; i++) {
                f[i] = fo[i];
                t[i] = to[i] + lever[i];
            }
            const double *up = tree + parent * TREE_ROW;
            M[parent * n + k] = M[k * n + parent] =
                tree_dot(up + TREE_AXIS, up[TREE_PRISMATIC] != 0.0 ? f : t);
        }
    }
}

#endif
