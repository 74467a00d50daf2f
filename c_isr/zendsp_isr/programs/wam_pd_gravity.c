/* wam_pd_gravity.c: joint PD with gravity compensation on the WAM, as in the 7-DOF whole-arm paper;
 * follows the table ref.
 *
 *     tau = Kp (r - q) + Kd (rd - qd) + g(q)
 *
 * A compensation.c beside this file, as `zendsp diagnose --out` writes it, is added to the command,
 * along the reference, as in pd.c.
 */
#include "isr.h"
#if __has_include("compensation.c")
#include "compensation.c"
#else
#define CompensationInit() ((void)0)
#define Compensation(joint, pos, vel, acc, torque) 0.0
#endif
#define N 7
#define MOTION_APPROACH 4.0 /* s: a joint may have 3 rad to go, and the drives allow 3 rad/s */
#define MOTION_SPEED 2.0
#include "motion.h"
#include "wam_gravity.h"

static double Kp[N] = {900.0, 1200.0, 300.0, 200.0, 25.0, 25.0, 6.0};  /* N m/rad */
static double Kd[N] = {40.0, 50.0, 8.0, 6.0, 0.3, 0.3, 0.02};          /* N m s/rad */
static double limit[N] = {77.3, 160.6, 95.6, 29.4, 11.6, 11.6, 2.7};   /* N m, of the drives */
static bool compensate;
static double share; /* of the gravity torque that acts */
static double g[N], tau[N];

void UserInit(void) {
    CompensationInit();
    MotionInit();
    MotionHolds();
    PARAMETER_ARRAY(Kp, "N m/rad", 0.0, 10000.0, "position gain");
    PARAMETER_ARRAY(Kd, "N m s/rad", 0.0, 1000.0, "velocity gain");
    PARAMETER_ARRAY(limit, "N m", 0.0, 200.0, "largest torque");
    PARAMETER(compensate, 1, "", 0, 1, "add the gravity torque");
    SIGNAL(g, "N m", "gravity torque of the model");
    SIGNAL(tau, "N m", "commands");
}

void UserISR_INT2(void) {
    MotionStep();
    WamGravity(q, g);
    share = MotionShare(share, compensate);
    for (int32_t j = 0; j < N; j++) {
        double wanted = Kp[j] * e[j] + Kd[j] * (rd[j] - qd[j]) + share * g[j];
        wanted += Compensation(j, r, rd, rdd, wanted);
        tau[j] = wanted > limit[j] ? limit[j] : wanted < -limit[j] ? -limit[j] : wanted;
        WRITE_TORQUE(j, tau[j]);
    }
}

void UserBackground(void) {}
