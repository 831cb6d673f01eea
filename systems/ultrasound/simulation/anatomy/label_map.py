"""Label maps: segmented anatomy from NRRD and NIfTI files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, read_only
from sonoservo.systems.signals.requirements import require

MAX_VOXELS = 150_000_000
"""Largest number of voxels that a file may have."""

LABEL_MAP_SUFFIXES = (".nrrd", ".nhdr", ".nii", ".nii.gz")

_SPACES = {
    "left-posterior-superior": (1, 1, 1),
    "lps": (1, 1, 1),
    "right-anterior-superior": (-1, -1, 1),
    "ras": (-1, -1, 1),
    "left-anterior-superior": (1, -1, 1),
    "las": (1, -1, 1),
}
"""Signs that turn a space's axes into LPS."""


@dataclass(frozen=True, eq=False)
class LabelMap(Immutable):
    """Labels of voxels, with their positions.

    Parameters
    ----------
    labels
        (nx, ny, nz) uint16 labels.
    X_LV
        (4, 4) transform from a voxel's indices to its centre in the patient's frame L (axes to the
        left, to the back and to the head), in m.

    Raises
    ------
    ValueError
        If the axes are not three independent directions or the voxels have no sensible size.
    """

    labels: NDArray[np.uint16]
    X_LV: NDArray[np.float64]

    def __post_init__(self) -> None:
        labels = read_only(self.labels, "labels", (None, None, None), np.uint16)
        object.__setattr__(self, "labels", labels)
        object.__setattr__(self, "X_LV", read_only(self.X_LV, "X_LV", (4, 4)))
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
        require(min(labels.shape) >= 2, "labels", labels.shape, "at least 2 voxels along each axis")


def is_label_map(path: str | Path) -> bool:
    """Return True if a file's name has the suffix of a label map."""
    return str(path).lower().endswith(LABEL_MAP_SUFFIXES)


def read_label_map(path: str | Path) -> LabelMap:
    """Read a label map from NRRD or NIfTI, with any spacing and directions.

    Parameters
    ----------
    path
        Path of a file that ends in .nrrd, .nhdr, .nii or .nii.gz.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file contains no valid label map; the message gives the reason in one line.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"anatomy: there is no file {path}")
    try:
        read = _read_nifti if str(path).lower().endswith((".nii", ".nii.gz")) else _read_nrrd
        return read(path)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def write_label_map(path: str | Path, label_map: LabelMap) -> Path:
    """Write a label map as NRRD in the space LPS, in mm.

    Returns
    -------
    Path of the file.
    """
    header = {
        "space": "left-posterior-superior",
        "space directions": 1e3 * label_map.X_LV[:3, :3].T,
        "space origin": 1e3 * label_map.X_LV[:3, 3],
        "kinds": ["domain"] * 3,
    }
    labels = label_map.labels
    smallest = labels.astype(np.uint8) if labels.max() < 256 else labels
    nrrd.write(str(path), smallest, header, compression_level=1, index_order="F")
    return Path(path)


def _read_nrrd(path: Path) -> LabelMap:
    try:
        header = nrrd.read_header(str(path))
    except (nrrd.NRRDError, OSError, UnicodeDecodeError, KeyError, IndexError) as error:
        raise ValueError(f"is no NRRD file ({' '.join(str(error).split())})") from error
    _require_shape([int(size) for size in header.get("sizes", [])])
    signs = np.array(_signs(str(header.get("space", "lps"))))
    origin = np.array(header.get("space origin", np.zeros(3)), dtype=float)
    if "space directions" in header:
        directions = np.array(header["space directions"], dtype=float)
    else:
        spacings = np.array(header.get("spacings", np.full(3, np.nan)), dtype=float)
        directions = np.diag(spacings)
    allowed = directions.shape == (3, 3) and bool(np.isfinite(directions).all())
    require(allowed, "space directions", directions.tolist(), "three vectors of numbers")
    require(
        origin.shape == (3,) and bool(np.isfinite(origin).all()),
        "space origin",
        origin.tolist(),
        "three numbers",
    )
    try:
        data = nrrd.read(str(path), index_order="F")[0]
    except (nrrd.NRRDError, OSError, ValueError, EOFError) as error:
        raise ValueError(f"its data cannot be read ({' '.join(str(error).split())})") from error
    return _label_map(data, directions.T * 1e-3, origin * 1e-3, signs)


def _read_nifti(path: Path) -> LabelMap:
    import nibabel

    try:
        image = nibabel.load(path)
        shape = list(image.shape)
        while len(shape) > 3 and shape[-1] == 1:
            shape.pop()
        _require_shape(shape)
        data = np.asanyarray(image.dataobj).reshape(shape)
    except (nibabel.filebasedimages.ImageFileError, OSError, EOFError) as error:
        raise ValueError(f"is no NIfTI file ({' '.join(str(error).split())})") from error
    affine = np.array(image.affine, dtype=float)
    return _label_map(data, affine[:3, :3] * 1e-3, affine[:3, 3] * 1e-3, np.array([-1, -1, 1]))


def _require_shape(shape: list[int]) -> None:
    require(len(shape) == 3, "sizes", shape, "those of three axes: one label a voxel")
    count = int(np.prod(np.array(shape, dtype=object)))
    require(
        count <= MAX_VOXELS,
        "sizes",
        shape,
        f"at most {MAX_VOXELS:,} voxels together; resample it to 0.5 mm or coarser, or crop it",
    )


def _signs(space: str) -> tuple[int, int, int]:
    known = ", ".join(name for name in _SPACES if "-" in name)
    require(space.lower() in _SPACES, "space", space, f"one of {known}")
    return _SPACES[space.lower()]


def _label_map(
    data: NDArray[Any],
    axes: NDArray[np.float64],
    origin: NDArray[np.float64],
    signs: NDArray[np.int64],
) -> LabelMap:
    if data.dtype.kind == "f":
        require(bool(np.isfinite(data).all()), "labels", "NaN or infinity", "whole numbers from 0")
        require(bool((data == np.round(data)).all()), "labels", "fractions", "whole numbers from 0")
    require(data.dtype.kind in "iuf", "labels", str(data.dtype), "whole numbers from 0")
    low, high = data.min(), data.max()
    require(low >= 0 and high <= 65535, "labels", [float(low), float(high)], "from 0 to 65535")
    X_LV = np.eye(4)
    X_LV[:3, :3] = signs[:, np.newaxis] * axes
    X_LV[:3, 3] = signs * origin
    return LabelMap(np.asarray(data, dtype=np.uint16), X_LV)
