"""Pages of the reference: rooms, fields of each experiment, and numbers of the tracker."""

import ast
import inspect
from collections.abc import Iterator
from html import escape
from importlib import import_module
from importlib.resources import files
from itertools import groupby, pairwise
from pathlib import Path

from pydrake.systems.framework import Diagram, LeafSystem

from sonoservo.diagrams.experiments.registry import EXPERIMENTS, experiment_class
from sonoservo.systems.files.field_meanings import field_rows
from sonoservo.systems.files.writing import write_atomically

FIRST = ("run", "track", "track_recording", "locate", "locate_in", "scan", "load_scenario", "drive")
"""Functions that most programs begin with."""

ROOMS = {
    "diagrams": "Everything a program starts with, and diagrams that are wired already.",
    "systems.signals": "Values on the wires.",
    "systems.ultrasound": "From echoes to volumes.",
    "systems.tracking": "Finding and following a needle in volumes.",
    "systems.shape": "Cross-sections and shape of a needle that bends.",
    "systems.control": "Servo, force and guard.",
    "systems.robot": "Arm, probe, phantom and sensors.",
    "systems.needle": "The needle and the hand that pushes it.",
    "systems.calibration": "Delay and hand-eye error of the poses.",
    "systems.recording": "Volumes in files.",
    "systems.live": "Volumes over sockets.",
    "systems.evaluation": "Logs, metrics and pictures of a run.",
    "systems.display": "The console and the world.",
}
"""Rooms of the reference, and what each holds."""


def write_reference(folder: Path) -> None:
    """Write the reference as pages of Markdown into a folder, below ``fields`` and ``python``."""
    for name in EXPERIMENTS:
        write_atomically(folder / "fields" / f"{name}.md", fields_page(name))
    for room, words in ROOMS.items():
        write_atomically(folder / "python" / f"{room.split('.')[-1]}.md", room_page(room, words))
    write_atomically(folder / "fields" / "numbers.md", numbers_page("systems.tracking"))


def fields_page(name: str) -> str:
    """Return the page of all fields of an experiment, with their meanings, folded by section."""
    title = f"# Fields: {name.replace('_', ' ')}"
    page = [title, "", f"`experiment: {name}`. A click unfolds a section."]
    rows = field_rows(experiment_class(name).scenario_class)
    groups = [list(each) for _, each in groupby(rows, lambda row: row[0].partition(".")[0])]
    page += ["", *_fields_table([group[0] for group in groups if len(group) == 1])]
    for (path, _, text), *inner in (group for group in groups if len(group) > 1):
        summary = f"<summary><code>{path}</code>: {escape(text)}</summary>"
        page += ["", "<details>", summary, "", *_fields_table(inner), "", "</details>"]
    return "\n".join(page) + "\n"


def _fields_table(rows: list[tuple[str, str, str]]) -> list[str]:
    lines = [f"| `{path}` | {text} | {default} |" for path, default, text in rows]
    return ["| field | meaning | default |", "|---|---|---|", *lines]


def numbers_page(room: str) -> str:
    """Return the page of the numbers in a room's modules, with their values and meanings."""
    page = ["# Numbers of the tracker", "", "Those that are no fields of a scenario."]
    for path in sorted(Path(str(files(f"sonoservo.{room}"))).glob("*.py")):
        if rows := list(_numbers(path.read_text(encoding="utf-8"))):
            title = path.stem.replace("_", " ").capitalize()
            page += ["", f"## {title}", "", "| number | value | meaning |", "|---|---|---|", *rows]
    return "\n".join(page) + "\n"


def _numbers(source: str) -> Iterator[str]:
    """Yield a row for each constant with numbers that a docstring or a comment explains."""
    lines = source.splitlines()
    for node, following in pairwise([*ast.parse(source).body, ast.Pass()]):
        if not isinstance(node, ast.Assign) or not any(
            isinstance(each, ast.Constant) and type(each.value) in (int, float)
            for each in ast.walk(node.value)
        ):
            continue
        match following:
            case ast.Expr(value=ast.Constant(value=str(meaning))):
                pass
            case _:
                meaning = lines[node.lineno - 1].partition("  # ")[2]
        if meaning:
            words = escape(" ".join(meaning.split()), quote=False)
            name = ast.unparse(node.targets[0]).strip("()")
            yield f"| `{name}` | `{ast.unparse(node.value)}` | {words} |"


def room_page(room: str, words: str) -> str:
    """Return the page of a room: what programs begin with, systems, classes and functions."""
    module = f"sonoservo.{room}"
    name = room.split(".")[-1].capitalize()
    page = [f"# {name}: {words.rstrip('.')}", "", f"`from {module} import ...`"]
    for title, names in _sections(module):
        page += ["", f"## {title}", "", "```{eval-rst}"]
        for name in names:
            kind = "class" if inspect.isclass(getattr(import_module(module), name)) else "function"
            page.append(f".. auto{kind}:: {module}.{name}")
            page += ["   :members:", ""] if kind == "class" else [""]
        page.append("```")
    return "\n".join(page) + "\n"


def _sections(module: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the titles and names of a room's sections that are not empty."""
    room = import_module(module)
    kinds: dict[str, list[str]] = {
        "First": [], "Systems": [], "Classes": [], "Parameters": [], "Functions": []
    }  # fmt: skip
    for name in room.__all__:
        value = getattr(room, name)
        is_class = inspect.isclass(value)
        if name in FIRST and module == "sonoservo.diagrams":
            kinds["First"].append(name)
        elif (is_class and issubclass(value, LeafSystem | Diagram)) or name.startswith("Make"):
            kinds["Systems"].append(name)
        elif is_class:
            kinds["Parameters" if name.endswith("Parameters") else "Classes"].append(name)
        else:
            kinds["Functions"].append(name)
    kinds["First"].sort(key=FIRST.index)
    return ((title, names) for title, names in kinds.items() if names)
