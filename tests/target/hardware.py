"""A driver of one joint in C, with what a test needs of it."""

from __future__ import annotations

_DRIVER = """
#include <stdio.h>
#include <time.h>
#include <unistd.h>
#include "machine.h"
#include "machine_config.h"
%(before)s
static int open_it(void **h, const char *config, double period, machine_info *info, char *error,
                   size_t size) {
    (void)h; (void)config; (void)period; (void)error; (void)size;
    info->joints = 1; info->stop_input = -1;
    info->joint[0] = (machine_joint){.counts_per_unit = 1000.0, .mv_per_torque = 1.0,
        .mv_per_speed = 1.0, .command_max = 1e4, .position_min = -100.0, .position_max = 100.0,
        .speed_max = 1e3, .torque_max = 1e3};
    %(opened)s
    return 0;
}
static void read_it(void *h, machine_sensors *s) { (void)h; %(read)s }
static void write_it(void *h, const machine_actuators *a) { (void)h; (void)a; %(write)s }
static void safe(void *h) { (void)h; %(safe)s }
const machine_ops zendsp_machine = {.abi = MACHINE_ABI, .open = open_it, .read = read_it,
    .write = write_it, .safe = safe};
"""


def driver(
    safe: str, *, before: str = "", opened: str = "", read: str = "s->enc[0] = 5;", write: str = ""
) -> str:
    """C source of a driver: statements of each of its functions, and what stands before them."""
    parts = {"before": before, "opened": opened, "read": read, "write": write, "safe": safe}
    return _DRIVER % parts
