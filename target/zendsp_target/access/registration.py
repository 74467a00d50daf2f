"""The entry by which hosts on this machine find the target without an address."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import msgspec

from zendsp_protocol import registry
from zendsp_protocol.errors import Refused
from zendsp_protocol.version import PROTOCOL


def own_folder() -> Path:
    """The folder of the entries, made where it is missing. It belongs to this user and nobody else
    can look into it.

    Raises
    ------
    Refused
        It cannot be made, belongs to someone else, or others may use it.
    """
    folder = Path(registry.folder())
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise Refused(
            f"{folder} cannot be made a folder ({error.strerror}); set ZENDSP_RUNTIME_DIR to a"
            " folder of your own"
        ) from None
    found = folder.stat()
    if found.st_uid != os.getuid() or not registry.steady(folder):
        raise Refused(
            f"{folder} belongs to another user; set ZENDSP_RUNTIME_DIR to a folder of your own"
        )
    if found.st_mode & 0o077:
        raise Refused(
            f"others may use {folder}, where targets of yours are reached: chmod 700 {folder}, or"
            " set ZENDSP_RUNTIME_DIR to a folder of your own"
        )
    return folder


@contextmanager
def users_file(name: str, users: Mapping[str, str]) -> Iterator[str]:
    """The path of a file of users and passwords that exists while Zenoh reads it and that only this
    user can read; an empty path without users.
    """
    if not users:
        yield ""
        return
    path = own_folder() / f"{name}.users"
    path.unlink(missing_ok=True)
    with open(
        os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8"
    ) as file:
        file.writelines(f"{user}:{password}\n" for user, password in users.items())
    try:
        yield str(path)
    finally:
        path.unlink(missing_ok=True)


class Registration:
    """The entry of this process, by which hosts of this computer find it; only this user may read
    it.

    Raises
    ------
    Refused
        A target of that name runs already, the folder belongs to someone else, or is full.
    """

    def __init__(
        self,
        name: str,
        endpoints: list[str],
        machine: str,
        token: tuple[str, str] = ("", ""),
        instance: str = "",
        stop: str = "",
    ) -> None:
        self._entry = registry.Entry(
            name=name, pid=os.getpid(), born=registry.born(os.getpid()), endpoints=endpoints,
            machine=machine, protocol=PROTOCOL, user=token[0], password=token[1],
            instance=instance, stop=stop,
        )
        check_free(name)
        self._write()
        remove_left()

    def _write(self) -> None:
        self._path = own_folder() / registry.file_name(self._entry.name)
        temporary = self._path.with_suffix(f".{os.getpid()}.part")
        try:
            temporary.touch(0o600)  # it may hold a token
            temporary.write_bytes(msgspec.json.encode(self._entry))
            os.replace(temporary, self._path)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            raise Refused(f"{self._path}: cannot be written: {error.strerror}") from error

    def keep(self) -> None:
        """Write the entry again where it was removed, for example with its folder at the end of a
        login. Without it no STOP from this computer would find the target.
        """
        if not self._path.exists():
            with contextlib.suppress(OSError, Refused):
                self._write()

    def remove(self) -> None:
        """Remove the entry if it is still that of this process."""
        with contextlib.suppress(OSError, msgspec.MsgspecError):
            found = msgspec.json.decode(self._path.read_bytes(), type=registry.Entry)
            if found.pid == os.getpid():
                self._path.unlink()


def remove_left() -> None:
    """Remove what killed targets left in the folder: sockets that nobody holds, and entries of
    processes that are gone.
    """
    folder = own_folder()
    for path in filter(Path.is_file, folder.glob("*.sock.lock")):
        with contextlib.suppress(OSError), open(path, "rb") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # Zenoh holds it while it listens
            path.with_suffix("").unlink(missing_ok=True)
            path.unlink()
    for path in filter(Path.is_file, folder.glob("*.json")):  # a pipe would never end
        with contextlib.suppress(OSError, msgspec.MsgspecError, RecursionError):
            entry = msgspec.json.decode(path.read_bytes(), type=registry.Entry)
            if registry.born(entry.pid) != entry.born:
                path.unlink()


def check_free(name: str) -> None:
    """Refuse a name that a running target of this user has.

    Raises
    ------
    Refused
        With the number of the process that has it.
    """
    for path in (Path(folder) / registry.file_name(name) for folder in registry.folders()):
        try:
            if path.stat().st_uid not in (os.getuid(), 0):
                continue  # anybody may make such a folder before its user does
            entry = msgspec.json.decode(path.read_bytes(), type=registry.Entry)
        except (OSError, msgspec.MsgspecError):
            continue
        if entry.pid != os.getpid() and entry.born and registry.born(entry.pid) == entry.born:
            raise Refused(
                f"a target named {name!r} runs here already (process {entry.pid}): stop it or"
                " choose --name"
            )
