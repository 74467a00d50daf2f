"""Compiles the C of this folder once per content and opens it."""

from __future__ import annotations

import functools
import hashlib
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import cffi

HERE = Path(__file__).parent
PARTS = ("reality.h", "mechanism.c", "joint.c", "loop.c")
# no contraction into fused multiply-adds: the same seed gives the same bits on every machine
FLAGS = ("-O2", "-std=gnu11", "-ffp-contract=off", "-shared", "-fPIC")


def cache_folder() -> Path:
    """Folder of compiled libraries: ``$XDG_CACHE_HOME/zendsp`` or one below the temporary folder.
    """
    root = os.environ.get("XDG_CACHE_HOME")
    folder = (
        Path(root) / "zendsp" if root else Path(tempfile.gettempdir()) / f"zendsp-{os.getuid()}"
    )
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    return folder


@functools.cache
def library() -> tuple[Any, Any]:
    """The pair (ffi, lib) of the simulator, compiled at first use.

    Raises
    ------
    RuntimeError
        The C compiler is missing or refuses; its words are in the message.
    """
    texts = {name: (HERE / name).read_text(encoding="utf-8") for name in PARTS}
    source = "#include <math.h>\n" + "\n".join(texts.values())
    key = hashlib.sha256((source + " ".join(FLAGS)).encode()).hexdigest()[:16]
    path = cache_folder() / f"reality-{key}.so"
    if not path.exists():
        compile_to(path, source)
    ffi = cffi.FFI()
    ffi.cdef(texts["reality.h"])
    return ffi, ffi.dlopen(str(path))


def compile_to(path: Path, source: str) -> None:
    """Compile into a private file, then rename: a second process never opens half a library."""
    compiler = os.environ.get("CC", "cc")
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        code, product = Path(folder) / "reality.c", Path(folder) / "reality.so"
        code.write_text(source, encoding="utf-8")
        try:
            done = subprocess.run(
                [compiler, *FLAGS, str(code), "-o", str(product), "-lm"],
                capture_output=True,
                text=True,
            )
        except FileNotFoundError as error:
            raise RuntimeError(
                f"no C compiler {compiler!r} found; install one or set CC"
            ) from error
        if done.returncode != 0:
            raise RuntimeError(f"{compiler} refused the simulator of the proof:\n{done.stderr}")
        os.replace(product, path)
