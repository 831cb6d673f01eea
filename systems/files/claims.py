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
    """Keep every other process that claims a folder from writing into it.

    The folder is created if necessary, and the partial files of a killed writer are removed. The
    operating system ends the claim with the process, however that ends. On a file system without
    locks, nothing is claimed.

    Parameters
    ----------
    folder
        Folder to write into; None claims nothing.

    Raises
    ------
    ConfigurationError
        If another process writes into the folder.
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
    """Claim an open file or folder until its handle is closed.

    Parameters
    ----------
    handle
        Number of the open file.
    path
        Path of the file.
    other
        What a person can give instead, for the message.

    Raises
    ------
    ConfigurationError
        If another process has claimed it.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise ConfigurationError(
            f"{path}: another run is writing here; wait for its end, or give {other}"
        ) from error
    except OSError:
        return  # a file system without locks
