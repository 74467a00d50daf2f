/* volts.c: a constant voltage on one motor, there and back; the others are held where they were,
 * and so is this one while `level` is 0.
 *
 * `level` is added to `weight`. It changes its sign where the joint passes `upper` or `lower`, and
 * every `flip` seconds. Beyond them by more than `aside` it is the largest there is, inwards.
 */
#include "isr.h"

enum { MOST = 8 };

static int32_t joint;
static double level, weight, largest, lower, upper, aside, flip;
static double stiff[MOST];
static double q[MOST], command;

static double start[MOST], sign, since;

void UserInit(void) {
    PARAMETER(joint, 1, "", 1, MOST, "joint whose motor is driven, from 1");
    PARAMETER(level, 0.0, "mV", 0.0, 10000.0, "size of the command");
    PARAMETER(weight, 0.0, "mV", -10000.0, 10000.0, "command that bears the joint's weight");
    PARAMETER(largest, 10000.0, "mV", 0.0, 10000.0, "of the command");
    PARAMETER(lower, -1e9, "{q}", NO_MIN, NO_MAX, "position at which it turns back upwards");
    PARAMETER(upper, 1e9, "{q}", NO_MIN, NO_MAX, "position at which it turns back downwards");
    PARAMETER(aside, 1e9, "{q}", 0.0, NO_MAX, "way beyond them that is left to it");
    PARAMETER(flip, 1000.0, "s", 0.01, 1000.0, "longest time in one direction");
    PARAMETER_FIRST(stiff, JOINTS, "mV/{q}", 0.0, NO_MAX, "command over displacement of the held");
    SIGNAL_FIRST(q, JOINTS, "{q}", "positions");
    SIGNAL(command, "mV", "to the motor");
    SIGNAL(sign, "", "direction of the voltage");
}

void UserISR_INT2(void) {
    const int32_t k = joint - 1;
    for (int32_t j = 0; j < JOINTS; j++) {
        q[j] = READ_POSITION(j);
        if (FIRST_SAMPLE || !DRIVE_ENABLED)
            start[j] = q[j];
        IOGP_FU1_WRITE_AOUT_ENGU(j) = fmax(-largest, fmin(largest, stiff[j] * (start[j] - q[j])));
    }
    if (FIRST_SAMPLE || !DRIVE_ENABLED) {
        sign = 1.0;
        since = SAMPLE_TIME;
    }
    const double turned = q[k] > upper ? -1.0 : q[k] < lower ? 1.0
        : SAMPLE_TIME - since >= flip ? -sign : sign;
    if (turned != sign) {
        sign = turned;
        since = SAMPLE_TIME;
    }
    const bool far = q[k] > upper + aside || q[k] < lower - aside;
    const double held = fmax(-largest, fmin(largest, stiff[k] * (start[k] - q[k])));
    command = level == 0.0 ? held : sign * (far ? largest : level) + weight;
    command = fmax(-largest, fmin(largest, command));
    IOGP_FU1_WRITE_AOUT_ENGU(k) = command;
}

void UserBackground(void) {}
