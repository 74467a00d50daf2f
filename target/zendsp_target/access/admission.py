"""Who may come in, and what for: users, roles, the token of this computer's own user, and Zenoh's
access control.

A link that moves a machine, and that brings code to run, is not for everyone: neither on the
network nor on this computer. Beyond this computer it needs TLS and a way to tell who connects
(`endpoints`). Here it is a socket that only the target's own user can open, or a port on the
loopback with a token that only this user can read. Hosts can ask, listen and show that they are
there, and nothing else: only the target answers and publishes under its name.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from zendsp_isr.confine import landlock_version
from zendsp_protocol import keys, registry
from zendsp_protocol.certificates import begins, ended, ends_within
from zendsp_protocol.errors import Refused
from zendsp_protocol.verbs import ROLES, Verb
from zendsp_target.access.endpoints import Security, check, check_connect, is_local
from zendsp_target.access.lists import OWNER, RolesFile, check_secret, read_users

LONGEST_SOCKET = 107  # bytes of its path, sockaddr_un of Linux
# need no role: without the others, nobody could connect to stop it, and see that it stopped
OPEN = ("stop", "stopped", "status", "info")
ENCRYPTED = ("tls", "quic")
SOON_DAYS = 30.0  # a certificate that ends within them is told of at the start
EVERYWHERE = f"{keys.ROOT}/**"


@dataclass(frozen=True)
class Doors:
    """Where a target listens and who may come in, settled before the machine is touched.

    Attributes
    ----------
    endpoints : tuple of str
    security : Security
    users : mapping of str to str
        Passwords of those who must show one; with the token's where there is one.
    roles : mapping of str to str, or None
        None: everyone who is let in may do everything.
    token : tuple of str
        User and password that only this user can read; empty where no port needs one.
    routed : bool
        Hosts come through a router as well.
    """

    endpoints: tuple[str, ...]
    security: Security = field(default_factory=Security)
    users: Mapping[str, str] = field(default_factory=dict)
    roles: Mapping[str, str] | None = None
    token: tuple[str, str] = ("", "")
    routed: bool = False

    @property
    def named(self) -> tuple[str, ...]:
        """Users or certificates that are let in by name."""
        return (
            tuple(self.roles)
            if self.roles is not None
            else tuple(user for user in self.users if user != OWNER)
        )

    @property
    def sentence(self) -> str:
        """Who is let in by name, and with which role, in a sentence; empty where nobody is."""
        who = ", ".join(f"{name} ({self.role_of(name)})" for name in self.named)
        return f"lets in: {who}" if who else ""

    @property
    def ending(self) -> str:
        """That a certificate of the target ends soon, in a sentence; empty where none does."""
        for file in (self.security.certificate, self.security.authority):
            if file and (day := ends_within(file, SOON_DAYS)):
                return f"{file} ends on {day}: no host comes in from then on, not even to stop"
        return ""

    def role_of(self, user: str) -> str:
        """The role of a user whom the access control let in, empty where the user has none."""
        if not user or user == OWNER or self.roles is None:
            return ROLES[-1]
        return self.roles.get(user, "")

    def check_upload(self, user: str) -> None:
        """Refuse to compile source of other users where the kernel cannot keep the compiler from
        reading files of the target's user.

        Parameters
        ----------
        user : str
            Whom the access control let in; empty for the target's own user, and for all where
            nobody is known by name.

        Raises
        ------
        Refused
            There is no Landlock, and this may be somebody else. The target's own user may read
            these files anyway.
        """
        nameless = self.roles is None and not set(self.users) - {OWNER}
        beyond = self.routed or any(e.startswith(("tls/", "quic/")) for e in self.endpoints)
        own = user == OWNER or (not user and not (nameless and beyond))
        if not own and landlock_version() < 1:
            raise Refused(
                f"this target does not compile for {user or 'others'}: its kernel has no Landlock"
                " (Linux 5.13), so .incbin could take in files of the target's user. Compile on"
                " the target's own computer with --listen here alone, or use a newer kernel"
            )


def may(role: str, verb: Verb) -> bool:
    """Whether a role includes a verb. An empty role includes the verbs that are open to everyone.
    """
    return verb.name in OPEN or (role in ROLES and ROLES.index(role) >= ROLES.index(verb.role))


def check_role(user: str, role: str, verb: Verb) -> None:
    """Refuse a verb that a user's role does not include. STOP, and seeing that it stopped, are open
    to everyone who was let in.

    Raises
    ------
    Refused
        Naming the role that is needed, the one there is, and who can change it.
    """
    if not may(role, verb):
        has = f"has the role {role!r}" if role else "has none"
        raise Refused(
            f"{verb.name!r} needs the role {verb.role!r}; {user} {has}. Roles are in the file given"
            " to the target with --roles"
        )


def own_socket(name: str) -> str:
    """The endpoint that only this user can open: a socket, or a loopback port where the socket's
    path would be too long.
    """
    path = Path(registry.folder()).absolute() / registry.socket_name(name)
    return (
        f"unixsock-stream/{path}" if len(os.fsencode(path)) <= LONGEST_SOCKET else "tcp/127.0.0.1:0"
    )


def _protocol(endpoint: str) -> str:
    return endpoint.partition("/")[0]


def settle(name: str, listen: Sequence[str], connect: Sequence[str], security: Security) -> Doors:
    """Return where the target listens and who may come in, after all checks.

    Parameters
    ----------
    name : str
        Of the target.
    listen, connect : sequence of str
        Endpoints; ``here``, and an empty ``listen``: the socket that only this user can open.

    Raises
    ------
    Refused
        What is missing, unreadable or would let in everybody.
    """
    endpoints = tuple(own_socket(name) if e == "here" else e for e in listen or ("here",))
    check(endpoints, security)
    check_connect(connect, security)
    _check_files(security)
    users = read_users(security.users) if security.users else {}
    roles = RolesFile(security.roles) if security.roles else None
    if roles is not None and (without := [user for user in users if user not in roles]):
        raise Refused(
            f"--users {security.users}: {', '.join(without)} would get no answer, without a role in"
            f' {security.roles}: add a line there, {without[0]} = "observe" for example, or take'
            f" {without[0]} out of the users"
        )
    _check_router(endpoints, connect, users, roles)
    if (
        roles is None
        and not users
        and security.authority
        and any(_protocol(e) in ENCRYPTED for e in endpoints)
    ):
        raise Refused(
            "--tls-ca without --roles: whoever has a certificate of that authority could do"
            " everything, under any name. Name those who may come in, and what for, in a file:"
            " --roles FILE with lines like anna = \"download\" ('zendsp keys' makes it)"
        )
    sockets = [e for e in endpoints if e.startswith("unixsock-stream/")]
    certified = [e for e in endpoints if e.startswith(("tls/", "quic/")) and security.authority]
    exposed = [e for e in endpoints if is_local(e) and e not in (*sockets, *certified)]
    beside = [e for e in endpoints if e not in (*sockets, *exposed)]
    if exposed and beside and not users:
        raise Refused(
            f"--listen {exposed[0]} can be reached by every user of this computer: beside"
            f" {beside[0]} it needs --users; or leave it out, and listen with --listen here on the"
            " socket that only you can open"
        )
    token = (OWNER, os.urandom(24).hex()) if users or exposed else ("", "")
    return Doors(
        endpoints,
        security,
        {**users, token[0]: token[1]} if token[0] else {},
        roles,
        token,
        bool(connect),
    )


def _check_files(security: Security) -> None:
    """Refuse certificate files that cannot be read or have expired, and a key that others may read.
    """
    for option, file in (
        ("cert", security.certificate),
        ("key", security.key),
        ("ca", security.authority),
    ):
        if file and not (os.path.isfile(file) and os.access(file, os.R_OK)):
            raise Refused(
                f"--tls-{option} {file}: cannot be read; expected a PEM file ('zendsp keys' makes"
                " them)"
            )
    for option, file in (("cert", security.certificate), ("ca", security.authority)):
        if file and (day := ended(file)):
            raise Refused(
                f"--tls-{option} {file}: ended on {day}, so no host would come in, not even to"
                f" stop: 'zendsp keys {'target' if option == 'cert' else 'init'}' makes another (or"
                " is this computer's clock wrong?)"
            )
        if file and (day := begins(file)):
            raise Refused(
                f"--tls-{option} {file}: begins on {day} only, so no host would come in, not even"
                " to stop: set this computer's clock (or the clock of the one that made it was"
                " wrong)"
            )
    if security.key:
        check_secret("--tls-key", security.key)


def _check_router(
    endpoints: Sequence[str], connect: Sequence[str], users: Collection[str], roles: object
) -> None:
    """Refuse passwords and roles where they would not hold, because hosts may come through a
    router.
    """
    both = {_protocol(e) for e in connect} & {_protocol(e) for e in endpoints}
    if both and users:
        raise Refused(
            f"--connect {', '.join(connect)} and --listen over {', '.join(sorted(both))}: a host"
            " could not be told from the router, for which --users does not hold. Listen there or"
            " connect to the router, not both; the router has rules of its own"
        )
    if connect and roles is not None:
        raise Refused(
            f"--roles with --connect {', '.join(connect)}: roles do not hold behind a router, since"
            " the target cannot see who asks there. Leave out --roles and let the router decide"
            " who comes in, or have hosts connect to the target itself"
        )


class _Rules:
    """The three lists of Zenoh's access control: rules, subjects, and which rule is for whom."""

    def __init__(self) -> None:
        self.rules: list[dict[str, object]] = []
        self.subjects: list[dict[str, object]] = []
        self.policies: list[dict[str, object]] = []
        asks = ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query")
        says = ("reply", "liveliness_token", "declare_queryable", *asks)
        self._common = [
            self._rule("say", "egress", says, (EVERYWHERE,)),
            self._rule("listen", "ingress", asks, (EVERYWHERE,)),
        ]

    def _rule(self, number: str, flow: str, messages: Sequence[str], wanted: Sequence[str]) -> str:
        self.rules.append(
            {
                "id": number,
                "permission": "allow",
                "flows": [flow],
                "messages": list(messages),
                "key_exprs": list(wanted),
            }
        )
        return number

    def admit(
        self,
        number: str,
        who: Mapping[str, object],
        asked: Sequence[str],
        there: str,
        told: Sequence[str],
    ) -> None:
        """Let in a subject. ``asked``: keys that it may query; ``there``: where it may show that it
        is present; ``told``: keys that are published to it.
        """
        rights = [
            self._rule(f"ask {number}", "ingress", ("query",), (keys.info(), *asked)),
            self._rule(f"show {number}", "ingress", ("liveliness_token",), (there,)),
            self._rule(f"tell {number}", "egress", ("put", "delete"), told),
        ]
        self.subjects.append({"id": number, **who})
        self.policies.append({"rules": [*self._common, *rights], "subjects": [number]})


def access_control(name: str, doors: Doors, connect: Sequence[str] = ()) -> dict[str, object]:
    """Zenoh's access control for the session of a target.

    Hosts may send requests, subscribe, and show that they are present. Everything else that they
    send is dropped. A host that is known by name may do so, and receive live rows, under that name
    only. Without these rules a client could answer in place of the target, publish false rows to
    other hosts, or go on reading after its role was taken away.

    Parameters
    ----------
    name : str
        Of the target.
    connect : sequence of str
        Routers to which it connects: whom they let in is theirs to decide.

    Returns
    -------
    dict
        The value of ``access_control``.
    """
    table = _Rules()
    everything = (keys.rpc(name, "*"), keys.rpc(name, "*", "*"), keys.variable("*", "**"))
    own = {"link_protocols": ["unixsock-stream"]} if not doors.users else {"usernames": [OWNER]}
    table.admit(OWNER, own, everything, keys.host(name, "**"), (EVERYWHERE,))
    for user in doors.named:
        asked = (keys.rpc(name, "*", user), keys.variable(name, "**", user))
        told = (keys.event(name), keys.live(name, user=user))
        there = keys.host(name, f"{user}@$*")
        for field_name in ("usernames", "cert_common_names"):
            table.admit(f"{field_name} {user}", {field_name: [user]}, asked, there, told)
    if connect:
        protocols = {"link_protocols": sorted({_protocol(endpoint) for endpoint in connect})}
        table.admit("routers", protocols, everything, keys.host(name), (EVERYWHERE,))
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": table.rules,
        "subjects": table.subjects,
        "policies": table.policies,
    }
