/* main.c: the runner process: map the shared memory, load machine and program, run UserInit, enter
 * the loop.
 *
 *     runner CONTROL          run
 *     runner --safe CONTROL   wait for a byte, then put the machine into its safe state, and end
 *     runner --look CONTROL   open the machine, leave what it says of itself in CONTROL, and end
 */
#define _GNU_SOURCE
#include <dlfcn.h>    /* dlopen */
#include <errno.h>    /* errno */
#include <fcntl.h>    /* open */
#include <link.h>     /* dl_iterate_phdr */
#include <signal.h>   /* sigaction */
#include <stdio.h>    /* snprintf */
#include <string.h>   /* strcmp, strerror */
#include <sys/stat.h> /* fstat */
#include <ucontext.h> /* where a crash happened */
#include <unistd.h>   /* close, _exit */

#include "runner.h"

enum { STACK_PROBE = 4096 }; /* a page: the compiler's probes are no further apart */

runner the_runner;
_Thread_local int32_t this_thread_is;
_Thread_local uint64_t this_stack_begins;

static void *map_file(const char *path, size_t size) {
    struct stat status;
    const int file = open(path, O_RDWR | O_CLOEXEC);
    if (file < 0 || fstat(file, &status) != 0 || (size_t)status.st_size < size) {
        fprintf(stderr, "runner: %s: %s\n", path, file < 0 ? strerror(errno) : "too short");
        return NULL;
    }
    void *at = contain_map(file, size);
    close(file);
    return at;
}

static control *map_control(const char *path) {
    control *c = map_file(path, sizeof *c);
    if (!c || c->magic != LAYOUT_MAGIC || c->version != LAYOUT_VERSION || c->bytes != sizeof *c) {
        fprintf(stderr, "runner: %s: made by another version of zendsp\n", path);
        return NULL;
    }
    return c;
}

static int fail(control *c, const char *what, const char *why) {
    if (c->error[0] == 0)
        snprintf(c->error, sizeof c->error, "%s%s%s", what, why && why[0] ? ": " : "",
                 why ? why : "");
    store32(&c->phase, PHASE_FAILED);
    return 1;
}

/* A setting that the machine has not asked for, copied into `key`; NULL where there is none. What
 * every machine is given does not count. */
static const char *unknown_setting(const char *config, const char *asked, char *key, size_t size) {
    static const char given[] = "\nload\nmodel\nclock\nideal\nfriction\n";
    char line[LAYOUT_NAME + 3];
    for (const char *at = config; asked && asked[0] && *at; at += strcspn(at, "\n") + 1) {
        snprintf(key, size, "%.*s", (int)strcspn(at, " ="), at);
        snprintf(line, sizeof line, "\n%.63s\n", key);
        if (!strstr(asked, line) && !strstr(given, line) && strncmp(key, "effect", 6) != 0)
            return key;
    }
    return NULL;
}

static int open_machine(runner *r) {
    control *c = r->control;
    char why[LAYOUT_PATH] = "";
    void *library = dlopen(c->machine_path, RTLD_NOW | RTLD_LOCAL);
    if (!library)
        return fail(c, "machine", dlerror());
    const machine_ops *machine = dlsym(library, "zendsp_machine");
    r->config.machine = machine;
    if (!machine)
        return fail(c, "machine", "exports no 'zendsp_machine' (see docs/machines.md)");
    if (machine->abi != MACHINE_ABI)
        return fail(c, "machine", "compiled against another machine.h; compile it again");
    void **handle = &r->config.handle;
    const double period = 1.0 / c->rate_hz;
    if (machine->open(handle, c->machine_config, period, &c->info, why, sizeof why) != 0)
        return fail(c, "machine", why[0] ? why : "open failed");
    if ((machine->step != NULL) != (c->info.simulated != 0))
        return fail(c, "machine",
                    "a simulated machine has step(), hardware has none; machine_info.simulated"
                    " disagrees");
    return 0;
}

static int check_settings(runner *r) {
    control *c = r->control;
    if (c->clock == CLOCK_FAST && !c->info.simulated)
        return fail(c, "machine", "the fast clock needs a simulated machine");
    char key[LAYOUT_NAME], why[LAYOUT_TEXT];
    if (promises_check(&c->info, why, sizeof why) != 0)
        return fail(c, "machine", why);
    void *library = dlopen(c->machine_path, RTLD_NOW | RTLD_NOLOAD);
    const char *asked = library ? dlsym(library, "machine_config_asked") : NULL;
    if (!unknown_setting(c->machine_config, asked, key, sizeof key))
        return 0;
    snprintf(why, sizeof why, "it has no setting '%s'; it asks for%s", key, asked);
    for (char *at = why; *at; at++)
        if (*at == '\n')
            *at = at[1] ? ' ' : 0;
    return fail(c, "machine", why);
}

static int find_end(struct dl_phdr_info *info, size_t size, void *data) {
    runner *r = data;
    (void)size;
    if (info->dlpi_addr != r->config.image)
        return 0;
    for (int i = 0; i < info->dlpi_phnum; i++) {
        const uint64_t end =
            info->dlpi_addr + info->dlpi_phdr[i].p_vaddr + info->dlpi_phdr[i].p_memsz;
        if (info->dlpi_phdr[i].p_type == PT_LOAD && end > r->config.image_end)
            r->config.image_end = end;
    }
    return 1;
}

static int load_program(runner *r) {
    control *c = r->control;
    store32(&c->within, WITHIN_LOADING);
    void *library = dlopen(c->program_path, RTLD_NOW | RTLD_LOCAL);
    store32(&c->within, WITHIN_RUNTIME);
    if (!library)
        return fail(c, "program", dlerror());
    const int32_t *abi = dlsym(library, "zendsp_isr_abi");
    if (!abi || *abi != ZENDSP_ISR_ABI)
        return fail(c, "program",
                    abi ? "compiled against another isr.h; compile it again"
                        : "does not include isr.h");
    zendsp_io **io = dlsym(library, "zendsp");
    void (*init)(void) = NULL;
    *(void **)&init = dlsym(library, "UserInit");
    *(void **)&r->config.isr = dlsym(library, "UserISR_INT2");
    *(void **)&r->config.background = dlsym(library, "UserBackground");
    if (!io || !init || !r->config.isr)
        return fail(c, "program", "needs UserInit and UserISR_INT2");
    Dl_info where;
    if (dladdr((void *)(uintptr_t)abi, &where) != 0)
        r->config.image = (uint64_t)(uintptr_t)where.dli_fbase;
    dl_iterate_phdr(find_end, r);
    *io = &r->buffers.io;
    store32(&c->phase, PHASE_INIT);
    store32(&c->within, WITHIN_INIT);
    init();
    store32(&c->within, WITHIN_RUNTIME);
    return dictionary_finish(r) == 0 ? 0 : fail(c, "", NULL);
}

/* A row is of the sample that runs: the background has none. */
static void acquire(void) {
    if (this_thread_is == 0)
        stream_sample(&the_runner);
}

static void close_machine(const runner *r) {
    if (r->config.machine->close)
        r->config.machine->close(r->config.handle);
}

static void prepare_io(runner *r) {
    const control *c = r->control;
    zendsp_io *io = &r->buffers.io;
    io->period = 1.0 / c->rate_hz;
    io->joints = c->info.joints;
    io->declare = dictionary_declare;
    io->acquire = acquire;
    for (int j = 0; j < MACHINE_JOINTS; j++) {
        const machine_joint *joint = &c->info.joint[j];
        io->counts_per_unit[j] = joint->counts_per_unit != 0.0 ? joint->counts_per_unit : 1.0;
        io->zero_counts[j] = joint->zero_counts;
        /* what is written to a joint that takes no torque must show, as for one that is absent */
        io->mv_per_torque[j] = joint->mv_per_torque != 0.0 ? joint->mv_per_torque : NO_TORQUE_MV;
        io->torque_max[j] = strcmp(joint->command, "none") == 0 ? 0.0 : joint->torque_max;
        io->inertia[j] = joint->inertia;
    }
}

/* Between the first frame of a thread and its stack pointer all is stack: a write there fails only
 * where no more stack can be had. A call or a probe reaches a page beyond the stack pointer. */
static int stack_used_up(int number, uint64_t touched, uint64_t stack_pointer) {
    return number == SIGSEGV && stack_pointer != 0 && touched < this_stack_begins &&
           touched + STACK_PROBE >= stack_pointer;
}

static void on_crash(int number, siginfo_t *info, void *context) {
    runner *r = &the_runner;
    uint64_t at = 0, stack_pointer = 0;
#if defined(__x86_64__)
    at = (uint64_t)((ucontext_t *)context)->uc_mcontext.gregs[REG_RIP];
    stack_pointer = (uint64_t)((ucontext_t *)context)->uc_mcontext.gregs[REG_RSP];
#elif defined(__aarch64__)
    at = (uint64_t)((ucontext_t *)context)->uc_mcontext.pc;
    stack_pointer = (uint64_t)((ucontext_t *)context)->uc_mcontext.sp;
#else
    (void)context;
#endif
    r->control->crash_signal = number;
    r->control->crash_stack =
        (uint32_t)stack_used_up(number, (uint64_t)(uintptr_t)info->si_addr, stack_pointer);
    r->control->crash_within = this_thread_is ? this_thread_is : (int32_t)r->control->within;
    r->control->crash_address =
        at >= r->config.image && at < r->config.image_end ? at - r->config.image : 0;
    /* SA_RESETHAND: returning repeats the fault, now with its default action */
    if (number == SIGABRT)
        raise(number);
}

static void on_end(int number) {
    (void)number;
    store32(&the_runner.control->run, RUN_QUIT);
}

static void catch_signals(void) {
    static const int fatal[] = {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT};
    static unsigned char own_stack[65536];
    const stack_t stack = {.ss_sp = own_stack, .ss_size = sizeof own_stack};
    sigaltstack(&stack, NULL); /* a stack overflow needs another stack to be told on */
    this_stack_begins = (uint64_t)(uintptr_t)__builtin_frame_address(0);
    struct sigaction crash = {.sa_sigaction = on_crash,
                              .sa_flags = (int)(SA_SIGINFO | SA_ONSTACK | SA_RESETHAND)};
    for (size_t i = 0; i < sizeof fatal / sizeof fatal[0]; i++)
        sigaction(fatal[i], &crash, NULL);
    struct sigaction end = {.sa_handler = on_end};
    sigaction(SIGTERM, &end, NULL);
}

/* In a process of its own, since the memory of one that crashed is not to be trusted. It begins
 * with the runner, is told its number, and then whether it is wanted. Where the monitor ends
 * without a word, the runner is to end first: it may have been killed as well, or stopped. */
static int make_safe(const char *path) {
    const control *given = map_control(path);
    static control copy;
    int32_t number, wanted;
    if (!given)
        return 1;
    copy = *given;
    if (read(STDIN_FILENO, &number, sizeof number) != sizeof number)
        return 0;
    const int handle = contain_hold(number);
    if (read(STDIN_FILENO, &wanted, sizeof wanted) != sizeof wanted) {
        if (handle < 0)
            return 0;
        contain_end_runner(handle, ORPHAN_S);
    } else if (!wanted)
        return 0;
    contain_end_within(ORPHAN_S); /* who asked for it may be gone by then */
    the_runner.control = &copy;
    if (open_machine(&the_runner) != 0) {
        fprintf(stderr, "runner: %s\n", copy.error);
        return 1;
    }
    the_runner.config.machine->safe(the_runner.config.handle);
    close_machine(&the_runner);
    return 0;
}

static int look(const char *path) {
    runner *r = &the_runner;
    r->control = map_control(path);
    if (!r->control)
        return 1;
    contain_hear_of_end(r->control, SIGKILL);
    if (open_machine(r) != 0)
        return 1;
    close_machine(r);
    return 0;
}

int main(int count, char **arguments) {
    runner *r = &the_runner;
    if (count == 3 && strcmp(arguments[1], "--safe") == 0)
        return make_safe(arguments[2]);
    if (count == 3 && strcmp(arguments[1], "--look") == 0)
        return look(arguments[2]);
    if (count != 2) {
        fprintf(stderr, "usage: runner [--safe | --look] CONTROL\n");
        return 2;
    }
    r->control = map_control(arguments[1]);
    if (!r->control)
        return 1;
    r->page = map_file(r->control->stop_path, sizeof *r->page);
    if (!r->page || r->page->magic != LAYOUT_MAGIC || r->page->version != STOP_PAGE_VERSION)
        return fail(r->control, "stop page",
                    "it is damaged, or of another version of zendsp: start the target again");
    catch_signals();
    contain_hear_of_end(r->control, SIGKILL);
    if (open_machine(r) != 0 || check_settings(r) != 0)
        return 1;
    prepare_io(r);
    dictionary_builtins(r);
    safety_reset(r);
    contain_thread();
    const int failed = service_start(r); /* before user code, which may start none */
    if (failed)
        return fail(r->control, "threads", strerror(failed));
    contain_hear_of_end(r->control, SIGCONT);
    contain_enter(r->control);
    if (load_program(r) != 0)
        return 1;
    realtime_enter(r);
    contain_say(r->control);
    store32(&r->control->phase, PHASE_READY);
    loop(r);
    r->config.machine->safe(r->config.handle);
    close_machine(r);
    store32(&r->control->phase, PHASE_ENDED);
    contain_end_children();
    if (getppid() != r->control->monitor)
        contain_end_group();
    _exit(0); /* the other threads are within user code: no destructors beneath their feet */
}
