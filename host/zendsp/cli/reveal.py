"""``zendsp reveal``: what a simulated machine conceals, after the fact."""

from __future__ import annotations

from dataclasses import asdict

import click

from zendsp.cli.common import emit, open_target, target_options


@click.command("reveal")
@click.option(
    "--seal", "only_seal", is_flag=True,
    help="Only the SHA-256 of the truth: ask before the diagnosis, compare after.",
)
@target_options
def command(target: str, connect: str | None, as_json: bool, only_seal: bool) -> None:
    """Tell which physics the target's simulated machine conceals, checked against its seal.

    Example:  zendsp reveal -t imi
    """
    with open_target(target, connect) as t:
        if only_seal:
            seal = t.seal()
            emit({"sha256": seal}, as_json, seal)
            return
        truth = t.reveal()
        lines = [
            f"{len(truth.effects)} concealed effect(s), from {truth.source}, friction"
            f" {truth.friction}, revealed at tick {truth.tick}"
        ]
        for effect in truth.effects:
            values = ", ".join(
                f"{name} {p['value']} {p['unit']}".rstrip()
                for name, p in effect["parameters"].items()
            )
            lines.append(f"  {effect['effect']} on joint {effect['joint']}: {values}")
        lines.append(f"seal {truth.sha256}")
        emit(asdict(truth), as_json, "\n".join(lines))
