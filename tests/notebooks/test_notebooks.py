"""Each notebook is a script and the same cells with their outputs; all run here in a short form."""

import gc
import sys
from pathlib import Path

import jupytext
import matplotlib.pyplot
import pytest
from IPython.core.interactiveshell import InteractiveShell
from traitlets.config import Config

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
SCRIPTS = sorted(NOTEBOOKS.glob("[1-9]*.py"))


QUICK = " ".join(
    [
        "duration=4.8",
        "hand.start=0.2",
        "hand.pushes.0.speed=0.02",
        "station.probe.height=0.004",
        "station.plant.contact_model=point",
        "scan_conversion.spacing=[1e-3,1e-3,1e-3]",
        "imaging.sector=0.55",
    ]
)


QUICKEST = ("1_the_loop", "5_needle_shape", "8_in_colab")
"""One of a run, of a shape and of a page; the others are slow."""


@pytest.mark.parametrize(
    "script",
    [
        pytest.param(path, id=path.stem, marks=[pytest.mark.slow] * (path.stem not in QUICKEST))
        for path in SCRIPTS
    ],
)
def test_every_cell_runs_and_shows_what_it_ends_with(script, monkeypatch, capsys):
    """In this process: a kernel for each would load everything anew."""
    monkeypatch.setenv("SONOSERVO_QUICK", QUICK)
    monkeypatch.chdir(NOTEBOOKS)
    matplotlib.pyplot.switch_backend("Agg")
    # The shell puts a module of its own in place of the main one.
    monkeypatch.setitem(sys.modules, "__main__", sys.modules["__main__"])
    shell = InteractiveShell(config=Config(HistoryManager={"enabled": False}))
    cells = [cell.source for cell in jupytext.read(script).cells if cell.cell_type == "code"]
    for source in cells:
        shell.run_cell(source.replace("%matplotlib inline", "")).raise_error()
    matplotlib.pyplot.close("all")
    shell.reset()
    gc.collect()  # Drake aborts where a Meshcat ends on another thread than its own


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_script_and_notebook_hold_the_same_cells(script):
    written, made = (jupytext.read(path) for path in (script, script.with_suffix(".ipynb")))
    cells = [[(cell.cell_type, cell.source) for cell in each.cells] for each in (written, made)]
    assert cells[0] == cells[1], "run `make notebooks`"


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
