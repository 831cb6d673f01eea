"""Identity of the code, data and libraries that make results."""

import ast
import hashlib
import platform
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

import llvmlite.binding
from grimp import build_graph

from sonoservo.diagrams.published import method_modules, published

_PARTS = ("systems", "models", "diagrams")

_SHOWING = ("sonoservo.systems.display", "sonoservo.systems.evaluation.reports")
"""Rooms that only present runs; nothing in them makes a result."""

RECORDS = "records.json.gz"
"""Name of the files of kept results, which the code makes and which do not count as part of it."""

_PACKAGES = ("sonoservo", "drake", "numpy", "scipy", "numba", "llvmlite", "filterpy")
"""Packages whose versions affect results."""


@cache
def code_fingerprint(*modules: str) -> str:
    """Return a digest of all data and of the code that some modules import, or of all code.

    Docstrings, lines of comment and code that only shows results (`_SHOWING`) do not count. Imports
    by name at run time are not followed, so the modules must import their experiments' classes.
    """
    digest = hashlib.sha256()
    reached = _reached_modules(modules)
    for part in _PARTS:
        folder = Path(str(files(f"sonoservo.{part}")))
        for path in sorted(folder.rglob("*")):
            names = (part, *path.relative_to(folder).with_suffix("").parts)
            module = ".".join(("sonoservo", *names))
            code = path.suffix in (".py", ".pyi")
            counts = not _shows(module) and (not code or reached is None or module in reached)
            made = path.suffix == ".md" or path.name == RECORDS or "__pycache__" in names
            if path.is_file() and counts and not made:
                content = _without_words(path.read_bytes()) if code else path.read_bytes()
                digest.update("/".join(names).encode() + b"\0" + content)
    return digest.hexdigest()[:16]


def _without_words(source: bytes) -> bytes:
    """Return the lines of a module that are neither docstrings, nor comments, nor empty."""
    words: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Expr(value=ast.Constant(value=str())):
                words.update(range(node.lineno - 1, node.end_lineno or node.lineno))
    lines = enumerate(source.splitlines())
    stripped = (line for number, line in lines if number not in words and line.strip())
    return b"\n".join(line for line in stripped if not line.lstrip().startswith(b"#"))


def _shows(module: str) -> bool:
    return any(module == room or module.startswith(f"{room}.") for room in _SHOWING)


def _reached_modules(modules: Sequence[str]) -> set[str] | None:
    """Return the names of modules and of all that they import; None for all modules."""
    if not modules:
        return None
    packages = (f"sonoservo.{part}" for part in _PARTS)
    graph = build_graph(*packages, cache_dir=None, exclude_type_checking_imports=True)
    if not graph.modules.issuperset(modules):
        return None
    for each in method_modules():
        # Imported by its name, which the graph does not see.
        graph.add_import(importer=published.__module__, imported=each)
    for each in list(graph.modules):
        if _shows(each):
            graph.remove_module(each)
    return set(modules).union(*(graph.find_upstream_modules(each) for each in modules))


@cache
def made_with() -> Mapping[str, str]:
    """Return what results depend on besides the code: versions, and the set of instructions."""
    python = ".".join(platform.python_version_tuple()[:2])
    versions = {name: version(name) for name in _PACKAGES}
    return {"python": python, **versions, "instruction set": _instruction_set()}


def made_by(module: str) -> dict[str, str]:
    """Return the identity of what makes the results of a module's function."""
    return {**made_with(), "module": module, "sonoservo's code": code_fingerprint(module)}


def is_outdated(identity: Mapping[str, str]) -> bool:
    """Return True if the code that made a result has changed since; ``identity`` as `made_by`."""
    return identity["sonoservo's code"] != code_fingerprint(identity["module"])


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
