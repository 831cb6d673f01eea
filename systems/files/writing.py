"""Atomic writing of files."""

import json
import math
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def write_atomically(path: str | Path, data: bytes | str) -> Path:
    """Write a file atomically: a reader sees the old file or the new one, never a part.

    Parameters
    ----------
    path
        Path of the file. Its folder is created if necessary.
    data
        Bytes, or text that is written as UTF-8.

    Returns
    -------
    Path of the file.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, partial = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data.encode() if isinstance(data, str) else data)
        os.chmod(partial, 0o644)  # because only the owner can read mkstemp's files
        os.replace(partial, path)
    except BaseException:
        os.unlink(partial)
        raise
    return path


def write_json(path: str | Path, data: Any) -> Path:
    """Write data as a JSON file, atomically.

    Parameters
    ----------
    path
        Path of the file.
    data
        JSON data, which may also contain NumPy numbers and arrays. Numbers that are not finite
        become null.

    Returns
    -------
    Path of the file.
    """
    return write_atomically(path, json.dumps(_plain(data), indent=2, allow_nan=False))


def _plain(data: Any) -> Any:
    """Return data in Python's own types, with None in place of numbers that are not finite."""
    if isinstance(data, Mapping):
        return {str(key): _plain(value) for key, value in data.items()}
    if hasattr(data, "tolist"):  # NumPy data, without importing NumPy
        return _plain(data.tolist())
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data]
    if isinstance(data, float) and not math.isfinite(data):
        return None
    return data
