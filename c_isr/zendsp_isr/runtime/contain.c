/* contain.c: user code starts nothing, ends and slows nobody else, and nothing that it might start
 * could reach the machine.
 *
 * A filter of system calls (seccomp) refuses new processes, new threads, other programs, signals to
 * others, and any change of scheduling, with EPERM. Where the system has no filter, what is left:
 * no process may be added for this user (RLIMIT_NPROC), a child of fork() ends at once, has none of
 * the shared memory and none of the open files after an exec, and is not real-time. What is started
 * all the same stays beneath the runner (subreaper), also in a session of its own, and ends with
 * it.
 */
#define _GNU_SOURCE
#include <asm/sockios.h>  /* FIOSETOWN */
#include <dirent.h>       /* opendir */
#include <errno.h>        /* errno */
#include <fcntl.h>        /* FD_CLOEXEC */
#include <linux/audit.h>  /* AUDIT_ARCH_… */
#include <linux/filter.h> /* sock_filter */
#include <linux/seccomp.h>
#include <poll.h>         /* poll */
#include <pthread.h>      /* pthread_atfork */
#include <signal.h>       /* kill */
#include <stddef.h>       /* offsetof */
#include <stdio.h>        /* snprintf */
#include <string.h>       /* strlen, strerror */
#include <sys/ioctl.h>    /* TIOCSTI */
#include <sys/mman.h>     /* madvise */
#include <sys/prctl.h>    /* PR_SET_NO_NEW_PRIVS */
#include <sys/resource.h> /* setrlimit */
#include <sys/syscall.h>  /* numbers of the calls */
#include <sys/wait.h>     /* waitpid */
#include <time.h>         /* nanosleep, timer_create */
#include <unistd.h>       /* syscall, _exit */

#include "runner.h"

#if defined(__x86_64__)
#define NATIVE AUDIT_ARCH_X86_64
#elif defined(__aarch64__)
#define NATIVE AUDIT_ARCH_AARCH64
#elif defined(__arm__)
#define NATIVE AUDIT_ARCH_ARM
#elif defined(__riscv)
#define NATIVE AUDIT_ARCH_RISCV64
#endif

enum { MOST_FILES = 256, LAST_FILE = 65536, X32_CALL = 0x40000000, ROUNDS = 1000 };

static int refused; /* errno of the filter, 0: it holds */

#ifdef NATIVE
#define FIELD(name)                                                                                \
    BPF_STMT(BPF_LD | BPF_W | BPF_ABS, (uint32_t)offsetof(struct seccomp_data, name))
#define DENY(error) BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ERRNO | (error))
#define ALLOW BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW)
#define DENY_CALL(number) BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, (number), 0, 1), DENY(EPERM)
/* The low word of an argument stands first or second by the byte order. */
#if __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
#define LOW_WORD 0u
#else
#define LOW_WORD 4u
#endif
#define ARGUMENT(index)                                                                            \
    BPF_STMT(BPF_LD | BPF_W | BPF_ABS,                                                             \
             (uint32_t)offsetof(struct seccomp_data, args[index]) + LOW_WORD)
/* A call whose first argument is a process: this one, or by 0 (of a signal: its group). */
#define OWN_ONLY(number, own)                                                                      \
    BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, (number), 0, 5), ARGUMENT(0),                              \
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, (own), 2, 0),                                          \
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, 0, 1, 0), DENY(EPERM), ALLOW
/* One command of a call that has many. */
#define DENY_COMMAND(number, command)                                                     \
    BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, (number), 0, 4), ARGUMENT(1),                      \
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, (command), 0, 1), DENY(EPERM), FIELD(nr)
#ifdef __NR_fcntl
#define CALL_FCNTL __NR_fcntl
#else
#define CALL_FCNTL __NR_fcntl64
#endif

/* For all threads at once, since the background runs user code too; and without the mitigation that
 * older kernels add to a filter, which slows every load after a store. 0 or errno. */
static int install(struct sock_filter *code, size_t lines) {
    const struct sock_fprog program = {.len = (unsigned short)lines, .filter = code};
    if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0)
        return errno;
    const unsigned long how = SECCOMP_FILTER_FLAG_TSYNC | SECCOMP_FILTER_FLAG_SPEC_ALLOW;
    const long other = syscall(__NR_seccomp, SECCOMP_SET_MODE_FILTER, how, &program);
    return other == 0 ? 0 : other > 0 ? EBUSY : errno;
}

static int filter_calls(void) {
    const uint32_t own = (uint32_t)getpid();
    struct sock_filter code[] = {
        FIELD(arch),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, NATIVE, 1, 0),
        DENY(EPERM),
        FIELD(nr),
#if defined(__x86_64__)
        BPF_JUMP(BPF_JMP | BPF_JGE | BPF_K, X32_CALL, 0, 1),
        DENY(EPERM),
#endif
        DENY_CALL(__NR_clone),
#ifdef __NR_clone3
        DENY_CALL(__NR_clone3),
#endif
#ifdef __NR_fork
        DENY_CALL(__NR_fork),
#endif
#ifdef __NR_vfork
        DENY_CALL(__NR_vfork),
#endif
        DENY_CALL(__NR_execve),
        DENY_CALL(__NR_execveat),
        DENY_CALL(__NR_ptrace),
        DENY_CALL(__NR_process_vm_readv),
        DENY_CALL(__NR_process_vm_writev),
        DENY_CALL(__NR_unshare),
        DENY_CALL(__NR_setns),
        DENY_CALL(__NR_setsid),
        DENY_CALL(__NR_setpgid),
        DENY_CALL(__NR_tkill),
        DENY_CALL(__NR_rt_sigqueueinfo),
        DENY_CALL(__NR_rt_tgsigqueueinfo),
#ifdef __NR_pidfd_send_signal
        DENY_CALL(__NR_pidfd_send_signal),
#endif
#ifdef __NR_pidfd_getfd
        DENY_CALL(__NR_pidfd_getfd),
#endif
#ifdef __NR_io_uring_setup
        DENY_CALL(__NR_io_uring_setup), /* what is asked for through a ring passes no filter */
#endif
        /* who owns a file is sent the signal of its choice when the file is ready */
        DENY_COMMAND(CALL_FCNTL, F_SETOWN),
        DENY_COMMAND(CALL_FCNTL, F_SETOWN_EX),
        DENY_COMMAND(__NR_ioctl, FIOSETOWN),
        DENY_COMMAND(__NR_ioctl, SIOCSPGRP),
        DENY_COMMAND(__NR_ioctl, TIOCSTI), /* typed into a shell it starts any program */
        DENY_COMMAND(__NR_ioctl, TIOCLINUX),
        OWN_ONLY(__NR_prlimit64, own), /* a process beyond its limit of CPU time is killed */
        /* a loop without its priority is late, and a target without time hears no STOP: a program
         * more urgent than the loop, that hung, kept the processor from all others. What the loop
         * may have, the monitor gives it from outside */
        DENY_CALL(__NR_sched_setscheduler),
        DENY_CALL(__NR_sched_setparam),
        DENY_CALL(__NR_sched_setattr),
        DENY_CALL(__NR_sched_setaffinity),
        DENY_CALL(__NR_setpriority),
        DENY_CALL(__NR_ioprio_set),
        OWN_ONLY(__NR_kill, own),
        OWN_ONLY(__NR_tgkill, own),
        ALLOW,
    };
    return install(code, sizeof code / sizeof code[0]);
}

#else
static int filter_calls(void) { return ENOSYS; }
#endif

/* The calling thread, and what it starts, reaches into no process outside (Landlock), not by /proc
 * either, not as root: any ruleset does that, and this one takes nothing else that a program or a
 * driver needs. */
void contain_thread(void) {
    enum { CREATE = 444, RESTRICT = 446 }; /* system calls, the same on every architecture */
    const uint64_t make_block_device = 1u << 11;
    const long rules = syscall(CREATE, &make_block_device, sizeof make_block_device, 0);
    if (rules < 0)
        return; /* an older kernel */
    prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0);
    syscall(RESTRICT, rules, 0);
    close((int)rules);
}

static void end_child(void) { _exit(127); }

static void limit(int what, rlim_t most) {
    const struct rlimit both = {.rlim_cur = most, .rlim_max = most};
    struct rlimit now;
    if (getrlimit((__rlimit_resource_t)what, &now) == 0 && now.rlim_max > most)
        setrlimit((__rlimit_resource_t)what, &both);
}

/* Bytes that count for RLIMIT_DATA, of the machine and of our own: user code is given so many more.
 */
static rlim_t used_memory(void) {
    unsigned long pages = 0;
    FILE *statm = fopen("/proc/self/statm", "re");
    if (statm) {
        if (fscanf(statm, "%*u %*u %*u %*u %*u %lu", &pages) != 1)
            pages = 0;
        fclose(statm);
    }
    return (rlim_t)pages * (rlim_t)sysconf(_SC_PAGESIZE);
}

/* Bytes of a mapping and of the page on either side of it. */
static size_t guarded(size_t bytes, size_t page) { return (bytes + 3 * page - 1) / page * page; }

/* A file in shared memory, all its pages present, between two pages that nobody may touch: what
 * runs beyond the end of a user's array meets them first. A child does not get this memory. NULL,
 * with errno set, where it cannot be mapped. */
void *contain_map(int file, size_t bytes) {
    const size_t page = (size_t)sysconf(_SC_PAGESIZE), whole = guarded(bytes, page);
    unsigned char *around =
        mmap(NULL, whole, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (around == MAP_FAILED)
        return NULL;
    void *at = mmap(around + page, bytes, PROT_READ | PROT_WRITE,
                    MAP_SHARED | MAP_POPULATE | MAP_FIXED, file, 0);
    if (at == MAP_FAILED) {
        const int why = errno;
        munmap(around, whole);
        errno = why;
        return NULL;
    }
    madvise(at, bytes, MADV_DONTFORK);
    return at;
}

void contain_unmap(void *at, size_t bytes) {
    const size_t page = (size_t)sysconf(_SC_PAGESIZE);
    munmap((unsigned char *)at - page, guarded(bytes, page));
}

/* Before the first line of user code, constructors included; the machine is open and our own
 * threads run. */
void contain_enter(control *c) {
    for (int file = 3; file < LAST_FILE; file++) {
        const int flags = fcntl(file, F_GETFD);
        if (flags >= 0)
            fcntl(file, F_SETFD, flags | FD_CLOEXEC);
        else if (file >= MOST_FILES)
            break;
    }
    pthread_atfork(NULL, NULL, end_child);
    limit(RLIMIT_NPROC, 0);
    limit(RLIMIT_RTPRIO, (rlim_t)c->priority); /* without a filter: nothing above the loop */
    limit(RLIMIT_NOFILE, MOST_FILES);
    limit(RLIMIT_DATA, used_memory() + c->memory);
    refused = filter_calls();
    c->contained = refused == 0;
    if (refused)
        prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0);
}

/* Added to the sentence on scheduling. */
void contain_say(control *c) {
    const size_t used = strlen(c->scheduling);
    char *rest = c->scheduling + used;
    if (refused == 0)
        snprintf(rest, sizeof c->scheduling - used, "; user code starts nothing");
    else
        snprintf(rest, sizeof c->scheduling - used, "; NO FILTER OF SYSTEM CALLS (seccomp: %s): %s",
                 strerror(refused),
                 geteuid() == 0 ? "user code of root could start processes"
                                : "processes are refused by their number");
}

/* One signal for each process right beneath this one; what is beneath those comes up to here.
 * Returns how many there were. */
static int end_those_right_beneath(void) {
    int found = 0;
    DIR *threads = opendir("/proc/self/task");
    for (const struct dirent *thread; threads && (thread = readdir(threads));) {
        char path[sizeof "/proc/self/task//children" + sizeof thread->d_name];
        snprintf(path, sizeof path, "/proc/self/task/%s/children", thread->d_name);
        FILE *children = thread->d_name[0] == '.' ? NULL : fopen(path, "re");
        for (int child; children && fscanf(children, "%d", &child) == 1; found++)
            kill(child, SIGKILL);
        if (children)
            fclose(children);
    }
    if (threads)
        closedir(threads);
    while (waitpid(-1, NULL, WNOHANG) > 0) {
    }
    return found;
}

/* Where no filter holds user code: what it started ends. */
void contain_end_children(void) {
    const struct timespec nap = {.tv_sec = 0, .tv_nsec = 1000000};
    for (int round = 0; refused && round < ROUNDS && end_those_right_beneath() > 0; round++)
        nanosleep(&nap, NULL);
}

/* This process is ended then, whatever its threads hang in; nothing that they do holds it up. */
void contain_end_within(int seconds) {
    struct sigevent end = {.sigev_notify = SIGEV_SIGNAL, .sigev_signo = SIGKILL};
    const struct itimerspec then = {.it_value = {.tv_sec = seconds}};
    timer_t timer;
    if (timer_create(CLOCK_MONOTONIC, &end, &timer) == 0)
        timer_settime(timer, 0, &then, NULL);
}

/* What this process is sent when the monitor ends: SIGKILL while the machine is being opened; from
 * then on the service makes it safe first, and SIGCONT is for one that was stopped. */
void contain_hear_of_end(const control *c, int signal) {
    prctl(PR_SET_PDEATHSIG, signal, 0, 0, 0);
    if (getppid() != c->monitor && signal == SIGKILL)
        _exit(1); /* it ended before the kernel was told */
}

/* A handle on another process, -1 where the kernel has none; the numbers of these two calls are the
 * same on every architecture. */
int contain_hold(int process) { return (int)syscall(434, process, 0); }

/* The monitor of a runner is gone: it makes its machine safe and ends. One that is stopped, or that
 * stops itself, goes on, and is ended when its time is over. */
void contain_end_runner(int handle, int seconds) {
    struct pollfd end = {.fd = handle, .events = POLLIN};
    const int each_ms = 100;
    for (int left = seconds * 1000; left > -seconds * 1000 && poll(&end, 1, each_ms) == 0;
         left -= each_ms)
        syscall(424, handle, left > 0 ? SIGCONT : SIGKILL, NULL, 0);
}

/* The watcher is gone: whatever is left of our process group goes with us. */
void contain_end_group(void) {
    contain_end_children();
    if (getpgrp() == getpid())
        kill(0, SIGKILL);
}
