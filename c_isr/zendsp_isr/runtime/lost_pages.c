/* lost_pages.c: files in shared memory that user code cut short do not end the monitor. User code
 * may open them, as any file of its user; whoever reads a page that its file no longer has is ended
 * by SIGBUS. */
#define _GNU_SOURCE
#include <signal.h>   /* sigaction */
#include <stdint.h>   /* uintptr_t */
#include <sys/mman.h> /* mmap */
#include <unistd.h>   /* sysconf */

#include "monitor.h"

static uintptr_t page_bytes;

/* The page is from now on one of zeros, which nothing that is shared is trusted not to be
 * (tests/target/test_wild_pointers.py). Where that is not the cause, or fails, what was tried is
 * tried again, and ends the process as before. */
static void put_zeros(int number, siginfo_t *why, void *context) {
    (void)context;
    void *page = (void *)((uintptr_t)why->si_addr & ~(page_bytes - 1));
    if (why->si_code != BUS_ADRERR ||
        mmap(page, page_bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED, -1,
             0) == MAP_FAILED)
        signal(number, SIG_DFL);
}

/* For all of this process: for a monitor's own, not for one that other people's code runs in. */
void monitor_outlive_lost_pages(void) {
    const struct sigaction act = {.sa_sigaction = put_zeros, .sa_flags = SA_SIGINFO};
    page_bytes = (uintptr_t)sysconf(_SC_PAGESIZE);
    sigaction(SIGBUS, &act, NULL);
}
