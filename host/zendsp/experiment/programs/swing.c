/* swing.c: a planned torque on one joint, with or without its motion followed.
 *
 *     tau = ref_tau + kp (r - q) + kv (rd - qd) + fc tanh(beta qd)
 *
 * On the way to the first row the motion is always followed; from there on only where `follow` is
 * set. Before and after the plan the weight is borne.
 */
#include "isr.h"
#define N 1
#define MOTION_CUTOFF 30.0
#include "motion.h"

static double kp, kv, fc, beta, sine, cosine, constant;
static bool follow;
static double tau[N], friction;

void UserInit(void) {
    MotionInit();
    PARAMETER(follow, 0, "", 0, 1, "follow the planned motion");
    PARAMETER(kp, 0.0, "{tau}/{q}", 0.0, NO_MAX, "position gain");
    PARAMETER(kv, 0.0, "{tau} s/{q}", 0.0, NO_MAX, "velocity gain");
    PARAMETER(fc, 0.0, "{tau}", 0.0, NO_MAX, "friction level of the model");
    PARAMETER(beta, 100.0, "s/{q}", 0.1, 1000.0, "steepness of the model at standstill");
    PARAMETER(sine, 0.0, "{tau}", NO_MIN, NO_MAX, "of the weight");
    PARAMETER(cosine, 0.0, "{tau}", NO_MIN, NO_MAX, "of the weight");
    PARAMETER(constant, 0.0, "{tau}", NO_MIN, NO_MAX, "of the weight");
    SIGNAL(tau, "{tau}", "command");
    SIGNAL(friction, "{tau}", "friction that is added");
}

void UserISR_INT2(void) {
    MotionStep();
    const bool coming = play_time < 0.0;
    const double most = TORQUE_MAX(0);
    const double weight = sine * sin(q[0]) + cosine * cos(q[0]) + constant;
    friction = coming ? 0.0 : fc * tanh(beta * qd[0]);
    double wanted = friction + (playing ? tau_ff[0] : weight);
    if (coming || follow)
        wanted += kp * e[0] + kv * (rd[0] - qd[0]);
    tau[0] = wanted > most ? most : wanted < -most ? -most : wanted;
    WRITE_TORQUE(0, tau[0]);
}

void UserBackground(void) {}
