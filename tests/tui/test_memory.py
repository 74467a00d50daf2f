"""The terminal's threads share one heap."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE_S

COUNT = """
import ctypes, threading
from zendsp.tui.memory import keep_one_heap
if {ask}:
    keep_one_heap()
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
ready = threading.Barrier(5)
def take():
    libc.malloc(ctypes.c_size_t(64))
    ready.wait()
threads = [threading.Thread(target=take) for _ in range(4)]
[t.start() for t in threads]
ready.wait()
libc.fopen.restype = ctypes.c_void_p
path = {path!r}.encode()
stream = ctypes.c_void_p(libc.fopen(path, b"w"))
libc.malloc_info(0, stream)
libc.fclose(stream)
"""


def _heaps(ask: bool, path: str) -> int:
    command = [sys.executable, "-c", COUNT.format(ask=ask, path=path)]
    subprocess.run(command, check=True, timeout=PATIENCE_S)
    with open(path, encoding="utf-8") as stream:
        return stream.read().count("<heap nr=")


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's own")
def test_threads_of_the_terminal_share_one_heap(tmp_path: Path) -> None:
    if _heaps(False, f"{tmp_path}/many.xml") < 2:
        pytest.skip("this C library keeps one heap anyway")
    assert _heaps(True, f"{tmp_path}/one.xml") == 1
