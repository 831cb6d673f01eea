"""Identity of the program: a digest of its code, and the versions that results depend on."""

import hashlib
import platform
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

_SHOWS_RESULTS = ("display", "cli", "terminal", "plots", "report", "page", "analysis", "results")
"""Endings of the names of folders and modules that do not affect results."""

_PACKAGES = ("sonoservo", "drake", "numpy", "scipy", "numba", "llvmlite", "filterpy")
"""Packages whose versions affect results."""


@cache
def code_fingerprint() -> str:
    """Return a digest of the package's files and of Drake's version.

    Code that only displays results (`_SHOWS_RESULTS`) is excluded: a better plot does not make runs
    out of date.
    """
    digest = hashlib.sha256(f"sonoservo {version('sonoservo')}, drake {version('drake')}".encode())
    for part in ("systems", "models", "diagrams"):
        folder = Path(str(files(f"sonoservo.{part}")))
        for path in sorted(folder.rglob("*")):
            names = path.relative_to(folder).with_suffix("").parts
            shows = any(name.endswith(_SHOWS_RESULTS) for name in names)
            if path.is_file() and not shows and "__pycache__" not in names:
                digest.update("/".join((part, *names)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def package_identity() -> Mapping[str, str]:
    """Return the versions of Python and of the `_PACKAGES`, and the `code_fingerprint`."""
    versions = {name: version(name) for name in _PACKAGES}
    python = ".".join(platform.python_version_tuple()[:2])
    return {"python": python, **versions, "sonoservo's code": code_fingerprint()}


def describe_differences(theirs: Mapping[str, str], ours: Mapping[str, str]) -> str:
    """Return a line of what differs between two identities; empty if they are the same."""
    names = [name for name in (*ours, *theirs) if theirs.get(name) != ours.get(name)]
    return ", ".join(
        f"{name} {theirs.get(name, 'missing')} instead of {ours.get(name, 'none')}"
        for name in dict.fromkeys(names)
    )
