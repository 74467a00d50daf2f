"""``zendsp demo``: a machine conceals physics, and zendsp finds it, in one command."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import click

from zendsp.cli.common import check_writable, emit, json_option
from zendsp.cli.completing import machines
from zendsp.errors import ZendspError
from zendsp.one_writer import one_writer


@click.command("demo")
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("zendsp-demo"),
    show_default=True,
    help="Folder for what it makes.",
)
@click.option(
    "--machine", default="imi_planar", show_default=True, shell_complete=machines,
    help="imi_planar, pendulum, or wam7, which conceals a payload.",
)
@click.option(
    "--effect",
    default=None,
    help=(
        "Conceal this one, or one of several: ripple/coupling. Default: drawn from those that show"
        " in tracking."
    ),
)
@click.option(
    "--seed", type=click.IntRange(0), default=None,
    help="Draw by this number, to see the same again. Default: drawn by the target, unknown here.",
)
@click.option("--clock", type=click.Choice(["real", "fast"]), default="fast", show_default=True,
              help="fast: simulated time runs as fast as the CPU allows.")  # fmt: skip
@click.option("--web", is_flag=True, help="Open the report in a browser at the end.")
@json_option
def command(
    out: Path,
    machine: str,
    effect: str | None,
    seed: int | None,
    clock: str,
    web: bool,
    as_json: bool,
) -> None:
    """Find physics that a simulated machine conceals, live, and switch its compensation on.

    A target starts with an effect drawn at random, which this process does not know. It is
    recorded, diagnosed, compensated while it runs, and then it reveals the truth. Exit status 0
    only if the story is true: named right, better on held-out data, and a smaller tracking error
    where the effect can be compensated; 1 otherwise.

    Example:  zendsp demo --seed 7
    """
    from zendsp.demo import run_demo
    from zendsp.demo.narrator import Narrator

    check_writable(out)
    narrator = Narrator(quiet=as_json)
    try:
        with one_writer(out, "zendsp demo"):
            told = run_demo(
                out, machine=machine, effect=effect, seed=seed, clock=clock, narrator=narrator
            )
    except KeyboardInterrupt:
        click.echo("ended early; the simulated machine ended with it", err=True)
        raise
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise ZendspError(f"--out {out}: cannot be written ({error.strerror})") from error
    emit(json.loads((out / "story.json").read_text(encoding="utf-8")), as_json)
    if web and not as_json:
        click.launch(str((out / "report.html").resolve()))
    raise click.exceptions.Exit(0 if told.true else 1)
