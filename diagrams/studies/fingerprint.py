"""Identity of the program: a digest of its code, and all else that results depend on."""

import hashlib
import platform
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

import llvmlite.binding
from grimp import build_graph

_PARTS = ("systems", "models", "diagrams")

_SHOWS_RESULTS = (
    "display", "cli", "terminal", "plots", "report", "page", "words", "analysis", "results",
)  # fmt: skip
"""Endings of the names of folders and modules that do not affect results."""

_PACKAGES = ("sonoservo", "drake", "numpy", "scipy", "numba", "llvmlite", "filterpy")
"""Packages whose versions affect results."""


@cache
def code_fingerprint(*modules: str) -> str:
    """Return a digest of the code that makes results, of its data files and of Drake's version.

    Code that only displays results (`_SHOWS_RESULTS`) is excluded, and so are pages of
    documentation: a better plot, or a better word, does not make runs out of date.

    Parameters
    ----------
    modules
        Names of the modules that make the results. Code that they do not import, directly or not,
        is excluded, too; so they must import the classes of their experiments. Without names, or if
        one of them is none of the package's, all code counts.
    """
    digest = hashlib.sha256(f"sonoservo {version('sonoservo')}, drake {version('drake')}".encode())
    reached = _reached_modules(modules)
    for part in _PARTS:
        folder = Path(str(files(f"sonoservo.{part}")))
        for path in sorted(folder.rglob("*")):
            names = (part, *path.relative_to(folder).with_suffix("").parts)
            code = path.suffix in (".py", ".pyi")
            counts = not code or reached is None or ".".join(("sonoservo", *names)) in reached
            shows = path.suffix == ".md" or any(name.endswith(_SHOWS_RESULTS) for name in names)
            if path.is_file() and counts and not shows and "__pycache__" not in names:
                digest.update("/".join(names).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def study_fingerprint(name: str) -> str:
    """Return the digest of the code that makes the results of a paper's reproduction, or a study.

    Parameters
    ----------
    name
        Name of its package.
    """
    return code_fingerprint(f"sonoservo.diagrams.{study_room(name)}.{name}.reproduction")


def study_room(name: str) -> str:
    """Return the folder of `diagrams` in which a study's package lies: "papers" or "studies"."""
    folder = Path(str(files("sonoservo.diagrams")))
    return "papers" if (folder / "papers" / name).is_dir() else "studies"


def _reached_modules(modules: Sequence[str]) -> set[str] | None:
    """Return the names of modules and of all that they import; None for all modules."""
    if not modules:
        return None
    packages = (f"sonoservo.{part}" for part in _PARTS)
    graph = build_graph(*packages, cache_dir=None, exclude_type_checking_imports=True)
    if not graph.modules.issuperset(modules):
        return None
    for each in list(graph.modules):
        if any(name.endswith(_SHOWS_RESULTS) for name in each.split(".")):
            graph.remove_module(each)
    return set(modules).union(*(graph.find_upstream_modules(each) for each in modules))


@cache
def made_with() -> Mapping[str, str]:
    """Return what results depend on beside the code.

    These are the versions of Python and of the `_PACKAGES`, and the set of instructions of which
    all processors give the same bits.
    """
    python = ".".join(platform.python_version_tuple()[:2])
    versions = {name: version(name) for name in _PACKAGES}
    return {"python": python, **versions, "instruction set": _instruction_set()}


def _instruction_set() -> str:
    machine = platform.machine()
    if machine not in ("x86_64", "AMD64"):
        return machine
    has = llvmlite.binding.get_host_cpu_features()
    return "x86-64-v3" if has.get("avx2") and has.get("fma") else "x86-64-v2"


@cache
def package_identity() -> Mapping[str, str]:
    """Return what results depend on: `made_with` and the `code_fingerprint`."""
    return {**made_with(), "sonoservo's code": code_fingerprint()}


def describe_differences(theirs: Mapping[str, str], ours: Mapping[str, str]) -> str:
    """Return a line of what differs between two identities; empty if they are the same."""
    names = [name for name in (*ours, *theirs) if theirs.get(name) != ours.get(name)]
    return ", ".join(
        f"{name} {theirs.get(name, 'missing')} instead of {ours.get(name, 'none')}"
        for name in dict.fromkeys(names)
    )
