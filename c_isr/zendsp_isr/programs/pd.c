/* pd.c: PD control of the planar arm around a circle in joint space, or around a reference that the
 * host has downloaded. It commands joints 1 and 2 and holds no weight: the arm's axes are vertical.
 * For other machines there is joint_pd.c.
 *
 *     tau = Kp (r - q) + Kd (rd - qd)
 *     rd, qd: differences of r and q through a first-order filter
 *
 * A compensation.c beside this file, as `zendsp diagnose --out` writes it, is added to the command,
 * along the reference: a measured speed at rest would chatter, a reference knows its reversals.
 *
 * The circle: r1 = center1 + radius cos(phi), r2 = center2 + radius sin(phi), entered and left
 * smoothly from where the arm stands. When it is changed by a leap the reference is led over to the
 * new one, within approach_time: the motion that was comes to rest on the way. A table whose first
 * row is far away makes that longer; approach_time is that of the beginning, and row_rate that of
 * the first row.
 */
#include "isr.h"
#if __has_include("compensation.c")
#include "compensation.c"
#else
#define CompensationInit() ((void)0)
#define Compensation(joint, pos, vel, acc, torque) 0.0
#endif

enum { N = 2, ROWS = 60000 }; /* reference of 60 s at 1 kHz */
#define HALT 0.3              /* s that the reference takes to come to rest */
#define STEP_SPEED 40.0        /* rad/s; the drives trip at 15 at the latest */
#define APPROACH_SPEED 3.0     /* rad/s at the most, to the first row */
#define APPROACH_TORQUE 0.4    /* of the largest torque at the most, to accelerate to it */
#define COAST 0.6              /* s in which a motion that another takes over from comes to rest */

static double Kp1, Kd1, Kp2, Kd2, cutoff;
static double center1, center2, radius, turn_time, approach_time;
static bool use_table, hold;
static int32_t row_rate; /* rows of the table a second */
static table ref;

static double q1, q2, qd1, qd2, r1, r2, e1, e2, tau1, tau2;
static double q[N], e[N], tau[N];
static double r[N], rd[N], rdd[N];

static double rd1, rd2;
static double start[N], coast[N], last_q[N], last_r[N], t0;
static double phi; /* of the circle, rad */
static double approach, rate; /* approach_time and row_rate of this motion */
static double pace; /* of the reference's time: 1 runs, 0 stands */
static uint32_t seen;
static bool tabled;
static struct circle { double center1, center2, radius, turn_time; } led; /* as it was */

void UserInit(void) {
    CompensationInit();
    PARAMETER(Kp1, 2000.0, "N m/rad", 0.0, 20000.0, "proportional gain, joint 1");
    PARAMETER(Kd1, 120.0, "N m s/rad", 0.0, 1000.0, "derivative gain, joint 1");
    PARAMETER(Kp2, 300.0, "N m/rad", 0.0, 5000.0, "proportional gain, joint 2");
    PARAMETER(Kd2, 12.0, "N m s/rad", 0.0, 200.0, "derivative gain, joint 2");
    PARAMETER(cutoff, 80.0, "Hz", 1.0, 1000.0, "velocity filter");
    PARAMETER(center1, 0.2, "rad", -1.5, 1.5, "circle: center, joint 1");
    PARAMETER(center2, 0.6, "rad", -1.5, 1.5, "circle: center, joint 2");
    PARAMETER(radius, 0.4, "rad", 0.0, 1.0, "circle: radius; 0 holds the center");
    PARAMETER(turn_time, 4.5, "s", 0.5, 1000.0, "circle: time for a turn");
    PARAMETER(approach_time, 1.5, "s", 0.1, 60.0,
              "time from where the arm stands to the reference");
    PARAMETER(use_table, 0, "", 0, 1, "follow the table ref in place of the circle");
    PARAMETER(row_rate, 1000, "1/s", 1, 100000, "rows of ref a second");
    PARAMETER(hold, 0, "", 0, 1, "come to rest on the reference and stay there; 0 goes on");
    TABLE(ref, ROWS, N, "rad", "reference positions, one row a step");
    SIGNAL(q1, "rad", "position, joint 1");
    SIGNAL(q2, "rad", "position, joint 2");
    SIGNAL(qd1, "rad/s", "velocity, joint 1");
    SIGNAL(qd2, "rad/s", "velocity, joint 2");
    SIGNAL(r1, "rad", "reference, joint 1");
    SIGNAL(r2, "rad", "reference, joint 2");
    SIGNAL(e1, "rad", "error, joint 1");
    SIGNAL(e2, "rad", "error, joint 2");
    SIGNAL(tau1, "N m", "command, joint 1");
    SIGNAL(tau2, "N m", "command, joint 2");
    SIGNAL(q, "rad", "positions");
    SIGNAL(e, "rad", "errors");
    SIGNAL(tau, "N m", "commands");
}

/* Smooth step of fifth order: 0 at s <= 0, 1 at s >= 1, at rest at both ends. */
static double smooth(double s) {
    if (s <= 0.0)
        return 0.0;
    return s < 1.0 ? s * s * s * (10.0 + s * (6.0 * s - 15.0)) : 1.0;
}

/* Time to the first row: the step of fifth order has the peak speed 15/8 d/T and the peak
 * acceleration 10/sqrt(3) d/T^2. */
static double time_to_table(void) {
    double time = approach_time;
    for (int32_t j = 0; j < N && ref.rows > 0; j++) {
        const double d = fabs(TableValue(&ref, 0.0, j) - start[j] - 0.5 * COAST * coast[j]);
        const double most = TORQUE_MAX(j), J = JOINT_INERTIA(j);
        const double a = J > 0.0 && most > 0.0 ? APPROACH_TORQUE * most / J : INFINITY;
        time = fmax(time, fmax(1.875 * d / APPROACH_SPEED, sqrt(5.7735 * d / a)));
    }
    return time;
}

/* Where the motion that was has come to, at time t since the beginning of another. */
static double from(double t, int32_t j) {
    const double x = t < COAST ? t / COAST : 1.0;
    return start[j] + COAST * coast[j] * x * (1.0 + x * x * (0.5 * x - 1.0));
}

static void reference(double t) {
    const double blend = smooth(t / approach), from1 = from(t, 0), from2 = from(t, 1);
    double target1, target2;
    if (use_table) {
        if (t <= approach)
            rate = row_rate;
        const double row = t > approach ? (t - approach) * rate : 0.0;
        target1 = TableValue(&ref, row, 0);
        target2 = TableValue(&ref, row, 1);
    } else {
        target1 = center1 + radius * cos(phi);
        target2 = center2 + radius * sin(phi);
    }
    phi += pace * SAMPLE_PERIOD * 6.283185307179586 / turn_time;
    r1 = from1 + blend * (target1 - from1);
    r2 = from2 + blend * (target2 - from2);
}

/* Whether the circle leaps: more than an approach would within a sample. What a host fades is
 * followed as it comes. */
static bool circle_leaps(void) {
    const double way = fmax(fabs(center1 - led.center1), fabs(center2 - led.center2)) +
                       fabs(radius - led.radius);
    const double speed = 6.283185307179586 * radius * fabs(1.0 / turn_time - 1.0 / led.turn_time);
    led = (struct circle){center1, center2, radius, turn_time};
    return way > APPROACH_SPEED * SAMPLE_PERIOD ||
           speed > APPROACH_SPEED / approach_time * SAMPLE_PERIOD;
}

/* The drives come on: begin from where the arm stands. A new table, another circle, or from circle
 * to table and back: lead over to it from the present reference, without a step. */
static void begin(void) {
    const bool fresh = FIRST_SAMPLE || !DRIVE_ENABLED, leaps = circle_leaps();
    if (FIRST_SAMPLE) {
        last_q[0] = q1;
        last_q[1] = q2;
        qd1 = qd2 = 0.0;
    }
    if (fresh) {
        r1 = last_r[0] = q1;
        r2 = last_r[1] = q2;
        rd1 = rd2 = 0.0;
        pace = hold ? 0.0 : 1.0;
    }
    if (fresh || use_table != tabled || (use_table ? seen != ref.version : leaps)) {
        const double speed[N] = {rd1, rd2}, place[N] = {r1, r2};
        for (int32_t j = 0; j < N; j++) {
            start[j] = place[j] + speed[j] * SAMPLE_PERIOD;
            coast[j] = pace > 0.1 ? speed[j] / pace : 0.0; /* of the reference's own time */
        }
        phi = 0.0;
        t0 = SAMPLE_TIME;
        seen = ref.version;
        tabled = use_table;
        approach = use_table ? time_to_table() : approach_time;
    }
}

/* While `hold` is set the reference's time slows down within HALT seconds and stands, so that
 * nothing jumps; then it runs up again. */
static void slow_down(void) {
    const double step = SAMPLE_PERIOD / HALT;
    pace = hold ? fmax(pace - step, 0.0) : fmin(pace + step, 1.0);
    t0 += (1.0 - pace) * SAMPLE_PERIOD;
}

/* Speed of the reference from one sample to the next. What is faster than any joint of the arm is a
 * step, and a step has no speed. */
static double slope(double now, double before) {
    const double speed = (now - before) / SAMPLE_PERIOD;
    return fabs(speed) < STEP_SPEED ? speed : 0.0;
}

static void differentiate(void) {
    const double a = 1.0 - exp(-6.283185307179586 * cutoff * SAMPLE_PERIOD);
    qd1 += a * ((q1 - last_q[0]) / SAMPLE_PERIOD - qd1);
    qd2 += a * ((q2 - last_q[1]) / SAMPLE_PERIOD - qd2);
    rd1 += a * (slope(r1, last_r[0]) - rd1);
    rd2 += a * (slope(r2, last_r[1]) - rd2);
    last_q[0] = q1;
    last_q[1] = q2;
    last_r[0] = r1;
    last_r[1] = r2;
}

static void compensate(void) {
    const double now[N] = {rd1, rd2};
    for (int32_t j = 0; j < N; j++) {
        rdd[j] = (now[j] - rd[j]) / SAMPLE_PERIOD;
        rd[j] = now[j];
    }
    r[0] = r1;
    r[1] = r2;
    tau1 += Compensation(0, r, rd, rdd, tau1);
    tau2 += Compensation(1, r, rd, rdd, tau2);
}

void UserISR_INT2(void) {
    q1 = READ_POSITION(0);
    q2 = READ_POSITION(1);
    begin();
    slow_down();
    reference(SAMPLE_TIME - t0);
    differentiate();
    e1 = r1 - q1;
    e2 = r2 - q2;
    tau1 = Kp1 * e1 + Kd1 * (rd1 - qd1);
    tau2 = Kp2 * e2 + Kd2 * (rd2 - qd2);
    compensate();
    WRITE_TORQUE(0, tau1);
    WRITE_TORQUE(1, tau2);
    q[0] = q1;
    q[1] = q2;
    e[0] = e1;
    e[1] = e2;
    tau[0] = tau1;
    tau[1] = tau2;
}
