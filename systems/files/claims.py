"""Claims of a folder or file for a single writer."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.writing import PARTIAL, make_folder


@contextmanager
def claim_folder(folder: Path | None) -> Iterator[None]:
    """Keep every other process that claims a folder from writing into it; None claims nothing.

    The folder is made, and a killed writer's partial files removed. The operating system ends the
    claim with the process. On a file system without locks, nothing is claimed.
    """
    if folder is None:
        yield
        return
    make_folder(folder)
    handle = os.open(folder, os.O_RDONLY)
    try:
        claim(handle, folder, "another --out")
        for partial in folder.glob(f".*{PARTIAL}"):
            with suppress(OSError):
                partial.unlink()
        yield
    finally:
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
