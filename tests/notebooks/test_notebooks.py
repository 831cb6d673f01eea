"""Each notebook is a script and, for Jupyter, the same cells without outputs; nbmake runs them."""

from pathlib import Path

import jupytext
import pytest

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
SCRIPTS = sorted(NOTEBOOKS.glob("[1-9]*.py"))


def test_there_are_five():
    assert len(SCRIPTS) == 5
    assert [path.with_suffix(".ipynb") for path in SCRIPTS] == sorted(NOTEBOOKS.glob("*.ipynb"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_script_and_notebook_hold_the_same_cells_and_no_outputs(script):
    written, made = (jupytext.read(path) for path in (script, script.with_suffix(".ipynb")))
    cells = [[(cell.cell_type, cell.source) for cell in each.cells] for each in (written, made)]
    assert cells[0] == cells[1], "run `make notebooks`"
    assert len(written.cells) < 15
    code = [cell for cell in made.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in code)
