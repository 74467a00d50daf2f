/* wam7_dynamics.h: rigid-body dynamics of the Barrett WAM, M(q) qdd + C(q, qd) qd + g(q) = tau, in
 * plain C.
 *
 * Newton-Euler in base coordinates (Luh, Walker, Paul 1980) for the bias torque, composite bodies
 * (Walker, Orin 1982) for M, Cholesky for the acceleration. No allocation, no state. Tested against
 * Pinocchio to 1e-9 (tests/machines).
 *
 * Frames: standard Denavit-Hartenberg, frame k fixed to link k: T = Rot(z, q) Trans(0, 0, d)
 * Trans(a, 0, 0) Rot(x, alpha). Inertial figures: Barrett Technology, "WAM Inertial Specifications"
 * AC-02, without a hand, as this project was given them. Masses and centres of mass are roundings
 * of what others republish (e.g. OpenRAVE's model of the arm); inertias of links 1 to 4 are not,
 * they differ by up to 0.1 %, and the products of inertia stand here as elements of the matrix,
 * with the opposite sign.
 */
#ifndef ZENDSP_WAM7_DYNAMICS_H
#define ZENDSP_WAM7_DYNAMICS_H

#include <math.h> /* sin, cos, sqrt */

enum { WAM7 = 7 };

/* An arm: its links, and the inertia of each rotor behind its drive. */
typedef struct wam7_link {
    double a, d;       /* m */
    double ca, sa;     /* cos and sin of alpha, exact for right angles */
    double mass;       /* kg */
    double com[3];     /* m, centre of mass in frame k */
    double inertia[6]; /* kg m^2 about the centre of mass, axes of frame k: xx yy zz xy xz yz */
} wam7_link;

typedef struct wam7_arm {
    wam7_link link[WAM7];
    double rotor[WAM7]; /* kg m^2, at the joint */
} wam7_arm;

static const double wam7_gravity[3] = {0.0, 0.0, -9.81}; /* m/s^2, base frame */

static const wam7_arm wam7_published = {.link = {
    {.a = 0.0, .d = 0.0, .ca = 0.0, .sa = -1.0, .mass = 10.768,
     .com = {-0.0044342, 0.12189, -0.00066489},
     .inertia = {0.134873, 0.113284, 0.0904562, 0.00213026, 0.000124857, -0.000685566}},
    {.a = 0.0, .d = 0.0, .ca = 0.0, .sa = 1.0, .mass = 3.8749,
     .com = {-0.0023698, 0.031056, 0.015421},
     .inertia = {0.0214093, 0.0137788, 0.015589, -0.000271719, -2.4597e-05, 0.00181916}},
    {.a = 0.045, .d = 0.55, .ca = 0.0, .sa = -1.0, .mass = 1.8023,
     .com = {-0.038259, 0.20751, 3.309e-05},
     .inertia = {0.0591122, 0.00324538, 0.0592641, 0.00249531, -7.38169e-06, 1.76755e-05}},
    {.a = -0.045, .d = 0.0, .ca = 0.0, .sa = 1.0, .mass = 2.4007,
     .com = {0.0049851, -0.00022942, 0.13272},
     .inertia = {0.0149055, 0.014818, 0.00294461, -1.74156e-05, 0.00150643, 2.1072e-05}},
    {.a = 0.0, .d = 0.3, .ca = 0.0, .sa = -1.0, .mass = 0.12376,
     .com = {8.921e-05, 0.0051122, 0.0043582},
     .inertia = {5.02849e-05, 7.58183e-05, 6.27046e-05, -2.03558e-07, 4.81173e-08, 3.58737e-06}},
    {.a = 0.0, .d = 0.0, .ca = 0.0, .sa = 1.0, .mass = 0.41797,
     .com = {0.00012262, -0.017032, 0.024683},
     .inertia = {0.000555163, 0.000243675, 0.000453575, -2.35292e-06, 3.27504e-06, 4.59051e-05}},
    {.a = 0.0, .d = 0.06, .ca = 1.0, .sa = 0.0, .mass = 0.068648,
     .com = {-7.974e-05, 0.00016313, -0.0032355},
     .inertia = {3.77295e-05, 3.80609e-05, 7.40777e-05, 1.89107e-07, -2.2889e-09, 3.7671e-09}},
}};

/* kg m^2, rotors at the joints (ratio squared), as OpenRAVE's model of the arm has them. */
static const double wam7_rotor[WAM7] = {0.201,     0.182,     0.067,      0.034,
                                        0.0033224, 0.0033224, 0.000466939};

/* Where everything is, in base coordinates, for one q. */
typedef struct wam7_pose {
    const wam7_arm *arm;
    double axis[WAM7][3];    /* of joint k */
    double origin[WAM7][3];  /* a point on that axis, m */
    double com[WAM7][3];     /* of link k, m */
    double inertia[WAM7][9]; /* of link k about its centre of mass, kg m^2 */
} wam7_pose;

static inline void wam7_cross(const double a[3], const double b[3], double r[3]) {
    r[0] = a[1] * b[2] - a[2] * b[1];
    r[1] = a[2] * b[0] - a[0] * b[2];
    r[2] = a[0] * b[1] - a[1] * b[0];
}

static inline double wam7_dot(const double a[3], const double b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* r = A b, A row by row. */
static inline void wam7_apply(const double A[9], const double b[3], double r[3]) {
    for (int i = 0; i < 3; i++)
        r[i] = A[3 * i] * b[0] + A[3 * i + 1] * b[1] + A[3 * i + 2] * b[2];
}

/* W = R I R^T for a symmetric I given as xx yy zz xy xz yz. */
static inline void wam7_turn(const double R[9], const double I[6], double W[9]) {
    const double full[9] = {I[0], I[3], I[4], I[3], I[1], I[5], I[4], I[5], I[2]};
    double half[9];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            half[3 * i + j] =
                R[3 * i] * full[j] + R[3 * i + 1] * full[3 + j] + R[3 * i + 2] * full[6 + j];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            W[3 * i + j] = half[3 * i] * R[3 * j] + half[3 * i + 1] * R[3 * j + 1] +
                           half[3 * i + 2] * R[3 * j + 2];
}

static inline void wam7_locate(const wam7_arm *arm, const double *q, wam7_pose *p) {
    p->arm = arm;
    double R[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, o[3] = {0, 0, 0}, c[3];
    for (int k = 0; k < WAM7; k++) {
        const wam7_link *l = &arm->link[k];
        const double cq = cos(q[k]), sq = sin(q[k]);
        const double step[9] = {cq,          -sq * l->ca, sq * l->sa, sq,   cq * l->ca,
                                -cq * l->sa, 0.0,         l->sa,      l->ca};
        const double way[3] = {l->a * cq, l->a * sq, l->d};
        double moved[3], next[9];
        for (int i = 0; i < 3; i++) {
            p->axis[k][i] = R[3 * i + 2];
            p->origin[k][i] = o[i];
        }
        wam7_apply(R, way, moved);
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                next[3 * i + j] =
                    R[3 * i] * step[j] + R[3 * i + 1] * step[3 + j] + R[3 * i + 2] * step[6 + j];
        for (int i = 0; i < 9; i++)
            R[i] = next[i];
        for (int i = 0; i < 3; i++)
            o[i] += moved[i];
        wam7_apply(R, l->com, c);
        for (int i = 0; i < 3; i++)
            p->com[k][i] = o[i] + c[i];
        wam7_turn(R, l->inertia, p->inertia[k]);
    }
}

/* tau of a motion; qdd may be NULL for zero acceleration (the bias torque). */
static inline void wam7_newton_euler(const wam7_pose *p, const double *qd, const double *qdd,
                                     double *tau) {
    double w[3] = {0, 0, 0}, wd[3] = {0, 0, 0}; /* of the link */
    double a[3], at[3] = {0, 0, 0};             /* acceleration of the point `at` of the link */
    double F[WAM7][3], N[WAM7][3], r[3], x[3], y[3];
    for (int i = 0; i < 3; i++)
        a[i] = -wam7_gravity[i]; /* a base that accelerates upwards stands for gravity */
    for (int k = 0; k < WAM7; k++) {
        /* to the origin of joint k, still with the link before */
        for (int i = 0; i < 3; i++)
            r[i] = p->origin[k][i] - at[i];
        wam7_cross(w, r, x);
        wam7_cross(w, x, y);
        wam7_cross(wd, r, x);
        for (int i = 0; i < 3; i++) {
            a[i] += x[i] + y[i];
            at[i] = p->origin[k][i];
        }
        /* the joint turns */
        wam7_cross(w, p->axis[k], x);
        for (int i = 0; i < 3; i++) {
            wd[i] += x[i] * qd[k] + (qdd ? p->axis[k][i] * qdd[k] : 0.0);
            w[i] += p->axis[k][i] * qd[k];
        }
        /* what link k needs */
        for (int i = 0; i < 3; i++)
            r[i] = p->com[k][i] - at[i];
        wam7_cross(w, r, x);
        wam7_cross(w, x, y);
        wam7_cross(wd, r, x);
        for (int i = 0; i < 3; i++)
            F[k][i] = p->arm->link[k].mass * (a[i] + x[i] + y[i]);
        wam7_apply(p->inertia[k], w, x);
        wam7_cross(w, x, y);
        wam7_apply(p->inertia[k], wd, x);
        for (int i = 0; i < 3; i++)
            N[k][i] = x[i] + y[i];
    }
    /* force, and moment about the base's origin, of links k and beyond */
    double f[3] = {0, 0, 0}, n[3] = {0, 0, 0};
    for (int k = WAM7 - 1; k >= 0; k--) {
        wam7_cross(p->com[k], F[k], x);
        for (int i = 0; i < 3; i++) {
            f[i] += F[k][i];
            n[i] += N[k][i] + x[i];
        }
        wam7_cross(p->origin[k], f, x);
        for (int i = 0; i < 3; i++)
            y[i] = n[i] - x[i];
        tau[k] = wam7_dot(p->axis[k], y) + (qdd ? p->arm->rotor[k] * qdd[k] : 0.0);
    }
}

/* Join body (m2, c2, I2) to (m1, c1, I1): mass, centre of mass, inertia about it. */
static inline void wam7_join(double *m1, double c1[3], double I1[9], double m2, const double c2[3],
                             const double I2[9]) {
    const double m = *m1 + m2, reduced = *m1 * m2 / m;
    double r[3];
    for (int i = 0; i < 3; i++)
        r[i] = c2[i] - c1[i];
    const double rr = wam7_dot(r, r);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            I1[3 * i + j] += I2[3 * i + j] + reduced * ((i == j ? rr : 0.0) - r[i] * r[j]);
    for (int i = 0; i < 3; i++)
        c1[i] += r[i] * m2 / m;
    *m1 = m;
}

static inline void wam7_mass(const wam7_pose *p, double M[WAM7][WAM7]) {
    double m = 0.0, c[3] = {0, 0, 0}, I[9] = {0}, r[3], f[3], n[3], x[3];
    for (int b = WAM7 - 1; b >= 0; b--) {
        wam7_join(&m, c, I, p->arm->link[b].mass, p->com[b], p->inertia[b]);
        /* unit acceleration of joint b alone: force and moment on everything from link b on */
        for (int i = 0; i < 3; i++)
            r[i] = c[i] - p->origin[b][i];
        wam7_cross(p->axis[b], r, f);
        for (int i = 0; i < 3; i++)
            f[i] *= m;
        wam7_apply(I, p->axis[b], n);
        for (int a = b; a >= 0; a--) {
            for (int i = 0; i < 3; i++)
                r[i] = c[i] - p->origin[a][i];
            wam7_cross(r, f, x);
            for (int i = 0; i < 3; i++)
                x[i] += n[i];
            M[a][b] = M[b][a] = wam7_dot(p->axis[a], x);
        }
        M[b][b] += p->arm->rotor[b];
    }
}

/* Inverse dynamics: tau of (q, qd, qdd), N m. With qd and qdd zero: gravity. */
static inline void wam7_inverse(const wam7_arm *arm, const double *q, const double *qd,
                                const double *qdd, double *tau) {
    wam7_pose p;
    wam7_locate(arm, q, &p);
    wam7_newton_euler(&p, qd, qdd, tau);
}

/* Hang a point mass on a link, at `place` in its frame. */
static inline void wam7_carry(wam7_link *l, double mass, const double place[3]) {
    const double I[6] = {l->inertia[0], l->inertia[1], l->inertia[2],
                         l->inertia[3], l->inertia[4], l->inertia[5]};
    double full[9] = {I[0], I[3], I[4], I[3], I[1], I[5], I[4], I[5], I[2]};
    const double none[9] = {0};
    wam7_join(&l->mass, l->com, full, mass, place, none);
    const double joined[6] = {full[0], full[4], full[8], full[1], full[2], full[5]};
    for (int i = 0; i < 6; i++)
        l->inertia[i] = joined[i];
}

/* Solve M x = b in place of b; M is symmetric and positive definite, and is overwritten by its
 * Cholesky factor. */
static inline void wam7_solve(double M[WAM7][WAM7], double *b) {
    for (int j = 0; j < WAM7; j++) {
        for (int k = 0; k < j; k++)
            M[j][j] -= M[j][k] * M[j][k];
        M[j][j] = sqrt(M[j][j]);
        for (int i = j + 1; i < WAM7; i++) {
            for (int k = 0; k < j; k++)
                M[i][j] -= M[i][k] * M[j][k];
            M[i][j] /= M[j][j];
        }
    }
    for (int i = 0; i < WAM7; i++) {
        for (int k = 0; k < i; k++)
            b[i] -= M[i][k] * b[k];
        b[i] /= M[i][i];
    }
    for (int i = WAM7 - 1; i >= 0; i--) {
        for (int k = i + 1; k < WAM7; k++)
            b[i] -= M[k][i] * b[k];
        b[i] /= M[i][i];
    }
}

/* Forward dynamics: qdd under tau, rad/s^2. */
static inline void wam7_forward(const wam7_arm *arm, const double *q, const double *qd,
                                const double *tau, double *qdd) {
    wam7_pose p;
    double M[WAM7][WAM7], bias[WAM7];
    wam7_locate(arm, q, &p);
    wam7_newton_euler(&p, qd, (const double *)0, bias);
    wam7_mass(&p, M);
    for (int k = 0; k < WAM7; k++)
        qdd[k] = tau[k] - bias[k];
    wam7_solve(M, qdd);
}

#endif
