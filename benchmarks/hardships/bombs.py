"""Programs that try to stay, and sources that try to take all there is, beside a machine that
moves.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from hardships.place import Place, Tally, children, until
from zendsp.errors import ZendspError
from zendsp.link import Target

PROMISE = (
    "what user code or a compilation starts ends with it, within its limits, and the machine beside"
    " it goes on"
)
# in which a target answers while it compiles a bomb, on a computer with two CPUs that both work
STATUS_S = 1.0
HEAD = (
    '#include "isr.h"\nstatic double x;\nvoid UserInit(void) { SIGNAL(x, "", ""); }\n'
    "void UserISR_INT2(void) { x = 1.0; }\n"
)
TENFOLD = "".join(f"#define A{i + 1} A{i} A{i} A{i} A{i} A{i} A{i} A{i} A{i}\n" for i in range(12))
SOURCES = {  # the quick ones first
    "itself": HEAD + '#include "bomb.c"\n',
    "zeros": HEAD + '#include "/dev/zero"\n',
    "nested": HEAD + "double z = " + "(" * 20_000 + "1" + ")" * 20_000 + ";\n",
    "large": HEAD + "char y[900 << 20] = {1};\n",
    "messages": HEAD + "".join(f"#warning {'w' * 200} {i}\n" for i in range(60_000)),
    "macros": HEAD + f"#define A0 1.0,\n{TENFOLD}double y[] = {{A12}};\n",
    "assembler": HEAD + 'asm(".rept 2000000000\\n.quad 1\\n.endr");\n',
}
HARMLESS = ("nested", "messages")  # some compilers bear them
FORKS = """
#include "isr.h"
#include <stdlib.h>
#include <sys/wait.h>
#include <unistd.h>
static double tries, got_away;
static void stay(void) {
    for (int i = 0; i < 20; i++) {
        tries += 1.0;
        const pid_t child = fork();
        if (child == 0) { setsid(); for (;;) { fork(); pause(); } }
        if (child > 0) got_away += 1.0;
    }
    if (system("setsid sleep 577 &") == 0) got_away += 1.0;
}
__attribute__((constructor)) static void early(void) { stay(); }
void UserInit(void) { SIGNAL(tries, "", ""); SIGNAL(got_away, "", ""); stay(); }
void UserISR_INT2(void) { if (tries < 500.0) stay(); }
"""


def rounds(place: Place, tally: Tally) -> Iterator[None]:
    """See the module."""
    with place.local("beside") as beside, place.local("bombed") as target:
        beside.download("pd.c")
        beside.start()
        own = {beside.info.pid, target.info.pid}
        while True:
            before = beside.status()
            _fork(place, target, own, tally)
            yield
            for name, text in SOURCES.items():
                _compile(place, target, own, name, text, tally)
                yield
            after = beside.status()
            tally.expect(
                after.state == "running" and after.trip is None,
                f"the machine beside it is {after.state}: {after.trip}",
            )
            tally.expect(after.tick > before.tick, "the machine beside it stands still")


def _fork(place: Place, target: Target, own: set[int], tally: Tally) -> None:
    target.download(_file(place, FORKS))
    target.start()
    tally.expect(until(lambda: float(target["tries"]) >= 500.0),
        "the program that forks does not run")  # type: ignore[arg-type]
    tally.expect(float(target["got_away"]) == 0.0,
        f"{target['got_away']} children got away")  # type: ignore[arg-type]
    tally.count("forks tried", int(target["tries"]))  # type: ignore[arg-type]
    target.unload()
    _nothing_stays(place, own, "a program that forks", tally)


def _compile(
    place: Place, target: Target, own: set[int], name: str, text: str, tally: Tally
) -> None:
    path = _file(place, text)
    over = threading.Event()
    worst = 0.0

    def ask() -> None:
        nonlocal worst
        while not over.is_set():
            began = time.monotonic()
            target.status()
            worst = max(worst, time.monotonic() - began)
            over.wait(0.02)

    began = time.monotonic()
    with ThreadPoolExecutor() as beside:
        asking = beside.submit(ask)
        try:
            result = target.compile(path)
            tally.expect(name in HARMLESS or not result.ok, f"{name}: there is a program")
        except ZendspError as error:
            tally.expect(str(error), f"{name}: refused without a word")
        finally:
            over.set()
        asking.result()
    tally.count("compile bombs")
    tally.measure("longest compilation, s", time.monotonic() - began)
    tally.measure("slowest status meanwhile, ms", 1000.0 * worst)
    tally.expect(worst < STATUS_S, f"{name}: a status took {worst:.2f} s meanwhile")
    _nothing_stays(place, own, f"the bomb {name}", tally)


def _file(place: Place, text: str) -> Path:
    path = place.folder / "bomb.c"
    path.write_text(text)
    return path


def _nothing_stays(place: Place, own: set[int], what: str, tally: Tally) -> None:
    """Only the two targets and the runners they have now are left."""

    def others() -> list[int]:
        kept = own | {child for pid in own for child in children(pid)}
        return [pid for pid in place.processes() if pid not in kept | {os.getpid()}]

    tally.expect(until(lambda: not others()), f"{what} leaves processes: {others()}")
