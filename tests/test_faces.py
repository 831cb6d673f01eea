"""The faces of the rooms, held against what is in them."""

import inspect
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

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


def test_importing_the_faces_loads_nothing():
    names = ", ".join(f"sonoservo.{package}" for package in PACKAGES)
    heavy = "numpy", "scipy", "numba", "pydrake", "matplotlib", "typer", "rich", "tornado"
    code = f"import sys, {names}; print([each for each in {heavy} if each in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "[]", result.stderr
