"""The layout of the shared memory, read by cffi from the runner's own headers: there is no second
copy of it.
"""

from __future__ import annotations

import functools
import re
import weakref
from typing import Any

from cffi import FFI

from zendsp_isr.build import source_root
from zendsp_isr.parts import build_monitor


def _declarations(text: str) -> str:
    """A header without preprocessor lines and static asserts, which cffi can parse."""
    text = re.sub(r"^\s*#.*$", "", text, flags=re.MULTILINE)
    return re.sub(r"^_Static_assert[^;]*;", "", text, flags=re.MULTILINE)


@functools.cache
def layout() -> tuple[Any, Any]:
    """The cffi handle that knows every struct of ``layout.h`` and ``machine.h``, and the compiled
    helper ``monitor.c``.

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
    for header in ("include/machine.h", "runtime/layout.h", "runtime/monitor.h"):
        ffi.cdef(_declarations((root / header).read_text()))
    return ffi, ffi.dlopen(str(build_monitor()))


def outlive_lost_pages() -> None:
    """Let this process live on where user code cuts a file of shared memory short: what is lost
    reads as zeros.
    """
    layout()[1].monitor_outlive_lost_pages()


_HELD: weakref.WeakKeyDictionary[Any, tuple[Any, ...]] = weakref.WeakKeyDictionary()


def struct(kind: str, **fields: Any) -> Any:
    """A new C struct that keeps alive what its pointers point to."""
    made = layout()[0].new(f"{kind} *", fields)
    _HELD[made] = tuple(fields.values())
    return made


def text_of(field: Any) -> str:
    """A fixed-size C string as text.
    """
    ffi, _ = layout()
    return bytes(ffi.string(field)).decode(errors="replace")


def set_text(field: Any, text: str) -> None:
    """Write text into a fixed-size C string.

    Raises
    ------
    ValueError
        The text does not fit.
    """
    encoded = text.encode()
    if len(encoded) >= len(field):
        raise ValueError(
            f"text of {len(encoded)} bytes does not fit into {len(field) - 1}: {text[:40]!r}…"
        )
    field[0 : len(encoded) + 1] = encoded + b"\0"
