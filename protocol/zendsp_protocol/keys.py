"""Zenoh keys. Every key begins with ``zendsp/<target>/``."""

from __future__ import annotations

import re

from zendsp_protocol.texts import shown

ROOT = "zendsp"
LANES = ("quick", "sync", "stop", "slow", "bulk")
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")


def check_name(name: str) -> str:
    """Return ``name`` if it can be the name of a target.

    Raises
    ------
    ValueError
        Empty, longer than 64 characters, with characters that keys cannot hold, or of points
        alone, which a path takes for a folder.
    """
    if not _NAME.fullmatch(name) or not name.strip("."):
        raise ValueError(
            f"target name {name!r}: use 1 to 64 letters, digits, '_', '-' or '.', not '.' alone"
        )
    return name


def rpc(target: str, lane: str, user: str = "") -> str:
    """Key of requests: one queryable for each lane, so that slow work never delays a STOP.

    A host that the target knows by name (password or certificate) asks under that name; the
    target's access control lets it ask under no other. A host of the target's own user, through its
    socket, has no name.
    """
    return f"{_room(target, user)}/rpc/{lane}"


def _room(target: str, user: str) -> str:
    return f"{ROOT}/{target}/as/{user}" if user else f"{ROOT}/{target}"


def user_of(key: str) -> str:
    """The name under which a request was sent, empty for the target's own user."""
    parts = key.split("/")
    return parts[3] if parts[2] == "as" else ""


def alive(target: str = "*") -> str:
    """Liveliness token of a target; ``zendsp/*/alive`` finds them all."""
    return f"{ROOT}/{target}/alive"


def ended(target: str) -> str:
    """Liveliness token of a target that ends by itself, shown before :func:`alive` goes. A target
    that was killed or cut off has none.
    """
    return f"{alive(target)}/ended"


def farewell(target: str, safe: bool) -> str:
    """Liveliness token of a target that ends by itself, shown last of all, once its program has
    ended: whether its machine is in its safe state.
    """
    return f"{ended(target)}/{'safe' if safe else 'unsafe'}"


def life(target: str) -> str:
    """All these tokens of a target."""
    return f"{alive(target)}/**"


def host(target: str, host_id: str = "*") -> str:
    """Liveliness token of a host connected to ``target``."""
    return f"{ROOT}/{target}/host/{host_id}"


def left(target: str, host_id: str = "*") -> str:
    """Liveliness token of a host that leaves by itself, shown before :func:`host` goes. One that
    was killed, or whose link a busy computer lost, has none.
    """
    return f"{host(target, host_id)}/left"


def info(target: str = "*") -> str:
    """Queryable: who the target is."""
    return f"{ROOT}/{target}/info"


def variable(target: str, name: str = "*", user: str = "") -> str:
    """Queryable: the value of one variable; array elements are read whole."""
    return f"{_room(target, user)}/var/{name}"


def live(target: str, stream: int | str = "*", user: str = "") -> str:
    """Key on which the newest samples of a live stream are published; for a host that is known by
    name it contains the name.
    """
    return f"{_room(target, user)}/live/{stream}"


def event(target: str = "*") -> str:
    """Publication: the status, whenever the state changes and at least twice a second."""
    return f"{ROOT}/{target}/event"


def target_of(key: str) -> str:
    """Name of the target in a key."""
    return shown(key.split("/")[1], lines=False)


def host_of(key: str) -> str:
    """Name of the host in the key of one of its tokens."""
    return shown(key.split("/")[3], lines=False)
