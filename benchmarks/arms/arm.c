// A chain of revolute joints by recursive Newton-Euler; fmi2.c and fmi3.c make it an FMU.
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "numbers.h"  // N, FRICTION, START, AXIS, PLACE, COM, INERTIA, GRAVITY

#define API __attribute__((visibility("default")))
#define STEPS_PER_S 5000.0
enum { NONE, STICKS, SMOOTH };  // dry friction inside
enum { U = 0, Q = N, V = 2 * N, MASS = 3 * N, ROTOR = 4 * N, VISCOUS = 5 * N, DRY = 6 * N,
       COUNT = 7 * N };  // value references

typedef struct { double v[COUNT]; } chain;

static double dot(const double *a, const double *b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double *a, const double *b, double *out) {
    double c[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
    memcpy(out, c, sizeof c);
}

// out = R(axis, angle) x
static void rotate(const double *axis, double angle, const double *x, double *out) {
    double c = cos(angle), s = sin(angle), along = dot(axis, x), k[3];
    cross(axis, x, k);
    for (int i = 0; i < 3; i++) out[i] = c * x[i] + s * k[i] + (1 - c) * along * axis[i];
}

static void outwards(const double *q, const double *qd, const double *qdd, double g,
                     double w[][3], double dw[][3], double a[][3]) {
    memset(w[0], 0, sizeof w[0]);
    memset(dw[0], 0, sizeof dw[0]);
    for (int i = 0; i < 3; i++) a[0][i] = -g * GRAVITY[i];
    for (int k = 0; k < N; k++) {
        double x[3], y[3], at[3];
        cross(dw[k], PLACE[k], x);
        cross(w[k], PLACE[k], y);
        cross(w[k], y, y);
        for (int i = 0; i < 3; i++) at[i] = a[k][i] + x[i] + y[i];
        rotate(AXIS[k], -q[k], at, a[k + 1]);
        rotate(AXIS[k], -q[k], w[k], w[k + 1]);
        rotate(AXIS[k], -q[k], dw[k], dw[k + 1]);
        cross(w[k + 1], AXIS[k], x);
        for (int i = 0; i < 3; i++) {
            w[k + 1][i] += AXIS[k][i] * qd[k];
            dw[k + 1][i] += AXIS[k][i] * qdd[k] + x[i] * qd[k];
        }
    }
}

// Torques of the motion without rotors and friction; g: 1 with gravity, 0 without.
static void inverse(const double *m, const double *q, const double *qd, const double *qdd, double g,
                    double *tau) {
    double w[N + 1][3], dw[N + 1][3], a[N + 1][3], force[3] = {0}, moment[3] = {0};
    outwards(q, qd, qdd, g, w, dw, a);
    for (int k = N - 1; k >= 0; k--) {
        double x[3], y[3], f[3], spin[3], turned[3];
        cross(dw[k + 1], COM[k], x);
        cross(w[k + 1], COM[k], y);
        cross(w[k + 1], y, y);
        for (int i = 0; i < 3; i++) {
            f[i] = m[k] * (a[k + 1][i] + x[i] + y[i]);
            spin[i] = INERTIA[k][i] * w[k + 1][i];
        }
        cross(w[k + 1], spin, x);
        cross(COM[k], f, y);
        for (int i = 0; i < 3; i++) {
            force[i] += f[i];
            moment[i] += INERTIA[k][i] * dw[k + 1][i] + x[i] + y[i];
        }
        tau[k] = dot(AXIS[k], moment);
        rotate(AXIS[k], q[k], force, turned);
        memcpy(force, turned, sizeof force);
        rotate(AXIS[k], q[k], moment, turned);
        cross(PLACE[k], force, x);
        for (int i = 0; i < 3; i++) moment[i] = turned[i] + x[i];
    }
}

// The inverse of the mass matrix.
static void mobility(const double *p, const double *q, double out[N][N]) {
    double a[N][2 * N], still[N] = {0}, unit[N], tau[N];
    for (int j = 0; j < N; j++) {
        memset(unit, 0, sizeof unit);
        unit[j] = 1;
        inverse(p + MASS, q, still, unit, 0, tau);
        for (int i = 0; i < N; i++) {
            a[i][j] = tau[i] + (i == j) * p[ROTOR + i];
            a[i][N + j] = i == j;
        }
    }
    for (int c = 0; c < N; c++) {
        double d = a[c][c];
        for (int j = 0; j < 2 * N; j++) a[c][j] /= d;
        for (int i = 0; i < N; i++) {
            double by = a[i][c];
            for (int j = 0; j < 2 * N && i != c; j++) a[i][j] -= by * a[c][j];
        }
    }
    for (int i = 0; i < N; i++) memcpy(out[i], a[i] + N, sizeof out[i]);
}

// Impulses of dry friction: what stays within its limits leaves its joint at rest.
static void stick(const double *p, double h, double give[N][N], double *v) {
    double push[N] = {0};
    for (int sweep = 0; sweep < 30; sweep++) {
        double moved = 0;
        for (int i = 0; i < N; i++) {
            double most = h * p[DRY + i], wanted = push[i] - v[i] / give[i][i];
            wanted = wanted > most ? most : wanted < -most ? -most : wanted;
            double change = wanted - push[i];
            push[i] = wanted;
            moved += fabs(change);
            for (int j = 0; j < N; j++) v[j] += give[j][i] * change;
        }
        if (moved < 1e-14) break;
    }
}

static void advance(double *p, double seconds) {
    int steps = (int)ceil(seconds * STEPS_PER_S - 1e-6);
    double h = seconds / steps, acc[N] = {0};
    for (int s = 0; s < steps; s++) {
        double q[N], v[N], tau[N], give[N][N], still[N] = {0}, next[N];
        for (int i = 0; i < N; i++) {
            q[i] = p[Q + i] + 0.5 * h * p[V + i];
            v[i] = p[V + i] + 0.5 * h * acc[i];
        }
        inverse(p + MASS, q, v, still, 1, tau);
        mobility(p, q, give);
        for (int i = 0; i < N; i++) {
            tau[i] = p[U + i] - tau[i] - p[VISCOUS + i] * v[i];
            if (FRICTION == SMOOTH) tau[i] -= p[DRY + i] * tanh(v[i] / 0.002);
        }
        for (int i = 0; i < N; i++) {
            next[i] = p[V + i];
            for (int j = 0; j < N; j++) next[i] += h * give[i][j] * tau[j];
        }
        if (FRICTION == STICKS) stick(p, h, give, next);
        for (int i = 0; i < N; i++) {
            p[Q + i] += 0.5 * h * (p[V + i] + next[i]);
            acc[i] = (next[i] - p[V + i]) / h;
            p[V + i] = next[i];
        }
    }
}

static void begin(chain *c) {
    memset(c, 0, MASS * sizeof(double));
    memcpy(c->v + MASS, START, sizeof START);
}

static void set(chain *c, const unsigned r[], size_t n, const double x[]) {
    for (size_t i = 0; i < n; i++) c->v[r[i]] = x[i];
}

static void get(const chain *c, const unsigned r[], size_t n, double x[]) {
    for (size_t i = 0; i < n; i++) x[i] = c->v[r[i]];
}
