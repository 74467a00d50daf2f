/* The torques of one joint. State that is neither position nor velocity (bristle, Bouc-Wen,
   actuator) is in Hidden and is advanced by its exact solution over a step where it has one. Signs:
   what is returned by resist() opposes, i.e. stands on the left of M qdd + ... + effect = torque.
 */

typedef struct {
    double bristle;  /* [rad] */
    double hysteresis; /* Bouc-Wen z, |z| <= 1 */
    double torque;   /* of the actuator after its lag [N m] */
} Hidden;

static double sign(double x) { return (x > 0) - (x < 0); }

static double drift(const Joint *j, double t) {
    return j->drift_ratio == 0.0 ? 1.0 : 1.0 + j->drift_ratio * (1.0 - exp(-t / j->drift_time));
}

/* largest torque that the set-valued friction can bear when it opposes a motion in the direction
 * `way` */
static double friction_level(const Joint *j, double q, double v, double torque, double t, int way) {
    double level = way >= 0 ? j->coulomb_pos : j->coulomb_neg;
    if (j->stribeck_extra != 0.0)
        level +=
            j->stribeck_extra * exp(-pow(fabs(v) / j->stribeck_velocity, j->stribeck_exponent));
    if (j->level_amplitude != 0.0)
        level += j->level_amplitude * sin(2 * M_PI * q / j->level_period + j->level_phase);
    level += j->load_mu * fabs(torque);
    return level > 0.0 ? level * drift(j, t) : 0.0;
}

/* place in a grid: the cell, and how far into it; a grid goes on as it ends */
static double cell(double x, double first, double step, int count, int *at) {
    double place = fmin(fmax((x - first) / step, 0.0), count - 1.0);
    *at = (int)fmin(floor(place), count - 2.0);
    return place - *at;
}

/* bilinear in a table */
static double foreign(const Joint *j, double q, double v) {
    int row, column;
    double y = cell(q, j->foreign_q, j->foreign_dq, j->foreign_rows, &row);
    double x = cell(v, j->foreign_v, j->foreign_dv, j->foreign_columns, &column);
    const double *low = j->foreign + (long)row * j->foreign_columns + column,
                 *high = low + j->foreign_columns;
    return (1 - y) * ((1 - x) * low[0] + x * low[1]) + y * ((1 - x) * high[0] + x * high[1]);
}

/* torques of the load's position and velocity */
static double resist_load(const Joint *j, double q, double v) {
    double f = 0.0;
    if (j->gravity != 0.0) f += j->gravity * sin(q - j->gravity_angle);
    f += j->stiffness * (q - j->neutral);
    if (j->cubic != 0.0) f += j->cubic * pow(q - j->cubic_neutral, 3);
    if (j->foreign) f += foreign(j, q, v);
    return f;
}

/* torques on the motor's side of the transmission, the set-valued friction apart */
static double resist_motor(const Joint *j, const Hidden *h, double q, double v, double torque,
                           double t) {
    double f = j->torque_offset,
           friction = (v > 0 ? j->viscous_pos : j->viscous_neg) * v + j->drag * v * fabs(v);
    if (j->bristle_stiffness != 0.0) {
        double level = friction_level(j, q, v, torque, 0.0, (int)sign(v));
        double slip = level > 0 ? j->bristle_stiffness * fabs(v) / level * h->bristle : 0.0;
        friction += j->bristle_stiffness * h->bristle + j->bristle_damping * (v - slip);
    }
    f += friction * drift(j, t);
    for (int k = 0; k < 2; k++)
        if (j->ripple_amplitude[k] != 0.0)
            f += j->ripple_amplitude[k] * sin(j->ripple_order[k] * q + j->ripple_phase[k]);
    return f + j->bw_force * h->hysteresis;
}

static Hidden advance(const Joint *j, Hidden h, double q, double v, double torque, double dt) {
    if (j->bristle_stiffness != 0.0 && v != 0.0) {
        double level = friction_level(j, q, v, torque, 0.0, (int)sign(v));
        double rest = level / j->bristle_stiffness * sign(v);
        h.bristle = rest != 0.0 ? rest + (h.bristle - rest) * exp(-fabs(v / rest) * dt) : 0.0;
    }
    if (j->bw_force != 0.0) {
        double a = j->bw_stiffness / j->bw_force, z = h.hysteresis;
        for (int k = 0; k < 2; k++) { /* midpoint: k = 0 gives the slope at the middle */
            double loss = 0.5 * a * pow(fabs(z), j->bw_exponent) * (fabs(v) * sign(z) + v);
            double slope = a * v - loss;
            z = h.hysteresis + (k == 0 ? 0.5 : 1.0) * dt * slope;
        }
        h.hysteresis = fmax(-1.0, fmin(1.0, z));
    }
    return h;
}

/* steady torque of a command value: limits, dead zone, gain */
static double actuator(const Joint *j, double u) {
    if (j->limit > 0) u = fmax(-j->limit, fmin(j->limit, u));
    if (j->dead_zone > 0) u = fabs(u) <= j->dead_zone ? 0.0 : u - sign(u) * j->dead_zone;
    if (j->saturation > 0) u = fmax(-j->saturation, fmin(j->saturation, u));
    return j->gain * u;
}

/* transmitted torque from motor to load; the contact of a gap can only push */
static double transmission(const Joint *j, double twist, double rate) {
    double half = 0.5 * j->trans_gap, f;
    if (half == 0.0) return j->trans_stiffness * twist + j->trans_damping * rate;
    if (twist > half) {
        f = j->trans_stiffness * (twist - half) + j->trans_damping * rate;
        return f > 0 ? f : 0.0;
    }
    if (twist < -half) {
        f = j->trans_stiffness * (twist + half) + j->trans_damping * rate;
        return f < 0 ? f : 0.0;
    }
    return 0.0;
}
