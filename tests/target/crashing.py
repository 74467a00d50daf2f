"""A program that crashes, and one that does not."""

from __future__ import annotations

CRASHING = """
#include "isr.h"
#include <stdlib.h>
static double x, gain;
static volatile int32_t when = 50, zero;
static int *nowhere;
static void deeper(volatile char *p) {{ volatile char here[4096]; here[0] = p ? p[0] : 0; deeper(here); }}
void UserInit(void) {{ PARAMETER(gain, 1.0, "", NO_MIN, NO_MAX, ""); SIGNAL(x, "", ""); (void)nowhere; (void)deeper; }}
void UserISR_INT2(void) {{
    x = (double)SAMPLE_TICK;
    if (SAMPLE_TICK == (uint64_t)when) {{
        {how}
    }}
}}
"""  # noqa: E501

GOOD = """
#include "isr.h"
static double x;
void UserInit(void) { SIGNAL(x, "", ""); }
void UserISR_INT2(void) { x += 1.0; }
"""
