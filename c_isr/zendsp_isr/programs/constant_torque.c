/* constant_torque.c: viscous friction. One joint gets a constant torque, open loop, until its speed
 * is steady: the torque is then the friction at that speed. The other joints are held where they
 * stand.
 *
 * Set `joint`, then `level`; change `go` to begin. Outside lower … upper the torque is replaced by
 * braking. Compile with -DN=1 for the pendulum.
 */
#include "isr.h"
#ifndef N
#define N 2
#endif
#include "motion.h"

static int32_t joint, go;
static double level, lower, upper;
static double Kp[8] = {2000.0, 300.0}, Kd[8] = {120.0, 12.0}; /* of the joints that are held */
/* of the driven joint, outside of lower … upper; the pendulum has 0.8 N m */
static double brake[8] = {N == 1 ? 0.02 : 30.0, 5.0};

static double tau[N], torque, speed;
static bool running;
static int32_t gone;

void UserInit(void) {
    MotionInit();
    PARAMETER(joint, 1, "", 1, N, "joint that is driven, from 1");
    PARAMETER(level, 0.0, "N m", -250.0, 250.0, "its torque");
    PARAMETER(lower, -2.0, "rad", -1000.0, 1000.0, "below this the joint is braked");
    PARAMETER(upper, 2.0, "rad", -1000.0, 1000.0, "above this the joint is braked");
    PARAMETER_ARRAY(brake, "N m s/rad", 0.0, 1000.0,
                    "damping of each joint outside of lower … upper");
    PARAMETER(go, 0, "", 0, 2147483647, "any change begins; the run ends at lower or upper");
    PARAMETER_ARRAY(Kp, "N m/rad", 0.0, 20000.0, "gain of a joint that is held");
    PARAMETER_ARRAY(Kd, "N m s/rad", 0.0, 1000.0, "damping of a joint that is held");
    SIGNAL(tau, "N m", "commands");
    SIGNAL(torque, "N m", "torque of the driven joint");
    SIGNAL(speed, "rad/s", "its speed, filtered");
    SIGNAL(running, "", "the torque is on");
}

void UserISR_INT2(void) {
    MotionStep();
    const int32_t k = joint - 1;
    if (!DRIVE_ENABLED) {
        running = false; /* a run that was cut short does not go on by itself */
    } else if (gone != go) {
        gone = go;
        running = true;
    }
    if ((q[k] > upper && level > 0.0) || (q[k] < lower && level < 0.0))
        running = false;
    speed = qd[k];
    torque = running ? level : -brake[k] * qd[k];
    for (int32_t j = 0; j < N; j++) {
        tau[j] = j == k ? torque : Kp[j] * e[j] - Kd[j] * qd[j];
        WRITE_TORQUE(j, tau[j]);
    }
}

void UserBackground(void) {}
