"""Files of models, by name or by path."""

from collections.abc import Callable, Sequence
from functools import lru_cache, wraps
from pathlib import Path
from typing import Any, TypeVar

from sonoservo.models import model_path
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import read_yaml, suggest

T = TypeVar("T")

NAMING = frozenset({"phantom", "probe", "needle", "arm"})
"""Fields of a scenario, and of its station, that hold the name of a model or of a user's file."""

_MODELS = model_path("package.xml").parent


def read_once(read: Callable[[Path], T]) -> Callable[[Path], T]:
    """Decorate a model's reader to read again only after a change; the result is shared."""

    @lru_cache(maxsize=64)
    def remembered(path: Path, _place: Path, _modified: int, _size: int) -> T:
        return read(path)

    @wraps(read)
    def reader(path: Path) -> T:
        state = path.stat()
        return remembered(path, path.resolve(), state.st_mtime_ns, state.st_size)

    return reader


def model_file(folder: str, name: str) -> Path:
    """Return the path of a model by its name in a folder of our models, or of a user's file."""
    own, kind = Path(name), folder.removesuffix("s")
    if not own.suffix:
        ours = {each.stem: each for each in _MODELS.joinpath(folder).glob("*.yaml")}
        if name not in ours:
            raise FileNotFoundError(f"{kind}: there is no {name!r}; {suggest(name, ours)}")
        return ours[name]
    if not own.is_file():
        raise FileNotFoundError(f"{kind}: there is no file {name}")
    if own.suffix not in (".yaml", ".yml", ".json"):  # JSON is YAML as well
        own, data = own.with_name(own.name.split(".")[0] + ".yaml"), own
        if not own.is_file():
            raise FileNotFoundError(
                f"{kind}: {data} needs a file {own.name} beside it that says what it is made of"
            )
    return own


def lasting_name(name: str) -> str:
    """Return a model's name, or the absolute path of a user's file, for use from any folder."""
    return str(Path(name).absolute()) if Path(name).suffix else name


def read_section(path: Path, section: str, sections: Sequence[str]) -> dict[str, Any]:
    """Read one section of a model's YAML file, empty if missing; others are refused."""
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
