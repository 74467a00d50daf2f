"""Run a command within limits: what it may read, write, take and last. Started as a script of its
own, which becomes the command.

    python -I -S confine.py SETTINGS /path/to/COMMAND …

Landlock (Linux 5.13 and later) needs no rights: the command reads its toolchain and the folders it
is given, and writes to its own. Where the system lets this user have namespaces, nothing else is
there at all: it cannot even tell whether a file exists. The limits on memory, CPU time and the size
of files hold everywhere. It imports nothing but the standard library.
"""

from __future__ import annotations

import ctypes
import json
import os
import resource
import sys
from collections.abc import Sequence

_CREATE, _ADD, _RESTRICT = 444, 445, 446  # the same numbers on every architecture
_RULE_PATH = 1
_NO_NEW_PRIVS = 38
_EXECUTE, _WRITE, _READ_FILE, _READ_DIR = 1, 2, 4, 8
_READ = _EXECUTE | _READ_FILE | _READ_DIR
_FILE_ONLY = _EXECUTE | _WRITE | _READ_FILE | 1 << 14
_NETWORK = 0b11  # bind and connect, TCP
_NEW_MOUNTS, _NEW_USER = 0x20000, 0x10000000  # of unshare
_BIND, _RECURSIVE, _PRIVATE = 1 << 12, 1 << 14, 1 << 18  # of mount


class _Ruleset(ctypes.Structure):
    _fields_ = (
        ("files", ctypes.c_uint64),
        ("network", ctypes.c_uint64),
        ("scoped", ctypes.c_uint64),
    )


class _Path(ctypes.Structure):
    _pack_ = 1
    _fields_ = (("allowed", ctypes.c_uint64), ("parent", ctypes.c_int32))


def landlock_version() -> int:
    """Version of the kernel's Landlock; 0 where there is none."""
    libc = ctypes.CDLL(None, use_errno=True)
    return max(0, int(libc.syscall(_CREATE, None, ctypes.c_size_t(0), ctypes.c_uint32(1))))


def restrict(readable: Sequence[str], writable: Sequence[str]) -> bool:
    """Let this process and its children see only these paths, for good.

    Parameters
    ----------
    readable, writable : sequence of str
        Folders and files; what does not exist is left out.

    Returns
    -------
    bool
        False where the kernel has no Landlock: nothing was restricted.

    Raises
    ------
    OSError
        The kernel has it and refused.
    """
    version = landlock_version()
    if version < 1:
        return False
    libc = ctypes.CDLL(None, use_errno=True)
    every = (1 << (13 + (version >= 2) + (version >= 3) + (version >= 5))) - 1
    rules = _Ruleset(every, _NETWORK if version >= 4 else 0, 0b11 if version >= 6 else 0)
    size = 24 if version >= 6 else 16 if version >= 4 else 8
    ruleset = libc.syscall(_CREATE, ctypes.byref(rules), ctypes.c_size_t(size), ctypes.c_uint32(0))
    _checked(ruleset)
    for paths, allowed in ((readable, _READ), (writable, every)):
        for path in paths:
            try:
                place = os.open(path, os.O_PATH | os.O_CLOEXEC)
            except OSError:
                continue
            mask = allowed if os.path.isdir(path) else allowed & _FILE_ONLY
            rule = _Path(mask & every, place)
            _checked(
                libc.syscall(_ADD, ruleset, _RULE_PATH, ctypes.byref(rule), ctypes.c_uint32(0))
            )
            os.close(place)
    _checked(libc.prctl(_NO_NEW_PRIVS, 1, 0, 0, 0))
    _checked(libc.syscall(_RESTRICT, ruleset, ctypes.c_uint32(0)))
    os.close(ruleset)
    return True


def seclude(paths: Sequence[str], cwd: str, program: str) -> bool:
    """Give this process and its children a root that holds these paths and nothing else.

    Parameters
    ----------
    paths : sequence of str
        Folders and files; what does not exist is left out.
    cwd : str
        Of the paths, the folder to go on in. An empty ``.root`` is left there.
    program : str
        What ``/proc/self/exe`` names, all that there is of ``/proc``: clang and zig find their
        headers by it.

    Returns
    -------
    bool
        False where the system allows no such thing: all is seen as before.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    root, user, group = os.path.join(cwd, ".root"), os.getuid(), os.getgid()
    others = _NEW_USER if user else 0
    try:
        _checked(libc.unshare(_NEW_MOUNTS | others))
        maps = {"uid_map": f"{user} {user} 1", "gid_map": f"{group} {group} 1"}
        for name, words in {"setgroups": "deny", **maps}.items() if others else ():
            with open(f"/proc/self/{name}", "w", encoding="ascii") as file:
                file.write(words)
        _mount(libc, "none", "/", _RECURSIVE | _PRIVATE)
        os.mkdir(root)
        _checked(libc.mount(b"none", os.fsencode(root), b"tmpfs", ctypes.c_ulong(0), None))
        for path in sorted(paths, key=len):  # what holds others first
            if os.path.exists(path):
                _bring(libc, path, root)
        os.makedirs(f"{root}/proc/self")
        os.symlink(program, f"{root}/proc/self/exe")
        os.chroot(root)
    except OSError:
        return False
    os.chdir(cwd)
    return True


def _bring(libc: ctypes.CDLL, path: str, root: str) -> None:
    """Mount a path in a new root, with the links on the way to it."""
    real = "/"
    for name in path.strip("/").split("/"):
        step = os.path.join(real, name)
        real = os.path.realpath(step)
        if os.path.islink(step) and not os.path.lexists(root + step):
            os.symlink(real, root + step)
        if not os.path.lexists(root + real):
            os.makedirs(root + os.path.dirname(real), exist_ok=True)
            if os.path.isdir(real):
                os.mkdir(root + real)
            else:
                os.close(os.open(root + real, os.O_CREAT))
    _mount(libc, real, root + real, _BIND | _RECURSIVE)


def _mount(libc: ctypes.CDLL, source: str, where: str, flags: int) -> None:
    _checked(
        libc.mount(os.fsencode(source), os.fsencode(where), None, ctypes.c_ulong(flags), None)
    )


def _checked(answer: int) -> None:
    if answer < 0:
        number = ctypes.get_errno()
        raise OSError(number, f"Landlock: {os.strerror(number)}")


def _limit(what: int, most: int) -> None:
    _, hard = resource.getrlimit(what)
    value = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(what, (value, value))


def main(words: Sequence[str]) -> None:
    """Set the limits and become the command.

    Parameters
    ----------
    words : sequence of str
        Settings as JSON (``cpu_s``, ``memory``, ``file``, ``read``, ``write``, ``program``; empty:
        what else there is can be told), then the command.
    """
    settings, command = json.loads(words[0]), list(words[1:])
    _limit(resource.RLIMIT_CPU, settings["cpu_s"])
    _limit(resource.RLIMIT_AS, settings["memory"])
    _limit(resource.RLIMIT_FSIZE, settings["file"])
    _limit(resource.RLIMIT_NOFILE, 256)
    _limit(resource.RLIMIT_CORE, 0)
    if settings["program"]:
        seclude([*settings["read"], *settings["write"]], os.getcwd(), settings["program"])
    if settings["read"]:
        restrict(settings["read"], settings["write"])
    os.execv(command[0], command)


if __name__ == "__main__":
    main(sys.argv[1:])
