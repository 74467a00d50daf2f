"""``zendsp completion``: the script with which a shell completes commands, targets and variables.
"""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

# bash ends what it completed with a space; behind NAME= a value follows
NO_SPACE = "    [[ ${COMPREPLY[0]} == *= ]] && compopt -o nospace\n\n    return 0\n"
DESCRIBED = "        _describe -V unsorted completions_with_descriptions -U"
JOINED = (
    "        local -a joined\n"
    "        [[ $completions_with_descriptions[1] == *=:* ]] && joined=(-S '')\n"
    f'{DESCRIBED} "${{joined[@]}}"'
)
# a new user's .zshrc has not begun zsh's completion
BEGUN = "(( $+functions[compdef] )) || { autoload -Uz compinit && compinit -i }\n"


@click.command("completion")
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def command(shell: str) -> None:
    """Print what makes SHELL complete commands, targets, variables and programs.

    \b
    bash: echo 'eval "$(zendsp completion bash)"' >> ~/.bashrc
    zsh:  echo 'eval "$(zendsp completion zsh)"' >> ~/.zshrc
    fish: zendsp completion fish > ~/.config/fish/completions/zendsp.fish

    Example:  zendsp completion bash
    """
    from zendsp.cli.commands import cli

    maker = get_completion_class(shell)
    assert maker is not None, shell
    made = maker(cli, {}, "zendsp", "_ZENDSP_COMPLETE")
    text = made.source_template % made.source_vars()
    if shell == "bash":
        text = text.replace("    return 0\n", NO_SPACE, 1)
    elif shell == "zsh":
        text = text.replace("    compdef ", f"    {BEGUN}    compdef ", 1)
        text = text.replace(DESCRIBED, JOINED, 1)
    else:  # a description may have commas
        text = text.replace('string split ","', 'string split -m 1 ","')
    click.echo(text)
