"""The house's own rules: which folders there are, and how large a file and a folder may be.

What may import what is held by import-linter; see `make lint`.
"""

import itertools
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = {"systems", "diagrams", "models", "tests", "notebooks"}
BUILT = [line.strip("/") for line in (ROOT / ".gitignore").read_text().splitlines()]
MOST_LINES, MOST_LINES_OF_A_TEST, MOST_MODULES = 350, 500, 15
FULLER = {
    "systems/localization": "one part of the method a module",
    "systems/signals": "one value a module",
}
"""Folders that may hold more modules, and why."""


def modules():
    """Paths of all modules, below the root."""
    for folder in sorted(FOLDERS):
        for path in (ROOT / folder).rglob("*.py"):
            yield path.relative_to(ROOT)


def test_there_are_five_folders():
    there = {path.name for path in ROOT.iterdir() if path.is_dir() and path.name[0] != "."}
    assert {name for name in there if not any(fnmatch(name, each) for each in BUILT)} == FOLDERS


def test_no_file_is_too_long():
    long = {}
    for path in modules():
        lines = (ROOT / path).read_text(encoding="utf-8").count("\n")
        if lines > (MOST_LINES_OF_A_TEST if path.parts[0] == "tests" else MOST_LINES):
            long[str(path)] = lines
    assert not long


def test_no_folder_is_too_full():
    """A folder that is over the limit is named with its reason, and none besides."""
    ours = (path for path in modules() if path.name != "__init__.py")
    folders = itertools.groupby(sorted(str(path.parent) for path in ours))
    full = {folder for folder, paths in folders if len(list(paths)) > MOST_MODULES}
    assert full == set(FULLER)


def test_every_package_has_an_init_and_every_root_is_typed():
    for path in modules():
        if path.parts[0] in ("systems", "diagrams", "models"):
            assert (ROOT / path.parent / "__init__.py").is_file(), path
    for folder in ("systems", "diagrams", "models"):
        assert (ROOT / folder / "py.typed").is_file()
