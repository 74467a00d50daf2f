"""``zendsp model``: begin a model file from a recording, and check one."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from zendsp.cli.common import emit, json_option, out_option
from zendsp.cli.complaints import say_open
from zendsp.errors import ModelError
from zendsp.whole_file import write_whole

if TYPE_CHECKING:
    from zendsp.physics.model import Model

FILE = click.Path(path_type=Path)


@click.group("model")
def command() -> None:
    """Begin a model file from a recording; check one.

    Example:  zendsp model new run.csv
    """


@command.command("new")
@click.argument("recording", type=FILE)
@out_option("Default: the recording's name with .toml, in this folder.")
@click.option("--robot", type=FILE, help="A URDF or an MJCF: it has the bodies.")
@click.option("--force", is_flag=True, help="Write over a file that is there.")
@json_option
def new(
    recording: Path, out: Path | None, robot: Path | None, force: bool, as_json: bool
) -> None:
    """Write a commented model file from a recording, with questions where the recording cannot
    tell.

    Example:  zendsp model new run.csv -o bench.toml
    """
    import tomllib

    from zendsp.physics.files.draft import draft_model, model_name
    from zendsp.physics.files.draft_data import machine_of
    from zendsp.physics.files.model_file import parse_model
    from zendsp.recording import read_table

    words = ["zendsp", "model", "new", str(recording)]
    words += [*(["-o", str(out)] if out else []), *(["--robot", str(robot)] if robot else [])]
    typed = shlex.join([*words, "--force"] if force else words)
    out = out or model_name(recording)
    if out.exists() and not force:
        raise ModelError(
            f"{out}: is there already; choose another name with -o, or --force to write over it"
        )
    machine = machine_of(recording, out.parent)
    draft = draft_model(read_table(recording), machine, robot, out.parent, typed)
    parse_model(tomllib.loads(draft.text), str(out))  # what is written can be read
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(out, draft.text)
    except OSError as error:
        raise ModelError(f"{out}: cannot be written ({error.strerror})") from error
    lines = [
        f"{out}: {draft.joints} joint{'s' if draft.joints > 1 else ''},"
        f" {_questions(len(draft.questions))}"
    ]
    lines += [f"  ? {question}" for question in draft.questions]
    if draft.unused:
        lines += [f"  not used: {', '.join(draft.unused)} (if it has a role, name it in [columns])"]
    words = ["zendsp", "model", "check", str(out), "--recording", str(recording)]
    lines += [f"then: {shlex.join(words)}"]
    emit(
        {"file": str(out), "joints": draft.joints, "questions": draft.questions,
         "unused": draft.unused},
        as_json,
        "\n".join(lines),
    )


def _questions(count: int) -> str:
    return f"{count} question{'s' if count > 1 else ''}:" if count else "no questions"


@command.command("check")
@click.argument("file", type=FILE)
@click.option(
    "--recording", type=FILE, default=None, help="Also read this recording by the model's columns."
)
@json_option
def check(file: Path, recording: Path | None, as_json: bool) -> None:
    """Read a model file, refuse what nobody would read, and say what it describes. Exit status 2
    where it is wrong.

    Example:  zendsp model check bench.toml --recording run.csv
    """
    from zendsp.physics.files.model_file import load_model
    from zendsp.physics.files.questions import open_questions
    from zendsp.physics.model import TREES
    from zendsp.physics.robots.robot import robot_tree

    model = load_model(file)
    say_open(file)
    links = [link.name for link in robot_tree(model)[0]] if model.kind in TREES else []
    if model.kind == "fmu":
        from zendsp.diagnosis.external.fmu import Fmu

        Fmu(model, 1).close()
    body = _about(model) | {"questions": open_questions(file)}
    lines = [f"{file}: {body['text']}"]
    if links:
        body["links"] = links
        many = f"links that joints 1 to {len(links)} move"
        what = many if len(links) > 1 else "link that joint 1 moves"
        lines.append(f"  {what}: {', '.join(links)}")
    if recording is not None:
        from zendsp.diagnosis.data.checks import check_signals
        from zendsp.diagnosis.data.reading import read_signals

        signals = read_signals(recording, model)
        notes = check_signals([signals], model)  # what a diagnosis would refuse is refused here
        seconds = len(signals.time) * signals.sample_time
        steps = ", ".join(f"{r:.4g}" if r else "none seen" for r in signals.resolution)
        body["recording"] = {
            "rows": len(signals.time), "sample_time": signals.sample_time, "notes": notes,
        }
        lines.append(
            f"{recording}: {len(signals.time)} rows, {signals.sample_time * 1e3:g} ms,"
            f" {seconds:.4g} s; resolution {steps}"
        )
        lines += [f"  {note}" for note in notes]
    emit(body, as_json, "\n".join(lines))


def together(named: Sequence[tuple[str, int]]) -> list[str]:
    """Each name once, with its joints.

    Examples
    --------
    >>> together([("viscous", 1), ("coulomb", 1), ("viscous", 2), ("viscous", 3)])
    ['viscous at joints 1 to 3', 'coulomb at joint 1']
    """
    found: dict[str, list[int]] = {}
    for name, joint in named:
        found.setdefault(name, []).append(joint)
    return [f"{name} at {_joints(sorted(set(joints)))}" for name, joints in found.items()]


def _joints(numbers: list[int]) -> str:
    if len(numbers) == 1:
        return f"joint {numbers[0]}"
    if len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"joints {numbers[0]} to {numbers[-1]}"
    return f"joints {', '.join(map(str, numbers[:-1]))} and {numbers[-1]}"


def _about(model: Model) -> dict[str, Any]:
    own = [key for key, quantities in model.mechanism.items() if any(q.free for q in quantities)]
    numbers = [
        (f"{t.effect} {name}", t.joint)
        for t in model.terms for name, q in t.parameters.items() if q.free
    ]  # fmt: skip
    free = own + [number for number, _ in numbers]
    effects = [f"{t.effect} at joint {t.joint}" for t in model.terms]
    has = together([(t.effect, t.joint) for t in model.terms])
    fitted = own + (together(numbers) if model.joints > 1 else free[len(own) :])
    joints = f"{model.joints} joint{'s' if model.joints > 1 else ''}"
    text = (
        f"{model.name}, {model.kind}, {joints}; effects: {', '.join(has) or 'none'}; "
        f"to be calibrated: {', '.join(fitted) or 'nothing'}"
    )
    return {
        "name": model.name, "kind": model.kind, "joints": model.joints, "effects": effects,
        "free": free, "text": text,
    }
