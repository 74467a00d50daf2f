"""Apply each mutation to a copy of the tree, run the tests that should notice, and report those
that did not.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from tests.mutations.catalogue import ROOT, Mutation, Stale, catalogue, chosen, copy_tree

SOURCES = ("host", "target", "protocol", "c_isr")
LIMIT_S = 900.0  # for the tests of one mutation; each test has pytest's own limit
PATIENCE_S = 20.0  # for pytest to clear up after Ctrl-C
# of memory of one process: a compilation without its limit shall not take the computer's
MOST_KB = 6 << 20
# Without its protection, what a test tries comes about: processes that stay, or end others. It
# happens in a namespace of its own, where there are no others, and which takes with it all that it
# holds. sh is there to wait for orphans.
NAMESPACES = (("--pid",), ("--user", "--map-current-user", "--pid"))
CAGE = (
    "--fork", "--mount-proc", "--kill-child", "sh", "-c", f'ulimit -v {MOST_KB}; "$@"; exit $?',
    "sh",
)
# A change after which nothing runs any more would be noticed by every test, and says nothing about
# any of them.
ALIVE = """
import zendsp, zendsp_target, sys
assert zendsp.__file__.startswith(sys.argv[1]) and zendsp_target.__file__.startswith(sys.argv[1]), zendsp.__file__
with zendsp.local("imi_planar", clock="fast") as target:
    target.download("pd.c")
    target.run_for(0.1)
    assert target.status().tick == 100 and target["Kp1"] > 0
"""  # noqa: E501


@dataclass(frozen=True)
class Result:
    """What became of one mutation.

    Attributes
    ----------
    outcome : str
        ``"noticed"``: every test failed. ``"SURVIVED"``: none did. ``"partly"``: some did not.
        ``"BROKEN"``: nothing ran any more.
    silent : tuple of str
        Tests that did not notice.
    seconds : float
    said : str
        The end of what a broken one wrote.
    """

    mutation: Mutation
    outcome: str
    silent: tuple[str, ...]
    seconds: float
    said: str = ""


def cage() -> tuple[str, ...]:
    """Return what to put before a command, so that nothing it lets loose reaches a process outside.

    Raises
    ------
    RuntimeError
        This computer allows no such thing.
    """
    said = ""
    for namespace in NAMESPACES:
        command = ("unshare", *namespace, *CAGE)
        try:
            done = subprocess.run([*command, "true"], capture_output=True, text=True, check=False)
        except OSError as error:
            raise RuntimeError(f"mutations need the command unshare: {error}") from error
        if done.returncode == 0:
            return command
        said = done.stderr.strip()
    raise RuntimeError(
        f"mutations need a PID namespace ({said}): without protection, what a test tries could end"
        " every process of this user"
    )


class Lab:
    """A copy of the tree in which commands run; ``before`` stands before each."""

    def __init__(self, root: Path, folder: Path, alive: str, before: Sequence[str]) -> None:
        self._before = tuple(before)
        self.tree = copy_tree(root, folder / "tree")
        self._alive = alive
        self._folder = folder
        runtime = folder / "run"
        runtime.mkdir(mode=0o700)
        self._env = {
            **{k: v for k, v in os.environ.items() if not k.startswith(("ZENDSP_", "PYTEST_"))},
            "PYTHONPATH": os.pathsep.join(str(self.tree / name) for name in SOURCES),
            # two versions of a file within one second would look the same to Python
            "PYTHONDONTWRITEBYTECODE": "1",
            "ZENDSP_RUNTIME_DIR": str(runtime),
            # what was taken away never comes: each such test costs this, where nothing computes
            "ZENDSP_TEST_PATIENCE_S": "40",
            "ZENDSP_CACHE": str(folder / "cache"),
        }

    def _run(self, command: Sequence[str]) -> tuple[int, str]:
        process = subprocess.Popen(
            [*self._before, *command], cwd=self.tree, env=self._env, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
        )
        try:
            said, _ = process.communicate(timeout=LIMIT_S)
        except BaseException as error:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.communicate(timeout=PATIENCE_S)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
            process.communicate()
            return -1, f"not over after {LIMIT_S:g} s"
        return process.returncode, said

    def lives(self) -> str:
        """Return an empty string where a program still runs, else what went wrong."""
        status, said = self._run([sys.executable, "-c", self._alive, str(self.tree)])
        return "" if status == 0 else said[-2000:] or f"exit status {status}"

    def failing(self, tests: Sequence[str]) -> tuple[set[str], str]:
        """Run tests; return which of them failed, and what was said.

        Raises
        ------
        RuntimeError
            The tests could not be run, or some of them ran in no case at all.
        """
        report = self._folder / "report.xml"
        report.unlink(missing_ok=True)
        command = [
            sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--junitxml={report}",
            *tests,
        ]
        status, said = self._run(command)
        if status not in (0, 1) or not report.is_file():
            raise RuntimeError(f"pytest ended with {status}: {said[-2000:]}")
        ran, failed = set(), set()
        for case in ElementTree.parse(report).iter("testcase"):
            node = f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name')}"
            for test in tests:
                if node == test or node.startswith(f"{test}["):
                    if case.find("skipped") is None:
                        ran.add(test)
                    if case.find("failure") is not None:
                        failed.add(test)
        if missing := set(tests) - ran:
            raise RuntimeError(
                f"skipped, or broken before it began: {', '.join(sorted(missing))}: {said[-2000:]}"
            )
        return failed, said

    def judge(self, mutation: Mutation) -> Result:
        """Apply a mutation, and see which of its tests notice."""
        begin = time.monotonic()
        # What a compilation said is kept beside the program: it would be told again without the
        # code that is gone.
        shutil.rmtree(self._folder / "cache" / "program", ignore_errors=True)
        with mutation.applied(self.tree):
            dead = self.lives()
            if dead:
                return Result(mutation, "BROKEN", mutation.tests, time.monotonic() - begin, dead)
            try:
                failed, _ = self.failing(mutation.tests)
            except RuntimeError as error:
                return Result(
                    mutation, "BROKEN", mutation.tests, time.monotonic() - begin, str(error)
                )
        silent = tuple(test for test in mutation.tests if test not in failed)
        outcome = "noticed" if not silent else "partly" if failed else "SURVIVED"
        return Result(mutation, outcome, silent, time.monotonic() - begin)


def page(results: Sequence[Result], command: str, version: str) -> str:
    """Return the results as a page of the documentation."""
    kept = sum(r.outcome == "noticed" for r in results)
    day = f"{datetime.now(UTC):%d %B %Y}".lstrip("0")
    lines = [
        "# Mutations: checks that cannot be removed unnoticed",
        "",
        (
            f"`{command}`, {day}, commit {version}: {kept} of {len(results)} were noticed, in"
            f" {sum(r.seconds for r in results):.0f} s."
        ),
        "",
        "Each is a promise that was taken out of a copy of the tree, alone; `--list` names them.",
        "Its tests in `tests/mutations/` ran on the copy; *noticed* means that every one failed.",
        "`--report FILE` writes such a page.",
        "",
        "| about | promises | noticed |",
        "|---|---|---|",
    ]
    for topic in dict.fromkeys(r.mutation.topic for r in results):
        outcomes = [r.outcome for r in results if r.mutation.topic == topic]
        lines.append(f"| {topic} | {len(outcomes)} | {outcomes.count('noticed')} |")
    silent = [f"- {r.mutation.name}: `{test}`" for r in results for test in r.silent]
    return "\n".join([*lines, *(["", "## Did not notice", "", *silent] if silent else []), ""])


def main(
    words: Sequence[str] | None = None,
    root: Path = ROOT,
    folder: Path | None = None,
    alive: str = ALIVE,
    caged: Callable[[], Sequence[str]] = cage,
) -> int:
    """Run the command; returns its exit status: 0 only if every test noticed."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutations", description=__doc__)
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="WORD",
        help="those with the word in their name, or of this topic",
    )
    parser.add_argument("--list", action="store_true", help="names and promises; runs nothing")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the results as a page")
    asked = parser.parse_args(words)
    try:
        mutations = chosen(catalogue(folder) if folder else catalogue(), asked.only)
        for mutation in mutations:
            mutation.mutated(root)
            mutation.check_tests(root)
    except Stale as error:
        print(f"stale: {error}", file=sys.stderr)
        return 2
    if not mutations:
        print(f"no mutation has one of {', '.join(asked.only)} in its name", file=sys.stderr)
        return 2
    if asked.list:
        print("\n".join(f"{m.topic:12} {m.name:36} {m.lost}" for m in mutations))
        return 0
    try:
        before = caged()
    except RuntimeError as error:
        print(error, file=sys.stderr)
        return 2
    tests = sorted({test for m in mutations for test in m.tests})
    results: list[Result] = []
    with tempfile.TemporaryDirectory(prefix="zm-", ignore_cleanup_errors=True) as place:
        lab = Lab(root, Path(place), alive, before)
        print(
            f"{len(mutations)} mutations; first their {len(tests)} tests without any …", flush=True
        )
        if dead := lab.lives():
            print(f"the copy does not run: {dead}", file=sys.stderr)
            return 2
        try:
            failed, said = lab.failing(tests)
        except RuntimeError as error:
            print(error, file=sys.stderr)
            return 2
        if failed:
            print(
                f"{said[-4000:]}\nfail without any mutation: {', '.join(sorted(failed))}",
                file=sys.stderr,
            )
            return 2
        try:
            for number, mutation in enumerate(mutations, 1):
                print(f"{number:3}/{len(mutations)} {mutation.name:36} ", end="", flush=True)
                result = lab.judge(mutation)
                results.append(result)
                print(f"{result.outcome} ({result.seconds:.0f} s)", flush=True)
                for line in (*result.silent, *result.said.splitlines()[-12:]):
                    print(f"        {line}")
        except KeyboardInterrupt:
            print(f"\nended by Ctrl-C after {len(results)} of {len(mutations)}", file=sys.stderr)
            return 130
    bad = [r for r in results if r.outcome != "noticed"]
    print(
        f"{len(results) - len(bad)} of {len(results)} noticed"
        + "".join(f"\n  {r.outcome}: {r.mutation.name}" for r in bad)
    )
    if asked.report:
        command = "python -m tests.mutations" + (
            f" --only {shlex.join(asked.only)}" if asked.only else ""
        )
        asked.report.write_text(page(results, command, _version(root)))
    return 1 if bad else 0


def _version(root: Path) -> str:
    said = subprocess.run(
        ["git", "-C", str(root), "rev-parse", "--short", "HEAD"],
        capture_output=True,
        text=True,
        check=False,
    )
    return said.stdout.strip() or "unknown"


if __name__ == "__main__":
    sys.exit(main())
