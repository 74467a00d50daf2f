/* Mass matrix and bias (Coriolis, centrifugal, gravity) of the three mechanisms, with position q
   and velocity v. The chain works in world coordinates with spatial vectors about the world's
   origin (composite bodies for M, Newton-Euler for the bias): no joint frames to get wrong, and
   nothing in common with the library that is judged. */

typedef struct { double w[3], v[3]; } Spatial; /* angular part, linear part */
/* mass, first moment, inertia about the world's origin */
typedef struct { double m, mc[3], i[9]; } Body;

static void cross(const double a[3], const double b[3], double r[3]) {
    r[0] = a[1] * b[2] - a[2] * b[1];
    r[1] = a[2] * b[0] - a[0] * b[2];
    r[2] = a[0] * b[1] - a[1] * b[0];
}

static double dot(const double a[3], const double b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void multiply(const double a[9], const double b[9], double r[9]) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

static void rotate(const double a[9], const double x[3], double r[3]) {
    for (int i = 0; i < 3; i++) r[i] = dot(a + 3 * i, x);
}

static Body body_in_world(const Link *l, const double rot[9], const double org[3]) {
    Body b;
    double c[3], tmp[9], turned[9], transposed[9];
    rotate(rot, l->com, c);
    for (int i = 0; i < 3; i++) c[i] += org[i];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) transposed[3 * i + j] = rot[3 * j + i];
    multiply(rot, l->inertia, tmp);
    multiply(tmp, transposed, turned);
    b.m = l->mass;
    for (int i = 0; i < 3; i++) b.mc[i] = l->mass * c[i];
    double cc = dot(c, c);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            b.i[3 * i + j] = turned[3 * i + j] + l->mass * ((i == j ? cc : 0.0) - c[i] * c[j]);
    return b;
}

/* momentum of a body that moves with s; the angular part of the answer is about the world's origin
 */
static Spatial momentum(const Body *b, const Spatial *s) {
    Spatial h;
    double a[3], c[3];
    rotate(b->i, s->w, h.w);
    cross(b->mc, s->v, a);
    cross(s->w, b->mc, c);
    for (int i = 0; i < 3; i++) {
        h.w[i] += a[i];
        h.v[i] = b->m * s->v[i] + c[i];
    }
    return h;
}

static void chain(const Machine *m, const double *q, const double *v, double M[7][7],
                  double *bias) {
    Body body[7];
    Spatial axis[7], force[7];
    double rot[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, org[3] = {0, 0, 0};
    Spatial vel = {{0, 0, 0}, {0, 0, 0}},
            acc = {{0, 0, 0}, {-m->down[0], -m->down[1], -m->down[2]}};
    for (int i = 0; i < m->n; i++) {
        double step[3], fixed[9], c = cos(q[i]), s = sin(q[i]);
        const double turn[9] = {c, -s, 0, s, c, 0, 0, 0, 1};
        rotate(rot, m->link[i].place, step);
        for (int k = 0; k < 3; k++) org[k] += step[k];
        multiply(rot, m->link[i].rotation, fixed);
        multiply(fixed, turn, rot);
        Spatial *a = &axis[i];
        for (int k = 0; k < 3; k++) a->w[k] = rot[3 * k + 2];
        cross(org, a->w, a->v);
        body[i] = body_in_world(&m->link[i], rot, org);
        for (int k = 0; k < 3; k++) vel.w[k] += a->w[k] * v[i], vel.v[k] += a->v[k] * v[i];
        double x[3], y[3], z[3];
        cross(vel.w, a->w, x);
        cross(vel.w, a->v, y);
        cross(vel.v, a->w, z);
        for (int k = 0; k < 3; k++) acc.w[k] += x[k] * v[i], acc.v[k] += (y[k] + z[k]) * v[i];
        Spatial h = momentum(&body[i], &vel), f = momentum(&body[i], &acc);
        cross(vel.w, h.w, x);
        cross(vel.v, h.v, y);
        cross(vel.w, h.v, z);
        for (int k = 0; k < 3; k++) f.w[k] += x[k] + y[k], f.v[k] += z[k];
        force[i] = f;
    }
    for (int i = m->n - 1; i >= 0; i--) {
        bias[i] = dot(axis[i].w, force[i].w) + dot(axis[i].v, force[i].v);
        Spatial h = momentum(&body[i], &axis[i]);
        for (int j = 0; j <= i; j++) M[i][j] = M[j][i] = dot(axis[j].w, h.w) + dot(axis[j].v, h.v);
        if (i == 0) break;
        for (int k = 0; k < 3; k++)
            force[i - 1].w[k] += force[i].w[k], force[i - 1].v[k] += force[i].v[k];
        body[i - 1].m += body[i].m;
        for (int k = 0; k < 3; k++) body[i - 1].mc[k] += body[i].mc[k];
        for (int k = 0; k < 9; k++) body[i - 1].i[k] += body[i].i[k];
    }
}

static void mechanism(const Machine *m, const double *q, const double *v, double M[7][7],
                      double *bias) {
    if (m->kind == 0) {
        M[0][0] = m->p[0];
        bias[0] = m->p[1] != 0.0 ? m->p[1] * sin(q[0]) : 0.0;
    } else if (m->kind == 1) {
        double c = m->p[2] * cos(q[1]), s = m->p[2] * sin(q[1]);
        M[0][0] = m->p[0] + 2 * c;
        M[0][1] = M[1][0] = m->p[1] + c;
        M[1][1] = m->p[1];
        bias[0] = -s * v[1] * (2 * v[0] + v[1]);
        bias[1] = s * v[0] * v[0];
    } else {
        chain(m, q, v, M, bias);
    }
    for (int i = 0; i < m->n; i++) M[i][i] += m->joint[i].extra_inertia;
    for (int i = 0; i < m->couplings; i++) {
        const Coupling *c = &m->coupling[i];
        /* one-sided as the contract has it: c qdd_from acts on joint `to`; made symmetric, as a
         * shared rotor is */
        if (c->law == 0) M[c->to][c->from] += c->coefficient;
    }
}

void inverse(const Machine *m, int rows, const double *q, const double *v, const double *a,
             double *tau) {
    double M[7][7], bias[7];
    for (int k = 0; k < rows; k++, q += m->n, v += m->n, a += m->n, tau += m->n) {
        mechanism(m, q, v, M, bias);
        for (int i = 0; i < m->n; i++) {
            tau[i] = bias[i];
            for (int j = 0; j < m->n; j++) tau[i] += M[i][j] * a[j];
        }
    }
}
