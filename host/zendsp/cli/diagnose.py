"""``zendsp diagnose``: the contract of docs/diagnosis.md."""

from __future__ import annotations

import json
import os
import shlex
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from zendsp.cli.common import check_writable, out_option
from zendsp.cli.complaints import say_open
from zendsp.cli.completing import models
from zendsp.cli.lines import fitted
from zendsp.errors import ZendspError
from zendsp.one_writer import one_writer
from zendsp_protocol.texts import shown

if TYPE_CHECKING:
    from zendsp.diagnosis import Diagnosis
    from zendsp.diagnosis.progress import Progress, Said

FILE = click.Path(path_type=Path)


@click.command("diagnose")
@click.argument("train", nargs=-1, metavar="RECORDING...", type=FILE)
@click.option(
    "--model", "model_path", type=FILE, shell_complete=models,
    help="Given model (TOML), required; 'zendsp model new' begins one.",
)
@click.option(
    "--heldout", multiple=True, type=FILE,
    help="Recording to judge on; repeat for several. Default: the last third of each.",
)
@out_option(
    "Folder for report.json, report.html, figures, model.toml, compensation.c, and"
    " next_reference.mat where another motion would settle what is open."
)
@click.option(
    "--no-figures", is_flag=True, help="With --out: neither report.html nor figures; faster."
)
@click.option("--json", "as_json", is_flag=True, help="Print report.json instead of the summary.")
@click.option(
    "--run", "run_on", metavar="TARGET", default=None,
    help="Run the proposed next recording on this target and diagnose again with it; needs --out.",
)
@click.option(
    "--seed", type=int, default=0, show_default=True, help="Seed of what is drawn at random."
)
@click.option(
    "--jobs", type=click.IntRange(1), default=None,
    help="Threads; processes where there are several joints, or with --each. Default: all cores.",
)
@click.option(
    "--effects", multiple=True, type=FILE,
    help="Python file with your own effects; repeat for several.",
)
@click.option(
    "--each", is_flag=True, help="Diagnose each recording on its own; a table at the end."
)
@click.option(
    "--scheduler", default=None, metavar="ADDRESS",
    help="With --each: run on the Dask cluster of this scheduler (tcp://host:8786).",
)
def command(
    train: tuple[Path, ...],
    model_path: Path | None,
    heldout: tuple[Path, ...],
    out: Path | None,
    no_figures: bool,
    as_json: bool,
    run_on: str | None,
    seed: int,
    jobs: int | None,
    effects: tuple[Path, ...],
    each: bool,
    scheduler: str | None,
) -> None:
    """Find the physics that a model left out of real recordings.

    Calibrates the given model, locates what remains, names the missing physics, and shows the fit
    improve on held-out recordings. Several recordings are fitted jointly, or each on its own with
    --each. Exit status 0 when a diagnosis was made, 2 for unusable input; 130 after Ctrl-C, with
    what was found until then.

    Example:  zendsp diagnose run1.csv run2.csv --model bench.toml --heldout test.csv --out report
    """
    if not train:
        raise click.UsageError(
            "which recording? For example: zendsp diagnose run.mat --model arm.toml"
        )
    if model_path is None:
        from zendsp.physics.files.shipped import model_folder

        shipped = ", ".join(sorted(path.name for path in model_folder().glob("*.toml")))
        raise click.UsageError(
            f"which model? --model FILE names one of yours, or one that comes with zendsp"
            f" ({shipped}); to begin one: zendsp model new {shlex.quote(str(train[0]))}"
        )
    if scheduler is not None and not each:
        raise click.UsageError(
            "--scheduler spreads recordings over a cluster, each diagnosed on its own: give --each"
            " as well"
        )
    if run_on is not None and (each or out is None):
        raise click.UsageError(
            "--run needs --out, the folder that keeps the new recording, and goes without --each"
        )
    cores = jobs or os.cpu_count() or 1
    if out is not None:
        check_writable(out)
        inputs = (model_path, *_described_in(model_path), *train, *heldout)
        _keep_inputs(out, inputs, train if each else ())
    asked = _Asked(train, model_path, heldout, out, not no_figures, as_json, seed, cores, effects)
    say_open(model_path)
    with nullcontext() if out is None else one_writer(out, "zendsp diagnose"):
        if each:
            _each(asked, scheduler)
        else:
            _together(asked, run_on)


def _described_in(model: Path) -> list[Path]:
    """The file that describes the machine of a model, where it names one. What is wrong with either
    is told where they are read.
    """
    with suppress(OSError, ValueError, KeyError, TypeError):
        return [model.parent / tomllib.loads(model.read_text("utf-8"))["mechanism"]["file"]]
    return []


def _keep_inputs(out: Path, inputs: Sequence[Path], each: Sequence[Path]) -> None:
    """Refuse a folder whose report would replace what it is made from. ``each``: recordings that
    get a folder of their own below it.
    """
    from zendsp.diagnosis.fleet import stems
    from zendsp.diagnosis.report.files import would_replace

    lost = would_replace([out / stem for stem in stems([*map(str, each)])] or [out], inputs)
    if lost is not None:
        raise ZendspError(
            f"--out {out}: the report's {lost.name} would replace {lost}, which is given: choose"
            " another folder"
        )


@dataclass(frozen=True)
class _Asked:
    """The options that every diagnosis takes."""

    train: tuple[Path, ...]
    model: Path
    heldout: tuple[Path, ...]
    out: Path | None
    pictures: bool
    as_json: bool
    seed: int
    jobs: int
    effects: tuple[Path, ...]


def _together(asked: _Asked, run_on: str | None) -> None:
    """Diagnose all recordings together."""
    from zendsp.cli.progress import stages
    from zendsp.cli.steps import in_steps
    from zendsp.diagnosis import diagnose
    from zendsp.diagnosis.progress import Step
    from zendsp.diagnosis.report.files import no_reference, report_text
    from zendsp.physics.effects import load_effects

    for file in asked.effects:
        load_effects(file)
    out = asked.out
    with _how_far(out) as at, stages(quiet=asked.as_json) as say:
        tell = in_steps(lambda text: say(at(text)))
        result = diagnose(
            list(asked.train),
            asked.model,
            list(asked.heldout) or None,
            seed=asked.seed,
            jobs=asked.jobs,
            progress=tell,
            so_far=True,
        )
        if run_on is not None and out is not None:
            from zendsp.experiment.next_recording import run_next

            result = run_next(
                result, asked.train, run_on, out, heldout=asked.heldout, progress=tell,
                seed=asked.seed, jobs=asked.jobs,
            )
        if out is not None:
            tell(Step.REPORTING.says("writing the report"))
            written, wrong = _write(result, out, asked.pictures, tell)
    if asked.as_json:
        click.echo(report_text(result))
    else:
        from zendsp.diagnosis.report.summary import summary

        click.echo(fitted(shown(summary(result)), sys.stdout))
        if out is not None:
            page = "report.html" if asked.pictures else "report.json"
            click.echo(f"\nreport: {written / page}")
            why = no_reference(result)
            click.echo(f"next motion: {f'none, {why}' if why else written / 'next_reference.mat'}")
    if out is not None and wrong:
        click.echo(f"zendsp: {wrong}", err=True)
    if result.stopped:
        raise KeyboardInterrupt
    if out is not None and wrong:
        raise click.exceptions.Exit(1)


@contextmanager
def _how_far(out: Path | None) -> Iterator[Callable[[Said], Said]]:
    """A function that passes on the sentences of progress. After Ctrl-C the last of them is
    printed, and which files of the report exist.
    """
    from zendsp.diagnosis.progress import Step

    said: list[Said] = []

    def at(text: Said) -> Said:
        said[:] = [text]
        return text

    try:
        yield at
    except KeyboardInterrupt:
        reporting = said and said[0].step is Step.REPORTING
        kept = "" if reporting else "no report is written; "
        if reporting and out is not None and (out / "report.json").is_file():
            kept = f"{out / 'report.json'} is written, without pictures; "
        click.echo(f"{kept}it was at {said[0] if said else 'its beginning'}", err=True)
        raise


def _write(
    result: Diagnosis, out: Path, pictures: bool, tell: Progress
) -> tuple[Path, str]:
    """Write the report; return its folder and what went wrong. Where the disk is full, the report
    goes to a new folder for temporary files.
    """
    import tempfile

    from zendsp.diagnosis.report.files import write_report

    try:
        return write_report(result, out, pictures=pictures, progress=tell), ""
    except OSError as error:
        folder = Path(tempfile.mkdtemp(prefix="zendsp-report-"))
        elsewhere = write_report(result, folder, pictures=pictures)
        why = error.strerror or error
        return elsewhere, f"--out {out}: cannot be written ({why}); it is in {elsewhere} instead"


def _each(asked: _Asked, scheduler: str | None) -> None:
    """Diagnose each recording on its own."""
    from zendsp.cli.progress import stages
    from zendsp.diagnosis.fleet import diagnose_each, table
    from zendsp.errors import RecordingError
    from zendsp.physics.effects import load_effects
    from zendsp.physics.files.model_file import load_model

    for file in asked.effects:
        load_effects(file)
    load_model(asked.model)  # a wrong model is one error, not one for each recording
    with stages(quiet=asked.as_json) as tell:
        items = diagnose_each(
            asked.train, asked.model, asked.heldout, out=asked.out, pictures=asked.pictures,
            seed=asked.seed, jobs=asked.jobs, effects=asked.effects, scheduler=scheduler,
            progress=tell,
        )
    if all(i.report is None for i in items):
        raise RecordingError(
            f"none of {len(items)} recordings could be diagnosed; the first: {items[0].error}"
        )
    if asked.as_json:
        rows = [{"recording": i.recording, "report": i.report, "error": i.error} for i in items]
        click.echo(json.dumps(rows, indent=1, ensure_ascii=False))
    else:
        click.echo(shown(table(items)))
