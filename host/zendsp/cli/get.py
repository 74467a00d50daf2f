"""``zendsp get``: read variables."""

from __future__ import annotations

import click

from zendsp.cli.common import emit, open_target, target_options
from zendsp.cli.completing import variables
from zendsp_protocol.states import VariableKind
from zendsp_protocol.views import short


@click.command("get")
@click.argument("names", nargs=-1, shell_complete=variables)
@target_options
def command(names: tuple[str, ...], target: str, connect: str | None, as_json: bool) -> None:
    """Read variables, all from one sample; without NAMES, all of them.

    Example:  zendsp get Kp1 Kd1 'q[0]'
    """
    with open_target(target, connect) as t:
        infos = t.variables()
        chosen = list(names) or [i.name for i in infos.values() if i.kind != VariableKind.TABLE]
        # as it came over the wire: only long arrays need NumPy, for which one would wait longer
        # than for the target
        reading = t.request("read", names=chosen) if chosen else None
        values = dict(reading.values) if reading else {}
        units = {
            name: infos[name.partition("[")[0]].unit
            for name in values
            if name.partition("[")[0] in infos
        }
        body = {
            "tick": reading.tick if reading else None,
            "values": values,
            "units": units,
            "ended": reading.ended if reading else "",
        }
        emit(
            body,
            as_json,
            "\n".join(
                f"{name} = {short(v)} {units.get(name, '')}".rstrip() for name, v in values.items()
            ),
        )
