"""``zendsp simulate``: runs the control program against the host's model of the machine, without a
target.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from zendsp.cli.common import file_and_values, flag_option, json_option, out_option, parse_names
from zendsp.cli.completing import models, programs

if TYPE_CHECKING:
    from zendsp.recording import Recording


@click.command("simulate")
@click.argument("words", nargs=-1, required=True, metavar="PROGRAM", shell_complete=programs)
@click.option(
    "--model", "model_path", required=True, type=click.Path(path_type=Path), shell_complete=models,
    help="Model of the machine (TOML).",
)
@click.option(
    "--reference",
    type=click.Path(path_type=Path),
    help="Reference file (.mat) that the program follows.",
)
@click.option(
    "--seconds",
    type=click.FloatRange(min=0, min_open=True),
    help="Default: approach, reference and half a second; 10 s without a reference.",
)
@click.option(
    "--set", "assignments", multiple=True, metavar="NAME=VALUE",
    help="Parameter of the program; several too: --set Kp1=400 Kd1=40.",
)
@click.option(
    "--channels", help="What to record, with commas. Default: every SIGNAL of the program."
)
@click.option(
    "--position",
    help="Where the machine starts: one number, or one per joint with commas (rad or m).",
)
@click.option(
    "--inner", type=click.IntRange(1, 256), default=4, show_default=True,
    help="Integration steps per sample.",
)
@click.option(
    "--check",
    is_flag=True,
    help=(
        "Halve the step until no position changes by more than one count; status 1 if it never"
        " settles."
    ),
)
@flag_option
@out_option("Write the recording: .mat, .npz, .parquet, .csv, .mcap or .mf4.")
@click.option("--plot", type=click.Path(path_type=Path), help="Draw it: .png, .svg or .pdf.")
@json_option
def command(
    words: tuple[str, ...],
    model_path: Path,
    reference: Path | None,
    seconds: float | None,
    assignments: tuple[str, ...],
    channels: str | None,
    position: str | None,
    inner: int,
    check: bool,
    flags: tuple[str, ...],
    out: Path | None,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Run the control program PROGRAM, as it is, against a model of the machine: where a trajectory
    is tried before the machine moves.

    In fast time and deterministic; the recording has the form of an acquisition. Exit status 1
    where the code does not compile, or a limit of the model is left.

    Example:  zendsp simulate inverse_dynamics.c --model imi_planar.toml --reference
    circle.mat --out circle_sim.mat
    """
    from zendsp.cli.progress import drawing, stages
    from zendsp.errors import CompileFailed
    from zendsp.physics import simulate
    from zendsp_isr.sources import find_program

    program, values = file_and_values(words, assignments)
    if program is None:
        raise click.UsageError("missing argument 'PROGRAM'")
    source = find_program(program)
    wanted = parse_names(channels) if channels else None
    start = _numbers(position)
    with stages(quiet=as_json) as tell:
        tell("simulating")
        try:
            rec = simulate(
                source, model_path, reference=reference, seconds=seconds, parameters=values,
                channels=wanted, position=start, inner=inner, check=check, flags=flags,
            )
        except CompileFailed as error:
            click.echo(str(error), err=True)
            raise click.exceptions.Exit(1) from None
    files = {}
    if out is not None:
        files["file"] = str(rec.save(out))
    if plot is not None:
        with drawing(plot, quiet=as_json):
            rec.plot(wanted, plot)
        files["plot"] = str(plot)
    if as_json:
        summary = {
            "rows": len(rec),
            "seconds": len(rec) * rec.sample_time,
            "largest": _peaks(rec),
            "step_check": rec.extra.get("step_check"),
            "beyond": rec.extra["simulation"]["beyond"],
            "reference": rec.extra["simulation"].get("reference", ""),
            **files,
        }
        click.echo(json.dumps(summary))
    else:
        _say(rec)
        for path in files.values():
            click.echo(f"wrote {path}")
    beyond = rec.extra["simulation"]["beyond"]
    told = rec.extra["simulation"].get("reference", "")
    for sentence in filter(None, [*beyond, told]):
        click.echo(f"zendsp: {sentence}", err=True)
    found = rec.extra.get("step_check")
    if beyond or (found is not None and not found["converged"]):
        raise click.exceptions.Exit(1)


def _peaks(rec: Recording) -> dict[str, float | list[float]]:
    """The largest magnitude of each signal."""
    import numpy as np

    return {name: np.abs(rec[name]).max(axis=0).tolist() for name in rec.names}


def _say(rec: Recording) -> None:
    """Print the result of a simulation."""
    import numpy as np

    click.echo(
        f"{len(rec)} rows of {rec.sample_time * 1e3:g} ms on the model {rec.machine}; largest"
        " magnitudes:"
    )
    peaks = _peaks(rec)
    for channel in rec.channels:
        text = ", ".join(f"{x:.5g}" for x in np.atleast_1d(peaks[channel.name]))
        click.echo(f"  {channel.name:<12} {text} {channel.unit}".rstrip())
    found = rec.extra.get("step_check")
    if found is not None:
        last, unit, joint = max(
            (change, found["units"][j], j + 1)
            for j, change in enumerate(found["halvings"][-1]["change"])
        )
        what = "settled" if found["converged"] else "NOT settled"
        click.echo(
            f"step check: {what} at {rec.extra['simulation']['inner']} steps a sample; halving"
            f" it changes positions by {last:.2g} {unit} at the most (joint {joint})"
        )


def _numbers(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise click.BadParameter(
            f"{text!r} is not a list of numbers like 0.1,-0.2", param_hint="--position"
        ) from None
