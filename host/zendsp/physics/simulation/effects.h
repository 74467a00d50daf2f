/* What the effects of a joint do: to its torque, its command, its sensor and its parts.
 *
 * Completed at build time: EFFECT_FUNCTIONS becomes one small function per physical effect (see
 * effects/), EFFECT_CASES_* the switches that call them.
 */

/* EFFECT_FUNCTIONS */

enum { ROOM = 20 }; /* degrees C, where nobody says */

/* load: on what the joint moves; tau: what the drive gives at this speed */
typedef struct { double smooth, load, dry_pos, dry_neg, visc, tau; } sim_force;

/* Torque of all effects of one joint that opposes the drive, at the state in s. visc: N m s/rad. */
static void gather(const sim *S, int joint, const double *x, const double *v, zs s, sim_force *f) {
    double visc = 0, dry_scale = 1, visc_scale = 1;
    zs w = s; /* a viscous effect is a torque; its slope is wanted, also at rest */
    if (fabs(w.qd) < 1e-9)
        w.qd = w.qd < 0 ? -1e-9 : 1e-9;
    memset(f, 0, sizeof *f);
    for (int i = S->first[joint]; i < S->first[joint + 1]; i++) {
        const double *p = S->c.effect_p + i * SIM_P;
        switch (S->c.effect[i]) {
/* EFFECT_CASES_FORCE */
        default: break;
        }
    }
    f->dry_pos = f->dry_pos * dry_scale > 0 ? f->dry_pos * dry_scale : 0;
    f->dry_neg = f->dry_neg * dry_scale > 0 ? f->dry_neg * dry_scale : 0;
    f->visc = visc / w.qd * visc_scale;
    f->tau = s.tau;
    (void)x, (void)v;
}

/* degrees C in this sample */
static double warmth(const sim *S) {
    const int last = S->c.temperatures - 1;
    return last < 0
               ? ROOM
               : S->c.temperature[S->ticks - 1 < last ? (S->ticks > 0 ? S->ticks - 1 : 0) : last];
}

static double act(const sim *S, int joint, double u, double t) {
    const double limit = S->c.limit[joint];
    const zs s = {.t = t};
    if (limit > 0)
        u = u > limit ? limit : u < -limit ? -limit : u;
    for (int i = S->first[joint]; i < S->first[joint + 1]; i++) {
        const double *p = S->c.effect_p + i * SIM_P;
        switch (S->c.effect[i]) {
/* EFFECT_CASES_ACTUATOR */
        default: break;
        }
    }
    (void)s;
    return S->c.gain[joint] * u;
}

static double sense(const sim *S, int joint, double q) {
    zs s;
    memset(&s, 0, sizeof s);
    s.q = q;
    double out = q;
    for (int i = S->first[joint]; i < S->first[joint + 1]; i++) {
        const double *p = S->c.effect_p + i * SIM_P;
        switch (S->c.effect[i]) {
/* EFFECT_CASES_SENSOR */
        default: break;
        }
    }
    return out;
}

static void setup_joint(sim *S, int joint) {
    double delay = 0, lag = 0, k_spring = 0, c_spring = 0, j_load = 0, gap = 0, s0 = 0, s1 = 0,
           bw_force = 0, bw_a = 0, bw_n = 1, creep = 0, creep_lead = 0;
    double j_extra = 0, k_cubic = 0, w_amp = 0, w_order = 0, w_phase = 0, filter = 0,
           keep = 0, column_late = 0, dry_load = 0, j_links = 0;
    const double row = S->c.period; /* s */
    int two_mass = 0, lag_on = 0, straight = 0;
    for (int i = S->first[joint]; i < S->first[joint + 1]; i++) {
        const double *p = S->c.effect_p + i * SIM_P;
        switch (S->c.effect[i]) {
/* EFFECT_CASES_SETUP */
        default: break;
        }
    }
    sim_joint *j = &S->j[joint];
    *j = (sim_joint){.delay = delay + S->c.delay,
                     .lag = lag,
                     .k_spring = k_spring,
                     .c_spring = c_spring,
                     .j_load = j_load,
                     .gap = gap,
                     .s0 = s0,
                     .s1 = s1,
                     .bw_force = bw_force,
                     .bw_a = bw_a,
                     .bw_n = bw_n,
                     .creep = creep,
                     .creep_lead = creep_lead,
                     .straight = straight,
                     .dry_load = dry_load,
                     .j_links = j_links,
                     .j_extra = j_extra,
                     .k_cubic = k_cubic,
                     .w_amp = w_amp,
                     .w_order = w_order,
                     .w_phase = w_phase,
                     .filter = filter,
                     .keep = keep,
                     .column_late = column_late,
                     .two_mass = two_mass,
                     .lag_on = lag_on && lag > 0,
                     .motor = joint};
}

