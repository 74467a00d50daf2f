"""``zendsp cut``: a recording's parts as files of their own."""

from __future__ import annotations

import math
from pathlib import Path

import click

from zendsp.cli.common import emit, json_option, out_option, parse_names
from zendsp_protocol.texts import counted


@click.command("cut")
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--from", "begin", type=float, default=0.0, show_default=True, metavar="S",
              help="Leave out what is before, in seconds from the first row.")  # fmt: skip
@click.option("--to", "end", type=float, default=math.inf, metavar="S",
              help="Leave out this and what comes after.")  # fmt: skip
@click.option("--finite", default="", metavar="COLUMNS",
              help="Leave out rows in which one of these is no number.")  # fmt: skip
@click.option("--without", default="", metavar="S:S",
              help="Leave out these seconds; several ranges with commas.")  # fmt: skip
@click.option("--time", default="", metavar="COLUMN", help="Column of time, where it is not found.")
@out_option(
    ".mat, .npz, .parquet, .csv, .mcap or .mf4; of several parts part.csv becomes part-1.csv.",
    required=True,
)
@click.option("--force", is_flag=True, help="Write over files that are there.")
@json_option
def command(
    recording: Path, begin: float, end: float, finite: str, without: str, time: str, out: Path,
    force: bool, as_json: bool,
) -> None:
    """Cut RECORDING: a file for each part without a gap, of the whole or of a range of times.

    What a diagnosis refuses as two runs glued together becomes two recordings; what --without
    leaves out parts a recording too, so that nothing bridges it. The columns keep their names, and
    are in SI units; time is called t. Columns of words and days are left out, which is said.

    Example:  zendsp cut run.csv --from 1.5 --to 20 -o part.csv
    """
    from zendsp.errors import RecordingError
    from zendsp.recording.cut import read_cut
    from zendsp.recording.files import check_suffix

    check_suffix(out)
    left_out = [_range(text) for text in parse_names(without)]
    parts, said = read_cut(recording, begin, end, parse_names(finite), time, left_out)
    files = [
        out.with_stem(f"{out.stem}-{k}") if len(parts) > 1 else out
        for k in range(1, len(parts) + 1)
    ]
    there = [str(file) for file in files if file.exists()]
    if there and not force:
        raise RecordingError(
            f"{', '.join(there)}: is there already; choose another name with -o, or --force to"
            " write over it"
        )
    done: list[Path] = []
    try:
        for part, file in zip(parts, files, strict=True):
            part.save(file)
            done.append(file)
    except BaseException:
        if done:
            click.echo(
                f"zendsp: {len(done)} of {counted(len(files), 'part')} are written and whole:"
                f" {', '.join(map(str, done))}", err=True,
            )  # fmt: skip
        raise
    made = [(str(f), len(p), float(p.t[-1] - p.t[0])) for f, p in zip(files, parts, strict=True)]
    emit(
        [{"file": f, "rows": rows, "seconds": s, "notes": list(said)} for f, rows, s in made],
        as_json,
        "\n".join([
            *(f"{file}: {counted(rows, 'row')}, {s:.6g} s" for file, rows, s in made),
            *(f"  {note}" for note in said),
        ]),
    )


def _range(text: str) -> tuple[float, float]:
    """Two times, s, from a text with a colon between them."""
    first, _, last = text.partition(":")
    try:
        begin, end = float(first), float(last)
    except ValueError:
        begin, end = math.nan, math.nan
    if not begin < end:
        raise click.BadParameter(
            f"{text!r} is no range of times: write two with a colon, such as 4.2:4.25",
            param_hint="'--without'",
        )
    return begin, end
