"""A role that is taken away ends reading too, and certificates without roles are refused at the
start.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from journey import PATIENCE_S, Installed, until

sys.path.insert(0, str(Path(__file__).parents[1] / "e2e"))

from helpers import make_certificates

# Everything that a client of her own could try to go on reading with: all keys, and a live view
# that was open before.
SPY = r"""
import sys, time, zendsp, zenoh
from zendsp.errors import Refused
with zendsp.connect("imi") as target:
    session, seen = target.link.session, []
    keep = session.declare_subscriber("zendsp/**", lambda s: seen.append(str(s.key_expr)))
    view = target.live(["q"])
    def variables():
        found = []
        for key in ("zendsp/imi/var/**", "zendsp/imi/as/two/var/**", "zendsp/**"):
            for reply in session.get(key, timeout=2.0, consolidation=zenoh.ConsolidationMode.NONE):
                found += [str(reply.ok.key_expr)] if reply.ok is not None else []
        return sum("/var/" in key for key in found)
    assert view.next_block(5.0) is not None
    print("live", any("/live/" in key for key in seen), "variables", variables() > 0, flush=True)
    assert sys.stdin.readline() == "revoked\n"
    begin = time.monotonic()
    while view.next_block(1.0) is not None:
        assert time.monotonic() < begin + 150.0, "live rows go on"
    seen.clear()
    time.sleep(1.5)  # long enough for the status to come three times
    print("live", any("/live/" in key for key in seen), "status", any("/event" in key for key in seen))
    refused = 0
    for ask in (lambda: target["q"], lambda: target.live(["q"]), lambda: target.log(), lambda: target.acquire_load()):
        try:
            ask()
        except Refused as error:
            refused += "two has none" in str(error)
    print("refused", refused, "variables", variables())
    print(target.stop().trip.reason)
"""  # noqa: E501


def start(user: Installed, folder: Path, *options: str | Path) -> dict[str, str]:
    """Start a target that asks for certificates; returns what lets `two` in."""
    make_certificates(folder)
    process = user.start(
        "zendsp",
        "target",
        "--machine",
        "imi_planar",
        "--name",
        "imi",
        "--listen",
        "here",
        "--listen",
        "tls/127.0.0.1:0",
        "--tls-cert",
        folder / "one.pem",
        "--tls-key",
        folder / "one.key",
        "--tls-ca",
        folder / "ca.pem",
        *options,
    )
    path = Path(user.env["ZENDSP_RUNTIME_DIR"]) / "imi.json"
    until(path.exists, "target registered", alive=process)
    endpoint = next(e for e in json.loads(path.read_text())["endpoints"] if e.startswith("tls/"))
    return {
        "ZENDSP_CONNECT": endpoint, "ZENDSP_TLS_CA": str(folder / "ca.pem"),
        "ZENDSP_TLS_CERT": str(folder / "two.pem"), "ZENDSP_TLS_KEY": str(folder / "two.key"),
    }


def test_who_is_revoked_reads_nothing_any_more_and_can_still_stop(
    installed: Installed, tmp_path: Path
) -> None:
    roles = installed.write("roles.toml", '[roles]\ntwo = "observe"\none = "tune"\n')
    env = start(installed, tmp_path, "--roles", roles)
    assert installed.run("run", "pd.c", "-t", "imi").returncode == 0
    installed.write("spy.py", SPY)
    installed.env |= env
    spy = installed.start("python", "spy.py", stdin=subprocess.PIPE)
    assert spy.stdout is not None and spy.stdin is not None
    assert spy.stdout.readline() == "live True variables True\n"
    roles.write_text('[roles]\none = "tune"\n')
    said, _ = spy.communicate("revoked\n", timeout=PATIENCE_S)
    assert said.splitlines() == ["live False status True", "refused 4 variables 0", "stop"], said


MOVER = """
import sys, time, zendsp
with zendsp.connect("imi") as target:
    target.download("pd.c")
    target.take_command()
    target.start()
    print(target.drive_status().commander.startswith("two@"), flush=True)
    assert sys.stdin.readline() == "revoked\\n"
    begin = time.monotonic()
    while target.status().trip is None and time.monotonic() < begin + 60.0:
        time.sleep(0.05)
    print(target.status().trip.reason, repr(target.drive_status().commander))
    try:
        target.acknowledge()
    except zendsp.errors.Refused as error:
        print(error)
"""


def test_who_commands_and_is_revoked_lets_go_as_a_host_that_is_lost(
    installed: Installed, tmp_path: Path
) -> None:
    roles = installed.write("roles.toml", '[roles]\ntwo = "download"\n')
    installed.env |= start(installed, tmp_path, "--roles", roles)
    installed.write("mover.py", MOVER)
    mover = installed.start("python", "mover.py", stdin=subprocess.PIPE)
    assert mover.stdout is not None and mover.stdout.readline() == "True\n"
    roles.write_text('[roles]\ntwo = "tune"\n')
    said, _ = mover.communicate("revoked\n", timeout=PATIENCE_S)
    first, second = said.splitlines()
    assert first == "host lost ''" and "two has the role 'tune'" in second, said


RUNS = """
import sys, time, zendsp
with zendsp.connect("imi") as target:
    target.request("run_begin", names=["Kp1"], moves=True)
    print(target.drive_status().moved_by.startswith("two@"), flush=True)
    assert sys.stdin.readline() == "revoked\\n"
    begin = time.monotonic()
    while target.status().trip is None and time.monotonic() < begin + 60.0:
        time.sleep(0.05)
    print(target.status().trip.reason)
"""


def test_whose_run_moves_the_machine_and_is_revoked_lets_go_too(
    installed: Installed, tmp_path: Path
) -> None:
    """A run needs no more than the role `tune`."""
    roles = installed.write("roles.toml", '[roles]\ntwo = "tune"\none = "tune"\n')
    env = start(installed, tmp_path, "--roles", roles)
    assert installed.run("run", "pd.c", "-t", "imi").returncode == 0
    installed.write("runs.py", RUNS)
    owner = dict(installed.env)
    installed.env |= env
    runs = installed.start("python", "runs.py", stdin=subprocess.PIPE)
    assert runs.stdout is not None and runs.stdout.readline() == "True\n"
    roles.write_text('[roles]\none = "tune"\n')
    said, _ = runs.communicate("revoked\n", timeout=PATIENCE_S)
    assert said == "host lost\n", said
    installed.env = owner


def test_certificates_without_roles_are_refused_and_the_start_says_who_is_let_in(
    installed: Installed, tmp_path: Path
) -> None:
    make_certificates(tmp_path)
    listen = (
        "--name",
        "imi",
        "--listen",
        "tls/127.0.0.1:0",
        "--tls-cert",
        tmp_path / "one.pem",
        "--tls-key",
        tmp_path / "one.key",
    )
    said = installed.run("target", *listen, "--tls-ca", tmp_path / "ca.pem")
    assert (
        said.returncode == 2
        and "--roles" in said.stderr
        and "whoever has a certificate" in said.stderr
    )
    roles = installed.write("roles.toml", '[roles]\ntwo = "download"\none = "tune"\n')
    said = installed.run(
        "target",
        *listen,
        "--tls-ca",
        tmp_path / "ca.pem",
        "--roles",
        roles,
        "--connect",
        "unixsock-stream//tmp/nobody",
    )
    assert said.returncode == 2 and "roles do not hold behind a router" in said.stderr, said.stderr
    target = installed.start(
        "zendsp", "target", *listen, "--tls-ca", tmp_path / "ca.pem", "--roles", roles
    )
    assert target.stdout is not None
    lines = [target.stdout.readline() for _ in range(3)]
    assert any("lets in: two (download), one (tune)" in line for line in lines), lines


@pytest.mark.parametrize("roles", [True, False])
def test_the_log_names_who_the_password_or_the_certificate_says(
    installed: Installed, tmp_path: Path, roles: bool
) -> None:
    if roles:
        env = start(
            installed,
            tmp_path,
            "--roles",
            installed.write("roles.toml", '[roles]\ntwo = "download"\n'),
        )
        name = "two"
    else:
        make_certificates(tmp_path)
        installed.write("users", "anna:secret\n").chmod(0o600)
        process = installed.start(
            "zendsp", "target", "--name", "imi", "--listen", "tcp/127.0.0.1:0", "--users", "users"
        )
        path = Path(installed.env["ZENDSP_RUNTIME_DIR"]) / "imi.json"
        until(path.exists, "target registered", alive=process)
        env = {
            "ZENDSP_CONNECT": json.loads(path.read_text())["endpoints"][0],
            "ZENDSP_USER": "anna",
            "ZENDSP_PASSWORD": "secret",
        }
        name = "anna"
    installed.env |= env
    said = installed.script(
        "import zendsp\n"
        "with zendsp.connect('imi') as target:\n"
        "    target.download('pd.c')\n"
        "    target.link.author = 'somebody.else@lab:1'\n"
        "    for k in range(5):  # the second and later ones are known by their bytes\n"
        "        target.write(Kp1=410.0 + k)\n"
        "    target.update(Kp1=420.0)\n"
        "    print({change.author for change in target.log()}, len(target.log()))\n"
        "    open('roles.toml', 'w').write('[roles]\\none = \"tune\"\\n')\n"
        "    try:\n"
        "        target.write(Kp1=430.0)\n"
        "    except zendsp.errors.Refused as error:\n"
        "        print(error)\n"
    )
    told = said.stdout.splitlines()
    assert told[0] == f"{{{name!r}}} 6", said.stdout + said.stderr
    assert len(told) == (2 if roles else 1) and (not roles or "two has none" in told[1]), told
