"""``zendsp acquire``: record channels into a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from zendsp.cli.common import emit, open_target, out_option, progress, target_options
from zendsp.cli.completing import variables
from zendsp.cli.progress import drawing
from zendsp.errors import RecordingError

if TYPE_CHECKING:
    from zendsp.link import Target
    from zendsp.recording import Recording

PICTURES = (".png", ".svg", ".pdf")


@click.command("acquire")
@click.argument("channels", nargs=-1, shell_complete=variables)
@click.option("-s", "--seconds", type=float, help="How long, in the target's time.")
@out_option(".mat, .npz, .parquet, .csv, .mcap or .mf4.", required=True)
@click.option(
    "--decimation", type=int, default=1, show_default=True, help="Every how many samples a row."
)
@click.option("--trigger", metavar="SOURCE", help="Wait until this variable crosses --level.")
@click.option("--level", type=float, default=0.0, show_default=True)
@click.option(
    "--edge", type=click.Choice(["rising", "falling", "both"]), default="rising", show_default=True
)
@click.option(
    "--pre", type=float, default=0.0, show_default=True,
    help="Seconds to keep from before the trigger.",
)
@click.option("--start", is_flag=True, help="Also start the program, and pause it afterwards.")
@click.option("--take", is_flag=True, help="Also when another host is recording.")
@click.option(
    "--last", is_flag=True, help="Save what was recorded last, by a host that was lost, say."
)
@click.option("--note", default="", help="Kept in the recording.")
@click.option("--plot", type=click.Path(path_type=Path), help="Also draw it there (PNG, SVG, PDF).")
@target_options
def command(
    channels: tuple[str, ...],
    seconds: float | None,
    out: Path,
    decimation: int,
    trigger: str | None,
    level: float,
    edge: str,
    pre: float,
    start: bool,
    take: bool,
    last: bool,
    note: str,
    plot: Path | None,
    target: str,
    connect: str | None,
    as_json: bool,
) -> None:
    """Record CHANNELS (variables, elements, built-in signals) and save them with their metadata.

    A folder that is not there is made. Exit status 1 where the program stopped or crashed before
    the end, 130 after Ctrl-C; what was recorded until then is saved all the same. Where it cannot
    be written there, it is written to the folder for temporary files, and exit status 1.

    With --last nothing is recorded: what the target holds of the recording before is saved, until
    another one begins.

    Example:  zendsp acquire q tau -s 2 -o run.mat
    """
    from zendsp.cli.stats import late_since
    from zendsp.errors import AcquisitionError, Incomplete, RunnerDied
    from zendsp.link import Trigger

    _check(channels, seconds, last, out, plot)
    when = Trigger(source=trigger, level=level, edge=edge, pre_s=pre) if trigger else None
    ended = ""
    with open_target(target, connect, moves=True) as t:
        before = t.status().timing
        try:
            if seconds is None:
                recording = t.acquire_load(note)
            else:
                with progress("recording", seconds, as_json) as set_fraction:
                    recording = t.acquire(
                        list(channels), seconds, decimation, when, start=start, take=take,
                        note=note, progress=set_fraction,
                    )
            status = t.status()
            if status.trip is not None and not last:
                ended = f"the program was {status.state} within the recording"
        except (RunnerDied, Incomplete) as error:
            ended = str(error)
            try:
                recording = t.acquire_load(note or ended)
            except AcquisitionError:  # nothing was recorded
                raise error from None
        except KeyboardInterrupt as error:
            ended = "interrupted"
            try:
                recording = _kept(t, note)
            except AcquisitionError:
                raise error from None
        late = late_since(before, t.status().timing)
    never = ""
    if when is not None and ended == "interrupted" and recording.trigger_row < 0:
        never = f"; the trigger never came: {trigger} did not cross {level:g} ({edge})"
    made = "" if out.parent.is_dir() else ", in a new folder"
    written, wrong = _saved(recording, out, target, connect)
    if wrong:
        click.echo(f"zendsp: {wrong}", err=True)
    body = {
        "file": str(written), "rows": len(recording), "columns": recording.columns,
        "lost": recording.lost, "late": late, "ended": ended,
    }
    emit(
        body,
        as_json,
        f"{len(recording)} rows of {len(recording.columns)} signals to"
        f" {written}{made}, {recording.lost} lost" + (f", {late}" if late else "") + never,
    )
    drawn = plot is None or _draw(recording, plot)
    if ended == "interrupted":
        raise KeyboardInterrupt
    if ended:
        click.echo(f"zendsp: {ended}", err=True)
        raise click.exceptions.Exit(1)
    if wrong or not drawn:
        raise click.exceptions.Exit(1)


def _without_trigger() -> None:
    """Refuse what says how a trigger works, where there is none."""
    context = click.get_current_context()
    for name in ("level", "edge", "pre"):
        if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            raise click.UsageError(
                f"--{name} belongs to a trigger: name what is waited for, --trigger SOURCE"
            )


def _kept(target: Target, note: str) -> Recording:
    """What was recorded until Ctrl-C. Pressed again, it ends neither this nor the saving."""
    from zendsp.here.uninterrupted import uninterrupted

    click.get_current_context().with_resource(uninterrupted())
    return target.acquire_load(note)


def _saved(
    recording: Recording, out: Path, target: str, connect: str | None
) -> tuple[Path, str]:
    """Save a recording as `save_anyhow` does. Where that fails, say where it still is."""
    from zendsp.link.way_back import which
    from zendsp.recording.files import save_anyhow

    try:
        return save_anyhow(recording, out)
    except RecordingError as error:
        again = f"zendsp acquire --last{which(target, connect)} -o FILE"
        raise RecordingError(
            f"{error}; until another one begins, the target has it: {again}"
        ) from error


def _check(
    channels: tuple[str, ...], seconds: float | None, last: bool, out: Path, plot: Path | None
) -> None:
    """Refuse options that exclude one another, before the recording rather than after it."""
    from zendsp.recording.files import check_suffix

    check_suffix(out)
    if click.get_current_context().params["trigger"] is None:
        _without_trigger()
    if last and (channels or seconds is not None):
        raise click.UsageError("--last saves what is recorded already: without CHANNELS, --seconds")
    if not last and (seconds is None or not channels):
        raise click.UsageError(
            "what, and how long? For example: zendsp acquire q tau --seconds 2 --out run.mat"
        )
    if plot is not None and plot.suffix.lower() not in PICTURES:
        raise click.BadParameter(
            f"{plot}: a picture ends in {', '.join(PICTURES)}", param_hint="--plot"
        )


def _draw(recording: Recording, path: Path) -> bool:
    """Draw the recording. A picture that cannot be written is only a message, since the recording
    is saved.
    """
    try:
        with drawing(path, quiet=False):
            recording.plot(path=path)
    except RecordingError as error:
        click.echo(f"zendsp: {error}", err=True)
        return False
    return True
