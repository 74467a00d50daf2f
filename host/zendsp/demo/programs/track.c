/* track.c: follow a reference by feedback, with the model's torque fed forward, and room for
 * physics that the model lacks.
 *
 *     tau = model(r, rd, rdd) + Kp (r - q) + Kd (rd - qd) + compensation(r, rd, rdd),
 *
 * and no more than the drives give: a machine stops itself where a command is larger.
 *
 * model.h and compensation.h are made from the host's model and its library of effects; every level
 * of the compensation is a parameter and begins at zero, so that what a diagnosis finds is switched
 * on by one synchronous update, without a new download.
 */
#include "isr.h"
#include "motion.h"
#include "model.h"
#include "compensation.h"

static double Kp[N], Kd[N], limit[N], tau[N], tau_comp[N];
/* speed of the reference, as late as the measured speed: both go through the same filter */
static double rd_late[N];

void UserInit(void) {
    MotionInit();
    ModelInit();
    CompensationInit();
    PARAMETER(Kp, 0.0, "N m/rad", 0.0, 20000.0, "position gains");
    PARAMETER(Kd, 0.0, "N m s/rad", 0.0, 2000.0, "velocity gains");
    PARAMETER(limit, 0.0, "N m", 0.0, 10000.0, "largest torques");
    SIGNAL(tau, "N m", "commands");
    SIGNAL(tau_comp, "N m", "part of the command that compensates");
}

void UserISR_INT2(void) {
    MotionStep();
    const double a = 1.0 - exp(-6.283185307179586 * cutoff * SAMPLE_PERIOD);
    ModelTorque(r, rd, rdd, tau);
    for (int32_t j = 0; j < N; j++) {
        rd_late[j] = FIRST_SAMPLE || !DRIVE_ENABLED ? rd[j] : rd_late[j] + a * (rd[j] - rd_late[j]);
        tau_comp[j] = Compensation(j, r, rd, rdd, tau[j]);
        const double wanted =
            tau[j] + tau_comp[j] + Kp[j] * e[j] + Kd[j] * (rd_late[j] - qd[j]);
        tau[j] = wanted > limit[j] ? limit[j] : wanted < -limit[j] ? -limit[j] : wanted;
        WRITE_TORQUE(j, tau[j]);
    }
}

void UserBackground(void) {}
