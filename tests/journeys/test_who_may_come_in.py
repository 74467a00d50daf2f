"""Who may come in, and as whom: other users of the computer, rogue clients, roles over TLS."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from journey import PATIENCE_S, Installed

sys.path.insert(0, str(Path(__file__).parents[1] / "e2e"))

from helpers import make_certificates

SOMEBODY = 65534  # nobody

ROGUE = r"""
# a client without any of zendsp's manners: it offers to answer, publishes, and pretends to be there, for the target
import json, sys, time, zenoh
endpoint, user, password = sys.argv[1:4]
config = zenoh.Config()
for key, value in {"mode": "client", "connect/endpoints": [endpoint], "scouting/multicast/enabled": False,
                   "connect/timeout_ms": 2000, **({"transport/auth/usrpwd/user": user,
                   "transport/auth/usrpwd/password": password} if user else {})}.items():
    config.insert_json5(key, json.dumps(value))
session = zenoh.open(config)
lie = lambda query: (query.reply(query.key_expr, b"\x81\xa5error\x81\xa7message\xa3lie"), query.drop())
kept = [session.declare_queryable(key, lie, complete=True) for key in ("zendsp/**", *(f"zendsp/imi/rpc/{lane}"
        for lane in ("quick", "sync", "stop", "slow", "bulk")))]
kept += [session.liveliness().declare_token(key) for key in ("zendsp/ghost/alive",)]
print("here", flush=True)
end = time.monotonic() + 30
while time.monotonic() < end:
    for key in ("zendsp/imi/event", "zendsp/imi/live/1"):
        session.put(key, b"lie")
    session.delete("zendsp/imi/alive")
    time.sleep(0.001)
"""  # noqa: E501

HOST = r"""
import zendsp
with zendsp.connect("imi") as target:
    target.download("pd.c"); target.start()
    view = target.live(["q"])
    for k in range(200):
        assert target.update(Kp1=400.0 + k) > 0
        assert target["Kp1"] == 400.0 + k
    for _ in range(20):
        assert view.next_block(2.0) is not None
    assert target.alive and target.status().state == "running"
    print("true", len(target.status().hosts))
"""


def entry(user: Installed) -> dict[str, object]:
    import json

    (path,) = Path(user.env["ZENDSP_RUNTIME_DIR"]).glob("*.json")
    return dict(json.loads(path.read_text()))


@pytest.mark.parametrize("listen", ["here", "tcp/127.0.0.1:0"])
def test_a_rogue_client_answers_nothing_and_is_believed_nothing(
    installed: Installed, listen: str
) -> None:
    installed.target("imi", "imi_planar", "--listen", listen)
    found = entry(installed)
    rogue = installed.write("rogue.py", ROGUE)
    (endpoint,) = found["endpoints"]  # type: ignore[misc]
    liar = installed.start("python", rogue, endpoint, str(found["user"]), str(found["password"]))
    assert (
        liar.stdout is not None and liar.stdout.readline() == "here\n"
    ), "a rogue of the same user gets in"
    said = installed.script(HOST)
    assert said.returncode == 0 and said.stdout.startswith("true 1"), said.stdout + said.stderr
    assert "ghost" not in installed.run("ls").stdout
    assert liar.poll() is None


@pytest.mark.skipif(os.getuid() != 0, reason="only root can act as another user")
@pytest.mark.parametrize("listen", ["here", "tcp/127.0.0.1:0"])
def test_another_user_of_this_computer_is_kept_out(installed: Installed, listen: str) -> None:
    installed.target("imi", "imi_planar", "--listen", listen)
    (endpoint,) = entry(installed)["endpoints"]  # type: ignore[misc]
    code = f"""
import os, sys
import zenoh, json
os.setgid({SOMEBODY}); os.setuid({SOMEBODY})
config = zenoh.Config()
for key, value in {{"mode": "client", "connect/endpoints": [{endpoint!r}], "scouting/multicast/enabled": False,
                    "connect/timeout_ms": 1500, "connect/exit_on_failure": True}}.items():
    config.insert_json5(key, json.dumps(value))
try:
    session = zenoh.open(config)
    replies = list(session.get("zendsp/imi/info", timeout=1.0))
except zenoh.ZError:
    replies = []
print(len(replies))
os._exit(0)
"""  # noqa: E501
    said = installed.script(code)
    assert said.stdout == "0\n", said.stdout + said.stderr
    assert installed.run("info", "-t", "imi").returncode == 0, "its own user is let in all the same"


def test_an_empty_users_file_is_refused_at_start(installed: Installed) -> None:
    installed.write("users", "")
    said = installed.run("target", "--name", "imi", "--users", "users")
    assert said.returncode == 2 and "would let everybody in" in said.stderr


TLS = r"""
import sys, zendsp
from zendsp.errors import Refused
try:
    with zendsp.connect("imi") as target:
        for what in sys.argv[1:]:
            try:
                eval(what, {"target": target, "zendsp": zendsp})
                print("yes")
            except Refused as error:
                print("no:", error)
        print(target.log()[-1].author if target.log() else "nobody")
except zendsp.errors.LinkError as error:
    print("out:", error)
"""
LISTEN = ("--listen", "here", "--listen", "tls/127.0.0.1:0")
ASKED = (
    "target['Kp1']", "target.update(Kp1=410.0)", "target.pause()", "target.download('pd.c')",
    "target.stop()",
)


@pytest.mark.parametrize(
    ("role", "may"), [("observe", 1), ("tune", 2), ("command", 3), ("download", 4), (None, 0)]
)
def test_a_role_allows_what_it_says_and_stop_is_for_everyone(
    installed: Installed, tmp_path: Path, role: str | None, may: int
) -> None:
    make_certificates(tmp_path)
    installed.write(
        "roles.toml", f'[roles]\n{"two" if role else "else"} = "{role or "download"}"\n'
    )
    keys = f"--tls-cert {tmp_path}/one.pem --tls-key {tmp_path}/one.key --tls-ca {tmp_path}/ca.pem"
    installed.target("imi", "imi_planar", *LISTEN, *keys.split(), "--roles", "roles.toml")
    assert installed.run("run", "pd.c", "-t", "imi").returncode == 0
    endpoint = next(e for e in entry(installed)["endpoints"] if e.startswith("tls/"))  # type: ignore[attr-defined]
    installed.env |= {
        "ZENDSP_CONNECT": endpoint, "ZENDSP_TLS_CA": str(tmp_path / "ca.pem"),
        "ZENDSP_TLS_CERT": str(tmp_path / "two.pem"), "ZENDSP_TLS_KEY": str(tmp_path / "two.key"),
    }
    said = installed.script(TLS, *ASKED)
    if role is None:
        assert "out:" in said.stdout, said.stdout + said.stderr
        return
    answers = said.stdout.splitlines()
    assert [a == "yes" for a in answers[:5]] == [*(k < may for k in range(4)), True], (
        said.stdout + said.stderr
    )
    refused = [a for a in answers if a.startswith("no:")]
    assert all(f"two has the role '{role}'" in a for a in refused)
    assert answers[5].startswith("two@") == (may >= 2), answers


@contextlib.contextmanager
def bridged(user: Installed, env: dict[str, str]) -> Iterator[Callable[..., str]]:
    """A bridge that writes, with somebody's certificate; what a viewer asks of it."""
    pytest.importorskip("foxglove")
    connect = pytest.importorskip("websockets.sync.client").connect
    words = ("bridge", "foxglove", "-t", "imi", "--port", "0", "--write", "--json")
    bridge = user.start("zendsp", *words, env=env)
    assert bridge.stdout is not None
    url = json.loads(bridge.stdout.readline())["url"]
    with connect(url, subprotocols=["foxglove.sdk.v1"]) as socket:

        def ask(op: str, *, until: str, **values: object) -> str:
            socket.send(json.dumps({"op": op, "id": "a", **values}))
            while until not in (said := str(socket.recv(timeout=PATIENCE_S))):
                pass
            return said

        yield ask
    bridge.send_signal(signal.SIGINT)
    assert bridge.wait(PATIENCE_S) == -signal.SIGINT


def test_a_lab_makes_keys_gives_roles_and_takes_them_back(installed: Installed) -> None:
    pytest.importorskip("cryptography")
    for line in ("init", "target imi", "user anna --role observe", "user bo --role tune"):
        said = installed.run("keys", *line.split())
        assert said.returncode == 0, said.stderr
    keys = "--tls-cert lab/targets/imi.pem --tls-key lab/targets/imi.key --tls-ca lab/ca.pem"
    installed.target("imi", "imi_planar", *LISTEN, *keys.split(), "--roles", "lab/roles.toml")
    assert installed.run("run", "pd.c", "-t", "imi").returncode == 0
    anna = {
        "ZENDSP_CONNECT": next(e for e in entry(installed)["endpoints"] if e.startswith("tls/")),  # type: ignore[attr-defined]
        "ZENDSP_TLS_CA": "lab/ca.pem",
        "ZENDSP_TLS_CERT": "lab/users/anna.pem",
        "ZENDSP_TLS_KEY": "lab/users/anna.key",
    }
    assert installed.run("get", "Kp1", "-t", "imi", env=anna).returncode == 0
    refused = installed.run("set", "Kp1=410", "-t", "imi", env=anna)
    assert (
        refused.returncode == 2
        and "needs the role 'tune'; anna has the role 'observe'" in refused.stderr
    )
    with bridged(installed, anna) as ask:
        assert "2000" in ask("getParameters", parameterNames=["Kp1"], until="parameterValues")
        write = {"parameters": [{"name": "Kp1", "value": 430.0}], "until": "status"}
        assert "needs the role 'tune'; anna has the role 'observe'" in ask("setParameters", **write)
        assert installed.run("keys", "user", "anna", "--role", "tune").returncode == 0
        assert "430" in ask("setParameters", **{**write, "until": "430"})
        assert installed.run("get", "Kp1", "-t", "imi").stdout == "Kp1 = 430 N m/rad\n"
    assert installed.run("set", "Kp1=410", "-t", "imi", env=anna).returncode == 0
    assert installed.run("keys", "revoke", "anna").returncode == 0
    refused = installed.run("set", "Kp1=420", "-t", "imi", env=anna)
    assert refused.returncode == 2 and "anna has none" in refused.stderr
    bo = {name: word.replace("anna", "bo") for name, word in anna.items()}
    said = installed.run("set", "Kp1=430", "-t", "imi", env=bo)
    assert said.returncode == 0, f"revoking anna took bo's role: {said.stderr}"
    stopped = installed.run("stop", "-t", "imi", env=anna)
    assert stopped.returncode == 0, stopped.stdout + stopped.stderr
    assert "revoked" in installed.run("keys", "list").stdout
