/* torque_steps.c: static friction. A torque that grows by small steps until the joint breaks away;
 * the other joints get none.
 *
 * Set `joint`, `direction`, then change `go`. When `moved` turns true, `breakaway` is the torque of
 * the last step, and the torque is taken away. Works on any machine without gravity on that joint.
 */
#include "isr.h"

static int32_t joint, direction, go;
static double increment, hold, threshold, maximum, first;

static double position, torque, breakaway, start;
static bool moved, running;

static double since; /* s, begin of this step */
static int32_t gone; /* the `go` that is being executed */

void UserInit(void) {
    PARAMETER(joint, 1, "", 1, 8, "joint that is pushed, from 1");
    PARAMETER(direction, 1, "", -1, 1, "1 counterclockwise, -1 clockwise");
    PARAMETER(first, 0.0, "N m", 0.0, 1000.0, "torque of the first step");
    PARAMETER(increment, 0.1, "N m", 1e-6, 100.0, "height of a step");
    PARAMETER(hold, 0.1, "s", 0.001, 10.0, "length of a step");
    PARAMETER(threshold, 0.01, "rad", 1e-6, 1.0, "motion that counts as having broken away");
    PARAMETER(maximum, 50.0, "N m", 0.0, 1000.0, "give up at this torque");
    PARAMETER(go, 0, "", 0, 2147483647, "any change begins a staircase");
    SIGNAL(position, "rad", "position of the joint");
    SIGNAL(torque, "N m", "torque on the joint");
    SIGNAL(start, "rad", "where this staircase began");
    SIGNAL(breakaway, "N m", "torque at which it moved; 0 while it has not");
    SIGNAL(moved, "", "it has broken away");
    SIGNAL(running, "", "a staircase is under way");
}

static void begin(void) {
    gone = go;
    running = true;
    moved = false;
    breakaway = 0.0;
    start = position;
    since = SAMPLE_TIME;
    torque = direction < 0 ? -first : first;
}

void UserISR_INT2(void) {
    position = READ_POSITION(joint - 1);
    if (!DRIVE_ENABLED)
        running = false; /* a staircase that was cut short does not go on by itself */
    else if (gone != go)
        begin();
    if (running && fabs(position - start) > threshold) {
        moved = true;
        breakaway = torque;
        running = false;
    } else if (running && SAMPLE_TIME - since >= hold - 1e-9) {
        since += hold;
        torque += direction < 0 ? -increment : increment;
        running = fabs(torque) <= maximum;
    }
    if (!running)
        torque = 0.0;
    for (int32_t j = 0; j < JOINTS; j++)
        WRITE_TORQUE(j, 0.0);
    WRITE_TORQUE(joint - 1, torque);
}

void UserBackground(void) {}
