"""The catalogue of what must never be lost fits the code, and its command tells what was noticed
from what was not.

Running the catalogue takes longer than a test may: `python -m tests.mutations`, before a release.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.mutations.__main__ import cage, main
from tests.mutations.catalogue import Stale, catalogue

ROOT = Path(__file__).parents[2]
CODE = "LIMIT = 3\ndef allowed(x):\n    return x < LIMIT\n"
TESTS = """
import sys
from pathlib import Path
sys.path.insert(0, str(Path(__file__).parents[1]))
from code_of_it import allowed

def test_small(): assert allowed(1)
def test_large(): assert not allowed(5)
"""
ENTRY = (
    '[[mutation]]\nname = "{}"\nlost = "x"\nfile = "code_of_it.py"\nold = "{}"\nnew = "{}"\n'
    "tests = [{}]\n"
)
LARGE, SMALL = '"tests/test_it.py::test_large"', '"tests/test_it.py::test_small"'


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A small project under git, and a folder for its catalogue beside it."""
    root = tmp_path / "project"
    (root / "tests").mkdir(parents=True)
    (root / "code_of_it.py").write_text(CODE)
    (root / "tests" / "test_it.py").write_text(TESTS)
    (tmp_path / "catalogue").mkdir()
    subprocess.run(["git", "init", "-q", str(root)], check=True)
    return root


def _run(
    tree: Path, *entries: str, words: tuple[str, ...] = (), alive: str = "import code_of_it"
) -> int:
    folder = tree.parent / "catalogue"
    (folder / "limits.toml").write_text("\n".join(entries))
    return main(words, tree, folder, alive, tuple)


def test_every_mutation_applies_and_names_tests_that_exist() -> None:
    known = catalogue()
    for mutation in known:
        assert mutation.mutated(ROOT) != (ROOT / mutation.file).read_text(), mutation.name
        mutation.check_tests(ROOT)
    assert {"limits", "stop", "updates", "access", "containment"} <= {m.topic for m in known}


@pytest.mark.long("whoever mutates looks at what it says; lost: that it tells them apart")
def test_noticed_mutations_are_told_from_surviving_ones(
    tree: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    entries = [
        ENTRY.format("seen", "x < LIMIT", "True", LARGE),
        ENTRY.format("unseen", "x < LIMIT", "True", SMALL),
        ENTRY.format("half", "x < LIMIT", "True", f"{LARGE}, {SMALL}"),
        ENTRY.format("dead", "def allowed", "deff allowed", LARGE),
    ]
    page = tmp_path / "page.md"
    assert _run(tree, *entries, words=("--report", str(page))) == 1
    said = capsys.readouterr().out
    for name, outcome in (
        ("seen", "noticed"),
        ("unseen", "SURVIVED"),
        ("half", "partly"),
        ("dead", "BROKEN"),
    ):
        assert any(line.split()[1:3] == [name, outcome] for line in said.splitlines()), (name, said)
    assert "1 of 4 noticed" in said and "- half: `tests/test_it.py::test_small`" in page.read_text()
    assert (tree / "code_of_it.py").read_text() == CODE, "the working tree is never changed"
    assert (
        _run(tree, *entries, words=("--only", "seen", "--report", str(page))) == 1
    ), "unseen has the word too"
    assert _run(tree, entries[0], words=("--only", "limits")) == 0


def test_a_test_that_fails_without_any_change_proves_nothing(
    tree: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tree / "tests" / "test_it.py").write_text(TESTS.replace("not allowed", "allowed"))
    assert _run(tree, ENTRY.format("seen", "x < LIMIT", "True", LARGE)) == 2
    assert "fail without any mutation: tests/test_it.py::test_large" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("entry", "why"),
    [
        (ENTRY.format("gone", "x <= LIMIT", "True", LARGE), "stands 0 times"),
        (ENTRY.format("twice", "LIMIT", "True", LARGE), "stands 2 times"),
        (
            ENTRY.format("file", "x", "y", LARGE).replace("code_of_it", "other"),
            "there is no other.py",
        ),
        (
            ENTRY.format("test", "x < LIMIT", "True", '"tests/test_it.py::test_none"'),
            "there is no test",
        ),
        (ENTRY.format("none", "x < LIMIT", "True", ""), "names no test"),
        (ENTRY.format("fields", "x < LIMIT", "True", LARGE) + "extra = 1\n", "needs the fields"),
    ],
)
def test_an_entry_that_no_longer_fits_the_code_fails_loudly(
    tree: Path, capsys: pytest.CaptureFixture[str], entry: str, why: str
) -> None:
    assert _run(tree, entry) == 2
    assert why in capsys.readouterr().err


def test_a_mutation_name_is_unique(tree: Path) -> None:
    folder = tree.parent / "catalogue"
    (folder / "a.toml").write_text(ENTRY.format("same", "x < LIMIT", "True", LARGE) * 2)
    with pytest.raises(Stale, match="stands twice"):
        catalogue(folder)


def test_nothing_that_is_let_loose_reaches_a_process_outside(tmp_path: Path) -> None:
    try:
        before = cage()
    except RuntimeError as error:
        pytest.skip(str(error))
    stays = "sleep 577.25 & echo $!; wait"
    code = (
        "import os, subprocess, sys\n"
        f"subprocess.Popen(['sh', '-c', {stays!r}], start_new_session=True)\n"
        f"os.kill({os.getpid()}, 0)\n"
    )
    done = subprocess.run(
        [*before, sys.executable, "-c", code], capture_output=True, text=True, timeout=20,
        check=False,
    )
    assert (
        done.returncode == 1 and "ProcessLookupError" in done.stderr
    ), "this process is not to be seen from there"
    left = [
        path.parent.name
        for path in Path("/proc").glob("[0-9]*/cmdline")
        if b"577.25" in _words(path)
    ]
    assert left == [], "what was started there is gone with it"


def _words(path: Path) -> list[bytes]:
    try:
        return path.read_bytes().split(b"\0")
    except OSError:
        return []


def test_without_a_cage_nothing_is_run(
    tree: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.mutations.__main__.NAMESPACES", (("--none-such",),))
    with pytest.raises(RuntimeError, match="could end every process"):
        cage()
    folder = tree.parent / "catalogue"
    (folder / "limits.toml").write_text(ENTRY.format("seen", "x < LIMIT", "True", LARGE))
    assert main((), tree, folder, "import code_of_it", cage) == 2
    assert "could end every process" in capsys.readouterr().err
