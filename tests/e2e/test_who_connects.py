"""Who may connect, and where a target may listen."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from helpers import make_certificates
from waiting import PATIENCE_S

import zendsp
from zendsp.errors import LinkError
from zendsp.link import Target
from zendsp.link.settings import Credentials
from zendsp_protocol import registry


def test_a_planted_entry_leads_nowhere(
    fast: Target, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "shared"
    folder.mkdir(mode=0o700)
    entry = Path(registry.folder()) / registry.file_name(fast.name)
    shutil.copy(entry, folder / entry.name)
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(folder))
    assert [found.name for found in zendsp.discover()] == [fast.name]
    folder.chmod(0o777)
    assert zendsp.discover() == []
    if os.getuid() == 0:  # only root can make a link of another user
        folder.chmod(0o700)
        link = tmp_path / "link"
        link.symlink_to(folder)
        monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(link))
        assert [found.name for found in zendsp.discover()] == [fast.name]
        os.lchown(link, 65534, 65534)
        assert zendsp.discover() == [], "its owner could turn it at any time"


def test_a_socket_at_any_path_is_for_its_user_alone(
    start: Callable[..., Target], tmp_path: Path
) -> None:
    path = tmp_path / "own"
    before = os.umask(0)
    try:
        start(clock="fast", options=["--listen", f"unixsock-stream/{path}"])
    finally:
        os.umask(before)
    assert not path.stat().st_mode & 0o077


def test_two_targets_of_one_name_are_refused(start: Callable[..., Target]) -> None:
    first = start(clock="fast", name="same")
    with pytest.raises(LinkError, match=f"'same' runs here already \\(process {first.info.pid}\\)"):
        start(clock="fast", name="same")


def test_listening_beyond_loopback_is_refused_without_tls_and_authentication() -> None:
    for endpoint, words in (
        ("tcp/0.0.0.0:0", "use tls/"),
        ("udp/[::]:7447", "use tls/"),
        ("tls/192.0.2.1:7447", "needs --tls-cert and --tls-key and --tls-ca or --users"),
    ):
        command = [sys.executable, "-m", "zendsp_target", "--listen", endpoint]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
        assert done.returncode == 2 and words in done.stderr, done.stderr
        assert len(done.stderr.strip().splitlines()) == 1


def test_tls_with_a_password_or_a_certificate_lets_in_who_has_it_and_nobody_else(
    tmp_path: Path,
) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("needs the command openssl to make certificates")
    make_certificates(tmp_path)
    ca, users = str(tmp_path / "ca.pem"), tmp_path / "users"
    users.write_text("anna:secret\n")
    users.chmod(0o600)
    roles = tmp_path / "roles.toml"
    roles.write_text('[roles]\ntwo = "observe"\n')
    own = ["--tls-cert", str(tmp_path / "one.pem"), "--tls-key", str(tmp_path / "one.key")]
    password = Credentials(ca, user="anna", password="secret")
    certificate = Credentials(ca, str(tmp_path / "two.pem"), str(tmp_path / "two.key"))
    refused, nothing = "refuses the certificate or password", r"TLS_CERT.* of which none is given"
    for asked, good, bad, said in (
        (["--users", str(users)], password, replace(password, password="guess"), refused),
        (["--tls-ca", ca, "--roles", str(roles)], certificate, Credentials(ca), nothing),
    ):
        command = [
            sys.executable, "-m", "zendsp_target", "--name", "vault", "--json", "--listen",
            "tls/127.0.0.1:0", *own, *asked,
        ]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None
            endpoint = json.loads(process.stdout.readline())["endpoints"][0]
            with zendsp.connect("vault", endpoint, good, timeout=20.0) as target:
                assert target.status().state == "empty"
            with pytest.raises(LinkError, match=said):
                zendsp.connect("vault", endpoint, bad, timeout=2.0)
        finally:
            process.terminate()
            process.communicate(timeout=PATIENCE_S)
