/* loop.c: the sample, and when it happens. */
#define _GNU_SOURCE
#include <string.h> /* memcpy */

#include "runner.h"
#include "timing.h"

/* Most samples that are made good after a stall: the time of a simulated machine waits, and that of
 * hardware has passed, so that samples in one instant would be late commands from one reading. */
enum { CATCH_UP = 1000, CATCH_UP_HARDWARE = 10 };
/* Overruns in a row after which the machine's watchdog is left alone, whatever a host has set. */
enum { MOST_LATE = 100 };
static const uint64_t idle_poll_ns = 500000; /* while paused */
/* Machine time that the fast clock goes on after STOP, for the machine to come to rest. */
static const double coast_s = 1.0;

/* What goes by while the computer is asleep has passed for hardware, and a simulated machine
 * waits. */
static clockid_t clock_of(const runner *r) {
    return r->control->info.simulated ? CLOCK_MONOTONIC : CLOCK_BOOTTIME;
}

static uint64_t now(const runner *r) { return time_ns(clock_of(r)); }

/* Make this sample readable from outside, whole: readers copy a slot and check that it was not
 * rewritten meanwhile. */
static void publish(runner *r, uint64_t tick) {
    control *c = r->control;
    const uint64_t n = c->newest;
    unsigned char *place = r->data + c->snapshot_offset + n % LAYOUT_SNAPSHOTS * c->snapshot_stride;
    snapshot *slot = (snapshot *)(void *)place;
    unsigned char *values = place + sizeof *slot;
    __atomic_store_n(&slot->sequence, 2 * n + 1, __ATOMIC_RELAXED);
    __atomic_thread_fence(__ATOMIC_RELEASE);
    slot->tick = tick;
    const runner_config *config = &r->config;
    for (int i = 0; i < config->ranges_used; i++)
        memcpy(values + config->ranges[i].to, config->ranges[i].from, config->ranges[i].size);
    store64(&slot->sequence, 2 * n + 2);
    store64(&c->newest, n + 1);
    r->state.unseen = false;
}

static void fill_inputs(runner *r) {
    const control *c = r->control;
    const machine_sensors *sensors = &r->buffers.sensors;
    zendsp_io *io = &r->buffers.io;
    builtins *now = &r->buffers.now;
    const double t = (double)c->tick / c->rate_hz;
    io->tick = c->tick;
    io->t = t;
    io->din = sensors->din;
    memcpy(io->enc, sensors->enc, sizeof io->enc);
    memcpy(io->adc, sensors->adc, sizeof io->adc);
    now->tick = (double)c->tick;
    now->t = t;
    now->din = (double)sensors->din;
    for (int j = 0; j < MACHINE_JOINTS; j++)
        now->enc[j] = (double)sensors->enc[j];
    memcpy(now->adc, sensors->adc, sizeof now->adc);
}

/* The control law of this sample: the user's, or the machine's homing. */
static void compute(runner *r) {
    control *c = r->control;
    if (c->running == RUN_HOME) {
        store32(&c->within, WITHIN_MACHINE);
        const runner_config *config = &r->config;
        const int answer =
            config->machine->home
                ? config->machine->home(config->handle, &r->buffers.sensors, &r->state.held)
                : MACHINE_HOME_DONE;
        store32(&c->within, WITHIN_RUNTIME);
        safety_home(r, answer);
        return;
    }
    store32(&c->within, WITHIN_ISR);
    r->config.isr();
    store32(&c->within, WITHIN_RUNTIME);
    safety_command(r);
}

/* What a driver may not return from: then the machine is named. */
static void put_out(runner *r) {
    safety_output(r);
    store32(&r->control->within, WITHIN_MACHINE);
    r->config.machine->write(r->config.handle, &r->buffers.acting);
    store32(&r->control->within, WITHIN_RUNTIME);
    safety_acted(r);
}

static void take_in(runner *r) {
    store32(&r->control->within, WITHIN_MACHINE);
    r->config.machine->read(r->config.handle, &r->buffers.sensors);
    store32(&r->control->within, WITHIN_RUNTIME);
}

static void let_go(runner *r) {
    store32(&r->control->within, WITHIN_MACHINE);
    r->config.machine->safe(r->config.handle);
    store32(&r->control->within, WITHIN_RUNTIME);
}

/* One sample: outputs of the sample before → conversion → updates → control law → everything
 * recorded. */
static void sample(runner *r, uint64_t begin, uint64_t late) {
    control *c = r->control;
    store64(&c->heartbeat, c->heartbeat | 1u);
    safety_requests(r, false);
    put_out(r);
    take_in(r);
    if (safety_inputs(r))
        put_out(r);
    batch_apply(r, c->tick);
    stream_exchange(r);
    fill_inputs(r);
    r->state.acquired = false;
    r->buffers.now.late_us = 1e-3 * (double)late;
    compute(r);
    const uint64_t exec = now(r) - begin;
    r->buffers.now.exec_us = 1e-3 * (double)exec;
    r->buffers.now.dout = (double)r->buffers.io.dout;
    stream_sample(r);
    publish(r, c->tick);
    timing_count(&c->timing, late, exec);
}

static void step_machine(runner *r) {
    if (r->config.machine->step) {
        store32(&r->control->within, WITHIN_MACHINE);
        r->config.machine->step(r->config.handle, r->buffers.io.period);
        store32(&r->control->within, WITHIN_RUNTIME);
    }
}

/* The machine's own watchdog: nothing that hangs, ends or is late again and again comes here. */
static void keep_alive(runner *r) {
    const machine_ops *machine = r->config.machine;
    const uint32_t overruns = r->state.overruns_in_row;
    if (machine->keep_alive && overruns < (uint32_t)r->set.overrun_limit && overruns < MOST_LATE) {
        store32(&r->control->within, WITHIN_MACHINE);
        machine->keep_alive(r->config.handle);
        store32(&r->control->within, WITHIN_RUNTIME);
    }
}

static void finish_sample(runner *r) {
    control *c = r->control;
    step_machine(r);
    keep_alive(r);
    store64(&c->tick, c->tick + 1);
    store64(&c->heartbeat, (c->heartbeat | 1u) + 1u);
}

/* Hardware is read while nothing runs; nothing acts, and what was commanded before the pause shall
 * not act after it. */
static void rest(runner *r) {
    take_in(r);
    store32(&r->control->faults, r->buffers.sensors.fault);
    safety_anew(r);
    r->state.speed_known = 0;
    memset(r->buffers.now.aout, 0, sizeof r->buffers.now.aout);
    fill_inputs(r);
    r->state.unseen = true;
}

/* A simulated machine stands still in time; its panel does not. */
static void stand_still(runner *r) {
    control *c = r->control;
    if (c->newest == 0 || c->running == RUN_HOME) { /* a homing may have moved the zero */
        take_in(r);
        r->state.din = r->buffers.sensors.din;
        fill_inputs(r);
        r->state.unseen = true;
    }
    if (c->trip.reason != TRIP_NONE) /* what was held when time stood still is held no more */
        memset(r->buffers.now.aout, 0, sizeof r->buffers.now.aout);
    const uint32_t din = r->state.din | load32(&c->simulated_din);
    const double drive = (double)c->drive_mode;
    r->state.unseen |= din != r->buffers.io.din || drive != r->buffers.now.drive;
    r->buffers.io.din = r->buffers.sensors.din = din;
    r->buffers.now.din = (double)din;
}

/* Nothing runs: requests and updates are still answered; hardware is kept safe. Who waits for a
 * pause is told at the end of the first round, when all of it holds. */
static void idle(runner *r) {
    control *c = r->control;
    if (!c->info.simulated && c->running != RUN_PAUSED)
        let_go(r);
    safety_requests(r, true);
    safety_acted(r);
    batch_apply(r, c->tick);
    stream_idle(r);
    if (c->info.simulated)
        stand_still(r);
    else
        rest(r);
    safety_panel(r);
    r->buffers.now.drive = (double)c->drive_mode;
    if (r->state.unseen)
        publish(r, c->tick);
    store32(&c->running, RUN_PAUSED);
    r->state.overruns_in_row = 0;
    keep_alive(r);
    store64(&c->heartbeat, (c->heartbeat | 1u) + 1u);
    sleep_ns(idle_poll_ns);
}

/* Wait for the deadline: asleep, and awake for the last `spin` ns. Returns the time. */
static uint64_t wait_for(const runner *r, uint64_t deadline, uint64_t spin) {
    uint64_t at = now(r);
    if (at + spin < deadline) {
        sleep_until_ns(clock_of(r), deadline - spin);
        at = now(r);
    }
    while (at < deadline)
        at = now(r);
    return at;
}

/* Hardware that was without control for as long as a loop that hangs is borne does not move on by
 * itself: who watched may have gone home. The monitor ends such a loop, unless it stood still
 * too. */
static void check_stall(runner *r, uint64_t late) {
    const double stood = 1e-9 * (double)late;
    if (!r->control->info.simulated && stood > r->control->hang_s)
        safety_trip(r, TRIP_STALL, 0, stood, r->control->hang_s);
}

/* Samples are left out; the machine has moved on. Of more than a few on hardware the program
 * begins afresh, as after a pause. */
static void leave_out(runner *r, uint64_t behind) {
    control *c = r->control;
    const bool simulated = c->info.simulated;
    /* a simulated machine waits for a computer that stood still */
    for (uint64_t i = 0; i < behind && behind <= CATCH_UP; i++)
        step_machine(r);
    c->timing.missed += behind;
    stream_skip(r, behind);
    r->state.speed_known = 0; /* of equally spaced samples only */
    if (behind > (simulated ? CATCH_UP : CATCH_UP_HARDWARE) && c->running == RUN_ISR)
        safety_anew(r);
    store64(&c->tick, c->tick + behind);
}

/* Samples that the clock has left behind: by the setting, run late (count), or left out (skip). */
static uint64_t after_sample(runner *r, uint64_t deadline) {
    control *c = r->control;
    const uint64_t period = c->period_ns, next = deadline + period, at = now(r);
    if (at <= next) {
        r->state.overruns_in_row = 0;
        r->state.lag_ns = 0;
        return next;
    }
    const uint64_t lag = at - next, before = r->state.lag_ns, behind = lag / period;
    c->timing.overruns++;
    check_stall(r, lag);
    if (lag > before) { /* samples that catch up after a stall are late, no slower than others */
        /* the time of a simulated machine waits; hardware was without control meanwhile */
        const uint64_t lost = c->info.simulated ? 0 : (lag - before) / period;
        const uint64_t late = ++r->state.overruns_in_row + lost;
        if (r->set.overrun_policy == OVERRUN_TRIP && late >= (uint64_t)r->set.overrun_limit)
            safety_trip(r, TRIP_OVERRUN, 0, (double)late, (double)r->set.overrun_limit);
    }
    r->state.lag_ns = lag;
    const uint64_t most = c->info.simulated ? CATCH_UP : CATCH_UP_HARDWARE;
    if (behind == 0 || (r->set.overrun_policy != OVERRUN_SKIP && behind <= most))
        return next;
    leave_out(r, behind);
    r->state.lag_ns = lag - behind * period;
    return next + behind * period;
}

/* Fast clock with a speed limit: sleep when machine time is ahead. */
static void hold_speed(runner *r, uint64_t began, uint64_t first_tick) {
    const control *c = r->control;
    if (c->speed <= 0.0)
        return;
    const double machine_s = (double)(c->tick - first_tick) / c->rate_hz;
    const uint64_t due = began + (uint64_t)(1e9 * machine_s / c->speed);
    if (due > now(r) + 1000000u)
        sleep_until_ns(clock_of(r), due);
}

/* How long to wait awake: what is left of 0.8 of the period after the sample's own work. A FIFO
 * thread that never sleeps is stopped by the kernel for 50 ms in every second
 * (sched_rt_runtime_us). */
static uint64_t spin_beside(const runner *r, uint64_t spin) {
    const uint64_t most = r->control->period_ns - r->control->period_ns / 5;
    const uint64_t busy = r->state.busy_ns;
    return busy >= most ? 0 : spin < most - busy ? spin : most - busy;
}

static void run_real(runner *r, uint64_t *deadline, uint64_t spin) {
    const uint64_t begin = wait_for(r, *deadline, spin_beside(r, spin));
    check_stall(r, begin - *deadline);
    sample(r, begin, begin - *deadline);
    finish_sample(r);
    const uint64_t busy = now(r) - begin, before = r->state.busy_ns;
    r->state.busy_ns = busy > before ? before + (busy - before) / 8 : before - (before - busy) / 8;
    *deadline = after_sample(r, *deadline);
}

static bool coasted(const runner *r) {
    const control *c = r->control;
    return c->clock == CLOCK_FAST && c->run_until == 0 && c->trip.reason != TRIP_NONE &&
           (double)(c->tick - c->trip.tick) >= coast_s * c->rate_hz;
}

/* The life of the loop: paused, running, … until told to quit. */
void loop(runner *r) {
    control *c = r->control;
    const double most = 0.6e-3 * (double)c->period_ns; /* µs */
    const double spin_us = realtime_granted() ? (c->spin_us < most ? c->spin_us : most) : 0.0;
    const uint64_t spin = (uint64_t)(1e3 * spin_us);
    uint64_t deadline = 0, began = 0, first_tick = 0;
    if (!c->info.simulated)
        let_go(r);
    for (;;) {
        uint32_t run = load32(&c->run);
        if (run == RUN_QUIT)
            return;
        const uint64_t until = load64(&c->run_until);
        if (run != RUN_PAUSED && ((until != 0 && c->tick >= until) || coasted(r))) {
            __atomic_compare_exchange_n(&c->run, &run, RUN_PAUSED, false, __ATOMIC_ACQ_REL,
                                        __ATOMIC_ACQUIRE);
            continue;
        }
        if (run == RUN_PAUSED) {
            realtime_stay_awake(false);
            idle(r);
            deadline = 0;
            continue;
        }
        store32(&c->running, run);
        if (deadline == 0) {
            r->state.lag_ns = 0;
            realtime_stay_awake(true);
            began = now(r);
            first_tick = c->tick;
            deadline = began + c->period_ns;
            if (run == RUN_HOME) {
                safety_anew(r); /* nothing of the program's acts while homing, or of before it */
                c->homed = !c->info.needs_homing; /* its zero moves */
            }
        }
        if (c->clock == CLOCK_REAL) {
            run_real(r, &deadline, spin);
        } else {
            sample(r, now(r), 0);
            finish_sample(r);
            hold_speed(r, began, first_tick);
        }
    }
}
