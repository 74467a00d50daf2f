"""The notebooks of examples/ run from the first cell to the last, in a kernel of the user's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from journey import BENCH, Installed, record_bench

NOTEBOOKS = sorted((Path(__file__).parents[2] / "examples" / "notebooks").glob("*.ipynb"))
RUN = """
import sys, nbformat
from nbclient import NotebookClient
notebook = nbformat.read(sys.argv[1], 4)
NotebookClient(notebook, timeout=250, kernel_name="python3").execute()
for cell in notebook.cells:
    for output in cell.get("outputs", []):
        print(output.get("data", {}).get("text/html", ""), output.get("text", ""))
"""


MORE = pytest.mark.long("another runs, tests/experiment has the calls; lost: these cells")
IN_CI = "diagnose_a_file"


@pytest.mark.parametrize(
    "notebook",
    [pytest.param(p, id=p.stem, marks=[] if p.stem == IN_CI else [MORE]) for p in NOTEBOOKS],
)
def test_a_notebook_of_the_examples_runs_and_shows_tables_and_curves(
    kernels: Installed, notebook: Path
) -> None:
    done = kernels.script(RUN, str(notebook), timeout=300.0)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    assert "<polyline" in done.stdout and "<table>" in done.stdout


def test_notebooks_are_kept_without_what_they_put_out() -> None:
    assert len(NOTEBOOKS) >= 2
    for path in NOTEBOOKS:
        text = path.read_text()
        assert '"outputs": []' in text and '"execution_count": null' in text
        assert '"output_type"' not in text, f"{path.name}: clear its outputs before it is kept"


DRAWN = """
import nbformat
from nbclient import NotebookClient
cells = [
    "import zendsp, numpy as np",
    "t = zendsp.local('imi_planar'); t.download('pd.c'); t.start()",
    "t.acquire(['q', 'tau'], seconds=2.5).save('run.mat')",
    "quick = t.acquire(['q'], seconds=0.2)",
    "told = t.acquire(['q'], seconds=1.5, progress=lambda done: None)",
    "t.close(); zendsp.diagnose('bench.csv', 'bench.toml')",
]
shown = [""] * len(cells)
class Client(NotebookClient):
    def process_message(self, message, cell, index):
        data = message["content"].get("data", {})
        shown[index] += data.get("text/plain", "") + "\\n"
        return super().process_message(message, cell, index)
book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
Client(book, timeout=250, kernel_name="python3").execute()
for cell, text in zip(book.cells, shown):
    left = [output.data["text/plain"] for output in cell.outputs if "data" in output]
    print("CELL", text, "LEFT", left)
"""


@pytest.mark.long("tests/diagnosis/test_progress.py has the line; lost: as a notebook shows it")
def test_slow_calls_show_progress_in_a_notebook(kernels: Installed) -> None:
    record_bench(kernels.folder / "bench.csv")
    kernels.write("bench.toml", BENCH)
    done = kernels.script(DRAWN, timeout=300.0)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    recorded, quick, told, diagnosed = done.stdout.split("CELL")[3:]
    assert re.search(r"█+░* +[3-9]\d %", recorded)
    assert "joint 1: screening the library" in diagnosed
    assert "LEFT ['', '<Diagnosis " in diagnosed, "the line is taken away at the end"
    assert "%" not in quick + told, "nothing of what is short, or has a progress of its own"
