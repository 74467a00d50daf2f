/* isr.h: everything that control code needs; the only header to include.
 *
 *     #include "isr.h"
 *     static double Kp = 400.0, q, tau;
 *
 *     void UserInit(void) {
 *         PARAMETER(Kp, 400.0, "N m/rad", 0.0, 5000.0, "gain");
 *         SIGNAL(q, "rad", "angle");
 *         SIGNAL(tau, "N m", "");
 *     }
 *     void UserISR_INT2(void)  { q = READ_POSITION(0); tau = -Kp * q; WRITE_TORQUE(0, tau); }
 *     void UserBackground(void) {}
 *
 * Channels, joints and array elements count from 0, as everywhere in C. What the code writes at
 * sample k acts from sample k + 1.
 */
#ifndef ZENDSP_ISR_H
#define ZENDSP_ISR_H

#include <math.h>    /* sin, cos, …: control laws need them */
#include <stdbool.h> /* bool variables */
#include <stddef.h>  /* NULL */
#include <stdint.h>  /* int32_t */

/* ---- The three functions that you write ------------------------------------------------------ */

void UserInit(void);       /* once, at load: declare and initialise variables */
void UserISR_INT2(void);   /* every sample: the control law */
void UserBackground(void); /* again and again beneath the loop, which interrupts it; optional */

/* ---- Declaring variables, in UserInit -----------------------------------------------------------
 * A variable is a static or global double, float, int32_t or bool, or an array of them of one or
 * two dimensions. In a unit {q} is rad, or m where the joint slides; {tau} N m, or N; {J} kg m^2,
 * or kg. */

/* The host may write it, within min … max (NO_MIN, NO_MAX). Every element starts at `initial`. */
#define PARAMETER(variable, initial, unit, min, max, text)                                         \
    ZENDSP_DECLARE(variable, ZENDSP_PARAMETER, 1, (double)(initial), unit, min, max, text)

/* An array parameter that keeps the values of its C initialiser. */
#define PARAMETER_ARRAY(variable, unit, min, max, text)                                            \
    ZENDSP_DECLARE(variable, ZENDSP_PARAMETER, 0, 0.0, unit, min, max, text)

/* The first `count` elements of an array, for programs that fit any machine: count is JOINTS. */
#define PARAMETER_FIRST(variable, count, unit, min, max, text)                                     \
    ZENDSP_DECLARE_FIRST(variable, count, ZENDSP_PARAMETER, 0, 0.0, unit, min, max, text)
#define SIGNAL_FIRST(variable, count, unit, text)                                                  \
    ZENDSP_DECLARE_FIRST(variable, count, ZENDSP_SIGNAL, 0, 0.0, unit, NO_MIN, NO_MAX, text)

/* The host may read, record and plot it. */
#define SIGNAL(variable, unit, text)                                                               \
    ZENDSP_DECLARE(variable, ZENDSP_SIGNAL, 0, 0.0, unit, NO_MIN, NO_MAX, text)

/* A large array of double, `columns` values a row, at most `capacity` rows (60 s × 7 joints at 1
 * kHz: 60000 rows, 7 columns). The host fills it while the loop runs; all of it, with its length,
 * takes effect at the start of one sample. `variable` is a `table`. */
#define TABLE(variable, capacity, columns, unit, text)                                             \
    zendsp_declare_table(&(variable), #variable, capacity, columns, unit, text)

typedef struct table {
    const double *data; /* row after row; NULL while empty */
    int32_t rows;       /* 0 while empty */
    int32_t columns;
    uint32_t version;   /* counts the switch-overs: a change means new content */
} table;

#define NO_MIN (-INFINITY)
#define NO_MAX (INFINITY)

/* ---- Inputs and outputs ---------------------------------------------------------------------- */

#define IOGP_FU1_READ_ENC_CURRENT(ch) (zendsp->enc[ZENDSP_CH(ch)]) /* encoder, counts (int32_t) */
#define IOGP_FU1_READ_ADC(ch) (zendsp->adc[ZENDSP_CH(ch)]) /* analog input, its unit (double) */
#define IOGP_FU1_READ_DIN(ch) ((zendsp->din >> ((ch) & 31) & 1u) != 0u) /* digital input (bool) */

/* Analog output, mV: an lvalue, IOGP_FU1_WRITE_AOUT_ENGU(ch) = mv; or with two arguments,
 * IOGP_FU1_WRITE_AOUT_ENGU(ch, mv); */
#define IOGP_FU1_WRITE_AOUT_ENGU(...)                                                              \
    ZENDSP_PICK(__VA_ARGS__, ZENDSP_AOUT_SET, ZENDSP_AOUT, )(__VA_ARGS__)

/* Digital output: on is true or false. */
#define IOGP_FU1_WRITE_DOUT(ch, on)                                                                \
    (zendsp->dout = (on) ? zendsp->dout | 1u << ((ch) & 31) : zendsp->dout & ~(1u << ((ch) & 31)))

/* The same in physical units, by the scales of the machine: rad (or m), N m (or N). To read a joint
 * that the machine has not trips, and so does a torque other than 0 to a joint that takes none (its
 * command is a voltage, or it has no motor). */
#define READ_POSITION(ch) (zendsp_position(ZENDSP_CH(ch)))
#define WRITE_TORQUE(ch, tau) (zendsp_torque(ZENDSP_CH(ch), tau))

/* What the machine says of a joint: its largest torque, N m (or N; 0 without a motor), and what it
 * turns, kg m^2 (or kg; 0 where it does not say). */
#define TORQUE_MAX(ch) (zendsp->torque_max[ZENDSP_CH(ch)])
#define JOINT_INERTIA(ch) (zendsp->inertia[ZENDSP_CH(ch)])

/* ---- Time, state, acquisition ---------------------------------------------------------------- */

#define SAMPLE_PERIOD (zendsp->period) /* s */
#define SAMPLE_TICK (zendsp->tick)     /* samples since load (uint64_t) */
#define SAMPLE_TIME (zendsp->t)        /* s since load */
#define JOINTS (zendsp->joints)        /* joints of the machine */
#define DRIVE_ENABLED (zendsp->enabled != 0) /* false: outputs are ignored (hold integrators) */

/* True in the first sample after load, and in the first one after homing, an acknowledged trip or
 * STOP, a switching off of the drives during a pause, and any pause of hardware: nothing remembered
 * from before holds, positions may have jumped. Estimates of speed begin again
 * (qd = FIRST_SAMPLE ? 0.0 : …). Except after load, DRIVE_ENABLED is false in this sample: its
 * outputs are not taken, and a motion starts from where the machine stands. The pause of a
 * simulated machine stops its time: the program goes on as if there had been none. */
#define FIRST_SAMPLE (zendsp->first != 0)

/* Store one row of every running acquisition here and now; without a call it is done after
 * UserISR_INT2. Never blocks. In UserBackground it does nothing. */
#define Acquire() (zendsp->acquire())

/* Value of a table at a row (a fraction interpolates linearly, ends hold), 0 while empty. */
static inline double TableValue(const table *source, double row, int32_t column) {
    if (source->rows <= 0 || column < 0 || column >= source->columns)
        return 0.0;
    const double last = (double)(source->rows - 1);
    const double at = row > 0.0 ? (row < last ? row : last) : 0.0; /* NaN goes to the first row */
    const int32_t i = (int32_t)at;
    const double *here = source->data + (int64_t)i * source->columns + column;
    const double part = at - (double)i;
    return part > 0.0 ? here[0] + part * (here[source->columns] - here[0]) : here[0];
}

/* ---- Beneath: how the macros reach the runtime ----------------------------------------------- */

enum { ZENDSP_ISR_ABI = 4 }; /* raised when anything below changes; checked at load */
enum { ZENDSP_PARAMETER = 1, ZENDSP_SIGNAL = 2, ZENDSP_TABLE = 3 };
enum { ZENDSP_DOUBLE = 1, ZENDSP_FLOAT = 2, ZENDSP_INT32 = 3, ZENDSP_BOOL = 4 };

typedef struct zendsp_declaration {
    const char *name, *unit, *text;
    void *address;
    double initial, minimum, maximum;
    int32_t kind, type;
    int32_t bytes;         /* size of the variable; of a table: 0 */
    int32_t rows, columns; /* of a table; columns of a matrix too, else 1 */
    int32_t set;           /* 1: give every element `initial` now */
} zendsp_declaration;

typedef struct zendsp_io {
    uint64_t tick;
    double t, period; /* s */
    int32_t joints, enabled;
    uint32_t din, dout;
    int32_t enc[8];
    double adc[8], aout[8];
    double counts_per_unit[8], zero_counts[8], mv_per_torque[8];
    double torque_max[8], inertia[8];
    int32_t first;
    int32_t outside; /* 0, or a channel or joint that is not there: from 1, or as it is below 0 */
    void (*declare)(const zendsp_declaration *declaration);
    void (*acquire)(void);
} zendsp_io;

/* Weak: every file of a program may include this header, and all share one. */
__attribute__((weak, visibility("default"))) zendsp_io *zendsp;
__attribute__((weak, visibility("default"))) const int32_t zendsp_isr_abi = ZENDSP_ISR_ABI;

#define ZENDSP_PICK(a, b, name, ...) name
#define ZENDSP_AOUT(ch) (zendsp->aout[ZENDSP_CH(ch)])
#define ZENDSP_AOUT_SET(ch, mv) (zendsp->aout[ZENDSP_CH(ch)] = (mv))

/* A channel within the arrays; a constant that no machine has does not compile, a computed one
 * trips. */
#define ZENDSP_CH(ch)                                                                              \
    (__builtin_constant_p(ch) && ((ch) & ~7) != 0 ? zendsp_no_such_channel()                       \
                                                  : zendsp_channel((int32_t)(ch)))
__attribute__((error("channels and joints are 0 to 7"))) int32_t zendsp_no_such_channel(void);

static inline int32_t zendsp_channel(int32_t ch) {
    if ((ch & ~7) != 0)
        zendsp->outside = ch < 0 ? ch : ch + (ch < INT32_MAX);
    return ch & 7;
}

static inline double zendsp_position(int32_t joint) {
    if (joint >= zendsp->joints && zendsp->outside == 0)
        zendsp->outside = joint + 1;
    return (zendsp->enc[joint] - zendsp->zero_counts[joint]) / zendsp->counts_per_unit[joint];
}

static inline double zendsp_torque(int32_t joint, double torque) {
    return zendsp->aout[joint] = torque * zendsp->mv_per_torque[joint];
}

/* Type of a number, of an array's elements, or of a matrix's: that of its first row's. */
#define ZENDSP_TYPE(variable)                                                                      \
    _Generic((variable),                                                                           \
        double: ZENDSP_DOUBLE,                                                                     \
        double *: ZENDSP_DOUBLE,                                                                   \
        float: ZENDSP_FLOAT,                                                                       \
        float *: ZENDSP_FLOAT,                                                                     \
        int32_t: ZENDSP_INT32,                                                                     \
        int32_t *: ZENDSP_INT32,                                                                   \
        bool: ZENDSP_BOOL,                                                                         \
        bool *: ZENDSP_BOOL,                                                                       \
        default: _Generic(ZENDSP_ROW(variable),                                                    \
            double: 0,                                                                             \
            float: 0,                                                                              \
            int32_t: 0,                                                                            \
            bool: 0,                                                                               \
            double *: ZENDSP_DOUBLE,                                                               \
            float *: ZENDSP_FLOAT,                                                                 \
            int32_t *: ZENDSP_INT32,                                                               \
            bool *: ZENDSP_BOOL))
/* What an array's first element is, and a matrix's first row; of a number, which has none,
 * something valid, or where it is of no type that can be declared, what ZENDSP_TYPE refuses by its
 * name. Never evaluated. */
#define ZENDSP_ROW(variable)                                                                       \
    (*_Generic((variable),                                                                         \
         double: (double **)0,                                                                     \
         float: (double **)0,                                                                      \
         int32_t: (double **)0,                                                                    \
         bool: (double **)0,                                                                       \
         char: (char **)0,                                                                         \
         signed char: (signed char **)0,                                                           \
         unsigned char: (unsigned char **)0,                                                       \
         short: (short **)0,                                                                       \
         unsigned short: (unsigned short **)0,                                                     \
         unsigned: (unsigned **)0,                                                                 \
         long: (long **)0,                                                                         \
         unsigned long: (unsigned long **)0,                                                       \
         long long: (long long **)0,                                                               \
         unsigned long long: (unsigned long long **)0,                                             \
         long double: (long double **)0,                                                           \
         default: (variable)))
#define ZENDSP_SIZE(variable)                                                                      \
    (ZENDSP_TYPE(variable) == ZENDSP_DOUBLE ? sizeof(double)                                       \
     : ZENDSP_TYPE(variable) == ZENDSP_BOOL ? sizeof(bool)                                         \
                                            : sizeof(float))
#define ZENDSP_COLUMNS(variable)                                                                   \
    _Generic((variable),                                                                           \
        double: 1u,                                                                                \
        float: 1u,                                                                                 \
        int32_t: 1u,                                                                               \
        bool: 1u,                                                                                  \
        default: sizeof(ZENDSP_ROW(variable)) / ZENDSP_SIZE(variable))
/* 0; a pointer, whose own bytes are no number, does not compile. */
#define ZENDSP_NO_POINTER(variable)                                                                \
    _Generic(&(variable),                                                                          \
        double **: zendsp_pointer_declared(),                                                      \
        float **: zendsp_pointer_declared(),                                                       \
        int32_t **: zendsp_pointer_declared(),                                                     \
        bool **: zendsp_pointer_declared(),                                                        \
        default: 0)
__attribute__((error("a pointer is no variable: declare the array itself, static or global")))
int32_t zendsp_pointer_declared(void);
#define ZENDSP_DECLARE(variable, kind, set, initial, unit, min, max, text)                         \
    ZENDSP_DECLARE_BYTES(variable, sizeof(variable), kind, set, initial, unit, min, max, text)
#define ZENDSP_DECLARE_FIRST(variable, count, kind, set, initial, unit, min, max, text)            \
    ZENDSP_DECLARE_BYTES(variable, sizeof((variable)[0]) * ZENDSP_WITHIN(variable, count), kind,   \
                         set, initial, unit, min, max, text)
#define ZENDSP_WITHIN(variable, count)                                                             \
    ((size_t)(count) < sizeof(variable) / sizeof((variable)[0])                                    \
         ? (size_t)(count)                                                                         \
         : sizeof(variable) / sizeof((variable)[0]))
#define ZENDSP_DECLARE_BYTES(variable, bytes_, kind_, set_, initial_, unit_, min_, max_, text_)    \
    zendsp_declare(#variable, (unit_), (text_), (void *)&(variable), (initial_), (min_), (max_),   \
                   (kind_), ZENDSP_TYPE(variable),                                                 \
                   (int32_t)(bytes_) + ZENDSP_NO_POINTER(variable),                                \
                   (int32_t)ZENDSP_COLUMNS(variable), (set_))

/* Never inline: UserInit would fill in a structure for each variable, and compilers take eight
 * times as long over hundreds of them. */
static __attribute__((noinline, unused)) void
zendsp_declare(const char *name, const char *unit, const char *text, void *address, double initial,
               double minimum, double maximum, int32_t kind, int32_t type, int32_t bytes,
               int32_t columns, int32_t set) {
    zendsp->declare(&(const zendsp_declaration){.name = name,
                                                .unit = unit,
                                                .text = text,
                                                .address = address,
                                                .initial = initial,
                                                .minimum = minimum,
                                                .maximum = maximum,
                                                .kind = kind,
                                                .type = type,
                                                .bytes = bytes,
                                                .columns = columns,
                                                .set = set});
}

static inline void zendsp_declare_table(table *variable, const char *name, int32_t capacity,
                                        int32_t columns, const char *unit, const char *text) {
    zendsp->declare(&(const zendsp_declaration){.name = name,
                                                .unit = unit,
                                                .text = text,
                                                .address = variable,
                                                .minimum = NO_MIN,
                                                .maximum = NO_MAX,
                                                .kind = ZENDSP_TABLE,
                                                .type = ZENDSP_DOUBLE,
                                                .rows = capacity,
                                                .columns = columns});
}

#endif
