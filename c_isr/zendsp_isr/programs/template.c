/* template.c: the three sections of a control program. Copy it, and fill in the law. */
#include "isr.h"

static double setpoint, gain = 1.0; /* the host may write these … */
static double position, error;      /* … and watch these */
static double command;              /* mV */

/* Runs once when the program is loaded: declare what the host may see, and set it up. */
void UserInit(void) {
    PARAMETER(setpoint, 0.0, "rad", -3.0, 3.0, "where joint 1 shall be");
    PARAMETER(gain, 0.0, "mV/rad", 0.0, 1e5, "proportional gain; 0 keeps the machine still");
    SIGNAL(position, "rad", "joint 1");
    SIGNAL(error, "rad", "setpoint - position");
    SIGNAL(command, "mV", "output 0");
}

/* Runs every sample. What it writes here acts from the next sample on. */
void UserISR_INT2(void) {
    position = READ_POSITION(0);
    error = setpoint - position;
    command = gain * error;
    IOGP_FU1_WRITE_AOUT_ENGU(0) = command;
    Acquire();
}

/* Runs again and again beneath the loop, which interrupts it at any point. Slow work goes here. */
void UserBackground(void) {}
