"""Waiting with a deadline, helper processes, and a relay that can be cut."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

from waiting import PATIENCE_S

ROUTER = """
import sys, time, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", f'["{sys.argv[1]}"]')
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
print("there", flush=True)
time.sleep(3600)
"""


def python(code: str, *arguments: str) -> subprocess.Popen[str]:
    """Run Python code in a process of its own."""
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


@contextlib.contextmanager
def there(code: str, *words: str) -> Iterator[subprocess.Popen[str]]:
    """A process that runs Python code, from when it says that it is there."""
    process = subprocess.Popen(
        [sys.executable, "-c", code, *words], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None and process.stdout.readline() == "there\n"
        yield process
    finally:
        process.kill()
        process.communicate()


def kill(process: subprocess.Popen[str]) -> None:
    """End a helper the hard way."""
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=PATIENCE_S)


def running(pid: int) -> bool:
    """Tell whether a process runs (a zombie does not)."""
    from zendsp_protocol.registry import born

    return bool(born(pid))


def children(pid: int) -> list[int]:
    """Processes started by ``pid``."""
    found = []
    for task in os.listdir(f"/proc/{pid}/task"):
        with contextlib.suppress(OSError), open(f"/proc/{pid}/task/{task}/children") as file:
            found += [int(child) for child in file.read().split()]
    return found


def processor_s(pid: int) -> float:
    """Time of a processor that a process has taken, in s."""
    with open(f"/proc/{pid}/stat") as file:
        words = file.read().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def make_certificates(folder: Path) -> None:
    """Make an authority ``ca`` and two certificates signed by it, ``one`` and ``two``, good for the
    loopback.
    """

    def openssl(*arguments: str) -> None:
        subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)

    key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")
    openssl(
        "req", "-x509", *key, "-keyout", "ca.key", "-out", "ca.pem", "-days", "2", "-subj",
        "/CN=test authority",
    )
    (folder / "extensions").write_text("subjectAltName=DNS:localhost,IP:127.0.0.1\n")
    for name in ("one", "two"):
        openssl(
            "req", *key, "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}"
        )
        sign = (
            "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2", "-extfile",
            "extensions",
        )
        openssl("x509", "-req", "-in", f"{name}.csr", "-out", f"{name}.pem", *sign)


class Relay:
    """A TCP relay between host and target (its port or its socket) that a test can cut and mend."""

    def __init__(self, endpoint: str) -> None:
        self._there = endpoint.partition("/")[2]
        self._server = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._server.getsockname()[1]}"
        self._pairs: list[socket.socket] = []
        self._open = True
        self.passed = 0
        self.cut_after = -1
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._server.accept()
            except OSError:
                return
            if not self._open:
                near.close()
                continue
            if self._there.startswith("/"):
                far = socket.socket(socket.AF_UNIX)
                far.connect(self._there)
            else:
                address, _, port = self._there.rpartition(":")
                far = socket.create_connection((address, int(port)))
            self._pairs += [near, far]
            for a, b in ((near, far), (far, near)):
                threading.Thread(target=self._pump, args=(a, b), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(1 << 16):
                sink.sendall(data)
                self.passed += len(data)
                if 0 <= self.cut_after <= self.passed:
                    self.cut_after = -1
                    self.cut()

    def cut(self) -> None:
        """Break every connection and accept none."""
        self._open = False
        for end in self._pairs:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()
        self._pairs.clear()

    def mend(self) -> None:
        """Accept connections again."""
        self._open = True

    def close(self) -> None:
        """End the relay."""
        self.cut()
        self._server.close()


@contextlib.contextmanager
def relay_to(endpoint: str) -> Iterator[Relay]:
    """A relay for the length of a ``with``."""
    relay = Relay(endpoint)
    try:
        yield relay
    finally:
        relay.close()
