"""A function fits on a screen and has few parameters; exceptions are listed here with a reason."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCES = ("host", "target", "protocol", "c_isr")
SCREEN = 60  # lines of a body, its docstring aside
MOST = 7  # parameters
COLUMNS = 100

# file:function: why it is longer
LONG = {
    "target/zendsp_target/__main__.py:parser": "the table of options",
    "host/zendsp/proof/scoreboard.py:headline": "the sentences of a page, in their order",
    "host/zendsp/proof/rivals.py:rivals": "a table of rivals and what each is given",
    "host/zendsp/reference/kinds/swing.py:_collocate": "one optimal control problem, stated whole",
    "c_isr/zendsp_isr/runtime/contain.c:filter_calls": "the table of what is refused",
    "host/zendsp/physics/kernel/filter.c:zf_smooth": "a pass forward and one back, on one memory",
    "host/zendsp/physics/simulation/solve.h:solve": "one search for who slides, who sticks",
    "host/zendsp/physics/simulation/step.h:stage": "one stage of the integrator, term by term",
    "host/zendsp/physics/simulation/tree.h:tree_mass": "one recursion, its matrices unrolled",
}
PUBLIC = "a user's function: keywords with defaults, each explained"
PLANNED = "the fields of its form, one keyword each"
# file:function, or a folder: why it takes more
TOLD = {
    "host/zendsp/physics/calibration/predict.py:run": "what is asked of it, one keyword each",
    "host/zendsp/reference/kinds/": PLANNED,
    "host/zendsp/physics/simulation/run.py:simulate": PUBLIC,
    "host/zendsp/physics/simulation/control.py:simulate_loop": PUBLIC,
    "host/zendsp/physics/calibration/loop.py:simulate_joint_loop": PUBLIC,
    "host/zendsp/physics/calibration/fit.py:fit": PUBLIC,
    "host/zendsp/diagnosis/measure/likelihood.py:fit_scored": "it passes on what a fit takes",
    "host/zendsp/link/acquire.py:acquire": PUBLIC,
    "host/zendsp/diagnosis/fleet.py:diagnose_each": PUBLIC,
    "host/zendsp/experiment/frequency.py:frequency_response": PUBLIC,
    "host/zendsp/experiment/sweep.py:sweep": PUBLIC,
    "host/zendsp/experiment/excite.py:play": "what a multisine is played with",
    "host/zendsp/experiment/lab.py:record": "what a recording may be asked for, keywords",
    "host/zendsp/tui/app.py:__init__": "the options of `zendsp tui`",
    "host/zendsp/cli/tui.py:_serve": "the options of `zendsp tui --web`, handed on",
    "host/zendsp/tui/play_job.py:__init__": "a job's own fields",
    "host/zendsp/proof/mujoco/kit.py:truth": "the fields of a truth, keywords",
    "host/zendsp/physics/calibration/observed.py:response": "how an observer sees, keywords",
    "host/zendsp/diagnosis/decide/laws.py:named": "what a joint is decided by",
    "host/zendsp/diagnosis/decide/rivals.py:law_of": "what a joint is decided by",
}


def functions() -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Every function with the file that it stands in."""
    for source in SOURCES:
        for path in sorted((ROOT / source).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                    yield str(path.relative_to(ROOT)), node


def lines(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of the body without its docstring."""
    told = ast.get_docstring(node) is not None and len(node.body) > 1
    return (node.end_lineno or 0) - node.body[int(told)].lineno + 1


def c_functions() -> Iterator[tuple[str, int]]:
    """Every C function, ``file:name``, with the lines of its body."""
    head = r"^(?!typedef|enum|struct)[A-Za-z][^;={]*?(?:OF\((\w+)\)|\b(\w+))\([^;{]*\)"
    for source in SOURCES:
        for path in sorted((ROOT / source).rglob("*.[ch]")):
            for found in re.finditer(
                head + r"\s*\{\n(.*?)^\}", path.read_text(), re.MULTILINE | re.DOTALL
            ):
                name = found[1] or found[2]
                yield f"{path.relative_to(ROOT)}:{name}", found[3].count("\n")


def parameters(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Parameters, without ``self``; the options of a command are not counted."""
    if any("click." in ast.unparse(decorator) for decorator in node.decorator_list):
        return 0
    names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
    return len([name for name in names if name not in ("self", "cls")])


def unexcused(found: set[str], excuses: dict[str, str]) -> tuple[set[str], set[str]]:
    """What has no reason, and reasons that nothing needs."""
    folders = [e for e in excuses if e.endswith("/")]
    reasons = {
        f: f if f in excuses else next((e for e in folders if f.startswith(e)), None) for f in found
    }
    return {f for f, e in reasons.items() if e is None}, set(excuses) - set(reasons.values())


def test_a_function_fits_on_a_screen_or_says_why_not() -> None:
    found = {f"{file}:{node.name}" for file, node in functions() if lines(node) > SCREEN}
    found |= {name for name, size in c_functions() if size > SCREEN}
    assert unexcused(found, LONG) == (set(), set())


def test_a_function_is_told_few_things_or_says_why_more() -> None:
    found = {f"{file}:{node.name}" for file, node in functions() if parameters(node) > MOST}
    assert unexcused(found, TOLD) == (set(), set())


def test_a_line_of_c_has_at_most_100_columns() -> None:
    # ruff holds those of Python (E501)
    sources = [path for source in SOURCES for path in (ROOT / source).rglob("*.[ch]")]
    long = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in sources
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if len(line) > COLUMNS
    ]
    assert len(sources) > 50 and long == []


def test_a_line_of_a_page_has_at_most_100_columns() -> None:
    # tables aside, and what is typed or printed: fenced, or set in by four columns
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    long = []
    for page in pages:
        fenced = False
        for number, line in enumerate(page.read_text().splitlines(), 1):
            fenced ^= line.lstrip().startswith("```")
            if len(line) > COLUMNS and not fenced and not line.startswith(("|", "    ")):
                long.append(f"{page.relative_to(ROOT)}:{number}")
    assert len(pages) > 30 and long == []


def test_a_name_of_the_diagnosis_is_one_number() -> None:
    # who reads `SURE` in one file must not think of the `SURE` of another
    found: dict[str, dict[str, str]] = {}
    for path in (ROOT / "host/zendsp/diagnosis").rglob("*.py"):
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                name = node.targets[0].id.lstrip("_")
                if name.isupper():
                    found.setdefault(name, {})[ast.unparse(node.value)] = path.name
    assert {name: of for name, of in found.items() if len(of) > 1} == {}
