"""What the shell completes, and the prompt of `zendsp shell`: targets, variables, programs."""

from __future__ import annotations

import shutil
import subprocess

import pytest
from journey import PATIENCE_S, Installed
from screen import Screen

# what bash does when Tab is pressed behind these words
PRESS = """
eval "$(zendsp completion bash)"
COMP_WORDS=({words})
COMP_CWORD={last}
_zendsp_completion zendsp
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


def _tab(installed: Installed, *words: str) -> list[str]:
    quoted = " ".join(f"'{word}'" for word in words)
    script = PRESS.format(words=quoted, last=len(words) - 1)
    done = subprocess.run(
        ["bash", "-c", script], cwd=installed.folder, env=installed.env, capture_output=True,
        text=True, timeout=PATIENCE_S, check=False,
    )
    # compopt knows no completion that is in progress here, and says so
    said = [line for line in done.stderr.splitlines() if "compopt" not in line]
    assert not said, done.stderr
    return done.stdout.split()


def test_tab_completes_commands_targets_variables_and_programs(installed: Installed) -> None:
    assert _tab(installed, "zendsp", "sal") == ["salvage"]
    assert _tab(installed, "zendsp", "get", "K") == [], "nobody answers: nothing, and no noise"
    installed.target("imi")
    assert installed.run("run", "pd.c", "-t", "imi").returncode == 0
    assert _tab(installed, "zendsp", "get", "-t", "i") == ["imi"]
    assert _tab(installed, "zendsp", "get", "Kp") == ["Kp1", "Kp2"]
    assert _tab(installed, "zendsp", "set", "-t", "imi", "cut") == ["cutoff="]
    assert _tab(installed, "zendsp", "watch", "tau") == ["tau1", "tau2", "tau"]
    assert "pd.c" in _tab(installed, "zendsp", "run", "pd")


@pytest.mark.long("the same completion asks a target above; lost: these names")
def test_tab_completes_machines_and_experiments(installed: Installed) -> None:
    assert _tab(installed, "zendsp", "target", "--machine", "i") == ["imi_planar"]
    assert _tab(installed, "zendsp", "demo", "--machine", "w") == ["wam7"]
    assert _tab(installed, "zendsp", "experiment", "friction-") == ["friction-curve"]
    assert _tab(installed, "zendsp", "diagnose", "--model", "wam") == ["wam7.toml"]


def test_other_shells_get_a_script(installed: Installed) -> None:
    for shell, word in (("zsh", "compdef"), ("fish", "complete --no-files")):
        assert word in installed.run("completion", shell).stdout


def test_the_shell_runs_commands_over_one_link_and_survives_mistakes(installed: Installed) -> None:
    installed.target("imi")
    assert installed.run("run", "pd.c", "-t", "imi").returncode == 0
    lines = "set Kp1=450\nget Kp1\nget nothing\nset Kp1\n'\nnonsense\nhelp\nhelp set\n"
    lines += "get Kp1 --json\nexit\n"
    done = installed.run("shell", "-t", "imi", input=lines)
    assert done.returncode == 0
    assert "Kp1 set at sample" in done.stdout and "Kp1 = 450 N m/rad" in done.stdout
    assert '"values": {"Kp1": 450.0}' in done.stdout
    assert "zendsp: no command 'nonsense'; 'zendsp --help' lists them\n" in done.stderr
    assert "zendsp: nothing: no such variable" in done.stderr
    assert "Commands:" in done.stdout
    assert "Usage: zendsp set" in done.stdout
    assert "No closing quotation" in done.stderr


@pytest.mark.skipif(shutil.which("zsh") is None, reason="needs zsh")
def test_zsh_completes_for_a_user_who_has_not_set_up_its_completion(installed: Installed) -> None:
    installed.target("imi")
    assert installed.run("run", "pd.c", "-t", "imi").returncode == 0
    installed.write(".zshrc", 'PS1="ready> "\n' + 'eval "$(zendsp completion zsh)"\n')
    terminal = Screen(installed, (100, 24), program=[str(shutil.which("zsh")), "-d", "-i"])
    try:
        terminal.until("ready>")
        assert "compdef" not in terminal.text(), terminal.text()
        terminal.keys(b"zendsp set -t imi cut\t")
        terminal.until("cutoff=")
        terminal.keys(b"50 Kp\t")
        terminal.until("Kp1=  -- [N m/rad]")
        assert "cutoff=50 Kp" in terminal.text(), "no space behind the equals sign"
    finally:
        terminal.end()
