"""README and documentation: what they name is there, and what they tell people to type is right."""

import re
import shlex
from pathlib import Path

import pytest
import typer

from sonoservo.diagrams.app.cli import app
from sonoservo.diagrams.experiments.registry import EXPERIMENTS, experiment_class
from sonoservo.systems.files.field_meanings import field_rows

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "notebooks" / "docs"
PAGES = [
    ROOT / "README.md",
    *(path for path in sorted(DOCS.glob("*.md")) if path.name != "fields.md"),
    *sorted(ROOT.glob("systems/*/README.md")),
    ROOT / "models" / "README.md",
]
MOST_LINES_OF_README = 120


def blocks(path, language):
    return re.findall(f"```{language}\n(.*?)```", path.read_text(encoding="utf-8"), re.S)


def commands():
    """Commands of sonoservo in all pages."""
    for path in PAGES:
        for block in blocks(path, "sh"):
            for line in re.split("\n|&&", block):
                words = shlex.split(line, comments=True)
                if words[:1] == ["sonoservo"]:
                    yield pytest.param(words[1:], id=f"{path.stem}: {' '.join(words[1:4])}")


def test_the_front_page_is_short():
    lines = (ROOT / "README.md").read_text(encoding="utf-8").count("\n")
    assert lines <= MOST_LINES_OF_README


@pytest.mark.parametrize("path", PAGES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_links_lead_somewhere(path):
    text = path.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", text) + re.findall(r"include} (\S+)", text):
        if "://" not in target and target != "fields.md":
            assert (path.parent / target).exists(), target


@pytest.mark.parametrize("words", list(commands()))
def test_commands_are_understood(words):
    command = typer.main.get_command(app).commands[words[0]]
    command.make_context(words[0], list(words[1:])).close()


def test_volumes_of_one_s_own_are_tracked_as_the_page_says(capsys):
    exec(blocks(DOCS / "volumes.md", "python")[0], {})
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_every_field_of_a_scenario_is_described():
    for name in EXPERIMENTS:
        rows = list(field_rows(experiment_class(name).scenario_class))
        assert ("duration" in {row[0] for row in rows}) == (name == "following")
        assert not [path for path, _, text in rows if not text or text.endswith(": ")]
