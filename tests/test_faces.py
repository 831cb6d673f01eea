"""The faces of the rooms, held against what is in them."""

import ast
import inspect
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from pydrake.systems.framework import Diagram, LeafSystem

from sonoservo.systems.signals import Immutable

ROOT = Path(__file__).parents[1]
PACKAGES = sorted(
    str(path.parent.relative_to(ROOT)).replace("/", ".")
    for folder in ("systems", "diagrams", "models")
    for path in (ROOT / folder).rglob("__init__.py")
)
FACES = [
    package for package in PACKAGES if (ROOT / package.replace(".", "/") / "__init__.pyi").is_file()
]
"""Rooms that hand out names; the others are parts of a room, or what no program needs."""


def modules(package):
    """Names of the modules and rooms in a package."""
    folder = ROOT / package.replace(".", "/")
    paths = [*folder.glob("*.py"), *(path.parent for path in folder.glob("*/__init__.py"))]
    return {path.stem for path in paths} - {"__init__"}


def own_names(package):
    """Public classes and functions of a package's modules and its parts: (name, object)."""
    for name in sorted(modules(package)):
        if package.startswith("systems") and f"{package}.{name}" in PACKAGES:
            if f"{package}.{name}" not in FACES:
                yield from own_names(f"{package}.{name}")
            continue
        module = import_module(f"sonoservo.{package}.{name}")
        for each, value in vars(module).items():
            if not each.startswith("_") and getattr(value, "__module__", "") == module.__name__:
                yield each, value


@pytest.mark.parametrize("package", FACES)
def test_every_name_of_a_face_is_there_public_and_documented(package):
    face = import_module(f"sonoservo.{package}")
    assert face.__all__
    for name in face.__all__:
        value = getattr(face, name)
        assert not name.startswith("_")
        assert value.__module__.startswith(f"sonoservo.{package}.")
        text = inspect.getdoc(value) or ""
        assert text, f"{package}.{name} has no docstring"
        assert not text.startswith(f"{name}("), f"{package}.{name} has no docstring of its own"


@pytest.mark.parametrize("package", FACES)
def test_a_face_hands_out_every_block_and_its_parameters(package):
    """A module's name must not be handed out as well: it would be either, by order of import."""
    face = set(import_module(f"sonoservo.{package}").__all__)
    expected = {
        name
        for name, value in own_names(package)
        if re.match("(Make|Add)[A-Z]", name)
        or (isinstance(value, type) and issubclass(value, Diagram | LeafSystem))
        or (isinstance(value, type) and name.endswith("Parameters"))
    }
    assert expected <= face
    assert not face & modules(package)


def test_signals_hands_out_every_value():
    values = {
        name
        for name, value in own_names("systems.signals")
        if isinstance(value, type) and issubclass(value, Immutable)
    }
    assert values <= set(import_module("sonoservo.systems.signals").__all__)


def test_importing_the_faces_loads_nothing():
    names = ", ".join(f"sonoservo.{package}" for package in PACKAGES)
    heavy = "numpy", "scipy", "numba", "pydrake", "matplotlib", "typer", "rich", "tornado"
    code = f"import sys, {names}; print([each for each in {heavy} if each in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "[]", result.stderr


def imported(code):
    """Names that a piece of code imports from us: (module or package, name)."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and node.module.startswith("sonoservo."):
            for alias in node.names:
                yield node.module.removeprefix("sonoservo."), alias.name


NOTEBOOKS = sorted(ROOT.glob("notebooks/[1-9]*.py"))


@pytest.mark.parametrize(
    "path",
    [ROOT / "notebooks/docs/python.md", ROOT / "notebooks/docs/volumes.md", *NOTEBOOKS],
    ids=lambda path: path.stem,
)
def test_users_code_imports_from_faces(path):
    text = path.read_text()
    blocks = re.findall("```python\n(.*?)```", text, re.S) if path.suffix == ".md" else [text]
    names = [each for block in blocks for each in imported(block)]
    assert names
    for module, name in names:
        assert module in FACES
        assert name in import_module(f"sonoservo.{module}").__all__


def test_inside_names_are_imported_from_their_modules():
    """So import-linter sees every arrow, and a name is found where it is defined."""
    for package in PACKAGES:
        for path in (ROOT / package.replace(".", "/")).glob("*.py"):
            for module, name in imported(path.read_text()):
                assert module not in FACES or name in modules(module), f"{path}: {module}"
