"""Run a program where the system refuses a filter of system calls: python unfiltered.py FILE.c END
"""

from __future__ import annotations

import ctypes
import os
import signal
import struct
import sys
import time
from pathlib import Path

X86_64, AARCH64 = 317, 277  # number of seccomp(2)


def refuse_filters() -> None:
    """Have seccomp(2) fail with ENOSYS from now on, in this process and all that it starts."""
    number = X86_64 if os.uname().machine == "x86_64" else AARCH64
    code = [
        (0x20, 0, 0, 0),
        (0x15, 0, 1, number),
        (0x06, 0, 0, 0x00050000 | 38),
        (0x06, 0, 0, 0x7FFF0000),
    ]
    program = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *line) for line in code))

    class Filter(ctypes.Structure):
        _fields_ = (("length", ctypes.c_ushort), ("code", ctypes.c_void_p))

    libc = ctypes.CDLL(None, use_errno=True)
    assert libc.prctl(38, 1, 0, 0, 0) == 0
    wanted = Filter(len(code), ctypes.addressof(program))
    assert libc.prctl(22, 2, ctypes.byref(wanted), 0, 0) == 0, os.strerror(ctypes.get_errno())


def main() -> None:
    refuse_filters()
    from zendsp_target.runtime import Runtime

    runtime = Runtime("imi_planar", clock="real", realtime=False)
    result = runtime.compile({"user.c": Path(sys.argv[1]).read_text()})
    assert result.ok, result.diagnostics
    runtime.load(result.key)
    runtime.start()
    values = runtime.read(["answer"])[1]
    print(values["answer"], runtime.status().scheduling, flush=True)
    sys.stdin.readline()  # the test has looked
    if sys.argv[2] == "close":
        runtime.close()
    elif sys.argv[2] == "load":
        runtime.load(result.key)
        runtime.unload()
    elif sys.argv[2] == "crash":
        os.kill(runtime.runner_pid(), signal.SIGKILL)
        while runtime.status().state != "crashed" or not runtime.status().crash:
            time.sleep(0.005)
    elif sys.argv[2] == "orphan":
        os.kill(os.getpid(), signal.SIGKILL)
    print("ended", flush=True)
    sys.stdin.readline()
    os._exit(0)


main()
