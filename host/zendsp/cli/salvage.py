"""``zendsp salvage``: save what a target had recorded before it was killed."""

from __future__ import annotations

import time
from pathlib import Path

import click

from zendsp.cli.common import emit, json_option, out_option
from zendsp_protocol.views import text_table


@click.command("salvage")
@click.option("-t", "--target", default="", metavar="NAME", help="Only of targets of this name.")
@out_option("Save the newest: .mat, .npz, .parquet, .csv, .mcap or .mf4.")
@click.option(
    "--drop", is_flag=True, help="Free the memory of all that is listed, without saving it."
)
@click.option("--note", default="", help="Kept in the recording.")
@json_option
def command(target: str, out: Path | None, drop: bool, note: str, as_json: bool) -> None:
    """List what targets that were killed had recorded; with --out save the newest, and free its
    memory.

    Rows of the last three killed targets stay in memory on the target's own computer. A target that
    ended in good order leaves none. Exit status 1 where there is nothing.

    Example:  zendsp salvage -t imi -o run.mat
    """
    from zendsp.link.salvage import find_salvage
    from zendsp.recording.files import check_suffix

    if out is not None and drop:
        raise click.UsageError(
            "--out saves and frees the newest, --drop frees all without saving: give one of them"
        )
    if out is not None:
        check_suffix(out)
    found = find_salvage(target)
    if not found:
        emit(
            [], as_json,
            f"no recording of a killed target{f' named {target!r}' if target else ''} is kept here",
        )
        raise click.exceptions.Exit(1)
    if out is not None:
        recording = found[0].load(note)
        recording.save(out)
        found[0].drop()
        text = (
            f"{len(recording)} rows of {len(recording.columns)} signals of {recording.target} to"
            f" {out}, {recording.lost} lost"
        )
        emit(
            {
                "file": str(out), "rows": len(recording), "columns": recording.columns,
                "lost": recording.lost,
            },
            as_json,
            text,
        )
        return
    rows = []
    for one in found:
        begun = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(one.begun))
        rows.append([one.target, one.machine, begun, str(one.rows), str(one.columns)])
        if drop:
            one.drop()
    body = [
        {
            "target": f.target, "machine": f.machine, "begun": f.begun, "rows": f.rows,
            "columns": f.columns,
        }
        for f in found
    ]
    said = (
        "\nremoved" if drop else "\nsave the newest with '-o run.mat', or remove all with '--drop'"
    )
    emit(body, as_json, text_table(["TARGET", "MACHINE", "BEGUN", "ROWS", "SIGNALS"], rows) + said)
