"""Models with meshes in STL, which Drake neither draws nor parses, given meshes in OBJ instead."""

import re
import tempfile
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.refusals import ConfigurationError

_REFERENCE = re.compile(r'(filename="|<uri>)\s*([^"<]+?)\s*(?="|<)')
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])
_VERTEX = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")


def without_stl(model: Path, packages: Mapping[str, str]) -> Path:
    """Return a URDF or SDF file, or a copy that names OBJ meshes in place of its STL ones."""
    if model.suffix not in (".urdf", ".sdf") or ".stl" not in model.read_text().lower():
        return model
    changed = model.stat().st_mtime_ns
    return _converted(model, changed, tuple(sorted(packages.items())))


@lru_cache(maxsize=32)
def _converted(model: Path, changed: int, packages: tuple[tuple[str, str], ...]) -> Path:
    folder, known = _folder(), dict(packages)

    def replaced(found: re.Match[str]) -> str:
        opening, address = found.groups()
        path = _located(address, model, known)
        if path is None:
            return found.group()
        if path.suffix.lower() == ".stl":
            path = _as_obj(path, folder)
        return f"{opening}{path}"

    copy = folder / f"{len(list(folder.iterdir()))}_{model.name}"
    copy.write_text(_REFERENCE.sub(replaced, model.read_text()))
    return copy


@lru_cache(maxsize=1)
def _folder() -> Path:
    _kept.append(tempfile.TemporaryDirectory(prefix="sonoservo_meshes_"))
    return Path(_kept[0].name)


_kept: list["tempfile.TemporaryDirectory[str]"] = []


def _located(address: str, model: Path, packages: Mapping[str, str]) -> Path | None:
    """Return the absolute path of a mesh; None if it is in a package that only Drake knows."""
    scheme, separator, rest = address.partition("://")
    if not separator:
        return model.parent / address
    if scheme == "file":
        return Path(rest)
    name, _, inside = rest.partition("/")
    return Path(packages[name]) / inside if name in packages else None


def _as_obj(path: Path, folder: Path) -> Path:
    if not path.is_file():
        raise ConfigurationError(f"{path}: there is no such mesh")
    corners = read_stl(path).reshape(-1, 3)
    copy = folder / f"{len(list(folder.iterdir()))}_{path.stem}.obj"
    faces = np.arange(1, len(corners) + 1).reshape(-1, 3)
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in faces.tolist()]
    copy.write_text("\n".join(lines) + "\n")
    return copy


def read_stl(path: Path) -> NDArray[np.float32]:
    """Return the (n, 3, 3) corners of a mesh in STL, binary or as text, in the file's unit."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    if len(data) == 84 + _FACET.itemsize * count:
        return np.frombuffer(data, _FACET, count, 84)["corners"]
    corners = np.array(_VERTEX.findall(data), dtype=np.float32)
    if not len(corners) or len(corners) % 3:
        raise ConfigurationError(f"{path}: no mesh in STL")
    return corners.reshape(-1, 3, 3)
