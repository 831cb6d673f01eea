"""Files that are either whole or not there."""

import json
import math
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def write_atomically(path: str | Path, data: bytes | str) -> Path:
    """Write a file so that a reader sees the old one or the new one, never a part.

    Parameters
    ----------
    path
        Where to; its folder is made if it is missing.
    data
        Bytes, or text that is written as UTF-8.

    Returns
    -------
    The path.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, partial = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data.encode() if isinstance(data, str) else data)
        os.chmod(partial, 0o644)  # mkstemp's files are for their owner alone
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
        Where to.
    data
        Whatever JSON has; besides, NumPy's numbers and arrays, and what is not finite: it becomes
        null.
    """
    return write_atomically(path, json.dumps(_plain(data), indent=2, allow_nan=False))


def _plain(data: Any) -> Any:
    """The same in Python's own types, null in place of what is not finite."""
    if isinstance(data, Mapping):
        return {str(key): _plain(value) for key, value in data.items()}
    if hasattr(data, "tolist"):  # NumPy's, which need not be imported for it
        return _plain(data.tolist())
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data]
    if isinstance(data, float) and not math.isfinite(data):
        return None
    return data
