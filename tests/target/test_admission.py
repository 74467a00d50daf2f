"""Access: files and options that would let in everybody are refused."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from zendsp_protocol import kept
from zendsp_protocol.errors import Refused
from zendsp_protocol.verbs import ROLES, VERBS
from zendsp_target.access import admission
from zendsp_target.access.admission import Doors, access_control, check_role, settle
from zendsp_target.access.endpoints import Security, check
from zendsp_target.access.lists import read_roles, read_users
from zendsp_target.access.registration import Registration, own_folder, users_file


def write(path: Path, text: str) -> str:
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "names no user; an empty file would let everybody in"),
        ("\n", "line 1: expected user:password"),
        ("anna\n", "line 1: expected user:password"),
        ("anna:\n", "line 1: expected user:password"),
        (":secret\n", "line 1: expected user:password"),
        ("anna:secret\nbo", "line 2: expected user:password"),
        ("anna:secret\nbo:sec", "was the file cut off"),
        ("anna:secret\nanna:other\n", "stands there twice"),
        ("an/na:secret\n", "line 1: expected user:password"),
        ("owner:secret\n", "is the target's own"),
    ],
)
def test_a_users_file_that_is_empty_cut_or_doubtful_is_refused(
    tmp_path: Path, text: str, words: str
) -> None:
    with pytest.raises(Refused, match=words):
        settle("imi", [], [], Security(users=write(tmp_path / "users", text)))


def test_a_users_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Refused, match="cannot be read"):
        read_users(str(tmp_path / "none"))
    path = write(tmp_path / "users", "anna:secret\nbo:x:y\n")
    os.chmod(path, 0o640)
    assert read_users(path) == {"anna": "secret", "bo": "x:y"}


@pytest.mark.timeout(10)
@pytest.mark.parametrize("option", ["users", "roles"])
def test_a_list_that_would_never_end_is_refused_at_once(tmp_path: Path, option: str) -> None:
    pipe = str(tmp_path / "pipe")
    os.mkfifo(pipe, 0o600)  # to open it waits for somebody who writes
    with pytest.raises(Refused, match=f"--{option} {pipe}: .* expected a regular file"):
        settle("imi", [], [], Security(**{option: pipe}))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected a table"),
        ("[roles]\n", "expected a table"),
        ('[roles]\nanna = "tuna"\n', "did you mean tune"),
        ('[roles]\nowner = "tune"\n', "owner"),
        ("[roles\n", "cannot be read"),
        ('[roles]\nanna = "tune"\n[revokd]\n', "did you mean revoked"),
        ('[roles]\nanna = "tune"\n[revoked]\nanna = "2026-01-01"\n', "revoked as well"),
        ('revoked = ["anna"]\n[roles]\nbo = "tune"\n', "a table .revoked."),
    ],
)
def test_an_ambiguous_roles_file_is_refused(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(Refused, match=words):
        read_roles(write(tmp_path / "roles.toml", text))


def test_a_roles_file_that_others_may_write_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "roles.toml", '[roles]\nanna = "tune"\n')
    os.chmod(path, 0o666)
    with pytest.raises(Refused, match="others may write it"):
        read_roles(path)
    os.chmod(path, 0o644)
    assert read_roles(path) == {"anna": "tune"}


@pytest.mark.parametrize("mode", [0o644, 0o620, 0o602, 0o604])
def test_passwords_that_others_may_read_or_write_are_refused(tmp_path: Path, mode: int) -> None:
    path = write(tmp_path / "users", "anna:secret\n")
    os.chmod(path, mode)
    with pytest.raises(Refused, match=r"others may read or write it.*chmod 600"):
        read_users(path)


@pytest.mark.parametrize("mode", [0o644, 0o602])
def test_a_private_key_that_others_may_read_or_write_is_refused(tmp_path: Path, mode: int) -> None:
    certificate, key, users = (write(tmp_path / n, "anna:secret\n") for n in ("c", "k", "u"))
    os.chmod(users, 0o600)
    os.chmod(key, mode)
    security = Security(certificate, key, users=users)
    with pytest.raises(Refused, match=r"others may read or write it.*chmod 600"):
        settle("imi", ["tls/127.0.0.1:0"], [], security)
    os.chmod(key, 0o640)
    assert settle("imi", ["tls/127.0.0.1:0"], [], security).users["anna"] == "secret"


def test_every_verb_needs_a_role() -> None:
    assert [verb.name for verb in VERBS.values() if verb.role not in ROLES] == []


def test_what_runs_code_or_moves_the_machine_needs_the_role_for_it() -> None:
    """Written out a second time on purpose: an entry of the table is not lowered by a slip of the
    pen.
    """
    at_least = {
        role: {v.name for v in VERBS.values() if ROLES.index(v.role) >= n}
        for n, role in enumerate(ROLES)
    }
    assert at_least["download"] == {"compile", "load", "unload"}
    assert at_least["command"] - at_least["download"] == {
        "start", "pause", "set_limits", "set_drive", "set_ramp", "set_overrun", "set_inputs",
        "home", "acknowledge", "drive",
    }
    assert at_least["tune"] >= {
        "write", "update", "table_begin", "table_chunk", "table_commit", "acquire_configure",
    }


@pytest.mark.parametrize("verb", VERBS.values(), ids=lambda verb: verb.name)
def test_a_role_includes_those_before_it_and_nobody_is_kept_from_stop(verb: object) -> None:
    needed = ROLES.index(verb.role)  # type: ignore[attr-defined]
    for role in ("", *ROLES):
        allowed = verb.name in ("stop", "stopped", "status",
            "info") or (role and ROLES.index(role) >= needed)  # type: ignore[attr-defined]
        if allowed:
            check_role("anna", role, verb)  # type: ignore[arg-type]
        else:
            with pytest.raises(Refused, match="anna has"):
                check_role("anna", role, verb)  # type: ignore[arg-type]


def test_a_user_without_a_role_is_refused_at_the_start(tmp_path: Path) -> None:
    users = write(tmp_path / "users", "anna:a\nbo:b\n")
    os.chmod(users, 0o600)
    roles = write(tmp_path / "roles.toml", '[roles]\nanna = "tune"\n')
    with pytest.raises(Refused, match=r"bo would get no answer, without a role in .*roles\.toml"):
        settle("imi", [], [], Security(users=users, roles=roles))
    write(tmp_path / "roles.toml", '[roles]\nanna = "tune"\nbo = "observe"\n')
    doors = settle("imi", [], [], Security(users=users, roles=roles))
    assert doors.sentence == "lets in: anna (tune), bo (observe)"


def test_a_person_in_no_list_has_no_role() -> None:
    doors = Doors((), roles={"anna": "tune"})
    assert (doors.role_of("anna"), doors.role_of("bo"), doors.role_of("")) == (
        "tune", "", "download",
    )


@pytest.mark.parametrize(
    ("doors", "user", "own"),
    [
        (Doors(("unixsock-stream/run/imi.sock",)), "", True),
        (Doors(("tcp/127.0.0.1:7447",), users={"owner": "x"}, token=("owner", "x")), "owner", True),
        (
            Doors(("unixsock-stream/run/imi.sock", "tls/0.0.0.0:7447"), users={"anna": "x"}),
            "",
            True,
        ),
        (
            Doors(("unixsock-stream/run/imi.sock", "tls/0.0.0.0:7447"), users={"anna": "x"}),
            "anna",
            False,
        ),
        (Doors(("tls/0.0.0.0:7447",), roles={"anna": "download"}), "anna", False),
        (Doors(("unixsock-stream/run/imi.sock", "tls/0.0.0.0:7447")), "", False),
        (Doors(("unixsock-stream/run/imi.sock",), routed=True), "", False),
    ],
)
def test_code_of_others_is_not_compiled_where_the_compiler_could_read_every_file(
    doors: Doors, user: str, own: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(admission, "landlock_version", lambda: 0)
    if own:
        doors.check_upload(user)
    else:
        with pytest.raises(Refused, match="no Landlock"):
            doors.check_upload(user)
    monkeypatch.setattr(admission, "landlock_version", lambda: 1)
    doors.check_upload(user)


def test_a_loopback_port_needs_a_token_that_only_this_user_can_read(tmp_path: Path) -> None:
    doors = settle("imi", ["tcp/127.0.0.1:0"], [], Security())
    user, password = doors.token
    assert doors.users == {user: password} and len(password) == 48
    with users_file("imi", doors.users) as path:
        assert os.stat(path).st_mode & 0o777 == 0o600
    assert not os.path.exists(path)
    assert access_control("imi", doors)["default_permission"] == "deny"


def test_a_loopback_port_beside_one_for_certificates_is_refused_without_users(
    tmp_path: Path,
) -> None:
    pems = [write(tmp_path / name, "") for name in ("one.pem", "one.key", "ca.pem")]
    os.chmod(pems[1], 0o600)
    with pytest.raises(
        Refused,
        match=r"--tls-ca without --roles: whoever has a certificate.*'zendsp keys' makes it",
    ):
        settle("imi", ["tls/0.0.0.0:7447"], [], Security(*pems))
    files = Security(*pems, roles=write(tmp_path / "roles.toml", '[roles]\nanna = "tune"\n'))
    assert settle("imi", ["tls/0.0.0.0:7447"], [], files).sentence == "lets in: anna (tune)"
    with pytest.raises(Refused, match="every user of this computer"):
        settle("imi", ["tls/0.0.0.0:7447", "tcp/127.0.0.1:0"], [], files)
    assert settle("imi", ["tls/0.0.0.0:7447", "here"], [], files).token == ("", "")


def test_a_folder_that_others_may_use_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    open_to_all = tmp_path / "open"
    open_to_all.mkdir()
    open_to_all.chmod(0o755)
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(open_to_all))
    with pytest.raises(Refused, match="chmod 700"):
        own_folder()


def test_a_file_in_the_place_of_the_folder_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run").touch()
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(tmp_path / "run"))
    with pytest.raises(Refused, match=r"cannot be made a folder .* set ZENDSP_RUNTIME_DIR"):
        own_folder()


@pytest.mark.skipif(os.getuid() != 0, reason="only root can make a link of another user")
def test_a_link_that_another_user_can_turn_leads_nowhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own, link = tmp_path / "own", tmp_path / "link"
    own.mkdir(mode=0o700)
    link.symlink_to(own)
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(link))
    assert own_folder() == link
    os.lchown(link, 65534, 65534)
    with pytest.raises(Refused, match="belongs to another user"):
        own_folder()


def test_a_link_in_shared_memory_is_no_folder_of_a_killed_target(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever planted it could redirect it to files of this user between two checks."""
    folder = tmp_path / "zendsp-1"
    folder.mkdir(mode=0o700)
    (folder / kept.LOCK).touch()
    (tmp_path / "zendsp-2").symlink_to(folder)
    monkeypatch.setattr(kept, "base", lambda: tmp_path)
    with kept.abandoned() as folders:
        assert list(folders) == [folder]


@pytest.mark.parametrize(
    ("security", "words"),
    [
        (Security(), "needs --tls-cert and --tls-key and --tls-ca or --users"),
        (Security(authority="ca.pem"), "needs --tls-cert and --tls-key$"),
        (Security(certificate="one.pem", authority="ca.pem"), "needs --tls-cert and --tls-key$"),
        (Security("one.pem", "one.key"), "needs --tls-ca or --users$"),
    ],
)
def test_what_others_can_reach_needs_encryption_and_hosts_that_say_who_they_are(
    security: Security, words: str
) -> None:
    for endpoint in ("tls/192.0.2.1:7447", "quic/[2001:db8::1]:7447", "tls/robot.lab:7447"):
        with pytest.raises(Refused, match=words):
            check([endpoint], security)
        check([endpoint], Security("one.pem", "one.key", authority="ca.pem"))
        check([endpoint], Security("one.pem", "one.key", users="users"))


def test_an_entry_that_a_full_disk_does_not_take_is_refused_by_its_name_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(tmp_path / "run"))
    full = own_folder() / f"imi.{os.getpid()}.part"
    full.symlink_to("/dev/full")
    with pytest.raises(Refused, match=r"run/imi\.json: cannot be written: No space left"):
        Registration("imi", ["tcp/127.0.0.1:1"], "imi_planar")
    assert not any((tmp_path / "run").iterdir())


def test_what_a_killed_target_left_is_removed_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "run"
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(folder))
    listen = "unixsock-stream/{}/{}.sock"
    code = """
import os, sys, time, zenoh
from zendsp_target.access.registration import Registration
config = zenoh.Config()
config.insert_json5("listen/endpoints", f'["{sys.argv[2]}"]')
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
entry = Registration(sys.argv[1], [sys.argv[2]], "imi_planar")
print("there", flush=True)
time.sleep(3600)
"""

    def begin(name: str) -> subprocess.Popen[str]:
        words = [sys.executable, "-c", code, name, listen.format(folder, name)]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None and process.stdout.readline() == "there\n"
        return process

    folder.mkdir(mode=0o700)
    os.mkfifo(folder / "pipe.json")
    (folder / "endless.json").symlink_to("/dev/zero")
    first, other = begin("first"), begin("next")
    try:
        assert os.stat(folder / "first.json").st_mode & 0o077 == 0, "it may hold a token"
        first.kill()
        first.wait()
        assert (folder / "first.sock").exists()
        last = begin("last")
        try:
            left = sorted(path.name for path in folder.glob("[!pe]*"))
        finally:
            last.kill()
            last.communicate()
    finally:
        for process in (first, other):
            process.kill()
            process.wait()
    assert left == [f"{n}.{s}" for n in ("last", "next") for s in ("json", "sock", "sock.lock")]
