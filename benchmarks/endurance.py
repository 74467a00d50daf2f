"""What has to hold for hours, tried for as long as you like: on the loopback, against real targets,
with this Python's zendsp.

    python benchmarks/endurance.py [--minutes 3] [--only WORD …] [--rounds N] [--json FILE] [--list]

Each part goes on for `--minutes` (or for so many rounds), and says every ten seconds how far it is.
The exit status is 0 where every promise held, 1 where one did not (each is told), 130 after Ctrl-C.
`tests/journeys/test_endurance.py` runs a round or two of each.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from hardships import bombs, kills, links, messages, signals, starts, views
from hardships.place import Place, Tally, until

PROGRESS_S = 10.0
PARTS = {
    "messages": messages, "links": links, "kills": kills, "signals": signals, "bombs": bombs,
    "views": views, "starts": starts,
}


@dataclass
class Result:
    """What became of one part."""

    name: str
    promise: str
    rounds: int
    seconds: float
    tally: Tally

    @property
    def numbers(self) -> dict[str, float]:
        """What was done and the worst that was measured."""
        return {
            **self.tally.done,
            **{what: round(value, 2) for what, value in self.tally.worst.items()},
        }

    def line(self) -> str:
        """One line for people."""
        outcome = (
            "held" if self.tally.violations == 0 else f"VIOLATED {self.tally.violations} times"
        )
        return (
            f"{self.name}: {outcome} in {self.rounds} rounds, {self.seconds:.0f} s: "
            + ", ".join(f"{number:,.10g} {what}" for what, number in self.numbers.items())
        )


def endure(
    name: str,
    promise: str,
    hardship: Callable[[Place, Tally], Iterator[None]],
    seconds: float,
    most: int | None,
) -> Result:
    """Go through one hardship for so many seconds, or rounds."""
    tally, done = Tally(), 0
    begin = told = time.monotonic()
    with Place() as place:
        with contextlib.closing(hardship(place, tally)) as rounds:  # type: ignore[type-var]
            try:
                for _ in rounds:
                    done += 1
                    now = time.monotonic()
                    if now - told > PROGRESS_S:
                        told = now
                        print(
                            f"  {name}: {now - begin:.0f} s, {done} rounds, {tally.violations}"
                            " violations",
                            file=sys.stderr,
                            flush=True,
                        )
                    if done == most or (most is None and now - begin > seconds):
                        break
            except Exception as error:
                tally.expect(False, f"it ended by itself: {type(error).__name__}: {error}")
        tally.expect(
            until(lambda: not place.processes()),
            f"processes are left at the end: {place.processes()}",
        )
    return Result(name, promise, done, time.monotonic() - begin, tally)


def main(words: Sequence[str] | None = None, parts: dict[str, Any] | None = None) -> int:
    """Run the command; returns its exit status."""
    parts = PARTS if parts is None else parts
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=3.0, help="of each part (3)")
    parser.add_argument("--rounds", type=int, metavar="N", help="of each part, in place of minutes")
    parser.add_argument(
        "--only", nargs="+", choices=list(parts), default=list(parts), metavar="PART",
        help=", ".join(parts),
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write what was found")
    parser.add_argument(
        "--list", action="store_true", help="the parts and their promises; runs nothing"
    )
    asked = parser.parse_args(words)
    if asked.list:
        print("\n".join(f"{name:10} {part.PROMISE}" for name, part in parts.items()))
        return 0
    results: list[Result] = []
    try:
        for name in asked.only:
            results.append(
                endure(
                    name, parts[name].PROMISE, parts[name].rounds, 60.0 * asked.minutes,
                    asked.rounds,
                )
            )
            print(results[-1].line(), flush=True)
            for what in results[-1].tally.violated:
                print(f"    {what}", flush=True)
    except KeyboardInterrupt:
        print(f"ended by Ctrl-C after {len(results)} of {len(asked.only)} parts", file=sys.stderr)
        return 130
    finally:
        if asked.json:
            asked.json.write_text(json.dumps(_report(results), indent=1) + "\n")
    return int(any(r.tally.violations for r in results))


def _report(results: Sequence[Result]) -> dict[str, Any]:
    return {
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {
            "cpus": os.cpu_count(), "kernel": platform.release(),
            "python": platform.python_version(),
        },
        "parts": [
            {
                "name": r.name,
                "promise": r.promise,
                "rounds": r.rounds,
                "seconds": round(r.seconds, 1),
                "found": r.numbers,
                "violations": r.tally.violations,
                "violated": r.tally.violated,
            }
            for r in results
        ],
    }


if __name__ == "__main__":
    sys.exit(main())
