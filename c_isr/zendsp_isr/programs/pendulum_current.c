/* pendulum_current.c: the inner PI current loop of the pendulum, in user code. Open the machine
 * with drive = voltage.
 *
 *     i_ref = tau_ref / k_a,   v = kp (i_ref - i) + ki ∫ (i_ref - i) dt,   |v| <= supply
 *
 * tau_ref is the paper's open-loop law, or a constant. With voltage_mode on, `volts` goes straight
 * to the motor: then v/i against qd/i is a straight line of slope k_a and intercept R_a.
 */
#include "isr.h"
#define N 1
#define MOTION_CUTOFF 30.0
#include "motion.h"

static double kp, ki, k_a, supply, torque, volts;
static bool voltage_mode;
static double i, i_ref, v, tau[N];
static double integral; /* V */

void UserInit(void) {
    MotionInit();
    PARAMETER(kp, 5.0, "V/A", 0.0, 1000.0, "proportional gain");
    PARAMETER(ki, 5000.0, "V/(A s)", 0.0, 1e6, "integral gain");
    PARAMETER(k_a, 0.1762, "N m/A", 1e-3, 10.0, "torque constant");
    PARAMETER(supply, 24.0, "V", 0.0, 24.0, "largest voltage");
    PARAMETER(torque, 0.0, "N m", -0.8, 0.8, "torque reference, added to that of ref_tau");
    PARAMETER(voltage_mode, 0, "", 0, 1, "leave the loop out and apply volts");
    PARAMETER(volts, 0.0, "V", -24.0, 24.0, "voltage in voltage_mode");
    SIGNAL(i, "A", "current, measured");
    SIGNAL(i_ref, "A", "its reference");
    SIGNAL(v, "V", "motor voltage");
    SIGNAL(tau, "N m", "torque reference");
}

void UserISR_INT2(void) {
    MotionStep();
    i = IOGP_FU1_READ_ADC(0);
    tau[0] = torque + tau_ff[0];
    i_ref = tau[0] / k_a;
    const double wanted = voltage_mode ? volts : kp * (i_ref - i) + integral;
    v = wanted > supply ? supply : wanted < -supply ? -supply : wanted;
    if (!DRIVE_ENABLED || voltage_mode)
        integral = 0.0;
    else if (v == wanted) /* the integrator rests while the voltage is at its limit */
        integral += ki * SAMPLE_PERIOD * (i_ref - i);
    IOGP_FU1_WRITE_AOUT_ENGU(0) = v * 10000.0 / 24.0; /* 10 V for the supply voltage */
}

void UserBackground(void) {}
