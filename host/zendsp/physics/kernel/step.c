/* One sample's way from state to state: command, rigid body, transmission, friction. */

/* What the rigid body does at sample k. rigid: its inertia and torque along the recording, of each
 * lane; most lanes have the same. */
INLINE void OF(rigid_body)(const OF(task) *O, OF(motion) *X, int k, const OF(series) *rigid)
{
    const zk_model *M = O->M;
    const OF(numbers) *N = O->N;
    OF(lane) inertia, bias;
    OF(value)(&rigid[0], k, &inertia);
    OF(value)(&rigid[1], k, &bias);
    EACH { X->jm[l] = inertia[l] + N->j_extra[l]; X->bias[l] = bias[l]; }
    if (O->geared) EACH X->load[l] = X->jm[l] - N->j_extra[l];
    if (O->two_mass && M->bias_slope) /* the load is not where the motor was measured */
        for (int l = 0; l < LANES; l++)
            X->bias[l] += M[l].bias_slope[k] * (X->ql[l] - M[l].rq[k] - M[l].shift);
    if (O->two_mass)
        for (int l = 0; l < LANES; l++) {
            double motor, beyond;
            share_inertia(N->j_links[l] + N->j_extra[l], X->jm[l], N->j_load[l], &motor, &beyond);
            X->jm[l] = motor;
            X->per_jl[l] = 1.0 / beyond;
        }
    if (M->stiff) EACH X->jm[l] += O->h * N->damp[l]; /* implicit, of first order */
    EACH X->per_jm[l] = 1.0 / X->jm[l];
}

/* The command, held over sample k, and what the actuator makes of it: at once, or step by step. */
INLINE void OF(hold)(const OF(task) *O, OF(motion) *X, int k)
{
    const zk_model *M = O->M;
    if (!O->steady) {
        EACH X->past[l] = cum(M, k * M->T - O->N->delay[l], O->per_T);
        return;
    }
    const double held = (M->ucum[k + 1] - M->ucum[k]) / M->T, now = M->t0 + (k + 0.5) * M->T;
    EACH { X->u[l] = held; O->S->t[l] = now; }
    OF(act)(M, O->N, O->S, LANES_OF(u), (OF(lane) *)X->tau);
}

/* The same over a step that begins at tl, for a command that lags or is late: its mean, and how far
 * it takes the joint beyond what its mean would, times the inertia. */
INLINE void OF(drive)(const OF(task) *O, OF(motion) *X, double tl, int first)
{
    const OF(numbers) *N = O->N;
    const zk_model *M = O->M;
    const double h = O->h;
    EACH {
        const double end = tl + h - N->delay[l], next = cum(M, end, O->per_T),
                     edge = floor(clip(end * O->per_T, M->n - 1.0)), /* where the command changes */
                     until = edge * M->T - (end - h);
        const _Bool within = (until > 0) & (until < h) & (edge >= 0);
        const double then = M->ucum[within ? (int)edge : 0] - X->past[l];
        X->u[l] = (next - X->past[l]) * O->per_h;
        X->early[l] = within ? 0.5 * N->gain[l] * (h * then - until * (next - X->past[l])) : 0.0;
        X->past[l] = next;
    }
    OF(act)(M, N, O->S, LANES_OF(u), (OF(lane) *)X->tau);
    if (O->hidden && N->lag_on) /* a current loop or a winding: it is asked for what is left */
        EACH {
            double before = first ? X->tau[l] : X->a[l], held = X->tau[l];
            X->tau[l] = held + (before - held) * X->mean[l];
            X->a[l] = held + (before - held) * X->ex[l];
            X->early[l] +=
                (before - held) * N->lag[l] * h * (0.5 * (1 + X->ex[l]) - X->mean[l]);
        }
}

/* The error of a transmission: the load turns by slope for each turn of the motor. */
INLINE void OF(gear)(const OF(task) *O, OF(motion) *X, double added)
{
    const OF(numbers) *N = O->N;
    const OF(state) *S = O->S;
    EACH {
        double at = N->w_order[l] * S->q[l] + N->w_phase[l];
        X->slope[l] = 1 + N->w_amp[l] * N->w_order[l] * cos(at);
        X->wave[l] =
            N->w_amp[l] * sin(O->two_mass ? N->w_order[l] * X->q[l] + N->w_phase[l] : at);
        X->bend[l] = -N->w_amp[l] * N->w_order[l] * N->w_order[l] * sin(at) * X->slope[l] *
                     X->load[l]; /* times the speed squared */
    }
    if (O->geared)
        EACH {
            X->jm[l] = X->load[l] * X->slope[l] * X->slope[l] + N->j_extra[l];
            X->jm[l] += O->M->stiff ? O->h * N->damp[l] : 0.0;
            X->per_jm[l] = 1.0 / X->jm[l];
            X->push[l] = X->tau[l] - added - X->slope[l] * X->bias[l];
        }
    if (O->geared && N->pulled)
        EACH X->push[l] =
            X->tau[l] - added -
            X->slope[l] * (X->bias[l] + N->gravity[l] * sin(S->q[l] + X->wave[l]));
}

/* The spring between motor and load, and the load's step. */
INLINE void OF(stretch)(const OF(task) *O, OF(motion) *X)
{
    const OF(numbers) *N = O->N;
    const double h = O->h;
    OF(lane) fall, at, motor;
    EACH { fall[l] = X->bias[l]; at[l] = X->ql[l] + 0.5 * h * X->qdl[l]; }
    if (N->pulled) EACH fall[l] += N->gravity[l] * sin(at[l]);
    if (N->hung) {
        EACH { motor[l] = O->S->q[l]; O->S->q[l] = at[l]; }
        OF(hang)(O->M, N, O->S, &fall);
        EACH O->S->q[l] = motor[l];
    }
    EACH {
        double dv = (O->wavy ? X->slope[l] * X->qd[l] : X->qd[l]) - X->qdl[l],
               d = X->q[l] - X->ql[l] + (O->wavy ? X->wave[l] : 0.0), gap = N->gap[l],
               moved = h * dv;
        double e0 = OF(soft)(d, 0.5 * gap), e1 = OF(soft)(d + moved, 0.5 * gap),
               g = 0.5 * (e0 + e1); /* mean deflection */
        _Bool moves = fabs(moved) > 1e-12 * gap;
        double per = 1.0 / (moves ? moved : 1.0),
               on = moves ? (e1 - e0) * per : e0 != 0.0 ? 1.0 : 0.0; /* part of it in contact */
        on = gap > 0 ? on : 1.0;
        g = (on < 1.0) & (on > 0.0) & (gap > 0) ? 0.5 * (e1 * e1 - e0 * e0) * per : g;
        double c = N->c_spring[l] * on,
               pull = (N->k_spring[l] + N->k_cubic[l] * g * g) * g + c * dv;
        pull /= 1.0 + 0.5 * h * c * (X->per_jm[l] + X->per_jl[l]); /* damped by its mean speed */
        X->spring[l] = (gap > 0) & (pull * g < 0) ? 0.0 : pull; /* a contact pushes only */
        double vl = OF(soft)(X->qdl[l] + h * (X->spring[l] - fall[l]) * X->per_jl[l],
                             h * N->dry_load[l] * X->per_jl[l]);
        X->ql[l] += 0.5 * h * (X->qdl[l] + vl);
        X->qdl[l] = vl;
    }
}

/* The step's torques on the motor but friction and effects, at its middle. */
INLINE void OF(pushes)(const OF(task) *O, OF(motion) *X, double added)
{
    OF(state) *S = O->S;
    const OF(numbers) *N = O->N;
    EACH {
        S->u[l] = X->u[l]; S->tau[l] = X->tau[l];
        S->q[l] = X->q[l] + 0.5 * O->h * X->qd[l];
        S->qd[l] = X->qd[l];
        X->push[l] = X->tau[l] - added - (O->two_mass ? 0.0 : X->bias[l]);
        X->spring[l] = 0;
    }
    if (O->wavy) OF(gear)(O, X, added);
    if (O->two_mass) OF(stretch)(O, X);
    else if (N->pulled && !O->geared) EACH X->push[l] -= N->gravity[l] * sin(S->q[l]);
    EACH X->push[l] -= O->wavy ? X->slope[l] * X->spring[l] : X->spring[l];
}

/* What effects resist at the middle of the step, by the speed there; still: those that are the same
 * at any. */
INLINE void OF(resist)(const OF(task) *O, const OF(motion) *X, int k, const OF(lane) still[3],
                       OF(lane) *f, OF(lane) *scale)
{
    OF(lane) thick;
    EACH { (*f)[l] = still[0][l]; (*scale)[l] = still[1][l]; thick[l] = still[2][l]; }
    OF(gather)(O->M, O->N, O->S, k, 0, f, scale, &thick);
    if (O->geared) EACH (*f)[l] += X->bend[l] * O->S->qd[l] * O->S->qd[l];
}

/* Hysteresis by Bouc and Wen, |z| <= 1. whole: see raised */
INLINE void OF(remember_by)(const OF(task) *O, OF(motion) *X, OF(lane) *free, int whole)
{
    const OF(numbers) *N = O->N;
    EACH {
        double az = raised(fabs(X->zh[l]), N->bw_n[l], whole), v = O->S->qd[l];
        double zn = X->zh[l] + O->h * N->bw_a[l] *
                                   (v - 0.5 * fabs(v) * az * sgn(X->zh[l]) - 0.5 * v * az);
        zn = zn > 1 ? 1 : zn < -1 ? -1 : zn;
        (*free)[l] -= N->bw_force[l] * 0.5 * (X->zh[l] + zn);
        X->zh[l] = zn;
    }
}

INLINE void OF(remember)(const OF(task) *O, OF(motion) *X, OF(lane) *free)
{
    switch (O->N->bw_whole) {
    case 1: OF(remember_by)(O, X, free, 1); break;
    case 2: OF(remember_by)(O, X, free, 2); break;
    default: OF(remember_by)(O, X, free, 0);
    }
}

/* Dry friction that grows with the speed to its level, and sees the speed that the joint will have
 * after a lead: rub = c (v + lead a), most at the most. v: of a time within the step at which both
 * ends are exact to second order, the later the faster friction brakes beside the step. */
INLINE void OF(creep_straight)(const OF(task) *O, const OF(motion) *X, const OF(lane) *level,
                               const OF(lane) *vfree, OF(lane) *vn)
{
    EACH {
        const double most = O->h * (*level)[l] * X->per_jm[l],
                     lead = O->N->creep_lead[l] * O->per_h;
        const double c = most / O->N->creep[l], g = 1 + c * lead, below = 2 * g + c,
                     ahead = lead * below + g + c, /* over below: steps */
                     seen = X->qd[l] * below + ahead * ((*vfree)[l] - X->qd[l]),
                     rub = clip(c * seen / (below + c * ahead), most);
        (*vn)[l] = (*vfree)[l] - rub;
    }
}

/* Dry friction that grows as most tanh(v / slow), v of the same time within the step. In units of
 * slow, u + a tanh u = f: by one step of Newton's method from where tanh u is min(u / 0.818, 1) of
 * 0.532 and min(u / 1.978, 1) of the rest, which is off by 0.05 at most. Friction is then off by
 * less than 0.4 %. */
INLINE void OF(creep_round)(const OF(task) *O, const OF(motion) *X, const OF(lane) *level,
                            double h, const OF(lane) *from, const OF(lane) *vfree, OF(lane) *vn)
{
    EACH {
        const double most = h * (*level)[l] * X->per_jm[l], slow = O->N->creep[l], v = (*from)[l];
        const double per = 1.0 / slow, c = most * per, at = 1 + c, below = 2 + c,
                     part = 1 / (at * below), ahead = at * at * part, a = c * ahead,
                     seen = (v + ahead * ((*vfree)[l] - v)) * per, f = fabs(seen),
                     first = f / (1 + 0.887 * a), next = (f - 0.532 * a) / (1 + 0.2366 * a),
                     last = f - a;
        double u = first > next ? first : next;
        u = u > last ? u : last;
        const double e = exp(u < 20 ? 2 * u : 40), sum = e + 1;
        u -= ((u - f) * sum * sum + a * (e - 1) * sum) / (sum * sum + 4 * a * e);
        (*vn)[l] = v + (copysign(u * slow, seen) - v) * below * below * part;
    }
}

/* A step from a speed at which friction holds to where it creeps, or beyond a turn: friction as at
 * the step's end would be wrong for what came before. In parts, and so the way. */
INLINE void OF(creep_turning)(const OF(task) *O, const OF(motion) *X, const OF(lane) *level,
                              const OF(lane) *vfree, OF(lane) *vn, OF(lane) *way)
{
    const double part = O->h / TURN_STEPS;
    OF(lane) turns, v, aim, to, gone;
    _Bool any = 0;
    EACH {
        const double from = X->qd[l], brake = O->h * (*level)[l] * X->per_jm[l];
        turns[l] = (fabs(from) > O->N->creep[l]) & (from * ((*vfree)[l] - brake * sgn(from)) <= 0);
        v[l] = from; gone[l] = 0;
    }
    for (int l = 0; l < LANES; l++) any |= turns[l] != 0;
    for (int k = 0; any && k < TURN_STEPS; k++) {
        EACH aim[l] = v[l] + ((*vfree)[l] - X->qd[l]) / TURN_STEPS;
        OF(creep_round)(O, X, level, part, &v, &aim, &to);
        EACH { gone[l] += 0.5 * part * (v[l] + to[l]); v[l] = to[l]; }
    }
    EACH {
        (*vn)[l] = turns[l] != 0 ? v[l] : (*vn)[l];
        (*way)[l] = turns[l] != 0 ? gone[l] : (*way)[l];
    }
}

/* Bristles: z' = v - s0 |v| z / level, force s0 z + s1 z'. Exact for a level and a speed that stay
 * within the step. The force acts at the speed of its middle; the shorter the bristles' period
 * beside the step, the more at that of its end, or else they would ring for ever. */
INLINE void OF(bristle)(const OF(task) *O, OF(motion) *X, const OF(lane) *level,
                        const OF(lane) *vfree, OF(lane) *vn, OF(lane) *way)
{
    const OF(numbers) *N = O->N;
    const double h = O->h, per_h = O->per_h;
    EACH {
        const _Bool on = (N->s0[l] > 0) & ((*level)[l] > 0);
        const double s0 = N->s0[l], s1 = N->s1[l], w = h * X->per_jm[l], v = X->qd[l],
                     x = h * s0 * fabs(O->S->qd[l]) / (on ? (*level)[l] : 1.0);
        const _Bool few = x < 0.01; /* or else a difference of equals */
        const double y = few ? 1.0 : x, third = 1.0 / 3 - x * (1.0 / 12 - x / 60),
                     part = few ? 1 - 0.5 * x * (1 - x * third) : (1 - exp(-x)) / y,
                     stays = 1 - x * part,
                     bent = h * (few ? 0.5 * (1 - x * third) : (1 - part) / y),
                     of_z = part * (s0 - s1 * x * per_h), of_v = s0 * bent + s1 * part,
                     stiff = 0.25 * w * of_v * w * of_v, end = 0.5 + 0.5 * stiff / (1 + stiff);
        const double to = ((*vfree)[l] - w * (of_z * X->z[l] + (1 - end) * of_v * v)) /
                          (1 + end * w * of_v),
                     mean = (1 - end) * v + end * to;
        (*vn)[l] = on ? to : (*vn)[l];
        (*way)[l] = on ? h * mean : (*way)[l];
        X->z[l] = on ? stays * X->z[l] + h * part * mean : X->z[l];
    }
}

/* The motor's step, of which all but dry friction and its kin are known. Dry friction resists the
 * motion until the joint stands, and from then on, within the same step, what moves it again. */
INLINE void OF(slide)(const OF(task) *O, OF(motion) *X, const OF(lane) *f, const OF(lane) *scale)
{
    const double h = O->h;
    const _Bool creeps = O->hidden && O->N->creeps, /* each lane or none */
                soft = creeps || (O->hidden && O->N->bristled);
    OF(lane) free, vfree, along, level, vn, way;
    EACH free[l] = X->push[l] - (*f)[l];
    if (O->hidden && O->N->bent) OF(remember)(O, X, &free);
    EACH {
        vfree[l] = X->qd[l] + h * free[l] * X->per_jm[l];
        along[l] = copysign(O->S->qd[l], vfree[l]); /* the speed at the step's middle */
    }
    OF(dry)(O->M, O->N, O->S, &along, scale, &level);
    EACH level[l] = level[l] > 0 ? level[l] : 0.0;
    if (creeps && O->N->straight) OF(creep_straight)(O, X, &level, &vfree, &vn);
    else if (creeps) OF(creep_round)(O, X, &level, O->h, LANES_OF(qd), &vfree, &vn);
    else EACH {
        const double a = free[l] * X->per_jm[l], b = level[l] * X->per_jm[l], v = X->qd[l];
        const double to = v + h * (a - b * sgn(v)); /* where it would get without a stand */
        const _Bool turns = !soft & (v * to <= 0);
        const double stood = turns & (v != 0) ? h * v / (v - to) : 0.0, left = h - stood;
        vn[l] = turns ? left * OF(soft)(a, b) : OF(soft)(vfree[l], h * b);
        way[l] = turns ? 0.5 * (stood * v + left * vn[l]) : 0.5 * h * (v + vn[l]);
    }
    if (soft) EACH way[l] = 0.5 * h * (X->qd[l] + vn[l]);
    if (creeps && !O->N->straight) OF(creep_turning)(O, X, &level, &vfree, &vn, &way);
    if (O->hidden && O->N->bristled) OF(bristle)(O, X, &level, &vfree, &vn, &way);
    if (!O->steady) EACH way[l] += (X->qd[l] != 0) | (vn[l] != 0) ? X->early[l] * X->per_jm[l] : 0;
    if (O->N->loaded)
        EACH O->S->load[l] =
            O->two_mass ? X->spring[l]
                        : X->jm[l] * (vn[l] - X->qd[l]) * O->per_h + X->bias[l] +
                              O->N->gravity[l] * sin(O->S->q[l]);
    EACH {
        X->rub[l] = (vfree[l] - vn[l]) * X->jm[l] * O->per_h;
        X->q[l] += way[l];
        X->qd[l] = vn[l];
    }
}

/* One step of sample k, which begins tl s after the first sample. */
INLINE void OF(step)(const OF(task) *O, OF(motion) *X, int k, double tl, double added)
{
    const zk_model *M = O->M;
    const OF(numbers) *N = O->N;
    OF(state) *S = O->S;
    OF(lane) from, f, scale, still[3];
    EACH S->t[l] = M->t0 + tl + 0.5 * O->h; /* absolute, for effects */
    if (!O->steady) OF(drive)(O, X, tl, k == 0 && tl == 0);
    if (O->filtered) EACH from[l] = SIDE_Q;
    OF(pushes)(O, X, added);
    OF(gather_still)(M, N, S, k, 0, &still[0], &still[1], &still[2]);
    OF(resist)(O, X, k, still, &f, &scale);
    if (!M->stiff) {
        EACH S->qd[l] =
            X->qd[l] + 0.5 * O->h * (X->push[l] - f[l] - X->rub[l]) * X->per_jm[l];
        if (O->drives) EACH S->tau[l] = X->tau[l];
        OF(resist)(O, X, k, still, &f, &scale);
    }
    OF(slide)(O, X, &f, &scale);
    if (!O->two_mass) EACH { X->ql[l] = X->q[l]; X->qdl[l] = X->qd[l]; }
    if (O->geared && (O->side || M->beyond)) /* or else nobody looks at it */
        EACH {
            X->ql[l] += N->w_amp[l] * sin(N->w_order[l] * X->q[l] + N->w_phase[l]);
            X->qdl[l] *= X->slope[l];
        }
    if (O->filtered) /* exact for a position that moves evenly within the step */
        EACH {
            double to = SIDE_Q, lag = (to - from[l]) * O->per_h * N->filter[l];
            double flows = to - lag + (X->seen[l] - from[l] + lag) * X->fade[l];
            X->seen[l] = N->keep[l] > 0 ? X->seen[l] : flows;
        }
}
