/* What the simulator of simulate.c is told (sim_config), and what it remembers (sim_joint, sim).
 * Goes before solve.h.
 *
 * Units: rad or m, s, N m or N. Joints from 0.
 */
#include <stdint.h> /* int32_t */
#include <stdlib.h> /* calloc, free */
#include <string.h> /* memset, memcpy */

enum { SIM_MAX = 8, SIM_DOF = 2 * SIM_MAX, SIM_P = 6 };
enum { SIM_DIAGONAL = 0, SIM_PLANAR2R = 1, SIM_TREE = 2 };

typedef struct sim_config {
    int32_t joints, kind, inner; /* inner: integration steps per sample */
    int32_t load_sensor;         /* 1: the sensor sits on the load side of an elastic joint */
    int32_t hold;                /* samples for which a command is held */
    int32_t effects;
    double period;               /* s */
    double delay;                /* s, of every command */
    double p1, p2, p3;           /* planar2r, kg m^2 */
    double p3_angle;             /* rad, of what link 2 carries beside its line */
    double gravity[3];           /* tree, m/s^2 */
    /* diagonal: kg m^2 or kg; torque = weight sin(q) */
    double inertia[SIM_MAX], weight[SIM_MAX];
    /* torque per command unit; command units, 0: none */
    double gain[SIM_MAX], limit[SIM_MAX];
    double resolution[SIM_MAX];                    /* of the sensor, 0: continuous */
    double command_matrix[SIM_MAX * SIM_MAX];      /* joint command = matrix command */
    double sensor_matrix[SIM_MAX * SIM_MAX];       /* measured = matrix (joint - offset) */
    double sensor_offset[SIM_MAX];
    double q0[SIM_MAX], qd0[SIM_MAX];
    const double *tree;          /* TREE_ROW numbers a joint */
    const int32_t *effect, *effect_joint; /* index into the library; joint, ascending */
    const double *effect_p;      /* SIM_P numbers an effect */
    const double *temperature;   /* degrees C, one a sample; the last one stays */
    int32_t temperatures, reserved;
} sim_config;

typedef struct { /* what an effect may look at (the names that the effects' C uses) */
    double q, qd, qdd, t;
    double u, tau, load;
    double oq, oqd, oqdd;
    double lag_t;
    double temp;        /* degrees C */
} zs;

typedef struct sim_joint { /* what the effects of site "setup" set, and states */
    double delay, lag, k_spring, c_spring, j_load, gap, s0, s1, bw_force, bw_a, bw_n, j_extra;
    double dry_load; /* dry friction of a load on a spring */
    double j_links;  /* of an arm's links, which j_load is a part of; 0: that of the start */
    double creep; /* speed about which dry friction changes its sign; 0: it holds */
    double creep_lead; /* s: how far ahead a straight one sees the speed */
    int straight; /* it grows in proportion to the speed, not as a tanh */
    double k_cubic, w_amp, w_order, w_phase; /* load = motor + w_amp sin(w_order motor + w_phase) */
    double filter, seen;                     /* s; the position behind the filter */
    double keep; /* what a filter keeps that is computed once a row; 0: always */
    double column_late;                      /* s: of the recorded command */
    int two_mass, lag_on;
    int motor;          /* degree of freedom on the motor side; the joint's own where it is rigid */
    double j_motor;     /* inertia on the motor side of an elastic joint */
    double z, hyst, a;  /* bristle, hysteresis, lagged torque */
    double u, tau;      /* command and torque in this step */
    double load;        /* what of it reached the load in the step before */
} sim_joint;

typedef struct sim {
    sim_config c;
    sim_joint j[SIM_MAX];
    int dof, ticks, room;
    /* whether a rigid transmission has an error, a sensor a filter */
    int uneven, filtered;
    int first[SIM_MAX + 1];        /* effects of joint i: first[i] … first[i + 1] */
    /* position and speed: joints (load side), then motors of elastic joints */
    double x[SIM_DOF], v[SIM_DOF];
    double across[SIM_MAX][SIM_MAX]; /* inertia couplings of the effects */
    double *ucum;                  /* room + 1 rows of joints: integral of the held command */
    double held[SIM_MAX];
    double torque[SIM_MAX];        /* mean over the last sample */
} sim;

static inline double sgn(double x) { return (x > 0) - (x < 0); }
static inline double soft(double v, double lim) {
    return v > lim ? v - lim : v < -lim ? v + lim : 0.0;
}
