/* reversal.h: dry friction turns round with its joint, and a command that knows it does so too.
 *
 * Where a joint turns round, an integral has to go from one side of friction to the other. Until it
 * is there the joint stands and its error grows; then the error takes it along, much faster than it
 * was to move. Here the command by which a joint moved is averaged before and after it turns round.
 * Half of what both differ by is its friction, and the next time the command turns round at once.
 * Needs r, rd, q and tau of the program.
 */
#ifndef ZENDSP_REVERSAL_H
#define ZENDSP_REVERSAL_H
#define REVERSAL_MEAN 0.1  /* s, that a command is averaged over */
#define REVERSAL_LOOK 0.1  /* s, between two looks whether the joint follows: by half of its way */
#define REVERSAL_MOVED 0.2 /* s, that a joint has to move one way for its command to be known */
#define REVERSAL_SLOW 0.02 /* of its fastest reference: what is slower has no direction */

static struct reversal {
    double sense;    /* of the latest reference that was not slow; 0: none yet */
    double fastest;  /* reference, rad/s (m/s) */
    double q, r;     /* at the latest look, rad (m) */
    double since;    /* s, of that look */
    bool follows;    /* as of that look */
    double moved;    /* s, since it turned round, while it followed */
    double mean;     /* command meanwhile, N m (N) */
    double before;   /* that of the way before */
    bool known;      /* the way before had one */
    double friction; /* N m (N); 0: not known */
} reversal_joint[8];

/* Average the command by which joint j follows; learn its friction once it has turned round. */
static inline void ReversalLook(int32_t j) {
    struct reversal *b = &reversal_joint[j];
    if (SAMPLE_TIME - b->since >= REVERSAL_LOOK) {
        b->follows = (q[j] - b->q) * b->sense > 0.5 * (r[j] - b->r) * b->sense;
        b->q = q[j];
        b->r = r[j];
        b->since = SAMPLE_TIME;
    }
    if (!b->follows)
        return; /* it stands */
    const bool knew = b->moved > REVERSAL_MOVED;
    b->moved += SAMPLE_PERIOD;
    b->mean += (tau[j] - b->mean) * SAMPLE_PERIOD / fmin(b->moved, REVERSAL_MEAN);
    if (b->known && !knew && b->moved > REVERSAL_MOVED)
        b->friction = fmax(0.0, 0.5 * b->sense * (b->mean - b->before));
}

/* Whether joint j turns round in this sample by a command that is known, which is written to
 * `torque`. Once a sample. */
static inline bool Reversal(int32_t j, double *torque) {
    struct reversal *b = &reversal_joint[j];
    if (FIRST_SAMPLE || !DRIVE_ENABLED)
        *b = (struct reversal){.sense = 0.0};
    b->fastest = fmax(b->fastest, fabs(rd[j]));
    if (fabs(rd[j]) <= REVERSAL_SLOW * b->fastest)
        return false;
    const double sense = rd[j] > 0.0 ? 1.0 : -1.0;
    if (sense == b->sense) {
        ReversalLook(j);
        return false;
    }
    b->known = b->moved > REVERSAL_MOVED;
    b->before = b->mean;
    b->sense = sense;
    b->moved = b->mean = 0.0;
    b->q = q[j];
    b->r = r[j];
    b->since = SAMPLE_TIME;
    b->follows = false;
    *torque = b->before + 2.0 * sense * b->friction;
    return b->known && b->friction > 0.0;
}

#endif
