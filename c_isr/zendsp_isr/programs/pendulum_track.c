/* pendulum_track.c: PD around an optimal trajectory: its torque fed forward, its motion followed
 * (tables ref and ref_tau).
 *
 *     tau = ref_tau + kp (r - q) + kv (rd - qd)
 *
 * With kp = kv = 0 it is the same swing played open loop. Gains of the pendulum paper (Hardware
 * 2025, 3(3), 11).
 */
#include "isr.h"
#define N 1
#define MOTION_CUTOFF 30.0 /* a count of the 12-bit encoder in one sample is 1.5 rad/s */
#include "motion.h"

static double kp, kv, limit;
static double tau[N];

void UserInit(void) {
    MotionInit();
    PARAMETER(kp, 1.2, "N m/rad", 0.0, 20.0, "position gain");
    PARAMETER(kv, 0.005, "N m s/rad", 0.0, 1.0, "velocity gain");
    PARAMETER(limit, 0.8, "N m", 0.0, 0.8, "largest torque");
    SIGNAL(tau, "N m", "command");
}

void UserISR_INT2(void) {
    MotionStep();
    const double wanted = tau_ff[0] + kp * e[0] + kv * (rd[0] - qd[0]);
    tau[0] = wanted > limit ? limit : wanted < -limit ? -limit : wanted;
    WRITE_TORQUE(0, tau[0]);
}

void UserBackground(void) {}
