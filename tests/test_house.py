"""The house's own rules: which folders there are.

What may import what is held by import-linter; see `make lint`.
"""

from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = {"systems", "diagrams", "models", "tests", "notebooks"}
BUILT = [line.strip("/") for line in (ROOT / ".gitignore").read_text().splitlines()]


def modules():
    """Paths of all modules, below the root."""
    for folder in sorted(FOLDERS):
        for path in (ROOT / folder).rglob("*.py"):
            yield path.relative_to(ROOT)


def test_there_are_five_folders():
    there = {path.name for path in ROOT.iterdir() if path.is_dir() and path.name[0] != "."}
    assert {name for name in there if not any(fnmatch(name, each) for each in BUILT)} == FOLDERS


def test_every_package_has_an_init_and_every_root_is_typed():
    for path in modules():
        if path.parts[0] in ("systems", "diagrams", "models"):
            assert (ROOT / path.parent / "__init__.py").is_file(), path
    for folder in ("systems", "diagrams", "models"):
        assert (ROOT / folder / "py.typed").is_file()
