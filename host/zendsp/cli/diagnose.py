"""``zendsp diagnose``: the contract of DIAGNOSIS.md."""

from __future__ import annotations

import json
from pathlib import Path

import click


@click.command("diagnose")
@click.argument("train", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--model", "model_path", required=True, type=click.Path(path_type=Path), help="Given model (TOML).")
@click.option("--heldout", multiple=True, type=click.Path(path_type=Path), help="Recording to judge on; repeat for several. Default: the last third of each.")
@click.option("--out", type=click.Path(path_type=Path), default=None, help="Folder for report.json, report.html, figures, model.toml, compensation.c.")
@click.option("--json", "as_json", is_flag=True, help="Print report.json instead of the summary.")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of what is drawn at random.")
@click.option("--jobs", type=click.IntRange(1), default=None, help="Threads. Default: all cores.")
def command(train: tuple[Path, ...], model_path: Path, heldout: tuple[Path, ...], out: Path | None, as_json: bool, seed: int, jobs: int | None) -> None:
    """Find the physics that a model left out of real recordings.

    Calibrates the given model, locates what remains, names the missing physics, and shows the fit improve on held-out recordings.
    Exit status 0 when a diagnosis was made, 2 for unusable input.

    Example:  zendsp diagnose run1.csv run2.csv --model bench.toml --heldout test.csv --out report
    """
    import os

    from zendsp.cli.progress import stages
    from zendsp.diagnosis import diagnose

    with stages(quiet=as_json) as tell:
        result = diagnose(list(train), model_path, list(heldout) or None, seed=seed, jobs=jobs or os.cpu_count() or 1, progress=tell)
        if out is not None:
            from zendsp.diagnosis.report import write_report

            tell("writing the report")
            write_report(result, out)
    if as_json:
        click.echo(json.dumps(result.report(), indent=1, ensure_ascii=False, allow_nan=False))
    else:
        from zendsp.diagnosis.summary import summary

        click.echo(summary(result))
        if out is not None:
            click.echo(f"\nreport: {out / 'report.html'}")
