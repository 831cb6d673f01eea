"""Reference of all fields of a scenario, made of the dataclasses and their docstrings."""

from pathlib import Path

from sonoservo.diagrams.experiments.registry import EXPERIMENTS, experiment_class
from sonoservo.systems.files.field_meanings import field_rows
from sonoservo.systems.files.writing import write_atomically


def write_reference(path: Path) -> None:
    """Write the reference of all experiments as a page of Markdown."""
    page = ["# Fields of a scenario", ""]
    for name in EXPERIMENTS:
        page += [f"## experiment: {name}", "", "| field | default | |", "|---|---|---|"]
        for path_of_field, default, text in field_rows(experiment_class(name).scenario_class):
            page.append(f"| `{path_of_field}` | {default} | {text} |")
        page.append("")
    write_atomically(path, "\n".join(page))
