"""The ``zendsp`` command."""

from zendsp.cli.commands import COMMANDS as COMMANDS
from zendsp.cli.commands import LazyGroup as LazyGroup
from zendsp.cli.commands import cli as cli
from zendsp.cli.entry import main as main
