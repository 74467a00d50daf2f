"""A link that is cut while changes are under way: none is lost, none is made twice, and of none it is unknown."""

from __future__ import annotations

import json
import random
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

from journey import Installed
from proxy import Proxy

CUTS = 12  # of the short version
PROGRAM = """#include "isr.h"
static double a;
void UserInit(void) { PARAMETER(a, 0.0, "", NO_MIN, NO_MAX, ""); }
void UserISR_INT2(void) {}
void UserBackground(void) {}
"""
HOST = r"""
import json, sys, threading, time
import zendsp
port = int(sys.argv[1])
told, unknown, k = [], [], 0
with zendsp.connect("cut", connect=f"tcp/127.0.0.1:{port}") as t:
    t.download("a.c"); t.start()
    print("ready", flush=True)
    over = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), over.set()), daemon=True).start()
    while not over.is_set():
        k += 1
        try:
            if k % 3:
                told.append((k, t.update(a=float(k))))
            else:
                t.write(a=float(k)); told.append((k, -1))
        except zendsp.errors.ZendspError as error:
            unknown.append((k, f"{type(error).__name__}: {error}"))
    time.sleep(0.1)
    log = [(c.new, c.tick) for c in t.log() if c.name == "a"]
print(json.dumps({"told": told, "unknown": unknown, "log": log}))
"""


def cut_links(host: list[str], folder: Path, env: dict[str, str], port: int, cuts: int, seed: int = 1) -> dict[str, int]:
    """Cut the link of a host that updates without a pause; returns counts: cuts, updates, lost, doubled, unknown, wrong samples."""
    proxy = Proxy(("127.0.0.1", port))
    draw = random.Random(seed)
    process = subprocess.Popen(
        [*host, str(proxy.port)], cwd=folder, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n", process.communicate()[1]
        for _ in range(cuts):
            time.sleep(draw.uniform(0.05, 0.3))
            proxy.cut()
        time.sleep(2.5)
        out, error = process.communicate("end\n", timeout=60)
    finally:
        process.kill()
        process.wait()
        proxy.close()
    assert process.returncode == 0, error
    found = json.loads(out.splitlines()[-1])
    log = [(int(value), tick) for value, tick in found["log"]]
    applied = [value for value, _ in log]
    ticks = dict(log)
    told = [(k, tick) for k, tick in found["told"]]
    for line in found["unknown"][:5]:
        print(line, file=sys.stderr)
    return {
        "cuts": cuts,
        "updates": len(told),
        "lost": sum(k not in ticks for k, _ in told),
        "doubled": len(applied) - len(set(applied)),
        "late": sum(b < a for a, b in pairwise(applied)),
        "unknown": len(found["unknown"]),
        "wrong": sum(tick not in (-1, ticks.get(k)) for k, tick in told),
    }


def test_no_change_is_lost_doubled_late_or_unknown_over_cut_links(installed: Installed) -> None:
    installed.write("a.c", PROGRAM)
    script = installed.write("host.py", HOST)
    installed.target("cut", "imi_planar", "--listen", "tcp/127.0.0.1:0")
    (path,) = Path(installed.env["ZENDSP_RUNTIME_DIR"]).glob("*.json")
    entry = json.loads(path.read_text())  # as the target's own user, through a port that the registry does not know
    (endpoint,) = entry["endpoints"]
    env = {**installed.env, "ZENDSP_USER": entry["user"], "ZENDSP_PASSWORD": entry["password"]}
    host = [str(installed.python), str(script)]
    counts = cut_links(host, installed.folder, env, int(endpoint.rpartition(":")[2]), CUTS)
    assert counts["updates"] > 50, counts
    assert {k: v for k, v in counts.items() if k not in ("cuts", "updates")} == dict.fromkeys(("lost", "doubled", "late", "unknown", "wrong"), 0), counts
