/* joint_pd.c: PID in every joint, for any machine whose command is a torque: holds where it stands,
 * sways, or follows the table ref.
 *
 *     tau = J (w^2 e + 2 damping w ed) + integral of J w^2 e / reset        w = 2 pi bandwidth
 *
 * J is what the machine says that each joint turns; where it says nothing, what its torque
 * accelerates by 100 rad/s^2.
 *
 * With `stalls` the machine is held where it is as soon as something holds a joint up on its way
 * (blocked.h); `blocked` says which. With `learns` the integral of a joint that turns round goes to
 * the other side of its dry friction at once (reversal.h).
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
#define N JOINTS
#define MOTION_MOST 8
#define MOTION_APPROACH 3.0
#define MOTION_SPEED 2.0 /* two thirds of what the WAM allows */
#include "motion.h"

static double bandwidth, damping, reset, amplitude, period;
static double J[8];   /* kg m^2 (or kg) */
static double tau[8]; /* N m (or N) */
static double sum[8]; /* N m, of the integrals */
static double carried[8];
static bool stalls, learns;
static int32_t blocked;
static double kept[8]; /* rad (or m), where the joints are held once one is blocked */
static double phase;  /* of the sway, turns */
#include "blocked.h"
#include "reversal.h"
/* amplitude and 1 / period of the sway as they act, and on their way there */
static double swing[2], pace[2];

void UserInit(void) {
    CompensationInit();
    MotionInit();
    MotionHolds();
    for (int32_t j = 0; j < N; j++)
        J[j] = JOINT_INERTIA(j) > 0.0 ? JOINT_INERTIA(j) : TORQUE_MAX(j) / 100.0;
    PARAMETER(bandwidth, 3.0, "Hz", 0.1, 20.0, "of the position loop");
    PARAMETER(damping, 1.0, "", 0.1, 3.0, "damping ratio");
    PARAMETER(reset, 0.3, "s", 0.05, 1000.0, "time constant of the integral");
    PARAMETER(amplitude, 0.0, "{q}", 0.0, 1.0, "sway of every joint about the reference; 0: none");
    PARAMETER(period, 4.0, "s", 0.5, 60.0,
              "of the sway of joint 1; each next joint sways a fifth faster");
    PARAMETER_FIRST(J, N, "{J}", 1e-12, 1e6, "inertia that each joint turns");
    PARAMETER_FIRST(carried, N, "{tau}", -1e6, 1e6, "that the integrals begin with: a weight");
    PARAMETER(stalls, 0, "", 0, 1, "hold the machine where a joint is blocked");
    PARAMETER(learns, 0, "", 0, 1, "turn dry friction round with the joint, once it is known");
    SIGNAL_FIRST(tau, N, "{tau}", "commands");
    SIGNAL(blocked, "", "joint that something holds up, from 1; 0: none");
}

/* Lead what acts over to what was set, in two lags of 0.15 s: neither it nor its speed jumps. */
static void lead(double *x, double goal, bool at_once) {
    const double share = at_once ? 1.0 : SAMPLE_PERIOD / (0.15 + SAMPLE_PERIOD);
    x[1] += share * (goal - x[1]);
    x[0] += share * (x[1] - x[0]);
}

/* Sway: in and out with the drives, every joint at a frequency of its own, so that a recording
 * tells the joints apart. */
static void sway(void) {
    double faster = 1.0;
    const bool fresh = FIRST_SAMPLE || !DRIVE_ENABLED;
    lead(swing, amplitude, fresh);
    lead(pace, 1.0 / period, fresh);
    phase = fresh ? 0.0 : phase + motion.pace * SAMPLE_PERIOD * pace[0];
    const double in = MotionSmooth(0.5 * phase);
    for (int32_t j = 0; j < N; j++, faster *= 1.2) {
        const double turn = 6.283185307179586 * faster;
        r[j] += in * swing[0] * sin(turn * phase);
        rd[j] += in * swing[0] * turn * pace[0] * cos(turn * phase);
        rdd[j] -= in * swing[0] * turn * pace[0] * turn * pace[0] * sin(turn * phase);
        e[j] = r[j] - q[j];
    }
}

void UserISR_INT2(void) {
    const double w = 6.283185307179586 * bandwidth;
    MotionStep();
    sway();
    if (FIRST_SAMPLE || !DRIVE_ENABLED)
        blocked = 0;
    for (int32_t j = 0; j < N && blocked > 0; j++) {
        r[j] = kept[j];
        rd[j] = rdd[j] = tau_ff[j] = 0.0;
        e[j] = r[j] - q[j];
    }
    for (int32_t j = 0; j < N; j++) {
        const double most = TORQUE_MAX(j), stiff = J[j] * w * w;
        double wanted =
            stiff * e[j] + 2.0 * damping * J[j] * w * (rd[j] - qd[j]) + sum[j] + tau_ff[j];
        wanted += Compensation(j, r, rd, rdd, wanted);
        double turned = wanted;
        if (learns && Reversal(j, &turned)) {
            sum[j] += turned - wanted;
            wanted = turned;
        }
        tau[j] = wanted > most ? most : wanted < -most ? -most : wanted;
        if (!DRIVE_ENABLED || FIRST_SAMPLE)
            sum[j] = carried[j];
        else if (wanted == tau[j] && blocked != j + 1) /* rests at the limit, and where blocked */
            sum[j] += stiff * e[j] * SAMPLE_PERIOD / reset;
        WRITE_TORQUE(j, tau[j]);
    }
    const int32_t found = Blocked();
    if (stalls && blocked == 0 && found > 0) {
        const struct blocked *b = &blocked_joint[found - 1];
        blocked = found; /* held by no more than it had moved by */
        sum[found - 1] = fmax(b->low, fmin(b->high, sum[found - 1]));
        for (int32_t j = 0; j < N; j++)
            kept[j] = q[j];
    }
}
