"""``zendsp keys``: a lab's certificates, and who may do what."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from zendsp.cli.common import emit, json_option
from zendsp_protocol.verbs import ROLES
from zendsp_protocol.views import text_table

_folder = click.option(
    "--folder", default="lab", show_default=True, type=click.Path(path_type=Path),
    help="Where the lab's keys are.",
)


def _days(default: int) -> Callable[..., Any]:
    return click.option(
        "--days", default=default, show_default=True, type=click.IntRange(1, 36500),
        help="How long it is good for.",
    )


@click.group("keys")
def command() -> None:
    """Make a lab's certificates and say who may do what.

    The folder holds the authority's key: keep it on one computer, and copy only what each command
    says.

    Example:  zendsp keys init && zendsp keys target imi --host robot.lab && zendsp keys user anna
    --role tune
    """


@command.command("init")
@_folder
@_days(3650)
def init(folder: Path, days: int) -> None:
    """Make an authority, which signs all other certificates.

    Example:  zendsp keys init --folder lab
    """
    from zendsp.lab_keys import Lab

    lab = Lab.create(folder, days)
    click.echo(
        f"{lab.authority} is the lab's authority. Its key, ca.key, stays here. Next: zendsp keys"
        " target NAME, zendsp keys user NAME"
    )


@command.command("target")
@click.argument("name")
@click.option(
    "--host", "hosts", multiple=True, metavar="NAME|ADDRESS",
    help="Under which hosts reach it; may be repeated.",
)
@_folder
@_days(730)
def target(name: str, hosts: tuple[str, ...], folder: Path, days: int) -> None:
    """Make key and certificate of a target.

    Example:  zendsp keys target imi --host robot.lab --host 192.168.1.5
    """
    from zendsp.lab_keys import Lab

    lab = Lab(folder)
    made = lab.add_target(name, hosts, days)
    click.echo(
        f"Copy {made.certificate}, {made.key}, {lab.authority} and {lab.roles_file} to the target,"
        f" and start it there with\n  zendsp target --name {name} --listen here --listen"
        f" tls/0.0.0.0:7447 --tls-cert {name}.pem --tls-key {name}.key --tls-ca ca.pem --roles"
        " roles.toml"
    )
    if not hosts:
        click.echo("Good for localhost only: --host NAME makes one for other computers", err=True)


@command.command("user")
@click.argument("name")
@click.option(
    "--role", required=True, type=click.Choice(ROLES),
    help="Each includes those before it; download runs code there.",
)
@click.option("--renew", is_flag=True, help="A new key and certificate also where there is one.")
@_folder
@_days(730)
def user(name: str, role: str, renew: bool, folder: Path, days: int) -> None:
    """Give a person a role, and a key and certificate where there is none yet.

    Example:  zendsp keys user anna --role tune
    """
    from zendsp.lab_keys import Lab

    lab = Lab(folder)
    before = {holder.certificate: holder.until for holder in lab.holders()}
    made = lab.add_user(name, role, days, renew)
    if made.ended:
        day = f"{made.until:%Y-%m-%d}"
        click.echo(f"{made.certificate} ended on {day}: --renew makes another", err=True)
    click.echo(
        f"{name} may {role}. Copy {lab.roles_file} to each target; one that runs takes a new role"
        " at once, a new name when it starts."
    )
    if before.get(made.certificate) != made.until:
        click.echo(
            f"{name} gets {made.certificate}, {made.key} and {lab.authority}, and says\n  export"
            f" ZENDSP_CONNECT=tls/ROBOT:7447 ZENDSP_TLS_CA=ca.pem ZENDSP_TLS_CERT={name}.pem"
            f" ZENDSP_TLS_KEY={name}.key"
        )


@command.command("list")
@_folder
@json_option
def list_(folder: Path, as_json: bool) -> None:
    """List who has a certificate, and with which role.

    Example:  zendsp keys list
    """
    from zendsp.lab_keys import Lab

    holders = Lab(folder).holders()
    rows = [
        [
            h.name, h.kind, h.role, f"{h.until:%Y-%m-%d}{' ended' if h.ended else ''}",
            str(h.certificate),
        ]
        for h in holders
    ]
    body = [
        {
            "name": h.name, "kind": h.kind, "role": h.role, "until": h.until.isoformat(),
            "certificate": str(h.certificate),
        }
        for h in holders
    ]
    emit(
        body,
        as_json,
        (
            text_table(["NAME", "KIND", "ROLE", "UNTIL", "CERTIFICATE"], rows)
            if rows
            else "no certificates yet"
        ),
    )


@command.command("revoke")
@click.argument("name")
@_folder
def revoke(name: str, folder: Path) -> None:
    """Take a person's role away.

    Example:  zendsp keys revoke anna
    """
    from zendsp.lab_keys import Lab

    lab = Lab(folder)
    lab.revoke(name)
    click.echo(
        f"{name} has no role any more. Copy {lab.roles_file} to each target; it holds there at"
        " once."
    )
