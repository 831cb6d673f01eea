"""Write the notebooks from their scripts and run them, so that they hold their outputs.

`make notebooks` runs all; names of scripts run these alone.
"""

import os
import sys
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient

HERE = Path(__file__).parent
KERNEL = {"name": "python3", "display_name": "Python 3", "language": "python"}


def execute(script: Path) -> None:
    """Run a script as a notebook beside it; a page of this machine is no output to keep."""
    notebook = jupytext.read(script)
    notebook.metadata["kernelspec"] = KERNEL
    NotebookClient(notebook, timeout=900, resources={"metadata": {"path": HERE}}).execute()
    for number, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{number}"
        cell.metadata.pop("execution", None)
        if "remove-output" in cell.metadata.get("tags", ()):
            cell.outputs = []
    notebook.metadata.pop("language_info", None)
    nbformat.write(notebook, script.with_suffix(".ipynb"))
    print(f"written: {script.with_suffix('.ipynb').name}", flush=True)


if __name__ == "__main__":
    os.environ.setdefault("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    named = [HERE / Path(name).name for name in sys.argv[1:]]
    for script in named or sorted(HERE.glob("[1-9]*.py")):
        execute(script)
