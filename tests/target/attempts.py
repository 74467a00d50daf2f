"""A program that tries what user code may not do, and publishes the answer."""

from __future__ import annotations

PROGRAM = """
#define _GNU_SOURCE
#include "isr.h"
#include <asm/sockios.h>
#include <asm/ioctls.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <spawn.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>
extern char **environ;
static double answer = -1.0, refused;
static char *const sleeper[] = {"sleep", "%(mark)s", NULL};
static int started(void) { execvp("sleep", sleeper); _exit(0); }
static inline long attempt(void) { %(how)s }
%(constructor)s
void UserInit(void) {
    SIGNAL(answer, "", ""); SIGNAL(refused, "", "");
    (void)started; (void)sleeper; (void)attempt;
    %(init)s
}
void UserISR_INT2(void) {
    %(isr)s
}
"""
TRY = "{ errno = 0; answer = (double)attempt(); refused = errno; }"


def attempting(how: str, mark: str, where: str) -> str:
    parts = {"constructor": "", "init": "", "isr": ""}
    parts[where] = (
        TRY if where != "constructor" else f"__attribute__((constructor)) static void c(void) {TRY}"
    )
    return PROGRAM % {"how": how % {"mark": mark}, "mark": mark, **parts}
