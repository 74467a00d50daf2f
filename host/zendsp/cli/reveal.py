"""``zendsp reveal``: what a simulated machine conceals, after the diagnosis."""

from __future__ import annotations

from dataclasses import asdict

import click

from zendsp.cli.common import emit, open_target, target_options
from zendsp.errors import ZendspError
from zendsp.link.concealed import TrueEffect
from zendsp_protocol.texts import counted


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
            f"{counted(len(truth.effects), 'concealed effect')}, from {truth.source}, friction"
            f" {truth.friction}, revealed at tick {truth.tick}"
        ]
        for effect in truth.effects:
            values = ", ".join(
                f"{name} {p['value']} {p['unit']}".rstrip()
                for name, p in effect["parameters"].items()
            )
            lines.append(f"  {effect['effect']} on joint {effect['joint']}: {values}")
            lines += _in_model_frame(effect, t.info.machine)
        lines.append(f"seal {truth.sha256}")
        emit(asdict(truth), as_json, "\n".join(lines))


def _in_model_frame(effect: TrueEffect, machine: str) -> list[str]:
    """The position of a payload in the frame that a diagnosis uses, where that is another one."""
    from zendsp.demo.evidence import in_model_frame
    from zendsp.reference import load_machine

    try:
        told = in_model_frame(effect, load_machine(machine))
    except ZendspError:  # a machine that is not shipped: one frame
        return []
    if told is effect:
        return []
    place = ", ".join(f"{told['parameters'][f'com_{k}']['value']:.4g}" for k in "xyz")
    return [f"    that is at {place} m in the model's frame of link {effect['joint']}"]
