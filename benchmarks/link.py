"""How far the link is from the bare transport beneath it, measured side by side in one run.

    python benchmarks/link.py [--quick] [--json FILE]

Every figure of ours stands beside the same thing done with nothing but Zenoh, over the same
transport where nothing else is said, between the same two processes, taken in turns, in random
order, so that a busy moment hits both; of each, the median of the quicker half counts. The goals
are ratios.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec
import numpy as np
from bare import Bare

import zendsp
from zendsp.link import Target
from zendsp.link.find import local_entries
from zendsp.link.settings import Credentials
from zendsp_protocol import codec, verbs
from zendsp_protocol import messages as m

DECLARED = "\n".join(f"static double v{k};" for k in range(64))
PARAMETERS = " ".join(f'PARAMETER(v{k}, 0, "", NO_MIN, NO_MAX, "");' for k in range(64))
SIXTY_FOUR = f"""#include "isr.h"
#include <time.h>
static double q[128], now;
static int32_t n;
{DECLARED}
void UserInit(void) {{ {PARAMETERS} SIGNAL(q, "", ""); SIGNAL(n, "", ""); SIGNAL(now, "s", "monotonic clock"); }}
void UserISR_INT2(void) {{
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    now = at.tv_sec + 1e-9 * at.tv_nsec;
    n++;
    for (int i = 0; i < 128; i++) q[i] = n + i;
}}
void UserBackground(void) {{}}
"""  # noqa: E501


@dataclass(frozen=True)
class Row:
    """One line of the result."""

    what: str
    ours: float
    bare: float
    unit: str
    ratio: float
    goal: str
    met: bool | None


def in_turns(
    count: int, *actions: Callable[[], object], prepare: Callable[[], object] = lambda: None
) -> list[np.ndarray]:
    """Time each action ``count`` times, in a new order in every round; seconds. ``prepare`` comes
    before each round, untimed.

    The order matters: the first request to a process that has rested takes up to 20 µs longer than
    the next.
    """
    times = np.empty((len(actions), count))
    order = np.random.default_rng(0)
    for k in range(count):
        prepare()
        for i in order.permutation(len(actions)):
            start = time.perf_counter_ns()
            actions[i]()
            times[i, k] = time.perf_counter_ns() - start
    return list(times * 1e-9)


def typical(times: np.ndarray) -> float:
    """Median of the quicker half: what it takes when nothing else wants the CPU."""
    return float(np.percentile(times, 25))


def compare(what: str, ours: np.ndarray, bare: np.ndarray, goal: float) -> Row:
    """Compare typical times: less is better."""
    a, b = typical(ours), typical(bare)
    return Row(what, a * 1e6, b * 1e6, "µs", a / b, f"≤ {goal}", a / b <= goal)


def requests(target: Target, bare: Bare, count: int) -> list[Row]:
    """Write and read of one variable against a bare round trip, a turn of each in every round.

    They are measured apart: a host that has written waits, when it reads next, for the sample in
    which that acts. `at_once` measures that reading.
    """
    rows = []
    numbers = itertools.count(0.5)
    for what, action in (
        ("write one variable, acknowledged", lambda: target.write(v0=next(numbers))),
        ("read one variable, nothing written before", lambda: target.read(["v0"])),
    ):
        target.read(["v0"])  # nothing that was written is waited for any more
        rows.append(compare(what, *in_turns(count, action, bare.round_trip), 1.3))
    least, base = in_turns(count, lambda: bare.packed(next(numbers)), bare.round_trip)
    a, b = typical(least) * 1e6, typical(base) * 1e6
    what = "write by Zenoh and MessagePack alone, nothing checked or written"
    return [*rows, Row(what, a, b, "µs", a / b, "", None)]


class Envelope(msgspec.Struct, frozen=True):
    """A request as one struct, for a decoder that reads and checks in one go."""

    v: int
    verb: str
    by: str
    args: verbs.Write


class Yes(msgspec.Struct, frozen=True):
    """A reply to a write as one struct."""

    v: int
    ok: bool
    result: m.Written


def woken(bare: Bare, count: int) -> Row:
    """Pack a write and read its reply as a host that has just waited for another answer: with
    little of this in the caches. Against ``msgspec`` alone.
    """
    args = {"values": {"v0": 0.5}}
    reply = codec.encode_result(m.Written(sequence=7))
    body = {"v": 1, "verb": "write", "by": "me", "args": args}
    whole = msgspec.msgpack.Decoder(Yes)

    def ours() -> None:
        codec.encode_request("write", args, "me")
        codec.decode_reply(reply, m.Written)

    def alone() -> None:
        msgspec.msgpack.encode(body)
        whole.decode(reply)

    a, b = (
        typical(in_turns(count, action, prepare=bare.round_trip)[0]) * 1e6
        for action in (ours, alone)
    )
    what = "pack a write, read its reply, after a wait: msgpack and checks, msgspec alone"
    return Row(what, a, b, "µs", a / b, "", None)


def wire(count: int) -> list[Row]:
    """Pack and unpack a request: ``msgpack`` with the checks of the product, against ``msgspec``
    alone.
    """
    whole = msgspec.msgpack.Decoder(Envelope)
    rows = []
    for size in (1, 64):
        args = {"values": {f"v{k}": float(k) for k in range(size)}}
        body = {"v": 1, "verb": "update", "by": "me", "args": args}

        def ours(args: dict[str, object] = args) -> None:
            codec.decode_request(codec.encode_request("update", args, "me"), "sync")

        def alone(body: dict[str, object] = body) -> None:
            whole.decode(msgspec.msgpack.encode(body))

        a, b = (typical(times) * 1e6 for times in in_turns(count, ours, alone))
        rows.append(
            Row(
                f"pack and unpack an update of {size}: msgpack and checks, msgspec alone",
                a,
                b,
                "µs",
                a / b,
                "",
                None,
            )
        )
    return rows


def at_once(target: Target, bare: Bare, count: int) -> list[Row]:
    """Commit 64 staged variables, and read what was just written, both at 20 kHz.

    Either is answered after a sample, which is never more than 50 µs away. A commit waits half of
    that in the mean, and less in the quicker half, of which the times here are: what a wait of 0 to
    50 µs adds to the bare request is taken off. What was written acts by the time that its reading
    arrives. Like is set against like: the values are staged, and checked, before, they are new each
    time, and the bare request has as many bytes as ours.
    """
    names = [f"v{k}" for k in range(64)]
    random = np.random.default_rng(0)
    values = dict.fromkeys(names, 0.1)
    size = len(codec.encode_request("update", {"values": values}, target.link.author))
    staged, base = in_turns(
        count,
        target.update,
        lambda: bare.round_trip(size),
        prepare=lambda: target.stage(**dict(zip(names, random.random(64).tolist(), strict=True))),
    )
    wait = typical(base + random.uniform(0.0, 1.0 / target.info.rate_hz, count)) - typical(base)
    commit = f"commit 64 staged variables (wait of {wait * 1e6:.0f} µs for a sample taken off)"
    read, small = in_turns(
        count,
        lambda: target.read(["v0"]),
        bare.round_trip,
        prepare=lambda: target.write(v0=float(random.random())),
    )
    return [
        compare(commit, staged - wait, base, 1.3),
        compare("read one variable that was just written", read, small, 1.3),
    ]


def load(socket: Bare, tcp: Bare, mib: int, rounds: int) -> list[Row]:
    """Load of a recording against the same bytes through bare Zenoh into an array; the loop rests
    meanwhile.

    A host of the same user reads shared memory. One that was given the address gets checked chunks
    over the link: over the target's own socket, and over TCP. Zenoh brings much less over the
    former, with the kernel's default buffers.
    """
    with (
        zendsp.local(
            "imi_planar", clock="fast", options=["--listen", "here", "--listen", "tcp/127.0.0.1:0"]
        ) as target,
        contextlib.ExitStack() as open_hosts,
    ):
        target.download({"link.c": SIXTY_FOUR})
        rows = (mib << 20) // (8 * 128)
        target.acquire_configure(["q"], seconds=rows / target.info.rate_hz)
        target.acquire_start()
        target.run_for(rows / target.info.rate_hz)
        entry = next(e for e in local_entries() if e.name == target.name)
        own = Credentials(user=entry.user, password=entry.password)
        hosts = {
            endpoint.partition("/")[0]: open_hosts.enter_context(
                zendsp.connect(target.name, endpoint, own)
            )
            for endpoint in entry.endpoints
        }
        here, by_socket, by_tcp, bare_socket, bare_tcp = in_turns(
            rounds,
            lambda: target.load_rows(0, rows, 128),
            lambda: hosts["unixsock-stream"].load_rows(0, rows, 128),
            lambda: hosts["tcp"].load_rows(0, rows, 128),
            lambda: socket.load(mib),
            lambda: tcp.load(mib),
        )

    def row(what: str, ours: np.ndarray, bare: np.ndarray) -> Row:
        a, b = ((mib << 20) / typical(times) / 1e6 for times in (ours, bare))
        return Row(what, a, b, "MB/s", a / b, "≥ 0.8", a / b >= 0.8)

    return [
        row(f"load {mib} MiB on the same computer, bare over TCP", here, bare_tcp),
        row(f"load {mib} MiB over the link, TCP, checked", by_tcp, bare_tcp),
        row(f"load {mib} MiB over the link, socket, checked", by_socket, bare_socket),
    ]


def live_lag(target: Target, seconds: float) -> Row:
    """Time from the sample to the callback, by the one monotonic clock of this machine."""
    lags: list[float] = []

    def take(block: object) -> None:
        lags.append(time.monotonic() - float(block.data[-1, 0]))  # type: ignore[attr-defined]

    with target.live(["now"], callback=take) as view:
        time.sleep(seconds)
        lost, received = view.lost, view.received
    p50, p99 = np.percentile(lags, [50, 99]) * 1e3
    what = (
        f"live lag at {target.info.rate_hz:g} Hz, p50 (p99 {p99:.2f} ms, {received} rows, {lost}"
        " skipped)"
    )
    return Row(what, float(p50), 2.0, "ms", float(p50) / 2.0, "p50 ≤ 2 ms", bool(p50 <= 2.0))


def stream_to_file(target: Target, seconds: float) -> Row:
    """20 kHz × 128 float64 to a file: what the target lost."""
    with tempfile.TemporaryDirectory() as folder:
        before = target.status().timing
        start = time.perf_counter()
        recording = target.acquire(["q"], seconds=seconds)
        got = time.perf_counter() - start
        recording.save(Path(folder) / "all.npz") if seconds < 3 else np.save(
            Path(folder) / "all.npy", recording.data
        )
        took = time.perf_counter() - start
    after = target.status().timing
    steps = np.diff(recording["q[0]"])
    missing = int((steps - 1).sum()) - (after.missed - before.missed)
    what = (
        f"{target.info.rate_hz / 1e3:g} kHz × 128 for {seconds:g} s: rows lost (loaded"
        f" {got - seconds:.2f} s after, on disk {took:.1f} s)"
    )
    lost = recording.lost + max(0, missing)
    return Row(what, float(lost), 0.0, "rows", float(lost), "0", lost == 0)


def report(rows: list[Row]) -> str:
    """Lay the rows out as a table."""
    lines = [f"{'':74}{'ours':>10}{'bare':>10}        {'ratio':>6}  goal"]
    for row in rows:
        mark = {True: "met", False: "NOT MET", None: ""}[row.met]
        bare = f"{row.bare:10.1f}" if row.unit not in ("ms", "rows") else " " * 10
        ratio = f"{row.ratio:6.2f}" if row.unit not in ("ms", "rows") else " " * 6
        lines.append(
            f"{row.what:74}{row.ours:10.2f}{bare} {row.unit:6} {ratio}  {row.goal}  {mark}"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a fifth of the repetitions")
    parser.add_argument("--json", type=Path, help="also write the rows there")
    args = parser.parse_args()
    count, mib, rounds = (600, 64, 5) if args.quick else (3000, 256, 25)
    rows = wire(count)
    folder = tempfile.TemporaryDirectory()
    bare, tcp = Bare(f"unixsock-stream/{folder.name}/bare.sock"), Bare("tcp/127.0.0.1:0")
    try:
        rows.append(woken(bare, count))
        with zendsp.local("imi_planar", rate=1000.0) as target:
            target.download({"link.c": SIXTY_FOUR})
            target.start()
            rows += requests(target, bare, count)
            rows.append(live_lag(target, 2.0 if args.quick else 10.0))
        rows += load(bare, tcp, mib, rounds)
        with zendsp.local("imi_planar", rate=20_000.0) as target:
            target.download({"link.c": SIXTY_FOUR})
            target.start()
            rows += at_once(target, bare, count)
            rows.append(stream_to_file(target, 2.0 if args.quick else 10.0))
    finally:
        bare.close()
        tcp.close()
        folder.cleanup()
    print(report(rows))
    if args.json:
        args.json.write_text(json.dumps([asdict(row) for row in rows], indent=2))


if __name__ == "__main__":
    main()
