"""Atomic writing of files, and claims of a folder or file for a single writer."""

import errno
import fcntl
import json
import math
import os
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Self

from sonoservo.systems.files.refusals import ConfigurationError

PARTIAL = ".partial"
"""Suffix of the hidden files that are being written."""

# Beginnings of the paths of open files, which may already hold other output.
_STREAMS = ("/dev/", "/proc/")


def write_atomically(path: str | Path, data: bytes | str) -> Path:
    """Write bytes, or text as UTF-8, atomically: a reader sees the old file or the new one.

    The folder is made if necessary. A symbolic link's target is written. Devices, pipes and files
    with several names are written into, never replaced. An OSError names the file. Returns its
    path.
    """
    path = Path(path)
    content = data.encode() if isinstance(data, str) else data
    make_folder(path.parent)
    with naming(path):
        if str(path.absolute()).startswith(_STREAMS):
            _write_into(path, content, "ab")
        elif path.exists() and not (path.is_file() and path.stat().st_nlink == 1):
            _write_into(path, content, "wb")
        else:
            _replace(Path(os.path.realpath(path)), content)
    return path


def make_folder(folder: Path) -> None:
    """Make a folder and those above it, unless it exists."""
    try:
        with naming(folder):
            folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise NotADirectoryError(errno.ENOTDIR, "it is not a folder", str(folder)) from error


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Name a file in the operating system's errors, such as that of a full disk."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


@contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """Open a hidden file that takes a path's place if the block ends without an error."""
    handle, partial = tempfile.mkstemp(PARTIAL, f".{path.name[:100]}.", path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            # Only the owner can read the files of mkstemp.
            os.fchmod(handle, path.stat().st_mode & 0o777 if path.exists() else 0o644)
            yield file
        os.replace(partial, path)
    except BaseException:
        os.unlink(partial)
        raise


def _replace(path: Path, content: bytes) -> None:
    with replacing(path) as file:
        file.write(content)


def _write_into(path: Path, content: bytes, mode: str) -> None:
    with path.open(mode) as file:
        file.write(content)


class Unwritten:
    """Collects the errors of files, so that a result outlives a full disk."""

    def __init__(self) -> None:
        self.failure: OSError | None = None

    @contextmanager
    def collect(self) -> Iterator[None]:
        """Note an error of the operating system, and go on after the block."""
        try:
            yield
        except OSError as error:
            self.note(error)

    def note(self, error: OSError) -> None:
        """Note an error; only the first counts."""
        self.failure = self.failure or error


def write_json(path: str | Path, data: Any) -> Path:
    """Write data, also NumPy's, as JSON, atomically; numbers that are not finite become null."""
    return write_atomically(path, to_json(data))


def to_json(data: Any) -> str:
    """Return data as JSON; see `write_json`."""
    return json.dumps(to_plain(data), indent=2, allow_nan=False)


def to_plain(data: Any, *, for_json: bool = True) -> Any:
    """Return data with NumPy's values as Python's own."""
    if isinstance(data, Mapping):
        return {
            str(key) if for_json else key: to_plain(value, for_json=for_json)
            for key, value in data.items()
        }
    if hasattr(data, "tolist"):  # NumPy data, without importing NumPy
        return to_plain(data.tolist(), for_json=for_json)
    if isinstance(data, list | tuple):
        return [to_plain(value, for_json=for_json) for value in data]
    if for_json and isinstance(data, float) and not math.isfinite(data):
        return None
    return data


@contextmanager
def claim_folder(folder: Path | None) -> Iterator[None]:
    """Keep every other process that claims a folder from writing into it; None claims nothing.

    The folder, and those above it, are made if necessary, and those left empty are removed again.
    """
    if folder is None:
        yield
        return
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    make_folder(folder)
    handle = os.open(folder, os.O_RDONLY)
    try:
        claim(handle, folder, "another --out")
        for partial in folder.glob(f".*{PARTIAL}"):
            with suppress(OSError):
                partial.unlink()
        yield
    finally:
        with suppress(OSError):  # the first that holds something, and so those above it
            for each in made:
                each.rmdir()
        os.close(handle)


def claim(handle: int, path: Path, other: str) -> None:
    """Claim an open file until its handle is closed; the error names ``other`` as the way out."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise ConfigurationError(
            f"{path}: another run is writing here; wait for its end, or give {other}"
        ) from error
    except OSError:
        return  # a file system without locks


class Closing(ABC):
    """Base class of objects that are closed at the end of a ``with`` block."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @abstractmethod
    def close(self) -> None:
        """Finish the work; nothing is complete before."""
