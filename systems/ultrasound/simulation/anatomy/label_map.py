"""Label maps: segmented anatomy from NRRD and NIfTI files."""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import nrrd
import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.nifti_reader import open_nifti
from sonoservo.systems.files.nrrd_reader import SPACES, open_nrrd
from sonoservo.systems.files.refusals import refusing_failures
from sonoservo.systems.files.volume_file import VolumeFile
from sonoservo.systems.files.writing import write_atomically
from sonoservo.systems.signals.immutable import Immutable, Shape
from sonoservo.systems.signals.requirements import require

LABEL_MAP_SUFFIXES = (".nrrd", ".nhdr", ".nii", ".nii.gz")


@dataclass(frozen=True, eq=False)
class LabelMap(Immutable):
    """(nx, ny, nz) labels of voxels with their positions, which must make sense (ValueError)."""

    labels: Annotated[NDArray[np.uint16], Shape(None, None, None, dtype=np.uint16)]
    X_LV: Annotated[NDArray[np.float64], Shape(4, 4)]
    """Transform from a voxel's indices to its centre in the patient's frame L (axes to the left, to
    the back and to the head), in m."""

    def __post_init__(self) -> None:
        super().__post_init__()
        axes = self.X_LV[:3, :3]
        steps = np.linalg.norm(axes, axis=0)
        require(
            bool(np.isfinite(self.X_LV).all() and (steps >= 1e-5).all() and (steps <= 0.02).all()),
            "voxel size",
            (1e3 * steps).tolist(),
            "from 0.01 to 20 mm along each axis; lengths in the file are in mm",
        )
        volume = abs(np.linalg.det(axes / steps))
        require(volume > 0.1, "axes", axes.round(6).tolist(), "three independent directions")
        shape = self.labels.shape
        require(min(shape) >= 2, "labels", shape, "at least 2 voxels along each axis")


def is_label_map(path: str | Path) -> bool:
    """Return True if a file's name has the suffix of a label map."""
    return str(path).lower().endswith(LABEL_MAP_SUFFIXES)


def read_label_map(path: str | Path) -> LabelMap:
    """Read a label map from NRRD or NIfTI, with any spacing and directions.

    Raises FileNotFoundError, or a ValueError with the reason if the file contains no label map.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"anatomy: there is no file {path}")
    nifti = str(path).lower().endswith((".nii", ".nii.gz"))
    with refusing_failures(path, "its data cannot be read"):
        file = open_nifti(path) if nifti else open_nrrd(path)
        require(file.count == 1, "sizes", file.shape, "those of a single label map, not a sequence")
        if not nifti:
            _require_placed(file)
        return _label_map(file.read(0), 1e-3 * file.directions, 1e-3 * file.origin)


def write_label_map(path: str | Path, label_map: LabelMap) -> Path:
    """Write a label map as NRRD in the space LPS, in mm; return the path."""
    header = {
        "space": "left-posterior-superior",
        "space directions": 1e3 * label_map.X_LV[:3, :3].T,
        "space origin": 1e3 * label_map.X_LV[:3, 3],
        "kinds": ["domain"] * 3,
    }
    labels = label_map.labels
    smallest = labels.astype(np.uint8) if labels.max() < 256 else labels
    buffer = io.BytesIO()
    nrrd.write(buffer, smallest, header, compression_level=1, index_order="F")
    return write_atomically(path, buffer.getvalue())


def _require_placed(file: VolumeFile) -> None:
    """Refuse an NRRD file that does not state how its voxels lie in a patient."""
    known = ", ".join(name for name in SPACES if "-" in name)
    space = file.fields.get("space", "lps").lower()
    require(space in SPACES, "space", space, f"one of {known}")
    require(
        not file.fields.keys().isdisjoint({"space directions", "spacings"}),
        "space directions",
        None,
        "three vectors of numbers",
    )


def _label_map(
    data: NDArray[Any],
    axes: NDArray[np.float64],
    origin: NDArray[np.float64],
) -> LabelMap:
    if data.dtype.kind == "f":
        require(bool(np.isfinite(data).all()), "labels", "NaN or infinity", "whole numbers from 0")
        require(bool((data == np.round(data)).all()), "labels", "fractions", "whole numbers from 0")
    require(data.dtype.kind in "iuf", "labels", str(data.dtype), "whole numbers from 0")
    low, high = data.min(), data.max()
    require(low >= 0 and high <= 65535, "labels", [float(low), float(high)], "from 0 to 65535")
    X_LV = np.eye(4)
    X_LV[:3, :3], X_LV[:3, 3] = axes, origin
    return LabelMap(np.asarray(data, dtype=np.uint16), X_LV)
