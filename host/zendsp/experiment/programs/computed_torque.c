/* computed_torque.c: computed torque by a model of the machine, model.c (zendsp model2c).
 *
 *     a   = rdd + Kp (r - q) + Kd (rd - qd)
 *     tau = M(q) a + C(q, qd) qd + g(q) + effects(r, rd, a)
 *
 * Effects are friction, where the model has any, and what else a torque can cancel. Their speed is
 * that of the reference: it does not chatter, and it knows the reversal.
 */
#include "isr.h"
#include "model.c"
#define N MODEL_JOINTS
#include "motion.h"

static double Kp = 1600.0, Kd = 80.0; /* 1/s^2, 1/s: all joints at 40 rad/s, critically damped */
static double tau[N], friction[N];

void UserInit(void) {
    ModelInit();
    MotionInit();
    MotionHolds();
    PARAMETER(Kp, 1600.0, "1/s^2", 0.0, 10000.0, "position gain");
    PARAMETER(Kd, 80.0, "1/s", 0.0, 400.0, "velocity gain");
    SIGNAL(tau, "{tau}", "commands");
    SIGNAL(friction, "{tau}", "friction and other effects that are compensated");
}

void UserISR_INT2(void) {
    double a[N];
    MotionStep();
    for (int32_t j = 0; j < N; j++)
        a[j] = rdd[j] + Kp * e[j] + Kd * (rd[j] - qd[j]);
    model_rigid(q, qd, a, tau);
    ModelEffects(r, rd, a, tau, friction);
    for (int32_t j = 0; j < N; j++) {
        tau[j] += friction[j];
        WRITE_TORQUE(j, tau[j]);
    }
}

void UserBackground(void) {}
