"""``zendsp reference``: plans a motion, checks it against a machine's limits and saves it; one
subcommand for each kind.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from zendsp.cli.completing import targets
from zendsp.cli.planned_for import machine_for

# A stand-in where the machine decides: the option's help then says so.
MACHINE_DEFAULT = "of the machine"
COLUMNS = ((10, 4), (10, 4), (9, 3), (9, 2), (9, 3))  # width and decimals


def _summary(reference: Any, torque: Any) -> dict[str, Any]:
    """Duration, and the largest magnitudes of each joint."""
    told = [("torque", torque)]
    if not reference.jumps:  # a step has neither
        told += [("speed", reference.qd), ("acceleration", reference.qdd)]
    peaks = {name: abs(x).max(axis=0).tolist() for name, x in told if x is not None}
    return {
        "kind": reference.kind,
        "machine": reference.machine,
        "mode": reference.mode,
        "samples": reference.samples,
        "duration": reference.duration,
        "cyclic": reference.cyclic,
        "unit": reference.unit,
        "position_min": reference.q.min(axis=0).tolist(),
        "position_max": reference.q.max(axis=0).tolist(),
        **dict.fromkeys(("speed", "acceleration"), [None] * reference.joints),
        **peaks,
        "jumps": reference.jumps,
        "parameters": dict(reference.parameters),
    }


def _print_table(summary: dict[str, Any]) -> None:
    from zendsp.reference import JUMPS, UNPREDICTED

    share = 100 * summary["parameters"].get("headroom", 1.0)
    of = "the limits of position" if summary["jumps"] else f"{share:g} % of the limits"
    within = f"within {of}"
    if not summary["limits"]:
        within = "checked against no limits: --machine or --target says whose"
    click.echo(
        f"{summary['kind']} on {summary['machine'] or 'no machine'}: {summary['duration']:g} s,"
        f" {summary['samples']} samples, mode"
        f" {summary['mode']}{', cyclic' if summary['cyclic'] else ''}, {within}"
    )
    u = summary["unit"]
    force = {"rad": "N m", "m": "N"}
    heads = (f"q min {u}", f"q max {u}", f"{u}/s", f"{u}/s^2", force.get(u, ""))
    if u not in force:  # each joint its own: there is no room in the heads
        heads = ("q min", "q max", "speed", "accel.", "torque")
        click.echo(f"positions in {u}, speeds and accelerations likewise, torques in N m or N")
    cells = (f"{head:>{width}}" for head, (width, _) in zip(heads, COLUMNS, strict=True))
    click.echo(f"{'joint':>6} {' '.join(cells)}")
    columns = zip(
        *(summary[k] for k in ("position_min", "position_max", "speed", "acceleration")),
        strict=True,
    )
    torque = summary.get("torque")
    limits = list(zip(*summary["limits"].values(), strict=True))
    for j, row in enumerate(columns):
        _print_row(str(j + 1), (*row, None if torque is None else torque[j]))
        if limits:  # of the machine itself, without the headroom
            _print_row("limit", limits[j])
    if torque is None and (limits or summary["jumps"]):
        click.echo(JUMPS if summary["jumps"] else UNPREDICTED)


def _print_row(name: str, row: tuple[float | None, ...]) -> None:
    cells = (
        f"{'–' if x is None else f'{x:.{digits}f}':>{width}}"
        for x, (width, digits) in zip(row, COLUMNS, strict=True)
    )
    click.echo(f"{name:>6} {' '.join(cells)}")


def _finish(
    make: Callable[[], Any], machine: Any, out: str | None, plot: str | None, as_json: bool,
    check: bool, takes: str = "",
) -> None:
    """Plan or read the motion with ``make``, then check, save, draw and print it."""
    from zendsp.cli.progress import stages

    with stages(quiet=as_json) as tell:
        if machine is not None:
            tell(f"planning within the limits of {machine.name}{takes and f' ({takes})'}")
        summary = _made(make(), machine, out, plot, check, tell)
    if as_json:
        click.echo(json.dumps(summary))
        return
    _print_table(summary)
    for key in ("file", "plot"):
        if key in summary:
            click.echo(f"wrote {summary[key]}")


def _made(
    reference: Any, machine: Any, out: str | None, plot: str | None, check: bool,
    tell: Callable[[str], None],
) -> dict[str, Any]:
    from zendsp.reference import save_reference

    if machine is not None and check:
        machine.check(reference)
    summary = _summary(reference, None if machine is None else machine.torque(reference))
    summary["limits"] = {} if machine is None else {
        key: [float(x) if math.isfinite(x) else None for x in getattr(machine.limits, key)]
        for key in ("position_min", "position_max", "speed", "acceleration", "torque")
    }
    if out is not None:
        summary["file"] = str(save_reference(reference, out, machine, check=False))
    if plot is not None:
        tell(f"drawing {plot}")
        from zendsp.reference import plot_reference

        Path(plot).parent.mkdir(parents=True, exist_ok=True)
        plot_reference(reference, machine, plot)
        summary["plot"] = plot
    return summary


_MACHINE = (
    click.option("--connect", metavar="ENDPOINT", help="Where to reach the target."),
    click.option(
        "-t", "--target", default="", metavar="NAME", shell_complete=targets,
        help="Take the limits of this running target.",
    ),
    click.option(
        "--machine", "machine_name", default=None,
        help="imi_planar, pendulum, wam7, a .toml description, or a robot's file (.urdf, .xml).",
    ),
)


def _common(function: Any) -> Any:
    """A command with the options of every kind."""
    for option in (
        click.option(
            "--json", "as_json", is_flag=True, help="Print one JSON object instead of the table."
        ),
        click.option(
            "--no-check", is_flag=True, help="Write it even where it breaks limits of the machine."
        ),
        click.option(
            "--plot", type=click.Path(dir_okay=False), help="Draw it: .png, .svg or .pdf."
        ),
        click.option(
            "-o",
            "--out",
            type=click.Path(dir_okay=False),
            help="Write it: the .mat file that Execute plays.",
        ),
        *_MACHINE,
    ):
        function = option(function)
    return function


def _default_text(parameter: Any) -> str:
    home = parameter.type == "joints" and parameter.default is None
    if parameter.by_machine or parameter.keeps or home:
        return MACHINE_DEFAULT
    if parameter.default is None:
        return "none"
    if isinstance(parameter.default, list):
        return ",".join(f"{x:g}" for x in parameter.default)
    return (
        f"{parameter.default:g}" if isinstance(parameter.default, float) else str(parameter.default)
    )


def _say_of_all(kind: Any, chosen: dict[str, str], joints: int) -> None:
    """Say that one number is taken for each of several joints."""
    for parameter in kind.parameters:
        value = chosen.get(parameter.name, "")
        if joints > 1 and parameter.type == "joints" and value and "," not in value:
            option = f"--{parameter.name.replace('_', '-')}"
            each = ",".join(f"Q{j + 1}" for j in range(joints))
            click.echo(
                f"zendsp: {option} {value} is taken for each of the {joints} joints; a number of"
                f" its own for each is written {option} {each}",
                err=True,
            )


def _make_command(kind: Any) -> click.Command:
    """The subcommand of one kind, with an option for each of its parameters."""

    def run(
        out: str | None,
        plot: str | None,
        as_json: bool,
        no_check: bool,
        sample_time: float | None,
        **given: str | None,
    ) -> None:
        from zendsp.reference import MACHINES, load_machine, make_reference

        asked = given.pop("machine_name"), given.pop("target") or "", given.pop("connect")
        machine = machine_for(*asked) or next(
            one for one in map(load_machine, MACHINES) if kind.fits(one)
        )
        chosen = {name: value for name, value in given.items() if value is not None}
        _say_of_all(kind, chosen, machine.joints)

        def make() -> Any:
            return make_reference(kind.name, machine, sample_time=sample_time, **chosen)

        _finish(make, machine, out, plot, as_json, not no_check, kind.takes)

    options: list[click.Parameter] = []
    from zendsp.reference.registry import HEADROOM

    for parameter in (*kind.parameters, HEADROOM):
        unit = f" [{parameter.unit}]" if parameter.unit else ""
        text = _default_text(parameter)
        default = f"default {text}" if text else "required"
        bounds = (
            ""
            if parameter.choices or not parameter.describe_bounds()
            else f"; {parameter.describe_bounds()}"
        )
        options.append(
            click.Option(
                [f"--{parameter.name.replace('_', '-')}", parameter.name],
                type=click.Choice(list(parameter.choices)) if parameter.choices else str,
                metavar=None if parameter.choices else parameter.type.upper(),
                help=f"{parameter.description}{unit} ({default}{bounds})",
                required=not text,
            )
        )
    options.append(
        click.Option(["--sample-time"], type=float, help="Sample time [s] (default of the machine)")
    )
    files = "".join(f" --{p.name} motion.csv" for p in kind.parameters if p.type == "path")
    example = (
        f"Example:  zendsp reference {kind.name}{files} --out {kind.name}.mat"
        f" --plot {kind.name}.png"
    )
    command = click.Command(
        kind.name, callback=run, params=options, help=f"{kind.description}\n\n{example}",
        short_help=kind.title,
    )
    return _common_on(command)


def _common_on(command: click.Command) -> click.Command:
    """Append the common options to a command made without decorators."""

    @_common
    def carrier() -> None: ...

    command.params.extend(reversed(carrier.__click_params__))
    return command


class _Kinds(click.Group):
    """One subcommand for each kind of reference, made from the registry when it is needed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        from zendsp.reference import KINDS

        return [*KINDS, *super().list_commands(ctx)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        from zendsp.reference import KINDS

        name = cmd_name.replace("-", "_")
        return _make_command(KINDS[name]) if name in KINDS else super().get_command(ctx, cmd_name)


@click.group(cls=_Kinds, context_settings={"help_option_names": ["-h", "--help"]})
def command() -> None:
    """Plan a motion within a machine's limits and save it as the MAT file that Execute plays.

    Joint lists are one number for all joints or one per joint: --start 0.1,-0.2. Exit status 2 when
    a limit is broken.

    Example:  zendsp reference circle --machine imi_planar --radius 0.15 --out circle.mat --plot
    circle.png
    """


@command.command("show", short_help="Check and describe a saved reference")
@click.argument("file", type=click.Path(exists=True, dir_okay=False))
@click.option(
    "--machine", "machine_name", default=None, help="Check against this machine instead of its own."
)
@click.option(
    "-t", "--target", default="", metavar="NAME", shell_complete=targets,
    help="Check against the limits of this running target.",
)
@click.option("--connect", metavar="ENDPOINT", help="Where to reach the target.")
@click.option("--plot", type=click.Path(dir_okay=False), help="Draw it: .png, .svg or .pdf.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object instead of the table.")
def show(
    file: str,
    machine_name: str | None,
    target: str,
    connect: str | None,
    plot: str | None,
    as_json: bool,
) -> None:
    """Read a reference file, check it against the limits, print its extremes. Of one that names no
    machine, as a diagnosis writes it, the extremes alone where no machine is named either.

    Example:  zendsp reference show circle.mat
    """
    from zendsp.errors import ReferenceError_
    from zendsp.reference import load_machine, load_reference

    reference = load_reference(file)
    machine = machine_for(machine_name, target, connect)
    if machine is None and not reference.machine and plot is not None:
        raise ReferenceError_(
            f"{file} names no machine: say with --machine or --target whose limits to draw"
        )
    if machine is None and reference.machine:
        try:
            machine = load_machine(reference.machine)
        except ReferenceError_ as error:
            if reference.machine.endswith(".toml"):
                raise
            raise ReferenceError_(
                f"{file} is of the machine {reference.machine!r}, which is none of zendsp's: say"
                " where its limits are: --target NAME of one that runs, or --machine FILE"
            ) from error
    _finish(lambda: reference, machine, None, plot, as_json, check=True)
