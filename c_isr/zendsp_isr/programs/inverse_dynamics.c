/* inverse_dynamics.c: computed torque on the planar arm, with or without friction compensation.
 *
 *     a   = rdd + Kp (r - q) + Kd (rd - qd)
 *     tau = M(q) a + C(q, qd) qd + friction(v)
 *
 * Friction, where `compensate` is on, is the two sliding regions of the fast-prototyping paper: a
 * cubic below the speed `split`, a parabola above, the same for both directions. Its speed is that
 * of the reference: it does not chatter, and it knows the reversal.
 *
 * A compensation.c beside this file, as `zendsp diagnose --out` writes it, is added to the command,
 * along the reference, as in pd.c; leave `compensate` off where it has friction.
 */
#include "isr.h"
#if __has_include("compensation.c")
#include "compensation.c"
#else
#define CompensationInit() ((void)0)
#define Compensation(joint, pos, vel, acc, torque) 0.0
#endif
#define N 2
#include "motion.h"

/* 1/s^2, 1/s: both joints at 40 rad/s, critically damped */
static double Kp[N] = {1600.0, 1600.0}, Kd[N] = {80.0, 80.0};
static double p1, p2, p3;
static bool compensate;
static double share; /* of the friction torque that acts */
static double low1[4] = {8.45, 5.3, 0.0, 0.0}, high1[3] = {8.45, 5.3, 0.0};
static double low2[4] = {2.35, 1.1, 0.0, 0.0}, high2[3] = {2.35, 1.1, 0.0};
static double split[N] = {0.5, 0.5};
static double still;
static double tau[N], friction[N];

void UserInit(void) {
    CompensationInit();
    MotionInit();
    MotionHolds();
    PARAMETER_ARRAY(Kp, "1/s^2", 0.0, 10000.0, "position gain");
    PARAMETER_ARRAY(Kd, "1/s", 0.0, 400.0, "velocity gain");
    PARAMETER(p1, 3.473, "kg m^2", 0.0, 20.0, "inertia of both links about axis 1");
    PARAMETER(p2, 0.196, "kg m^2", 0.0, 5.0, "inertia of link 2 about axis 2");
    PARAMETER(p3, 0.242, "kg m^2", 0.0, 5.0, "coupling of the links");
    PARAMETER(compensate, 0, "", 0, 1, "add the friction torque");
    PARAMETER_ARRAY(low1, "N m (s/rad)^k", NO_MIN, NO_MAX,
                    "friction of joint 1 below split: c0 + c1 v + c2 v^2 + c3 v^3");
    PARAMETER_ARRAY(high1, "N m (s/rad)^k", NO_MIN, NO_MAX,
                    "friction of joint 1 above split: c0 + c1 v + c2 v^2");
    PARAMETER_ARRAY(low2, "N m (s/rad)^k", NO_MIN, NO_MAX, "friction of joint 2 below split");
    PARAMETER_ARRAY(high2, "N m (s/rad)^k", NO_MIN, NO_MAX, "friction of joint 2 above split");
    PARAMETER_ARRAY(split, "rad/s", 0.0, 100.0, "speed where the two polynomials meet");
    PARAMETER(still, 0.005, "rad/s", 1e-6, 1.0,
              "below about this speed the joint counts as standing: no compensation");
    SIGNAL(tau, "N m", "commands");
    SIGNAL(friction, "N m", "friction torque that is compensated");
}

static double sliding(double v, const double *low, const double *high, double where) {
    const double s = fabs(v);
    const double size = s < where ? low[0] + s * (low[1] + s * (low[2] + s * low[3]))
                                  : high[0] + s * (high[1] + s * high[2]);
    return size * tanh(v / still); /* no torque at a standstill, all of it a little above */
}

void UserISR_INT2(void) {
    MotionStep();
    share = MotionShare(share, compensate);
    friction[0] = share * sliding(rd[0], low1, high1, split[0]);
    friction[1] = share * sliding(rd[1], low2, high2, split[1]);
    const double a1 = rdd[0] + Kp[0] * e[0] + Kd[0] * (rd[0] - qd[0]);
    const double a2 = rdd[1] + Kp[1] * e[1] + Kd[1] * (rd[1] - qd[1]);
    const double c = p3 * cos(q[1]), s = p3 * sin(q[1]);
    tau[0] = (p1 + 2.0 * c) * a1 + (p2 + c) * a2 - s * qd[1] * (2.0 * qd[0] + qd[1]) + friction[0];
    tau[1] = (p2 + c) * a1 + p2 * a2 + s * qd[0] * qd[0] + friction[1];
    for (int32_t j = 0; j < N; j++) {
        tau[j] += Compensation(j, r, rd, rdd, tau[j]);
        WRITE_TORQUE(j, tau[j]);
    }
}

void UserBackground(void) {}
