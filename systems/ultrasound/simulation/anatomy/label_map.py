"""Label maps: segmented anatomy from NRRD and NIfTI files."""

import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import nrrd
import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.nrrd_reader import SPACES, open_nrrd
from sonoservo.systems.files.refusals import refusing_failures
from sonoservo.systems.files.volume_file import MAX_DEFLATED, check_layout, require_voxels
from sonoservo.systems.files.writing import write_atomically
from sonoservo.systems.signals.immutable import Immutable, Shape
from sonoservo.systems.signals.requirements import require

LABEL_MAP_SUFFIXES = (".nrrd", ".nhdr", ".nii", ".nii.gz")

_METRES = {"unknown": 1e-3, "meter": 1.0, "mm": 1e-3, "micron": 1e-6}
"""Length in m of the units that NIfTI has; "unknown" is mm by custom."""


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
        return _read_nifti(path) if nifti else _read_nrrd(path)


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


def _read_nrrd(path: Path) -> LabelMap:
    file = open_nrrd(path)
    require(file.count == 1, "sizes", file.shape, "those of a single label map, not a sequence")
    known = ", ".join(name for name in SPACES if "-" in name)
    space = file.fields.get("space", "lps").lower()
    require(space in SPACES, "space", space, f"one of {known}")
    require(
        not file.fields.keys().isdisjoint({"space directions", "spacings"}),
        "space directions",
        None,
        "three vectors of numbers",
    )
    return _label_map(file.read(0), 1e-3 * file.directions, 1e-3 * file.origin)


def _read_nifti(path: Path) -> LabelMap:
    import nibabel

    with refusing_failures(path, "is no NIfTI file"):
        image = nibabel.load(path)
        shape = list(image.shape)
        while len(shape) > 3 and shape[-1] == 1:
            shape.pop()
        require(len(shape) == 3, "sizes", shape, "those of three axes: one label a voxel")
        check_layout(path, tuple(shape), 1, np.array(image.affine, float)[:3, :3])
        require_voxels(path, shape)
        _require_present(path, math.prod(shape) * image.get_data_dtype().itemsize)
        data = np.asanyarray(image.dataobj).reshape(shape)
    unit = image.header.get_xyzt_units()[0]
    require(unit in _METRES, "xyzt_units", unit, f"one of {', '.join(_METRES)}")
    affine = np.array(image.affine, dtype=float)
    scale = _METRES[unit] * np.array(SPACES["ras"], float)
    return _label_map(data, scale[:, np.newaxis] * affine[:3, :3], scale * affine[:3, 3])


def _require_present(path: Path, size: int) -> None:
    """Refuse a file that is too small for the data that its header announces."""
    packed = path.suffix.lower() == ".gz"
    present = path.stat().st_size * (MAX_DEFLATED if packed else 1)
    require(size <= present, "header", size, f"that of at most {present} bytes of voxels")


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
