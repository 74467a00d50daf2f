"""The entry point of the ``zendsp`` command, and its exit status."""

from __future__ import annotations

import os
import resource
import sys
import warnings

import click

from zendsp.cli.commands import UNREAD, cli
from zendsp.cli.complaints import say
from zendsp.cli.lines import write_anywhere
from zendsp.errors import ZendspError
from zendsp.here.ending import interruption

LEAST_MEMORY = 512 << 20  # bytes of addresses


class _NoNumPy:
    """Refuses to import NumPy where little memory is allowed: its linear algebra library would
    retry its allocation for ever.
    """

    @staticmethod
    def find_spec(name: str, *_: object) -> None:
        """Raise for NumPy; find nothing."""
        if name == "numpy":
            raise MemoryError(f"it needs {LEAST_MEMORY >> 20} MB of addresses")


def main() -> None:
    """Run a command. Expected errors end with one sentence and exit status 2, Ctrl-C with 130,
    SIGTERM with 143, output that nobody reads on with 141.
    """
    write_anywhere(sys.stdout)
    warnings.formatwarning = lambda message, *_, **__: f"zendsp: {message}\n"
    if 0 <= resource.getrlimit(resource.RLIMIT_AS)[0] < LEAST_MEMORY:
        sys.meta_path.insert(0, _NoNumPy)
    try:
        # click returns the status of a command that ended by Exit, and raises everything else
        status = cli(prog_name="zendsp", standalone_mode=False)
        if status == UNREAD:
            _let_go_of_output()
        sys.exit(status if isinstance(status, int) else 0)
    except click.exceptions.Exit as stop:
        sys.exit(stop.exit_code)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(2)
    except (click.ClickException, ZendspError) as error:
        say(error)
        sys.exit(2)
    except (click.Abort, KeyboardInterrupt):
        words, status = interruption()
        click.echo(words, err=True)
        sys.exit(status)
    except (MemoryError, ImportError) as error:
        lacking = _too_little_memory(error)
        if lacking is None:
            raise
        say(MemoryError(str(lacking)))
        sys.exit(2)
    except OSError as error:  # a full disk, a folder without the right to write, a full output
        say(error)
        _let_go_of_output()
        sys.exit(2)


def _too_little_memory(error: BaseException | None) -> BaseException | None:
    """A sentence on what did not fit into memory; None for any other error. Under a limit (``ulimit
    -v``) this can be a library that cannot be loaded, upon which NumPy raises an error of its own.
    """
    while isinstance(error, ImportError) and error.path is None:
        error = error.__cause__
    limited = resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY
    return error if limited or isinstance(error, MemoryError) else None


def _let_go_of_output() -> None:
    """Discard output that nobody reads, of which the interpreter would complain once more at its
    end.
    """
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
