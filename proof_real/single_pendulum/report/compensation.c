/* compensation.c: physics found in single_pendulum, as torque to add to a command.
 *    Joint 1 lacks Coulomb friction of 0.00056 ± 0.00022 N m: the torque opposes the motion whatever the speed.
 *    Joint 1 lacks quadratic drag of 1.29e-05 ± 1.3e-05 N m s²/rad². It makes viscous unnecessary.
 *
 *     #include "isr.h"
 *     #include "compensation.c"
 *     … UserInit:      CompensationInit();
 *     … UserISR_INT2:  tau[j] += Compensation(j, q, qd, qdd, tau[j]);
 */
#include "isr.h"

static double comp_share;
static double comp_fade;
static double comp_limit;
static double comp_sign_speed;
static double comp_coulomb1_level;
static double comp_quadratic_drag1_coefficient;

static double comp_now;    /* share that acts: follows comp_share within comp_fade seconds */
static uint64_t comp_tick; /* sample in which it was last moved */

static inline double comp_sign(double x) {
    return comp_sign_speed > 0.0 ? tanh(x / comp_sign_speed) : (double)((x > 0.0) - (x < 0.0));
}

static inline void CompensationInit(void) {
    PARAMETER(comp_share, 1.0, "", 0.0, 1.0, "part of the compensation that is added");
    PARAMETER(comp_fade, 0.5, "s", 0.0, 60.0, "time in which it fades in or out");
    PARAMETER(comp_limit, 0.5, "", 0.0, 1.0, "most that is added, part of the torque limit");
    PARAMETER(comp_sign_speed, 0.02, "rad/s", NO_MIN, NO_MAX, "speed over which dry friction changes its sign; 0: at once");
    PARAMETER(comp_coulomb1_level, 0.0005550646788183172, "N m", NO_MIN, NO_MAX, "coulomb of joint 1: level");
    PARAMETER(comp_quadratic_drag1_coefficient, 1.2934989385592427e-05, "N m s^2/rad^2", NO_MIN, NO_MAX, "quadratic drag of joint 1: coefficient");
}

/* Once a sample: the share moves towards comp_share. In a program's first sample it is there. */
static inline void comp_step(void) {
    if (FIRST_SAMPLE)
        comp_now = comp_share;
    if (comp_tick != SAMPLE_TICK) {
        const double most = comp_fade > 0.0 ? SAMPLE_PERIOD / comp_fade : 1.0;
        comp_now += fmax(-most, fmin(most, comp_share - comp_now));
        comp_tick = SAMPLE_TICK;
    }
}

/* Torque to add to the command `torque` of a joint (from 0); position, speed and acceleration of all joints, SI units. */
static inline double Compensation(int32_t joint, const double *pos, const double *vel, const double *acc, double torque) {
    double wanted = torque;
    (void)pos, (void)vel, (void)acc;
    comp_step();
    switch (joint) {
    case 0:
        wanted += comp_now * (comp_coulomb1_level * comp_sign(vel[0])); /* coulomb: Fc sign(q̇) */
        wanted += comp_now * (comp_quadratic_drag1_coefficient * vel[0] * fabs(vel[0])); /* quadratic drag: c q̇ |q̇| */
        break;
    default:
        break;
    }
    const double most = TORQUE_MAX(joint) > 0.0 ? comp_limit * TORQUE_MAX(joint) : INFINITY;
    return fmax(-most, fmin(most, wanted - torque));
}
