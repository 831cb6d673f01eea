"""Files of models, by name or by path."""

from pathlib import Path

from sonoservo.models import model_path


def model_file(folder: str, name: str) -> Path:
    """Path of a model that ships with the package, by its name, or of one's own, by its path.

    Raises
    ------
    FileNotFoundError
        If there is neither; for a name the message lists those that ship.
    """
    own = Path(name)
    if own.suffix and not own.is_file():
        raise FileNotFoundError(f"{folder.removesuffix('s')}: there is no file {name}")
    return own if own.suffix else model_path(f"{folder}/{name}.yaml")
