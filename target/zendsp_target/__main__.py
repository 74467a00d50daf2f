"""``python -m zendsp_target``: start a target. Nothing of the host is needed.

A C compiler is, and the packages zenoh, numpy, msgpack, msgspec, cffi and pyelftools.
"""

from __future__ import annotations

import signal

if __name__ == "__main__":
    # Ctrl-C waits until all is imported; `zendsp target` begins this process with it held back
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})

import argparse
import contextlib
import json
import logging
import os
import resource
import sys
import threading
import traceback
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NoReturn

from zendsp_isr.compiler import end_compilers
from zendsp_isr.parts import machine_title
from zendsp_protocol.errors import ZendspError
from zendsp_protocol.files_left import need_files
from zendsp_protocol.states import Clock
from zendsp_protocol.texts import number_hint
from zendsp_target.access.admission import settle
from zendsp_target.access.endpoints import Security

if TYPE_CHECKING:
    from zendsp_target.monitor import Asked, Monitor
    from zendsp_target.runtime import Runtime

AS_ROOT = (
    "zendsp target: runs as root, so whoever may download a program to it runs code as root; "
    "an ordinary user is enough (docs/security.md)"
)
PATIENCE_S = 1.0  # of silence, after which it is said what takes so long
LEAST_MEMORY = 512 << 20  # bytes of addresses; a target has some 1400 MB of them
NO_ROOM = (
    "zendsp target: the system gives this process no more memory or threads ({error}): allow more,"
    " see 'ulimit -v' and 'ulimit -u'"
)
LEFT = (
    "zendsp target: {name} was killed while it held a recording of {columns} signals, which is kept"
    " in memory: 'zendsp salvage -t {name} -o run.mat' saves it, 'zendsp salvage -t {name} --drop'"
    " frees the memory"
)
DROPPED = (
    "zendsp target: an older recording of {name}, killed as well and never saved, was removed from"
    " memory"
)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Exit with the message in one line, as for every other error."""
        self.exit(2, f"zendsp target: {message}; '{self.prog} --help' lists the options\n")


def number(text: str) -> float:
    """Return the number that an option gives."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no number{number_hint(text)}") from None


def machine_option(text: str) -> str:
    """Return an option ``KEY=VALUE``. A decimal comma is refused: the machine would read the number
    only as far as the comma.
    """
    if point := number_hint(text.partition("=")[2]):
        raise argparse.ArgumentTypeError(f"{text!r} is no number{point}")
    return text


def parser() -> argparse.ArgumentParser:
    """Return the parser of the target's command line."""
    p = _Parser(
        prog="python -m zendsp_target",
        allow_abbrev=False,
        description=(
            "Run C control code at a fixed rate against a machine, and serve it over Zenoh."
        ),
        epilog=(
            "Example: python -m zendsp_target --machine imi_planar --name imi --rate 1000 --clock"
            " real"
        ),
    )
    p.add_argument(
        "--machine",
        default="imi_planar",
        help=(
            "machine to drive: a shipped one, a .c file, or a MuJoCo model (.xml, .urdf); default:"
            " imi_planar"
        ),
    )
    p.add_argument("--name", default="", help="name of the target (default: that of the machine)")
    p.add_argument(
        "--rate", type=number, default=1000.0, metavar="HZ",
        help="sample rate in Hz (default: 1000)",
    )
    p.add_argument(
        "--clock", choices=[*Clock], default="real", help="fast: as fast as the CPU allows"
    )
    p.add_argument(
        "--listen", action="append", metavar="ENDPOINT",
        help="Zenoh endpoint (default: here, a socket that only you can open); may be repeated",
    )
    p.add_argument(
        "--connect", action="append", default=[], metavar="ENDPOINT", help="router to announce to"
    )
    p.add_argument("--tls-cert", default="", metavar="PEM", help="this target's certificate")
    p.add_argument("--tls-key", default="", metavar="PEM", help="this target's private key")
    p.add_argument(
        "--tls-ca", default="", metavar="PEM", help="authority that signs the hosts' certificates"
    )
    p.add_argument(
        "--users", default="", metavar="FILE", help="lines user:password that hosts must know"
    )
    p.add_argument(
        "--roles", default="", metavar="FILE",
        help="who may observe, tune, command, download (docs/security.md)",
    )
    p.add_argument(
        "--parent", type=int, default=0, metavar="PID", help="end when this parent process ends"
    )
    p.add_argument("--machine-option", action="append", type=machine_option, default=[],
                   metavar="KEY=VALUE",
                   help="setting of the machine, e.g. its start position; may be repeated")
    p.add_argument("--ideal", action="store_true",
                   help="a simulated machine without noise and other imperfections")
    p.add_argument("--concealed", metavar="FILE|seed:N", help="effects that only the machine knows")
    p.add_argument(
        "--no-realtime", action="store_true",
        help="do not ask for SCHED_RR, locked memory and a CPU",
    )
    p.add_argument("--priority", type=int, default=80, help="of SCHED_RR (default: 80)")
    p.add_argument(
        "--cpu", type=int, default=-1, help="CPU of the loop (default: the last without another)"
    )
    p.add_argument(
        "--spin", type=number, default=-1.0, metavar="US",
        help="waited awake before each sample, in µs (default: 60; 0 on a CPU that is shared)",
    )
    p.add_argument(
        "--memory", type=number, default=1000.0, metavar="MB",
        help="that user code may take (default: 1000)",
    )
    p.add_argument(
        "--speed", type=number, default=0.0,
        help="fast clock: at most so many machine seconds a second",
    )
    p.add_argument("--managed", action="store_true",
                   help="enforce the safe sequence: power, home and enable before anything moves")
    p.add_argument(
        "--json", action="store_true",
        help="say where it listens as one line of JSON on standard output",
    )
    p.add_argument(
        "--verbose", "-v", action="store_true", help="log what happens on standard error"
    )
    return p


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a target until it is told to end; return the exit status."""
    args = parser().parse_args(arguments)
    logging.basicConfig(
        level=logging.DEBUG if args.verbose else logging.WARNING, format="%(levelname)s %(message)s"
    )
    security = Security(args.tls_cert, args.tls_key, args.tls_ca, args.users, args.roles)
    listen = args.listen or []
    try:
        # before the machine is touched
        doors = settle(args.name or machine_title(args.machine), listen, args.connect, security)
        for sentence in filter(None, (doors.sentence, doors.ending)):
            print(f"zendsp target: {sentence}", file=sys.stderr, flush=True)
        return _serve(args, listen, security)
    except (ZendspError, ValueError, OSError) as error:
        print(f"zendsp target: {error}", file=sys.stderr)
    except MemoryError as error:
        print(NO_ROOM.format(error=error or "no memory"), file=sys.stderr)
    return 2


def _take_files() -> None:
    """Raise the limit of open files to what the system allows. Every connection takes one, even one
    that is refused.
    """
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def _need_memory() -> None:
    """Refuse an address space so small that NumPy's linear algebra library would retry its
    allocation for ever.
    """
    most = resource.getrlimit(resource.RLIMIT_AS)[0]
    if 0 <= most < LEAST_MEMORY:
        raise MemoryError(f"{most >> 20} MB of addresses, it needs {LEAST_MEMORY >> 20} MB")


@contextlib.contextmanager
def _patience(text: str) -> Iterator[None]:
    """Print the text if the block takes longer than `PATIENCE_S`."""
    told = threading.Timer(PATIENCE_S, print, (text,), {"file": sys.stderr, "flush": True})
    told.daemon = True
    told.start()
    try:
        yield
    finally:
        told.cancel()


def _runtime(args: argparse.Namespace) -> Runtime:
    from zendsp_target.runtime import Runtime

    ideal = ["ideal=1"] if args.ideal else []
    return Runtime(
        machine=args.machine,
        rate_hz=args.rate,
        clock=args.clock,
        machine_config={
            key: value
            for key, _, value in (text.partition("=") for text in [*ideal, *args.machine_option])
        },
        concealed=args.concealed,
        realtime=not args.no_realtime,
        priority=args.priority,
        cpu=args.cpu,
        spin_us=args.spin,
        speed=args.speed,
        memory_mb=args.memory,
    )


def _monitor(
    args: argparse.Namespace, name: str, listen: Sequence[str], security: Security
) -> tuple[Runtime, Monitor, Asked]:
    """Start runtime and server, and return the monitor. It takes one and a half seconds on an idle
    computer, more where the machine has to be compiled.
    """
    _need_memory()
    from zendsp_target.monitor import Monitor, Options, asked_to_end
    from zendsp_target.runtime import outlive_lost_pages
    from zendsp_target.serving.malloc import keep_large_buffers

    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    keep_large_buffers()
    outlive_lost_pages()
    _take_files()
    need_files()
    runtime = _runtime(args)
    title = machine_title(args.machine)
    try:
        asked = asked_to_end()
        options = Options(name, title, listen, args.connect, security, args.managed)
        return runtime, Monitor(runtime, options), asked
    except BaseException:
        runtime.close()
        raise


def _say_what_is_left(name: str, runtime: Runtime) -> None:
    """What is said of a target that runs: where it does not start, why comes first."""
    if os.getuid() == 0:
        print(AS_ROOT, file=sys.stderr, flush=True)
    kept, dropped = runtime.left_behind
    for note in kept:
        if note.about.target == name:
            print(LEFT.format(columns=len(note.columns), name=name), file=sys.stderr)
    for note in dropped:
        print(DROPPED.format(name=note.about.target), file=sys.stderr)


def _serve(args: argparse.Namespace, listen: Sequence[str], security: Security) -> int:
    name = args.name or machine_title(args.machine)
    with _patience(f"zendsp target: starting {args.machine}; one that is new is compiled first …"):
        runtime, monitor, asked = _monitor(args, name, listen, security)

    def announce() -> None:
        _say_what_is_left(name, runtime)
        where = ", ".join(monitor.endpoints)
        text = f"target {name} listens on {where}; Ctrl-C ends it"
        if runtime.title and not args.json:
            print(runtime.title, flush=True)
        print(
            json.dumps({"name": name, "endpoints": monitor.endpoints}) if args.json else text,
            flush=True,
        )

    monitor.run(asked, args.parent, announce)
    if runtime.unsafe or not args.json:
        said = sys.stderr if runtime.unsafe else sys.stdout
        with contextlib.suppress(OSError):  # nobody may be there to read it
            print(f"target {name} has ended{runtime.farewell}", file=said, flush=True)
    return 1 if runtime.unsafe else 0


def leave(status: int) -> NoReturn:
    """End the process without shutting the interpreter down; everything is closed by now.

    A thread that returns from Zenoh's compiled code during that shutdown would abort the process
    ("exception not rethrown"), and a clean end would look like a crash.
    """
    end_compilers()  # of a thread that waits for one
    with contextlib.suppress(OSError):  # nobody may be there to read it
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(status)


if __name__ == "__main__":
    status = 1
    try:
        status = main()
    except SystemExit as end:  # argparse
        status = end.code if isinstance(end.code, int) else 2
    except KeyboardInterrupt:
        status = 130
        print("zendsp target: interrupted before it was ready", file=sys.stderr)
    except Exception:
        traceback.print_exc()
    finally:  # also where what was to be said could not be, since nobody reads it any more:
        leave(status)  # threads of a server that did not come to be would keep the process
