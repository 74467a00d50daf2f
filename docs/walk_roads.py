"""Print how long two roads of the code overview are, a diagnosis and a write: functions, files,
stays in one file, returns to a file seen before.

``python docs/walk_roads.py [--names]``. Counted are functions where they are first called, one
thread after the other, inner ones aside; of a diagnosis those of `zendsp.diagnosis`.
"""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from inspect import CO_OPTIMIZED
from itertools import groupby
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).parents[1]
# the code of this tree, whatever is installed
sys.path[:0] = [str(ROOT / room) for room in ("host", "target", "protocol", "c_isr")]
sys.path.append(str(ROOT / "tests/diagnosis"))
RATE = 500.0  # samples a second of the recordings
ASIDE = ("live", "pulse")  # threads of a target that no request goes through
Met = dict[tuple[str, str], int]  # the thread in which each (file, function) was first called


@contextmanager
def watched(met: Met, below: Path) -> Iterator[Callable[[bool], None]]:
    """A function that switches the watch on and off; threads have to begin within the block."""
    on = threading.Event()
    threads: dict[int, int] = {}

    def look(frame: FrameType, event: str, _: object) -> None:
        if event != "call" or not on.is_set():
            return
        code = frame.f_code
        file, name = code.co_filename, code.co_qualname
        function = code.co_flags & CO_OPTIMIZED and "<" not in name  # no module, no class, no inner
        ours = function and file.startswith(str(below)) and ".venv" not in file
        if ours and file != __file__ and threading.current_thread().name not in ASIDE:
            thread = threads.setdefault(threading.get_ident(), len(threads))
            met.setdefault((file, name), thread)

    threading.setprofile(look)
    sys.setprofile(look)
    try:
        yield lambda wanted: on.set() if wanted else on.clear()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)


def told(road: str, met: Met) -> None:
    """Print a row of the table; with ``--names`` every stay with its functions."""
    order = sorted(met, key=lambda m: met[m])
    stays = [(file, [n for _, n in each]) for file, each in groupby(order, key=lambda m: m[0])]
    files = len({file for file, _ in stays})
    print(f"| {road} | {len(met)} | {files} | {len(stays)} | {len(stays) - files} |")
    if "--names" in sys.argv:
        for file, names in stays:
            print(f"  {Path(file).relative_to(ROOT)}: {', '.join(names)}")


def diagnosis() -> Met:
    """What a diagnosis calls of a joint whose Coulomb friction its model lacks."""
    import reality

    import zendsp

    met: Met = {}
    with tempfile.TemporaryDirectory() as folder:
        files = [
            reality.save(
                Path(folder) / f"{seed}.csv",
                reality.simulate(reality.Machine(), reality.multisine(6.0, RATE, seed), RATE, seed),
            )
            for seed in (1, 2)
        ]
        viscous = reality.effect("viscous", coefficient=0.004)
        model = reality.model_file(Path(folder) / "model.toml", RATE, viscous)
        with watched(met, ROOT / "host/zendsp/diagnosis") as watch:
            watch(True)
            zendsp.diagnose(files[0], model, files[1], jobs=1)
            watch(False)
    return met


def write() -> Met:
    """What the first update of two variables calls, in the host and in the target."""
    import zendsp
    from zendsp_target.monitor import Monitor, Options
    from zendsp_target.runtime import Runtime

    met: Met = {}
    with watched(met, ROOT) as watch, Runtime("imi_planar", clock="fast") as runtime:
        name = f"walked-{time.time_ns()}"
        monitor = Monitor(runtime, Options(name, "imi_planar", listen=("here",)))
        with zendsp.connect(name) as target:
            target.download("pd.c")
            target.start()
            time.sleep(1.0)  # what a start has to tell is told
            watch(True)
            target.update(Kp1=450.0, Kd1=40.0)
            time.sleep(0.3)  # for the log
            watch(False)
        monitor.close()
    return met


if __name__ == "__main__":
    print("| road | functions | files | stays | returns |\n|---|---|---|---|---|")
    told("a diagnosis", diagnosis())
    told("a write", write())
