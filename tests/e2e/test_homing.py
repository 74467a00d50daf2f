"""A machine that has to be homed, and one whose home switch is never found."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

import zendsp
from zendsp.errors import Refused

CODE = {
    "p.c": '#include "isr.h"\nvoid UserInit(void) {}\nvoid UserISR_INT2(void) {}\n'
    "void UserBackground(void) {}\n"
}
MACHINE = """
#include <stdlib.h>
#include <string.h>
#include "machine.h"
static int lost; /* the home switch is */
static long samples;
static int open_(void **h, const char *config, double dt, machine_info *i, char *e, size_t n) {
    (void)dt, (void)e, (void)n;
    *h = &samples;
    lost = strstr(config, "lost") != NULL;
    strcpy(i->name, "axis");
    i->simulated = i->joints = i->needs_homing = 1;
    i->stop_input = -1;
    machine_joint *j = &i->joint[0];
    strcpy(j->name, "joint 1"), strcpy(j->unit, "rad"), strcpy(j->command, "torque");
    j->counts_per_unit = j->mv_per_torque = j->mv_per_speed = 1000.0;
    j->command_max = 10000.0, j->position_max = 1.0, j->position_min = -1.0;
    j->speed_max = j->torque_max = 10.0;
    return 0;
}
static void read_(void *h, machine_sensors *s) { (void)h, s->enc[0] = 0; }
static void write_(void *h, const machine_actuators *u) { (void)h, (void)u; }
static void step(void *h, double dt) { (void)h, (void)dt, samples++; }
static void safe(void *h) { (void)h; }
static int home(void *h, const machine_sensors *s, machine_actuators *u) {
    (void)h, (void)s, u->mode = MACHINE_VELOCITY, u->aout[0] = 10.0;
    return lost || samples < 100 ? MACHINE_HOME_BUSY : MACHINE_HOME_DONE;
}
const machine_ops zendsp_machine = {.abi = MACHINE_ABI, .open = open_, .read = read_,
    .write = write_, .step = step, .safe = safe, .home = home};
"""


@pytest.fixture
def machine(tmp_path: Path) -> str:
    file = tmp_path / "axis.c"
    file.write_text(MACHINE)
    return str(file)


def test_nothing_starts_before_the_position_is_known(machine: str) -> None:
    with zendsp.local(machine) as target:
        target.download(CODE)
        with pytest.raises(Refused, match="starting is refused: homed: the position is unknown"):
            target.start()
        assert target.status().state == "loaded"
        target.power_on()
        assert target.home_and_wait() == "homed"
        target.enable()
        target.start()
        assert target.status().drive == "running"


def test_homing_without_end_ends_with_the_time_it_was_given_or_with_a_pause(machine: str) -> None:
    with zendsp.local(machine, options=["--machine-option", "lost=1"]) as target:
        target.download(CODE)
        with pytest.raises(Refused, match=r"not done after 0\.5 s and is ended"):
            target.home_and_wait(0.5)
        assert target.status().state != "running" and not target.status().homed
        pause = threading.Timer(0.5, target.pause)
        pause.start()
        with pytest.raises(Refused, match="homing ended: by a pause, or another load"):
            target.home_and_wait()
        pause.join()
