/* blocked.h: whether something holds a joint up on its way: a stop that nobody declared, a hand.
 *
 * A joint is looked at whenever it was to go by 5 mrad (mm), every 0.1 s at most. One that goes
 * less than a tenth of that, twice, is blocked where its command is far outside the range of
 * commands that it has moved by so far: by the width of that range where it had moved since it
 * turned round; by three times where it had not, since friction is larger at rest. Of one that
 * never moved nothing is known. Needs r, q and tau of the program.
 */
#ifndef ZENDSP_BLOCKED_H
#define ZENDSP_BLOCKED_H
#define BLOCKED_TIME 0.1    /* s, between two looks, at least */
#define BLOCKED_WAY 5e-3    /* rad (m), between two looks: bristles bend by less */
#define BLOCKED_FOLLOWS 0.5 /* of its way, that a joint which moves goes at least … */
#define BLOCKED_STANDS 0.1  /* … and one that does not, at most … */
#define BLOCKED_LOOKS 2     /* … one after the other */

static struct blocked {
    double q, r;         /* at the latest look, rad (m) */
    double low, high;    /* commands that it moved by, N m (N) */
    double least, most;  /* commands since it last moved */
    double since;        /* s, of that look */
    double sense;        /* of the way that it is on */
    bool begun, moved;   /* any command is known; it moved since it turned round */
    int32_t stood;       /* looks */
} blocked_joint[8];

static inline void BlockedBegin(int32_t j) {
    struct blocked *b = &blocked_joint[j];
    *b = (struct blocked){
        .q = q[j], .r = r[j], .since = SAMPLE_TIME, .least = tau[j], .most = tau[j]};
}

static inline bool BlockedLook(int32_t j) {
    struct blocked *b = &blocked_joint[j];
    const double asked = fabs(r[j] - b->r), sense = r[j] > b->r ? 1.0 : -1.0;
    const double went = (q[j] - b->q) * sense;
    if (SAMPLE_TIME - b->since < BLOCKED_TIME || asked < BLOCKED_WAY)
        return false;
    if (sense != b->sense) {
        b->moved = false;
        b->stood = 0;
    }
    b->sense = sense;
    if (went > BLOCKED_FOLLOWS * asked) {
        b->low = b->begun ? fmin(b->low, b->least) : b->least;
        b->high = b->begun ? fmax(b->high, b->most) : b->most;
        b->begun = b->moved = true;
        b->least = b->most = tau[j];
    }
    b->stood = went < BLOCKED_STANDS * asked ? b->stood + 1 : 0;
    b->q = q[j];
    b->r = r[j];
    b->since = SAMPLE_TIME;
    const double room = (b->moved ? 1.0 : 3.0) * (b->high - b->low);
    const double beyond = sense > 0.0 ? tau[j] - b->high : b->low - tau[j];
    return b->begun && b->stood >= BLOCKED_LOOKS && beyond > room;
}

/* The number of a joint that is blocked, from 1; 0: none. Once a sample. */
static inline int32_t Blocked(void) {
    int32_t found = 0;
    for (int32_t j = 0; j < N; j++) {
        if (FIRST_SAMPLE || !DRIVE_ENABLED)
            BlockedBegin(j);
        blocked_joint[j].least = fmin(blocked_joint[j].least, tau[j]);
        blocked_joint[j].most = fmax(blocked_joint[j].most, tau[j]);
        if (BlockedLook(j) && found == 0)
            found = j + 1;
    }
    return found;
}

#endif
