"""README and documentation: what they name is there, and what they tell people to type is right."""

import re
import runpy
import shlex
from pathlib import Path

import pytest
import typer
import yaml
from commands import sonoservo_here
from docutils.utils.math.latex2mathml import tex2mathml

from sonoservo.diagrams.app.cli import app
from sonoservo.diagrams.experiments import registry
from sonoservo.diagrams.experiments.registry import EXPERIMENTS, experiment_class, list_scenarios
from sonoservo.diagrams.studies.cluster.opening import read_job_queue
from sonoservo.models import model_path
from sonoservo.systems.files.field_meanings import field_rows
from sonoservo.systems.files.typed_yaml import load_typed, read_yaml
from sonoservo.systems.files.writing import write_atomically
from sonoservo.systems.robot.arm import load_arm
from sonoservo.systems.ultrasound.simulation.anatomy.anatomies import LabelMapAnatomy

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "notebooks" / "docs"
PAGES = [
    ROOT / "README.md",
    *sorted(DOCS.glob("*.md")),
    *sorted(ROOT.glob("systems/*/README.md")),
    ROOT / "models" / "README.md",
]

BUILT = ("fields/", "python/", "tutorials/")
"""Folders that only a build of the documentation makes."""


def blocks(path, language):
    return re.findall(f"```{language}\n(.*?)```", path.read_text(encoding="utf-8"), re.S)


def commands(name=""):
    """Commands of sonoservo in all pages, or in those of a name."""
    for path in PAGES:
        if name not in ("", path.name):
            continue
        for block in blocks(path, "sh"):
            for line in re.split("\n|&&", block):
                words = shlex.split(line, comments=True)
                if words[:1] == ["sonoservo"]:
                    yield pytest.param(words[1:], id=f"{path.stem}: {' '.join(words[1:4])}")


@pytest.mark.parametrize(
    "path",
    [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"],
    ids=lambda path: f"{path.parent.name}/{path.name}",
)
def test_links_lead_somewhere(path):
    text = path.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", text) + re.findall(r"include} (\S+)", text):
        if "://" not in target:
            assert (path.parent / target).exists(), target
            assert not target.startswith(BUILT), f"the sources do not have {target}"


def test_numbers_stand_beside_their_meanings():
    numbers = runpy.run_path(str(DOCS / "reference.py"))["_numbers"]
    source = '''A, _B = 1.0, 2
"""Meaning of both,
in m."""
NAME = "no number"
C = 3  # meaning < here
_UNEXPLAINED = 4
'''
    assert list(numbers(source)) == [
        "| `A, _B` | `(1.0, 2)` | Meaning of both, in m. |",
        "| `C` | `3` | meaning &lt; here |",
    ]


def test_every_room_has_its_page_in_the_reference():
    rooms = runpy.run_path(str(DOCS / "reference.py"))["ROOMS"]
    pages = re.findall(r"^python/(\w+)$", (DOCS / "python.md").read_text(encoding="utf-8"), re.M)
    assert pages == [room.split(".")[-1] for room in rooms]


def test_formulas_are_of_the_kind_that_needs_no_script_to_be_drawn():
    text = (DOCS / "science.md").read_text(encoding="utf-8")
    formulas = re.findall(r"\$\$(.+?)\$\$", text, re.S)
    formulas += re.findall(r"(?<!\$)\$([^$]+)\$(?!\$)", text)
    assert len(formulas) > 20
    for each in formulas:
        assert tex2mathml(each.strip()).startswith("<math"), each


def test_fields_that_are_set_are_fields():
    known = {
        row[0] for name in EXPERIMENTS for row in field_rows(experiment_class(name).scenario_class)
    }
    texts = [path.read_text(encoding="utf-8") for path in PAGES]
    named = {path for text in texts for path in re.findall(r"--set \"?([\w.]+)=", text)}
    assert len(named) > 10
    assert not named - known


@pytest.mark.parametrize("words", list(commands()))
def test_commands_are_understood(words):
    command = typer.main.get_command(app).commands[words[0]]
    command.make_context(words[0], list(words[1:])).close()


SHORT = {
    "following": {"duration": 0.4},
    "shape_prediction": {"depth": 0.01, "observe_until": 0.005, "rotations": [], "step": 2e-3},
}
"""Changes that make a run a matter of a volume or of a few slices."""

SLOW_PAGES = ("scenarios.md", "report.md")

RUN = {"list", "show", "new", "scan", "run", "compare", "replay"}
"""Commands that are run; the others are only parsed here, and have tests of their own."""

OTHER = {"--serve", "--record", "--explain", "--log", "clinic", "carriere2016_d60"}
"""Words of commands that are only parsed, because they need a peer, or kernels of their own."""


@pytest.fixture
def quick(tmp_path, monkeypatch):
    """Make runs of built-in scenarios short, in a folder of their own."""
    known = {}
    for name, path in list_scenarios().items():
        data = read_yaml(path)
        data |= SHORT[data.get("experiment", "following")]
        known[name] = write_atomically(tmp_path / "short" / f"{name}.yaml", yaml.safe_dump(data))
    monkeypatch.setattr(registry, "list_scenarios", lambda: known)
    for module in ("run_result", "kept_runs.compare"):  # drawing takes longer than the run itself
        monkeypatch.setattr(f"sonoservo.diagrams.app.{module}.png", lambda figure: b"")
    monkeypatch.chdir(tmp_path)
    write_atomically("mine.yaml", "duration: 0.4")
    return tmp_path


@pytest.mark.parametrize(
    "page",
    ["README.md", *(pytest.param(each, marks=pytest.mark.slow) for each in SLOW_PAGES)],
)
def test_commands_do_what_the_pages_say(page, quick, capsys):
    if page == "README.md":  # as `make run` does
        assert sonoservo_here("run", "chatelain2013_fig5", "--no-meshcat").returncode == 0
    done = set()
    for words in (each.values[0] for each in commands(page)):
        if words[0] not in RUN or OTHER & set(words) or words[:2] == ["new", "mine.yaml"]:
            continue
        if words[0] == "run" and "--no-meshcat" not in words:
            words = [*words, "--no-meshcat"]
        if words[0] == "replay":
            words = [*words, "--once", "--no-open"]
        if tuple(words) not in done:
            result = sonoservo_here(*words)
            assert result.returncode == 0, (words, result.stderr)
            done.add(tuple(words))
    assert done


@pytest.mark.parametrize(
    "page",
    ["README.md", pytest.param("report.md", marks=pytest.mark.slow), "parts.md", "volumes.md"],
)
def test_snippets_run(page, quick, capsys):
    path = ROOT / page if page == "README.md" else DOCS / page
    names = {}
    for block in blocks(path, "python"):
        code = compile(block, f"{page}: {block[:40]}", "exec")
        if "fig4.seq.nrrd" not in block:  # it shows a recording that a command above makes
            exec(code, names)
    if page == "volumes.md":
        assert len(capsys.readouterr().out.splitlines()) == 3


@pytest.mark.parametrize("path", PAGES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_yaml_of_the_pages_is_read(path, tmp_path):
    for block in blocks(path, "yaml"):
        data = yaml.safe_load(block)
        if "class" in data:
            queue = tmp_path / "queue.yaml"
            queue.write_text(block)
            assert read_job_queue(queue).jobs == data["jobs"]
        elif "directives" in data:
            (tmp_path / "mine.yaml").write_text(block)
            (tmp_path / "mine.urdf").write_text(model_path("robots/ur5e.urdf").read_text())
            assert load_arm(str(tmp_path / "mine.yaml")).servo.p
        elif "tissue" in data:
            data = {name: data["tissue"]["anatomy"][name] for name in ("kind", "top", "labels")}
            assert load_typed(LabelMapAnatomy, data, str(path)).labels
        else:
            load_typed(experiment_class("following").scenario_class, data, str(path))


def test_every_field_of_a_scenario_is_described():
    for name in EXPERIMENTS:
        rows = list(field_rows(experiment_class(name).scenario_class))
        assert ("duration" in {row[0] for row in rows}) == (name == "following")
        assert not [path for path, _, text in rows if not text or text.endswith(": ")]
