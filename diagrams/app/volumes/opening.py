"""Opening of recorded volumes, as the options of a command say."""

from pathlib import Path
from typing import Any

from sonoservo.diagrams.app.volumes.reconstruct import ReconstructedRecording
from sonoservo.systems.recording.plus_configuration import (
    PlusConfiguration,
    read_calibration,
    read_plus_configuration,
)
from sonoservo.systems.recording.recording import Recording


def open_volumes(
    path: Path,
    *,
    reconstruct: bool = False,
    depth: str = "P",
    volume_rate: float | None = None,
    frames: int | None = None,
    spacing: float = 7e-4,
    plus_config: Path | None = None,
    calibration: str | None = None,
    **reading: Any,
) -> Recording | ReconstructedRecording:
    """Open a file of volumes, or of frames to be reconstructed.

    Parameters
    ----------
    path
        Path of the file.
    reconstruct
        Whether to reconstruct volumes from 2D frames.
    depth, volume_rate
        See `Recording`; the rate is that of the frames if they are reconstructed.
    frames, spacing
        See `ReconstructedRecording`.
    plus_config
        Configuration of PLUS that knows transforms and the images' orientation.
    calibration
        Calibration of the image (`read_calibration`), which counts before the configuration's.
    **reading
        Other arguments of `Recording` and of its kin.

    Raises
    ------
    ConfigurationError
        If a file is not valid; the message names the file and the fault.
    """
    known = read_plus_configuration(plus_config) if plus_config else PlusConfiguration()
    transforms = known.matrices
    if calibration is not None:
        name, matrix = read_calibration(calibration)
        transforms[name] = matrix
    reading |= {"transforms": transforms, "orientation": known.orientation}
    opened: Recording | ReconstructedRecording
    if reconstruct:
        opened = ReconstructedRecording(
            path, frames=frames, spacing=spacing, frame_rate=volume_rate, clip=known.clip, **reading
        )
    else:
        opened = Recording(path, depth=depth, volume_rate=volume_rate, **reading)
    opened.notes[:0] = known.notes()
    return opened
