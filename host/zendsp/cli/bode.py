"""``zendsp bode``: the frequency response of a running machine."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from zendsp.cli.common import (
    announcing,
    emit,
    open_target,
    out_option,
    progress,
    target_options,
)
from zendsp.cli.completing import variables
from zendsp.cli.progress import drawing
from zendsp_protocol.views import text_table


@click.command("bode")
@click.option("-j", "--joint", type=int, default=1, show_default=True, help="From 1.")
@click.option("--f-min", type=float, default=0.5, show_default=True, help="Hz.")
@click.option("--f-max", type=float, default=30.0, show_default=True, help="Hz.")
@click.option(
    "--lines", type=int, default=30, show_default=True,
    help="Frequencies at the most: multiples of --f-min, every third of neighbours left out.",
)
@click.option(
    "-a", "--amplitude", type=float, default=None,
    help="Peak of what swings: rad (m), with --torque N m (N). Default: by the machine, and told.",
)
@click.option("--torque", is_flag=True, help="Swing the torque beside a held position.")
@click.option("--input", default="", shell_complete=variables, help="Default: r, or tau.")
@click.option("--output", default="", shell_complete=variables, help="Default: q.")
@click.option("--periods", type=int, default=6, show_default=True, help="That are used.")
@click.option("--no-rehearsal", is_flag=True, help="Do not try it on a simulated twin first.")
@out_option("Write the rows (CSV).")
@click.option("--plot", type=click.Path(path_type=Path), help="Draw it there (PNG, SVG, PDF).")
@target_options
def command(
    joint: int,
    f_min: float,
    f_max: float,
    lines: int,
    amplitude: float | None,
    torque: bool,
    input: str,
    output: str,
    periods: int,
    no_rehearsal: bool,
    out: Path | None,
    plot: Path | None,
    target: str,
    connect: str | None,
    as_json: bool,
) -> None:
    """Swing one joint by many sines at once and show output over input: dB, deg, coherence.

    Moves the machine. Where friction, a gap or a limit acts, ± is larger and another --amplitude
    gives another response: measure with two. The loaded program must play tables, as pd.c and
    joint_pd.c do; the sines come from its table, on the target's own clock. Afterwards the
    program does what it did before. Ended early, the machine is held where it is; a program with a
    motion of its own is paused.

    Example:  zendsp bode --joint 1 --f-max 20 --plot bode.png
    """
    from zendsp.experiment.frequency import frequency_response, usual_amplitude
    from zendsp.experiment.response import shown_lines

    for path, kinds in ((out, (".csv",)), (plot, (".png", ".svg", ".pdf"))):
        if path is not None and path.suffix.lower() not in kinds:
            raise click.BadParameter(f"{path}: must end in {' or '.join(kinds)}")
    quantity: Literal["position", "torque"] = "torque" if torque else "position"
    seconds = (periods + 1) / f_min if f_min > 0.0 else 0.0
    with (
        open_target(target, connect, moves=True) as t,
        progress("measuring", seconds, as_json) as tell,
    ):
        if amplitude is None:
            amplitude, unit = usual_amplitude(t.machine(), t.limits(), joint, quantity)
            tell = announcing(f"joint {joint} swings by {amplitude:g} {unit}", tell)
        found = frequency_response(
            t, joint=joint, f_min=f_min, f_max=f_max, lines=lines, amplitude=amplitude,
            quantity=quantity, input=input, output=output, periods=periods,
            rehearsed=not no_rehearsal, progress=tell,
        )  # fmt: skip
    header = ["f [Hz]", "dB", "deg", "± dB", "± deg", "coherence"]
    shown = text_table(header, shown_lines(found.rows()))
    emit(found.rows(), as_json, f"{shown}\n{found.summary()}")
    if out is not None:  # last: what was measured is seen where it cannot be written
        found.save(out)
    if plot is not None:
        with drawing(plot, quiet=as_json):
            found.plot(plot)
