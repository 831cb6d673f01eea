"""Each notebook is a script and the same cells with their outputs; nbmake runs them."""

from pathlib import Path

import jupytext
import pytest

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
SCRIPTS = sorted(NOTEBOOKS.glob("[1-9]*.py"))


def test_there_are_eight():
    assert len(SCRIPTS) == 8
    assert [path.with_suffix(".ipynb") for path in SCRIPTS] == sorted(NOTEBOOKS.glob("*.ipynb"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_script_and_notebook_hold_the_same_cells(script):
    written, made = (jupytext.read(path) for path in (script, script.with_suffix(".ipynb")))
    cells = [[(cell.cell_type, cell.source) for cell in each.cells] for each in (written, made)]
    assert cells[0] == cells[1], "run `make notebooks`"
    assert len(written.cells) < 15


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_outputs_are_kept_without_warnings_and_without_pages_of_one_machine(script):
    """The documentation shows the notebooks as they are here."""
    made = jupytext.read(script.with_suffix(".ipynb"))
    outputs = [
        each for cell in made.cells if cell.cell_type == "code" for each in cell.get("outputs", [])
    ]
    assert outputs, "run `make notebooks`"
    for output in outputs:
        assert output.get("name") != "stderr", output.get("text")
        assert "warning" not in str(output.get("data", {}) | {"image/png": ""}).lower()
        assert "application/vnd.jupyter.widget-view+json" not in output.get("data", {})
        assert "localhost" not in str(output)
