/* push.c: friction by torque. Goes to a start position, rests there, then pushes one joint and lets
 * the others be held.
 *
 * The torque begins at `first` and grows by `increment` every `hold` seconds (0: constant torque).
 * The push ends when the joint has left its start by `threshold`, or has passed `upper`
 * (counterclockwise) or `lower` (clockwise); the joint is then braked.
 */
#include "isr.h"

enum { MOST = 8 };

static int32_t joint, direction;
static double place[MOST], Kp[MOST], Kd[MOST], brake[MOST];
static double first, increment, hold, threshold, lower, upper, travel_time, rest_time, cutoff;

static double q[MOST], qd[MOST], tau[MOST], torque;
static int32_t phase; /* 0 on the way to the start, 1 resting, 2 pushing, 3 ended */

static double last[MOST], start[MOST], begun, origin;
static bool known;

void UserInit(void) {
    PARAMETER(joint, 1, "", 1, MOST, "joint that is pushed, from 1");
    PARAMETER(direction, 1, "", -1, 1, "1 counterclockwise, -1 clockwise");
    PARAMETER_ARRAY(place, "rad", NO_MIN, NO_MAX, "where the joints start");
    PARAMETER_ARRAY(Kp, "N m/rad", 0.0, 20000.0, "gain on the way, and of joints that are held");
    PARAMETER_ARRAY(Kd, "N m s/rad", 0.0, 1000.0, "damping of the same");
    PARAMETER_ARRAY(brake, "N m s/rad", 0.0, 1000.0, "damping when the push has ended");
    PARAMETER(first, 0.0, "N m", 0.0, 1000.0, "torque at the beginning of the push");
    PARAMETER(increment, 0.0, "N m", 0.0, 100.0, "height of a step");
    PARAMETER(hold, 0.1, "s", 0.001, 10.0, "length of a step");
    PARAMETER(threshold, 1000.0, "rad", 0.0, 1000.0, "way after which the push ends");
    PARAMETER(lower, -2.0, "rad", -1000.0, 1000.0, "position at which a push clockwise ends");
    PARAMETER(upper, 2.0, "rad", -1000.0, 1000.0, "position at which a push counterclockwise ends");
    PARAMETER(travel_time, 2.0, "s", 0.1, 60.0, "time to the start position");
    PARAMETER(rest_time, 0.5, "s", 0.0, 60.0, "time at rest without torque");
    PARAMETER(cutoff, 80.0, "Hz", 1.0, 1000.0, "velocity filter");
    SIGNAL(q, "rad", "positions");
    SIGNAL(qd, "rad/s", "velocities, filtered");
    SIGNAL(tau, "N m", "commands");
    SIGNAL(torque, "N m", "command of the pushed joint");
    SIGNAL(phase, "", "0 going to the start, 1 resting, 2 pushing, 3 ended");
}

static void measure(void) {
    const double a = 1.0 - exp(-6.283185307179586 * cutoff * SAMPLE_PERIOD);
    for (int32_t j = 0; j < JOINTS; j++) {
        q[j] = READ_POSITION(j);
        qd[j] = FIRST_SAMPLE ? 0.0 : qd[j] + a * ((q[j] - last[j]) / SAMPLE_PERIOD - qd[j]);
        last[j] = q[j];
        if (FIRST_SAMPLE || !DRIVE_ENABLED)
            start[j] = q[j];
    }
    if (FIRST_SAMPLE || !DRIVE_ENABLED) {
        begun = SAMPLE_TIME;
        phase = 0;
    }
}

/* Fifth-order way from where the joint stood to its start position. */
static double wanted(int32_t j, double t) {
    const double s = t < travel_time ? t / travel_time : 1.0;
    return start[j] + s * s * s * (10.0 + s * (6.0 * s - 15.0)) * (place[j] - start[j]);
}

static double push(int32_t k, double t) {
    const bool beyond = direction < 0 ? q[k] < lower : q[k] > upper;
    if (phase == 2 && (fabs(q[k] - origin) > threshold || beyond))
        phase = 3;
    if (phase == 3)
        return -brake[k] * qd[k];
    const double size = first + increment * floor(t / hold + 1e-9);
    return direction < 0 ? -size : size;
}

void UserISR_INT2(void) {
    measure();
    const double t = SAMPLE_TIME - begun, rested = t - 1.5 * travel_time;
    const int32_t k = joint - 1;
    if (phase == 0 && rested >= 0.0)
        phase = 1;
    if (phase == 1 && rested >= rest_time) {
        phase = 2;
        origin = q[k];
    }
    for (int32_t j = 0; j < JOINTS; j++) {
        tau[j] = Kp[j] * (wanted(j, t) - q[j]) - Kd[j] * qd[j];
        if (j == k && phase > 0)
            tau[j] = phase == 1 ? 0.0 : push(j, rested - rest_time);
        WRITE_TORQUE(j, tau[j]);
    }
    torque = tau[k];
}

void UserBackground(void) {}
