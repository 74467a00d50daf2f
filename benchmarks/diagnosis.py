"""zendsp beside PySINDy and FROLS on the same concealed cases, in one table.

    export OMP_NUM_THREADS=1                            # one thread of linear algebra for every method
    python benchmarks/diagnosis.py                      # 60 one-joint cases, made here
    python benchmarks/diagnosis.py CASES TRUTH          # cases made by `python -m zendsp.proof.cases`

The columns are those of the proof's scoreboard; `x1 x0.3 x0.1` are the shares of single effects
named first by size. PySINDy needs `pip install 'zendsp[peers]'`; a peer that cannot run is said so,
with the reason.
"""  # noqa: E501

from __future__ import annotations

import tempfile
from pathlib import Path

import click

from zendsp.proof.cases import plan, write_all
from zendsp.proof.judge import Judgement, judge
from zendsp.proof.peers import METHODS, available, sysidentpy_trouble
from zendsp.proof.run_proof import asking
from zendsp.proof.score import answers, diagnose
from zendsp.proof.scoreboard import SINGLE_KINDS, percentile, rate
from zendsp.proof.seal import open_truth

SIZES = (1.0, 0.3, 0.1)
# 0: every effect once; the others that many
DEFAULT = (
    ("single", 13, (1.0,)),
    ("single", 13, (0.3,)),
    ("single", 13, (0.1,)),
    ("complete", 8, (1.0,)),
    ("complete_slow", 2, (1.0,)),
    ("pair", 5, (1.0,)),
    ("foreign", 3, (1.0,)),
    ("replace", 3, (1.0,)),
)


def make_cases(folder: Path) -> tuple[Path, Path]:
    """The default cases of the benchmark, sealed."""
    requests = []
    for index, (kind, count, sizes) in enumerate(DEFAULT):
        planned = plan(
            kind, "rotary", 900_000 + 1000 * index, 0 if kind == "single" else count, sizes
        )
        requests += planned[index % 2 :: 2][:count] if kind == "single" else planned
    write_all(requests, folder / "cases", folder / "truth")
    return folder / "cases", folder / "truth"


def row(method: str, judged: list[Judgement]) -> list[str]:
    """One line of the table."""
    singles = [j for j in judged if j.kind in SINGLE_KINDS and j.named is not None and j.detectable]
    cells = [method]
    for size in SIZES:
        good, total = rate(j.named for j in singles if j.size == size)
        cells.append(f"{good / total:.2f}" if total else "-")
    for values in (
        [j.both for j in judged], [j.replaced for j in judged], [j.alarm for j in judged],
        [j.refused for j in judged],
    ):
        good, total = rate(values)
        cells.append(f"{good}/{total}" if total else "-")
    cells.append(f"{percentile([j.seconds for j in judged], 0.5):.2f}")
    return cells


def show(rows: list[list[str]]) -> None:
    """Print aligned columns."""
    head = [
        "method", "x1", "x0.3", "x0.1", "both of two", "replaced", "false alarms",
        "foreign refused", "seconds",
    ]
    widths = [max(len(r[i]) for r in [head, *rows]) for i in range(len(head))]
    for cells in [head, *rows]:
        click.echo(
            "  ".join(
                c.ljust(w) if i == 0 else c.rjust(w)
                for i, (c, w) in enumerate(zip(cells, widths, strict=True))
            )
        )


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument(
    "cases", type=click.Path(exists=True, file_okay=False, path_type=Path), required=False
)
@click.argument(
    "truth", type=click.Path(exists=True, file_okay=False, path_type=Path), required=False
)
@click.option("--jobs", type=click.IntRange(1), default=2, show_default=True)
@click.option("--limit", type=float, default=300.0, show_default=True, help="Seconds per case.")
@click.option("--peers-only", is_flag=True, help="Leave zendsp out.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=None,
    help="Keep answers there and go on from them.",
)
def main(
    cases: Path | None,
    truth: Path | None,
    jobs: int,
    limit: float,
    peers_only: bool,
    out: Path | None,
) -> None:
    """Every method on every case."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = out or Path(scratch)
        if cases is None or truth is None:
            cases, truth = make_cases(folder)
        truths = open_truth(truth)
        folders = [cases / name for name in sorted(truths)]
        rows = []
        methods = {} if peers_only else {"zendsp": diagnose}
        troubles = available()
        methods |= {m: asking(m) for m in METHODS if not troubles[m]}
        for method, ask in methods.items():
            parallel = jobs if method == "zendsp" else 1
            got = dict(answers(folders, folder / f"{method}.json", parallel, limit, ask))
            rows.append(row(method, [judge(truths[name], got[name]) for name in sorted(truths)]))
        click.echo(f"{len(folders)} cases")
        show(rows)
        for method, words in troubles.items():
            if words:
                click.echo(f"{method}: {words}")
        if words := sysidentpy_trouble():
            click.echo(
                f"SysIdentPy's own FROLS does not run here ({words}); FROLS above is by the"
                " textbook"
            )


if __name__ == "__main__":
    main()
