"""``zendsp experiment``: measure a machine."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from zendsp.cli.common import check_writable, json_option, out_option, wrapped
from zendsp.cli.completing import experiments
from zendsp.cli.lines import fitted
from zendsp.errors import ModelError, RecordingError, Refused, ZendspError
from zendsp_protocol.texts import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from zendsp.experiment import Lab, Result
    from zendsp.link import Target
    from zendsp_protocol.messages import MachineInfo


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
@click.option(
    "--model", type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Model file of the machine, for experiments that need one.",
)
@json_option
def command(
    name: str | None,
    out: Path,
    into: Path | None,
    report: Path | None,
    target: str,
    connect: str | None,
    model: Path | None,
    as_json: bool,
) -> None:
    """Make the experiment NAME, or all of them; without NAME, list them and what each needs.

    Moves the machine. Ctrl-C stops it at the next sample. Every recording is kept, also the one
    that Ctrl-C ends; the result is a TOML file that a model takes in. With --target, all means all
    whose needs that machine meets; of each other one a line says what is lacking, or why it could
    not be made.

    Example:  zendsp experiment friction-curve --out curves
    """
    from zendsp.experiment import EXPERIMENTS, Lab, fit_model

    if name is None:
        _list()
        return
    check_writable(out)
    names = list(EXPERIMENTS) if name == "all" else [_present(name)]
    if model is not None and name != "all":
        EXPERIMENTS[names[0]].check_model()
    if into is not None and not (target or connect):
        fit_model(names, into)  # before a machine is started
    with contextlib.ExitStack() as closing:
        opened = told = None
        if target or connect:
            from zendsp.cli.common import open_target
            from zendsp.experiment.lab import told as machine_of

            opened = closing.enter_context(open_target(target, connect, moves=True))
            if name == "all" or into is not None:
                told = machine_of(opened)
        if name == "all" and told is not None:
            names = _fitting(names, told, model is not None)
        takes = fit_model(names, into, told) if into is not None else []  # before it moves
        goes_on = opened if name == "all" else None

        def lab_of(each: str) -> Lab:
            return Lab(out, opened, model=model if EXPERIMENTS[each].takes_model else None)

        _make_each(names, lab_of, into, takes, as_json, goes_on)
    if report is not None:
        from zendsp.experiment.report import write_report

        write_report(out, report)
        click.echo(f"wrote {report}", err=as_json)


def _make_each(
    names: Sequence[str],
    lab: Callable[[str], Lab],
    into: Path | None,
    takes: Sequence[str],
    as_json: bool,
    goes_on: Target | None,
) -> None:
    """Make experiments, each in a lab of its own. On the machine ``goes_on`` one that cannot be
    made does not keep the others from it, unless a limit has tripped or somebody has stopped it.
    """
    failed = []
    for name in names:
        try:
            _make(name, lab(name), into if name in takes else None, as_json)
        except (RecordingError, Refused, ModelError) as error:
            if goes_on is None or not goes_on.alive or goes_on.status().trip is not None:
                raise
            failed.append(name)
            click.echo(f"{name} is not made: {error}", err=True)
    if failed:
        raise ZendspError(
            f"{len(failed)} of {counted(len(names), 'experiment')} could not be made:"
            f" {', '.join(failed)}; the reasons stand above"
        )


def _present(name: str) -> str:
    """The name that an experiment has now; a former one is told."""
    from zendsp.experiment.registry import experiment_named

    now = experiment_named(name).name
    if now != name:
        click.echo(f"{name} is called {now} now", err=True)
    return now


def _fitting(names: Sequence[str], machine: MachineInfo, has_model: bool) -> list[str]:
    """Those whose needs the machine meets; of each other one a line says what is lacking."""
    from zendsp.experiment import EXPERIMENTS

    lacking = {name: EXPERIMENTS[name].lacking(machine, has_model) for name in names}
    for name, why in lacking.items():
        if why:
            click.echo(f"{name} is left out: it {why}", err=True)
    return [name for name, why in lacking.items() if not why]


def _make(name: str, lab: Lab, into: Path | None, as_json: bool) -> None:
    """Make an experiment, print its result, and put it into a model file."""
    from zendsp.cli.progress import stages
    from zendsp.experiment import put_into, run_experiment

    try:
        with stages(quiet=as_json) as tell:
            lab.say = lambda text: tell(f"{name}: {text}")
            result = run_experiment(name, lab)
    except (KeyboardInterrupt, ZendspError) as error:
        said = lab.left
        if isinstance(error, KeyboardInterrupt):
            said = said or f"ended early; what was recorded is in {lab.folder}"
            said += "" if lab.target else "; the simulated machine ended with it"
        if said:
            click.echo(fitted(f"{name}: {said}", sys.stderr), err=True)
        raise
    _print(result, lab.folder / name, as_json)
    if into is not None:
        for change in put_into(result, into):
            click.echo(f"{into}: {change}", err=as_json)


def _list() -> None:
    from zendsp.experiment import EXPERIMENTS

    width = max(len(name) for name in EXPERIMENTS)
    for experiment in EXPERIMENTS.values():
        needs = f"Needs: {experiment.needs.words()}."
        click.echo(wrapped(f"{experiment.title} {needs}", f"{experiment.name:<{width}}  "))


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
    click.echo(f"{result.title} ({result.target}; ± is one standard deviation)")
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
