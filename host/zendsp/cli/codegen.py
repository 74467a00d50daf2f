"""``zendsp model2c``: a model as C functions for a control program."""

from __future__ import annotations

from pathlib import Path

import click

from zendsp.cli.common import out_option
from zendsp.errors import ModelError
from zendsp.whole_file import write_whole
from zendsp_protocol.texts import shown


@click.command("model2c")
@click.argument("model", type=click.Path(path_type=Path))
@out_option("File to write. Default: print it.")
@click.option(
    "--effects-only", is_flag=True,
    help="Only what a torque can cancel, as Compensation(), without the rigid bodies.",
)
@click.option(
    "--sign-speed",
    type=click.FloatRange(min=0),
    default=0.02,
    show_default=True,
    help="Speed over which dry friction changes its sign [rad/s]; 0: at once.",
)
def command(model: Path, out: Path | None, effects_only: bool, sign_speed: float) -> None:
    """Turn the model file MODEL into C: inverse dynamics, gravity, friction and every effect that a
    torque can cancel.

    Include the file in a control program after isr.h and call ModelInit() in UserInit: every number
    is then a parameter that can be changed while the program runs.

    Example:  zendsp model2c imi_planar.toml --out model.c
    """
    from zendsp.physics import compensation, load_model, model_code

    loaded = load_model(model)
    if effects_only:
        kinds = [loaded.joint_kind(j + 1) for j in range(loaded.joints)]
        text = compensation(
            loaded.terms, title=loaded.name, kinds=kinds, actuator=loaded.actuator,
            sign_speed=sign_speed,
        )
    else:
        text = model_code(loaded, sign_speed=sign_speed)
    if out is None:
        click.echo(text, nl=False)
        return
    made = "compensation.c" if effects_only else "model.c"
    text = text.replace(f'#include "{made}"', f'#include "{shown(out.name, lines=False)}"', 1)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(out, text)
    except OSError as error:
        raise ModelError(f"{out}: cannot be written ({error.strerror})") from error
    click.echo(f"wrote {out}")
