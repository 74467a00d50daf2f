"""A lab's authority, the certificates that it signs, and the list of who may do what: plain files
in one folder.

    lab/ca.pem              the authority's certificate: every target and every host has a copy
    lab/ca.key              its private key: stays on one computer, makes new certificates
    lab/roles.toml          who may do what; each target has a copy (--roles)
    lab/targets/NAME.pem    certificate of a target, with NAME.key: stay on that target
    lab/users/NAME.pem      certificate of a person, with NAME.key: stay with that person

A certificate's common name is the name in ``roles.toml``. A target's certificate cannot be used as
a person's, nor the other way round: neither name may be given twice, and each says what it is for.
"""

from __future__ import annotations

import ipaddress
import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import tomli_w

from zendsp.errors import Refused
from zendsp.extras import need
from zendsp_protocol import written
from zendsp_protocol.errors import did_you_mean
from zendsp_protocol.verbs import ROLES

AUTHORITY_DAYS = 3650
DAYS = 730  # of a target's or a person's certificate
_BEFORE = timedelta(hours=1)  # clocks of a lab differ
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
_TAKEN = ("owner",)  # the name of a target's own user


@dataclass(frozen=True)
class Holder:
    """Whom the authority knows.

    Attributes
    ----------
    name : str
    kind : str
        ``"target"`` or ``"user"``.
    role : str
        Of a user; ``"revoked"`` for one who has none any more.
    until : datetime
        When the certificate ends.
    certificate, key : Path
    """

    name: str
    kind: str
    role: str
    until: datetime
    certificate: Path
    key: Path

    @property
    def ended(self) -> bool:
        """Whether nobody is let in with it any more."""
        return self.until < datetime.now(UTC)


class Lab:
    """The keys of a lab in a folder.

    Parameters
    ----------
    folder : path
        As :meth:`create` made it.

    Raises
    ------
    Refused
        There is no authority, or others may read its key.

    Examples
    --------
    >>> lab = Lab.create("lab")                                     # doctest: +SKIP
    >>> lab.add_target("imi", ["robot.lab"])                        # doctest: +SKIP
    >>> lab.add_user("anna", "tune")                                # doctest: +SKIP
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.authority = self.folder / "ca.pem"
        self.roles_file = self.folder / "roles.toml"
        self._key = self.folder / "ca.key"
        if not self._key.is_file() or not self.authority.is_file():
            raise Refused(
                f"{self.folder} holds no authority (ca.pem, ca.key): 'zendsp keys init' makes one,"
                " --folder says where it is"
            )
        if self._key.stat().st_mode & 0o077:
            raise Refused(
                f"others may read {self._key}, and with it make keys for any role: chmod 600"
                f" {self._key}"
            )

    @classmethod
    def create(cls, folder: str | Path, days: int = AUTHORITY_DAYS) -> Lab:
        """Make a new authority.

        Parameters
        ----------
        folder : path
            Made where it is not there; only this user may look into it.
        days : int
            How long it signs.

        Raises
        ------
        Refused
            There is one already.
        """
        folder = Path(folder)
        if (folder / "ca.key").exists() or (folder / "ca.pem").exists():
            raise Refused(
                f"{folder} holds an authority already; a new one would make all its certificates"
                " useless: choose --folder"
            )
        x509 = _x509()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.chmod(0o700)
        key = _new_key()
        name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "zendsp lab authority")])
        builder = (
            _builder(name, name, key.public_key(), days)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(sign_certificates=True), critical=True)
        )
        _write(folder / "roles.toml", b"[roles]\n", 0o644)
        _write(folder / "ca.key", _private(key), 0o600)
        _write(folder / "ca.pem", _pem(builder.sign(key, _hash())), 0o644)
        return cls(folder)

    def add_target(self, name: str, hosts: Sequence[str] = (), days: int = DAYS) -> Holder:
        """Make key and certificate of a target, good for the names and addresses under which hosts
        reach it.

        Parameters
        ----------
        hosts : sequence of str
            For example ``["robot.lab", "192.168.1.5"]``; ``localhost`` and ``127.0.0.1`` are always
            among them.

        Raises
        ------
        Refused
            The name is a person's, or none.
        """
        x509 = _x509()
        self._check_name(name, "target")
        reached = [
            _general(x509, host) for host in dict.fromkeys((*hosts, "localhost", "127.0.0.1"))
        ]
        # also a client's: a target connects to routers
        purposes = [x509.ExtendedKeyUsageOID.SERVER_AUTH, x509.ExtendedKeyUsageOID.CLIENT_AUTH]
        return self._issue(name, "target", days, purposes, x509.SubjectAlternativeName(reached))

    def add_user(self, name: str, role: str, days: int = DAYS, renew: bool = False) -> Holder:
        """Give a person a role, and a key and a certificate where there is none yet.

        Parameters
        ----------
        role : str
            ``"observe"``, ``"tune"``, ``"command"`` or ``"download"``; each includes those before
            it.
        renew : bool
            A new key and certificate also where there is one.

        Raises
        ------
        Refused
            No such role; or the name is a target's, none, or was revoked.
        """
        if role not in ROLES:
            raise Refused(f"{role!r} is no role; {did_you_mean(role, ROLES)}")
        self._check_name(name, "user")
        lists = self._lists()
        if name in lists["revoked"]:
            raise Refused(
                f"{name!r} was revoked on {lists['revoked'][name]}; its old certificate would be"
                " let in again under that name: choose another, for example "
                + f"{name}2"
            )
        known = self._holder(name, "user", role)
        if known is None or renew:
            x509 = _x509()
            known = self._issue(name, "user", days, [x509.ExtendedKeyUsageOID.CLIENT_AUTH], None)
        lists["roles"][name] = role
        self._keep(lists)
        return Holder(name, "user", role, known.until, known.certificate, known.key)

    def revoke(self, name: str) -> None:
        """Take a person's role away; the certificate says who it is still, and opens nothing.

        Raises
        ------
        Refused
            Nobody of that name has a role.
        """
        lists = self._lists()
        if name not in lists["roles"]:
            raise Refused(f"{name!r} has no role here; {did_you_mean(name, lists['roles'])}")
        del lists["roles"][name]
        lists["revoked"][name] = datetime.now(UTC).date().isoformat()
        self._keep(lists)

    def holders(self) -> list[Holder]:
        """Everyone with a certificate: targets first, then people, by name."""
        lists = self._lists()
        roles = {**dict.fromkeys(lists["revoked"], "revoked"), **lists["roles"]}
        found = []
        for kind in ("target", "user"):
            for path in sorted((self.folder / f"{kind}s").glob("*.pem")):
                holder = self._holder(
                    path.stem, kind, roles.get(path.stem, "") if kind == "user" else ""
                )
                if holder is not None:
                    found.append(holder)
        return found

    def _check_name(self, name: str, kind: str) -> None:
        if not _NAME.fullmatch(name) or name in _TAKEN:
            raise Refused(
                f"{kind} {name!r}: use 1 to 64 letters, digits, '_', '-' or '.', and not"
                f" {_TAKEN[0]!r}"
            )
        other = "user" if kind == "target" else "target"
        if (self.folder / f"{other}s" / f"{name}.pem").exists():
            raise Refused(
                f"{name!r} is the name of a {other} here: its certificate could be taken for the"
                f" {kind}'s; choose another"
            )

    def _lists(self) -> dict[str, dict[str, str]]:
        try:
            data = written.toml(self.roles_file.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise Refused(f"{self.roles_file} cannot be read: {error}") from error
        return {
            name: {str(k): str(v) for k, v in data.get(name, {}).items()}
            for name in ("roles", "revoked")
        }

    def _keep(self, lists: dict[str, dict[str, str]]) -> None:
        shown = {
            "roles": lists["roles"],
            **({"revoked": lists["revoked"]} if lists["revoked"] else {}),
        }
        _write(self.roles_file, tomli_w.dumps(shown).encode(), 0o644)

    def _holder(self, name: str, kind: str, role: str) -> Holder | None:
        path = self.folder / f"{kind}s" / f"{name}.pem"
        if not path.exists():
            return None
        try:
            until = _x509().load_pem_x509_certificate(path.read_bytes()).not_valid_after_utc
        except (OSError, ValueError) as error:
            raise Refused(f"{path} is no certificate: {error}") from error
        return Holder(name, kind, role, until, path, path.with_suffix(".key"))

    def _issue(
        self, name: str, kind: str, days: int, purposes: Sequence[Any], reached: Any
    ) -> Holder:
        x509 = _x509()
        authority = x509.load_pem_x509_certificate(self.authority.read_bytes())
        load = need(
            "cryptography.hazmat.primitives.serialization", "keys", "zendsp keys"
        ).load_pem_private_key
        signer = load(self._key.read_bytes(), None)
        if authority.public_key() != signer.public_key():
            raise Refused(
                f"{self._key} is not the key of {self.authority}: one of them is from another"
                " authority"
            )
        until = datetime.now(UTC) + timedelta(days=days)
        if until > authority.not_valid_after_utc:
            left = (authority.not_valid_after_utc - datetime.now(UTC)).days
            raise Refused(
                f"{days} days is longer than the authority itself is good for ({left} days): --days"
                f" {max(left, 1)}, or a new one"
            )
        key = _new_key()
        subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
        builder = (
            _builder(subject, authority.subject, key.public_key(), days)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(sign_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
        )
        if reached is not None:
            builder = builder.add_extension(reached, critical=False)
        certificate = builder.sign(signer, _hash())
        folder = self.folder / f"{kind}s"
        folder.mkdir(mode=0o700, exist_ok=True)
        _write(folder / f"{name}.key", _private(key), 0o600)
        _write(folder / f"{name}.pem", _pem(certificate), 0o644)
        return Holder(
            name, kind, "", certificate.not_valid_after_utc, folder / f"{name}.pem",
            folder / f"{name}.key",
        )


def _x509() -> Any:
    return need("cryptography.x509", "keys", "zendsp keys", Refused)


def _new_key() -> Any:
    elliptic = need("cryptography.hazmat.primitives.asymmetric.ec", "keys", "zendsp keys", Refused)
    return elliptic.generate_private_key(elliptic.SECP256R1())


def _hash() -> Any:
    return need("cryptography.hazmat.primitives.hashes", "keys", "zendsp keys", Refused).SHA256()


def _private(key: Any) -> bytes:
    form = need("cryptography.hazmat.primitives.serialization", "keys", "zendsp keys", Refused)
    data: bytes = key.private_bytes(
        form.Encoding.PEM, form.PrivateFormat.PKCS8, form.NoEncryption()
    )
    return data


def _pem(certificate: Any) -> bytes:
    form = need("cryptography.hazmat.primitives.serialization", "keys", "zendsp keys", Refused)
    data: bytes = certificate.public_bytes(form.Encoding.PEM)
    return data


def _builder(subject: Any, issuer: Any, public: Any, days: int) -> Any:
    if days < 1:
        raise Refused(f"{days} days: a certificate is good for one day or more")
    x509, now = _x509(), datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _BEFORE)
        .not_valid_after(now + timedelta(days=days))
    )


def _usage(sign_certificates: bool) -> Any:
    return _x509().KeyUsage(
        digital_signature=not sign_certificates, content_commitment=False, key_encipherment=False,
        data_encipherment=False, key_agreement=False, key_cert_sign=sign_certificates,
        crl_sign=sign_certificates, encipher_only=False, decipher_only=False,
    )


def _general(x509: Any, host: str) -> Any:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    try:
        return x509.DNSName(host)
    except ValueError as error:
        raise Refused(
            f"--host {host}: expected a name or an address, for example robot.lab or 192.168.1.5"
        ) from error


def _write(path: Path, data: bytes, mode: int) -> None:
    """Write a file whole or not at all; nobody else reads a private one at any moment."""
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    part.unlink(missing_ok=True)
    try:
        with open(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
            os.fchmod(file.fileno(), mode)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise Refused(f"{path}: cannot be written: {error.strerror}") from error
