"""``zendsp experiment``: measure a machine."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

import click

from zendsp.cli.common import check_writable, end_softly, json_option, out_option, wrapped
from zendsp.cli.completing import experiments
from zendsp_protocol.texts import counted

if TYPE_CHECKING:
    from zendsp.experiment import Result


@click.command("experiment")
@click.argument("name", required=False, shell_complete=experiments)
@out_option(
    "Folder of recordings, figures and results.",
    default=Path("experiments"), show_default=True,
)
@click.option(
    "--into",
    type=click.Path(path_type=Path, exists=True),
    help="Model file that takes in what was found; with all, what is of its machine.",
)
@click.option(
    "--report",
    type=click.Path(path_type=Path),
    help="Write all results of the folder beside the papers' (Markdown, figures beside it).",
)
@click.option(
    "-t", "--target", default="", metavar="NAME",
    help="A target with the machine. Default: a simulated one, started here, on the fast clock.",
)
@click.option("--connect", metavar="ENDPOINT", help="Where to reach it, e.g. tls/robot.lab:7447.")
@json_option
def command(
    name: str | None,
    out: Path,
    into: Path | None,
    report: Path | None,
    target: str,
    connect: str | None,
    as_json: bool,
) -> None:
    """Make the experiment NAME, or all of them; without NAME, list them.

    Moves the machine. Ctrl-C stops it at the next sample. Every recording is kept, also the one
    that Ctrl-C ends; the result is a TOML file that a model takes in. With --target, all means all
    of that machine; of a machine without its own, those for any.

    Example:  zendsp experiment imi-fit --into examples/models/imi_planar.toml
    """
    from zendsp.cli.progress import stages
    from zendsp.experiment import EXPERIMENTS, Lab, fit_model, put_into, run_experiment

    if name is None:
        _list()
        return
    check_writable(out)
    end_softly()
    names = [n for n, e in EXPERIMENTS.items() if e.machine] if name == "all" else [name]
    takes = fit_model(names, into) if into is not None else []  # before the machine moves
    opened = None
    closing = contextlib.ExitStack()
    if target or connect:
        from zendsp.cli.common import open_target

        opened = closing.enter_context(open_target(target, connect, moves=True))
        if name == "all":
            own = [each for each in names if EXPERIMENTS[each].machine == opened.info.machine]
            names = own or [each for each, e in EXPERIMENTS.items() if not e.machine]
            for each in [each for each in names if EXPERIMENTS[each].command != "torque"]:
                names.remove(each)
                click.echo(
                    f"{each} is left out: it commands a {EXPERIMENTS[each].command}, and needs a"
                    " target of its own",
                    err=True,
                )
    with closing:
        for each in names:
            try:
                with stages(quiet=as_json) as tell:
                    lab = Lab(out, opened, lambda text, each=each: tell(f"{each}: {text}"))  # type: ignore[misc]
                    result = run_experiment(each, lab)
            except KeyboardInterrupt:
                ours = "" if opened else "; the simulated machine ended with it"
                click.echo(f"{each}: ended early; what was recorded is in {out}{ours}", err=True)
                raise
            _print(result, out / each, as_json)
            if into is not None and each in takes:
                for change in put_into(result, into):
                    click.echo(f"{into}: {change}", err=as_json)
    if report is not None:
        from zendsp.experiment.report import write_report

        write_report(out, report)
        click.echo(f"wrote {report}", err=as_json)


def _list() -> None:
    from zendsp.experiment import EXPERIMENTS

    width = max(len(name) for name in EXPERIMENTS)
    for experiment in EXPERIMENTS.values():
        head = f"{experiment.name:<{width}}  {experiment.machine or 'any':<10}  "
        click.echo(wrapped(experiment.title, head))


def _print(result: Result, folder: Path, as_json: bool) -> None:
    if as_json:
        import json

        values = {
            key: {"value": e.value, "std": e.std, "unit": e.unit}
            for key, e in result.values.items()
        }
        click.echo(
            json.dumps(
                {
                    "name": result.name, "values": values, "warnings": result.warnings,
                    "folder": str(folder),
                },
                allow_nan=False,
            )
        )
        return
    click.echo(f"{result.title} ({result.target})")
    for key, estimate in result.values.items():
        click.echo(f"  {key.replace('_', ' '):<44} {estimate}")
    for text in result.findings:
        click.echo(wrapped(text, "  "))
    for text in result.warnings:
        click.echo(wrapped(text, "  warning: "))
    click.echo(
        f"  {folder / 'result.toml'}, {folder / result.figure},"
        f" {counted(len(result.recordings), 'recording')}"
    )
