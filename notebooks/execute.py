"""Write the notebooks from their scripts and run them, so that they hold their outputs.

`make notebooks` runs all; names of scripts run these alone.
"""

import os
from argparse import ArgumentParser
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


def main(arguments: list[str] | None = None) -> None:
    """Run the notebooks that are named, or all."""
    parser = ArgumentParser(description=__doc__)
    known = [script.name for script in sorted(HERE.glob("[1-9]*.py"))]
    parser.add_argument("scripts", nargs="*", help=f"all by default: {', '.join(known)}")
    named = [Path(name).name for name in parser.parse_args(arguments).scripts]
    if unknown := [name for name in named if name not in known]:
        parser.error(f"there is no notebook {unknown[0]}; there are {', '.join(known)}")
    os.environ.setdefault("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    for name in named or known:
        execute(HERE / name)


if __name__ == "__main__":
    main()
