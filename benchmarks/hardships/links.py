"""Links that are cut while changes are under way."""

from __future__ import annotations

import json
import random
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

from hardships.place import Place, Tally

sys.path[:0] = [str(Path(__file__).parents[2] / room) for room in ("tests", "tests/e2e")]

from helpers import relay_to  # noqa: E402

PROMISE = "over cut links no change is lost, made twice, out of order, or told wrongly"
CUTS = 12  # of a round
SETTLE_S = 2.5  # for the last cut to be noticed and mended, before the host is told to end
PROGRAM = """#include "isr.h"
static double a;
void UserInit(void) { PARAMETER(a, 0.0, "", NO_MIN, NO_MAX, ""); }
void UserISR_INT2(void) {}
void UserBackground(void) {}
"""
HOST = r"""
import json, sys, threading, time
import zendsp
told, unknown, k = [], [], 0
with zendsp.connect("cut", connect=sys.argv[1]) as t:
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


def rounds(place: Place, tally: Tally) -> Iterator[None]:
    """See the module."""
    (place.folder / "a.c").write_text(PROGRAM)
    draw = random.Random(1)
    while True:
        with place.local("cut") as target, relay_to(target.link.endpoints[0]) as relay:
            host = place.script(HOST, relay.endpoint)
            try:
                assert host.stdout is not None
                said = host.stdout.readline()
                if not tally.expect(said == "ready\n", "a host did not get through the relay"):
                    return
                for _ in range(CUTS):
                    time.sleep(draw.uniform(0.05, 0.3))  # the hazard itself: a cut at any moment
                    relay.cut()
                    relay.mend()
                time.sleep(SETTLE_S)
                out, _ = host.communicate("end\n", timeout=60)
            finally:
                host.kill()
                host.wait()
            tally.expect(host.returncode == 0, f"the host ended with {host.returncode}")
            _judge(json.loads(out.splitlines()[-1]), tally)
        yield


def _judge(found: dict[str, list[list[object]]], tally: Tally) -> None:
    log = [(int(value), tick) for value, tick in found["log"]]  # type: ignore[call-overload]
    applied, ticks = [value for value, _ in log], dict(log)
    tally.count("cuts", CUTS)
    tally.count("acknowledged changes", len(found["told"]))
    tally.expect(len(found["told"]) > CUTS, f"{len(found['told'])} changes in {CUTS} cuts")
    for k, tick in found["told"]:
        tally.expect(k in ticks, f"change {k} was acknowledged and is not in the log")
        tally.expect(tick in (-1, ticks.get(k)),
            f"change {k} was said to act at sample {tick}, and acted at {ticks.get(k)}")  # type: ignore[call-overload]
    tally.expect(len(applied) == len(set(applied)), "a change was made twice")
    tally.expect(all(a <= b for a, b in pairwise(applied)), "changes were made out of order")
    for k, error in found["unknown"]:
        tally.expect(False, f"change {k}: {error}")
