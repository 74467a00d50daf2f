/* What the effects of a model do, for LANES parameter sets at once (see kernel.c, which takes this,
 * motion.c, step.c and observer.c in twice: for one and for many). native.py writes each effect's C
 * into its place.
 *
 * The lanes have the recording, the observer and the kinds of effects in common and differ in
 * numbers only, so every loop over them is arithmetic without branches: a step is a long chain of
 * operations that wait for each other, and lanes fill the waiting.
 */

typedef struct {
    double p[MAXFX][MAXP * LANES];
    double shift[LANES], gain[LANES], limit[LANES], gravity[LANES];
    double delay[LANES], lag[LANES], k_spring[LANES], c_spring[LANES], j_load[LANES], gap[LANES];
    double s0[LANES], s1[LANES], bw_force[LANES], bw_a[LANES], bw_n[LANES], j_extra[LANES];
    double k_cubic[LANES], w_amp[LANES], w_order[LANES], w_phase[LANES], filter[LANES], keep[LANES];
    double creep[LANES], creep_lead[LANES], damp[LANES], dry_load[LANES], j_links[LANES];
    int bw_whole, whole[MAXFX][MAXP]; /* of a number in all lanes: 1 or 2 where it is that */
    int two_mass, lag_on, gapped, bristled, bent, creeps, straight, pulled, hung, late, drives,
        senses, wavy, filtered, by_rows, hidden, loaded; /* whether any lane has it */
    int at[PLACES][MAXFX], count[PLACES]; /* the effects of each place, by their rows */
} OF(numbers);

#if LANES > 1 /* a vector, which stays in a register where an array would not */
typedef double OF(lane) __attribute__((vector_size(8 * LANES)));
#else
typedef double OF(lane)[LANES];
#endif

typedef struct { /* what an effect may look at */
    OF(lane) q, qd, qdd; /* of the joint; qdd only where a trace is asked for */
    OF(lane) u, tau;     /* command (its own unit) and actuator torque */
    OF(lane) load;       /* what of it reaches the load: in the step before */
    /* time, degrees C; motion of the other joint, for couplings */
    OF(lane) t, temp, oq, oqd, oqdd;
} OF(state);

/* EFFECT_FUNCTIONS */

/* 1 or 2 where that is the number of all lanes, else 0 */
static int OF(whole)(const double *number)
{
    for (int l = 0; l < LANES; l++)
        if (number[l] != number[0] || (number[0] != 1.0 && number[0] != 2.0)) return 0;
    return (int)number[0];
}

static void OF(set_up)(const zk_model *M, OF(numbers) *N)
{
    memset(N, 0, sizeof *N);
    for (int l = 0; l < LANES; l++) {
        double delay = M[l].delay, lag = 0, k_spring = 0, c_spring = 0, j_load = 0, gap = 0;
        double s0 = 0, s1 = 0, bw_force = 0, bw_a = 0, bw_n = 1, j_extra = 0, row = M->T; /* s */
        double k_cubic = 0, w_amp = 0, w_order = 0, w_phase = 0, filter = 0, column_late = 0;
        double creep = 0, creep_lead = 0, damp = 0, dry_load = 0, keep = 0, j_links = 0;
        int two_mass = 0, lag_on = 0, drives = 0, senses = 0, hung = 0, loaded = 0, straight = 0;
        for (int i = 0; i < M->nfx; i++) {
            const double *p = M[l].p + i * MAXP;
            for (int j = 0; j < MAXP; j++) N->p[i][j * LANES + l] = p[j];
            switch (M->kind[i]) {
/* EFFECT_CASES_SETUP */
            default: break;
            }
        }
        /* nobody says how much of the inertia is the load */
        if (!(j_links > 0)) j_links = M[l].reference;
        if (two_mass && !(j_load > 0)) j_load = 0.5 * j_links;
        /* nor what damps it: a twentieth of critical */
        if (c_spring < 0) c_spring = 0.1 * sqrt(k_spring * j_load);
        /* a loop knows its command before it is recorded */
        if (!(M[l].kp > 0)) delay -= column_late;
        N->shift[l] = M[l].shift;
        N->gain[l] = M[l].gain;
        N->limit[l] = M[l].limit > 0 ? M[l].limit : INFINITY;
        N->gravity[l] = M[l].gravity;
        N->delay[l] = delay;
        N->lag[l] = lag;
        N->k_spring[l] = k_spring;
        N->c_spring[l] = c_spring;
        N->j_load[l] = j_load;
        N->gap[l] = gap;
        N->s0[l] = s0; N->s1[l] = s1;
        N->bw_force[l] = bw_force;
        N->bw_a[l] = bw_a;
        N->bw_n[l] = bw_n;
        N->j_extra[l] = j_extra;
        N->k_cubic[l] = k_cubic;
        N->w_amp[l] = w_amp;
        N->w_order[l] = w_order;
        N->w_phase[l] = w_phase;
        N->filter[l] = filter; N->keep[l] = keep;
        N->creep[l] = creep; N->creep_lead[l] = creep_lead;
        N->damp[l] = damp;
        N->dry_load[l] = dry_load; N->j_links[l] = j_links;
        N->wavy |= w_amp != 0;
        N->hidden |= lag_on || delay != 0 || s0 > 0 || bw_force > 0 || creep > 0;
        N->filtered |= filter > 0; N->by_rows |= keep > 0;
        N->drives |= drives;
        N->senses |= senses;
        N->hung |= hung;
        N->loaded |= loaded;
        N->two_mass |= two_mass;
        N->lag_on |= lag_on;
        N->gapped |= gap > 0;
        N->bristled |= s0 > 0;
        N->bent |= bw_force > 0;
        N->creeps |= creep > 0; N->straight |= straight;
        N->pulled |= M[l].gravity != 0; N->late |= delay != 0;
    }
}

static void OF(begin_numbers)(const zk_model *M, OF(numbers) *N)
{
    OF(set_up)(M, N);
    for (int i = 0; i < M->nfx; i++) {
        int places = 0;
        switch (M->kind[i]) {
/* EFFECT_CASES_PLACES */
        default: break;
        }
        for (int place = 0; place < PLACES; place++)
            if (places >> place & 1) N->at[place][N->count[place]++] = i;
    }
    N->bw_whole = OF(whole)(N->bw_n);
    for (int i = 0; i < M->nfx; i++)
        for (int j = 0; j < MAXP; j++) N->whole[i][j] = OF(whole)(&N->p[i][j * LANES]);
}

#define AT(place)                                                                                 \
    for (int a = 0; a < N->count[place]; a++) {                                                   \
        const int i = N->at[place][a];                                                            \
        const double *p = N->p[i];                                                                \
        switch (M->kind[i])

/* torque without dry friction, what dry friction is multiplied by, and viscous friction: of effects
 * that no speed or torque changes; lane l looks at sample k + stride l of what is recorded */
INLINE void OF(gather_still)(const zk_model *M, const OF(numbers) *N, OF(state) *S, int k,
                             int stride, OF(lane) *torque, OF(lane) *scale, OF(lane) *thick)
{
    EACH { (*torque)[l] = 0; (*scale)[l] = (*thick)[l] = 1; }
    AT(STILL) {
/* EFFECT_CASES_STILL */
        default: break;
        }
    }
    (void)S; (void)k; (void)stride;
}

/* The same of the others, upon those. What the drive cannot give at the speed is a torque that
 * resists, and S->tau then is what it gives. */
INLINE void OF(gather)(const zk_model *M, const OF(numbers) *N, OF(state) *S, int k, int stride,
                       OF(lane) *torque, OF(lane) *scale, OF(lane) *thick)
{
    OF(lane) visc;
    EACH visc[l] = 0;
    AT(FORCE) {
/* EFFECT_CASES_FORCE */
        default: break;
        }
    }
    EACH (*torque)[l] += visc[l] * (*thick)[l];
    (void)k; (void)stride;
}

/* what pulls at a load that turns apart from its motor, at S->q */
INLINE void OF(hang)(const zk_model *M, const OF(numbers) *N, const OF(state) *S, OF(lane) *fall)
{
    AT(LOAD) {
/* EFFECT_CASES_LOAD */
        default: break;
        }
    }
    (void)fall; (void)S;
}

/* dry friction for motion in the direction of v */
INLINE void OF(dry)(const zk_model *M, const OF(numbers) *N, const OF(state) *S,
                    const OF(lane) *v, const OF(lane) *scale, OF(lane) *level)
{
    EACH (*level)[l] = 0;
    AT(DRY) {
/* EFFECT_CASES_DRY */
        default: break;
        }
    }
    EACH (*level)[l] *= (*scale)[l];
    (void)v; (void)S;
}

INLINE void OF(act)(const zk_model *M, const OF(numbers) *N, const OF(state) *S,
                    const OF(lane) *command, OF(lane) *tau)
{
    OF(lane) u;
    EACH u[l] = clip((*command)[l], N->limit[l]);
    AT(ACTUATOR) {
/* EFFECT_CASES_ACTUATOR */
        default: break;
        }
    }
    EACH (*tau)[l] = N->gain[l] * u[l];
    (void)S;
}

INLINE void OF(sense)(const zk_model *M, const OF(numbers) *N, OF(state) *S, const OF(lane) *q,
                      OF(lane) *out)
{
    EACH { S->q[l] = (*q)[l]; (*out)[l] = (*q)[l]; }
    AT(SENSOR) {
/* EFFECT_CASES_SENSOR */
        default: break;
        }
    }
}
#undef AT
