"""Reader of freehand scans of the TUS-REC data sets (HDF5), recorded with a 4DC7-3/40."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures, require_extra
from sonoservo.systems.files.volume_file import VolumeFile, check_layout, require_frames
from sonoservo.systems.recording.plus_configuration import read_calibration
from sonoservo.systems.recording.valid_frames import matrix_text

_RATE = 20.0  # Frames per second at which all of them were recorded, in Hz
_CALIBRATION = "calib_matrix.csv"


def open_tus_rec(path: Path, *, frames: bool = False) -> VolumeFile:
    """Open a scan: ``frames`` (n, rows, columns) and ``tforms`` (n, 4, 4), from tool to tracker."""
    h5py = require_extra("h5py", "hdf5", path)
    with refusing_failures(path, "it is no scan of TUS-REC"):
        file = h5py.File(path, "r")
        pictures = file["frames"]
        count, rows, columns = pictures.shape
        require_frames(path, frames, f"{count} frames")
        check_layout(path, (columns, rows, 1), count, np.eye(3), frames=True)
        tforms = np.asarray(_tforms(h5py, file, path), float)
        if tforms.shape != (count, 4, 4):
            raise ConfigurationError(f"{path}: tforms: {tforms.shape} for {count} frames")
        fields = {
            f"Seq_Frame{k:04d}_ProbeToTrackerTransform": matrix_text(matrix)
            for k, matrix in enumerate(tforms)
        }
        notes = [f"its frames are taken to be {1 / _RATE:g} s apart, as the data set says"]
        calibration = next((p / _CALIBRATION for p in list(path.absolute().parents)[:4]
                            if (p / _CALIBRATION).is_file()), None)  # fmt: skip
        if calibration is not None:
            matrix = matrix_text(read_calibration(str(calibration))[1])
            fields |= {f"Seq_Frame{k:04d}_ImageToProbeTransform": matrix for k in range(count)}
            notes.append(f"the calibration is that of {calibration.name}")

    def read(number: int) -> NDArray[Any]:
        return np.asarray(pictures[number]).T[..., np.newaxis]

    return VolumeFile(
        path, (columns, rows, 1), count, np.eye(3), np.zeros(3), read, np.arange(count) / _RATE,
        fields, tuple(notes),
    )  # fmt: skip


def _tforms(h5py: Any, file: Any, path: Path) -> Any:
    if "tforms" in file:
        return file["tforms"][()]
    parts = ["transfs" if part == "frames" else part for part in path.absolute().parts]
    beside = Path(*parts)
    if not beside.is_file() or beside == path.absolute():
        raise ConfigurationError(f"{path}: it holds frames, but no transforms (tforms)")
    with h5py.File(beside, "r") as other:
        return other["tforms"][()]
