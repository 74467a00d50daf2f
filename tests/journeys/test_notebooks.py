"""The notebooks of examples/ run from the first cell to the last, in a kernel of the user's."""

from __future__ import annotations

from pathlib import Path

import pytest
from journey import Installed

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


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=[path.stem for path in NOTEBOOKS])
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
