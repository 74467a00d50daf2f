/* pendulum_torque.c: a torque played open loop: the table ref_tau (an optimal swing, a PRBS, a
 * chirp …), or without a table the law
 *
 *     tau(t) = level (1 - exp(-rate t)) + a1 sin(w1 t + phi1) + a2 sin(w2 t + phi2)
 *
 * from which the pendulum paper estimates its mechanical parameters (Hardware 2025, 3(3), 11).
 * Change `go` to begin the law.
 */
#include "isr.h"
#define N 1
#define MOTION_CUTOFF 30.0
#include "motion.h"

static double level, rate, a1, w1, phi1, a2, w2, phi2, duration;
static int32_t go;
static double tau[N];
static double begin; /* s */
static int32_t gone;
static bool running;

void UserInit(void) {
    MotionInit();
    PARAMETER(level, 0.3, "N m", -0.8, 0.8, "torque that the exponential rises to");
    PARAMETER(rate, 1.8, "1/s", 0.0, 1000.0, "rate of the exponential");
    PARAMETER(a1, 0.1, "N m", -0.8, 0.8, "amplitude of the first sine");
    PARAMETER(w1, 26.0, "rad/s", 0.0, 3000.0, "its frequency");
    PARAMETER(phi1, 0.08, "rad", -7.0, 7.0, "its phase");
    PARAMETER(a2, 0.1, "N m", -0.8, 0.8, "amplitude of the second sine");
    PARAMETER(w2, 12.0, "rad/s", 0.0, 3000.0, "its frequency");
    PARAMETER(phi2, 0.34, "rad", -7.0, 7.0, "its phase");
    PARAMETER(duration, 5.0, "s", 0.0, 3600.0, "of the law; no torque afterwards");
    PARAMETER(go, 0, "", 0, 2147483647, "any change begins the law");
    SIGNAL(tau, "N m", "command");
}

static double law(double t) {
    if (!running || t < 0.0 || t > duration)
        return 0.0;
    return level * (1.0 - exp(-rate * t)) + a1 * sin(w1 * t + phi1) + a2 * sin(w2 * t + phi2);
}

void UserISR_INT2(void) {
    MotionStep();
    if (!DRIVE_ENABLED) {
        running = false; /* a law that was cut short does not go on by itself */
    } else if (gone != go) {
        gone = go;
        running = true;
        begin = SAMPLE_TIME;
    }
    tau[0] = ref_tau.rows > 0 ? tau_ff[0] : law(SAMPLE_TIME - begin);
    WRITE_TORQUE(0, tau[0]);
}

void UserBackground(void) {}
