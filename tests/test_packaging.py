"""The wheel, made of the sdist and installed in an environment where nothing else is ours."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("systems", "diagrams", "models")
BUILD_SDIST = "from setuptools import build_meta; build_meta.build_sdist('dist')"


def call(*command, cwd):
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    result = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr


def package_files():
    """Files below the folders of the packages, which a clone has."""
    return {
        str(path.relative_to(ROOT))
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and path.parent.name != "__pycache__"
    }


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("source")
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder)
    for name in FOLDERS:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    cache = folder / "systems" / "signals" / "__pycache__"
    cache.mkdir()
    for name in (
        "volume.cpython-311.pyc",
        "volume.py-12.py311.nbi",
    ):  # as a clone that was used has
        (cache / name).write_bytes(b"old")
    call(sys.executable, "-c", BUILD_SDIST, cwd=folder)
    (sdist,) = folder.glob("dist/*.tar.gz")
    pip = (sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index")
    call(*pip, str(sdist), cwd=folder)
    (made,) = folder.glob("*.whl")
    return made


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Folder of an environment that has the wheel and sees our dependencies, but not this clone."""
    folder = tmp_path_factory.mktemp("environment")
    call(sys.executable, "-m", "venv", "--without-pip", str(folder), cwd=folder)
    pip = (sys.executable, "-m", "pip", "--python", str(folder / "bin" / "python"))
    call(*pip, "install", "--no-deps", "--no-index", str(wheel), cwd=folder)
    (packages,) = folder.glob("lib/python*/site-packages")
    # Python reads no .pth files in a folder that a .pth file names: an editable install stays out.
    ours = [path for path in sys.path if path.endswith("-packages")]
    (packages / "dependencies.pth").write_text("\n".join(ours))
    return folder


def test_the_wheel_holds_every_file_of_the_packages(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert names == {f"sonoservo/{name}" for name in package_files()}


def test_the_installed_package_is_typed_and_its_own(installed):
    code = (
        "import sys; from importlib.resources import files; import sonoservo.systems.signals as us;"
        "from sonoservo.models import model_path; model_path('robots/viper_s850.urdf');"
        f"assert us.__file__.startswith({str(installed)!r}), us.__file__;"
        "assert us.Volume.__module__ == 'sonoservo.systems.signals.volume';"
        "assert all(files(f'sonoservo.{name}').joinpath('py.typed').is_file()"
        f" for name in {FOLDERS})"
    )
    call(str(installed / "bin" / "python"), "-c", code, cwd=installed)
