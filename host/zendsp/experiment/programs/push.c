/* push.c: friction by torque. Goes to a start position, rests there, then pushes one joint and lets
 * the others be held.
 *
 * The torque begins at `first` and grows by `increment` every `hold` seconds (0: constant torque).
 * It comes on top of what carries the joint's weight, which is what the host knows of it, and up to
 * `band` of what else held the joint at rest, less `eased`. The push ends when the joint has left
 * its start by `threshold`, or by `back` the other way, or has passed `upper` (counterclockwise) or
 * `lower` (clockwise), or is faster than `fastest`. The joint is then braked, and held where it
 * stops.
 *
 * No weight sinks before: with `taken` the loops begin with what held the joints (`carried`), and
 * up to `resting` of what held the joint stays until the push begins.
 *
 * What holds a joint up on the way to its start (blocked.h), or a pushed one that had half of
 * `pace` and stands, ends everything: the machine is held where it is; `blocked` says which joint.
 */
#include "isr.h"

enum { MOST = 8 };
#define N JOINTS
#define BRAKE_TIME 0.2 /* s, at most, before the joint is held: a brake alone lets a weight sink */
enum { GOING, RESTING, PUSHING, BRAKING, HELD };

static int32_t joint, direction;
static double place[MOST], Kp[MOST], Kd[MOST], brake[MOST];
static double flat[MOST], cosine[MOST], sine[MOST], carried[MOST], resting, band;
static double eased;
static bool taken;
static double first, increment, hold, threshold, back, lower, upper, fastest;
static double travel_time, rest_time, cutoff, reset, pace;

static double q[MOST], qd[MOST], tau[MOST], torque;
static int32_t phase, blocked;
static double r[MOST]; /* where the joints are to be on the way to the start */

static double last[MOST], start[MOST], begun, origin;
static double sum[MOST]; /* N m, of the integrals */
static double kept; /* N m, what held the joint beside its weight, and what of it stays */
static double ended, speed; /* s and rad/s, when the push ended */
static double looked, from; /* s and place of the latest look at a joint that is pushed */
static bool moved;          /* it had half of `pace` */
static int32_t stood;       /* looks since */
#include "blocked.h"

void UserInit(void) {
    PARAMETER(joint, 1, "", 1, MOST, "joint that is pushed, from 1");
    PARAMETER(direction, 1, "", -1, 1, "1 counterclockwise, -1 clockwise");
    PARAMETER_FIRST(place, JOINTS, "{q}", NO_MIN, NO_MAX, "where the joints start");
    PARAMETER_FIRST(Kp, JOINTS, "{tau}/{q}", 0.0, 1e6, "gain on the way, and of joints held");
    PARAMETER_FIRST(Kd, JOINTS, "{tau} s/{q}", 0.0, 1e5, "damping of the same");
    PARAMETER_FIRST(brake, JOINTS, "{tau} s/{q}", 0.0, 1e5, "damping when the push has ended");
    PARAMETER_FIRST(flat, JOINTS, "{tau}", NO_MIN, NO_MAX, "weight, the same everywhere");
    PARAMETER_FIRST(cosine, JOINTS, "{tau}", NO_MIN, NO_MAX, "weight, by the cosine of q");
    PARAMETER_FIRST(sine, JOINTS, "{tau}", NO_MIN, NO_MAX, "weight, by the sine of q");
    PARAMETER_FIRST(carried, JOINTS, "{tau}", -1e6, 1e6, "that holds the joints as it begins");
    PARAMETER(taken, 0, "", 0, 1, "whether that is known; else they begin with the weight");
    PARAMETER(resting, 0.0, "{tau}", 0.0, 1e6, "beside the weight, what may hold it at rest");
    PARAMETER(band, 0.0, "{tau}", 0.0, 1e6, "of that, the most that stays during the push");
    PARAMETER(eased, 0.0, "{tau}", 0.0, 1e6, "taken off that, along the push, while it rests");
    PARAMETER(first, 0.0, "{tau}", -1e6, 1e6, "torque at the beginning of the push");
    PARAMETER(increment, 0.0, "{tau}", 0.0, 1e5, "height of a step");
    PARAMETER(hold, 0.1, "s", 0.0001, 10.0, "length of a step");
    PARAMETER(threshold, 1000.0, "{q}", 0.0, 1e6, "way after which the push ends");
    PARAMETER(back, 1000.0, "{q}", 0.0, 1e6, "way against the push, or at rest, that ends it");
    PARAMETER(lower, -2.0, "{q}", -1e6, 1e6, "position at which a push clockwise ends");
    PARAMETER(upper, 2.0, "{q}", -1e6, 1e6, "position at which a push counterclockwise ends");
    PARAMETER(fastest, 1e6, "{q}/s", 0.0, 1e6, "speed at which a push ends");
    PARAMETER(travel_time, 2.0, "s", 0.1, 600.0, "time to the start position");
    PARAMETER(rest_time, 0.5, "s", 0.0, 60.0, "time at rest before the push");
    PARAMETER(reset, 0.0, "s", 0.0, 1000.0, "time constant of what holds the others; 0: none");
    PARAMETER(pace, 0.0, "{q}/s", 0.0, 1e6, "that a constant torque is to give; 0: not looked at");
    PARAMETER(cutoff, 80.0, "Hz", 1.0, 1000.0, "velocity filter");
    SIGNAL_FIRST(q, JOINTS, "{q}", "positions");
    SIGNAL_FIRST(qd, JOINTS, "{q}/s", "velocities, filtered");
    SIGNAL_FIRST(tau, JOINTS, "{tau}", "commands");
    SIGNAL(torque, "{tau}", "command of the pushed joint");
    SIGNAL(phase, "", "0 going to the start, 1 resting, 2 pushing, 3 braking, 4 held");
    SIGNAL(blocked, "", "joint that something holds up, from 1; 0: none");
}

static double weight(int32_t j) { return flat[j] + cosine[j] * cos(q[j]) + sine[j] * sin(q[j]); }

static void measure(void) {
    const double a = 1.0 - exp(-6.283185307179586 * cutoff * SAMPLE_PERIOD);
    for (int32_t j = 0; j < JOINTS; j++) {
        q[j] = READ_POSITION(j);
        qd[j] = FIRST_SAMPLE ? 0.0 : qd[j] + a * ((q[j] - last[j]) / SAMPLE_PERIOD - qd[j]);
        last[j] = q[j];
        if (FIRST_SAMPLE || !DRIVE_ENABLED) {
            start[j] = q[j];
            sum[j] = taken && reset > 0.0 ? carried[j] - weight(j) : 0.0;
        }
    }
    if (FIRST_SAMPLE || !DRIVE_ENABLED) {
        begun = SAMPLE_TIME;
        phase = GOING;
        blocked = 0;
        kept = 0.0;
    }
}

/* Fifth-order way from where the joint stood to its start position. */
static double wanted(int32_t j, double t) {
    const double s = t < travel_time ? t / travel_time : 1.0;
    return start[j] + s * s * s * (10.0 + s * (6.0 * s - 15.0)) * (place[j] - start[j]);
}

/* Whether the pushed joint has done what it may. */
static bool over(int32_t k) {
    const double gone = q[k] - origin, along = direction < 0 ? -gone : gone;
    const bool beyond = direction < 0 ? q[k] < lower : q[k] > upper;
    if (phase == RESTING)
        return fabs(gone) > back;
    return phase == PUSHING &&
           (fabs(gone) > threshold || -along > back || beyond || fabs(qd[k]) > fastest);
}

/* Whether a joint that was moving under a constant torque stands. */
static bool stands(int32_t k) {
    const double since = SAMPLE_TIME - looked;
    const bool pushed = phase == PUSHING && pace > 0.0;
    if (pushed && since < BLOCKED_TIME)
        return false;
    const double share = (direction < 0 ? from - q[k] : q[k] - from) / fmax(since * pace, 1e-12);
    moved = pushed && (moved || share > BLOCKED_FOLLOWS);
    stood = moved && share < BLOCKED_STANDS ? stood + 1 : 0;
    looked = SAMPLE_TIME;
    from = q[k];
    return stood >= BLOCKED_LOOKS;
}

/* Hold the machine where it is, the blocked joint by its weight and a spring that is not bent. */
static void stay(int32_t k, int32_t found) {
    blocked = found;
    phase = HELD;
    origin = q[k];
    sum[found - 1] = 0.0;
    for (int32_t j = 0; j < JOINTS; j++)
        r[j] = q[j];
}

static void advance(int32_t k, double rested, double t) {
    if (phase == GOING && rested >= 0.0) {
        phase = RESTING;
        origin = q[k];
        kept = fmax(-resting, fmin(resting, kept));
    }
    if (phase == RESTING && rested >= rest_time) {
        phase = PUSHING;
        origin = q[k];
        kept = fmax(-band, fmin(band, kept)) - (direction < 0 ? -eased : eased);
    }
    if (over(k)) {
        phase = BRAKING;
        ended = t;
        speed = fabs(qd[k]);
    }
    if (phase == BRAKING && t > ended && (fabs(qd[k]) <= 0.05 * speed || t - ended > BRAKE_TIME)) {
        phase = HELD;
        origin = q[k];
    }
}

/* Torque of the pushed joint beside its weight, from rest on. */
static double push(int32_t k, double t) {
    if (phase == RESTING) /* t runs up to 0 */
        return kept - (direction < 0 ? -eased : eased) * (1.0 + t / fmax(rest_time, 1e-9));
    if (phase == BRAKING)
        return kept - brake[k] * qd[k];
    if (phase == HELD)
        return Kp[k] * (origin - q[k]) - Kd[k] * qd[k] + sum[k];
    const double size = first + increment * floor(t / hold + 1e-9);
    return kept + (direction < 0 ? -size : size);
}

void UserISR_INT2(void) {
    measure();
    const double t = SAMPLE_TIME - begun, rested = t - 1.5 * travel_time;
    const int32_t k = joint - 1;
    for (int32_t j = 0; j < JOINTS && blocked == 0; j++)
        r[j] = wanted(j, t);
    if (blocked == 0)
        advance(k, rested, t);
    for (int32_t j = 0; j < JOINTS; j++) {
        double beside = Kp[j] * (r[j] - q[j]) - Kd[j] * qd[j] + sum[j];
        if (j == k && phase == GOING) /* the mean of what holds it, over 0.1 s */
            kept += fmin(1.0, SAMPLE_PERIOD / 0.1) * (beside - kept);
        if (j == k && phase != GOING)
            beside = push(k, rested - rest_time);
        const double most = TORQUE_MAX(j) > 0.0 ? TORQUE_MAX(j) : 1e12;
        tau[j] = fmax(-most, fmin(most, weight(j) + beside));
        if (reset > 0.0 && fabs(tau[j]) < most && blocked != j + 1 &&
            (j != k || phase == GOING || phase == HELD))
            sum[j] += Kp[j] * ((phase == HELD && j == k ? origin : r[j]) - q[j]) *
                      SAMPLE_PERIOD / reset;
        WRITE_TORQUE(j, tau[j]);
    }
    torque = tau[k];
    const int32_t held_up = Blocked(), found = stands(k) ? joint : phase == GOING ? held_up : 0;
    if (blocked == 0 && found > 0)
        stay(k, found);
}

void UserBackground(void) {}
