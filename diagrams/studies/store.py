"""Stores of files: a folder, or any place that fsspec can reach."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sonoservo.systems.files.refusals import ConfigurationError, describe
from sonoservo.systems.files.writing import write_atomically

_FILE = "file://"


@dataclass(frozen=True)
class Store:
    """Place for the files of results: a folder, or a URL of fsspec such as ``s3://bucket/needles``.

    `shared`: whether the workers of a cluster write into it themselves.
    """

    url: str
    shared: bool = False

    def __post_init__(self) -> None:
        if self._folder is None:
            self._remote()

    def write(self, files: Mapping[str, bytes]) -> None:
        """Write files atomically; remotely all together, if its file system has transactions."""
        if self._folder is not None:
            for name, data in files.items():
                write_atomically(self._folder / name, data)
            return
        system, root = self._remote()
        with system.transaction:
            for name, data in files.items():
                path = f"{root}/{name}"
                system.makedirs(path.rpartition("/")[0], exist_ok=True)
                with system.open(path, "wb") as file:
                    file.write(data)

    def read(self, name: str) -> bytes | None:
        """Return the contents of a file; None if there is no such file."""
        try:
            if self._folder is not None:
                return (self._folder / name).read_bytes()
            system, root = self._remote()
            data: bytes = system.cat_file(f"{root}/{name}")
            return data
        except FileNotFoundError:
            return None

    def sizes(self) -> dict[str, int]:
        """Return the size of each file in bytes, by name."""
        if self._folder is not None:
            paths = (path for path in self._folder.rglob("*") if path.is_file())
            return {path.relative_to(self._folder).as_posix(): _size(path) for path in paths}
        system, root = self._remote()
        try:
            found = system.find(root, detail=True)
        except FileNotFoundError:
            return {}
        return {path[len(root) + 1 :]: int(entry["size"]) for path, entry in found.items()}

    def remove(self, names: Iterable[str]) -> None:
        """Remove files, if they are there."""
        for name in names:
            if self._folder is not None:
                (self._folder / name).unlink(missing_ok=True)
            else:
                system, root = self._remote()
                system.rm_file(f"{root}/{name}")

    def __str__(self) -> str:
        return self.url

    @property
    def _folder(self) -> Path | None:
        """Folder of this machine; None if the store is reached through fsspec."""
        if "://" not in self.url:
            return Path(self.url)
        return Path(self.url.removeprefix(_FILE)) if self.url.startswith(_FILE) else None

    def _remote(self) -> tuple[Any, str]:
        """Return fsspec's file system of the URL, and the path in it."""
        try:
            from fsspec.core import url_to_fs
        except ImportError as error:
            raise ConfigurationError(
                f"store: {self.url}: install fsspec first: pip install -e '.[cluster]'"
            ) from error
        try:
            system, root = url_to_fs(self.url)
        except (ValueError, ImportError, OSError) as error:  # no such protocol, package or host
            raise ConfigurationError(f"store: {self.url}: {describe(error)}") from error
        return system, root.rstrip("/")


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:  # removed meanwhile
        return -1


def absolute(url: str) -> str:
    """Return a URL as it is, and a folder by its absolute path, for processes elsewhere."""
    return url if "://" in url else os.path.realpath(url)
