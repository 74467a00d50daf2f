/* The steps of reality.py's machine, whose numbers stand before this text as struct numbers. */
#include <math.h>

/* joint; load; filtered position; bend of the bristles */
typedef struct { double q, v, there, speed, seen, bend; } state;

/* Torque of the spring or the gap on the joint; the load moves on. */
static double pull(const numbers *m, state *s, double h)
{
    /* an uneven transmission turns the spring by `slope` for each turn of the motor */
    const double slope = 1.0 + 5 * m->wobble * cos(5 * s->q + 0.6),
                 apart = s->q + m->wobble * sin(5 * s->q + 0.6) - s->there;
    double push = 0.0;
    if (m->soft != 0.0) {
        push = m->soft * apart + m->hard * pow(apart, 3) + 0.02 * (slope * s->v - s->speed);
        const double held = tanh(s->speed / 1e-3), steep = m->dry_load / 1e-3 * (1 - held * held);
        s->speed += h * (push - m->dry_load * held) / (m->load + h * steep);
    } else {
        const double side = copysign(1.0, apart), deep = apart - side * 0.5 * m->gap;
        if (fabs(apart) > 0.5 * m->gap)
            push = copysign(fmax(0.0, side * (120.0 * deep + 0.2 * (s->v - s->speed))), apart);
        s->speed += h * push / m->load;
    }
    s->there += h * s->speed;
    return slope * push;
}

/* Torque that resists the joint, but for dry friction, and the inertia that it turns. */
static double resist(const numbers *m, double q, double v, double *inertia)
{
    double f = m->viscous * v + m->drag * copysign(pow(fabs(v), m->power), v) +
               m->gravity * sin(q) + m->ripple * sin(m->order * q + 0.4) + m->spring * q;
    f += m->wave * tanh(3 * sin(3 * q)) * cos(2 * v) + m->wiggle * v / (1 + v * v);
    *inertia = m->inertia;
    if (m->wobble != 0.0 && m->soft == 0.0) { /* the load turns by `slope` a turn of the motor */
        const double slope = 1.0 + 5 * m->wobble * cos(5 * q + 0.6),
                     bend = -25 * m->wobble * sin(5 * q + 0.6);
        *inertia *= slope * slope;
        f += m->inertia * slope * bend * v * v;
        f += m->gravity * (slope * sin(q + m->wobble * sin(5 * q + 0.6)) - sin(q));
    }
    if (q > m->edge) f += fmax(0.0, m->touch * pow((q - m->edge) / 0.1, 1.5) * (1 + 0.1 * v));
    f += m->sticky * tanh(2 * sin(3 * q)) * tanh(v / 0.1);
    return f + (m->swirl * sin(2 * v) + m->blend * q * v);
}

/* A step of h seconds under the actuator's torque and one from outside; thin: of dry friction. */
static void step(const numbers *m, state *s, double torque, double outside, double thin, double h)
{
    const double q = s->q, v = s->v;
    double inertia, level = m->coulomb + m->uneven * sin(7 * q);
    if (m->breakaway != 0.0)
        level += (m->breakaway - m->coulomb) * exp(-pow(fabs(v / m->stribeck), m->tail));
    level *= thin;
    torque = fmax(-m->supply - m->back * v, fmin(m->supply - m->back * v, torque));
    torque = fmax(-m->weak, fmin(m->weak, torque)) + outside;
    torque -= resist(m, q, v, &inertia);
    if (m->soft != 0.0 || m->load != 0.0) torque -= pull(m, s, h);
    if (m->bristle != 0.0) { /* LuGre */
        const double flow = v - m->bristle * fabs(v) * s->bend / level;
        torque -= m->bristle * s->bend + m->brush * flow;
        s->bend += h * flow;
        level = 0.0;
    }
    if (m->lead != 0.0) { /* as MuJoCo's: of the speed to come, straight to its level */
        const double grip = level / m->creep, ahead = (m->lead + h) / inertia;
        torque -= fmax(-level, fmin(level, grip * (v + ahead * torque) / (1 + grip * ahead)));
        level = 0.0;
    }
    /* dry friction implicitly in its slope: stable at any step */
    const double way = tanh(v / m->creep), steep = level / m->creep * (1 - way * way);
    s->v += h * (torque - level * way) / (inertia - m->load + h * steep);
    s->q += h * s->v;
    if (m->smear != 0.0) s->seen += h * (s->q - s->seen) / m->smear;
}

static double counted(double at, double resolution)
{
    return resolution > 0.0 ? resolution * rint(at / resolution) : at;
}

/* n samples T apart, `sub` steps each. warm: degrees C; outside: torque; both (n,). out, (4, n):
 * position as recorded, command, the load's position, torque of the spring. */
void run(const numbers *m, int n, int sub, double T, const double *reference, const double *warm,
         const double *outside, double *out)
{
    const double h = T / sub;
    const long late = lrint(m->delay / h);
    double last = reference[0], *seen = out, *u = out + n, *far = out + 2 * n, *bent = out + 3 * n;
    state s = {.q = last, .there = last - 0.5 * m->gap, .seen = last};
    for (int k = 0; k < n; k++) {
        const double y = counted(s.q + m->oval * sin(2 * s.q + 0.3), m->resolution),
                     told = m->kp * (reference[k] - y) - m->kd * (y - last) / T,
                     apart = s.q - s.there, faded = 1.0 + m->fade * (1.0 - exp(-k * T / m->fading));
        last = y;
        seen[k] = m->smear != 0.0 ? counted(s.seen, m->resolution) : y;
        u[k] = fmax(-m->limit, fmin(m->limit, told));
        far[k] = counted(m->load != 0.0 ? s.there : s.q, m->resolution);
        bent[k] = m->soft * apart + m->hard * pow(apart, 3);
        for (int i = 0; i < sub; i++) {
            const long at = (long)k * sub + i - late;
            const double torque = late == 0 ? u[k] * faded : at < 0 ? 0.0 : u[at / sub];
            step(m, &s, torque, outside[k], 1.0 - m->thin * (warm[k] - 20.0), h);
        }
    }
}
