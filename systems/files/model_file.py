"""Files of models, by name or by path."""

from collections.abc import Callable, Sequence
from functools import lru_cache, wraps
from pathlib import Path
from typing import Any, TypeVar

from sonoservo.models import model_path
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import read_yaml, suggest

T = TypeVar("T")


def read_once(read: Callable[[Path], T]) -> Callable[[Path], T]:
    """Decorate the reader of a model, so that it reads a file again only after a change.

    The result is shared, and must not be changed.
    """

    @lru_cache(maxsize=64)
    def remembered(path: Path, _place: Path, _modified: int, _size: int) -> T:
        return read(path)

    @wraps(read)
    def reader(path: Path) -> T:
        state = path.stat()
        return remembered(path, path.resolve(), state.st_mtime_ns, state.st_size)

    return reader


def model_file(folder: str, name: str) -> Path:
    """Return the path of a model that ships with the package, or of a user's own.

    Parameters
    ----------
    folder
        Folder of `sonoservo.models` that contains models of this kind.
    name
        Name of a model in the folder, or path of a user's file, which has a suffix. A file that is
        not YAML, such as a label map, stands for the YAML file of the same name beside it.

    Raises
    ------
    FileNotFoundError
        If there is no such model. For a name, the message lists the models that ship.
    """
    own = Path(name)
    if own.suffix and not own.is_file():
        raise FileNotFoundError(f"{folder.removesuffix('s')}: there is no file {name}")
    if own.suffix and own.suffix not in (".yaml", ".yml"):
        own, data = own.with_name(own.name.split(".")[0] + ".yaml"), own
        if not own.is_file():
            raise FileNotFoundError(
                f"{folder.removesuffix('s')}: {data} needs a file {own.name} beside it that says "
                "what it is made of"
            )
    return own if own.suffix else model_path(f"{folder}/{name}.yaml")


def read_section(path: Path, section: str, sections: Sequence[str]) -> dict[str, Any]:
    """Read one section of a model's YAML file; a missing section is empty.

    Parameters
    ----------
    path
        Path of the file.
    section
        Name of the section to read.
    sections
        Names of all sections that such a file may have.

    Raises
    ------
    ConfigurationError
        If the file contains anything else.
    """
    data = read_yaml(path)
    for key in data:
        if key not in sections:
            raise ConfigurationError(
                f"{path}: {key}: unknown section; {suggest(str(key), sections)}"
            )
    content = data.get(section)
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ConfigurationError(
            f"{path}: {section}: {content!r} is not allowed; expected a mapping"
        )
    return content
