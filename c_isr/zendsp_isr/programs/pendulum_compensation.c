/* pendulum_compensation.c: friction compensated at the feedback level, around a trajectory that was
 * planned without friction.
 *
 *     tau = ref_tau + kp (r - q) + kv (rd - qd) + fc tanh(beta qd)
 *
 * The rival of pendulum_track.c in the pendulum paper: the friction term sees only the measured,
 * filtered, late speed; the goal is reached, by another path, with oscillations.
 */
#include "isr.h"
#define N 1
#define MOTION_CUTOFF 30.0
#include "motion.h"

static double kp, kv, fc, beta, limit;
static double tau[N], friction;

void UserInit(void) {
    MotionInit();
    PARAMETER(kp, 1.2, "N m/rad", 0.0, 20.0, "position gain");
    PARAMETER(kv, 0.005, "N m s/rad", 0.0, 1.0, "velocity gain");
    PARAMETER(fc, 0.1, "N m", 0.0, 0.8, "friction level of the model");
    PARAMETER(beta, 100.0, "s/rad", 0.1, 1000.0, "steepness of the model at standstill");
    PARAMETER(limit, 0.8, "N m", 0.0, 0.8, "largest torque");
    SIGNAL(tau, "N m", "command");
    SIGNAL(friction, "N m", "friction torque that is added");
}

void UserISR_INT2(void) {
    MotionStep();
    friction = fc * tanh(beta * qd[0]);
    const double wanted = tau_ff[0] + kp * e[0] + kv * (rd[0] - qd[0]) + friction;
    tau[0] = wanted > limit ? limit : wanted < -limit ? -limit : wanted;
    WRITE_TORQUE(0, tau[0]);
}

void UserBackground(void) {}
