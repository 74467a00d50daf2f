"""The shared memory as Python sees it: cffi reads the runner's own headers, so there is one layout and no second copy of it."""

from __future__ import annotations

import functools
import re
from typing import Any

from cffi import FFI

from zendsp_isr.build import build_monitor, source_root

_MONITOR = """
int monitor_snapshot(const uint64_t *newest_word, const unsigned char *slots, uint64_t stride, uint64_t from,
                     uint64_t bytes, unsigned char *values, uint64_t *tick);
int monitor_ended(int pidfd);
int monitor_commit(control *c, batch *b, uint32_t index, int pidfd);
int monitor_write(control *c, int pidfd, const batch_entry *entry, const double *limits, const double *values, uint32_t entries, batch *b,
                  uint32_t index, uint64_t sequence, uint64_t at_tick);
int monitor_read_again(const uint32_t *ended, const control *c, const unsigned char *data, uint64_t slots_at, uint64_t stride, uint64_t from,
                       uint64_t bytes, unsigned char *values, uint32_t count, const uint32_t *places, unsigned char *reply,
                       uint32_t tick_at, uint64_t least);
int monitor_write_again(const uint32_t *ended, control *c, int pidfd, const batch_entry *entry, const double *limits, uint32_t value_at,
                        unsigned char *reply, uint32_t sequence_at, const unsigned char *request, batch *b, uint32_t index,
                        uint64_t sequence);
uint32_t monitor_load32(const uint32_t *word);
uint64_t monitor_load64(const uint64_t *word);
void monitor_store32(uint32_t *word, uint32_t value);
void monitor_store64(uint64_t *word, uint64_t value);
void monitor_run(control *c, uint32_t run);
int monitor_wait_applied(const batch *b, uint64_t timeout_ns, uint64_t awake_ns);
uint64_t monitor_rows(const uint64_t *count_word, const double *rows, uint64_t capacity, uint64_t channels, uint64_t first,
                      uint64_t count, double *to, uint64_t *fold);
"""


def _declarations(text: str) -> str:
    """A header without preprocessor lines and static asserts: what cffi can parse."""
    text = re.sub(r"^\s*#.*$", "", text, flags=re.MULTILINE)
    return re.sub(r"^_Static_assert.*$", "", text, flags=re.MULTILINE)


@functools.cache
def layout() -> tuple[Any, Any]:
    """The cffi handle that knows every struct of ``layout.h`` and ``machine.h``, and the compiled helper ``monitor.c``.

    Returns
    -------
    ffi : cffi.FFI
    lib : cffi library
        Constants (``lib.RUN_ISR`` …) and the ``monitor_…`` functions.

    Raises
    ------
    CompileFailed
        There is no C compiler.
    """
    root = source_root()
    ffi = FFI()
    for header in ("include/machine.h", "runtime/layout.h"):
        ffi.cdef(_declarations((root / header).read_text()))
    ffi.cdef(_MONITOR)
    return ffi, ffi.dlopen(str(build_monitor()))


def text_of(field: Any) -> str:
    """A fixed-size C string as text.

    Parameters
    ----------
    field : cffi char array

    Returns
    -------
    str
    """
    ffi, _ = layout()
    return bytes(ffi.string(field)).decode(errors="replace")


def set_text(field: Any, text: str) -> None:
    """Write text into a fixed-size C string.

    Parameters
    ----------
    field : cffi char array
    text : str

    Raises
    ------
    ValueError
        The text does not fit.
    """
    encoded = text.encode()
    if len(encoded) >= len(field):
        raise ValueError(f"text of {len(encoded)} bytes does not fit into {len(field) - 1}: {text[:40]!r}…")
    field[0 : len(encoded) + 1] = encoded + b"\0"
