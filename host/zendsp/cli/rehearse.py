"""``zendsp rehearse``: plays a planned motion with the loaded program on a simulated twin, before
the machine moves.
"""

from __future__ import annotations

import click

from zendsp.cli.common import emit, open_target, target_options


@click.command("rehearse")
@click.argument("file", type=click.Path(exists=True, dir_okay=False))
@target_options
def command(file: str, target: str, connect: str | None, as_json: bool) -> None:
    """Play the reference FILE with the loaded program on a simulated twin of the target's machine;
    the target does not move.

    Same code, parameters, limits and position. A reference of another number of joints, or of
    another machine in another unit, is refused; that it was planned for another machine is told.
    Exit status 1 where a limit would be passed, or nothing could be simulated.

    Example:  zendsp rehearse circle.mat
    """
    from zendsp.link import rehearse
    from zendsp.reference import check_fits, load_reference

    reference = load_reference(file)
    with open_target(target, connect) as t:
        machine = t.machine()
        told = check_fits(reference, machine.name, [joint.unit for joint in machine.joints])
        known = t.variables()
        wanted = {"use_table": True, "row_rate": round(1.0 / reference.sample_time)}
        values = {name: value for name, value in wanted.items() if name in known}
        tables = {name: rows for name, rows in reference.tables().items() if name in known}
        approach = float(t["approach_time"]) if "approach_time" in known else 0.0  # type: ignore[arg-type]
        found = rehearse(t, tables, values, approach + reference.duration + 0.5)
    if told:
        click.echo(f"zendsp: {told}", err=True)
    emit(
        {
            "simulated": found.simulated, "trip": found.trip, "text": found.text,
            "peaks": found.peaks, "reference": told,
        },
        as_json,
        found.text if found.simulated else f"it could not be simulated: {found.text}",
    )
    if not found.good:
        raise click.exceptions.Exit(1)
