/* machine.h: the contract between the runtime and a machine (simulated plant or real hardware).
 *
 * A machine is one shared object compiled from C. It exports one constant,
 *
 *     const machine_ops zendsp_machine = { .abi = MACHINE_ABI, .open = …, .read = …, … };
 *
 * and the runtime calls it from the real-time thread, once a sample and in this order:
 *
 *     write(command computed in the sample before) → read(sensors) → user code
 *         → step(dt) if simulated
 *
 * so that a command acts one sample after it was computed, and is held for one sample. `read`,
 * `write`, `step` and `home` may not block, allocate, lock or print. See docs/machines.md. This
 * file is also read by Python (cffi): plain declarations only.
 */
#ifndef ZENDSP_MACHINE_H
#define ZENDSP_MACHINE_H

#include <stddef.h> /* size_t */
#include <stdint.h> /* fixed-width integers */

enum {
    MACHINE_ABI = 3,    /* raised when anything below changes */
    MACHINE_JOINTS = 8, /* most joints a machine may have */
    MACHINE_ADCS = 8,   /* most analog inputs */
    MACHINE_NAME = 32,  /* bytes of a name, with its final zero */
    MACHINE_UNIT = 16,
    MACHINE_TEXT = 256
};

/* What the drives do with the analog command. */
enum {
    MACHINE_OFF = 0,    /* power stage off: no torque (brakes, where the machine has them) */
    MACHINE_TORQUE = 1, /* aout is a torque (or voltage) command */
    MACHINE_VELOCITY = 2 /* aout is a reference for the drive's own speed loop; 0: stand still */
};

/* What home() answers. */
enum { MACHINE_HOME_BUSY = 0, MACHINE_HOME_DONE = 1, MACHINE_HOME_FAILED = -1 };

/* One joint: names, scales, limits. Positions in `unit` (rad or m), torques in N m (or N). */
typedef struct machine_joint {
    char name[MACHINE_NAME];
    char unit[MACHINE_UNIT];    /* "rad" or "m" */
    /* what aout means in torque mode: "torque", "force" or "voltage"; "none" without a motor */
    char command[MACHINE_UNIT];
    /* encoder counts per rad (or m); negative where the encoder counts backwards */
    double counts_per_unit;
    double zero_counts;         /* encoder reading at position zero, counts */
    /* mV per N m in torque mode; 0 where the command is a voltage, or there is none */
    double mv_per_torque;
    double mv_per_speed;        /* mV per rad/s in velocity mode */
    double command_max;         /* largest |aout|, mV */
    double position_min;        /* rad */
    double position_max;        /* rad */
    double speed_max;           /* rad/s */
    double torque_max;          /* N m */
    double home;                /* position where homing ends, rad */
    double length;              /* link length, m; 0 where it has no meaning */
    /* kg m^2 (or kg) that the joint turns while the others stand, roughly: gains are begun from
     * it; 0: unknown */
    double inertia;
} machine_joint;

/* What a machine says of itself; open() fills it in. */
typedef struct machine_info {
    char name[MACHINE_NAME];
    char text[MACHINE_TEXT]; /* one sentence for people */
    int32_t simulated;       /* 1: step() exists, time is ours, clock may be "fast"; 0: hardware */
    int32_t joints;          /* 1 … MACHINE_JOINTS */
    int32_t adcs;            /* 0 … MACHINE_ADCS */
    int32_t dins;            /* digital inputs, 0 … 32 */
    int32_t douts;           /* digital outputs, 0 … 32 */
    int32_t stop_input;      /* digital input that is the emergency stop, -1: none */
    int32_t stop_level;      /* level of that input which means STOP, 0 or 1 */
    int32_t needs_homing;    /* 1: positions mean nothing before home() said DONE */
    machine_joint joint[MACHINE_JOINTS];
    char adc_name[MACHINE_ADCS][MACHINE_NAME];
    char adc_unit[MACHINE_ADCS][MACHINE_UNIT];
} machine_info;

/* One conversion of all inputs. */
typedef struct machine_sensors {
    int32_t enc[MACHINE_JOINTS]; /* encoders, counts */
    uint32_t din;                /* digital inputs, bit 0 first */
    /* bit j: the sensor of joint j is not to be trusted (trips the drives) */
    uint32_t fault;
    uint32_t reserved;
    double adc[MACHINE_ADCS]; /* analog inputs, in adc_unit */
} machine_sensors;

/* One update of all outputs. */
typedef struct machine_actuators {
    int32_t mode;                /* MACHINE_OFF | MACHINE_TORQUE | MACHINE_VELOCITY */
    uint32_t dout;               /* digital outputs, bit 0 first */
    double aout[MACHINE_JOINTS]; /* analog outputs, mV */
} machine_actuators;

/* The machine itself. Entries marked (may be NULL) are optional. */
typedef struct machine_ops {
    uint32_t abi; /* MACHINE_ABI */

    /* Make the machine ready to be read. `config`: lines "key = value" (plain text, "" if none),
     * among them what only the target may know ("concealed = seed:17" or a file). `period`: s. Sets
     * *handle and *info; returns 0, or -1 with a sentence in `error`. */
    int (*open)(void **handle, const char *config, double period, machine_info *info, char *error,
                size_t error_size);

    void (*read)(void *handle, machine_sensors *sensors);
    void (*write)(void *handle, const machine_actuators *actuators);

    /* Simulated machines: let `dt` seconds pass with the actuators held. NULL marks hardware. */
    void (*step)(void *handle, double dt);

    /* Outputs to the state in which nothing can be harmed. Also called in a fresh process, after
     * open(), when user code has crashed. */
    void (*safe)(void *handle);

    /* Homing (may be NULL: positions are absolute). Called once a sample in place of user code
     * until it no longer says BUSY; fills in the outputs of the next sample. */
    int (*home)(void *handle, const machine_sensors *sensors, machine_actuators *actuators);

    void (*close)(void *handle); /* (may be NULL) */

    /* Hardware watchdog (may be NULL): tell it that all is well. Called from the real-time thread
     * at the end of each sample that is healthy, after write() and user code, and about every 0.5
     * ms while paused; never from elsewhere, not while a program is loaded either: a watchdog
     * begins to count with the first call. Not called once samples overran as often in a row as
     * `overrun.limit` says (100 at most), until one is in time again. A register write: it may not
     * block. */
    void (*keep_alive)(void *handle);
} machine_ops;

#endif
