"""Reader and writer of explained volumes: one file for each, in a subfolder of the run's folder."""

from pathlib import Path

from sonoservo.systems.evaluation.explanation.explained_volume import ExplainedVolume
from sonoservo.systems.evaluation.log import read_log, write_log

FOLDER = "explanation"
"""Name of the subfolder of the explained volumes."""

_FILES = "*s.npz"


def write_explanation(run: Path, explained: ExplainedVolume) -> Path:
    """Write an explained volume into the folder of a run, atomically.

    Its file is named after the volume's time.
    """
    return write_log(run / FOLDER / f"{float(explained.volume_time):08.3f}s.npz", explained)


def read_explanations(run: Path) -> list[ExplainedVolume]:
    """Read the explained volumes in the folder of a run, in order of time."""
    kept = [read_log(path, ExplainedVolume) for path in (run / FOLDER).glob(_FILES)]
    return sorted(kept, key=lambda each: float(each.volume_time))


def clear_explanations(run: Path) -> None:
    """Remove the explained volumes of an earlier run from the folder of a run, if there are any."""
    for path in (run / FOLDER).glob(_FILES):
        path.unlink()
    if (run / FOLDER).is_dir() and not any((run / FOLDER).iterdir()):
        (run / FOLDER).rmdir()
