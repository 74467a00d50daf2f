/* motion.h: what control programs of N joints share: measured motion, and a reference to follow.
 *
 *     #include "isr.h"
 *     #define N 2
 *     #include "motion.h"
 *
 *     void UserInit(void)     { MotionInit(); … }
 *     void UserISR_INT2(void) { MotionStep(); … q, qd; r, rd, rdd; tau_ff … }
 *
 * A program for any machine says `#define N JOINTS` and `#define MOTION_MOST 8`: arrays then have
 * eight elements, of which the host sees those of the machine.
 *
 * The host downloads the table `ref`, one row a step, N columns of positions (the q of a reference
 * file), and with it, if the program wants a torque as well, `ref_tau`. Both in one synchronous
 * update; the motion begins when they switch over, when `play` changes, or when the drives come on:
 * from where the machine stands, over `approach_time` as it then is, into the first row. A joint
 * that has far to go makes that longer; 0 is at once, for a table that begins where the machine
 * stands. `row_rate` is taken until the first row is reached. Between rows the
 * position is interpolated; its speed and acceleration are differences over one row. While `hold`
 * is set the reference's time slows down within MOTION_HALT seconds and stands: the machine comes
 * to rest on its path and goes on from there. Only a program that follows r may offer it, with
 * MotionHolds() after MotionInit(). docs/references.md has the convention.
 */
#ifndef ZENDSP_MOTION_H
#define ZENDSP_MOTION_H

#ifndef N
#error "define N, the number of joints, before #include \"motion.h\""
#endif
#ifndef MOTION_MOST
#define MOTION_MOST N /* elements of the arrays */
#endif
#ifndef MOTION_CUTOFF
#define MOTION_CUTOFF 80.0 /* Hz, initial value of the velocity filter */
#endif
#ifndef MOTION_HALT
#define MOTION_HALT 0.3 /* s from full speed to rest */
#endif
#ifndef MOTION_APPROACH
#define MOTION_APPROACH                                                                            \
    1.0 /* s, initial value of approach_time; longer for a machine whose joints come from far */
#endif
#ifndef MOTION_SPEED
#define MOTION_SPEED 3.0 /* rad/s (or m/s), at the most during an approach */
#endif
#ifndef MOTION_TORQUE
#define MOTION_TORQUE 0.4 /* of a joint's largest torque, at the most to accelerate an approach */
#endif
#ifndef MOTION_COAST
#define MOTION_COAST 0.6 /* s in which a motion that another takes over from comes to rest */
#endif
#ifndef MOTION_ROWS
#define MOTION_ROWS 60000 /* 60 s at 1 kHz */
#endif

static table ref, ref_tau;
static bool use_table, hold;
static int32_t row_rate, play;
static double approach_time, cutoff;

static double q[MOTION_MOST], qd[MOTION_MOST];                   /* measured, rad and rad/s */
static double r[MOTION_MOST], rd[MOTION_MOST], rdd[MOTION_MOST]; /* reference */
/* r - q; torque of the reference, N m */
static double e[MOTION_MOST], tau_ff[MOTION_MOST];
static double play_time; /* s since the first row; negative while approaching */
static bool playing;

static struct motion {
    bool tabled;    /* use_table, as it was */
    /* positions one sample ago and at the beginning, and when that was */
    double last[MOTION_MOST], start[MOTION_MOST], t0;
    double v[MOTION_MOST], a[MOTION_MOST]; /* speed and acceleration at the beginning */
    /* reference of the sample before, whatever the program adds to it */
    double r[MOTION_MOST], rd[MOTION_MOST], rdd[MOTION_MOST];
    double approach; /* s, of this motion */
    double rate;     /* rows a second, of this motion */
    double pace;     /* of the reference's time: 1 runs, 0 stands */
    uint32_t seen;
    int32_t played;
} motion;

static inline void MotionInit(void) {
    PARAMETER(use_table, 1, "", 0, 1, "follow the table ref; 0 holds the position");
    PARAMETER(row_rate, 1000, "1/s", 1, 100000, "rows of ref a second");
    PARAMETER(approach_time, MOTION_APPROACH, "s", 0.0, 60.0,
              "time from where the machine stands to the first row");
    PARAMETER(play, 0, "", 0, 2147483647,
              "any change plays ref again from where the machine stands");
    PARAMETER(cutoff, MOTION_CUTOFF, "Hz", 1.0, 1000.0, "velocity filter");
    TABLE(ref, MOTION_ROWS, N, "{q}", "reference positions, one row a step");
    TABLE(ref_tau, MOTION_ROWS, N, "{tau}", "torque that goes with them");
    SIGNAL_FIRST(q, N, "{q}", "positions");
    SIGNAL_FIRST(qd, N, "{q}/s", "velocities, filtered");
    SIGNAL_FIRST(r, N, "{q}", "reference");
    SIGNAL_FIRST(rd, N, "{q}/s", "its velocity");
    SIGNAL_FIRST(rdd, N, "{q}/s^2", "its acceleration");
    SIGNAL_FIRST(e, N, "{q}", "errors r - q");
    SIGNAL_FIRST(tau_ff, N, "{tau}", "torque of the reference");
    SIGNAL(play_time, "s", "time in the reference");
    SIGNAL(playing, "", "true from the first row to the last");
}

/* For programs whose command follows r: a host that is lost may then leave the machine standing
 * under control. */
#define MotionHolds()                                                                              \
    PARAMETER(hold, 0, "", 0, 1, "come to rest on the reference and stay there; 0 goes on")

/* Fifth-order step, at rest at both ends. */
static inline double MotionSmooth(double s) {
    if (s <= 0.0)
        return 0.0;
    return s < 1.0 ? s * s * s * (10.0 + s * (6.0 * s - 15.0)) : 1.0;
}

/* The motion that was, from time t = 0 on: it comes to rest without a step of speed or
 * acceleration. */
static inline double MotionFrom(double t, int32_t j) {
    const double x = t < MOTION_COAST ? t / MOTION_COAST : 1.0;
    const double of_v = x * (1.0 + x * x * (0.5 * x - 1.0));
    const double of_a = x * x * (0.5 + x * (0.25 * x - 2.0 / 3.0));
    const double coasted = motion.v[j] * of_v + MOTION_COAST * motion.a[j] * of_a;
    return motion.start[j] + MOTION_COAST * coasted;
}

/* Lead a share over to 0 or 1 within MOTION_COAST: what is added to a command comes and goes
 * without a step. Where the program begins afresh it is there at once. */
static inline double MotionShare(double share, bool on) {
    const double step = SAMPLE_PERIOD / MOTION_COAST, goal = on ? 1.0 : 0.0;
    return FIRST_SAMPLE || !DRIVE_ENABLED ? goal : share + fmax(-step, fmin(step, goal - share));
}

/* Reference of joint j at time t since the beginning. */
static inline double MotionAt(double t, int32_t j) {
    const double from = MotionFrom(t, j);
    if (!use_table || ref.rows == 0)
        return from;
    /* before row 0 and after the last: these hold */
    const double goal = TableValue(&ref, (t - motion.approach) * motion.rate, j);
    return from + (motion.approach > 0.0 ? MotionSmooth(t / motion.approach) : 1.0) * (goal - from);
}

static inline void MotionMeasure(void) {
    const double a = 1.0 - exp(-6.283185307179586 * cutoff * SAMPLE_PERIOD);
    for (int32_t j = 0; j < N; j++) {
        q[j] = READ_POSITION(j);
        qd[j] = FIRST_SAMPLE ? 0.0 : qd[j] + a * ((q[j] - motion.last[j]) / SAMPLE_PERIOD - qd[j]);
        motion.last[j] = q[j];
    }
}

/* Time of the approach: the step of fifth order has the peak speed 15/8 d/T and the peak
 * acceleration 10/sqrt(3) d/T^2. */
static inline double MotionApproach(void) {
    double time = approach_time;
    if (!use_table || ref.rows == 0 || time <= 0.0)
        return time;
    for (int32_t j = 0; j < N; j++) {
        const double d = fabs(TableValue(&ref, 0.0, j) - MotionFrom(MOTION_COAST, j));
        const double most = TORQUE_MAX(j), J = JOINT_INERTIA(j);
        const double a = J > 0.0 && most > 0.0 ? MOTION_TORQUE * most / J : 100.0 * MOTION_TORQUE;
        time = fmax(time, fmax(1.875 * d / MOTION_SPEED, sqrt(5.7735 * d / a)));
    }
    return time > approach_time ? ceil(time / SAMPLE_PERIOD) * SAMPLE_PERIOD : time;
}

static inline void MotionBegin(void) {
    const bool fresh = FIRST_SAMPLE || !DRIVE_ENABLED;
    const double pace = motion.pace; /* of the sample before */
    for (int32_t j = 0; j < N; j++) { /* drives on: on from the reference, so that nothing jumps */
        motion.start[j] = fresh ? q[j] : motion.r[j] + SAMPLE_PERIOD * motion.rd[j];
        motion.v[j] = fresh || pace <= 0.0 ? 0.0 : motion.rd[j] / pace;
        motion.a[j] = fresh || pace < 1.0 ? 0.0 : motion.rdd[j];
    }
    motion.approach = MotionApproach();
    motion.t0 = SAMPLE_TIME;
    motion.seen = ref.version;
    motion.played = play;
    motion.tabled = use_table;
    if (fresh)
        motion.pace = hold ? 0.0 : 1.0;
}

/* Returns the rate at which the pace changes, 1/s. */
static inline double MotionPace(void) {
    const double before = motion.pace, step = SAMPLE_PERIOD / MOTION_HALT;
    motion.pace = hold ? fmax(before - step, 0.0) : fmin(before + step, 1.0);
    motion.t0 += (1.0 - motion.pace) * SAMPLE_PERIOD;
    return (motion.pace - before) / SAMPLE_PERIOD;
}

static inline void MotionStep(void) {
    MotionMeasure();
    if (FIRST_SAMPLE || !DRIVE_ENABLED || motion.seen != ref.version || motion.played != play ||
        motion.tabled != use_table)
        MotionBegin();
    const double slowing = MotionPace(), pace = motion.pace;
    const double t = SAMPLE_TIME - motion.t0;
    play_time = t - motion.approach;
    if (play_time <= 0.0)
        motion.rate = row_rate;
    const double h = 1.0 / motion.rate;
    playing = use_table && ref.rows > 0 && play_time >= 0.0 && play_time <= (ref.rows - 1) * h;
    for (int32_t j = 0; j < N; j++) {
        const double before = MotionAt(t - h, j), after = MotionAt(t + h, j);
        r[j] = MotionAt(t, j);
        const double speed = (after - before) / (2.0 * h);
        rd[j] = pace * speed;
        rdd[j] = pace * pace * (after - 2.0 * r[j] + before) / (h * h) + slowing * speed;
        motion.r[j] = r[j];
        motion.rd[j] = rd[j];
        motion.rdd[j] = rdd[j];
        e[j] = r[j] - q[j];
        /* a torque is held, not interpolated; it belongs to the motion, and fades with it */
        tau_ff[j] =
            playing ? pace * TableValue(&ref_tau, floor(play_time * motion.rate + 1e-6), j) : 0.0;
    }
}

#endif
