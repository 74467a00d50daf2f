/* safety.c: below the user's code, every sample: drive modes, STOP, limits, soft start and stop. */
#include <math.h> /* fabs, isfinite */
#include <string.h> /* memcpy, memset */

#include "runner.h"

static double position_of(const runner *r, int j) {
    const machine_joint *joint = &r->control->info.joint[j];
    return ((double)r->buffers.sensors.enc[j] - joint->zero_counts) / joint->counts_per_unit;
}

static bool latched(const runner *r) { return r->control->trip.reason != TRIP_NONE; }

/* Latch the first trip; later ones change nothing until it is acknowledged. */
void safety_trip(runner *r, uint32_t reason, int joint, double value, double limit) {
    control *c = r->control;
    const bool asked = reason == TRIP_STOP || reason == TRIP_HOST_LOST;
    if (!latched(r) || asked) /* what breaks a limit does so every sample */
        store32(&r->page->trips, r->page->trips + 1);
    if (latched(r))
        return;
    c->trip.joint = joint;
    c->trip.tick = c->tick;
    c->trip.shown = c->newest + 1;
    r->state.unseen = true;
    c->trip.value = value;
    c->trip.limit = limit;
    c->trip.idle = (reason == TRIP_POSITION || reason == TRIP_SPEED) && c->running == RUN_ISR &&
                   r->buffers.now.cmd[joint - 1] == 0.0;
    memset(c->trip.by, 0, sizeof c->trip.by);
    if (reason == TRIP_STOP)
        memcpy(c->trip.by, r->page->by, sizeof r->page->by - 1);
    store32(&c->trip.acted, 0);
    store32(&c->trip.reason, reason);
    c->gain = 0.0;
}

/* Limits from the machine; speeds unknown until positions have been seen. */
void safety_reset(runner *r) {
    const machine_info *info = &r->control->info;
    for (int j = 0; j < MACHINE_JOINTS; j++) {
        r->set.position_min[j] = r->state.lowest[j] = info->joint[j].position_min;
        r->set.position_max[j] = r->state.highest[j] = info->joint[j].position_max;
        r->state.least_seen[j] = r->set.position_min[j];
        r->state.most_seen[j] = r->set.position_max[j];
        r->set.speed_max[j] = info->joint[j].speed_max;
        r->set.torque_max[j] = info->joint[j].torque_max;
        r->set.command_max[j] = info->joint[j].command_max;
    }
    r->set.stop_input = info->stop_input;
    r->set.stop_level = info->stop_level;
    r->set.overrun_limit = 10;
    /* a speed that is far too large is seen over 10 ms, one that is a little over the whole ring */
    const double samples = 0.01 * r->control->rate_hz;
    const double most = SPEED_WINDOW - 1;
    r->config.speed_window = (uint32_t)(samples < 1.0 ? 1.0 : samples > most ? most : samples);
    r->state.speed_known = 0;
    r->control->homed = !info->needs_homing;
    r->state.held.mode = MACHINE_OFF;
    r->buffers.io.first = 1; /* of a program that has just been loaded */
}

/* A joint outside its limits, since it was stopped there or they were moved, may be brought back:
 * until it is inside, it may not go further out. Room for the soft start is given once: a program
 * that goes on outward would have it at each acknowledgement anew. */
static void widen(runner *r, int j) {
    const double margin = 0.02, noise = 1e-3; /* rad: room for the soft start, for the encoder */
    runner_state *s = &r->state;
    const double q = position_of(r, j);
    const double least = r->set.position_min[j], most = r->set.position_max[j];
    const bool below = s->lowest[j] < least && least == s->least_seen[j];
    const bool above = s->highest[j] > most && most == s->most_seen[j];
    const double low = q - (below ? noise : margin), high = q + (above ? noise : margin);
    s->lowest[j] = q >= least ? least : below && s->lowest[j] < low ? s->lowest[j] : low;
    s->highest[j] = q <= most ? most : above && s->highest[j] > high ? s->highest[j] : high;
    s->least_seen[j] = least;
    s->most_seen[j] = most;
}

/* What the program remembers no longer holds: it begins afresh, and its outputs are taken only
 * after the run-in. */
void safety_anew(runner *r) {
    r->state.anew = true;
    r->state.held.mode = MACHINE_OFF;
    r->control->drive_mode = MACHINE_OFF;
    r->control->gain = 0.0;
}

/* Requests of the monitor, at the start of a sample and while paused. */
void safety_requests(runner *r, bool paused) {
    control *c = r->control;
    const uint32_t acknowledge = load32(&c->acknowledge);
    if (acknowledge != c->acknowledged) {
        if (c->acknowledge_trip == r->page->trips) { /* else nobody has seen the latest */
            store32(&c->trip.reason, TRIP_NONE);
            r->state.overruns_in_row = 0;
            safety_anew(r); /* what was computed before the trip shall not act */
            for (int j = 0; j < c->info.joints; j++)
                widen(r, j);
        }
        store32(&c->acknowledged, acknowledge);
    }
    const uint32_t off = load32(&c->off);
    if (off != r->state.off_seen && paused)
        safety_anew(r); /* while it runs, the program sees for itself that the drives go off */
    r->state.off_seen = off;
    /* after the acknowledgement: a STOP pressed meanwhile wins. Latched before the request is
     * cleared: whoever looks, and whatever ends this process, finds one or the other. */
    const uint32_t stop = load32(&c->stop);
    if (stop != TRIP_NONE) {
        safety_trip(r, stop, 0, 0.0, 0.0);
        store32(&c->stop, TRIP_NONE);
    }
    if (load32(&r->page->stop) != 0) {
        safety_trip(r, TRIP_STOP, 0, 0.0, 0.0);
        store32(&r->page->stop, 0);
        r->state.asked = true;
    }
}

/* The machine has the outputs of this sample, or was made safe while paused: a trip is told from
 * here on, and not by a loop that hangs in the machine's write. */
void safety_acted(runner *r) {
    control *c = r->control;
    if (!latched(r))
        return;
    store32(&c->trip.acted, 1);
    if (r->state.asked) {
        r->state.asked = false;
        store64(&r->page->sample, c->trip.tick);
        store32(&r->page->reason, c->trip.reason);
        store64(&r->page->taken, r->page->taken + 1);
    }
}

/* Soft start and stop: the gain moves towards what is wanted of the drives. */
static void move_gain(runner *r) {
    control *c = r->control;
    /* while homing, the machine's own routine chooses the mode */
    const int32_t wanted = c->running != RUN_HOME ? __atomic_load_n(&c->drive, __ATOMIC_ACQUIRE)
                           : r->state.held.mode != MACHINE_OFF ? r->state.held.mode
                                                               : MACHINE_VELOCITY;
    const double step = r->set.ramp > 0.0 ? 1.0 / (r->set.ramp * c->rate_hz) : 1.0;
    const bool same = wanted == c->drive_mode || c->drive_mode == MACHINE_OFF;
    if (wanted != MACHINE_OFF && same) {
        c->drive_mode = wanted;
        c->gain = c->gain + step < 1.0 ? c->gain + step : 1.0;
    } else {
        c->gain = c->gain - step > 0.0 ? c->gain - step : 0.0;
        if (c->gain <= 0.0)
            c->drive_mode = wanted; /* off, or the other mode, from zero */
    }
}

/* The first samples of a program that begins afresh: it runs with the drives off. */
static bool running_in(runner *r) {
    if (r->control->running != RUN_ISR)
        return false;
    if (r->state.anew) {
        r->state.run_in = 1;
        r->state.anew = false;
        r->buffers.io.first = 1;
        r->state.speed_known = 0; /* homing may have moved the zero of the encoders */
    }
    return r->state.run_in > 0;
}

/* What acts from this sample on: the held command, or the safe state. */
void safety_output(runner *r) {
    control *c = r->control;
    if (latched(r)) {
        c->drive_mode = MACHINE_VELOCITY;
        c->gain = 0.0;
    } else if (running_in(r)) {
        c->drive_mode = MACHINE_OFF;
        c->gain = 0.0;
    } else {
        move_gain(r);
    }
    r->buffers.acting.mode = c->drive_mode;
    r->buffers.acting.dout = r->state.held.dout;
    const bool live =
        !latched(r) && c->drive_mode != MACHINE_OFF && r->state.held.mode == c->drive_mode;
    for (int j = 0; j < MACHINE_JOINTS; j++) {
        r->buffers.acting.aout[j] = live ? c->gain * r->state.held.aout[j] : 0.0;
        r->buffers.now.aout[j] = r->buffers.acting.aout[j];
    }
    r->buffers.now.drive = (double)c->drive_mode;
    r->buffers.io.enabled = live || (!latched(r) && c->drive_mode != MACHINE_OFF);
}

/* Compare a joint's speed with its limit, over the mean of so many samples. Of what it has moved
 * only that counts which the sensor surely shows. */
static void check_speed(runner *r, int j, uint32_t window) {
    const runner_state *s = &r->state;
    const control *c = r->control;
    if (s->speed_known < window)
        return;
    const uint32_t oldest = (s->speed_place + SPEED_WINDOW - window) % SPEED_WINDOW;
    const int64_t moved =
        (int64_t)r->buffers.sensors.enc[j] - r->buffers.counts_before[oldest][j];
    const double per_count =
        c->rate_hz / (double)window / fabs(c->info.joint[j].counts_per_unit);
    if ((fabs((double)moved) - SPEED_COUNTS) * per_count > r->set.speed_max[j])
        safety_trip(r, TRIP_SPEED, j + 1,
                    (double)moved * c->rate_hz / (double)window / c->info.joint[j].counts_per_unit,
                    r->set.speed_max[j]);
}

static void check_motion(runner *r) {
    const control *c = r->control;
    const machine_sensors *sensors = &r->buffers.sensors;
    runner_state *s = &r->state;
    for (int j = 0; j < c->info.joints; j++) {
        const double q = position_of(r, j), least = r->set.position_min[j];
        const double most = r->set.position_max[j];
        if ((q >= least && q <= most) || least != s->least_seen[j] || most != s->most_seen[j])
            widen(r, j);
        if (c->drive_mode == MACHINE_OFF)
            continue;
        if (c->homed && c->running != RUN_HOME && (q < s->lowest[j] || q > s->highest[j]))
            safety_trip(r, TRIP_POSITION, j + 1, q,
                        q < s->lowest[j] ? s->lowest[j] : s->highest[j]);
        check_speed(r, j, r->config.speed_window);
        check_speed(r, j, SPEED_WINDOW - 1); /* so few counts are little of that */
        if (sensors->fault >> j & 1u)
            safety_trip(r, TRIP_SENSOR, j + 1, 0.0, 0.0);
    }
    for (int j = 0; j < c->info.joints; j++)
        r->buffers.counts_before[s->speed_place][j] = sensors->enc[j];
    s->speed_place = (s->speed_place + 1) % SPEED_WINDOW;
    if (s->speed_known < SPEED_WINDOW - 1)
        s->speed_known++;
}

/* Whether the machine's STOP input is active in what was read last. */
void safety_panel(runner *r) {
    const int32_t input = r->set.stop_input;
    const uint32_t din = r->buffers.sensors.din;
    store32(&r->control->pressed, input >= 0 && input < 32 &&
                                      (int32_t)(din >> input & 1u) == r->set.stop_level);
}

/* Check what was just read: STOP input, sensor faults, limits of position and speed. Returns true
 * when this very sample tripped: the outputs must be written again, safe. */
bool safety_inputs(runner *r) {
    control *c = r->control;
    const bool before = latched(r);
    r->state.din = r->buffers.sensors.din;
    if (c->info.simulated)
        r->buffers.sensors.din |= load32(&c->simulated_din);
    safety_panel(r);
    if (c->pressed)
        safety_trip(r, TRIP_STOP_INPUT, 0, (double)r->set.stop_level, 0.0);
    check_motion(r);
    return latched(r) && !before;
}

static double within_torque(runner *r, int j, double mv, double scale) {
    const double tau = mv / scale, limit = r->set.torque_max[j];
    /* rounding of N m → mV → N m must not trip a command at its limit */
    if (fabs(tau) <= limit * (1.0 + 1e-9))
        return mv;
    if (r->set.torque_clamp)
        return tau > 0.0 ? limit * scale : -limit * scale;
    safety_trip(r, TRIP_TORQUE, j + 1, tau, limit);
    return 0.0;
}

/* One output of the user's code: what may be held for the next sample. */
static double checked(runner *r, int j, double mv) {
    const machine_joint *joint = &r->control->info.joint[j];
    const double limit = r->set.command_max[j];
    if (!isfinite(mv)) {
        safety_trip(r, TRIP_NAN, j + 1, mv, 0.0);
        return 0.0;
    }
    if (joint->mv_per_torque == 0.0 && fabs(mv) > 1e-12 * NO_TORQUE_MV) {
        safety_trip(r, TRIP_TORQUE, j + 1, mv / NO_TORQUE_MV, 0.0);
        return 0.0;
    }
    if (r->control->drive_mode == MACHINE_TORQUE && joint->mv_per_torque != 0.0)
        mv = within_torque(r, j, mv, joint->mv_per_torque);
    if (r->control->drive_mode == MACHINE_VELOCITY && joint->mv_per_speed != 0.0 &&
        fabs(mv / joint->mv_per_speed) > r->set.speed_max[j] * (1.0 + 1e-9))
        safety_trip(r, TRIP_SPEED, j + 1, mv / joint->mv_per_speed, r->set.speed_max[j]);
    if (limit > 0.0 && fabs(mv) > limit * (1.0 + 1e-9)) {
        if (!r->set.torque_clamp)
            safety_trip(r, TRIP_COMMAND, j + 1, mv, limit);
        mv = mv > 0.0 ? limit : -limit;
    }
    return mv;
}

/* Check the command of this sample (NaN, limits of torque and command) and hold it for the next.
 * With the drives off or tripped, nothing is held. */
void safety_command(runner *r) {
    control *c = r->control;
    const bool enabled = !latched(r) && c->drive_mode != MACHINE_OFF;
    r->state.held.mode = c->drive_mode;
    r->state.held.dout = r->buffers.io.dout;
    for (int j = 0; j < c->info.joints; j++) {
        r->buffers.now.cmd[j] = r->buffers.io.aout[j];
        r->state.held.aout[j] = enabled ? checked(r, j, r->buffers.io.aout[j]) : 0.0;
    }
    for (int j = c->info.joints; j < MACHINE_JOINTS && enabled; j++)
        if (!(r->buffers.io.aout[j] == 0.0)) /* NaN as well */
            safety_trip(r, TRIP_COMMAND, j + 1, r->buffers.io.aout[j], 0.0);
    const int32_t outside = r->buffers.io.outside;
    if (outside != 0) {
        safety_trip(r, TRIP_OUTSIDE, 0, outside > 0 ? outside - 1 : outside, c->info.joints);
        r->buffers.io.outside = 0;
    }
    r->buffers.io.first = 0;
    if (r->state.run_in > 0)
        r->state.run_in--;
}

/* The machine's homing routine has filled `held`; see what it says. */
void safety_home(runner *r, int answer) {
    control *c = r->control;
    for (int j = 0; j < c->info.joints; j++)
        r->state.held.aout[j] = latched(r) ? 0.0 : checked(r, j, r->state.held.aout[j]);
    if (answer == MACHINE_HOME_FAILED)
        safety_trip(r, TRIP_HOMING, 0, 0.0, 0.0);
    if (answer == MACHINE_HOME_BUSY && !latched(r))
        return; /* cut short by a pause or a STOP: idle() and the acknowledgement see to it */
    if (answer == MACHINE_HOME_DONE && !latched(r)) {
        c->homed = 1;
        store32(&c->homings, c->homings + 1);
    }
    r->state.speed_known = 0;
    safety_anew(r);
    uint32_t home = RUN_HOME;
    __atomic_compare_exchange_n(&c->run, &home, RUN_PAUSED, false, __ATOMIC_ACQ_REL,
                                __ATOMIC_ACQUIRE);
}
