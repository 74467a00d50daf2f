/* declared.h: what is wrong with the variable behind a declaration of isr.h, for the runner and for
 * the simulator of programs. Runs within UserInit. */
#ifndef ZENDSP_DECLARED_H
#define ZENDSP_DECLARED_H

#include <float.h> /* DBL_MAX, FLT_MAX */
#include <link.h>  /* dl_iterate_phdr */
#include <stdio.h> /* snprintf */

#include "isr.h"

typedef struct sought {
    uintptr_t address;
    int constant;
} sought;

/* Whether an address is of memory that its object has for reading only. */
static int seek_constant(struct dl_phdr_info *object, size_t size, void *data) {
    (void)size;
    sought *s = data;
    for (int i = 0; i < object->dlpi_phnum; i++) {
        const uintptr_t from = object->dlpi_addr + object->dlpi_phdr[i].p_vaddr;
        if (object->dlpi_phdr[i].p_type == PT_LOAD && s->address >= from &&
            s->address - from < object->dlpi_phdr[i].p_memsz) {
            s->constant = (object->dlpi_phdr[i].p_flags & PF_W) == 0;
            return 1;
        }
    }
    return 0;
}

static int is_constant(const void *address) {
    sought s = {.address = (uintptr_t)address};
    dl_iterate_phdr(seek_constant, &s);
    return s.constant;
}

/* Why a host could not write this number into a parameter of this type (monitor.c: `fit`). */
static const char *no_value(int32_t type, double v) {
    if (!(fabs(v) <= DBL_MAX))
        return "is no finite number";
    if (type == ZENDSP_INT32 && !(v >= INT32_MIN && v <= INT32_MAX && v == (double)(int32_t)v))
        return "is not a 32-bit integer: declare it double";
    if (type == ZENDSP_BOOL && v != 0.0 && v != 1.0)
        return "is neither true nor false: declare it int32_t";
    if (type == ZENDSP_FLOAT && fabs(v) > (double)FLT_MAX)
        return "exceeds the range of float: declare it double";
    return NULL;
}

static double element(const void *address, int32_t type, int32_t i) {
    switch (type) {
    case ZENDSP_DOUBLE:
        return ((const double *)address)[i];
    case ZENDSP_FLOAT:
        return (double)((const float *)address)[i];
    case ZENDSP_INT32:
        return ((const int32_t *)address)[i];
    default:
        return ((const bool *)address)[i];
    }
}

/* What keeps a declared parameter of `length` elements from being one: NULL where nothing does. */
static const char *no_parameter(const zendsp_declaration *d, int32_t length) {
    static char text[160];
    if (!(d->minimum <= d->maximum)) {
        snprintf(text, sizeof text,
                 "its limits are %g and %g: the first must not be above the second", d->minimum,
                 d->maximum);
        return text;
    }
    for (int32_t i = 0; d->kind == ZENDSP_PARAMETER && i < (d->set ? 1 : length); i++) {
        const double v = d->set ? d->initial : element(d->address, d->type, i);
        const char *why = no_value(d->type, v);
        char which[32] = "";
        if (!d->set)
            snprintf(which, sizeof which, " of element %d", (int)i);
        if (why)
            snprintf(text, sizeof text, "initial value %g%s %s", v, which, why);
        else if (!(v >= d->minimum && v <= d->maximum))
            snprintf(text, sizeof text,
                     "initial value %g%s is outside its limits %g and %g: change one of them%s", v,
                     which, d->minimum, d->maximum, d->set ? " in UserInit" : "");
        else
            continue;
        return text;
    }
    return NULL;
}

#endif
