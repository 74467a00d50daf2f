"""Where the target listens and under which conditions, and the Zenoh settings that follow.

Loopback is for this computer; anything else needs TLS and a way to tell who connects. Who may come
in is `admission`'s.
"""

from __future__ import annotations

import ipaddress
import json
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import zenoh

from zendsp_protocol.codec import MOST_REQUEST
from zendsp_protocol.errors import Refused

LEASE_MS = 1000  # a stopped or unplugged host is noticed within this time
# packets of 64 kB that may wait for the link: the most that Zenoh takes, and a whole chunk of a
# recording
BULK_QUEUE = 16
STRANGERS = 100_000  # that may wait at a port; open files are fewer


@dataclass(frozen=True)
class Security:
    """Files that make a link beyond loopback acceptable.

    Attributes
    ----------
    certificate, key : str
        This target's certificate and private key (PEM).
    authority : str
        Certificate of the authority that signs the hosts' certificates: hosts must then show one.
    users : str
        File of lines ``user:password``: hosts must then know one.
    roles : str
        TOML file whose table ``[roles]`` gives names of users or certificates their role. Empty:
        everyone who is let in may do everything.
    """

    certificate: str = ""
    key: str = ""
    authority: str = ""
    users: str = ""
    roles: str = ""

    @property
    def encrypted(self) -> bool:
        """Whether certificate and key are given."""
        return bool(self.certificate and self.key)

    @property
    def authenticated(self) -> bool:
        """Whether a host must prove who it is."""
        return bool(self.authority or self.users)


def is_local(endpoint: str) -> bool:
    """Whether only this computer can reach ``endpoint``."""
    scheme, _, rest = endpoint.partition("/")
    if scheme == "unixsock-stream":
        return True
    host = rest.partition("#")[0].partition("?")[0].rpartition(":")[0].strip("[]").partition("%")[0]
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check(endpoints: Sequence[str], security: Security) -> None:
    """Refuse endpoints that others could reach without encryption and authentication.

    Raises
    ------
    Refused
        Naming the endpoint and the options that are missing.
    """
    for endpoint in endpoints:
        if "/" not in endpoint:
            raise Refused(
                f"--listen {endpoint}: expected protocol/address:port, for example tcp/127.0.0.1:0"
            )
        if is_local(endpoint):
            continue
        if endpoint.partition("/")[0] not in ("tls", "quic"):
            raise Refused(
                f"--listen {endpoint} can be reached from other machines: use tls/… there, with"
                " --tls-cert, --tls-key and either --tls-ca (hosts show a certificate) or --users"
                " (hosts know a password)"
            )
        if not security.encrypted or not security.authenticated:
            missing = [] if security.encrypted else ["--tls-cert and --tls-key"]
            missing += [] if security.authenticated else ["--tls-ca or --users"]
            raise Refused(
                f"--listen {endpoint} can be reached from other machines and needs"
                f" {' and '.join(missing)}"
            )


def check_connect(endpoints: Sequence[str], security: Security) -> None:
    """Refuse routers on other computers that the target could not tell from an impostor: who
    answers in a router's place could command the target.

    Raises
    ------
    Refused
        Naming the endpoint and what is missing.
    """
    for endpoint in endpoints:
        if is_local(endpoint):
            continue
        if endpoint.partition("/")[0] not in ("tls", "quic") or not security.authority:
            raise Refused(
                f"--connect {endpoint} leads to another machine: use tls/… and --tls-ca, which"
                " proves who it is"
            )


def with_free_ports(endpoints: Sequence[str]) -> list[str]:
    """The endpoints, with a port that is free now in place of port 0: Zenoh does not say which one
    it would take.
    """
    chosen = []
    for endpoint in endpoints:
        address, colon, port = endpoint.rpartition(":")
        if colon and port == "0":
            host = address.partition("/")[2].strip("[]")
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            with socket.socket(family, socket.SOCK_STREAM) as probe:
                probe.bind((host, 0))
                endpoint = f"{address}:{probe.getsockname()[1]}"
        chosen.append(endpoint)
    return chosen


def zenoh_config(
    endpoints: Sequence[str],
    security: Security,
    connect: Sequence[str] = (),
    access: Mapping[str, object] | None = None,
    users: str = "",
) -> zenoh.Config:
    """Settings of the target's session, each for a measured reason.

    Parameters
    ----------
    endpoints : sequence of str
        Where to listen.
    connect : sequence of str
        Routers to announce the target to.
    access : mapping, optional
        As of `access_control`.
    users : str
        File of users and passwords, checked.
    """
    settings: dict[str, object] = {
        "mode": "peer",
        "listen/endpoints": list(endpoints),
        "connect/endpoints": list(connect),
        "connect/exit_on_failure": False,
        # The default waits half a second for others to be heard of; nothing is announced by
        # multicast here.
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,  # hosts of one target need not know of each other
        "scouting/delay": 0,
        "open/return_conditions/connect_scouted": False,
        # the default lets a hundred strangers who say nothing keep every host out
        "transport/unicast/accept_pending": STRANGERS,
        # the largest is a program of 16 MB, and what is larger is put together nowhere: whoever may
        # look could otherwise fill the memory
        "transport/link/rx/max_message_size": MOST_REQUEST,
        "transport/link/tx/lease": LEASE_MS,  # the default of 10 s hides a dead host for 10 s
        # the recorder needs what there is; and see the host's settings
        "transport/shared_memory/enabled": False,
        # Two packets of 64 kB, the default, make sender and link wait for each other 16 times a
        # MiB. What is urgent has queues of its own, which the link empties first.
        "transport/link/tx/queue/size/data_low": BULK_QUEUE,
        "connect/retry": {
            "period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5,
        },
    }
    if security.encrypted:
        settings["transport/link/tls/listen_certificate"] = security.certificate
        settings["transport/link/tls/listen_private_key"] = security.key
        settings["transport/link/tls/connect_certificate"] = security.certificate
        settings["transport/link/tls/connect_private_key"] = security.key
    if security.authority:
        settings["transport/link/tls/root_ca_certificate"] = security.authority
        settings["transport/link/tls/enable_mtls"] = True
    if users:
        settings["transport/auth/usrpwd/dictionary_file"] = users
    if access:
        settings["access_control"] = access
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config
