"""What exists: arm, probe, phantom, transducers. The README tells where every value comes from."""

from pathlib import Path


def model_path(name: str) -> Path:
    """Path of a model file.

    Parameters
    ----------
    name
        Path below this folder, such as ``viper_s850.urdf``.

    Raises
    ------
    FileNotFoundError
        If there is none; the message lists those of the same kind.
    """
    folder = Path(__file__).parent
    path = folder / name
    if not path.is_file():
        kind = Path(name).suffix
        there = sorted(str(each.relative_to(folder)) for each in folder.rglob(f"*{kind}"))
        raise FileNotFoundError(f"there is no model {name!r}; there is: {', '.join(there)}")
    return path
