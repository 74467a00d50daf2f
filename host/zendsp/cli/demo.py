"""``zendsp demo``: the main job, from nothing to a picture, in one command."""

from __future__ import annotations

from pathlib import Path

import click

from zendsp.cli.common import emit


@click.command("demo")
@click.option("-o", "--out", type=click.Path(path_type=Path, file_okay=False), default=Path("zendsp-demo"), show_default=True,
              help="Folder for what it makes.")  # fmt: skip
@click.option("--clock", type=click.Choice(["real", "fast"]), default="real", show_default=True,
              help="fast: simulated time runs as fast as the CPU allows.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(out: Path, clock: str, as_json: bool) -> None:
    """Start a simulated arm, run C code on it, tune it while it moves, record it, and draw what happened.

    Example:  zendsp demo --out /tmp/demo
    """
    import zendsp
    from zendsp.demo import run_live_loop

    out.mkdir(parents=True, exist_ok=True)
    said: list[str] = []

    def say(text: str) -> None:
        said.append(text)
        if not as_json:
            click.echo(f"  {text}")

    with zendsp.local("imi_planar", clock=clock) as target:
        say(f"target {target.name} runs in process {target.info.pid}")
        recording = run_live_loop(target, out, say)
    made = [out / "circle.png", out / "circle.mat"]
    body = {"said": said, "files": [str(path) for path in made], "rows": len(recording), "lost": recording.lost}
    emit(body, as_json, "\n".join(["", "look at", *(f"  {path}" for path in made)]))
