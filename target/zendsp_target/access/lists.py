"""Reads the files of users with their passwords, and of roles."""

from __future__ import annotations

import logging
import os
import re
import stat
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

from zendsp_protocol import written
from zendsp_protocol.errors import Refused, did_you_mean
from zendsp_protocol.spelling import unknown_keys
from zendsp_protocol.verbs import ROLES

log = logging.getLogger(__name__)

_USER = re.compile(r"[A-Za-z0-9_.-]{1,64}")
OWNER = "owner"  # name that goes with the token of a loopback port


def check_secret(option: str, path: str) -> None:
    """Refuse a file of secrets that everyone may read or write; its group may read it.

    Raises
    ------
    Refused
        With the command that mends it.
    """
    if Path(path).stat().st_mode & 0o026:
        raise Refused(
            f"{option} {path}: others may read or write it, and come in with what stands there:"
            f" chmod 600 {path}"
        )


def _text(path: str) -> str:
    """The text of a regular file. A pipe or a device is refused, since reading it might never end.
    """
    if not stat.S_ISREG(os.stat(path).st_mode):
        raise OSError("it is a pipe, a device or a folder; expected a regular file")
    return Path(path).read_text(encoding="utf-8")


def read_users(path: str) -> dict[str, str]:
    """Users and passwords of a file of lines ``user:password``.

    Raises
    ------
    Refused
        The file cannot be read, is empty or cut, names a user twice, or one that cannot stand in a
        key; or others may read it. Zenoh would let everybody in on an empty file.
    """
    try:
        text = _text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise Refused(
            f"--users {path}: cannot be read ({error}); nobody is let in without it"
        ) from error
    users: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), 1):
        user, colon, password = line.partition(":")
        if not colon or not password or not _USER.fullmatch(user):
            raise Refused(
                f"--users {path}, line {number}: expected user:password, the user of letters,"
                " digits, '_', '-' or '.'"
            )
        if user == OWNER:
            raise Refused(
                f"--users {path}, line {number}: the user {OWNER!r} is the target's own; choose"
                " another name"
            )
        if user in users:
            raise Refused(f"--users {path}, line {number}: the user {user!r} stands there twice")
        users[user] = password
    if not users:
        raise Refused(f"--users {path}: names no user; an empty file would let everybody in")
    if not text.endswith("\n"):
        raise Refused(
            f"--users {path}: the last line does not end: was the file cut off? End it with a new"
            " line"
        )
    check_secret("--users", path)
    return users


def read_roles(path: str) -> dict[str, str]:
    """Roles by name of user or certificate, from a TOML file with a table ``[roles]``. Users whom
    `zendsp keys revoke` revoked stand in a table ``[revoked]``.

    Raises
    ------
    Refused
        The file cannot be read, others may write it, a role is none of `ROLES`, or somebody has one
        who was revoked.
    """
    try:
        data = written.toml(_text(path))
        writable = Path(path).stat().st_mode & 0o022
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise Refused(
            f"--roles {path}: cannot be read ({error}); nobody is let in without it"
        ) from error
    if writable:
        raise Refused(
            f"--roles {path}: others may write it, and so give themselves any role: chmod go-w"
            f" {path}"
        )
    if said := unknown_keys(data, ("roles", "revoked"), f"--roles {path}: the file"):
        raise Refused(said)
    roles = data.get("roles")
    if not isinstance(roles, dict) or not roles:
        raise Refused(
            f'--roles {path}: expected a table [roles] with lines like anna = "tune"'
            f' ({", ".join(ROLES)})'
        )
    revoked = data.get("revoked", {})
    if not isinstance(revoked, dict):
        raise Refused(f"--roles {path}: expected a table [revoked], as 'keys revoke' writes it")
    for name, role in roles.items():
        if name in revoked:
            raise Refused(
                f"--roles {path}: {name!r} has a role and was revoked as well; a certificate that"
                " leaked would be let in again: give the person another name"
            )
        if not _USER.fullmatch(name) or name == OWNER:
            raise Refused(
                f"--roles {path}: {name!r}: use letters, digits, '_', '-' or '.', and not {OWNER!r}"
            )
        if role not in ROLES:
            raise Refused(
                f"--roles {path}: {name} = {role!r} is no role; {did_you_mean(str(role), ROLES)}"
            )
    return dict(roles)


class RolesFile(Mapping[str, str]):
    """The roles of a file as it is now: a role that is taken out of it is gone with the next
    request.

    While the file is damaged nobody has a role. Names that were not in it when the target started
    are not let in.

    Raises
    ------
    Refused
        As `read_roles`.
    """

    def __init__(self, path: str) -> None:
        self._path = path
        self._seen = self._stamp()
        self._roles = read_roles(path)

    def _stamp(self) -> tuple[int, ...]:
        try:
            found = os.stat(self._path)
        except OSError:
            return ()
        return found.st_mtime_ns, found.st_ctime_ns, found.st_size, found.st_ino

    def _now(self) -> dict[str, str]:
        stamp = self._stamp()
        if stamp != self._seen:
            try:
                self._roles = read_roles(self._path)
            except Refused as error:
                log.error("nobody has a role from now on: %s", error)
                self._roles = {}
            self._seen = stamp
        return self._roles

    def __getitem__(self, name: str) -> str:
        return self._now()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._now())

    def __len__(self) -> int:
        return len(self._now())
