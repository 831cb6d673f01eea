"""Models of robots, probes and phantoms; the README gives the source of every value."""

from pathlib import Path


def model_path(name: str) -> Path:
    """Return the path of a model file.

    Parameters
    ----------
    name
        Path below this folder, such as ``robots/viper_s850.urdf``.

    Raises
    ------
    FileNotFoundError
        If there is no such file. The message lists the models of the same kind in its folder.
    """
    folder = Path(__file__).parent
    path = folder / name
    if not path.is_file():
        kind = folder / Path(name).parts[0]
        there = sorted(each.name for each in kind.glob(f"*{path.suffix}"))
        raise FileNotFoundError(f"there is no model {name!r}; available: {', '.join(there)}")
    return path
