"""The commands of README.md and the model files of the pages work as they stand."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest

from zendsp.cli import COMMANDS, cli
from zendsp.link.programs import STOPPED_S
from zendsp.physics import load_model
from zendsp.recording import Recording

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def test_the_ten_lines_run_and_record_every_sample(tmp_path: Path) -> None:
    match = re.search(r"```python\n(.*?)```", README, re.DOTALL)
    assert match is not None
    environment = {**os.environ, "ZENDSP_RUNTIME_DIR": str(tmp_path / "registry")}
    done = subprocess.run(
        [sys.executable, "-c", match[1]], cwd=tmp_path, env=environment, capture_output=True,
        text=True, check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "2000 rows, 0 lost"
    recording = Recording.load(tmp_path / "run.mat")
    assert len(recording) == 2000
    assert [channel.name for channel in recording.channels] == ["q", "tau"]


def test_the_page_says_after_how_long_stop_is_said_to_have_failed() -> None:
    """Two seconds stood there, and it is one: whoever waits for the banner waits for nothing."""
    page = (ROOT / "docs" / "tui.md").read_text()
    (seconds,) = re.findall(r"\*NOT STOPPED[^*]*\*: no word came within (\d+) s", page)
    assert float(seconds) == STOPPED_S


def mentioned_commands() -> dict[str, set[str]]:
    """Subcommands that the pages mention as ``zendsp NAME``, in code, with the long options beside
    them.
    """
    found: dict[str, set[str]] = {}
    for page in PAGES:
        text = page.read_text()
        lines = [
            *re.findall(r"`(?:[A-Z_]+=\S+ )*zendsp ([^`\n]+)`", text),
            *re.findall(r"^ {4}(?:[A-Z_]+=\S+ )*zendsp (.+)$", text, re.MULTILINE),
        ]
        for line in lines:
            words = shlex.split(line.partition("#")[0], comments=False)
            options = {word.partition("=")[0] for word in words[1:] if word.startswith("--")}
            found.setdefault(words[0], set()).update(options)
    return found


def test_every_command_and_option_of_the_pages_exists() -> None:
    mentioned = mentioned_commands()
    assert len(mentioned) > 15
    for name, options in mentioned.items():
        if name.startswith("--"):
            continue
        assert name in COMMANDS, name
        command = cli.get_command(click.Context(cli), name)
        assert command is not None
        if isinstance(command, click.Group) or command.context_settings.get(
            "ignore_unknown_options"
        ):
            continue
        known = {
            option
            for parameter in command.params
            for option in (*parameter.opts, *parameter.secondary_opts)
        }
        assert options - known - {"--help"} == set(), name


def test_every_link_between_the_pages_leads_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
            if "://" in target:
                continue
            path, _, anchor = target.partition("#")
            file = (page.parent / path).resolve() if path else page
            assert file.exists(), f"{page.relative_to(ROOT)}: {target}"
            if anchor and file.suffix == ".md":
                assert anchor in anchors(file), f"{page.relative_to(ROOT)}: {target}"


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as code hosts make them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def _printed(page: str, folder: Path) -> Path:
    match = re.search(r"```toml\n(.*?)```", (ROOT / "docs" / page).read_text(), re.DOTALL)
    assert match is not None
    file = folder / "printed.toml"
    file.write_text(match[1])
    return file


def test_the_model_file_of_the_page_loads(tmp_path: Path) -> None:
    model = load_model(_printed("models.md", tmp_path))
    assert (model.kind, model.joints, model.sample_time) == ("rotary", 1, 0.001)
    assert [term.effect for term in model.terms] == ["viscous"]


def test_the_model_file_of_the_mujoco_page_loads(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    arm = ROOT / "tests" / "machines" / "models" / "bench_arm.xml"
    shutil.copy(arm, tmp_path / "arm.xml")
    model = load_model(_printed("machines_mujoco.md", tmp_path))
    assert (model.kind, model.columns["command"]) == ("mjcf", "tau")
