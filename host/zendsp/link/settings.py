"""Zenoh settings of a host, and the credentials that it needs beyond this computer."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass

import zenoh

from zendsp.errors import LinkError
from zendsp_protocol.certificates import begins, decoded, ended, shown_to_have_ended, unfit

LEASE_MS = 1000  # a dead target is noticed within this time; the default of 10 s would hide it
# protocol/host:port, or what Zenoh has besides: protocol/path
ADDRESS = re.compile(r"(tcp|tls|udp|quic|ws)/.+:\d+([?#].*)?|(?!(tcp|tls|udp|quic|ws)/)[\w-]+/.+")


@dataclass(frozen=True)
class Credentials:
    """The credentials of this host.

    Attributes
    ----------
    authority : str
        Certificate (PEM) of the authority that signed the target's certificate.
    certificate, key : str
        This host's certificate and private key (PEM), where the target asks for one.
    user, password : str
        Where the target asks for these.
    """

    authority: str = ""
    certificate: str = ""
    key: str = ""
    user: str = ""
    password: str = ""
    own: bool = False  # of a target of this user on this machine, by its entry

    @property
    def identity(self) -> str:
        """Name under which the target knows this host: its user, or the common name of its
        certificate; empty for its own user.
        """
        if self.own:
            return ""
        return self.user or (common_name(self.certificate) if self.certificate else "")

    @classmethod
    def from_environment(cls) -> Credentials:
        """The credentials in ``ZENDSP_TLS_CA``, ``ZENDSP_TLS_CERT``, ``ZENDSP_TLS_KEY``,
        ``ZENDSP_USER`` and ``ZENDSP_PASSWORD``.
        """
        names = (
            "ZENDSP_TLS_CA", "ZENDSP_TLS_CERT", "ZENDSP_TLS_KEY", "ZENDSP_USER", "ZENDSP_PASSWORD",
        )
        authority, certificate, key, user, password = (os.environ.get(name, "") for name in names)
        return cls(authority, certificate, key, user, password)


def common_name(certificate: str) -> str:
    """The common name of a certificate (PEM), empty where it has none."""
    subject = decoded(certificate).get("subject", ())
    return next((value for row in subject for name, value in row if name == "commonName"), "")


def zenoh_config(
    endpoints: Sequence[str], credentials: Credentials, timeout: float, mode: str = "peer"
) -> zenoh.Config:
    """Settings of a host's session: it listens nowhere, connects to ``endpoints`` only, and
    reconnects after an outage.

    Parameters
    ----------
    endpoints : sequence of str
        For example ``tcp/127.0.0.1:7447``; any one that answers will do.
    timeout : float, s
        For the first connection.
    mode : str
        ``"peer"``, or ``"client"``: of a router.

    Raises
    ------
    LinkError
        A file of the credentials cannot be read, or a certificate comes without its key: over the
        link, either would only look like silence.
    """
    _check(credentials)
    settings: dict[str, object] = {
        "mode": mode,
        "listen/endpoints": [],
        "connect/endpoints": list(endpoints),
        "connect/timeout_ms": int(timeout * 1000),
        # Otherwise a peer opens "successfully" although nobody answered.
        "connect/exit_on_failure": True,
        "connect/retry": {
            "period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5,
        },
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,
        "open/return_conditions/connect_scouted": False,
        "transport/link/tx/lease": LEASE_MS,
        # Each closed session would leave a segment open in this process, and containers often have
        # 64 MB of it in all.
        "transport/shared_memory/enabled": False,
    }
    if credentials.authority:
        settings["transport/link/tls/root_ca_certificate"] = credentials.authority
    if credentials.certificate:
        settings["transport/link/tls/connect_certificate"] = credentials.certificate
        settings["transport/link/tls/connect_private_key"] = credentials.key
        settings["transport/link/tls/enable_mtls"] = True
    if credentials.user:
        settings["transport/auth/usrpwd/user"] = credentials.user
        settings["transport/auth/usrpwd/password"] = credentials.password
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _check(credentials: Credentials) -> None:
    files = {
        "authority (ZENDSP_TLS_CA)": credentials.authority,
        "certificate (ZENDSP_TLS_CERT)": credentials.certificate,
        "key (ZENDSP_TLS_KEY)": credentials.key,
    }
    for what, file in files.items():
        if file and not os.access(file, os.R_OK):
            raise LinkError(f"the {what} {file!r} cannot be read: give the path of a PEM file")
    if bool(credentials.certificate) != bool(credentials.key):
        raise LinkError(
            "a certificate needs its key and a key its certificate: give both ZENDSP_TLS_CERT and"
            " ZENDSP_TLS_KEY"
        )


def doubts(credentials: Credentials, endpoints: Sequence[str]) -> str:
    """The visible faults of addresses and credentials in words, for a target that does not answer.
    They do not prevent connecting, since the clock of this computer may be wrong.
    """
    for endpoint in endpoints:
        if not ADDRESS.fullmatch(endpoint):
            return f"{endpoint!r} is no address; one is tls/robot.lab:7447, for example"
    try:
        _check(credentials)
    except LinkError as error:
        return str(error)
    for what, file, renewed in (
        ("certificate", credentials.certificate, "'zendsp keys user NAME --role ROLE --renew'"),
        ("authority", credentials.authority, "'zendsp keys init'"),
    ):
        if file and (day := ended(file)):
            return f"the {what} {file} ended on {day}: {renewed} makes another"
        if file and (day := begins(file)):
            return f"the {what} {file} begins on {day} only: set this computer's clock"
    if credentials.certificate and unfit(credentials.certificate, credentials.key):
        return f"the key {credentials.key} does not belong to {credentials.certificate}"
    for endpoint in endpoints:
        if day := shown_to_have_ended(endpoint):
            return (
                f"the certificate that it shows ended on {day}: 'zendsp keys target NAME' makes"
                " another there, with which the target is to be started again"
            )
    return ""
