"""A lab's keys: each holder may do what the list of roles says, and nothing else."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from click.testing import CliRunner
from waiting import until

import zendsp
from zendsp import lab_keys
from zendsp.cli.keys import command as keys
from zendsp.errors import LinkError, Refused
from zendsp.lab_keys import Holder, Lab
from zendsp.link import connect
from zendsp.link.settings import Credentials, common_name, doubts
from zendsp_target.access.admission import settle
from zendsp_target.access.endpoints import Security
from zendsp_target.monitor import Monitor, Options
from zendsp_target.runtime import Runtime

x509 = pytest.importorskip("cryptography.x509", reason="zendsp keys needs cryptography")
Open = Callable[..., Monitor]


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    return Lab.create(tmp_path / "lab")


@pytest.fixture
def start(runtime: Runtime) -> Iterator[Open]:
    """Start a target with a certificate of a lab, for those with one."""
    running: list[Monitor] = []

    def begin(lab: Lab, holder: Holder, roles: bool = True) -> Monitor:
        files = Security(
            str(holder.certificate),
            str(holder.key),
            str(lab.authority),
            "",
            str(lab.roles_file) if roles else "",
        )
        running.append(
            Monitor(runtime, Options("fake", "imi_planar", ["tls/127.0.0.1:0"], (), files))
        )
        return running[-1]

    yield begin
    for monitor in running:
        monitor.close()


def enter(monitor: Monitor, lab: Lab, holder: Holder, timeout: float = 5.0) -> zendsp.link.Target:
    given = Credentials(str(lab.authority), str(holder.certificate), str(holder.key))
    return connect("fake", monitor.endpoints[0], given, timeout)


def test_a_person_may_do_what_the_list_says_now(lab: Lab, start: Open) -> None:
    target, anna = lab.add_target("imi"), lab.add_user("anna", "observe")
    with enter(start(lab, target), lab, anna) as host:
        assert host.status().state == "empty"
        with pytest.raises(Refused, match="needs the role 'download'; anna has the role 'observe'"):
            host.download("pd.c")
        again = lab.add_user("anna", "download")
        assert again.until == anna.until, "a new role needs no new certificate"
        host.download("pd.c")
        host.start()
        host.update(Kp1=2.0)
        assert host.log()[-1].author.startswith("anna@")
        lab.revoke("anna")
        with pytest.raises(Refused, match="anna has none"):
            host.update(Kp1=3.0)
        host.request("stop")  # whoever was let in may stop it, and see that it stopped
        until(lambda: host.status().state == "stopped", "it stopped")


def test_revoking_a_person_changes_nothing_for_others(lab: Lab, start: Open) -> None:
    target, bo = lab.add_target("imi"), lab.add_user("bo", "tune")
    lab.add_user("anna", "observe")
    monitor = start(lab, target)
    with enter(monitor, lab, bo) as host:
        assert host.log() == ()
        lab.revoke("anna")
        assert host.log() == (), "of a target that ran meanwhile"
    monitor.close()
    with enter(start(lab, target), lab, bo) as host:
        assert host.log() == (), "of one that starts afterwards"


def test_whom_the_list_does_not_name_is_told_so(lab: Lab, start: Open) -> None:
    lab.add_user("anna", "observe")
    monitor = start(lab, lab.add_target("imi"))
    late = lab.add_user("bo", "observe")  # the target started without this name
    with pytest.raises(LinkError, match="or it has no role for this certificate"):
        enter(monitor, lab, late, 2.0)


def test_a_damaged_list_gives_nobody_a_role(
    lab: Lab, start: Open, caplog: pytest.LogCaptureFixture
) -> None:
    target, anna = lab.add_target("imi"), lab.add_user("anna", "download")
    with enter(start(lab, target), lab, anna) as host:
        lab.roles_file.write_text("[rol")
        with pytest.raises(Refused, match="anna has none"):
            host.limits()
        assert "nobody has a role from now on" in caplog.text
        lab.roles_file.unlink()
        with pytest.raises(Refused, match="anna has none"):
            host.limits()
        os.mkfifo(lab.roles_file, 0o600)  # the target waits for nobody who would write into it
        with pytest.raises(Refused, match="anna has none"):
            host.limits()


def test_a_person_s_name_in_a_request_is_that_of_the_certificate(lab: Lab, start: Open) -> None:
    """A request under another's name is not answered, neither in the key expression nor in the
    message.
    """
    target = lab.add_target("imi")
    anna = lab.add_user("anna", "observe")
    bo = lab.add_user("bo", "download")
    monitor = start(lab, target)
    with enter(monitor, lab, bo) as good, enter(monitor, lab, anna) as bad:
        good.download("pd.c")
        good.start()
        from zendsp_protocol import codec, keys

        def ask(key: str, by: str) -> list[bytes]:
            data = codec.encode_request("update", {"values": {"Kp1": 9.0}}, by)
            replies = bad.link.session.get(key, payload=data, timeout=1.0)
            return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]

        assert ask(keys.rpc("fake", "sync", "bo"), "bo@lab:1") == []
        assert ask(keys.rpc("fake", "sync"), "bo@lab:1") == [], "nor as the target's own user"
        (refused,) = ask(keys.rpc("fake", "sync", "anna"), "bo@lab:1")
        assert b"anna has the role 'observe'" in refused
        lab.add_user("anna", "tune")
        (done,) = ask(keys.rpc("fake", "sync", "anna"), "bo@lab:1")
        assert b"error" not in done
        assert good.log()[-1].author == "anna"


def test_nobody_is_made_present_or_absent_by_another(lab: Lab, start: Open) -> None:
    target = lab.add_target("imi")
    anna = lab.add_user("anna", "observe")
    bo = lab.add_user("bo", "download")
    monitor = start(lab, target)
    with enter(monitor, lab, bo) as good, enter(monitor, lab, anna) as bad:
        from zendsp_protocol import keys

        liveliness = bad.link.session.liveliness()
        false = [
            liveliness.declare_token(keys.host("fake", name))
            for name in (good.link.author, "bo@ghost:1")
        ]
        # what was declared before has been seen by then
        assert bad.status().hosts == good.status().hosts
        assert "bo@ghost:1" not in good.status().hosts
        for token in false:
            token.undeclare()  # type: ignore[no-untyped-call]
        bad.status()
        assert good.link.author in good.status().hosts


@pytest.mark.parametrize("what", ["another authority", "over", "to come", "a target's"])
def test_a_certificate_that_does_not_fit_opens_nothing(
    lab: Lab, start: Open, tmp_path: Path, what: str
) -> None:
    target, anna = lab.add_target("imi"), lab.add_user("anna", "download")
    monitor = start(lab, target)
    with enter(monitor, lab, anna):
        pass
    if what == "another authority":
        foreign = Lab.create(tmp_path / "other").add_user("anna", "download")
        bad = Holder("anna", "user", "", foreign.until, foreign.certificate, foreign.key)
    elif what in ("over", "to come"):
        bad = lab.add_user("anna", "download", renew=True)
        _end(lab, bad, timedelta(days=3) if what == "to come" else timedelta())
    else:
        bad = target
    words = {
        "over": "anna.pem ended on 20.*--renew", "to come": "anna.pem begins on 20.*clock",
    }.get(what, "refuses the certif|no target")
    with pytest.raises(LinkError, match=words):
        enter(monitor, lab, bad, 1.5)
    if what == "over":
        good = lab.add_user("anna", "download", renew=True)
        unfit = Holder("anna", "user", "", good.until, good.certificate, target.key)
        with pytest.raises(LinkError, match=r"imi\.key does not belong to .*anna\.pem"):
            enter(monitor, lab, unfit, 1.5)


def test_a_certificate_of_the_target_that_ended_while_it_ran_is_named(
    lab: Lab, start: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A host had read only that nothing answers, or refuses."""
    target, anna = lab.add_target("imi"), lab.add_user("anna", "download")
    _end(lab, target)
    for check in ("ended", "begins"):  # it had not when the target began
        monkeypatch.setattr(f"zendsp_target.access.admission.{check}", lambda _: "")
    monitor = start(lab, target)
    with pytest.raises(LinkError, match=r"that it shows ended on 20.*zendsp keys target NAME"):
        enter(monitor, lab, anna, 1.5)


def _end(lab: Lab, holder: Holder, later: timedelta = timedelta()) -> None:
    """Sign a certificate again, so that its two days ended an hour ago, or later."""
    from cryptography.hazmat.primitives import hashes, serialization

    old = x509.load_pem_x509_certificate(holder.certificate.read_bytes())
    signer = serialization.load_pem_private_key((lab.folder / "ca.key").read_bytes(), None)
    now = datetime.now(UTC) + later
    builder = (
        x509.CertificateBuilder()
        .subject_name(old.subject)
        .issuer_name(old.issuer)
        .public_key(old.public_key())
        .serial_number(old.serial_number)
        .not_valid_before(now - timedelta(days=2))
        .not_valid_after(now - timedelta(hours=1))
    )
    for extension in old.extensions:
        builder = builder.add_extension(extension.value, extension.critical)
    holder.certificate.write_bytes(
        builder.sign(signer, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
    )


@pytest.mark.parametrize(("days", "told"), [(29, True), (31, False)])
def test_a_target_tells_at_its_start_of_a_certificate_that_ends_soon(
    lab: Lab, days: int, told: bool
) -> None:
    """From that day on nobody comes in, and until then nothing shows it."""
    imi, roles = lab.add_target("imi", days=days), str(lab.folder / "roles.toml")
    lab.add_user("anna", "tune")
    secured = Security(str(imi.certificate), str(imi.key), str(lab.folder / "ca.pem"), roles=roles)
    doors = settle("imi", ["tls/127.0.0.1:0"], [], secured)
    assert (f"{imi.certificate} ends on 20" in doors.ending) == told
    assert bool(doors.ending) == told


def test_a_persons_key_cannot_serve_as_a_target(lab: Lab, start: Open) -> None:
    """The holder of a person's key cannot pose as a target."""
    anna, bo = lab.add_user("anna", "download"), lab.add_user("bo", "download")
    rogue = start(lab, anna)
    with pytest.raises(LinkError):
        enter(rogue, lab, bo, 1.5)


@pytest.mark.parametrize(
    "broken",
    [
        "certificate", "key", "authority", "another's key", "an empty authority", "one that ended",
        "one to come",
    ],
)
def test_a_target_does_not_start_with_files_that_do_not_fit(
    lab: Lab, runtime: Runtime, broken: str
) -> None:
    imi, other = lab.add_target("imi"), lab.add_target("other")
    empty = lab.folder / "empty.pem"
    empty.touch()
    files = {
        "certificate": str(imi.certificate), "key": str(imi.key), "authority": str(lab.authority),
    }
    if broken in files:
        files[broken] = str(lab.folder / "none.pem")
    elif broken == "another's key":
        files["key"] = str(other.key)
    elif broken in ("one that ended", "one to come"):
        _end(lab, imi, timedelta(days=3) if broken == "one to come" else timedelta())
    else:
        files["authority"] = str(empty)
    lab.add_user("anna", "tune")
    security = Security(**files, roles=str(lab.roles_file))
    words = "none.pem.*cannot be read" if broken in files else "cannot listen|(ended|begins) on 20"
    with pytest.raises((Refused, LinkError), match=words):
        Monitor(runtime, Options("fake", "imi_planar", ["tls/127.0.0.1:0"], (), security))


def test_a_router_is_never_taken_for_a_host(lab: Lab) -> None:
    imi = lab.add_target("imi")
    lab.add_user("anna", "observe")
    files = Security(
        str(imi.certificate), str(imi.key), str(lab.authority), "", str(lab.roles_file)
    )
    for listen in ("tls/127.0.0.1:0", "here"):
        with pytest.raises(Refused, match="roles do not hold behind a router"):
            settle("imi", [listen], ["tls/127.0.0.1:7447"], files)
    users = lab.folder / "passwords"
    users.write_text("anna:secret\n")
    users.chmod(0o600)
    files = Security(str(imi.certificate), str(imi.key), str(lab.authority), str(users))
    with pytest.raises(Refused, match="could not be told from the router"):
        settle("imi", ["tls/127.0.0.1:0"], ["tls/127.0.0.1:7447"], files)
    settle("imi", ["here"], ["tls/127.0.0.1:7447"], files)


def test_private_keys_are_readable_by_their_owner_only_and_names_are_unique(lab: Lab) -> None:
    imi, anna = lab.add_target("imi", ["robot.lab", "192.168.1.5"]), lab.add_user("anna", "tune")
    for key in (lab.folder / "ca.key", imi.key, anna.key):
        assert os.stat(key).st_mode & 0o777 == 0o600
    assert os.stat(lab.folder).st_mode & 0o777 == 0o700
    assert common_name(str(anna.certificate)) == "anna"
    names = x509.load_pem_x509_certificate(imi.certificate.read_bytes()).extensions
    reached = names.get_extension_for_class(x509.SubjectAlternativeName).value
    assert reached.get_values_for_type(x509.DNSName) == ["robot.lab", "localhost"]
    assert [str(ip) for ip in reached.get_values_for_type(x509.IPAddress)] == [
        "192.168.1.5", "127.0.0.1",
    ]
    for name in ("imi", "owner", "an/na", ""):
        with pytest.raises(Refused):
            lab.add_user(name, "tune")
    with pytest.raises(Refused, match="name of a user"):
        lab.add_target("anna")
    lab.revoke("anna")
    with pytest.raises(Refused, match="was revoked on"):
        lab.add_user("anna", "tune")
    assert [(h.name, h.kind, h.role) for h in lab.holders()] == [
        ("imi", "target", ""),
        ("anna", "user", "revoked"),
    ]


def test_an_authority_is_not_overwritten_nor_shared(lab: Lab, tmp_path: Path) -> None:
    with pytest.raises(Refused, match="holds an authority already"):
        Lab.create(lab.folder)
    with pytest.raises(Refused, match="holds no authority"):
        Lab(tmp_path / "none")
    (lab.folder / "ca.key").chmod(0o640)
    with pytest.raises(Refused, match="chmod 600"):
        Lab(lab.folder)


def test_a_full_disk_is_told_with_the_file_and_changes_nothing(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab.add_user("anna", "tune")
    before = lab.roles_file.read_text()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(Refused, match=r"lab/roles\.toml: cannot be written: No space left"):
        lab.add_user("anna", "command")
    assert lab.roles_file.read_text() == before and not [*lab.folder.rglob("*.part")]


def test_nothing_is_signed_for_longer_than_the_authority_lives(lab: Lab) -> None:
    with pytest.raises(Refused, match="longer than the authority"):
        lab.add_user("anna", "tune", days=4000)
    with pytest.raises(Refused, match="one day or more"):
        lab.add_user("anna", "tune", days=0)
    assert lab.holders() == []


def test_handing_out_an_expired_certificate_is_reported(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    until_then = lab.add_user("anna", "tune", days=2).until

    class Later(datetime):
        @classmethod
        def now(cls, tz: object = None) -> datetime:  # type: ignore[override]
            return until_then + timedelta(days=1)

    monkeypatch.setattr(lab_keys, "datetime", Later)
    folder = ["--folder", str(lab.folder)]
    assert f"{until_then:%Y-%m-%d} ended" in CliRunner().invoke(keys, ["list", *folder]).output
    again = ["user", "anna", "--role", "tune", *folder]
    assert "--renew makes another" in CliRunner().invoke(keys, again).output
    assert "ended on" not in CliRunner().invoke(keys, [*again, "--renew"]).output


@pytest.mark.parametrize(
    ("endpoint", "right"),
    [
        ("tls/robot.lab:7447", True), ("tcp/[::1]:7447", True), ("unixsock-stream//tmp/a", True),
        ("tcp/robot.lab:7447#iface=eth0", True),
        ("tls/robot.lab", False), ("robot.lab:7447", False), ("tcp/robot.lab:", False),
    ],
)
def test_an_address_without_a_port_or_a_protocol_is_named(endpoint: str, right: bool) -> None:
    assert doubts(Credentials(), [endpoint]) == (
        "" if right else f"{endpoint!r} is no address; one is tls/robot.lab:7447, for example"
    )


def test_a_certificate_that_is_not_there_is_named_and_not_its_key(tmp_path: Path) -> None:
    absent, key = str(tmp_path / "anna.pem"), tmp_path / "anna.key"
    key.touch()
    said = doubts(Credentials(certificate=absent, key=str(key)), ["tls/robot.lab:7447"])
    assert f"certificate (ZENDSP_TLS_CERT) {absent!r} cannot be read" in said
