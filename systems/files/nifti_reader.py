"""Reader of volumes from NIfTI files (``.nii``, ``.nii.gz``), as of ITK, FSL and 3D Slicer."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.volume_file import (
    MAX_DEFLATED,
    MILLIMETRES,
    SECONDS,
    VolumeFile,
    check_layout,
    require_voxels,
)


def open_nifti(path: Path, *, frames: bool = False) -> VolumeFile:
    """Open a NIfTI file with one volume, or with a sequence of them along a further axis."""
    import nibabel  # late, as it takes a while

    with refusing_failures(path, "it is no NIfTI file"):
        image: Any = nibabel.load(path)
        header, sizes = image.header, image.shape
        # As ANTs writes a sequence, the fifth axis counts volumes, and the fourth is one long.
        numbered = [axis for axis in range(3, len(sizes)) if sizes[axis] != 1]
        if len(sizes) < 3 or len(numbered) > 1:
            raise ConfigurationError(
                f"{path}: dim: {[*sizes]} is not allowed; a volume has 3 axes, a sequence 4"
            )
        length, duration = header.get_xyzt_units()
        unit = "" if length == "unknown" else length
        if unit not in MILLIMETRES:
            raise ConfigurationError(f"{path}: xyzt_units: {length!r} is not allowed")
        ras = np.array([-1.0, -1.0, 1.0]) * MILLIMETRES[unit]
        affine, unplaced = _affine(header)
        directions, origin = ras[:, np.newaxis] * affine[:3, :3], ras * affine[:3, 3]
        shape, count = tuple(sizes[:3]), sizes[numbered[0]] if numbered else 1
        check_layout(path, shape, count, directions, frames=frames)
        require_voxels(path, shape)  # before any voxel is looked for
        dtype = image.get_data_dtype()
        if dtype.kind == "c":
            raise ConfigurationError(f"{path}: datatype: complex numbers are no grey levels")
        size = math.prod(sizes) * dtype.itemsize
        present = path.stat().st_size * (MAX_DEFLATED if path.suffix.lower() == ".gz" else 1)
        if size > present:
            raise ConfigurationError(f"{path}: it is cut off: {size} bytes of voxels are announced")
        step = float(header.get_zooms()[numbered[0]]) if numbered else 0.0
        times = None
        if duration in SECONDS and step > 0:
            times = SECONDS[duration] * (float(header["toffset"]) + step * np.arange(count))
        untimed = []
        if numbered and duration not in SECONDS:
            untimed.append(f"its unit of time (xyzt_units) is {duration!r}")
        if numbered and not step > 0:
            untimed.append(f"its step of time (pixdim[{numbered[0] + 1}]) is {step:g}")

    colours = dtype.names or ()

    def read(number: int) -> NDArray[Any]:
        with refusing_failures(path, "its voxels cannot be read"):
            rest = [number if axis in numbered else 0 for axis in range(3, len(sizes))]
            voxels = np.asarray(image.dataobj[(..., *rest)]).reshape(shape)
        return np.stack([voxels[each] for each in colours], axis=-1) if colours else voxels

    unmeasured = ["it states no unit of length; mm are taken"] if length == "unknown" else []
    return VolumeFile(
        path, shape, count, directions, origin, read, times,
        notes=(*unmeasured, *unplaced, *untimed), channels=max(len(colours), 1),
    )  # fmt: skip


def _affine(header: Any) -> tuple[NDArray[np.float64], list[str]]:
    """Return the matrix from voxels to RAS, and what is said of one that had to be chosen."""
    sform, qform = header.get_sform(coded=True)[0], header.get_qform(coded=True)[0]
    if sform is None and qform is None:  # as ITK takes it; nibabel would turn and centre it
        said = "its first voxel is taken to lie at 0, and its axes to be LPS"
        lps = np.diag([*header.get_zooms()[:3], 1.0]).astype(float)
        return np.diag([-1.0, -1.0, 1.0, 1.0]) @ lps, [
            f"it states no position (sform, qform); {said}"
        ]
    if sform is not None and qform is not None and not np.allclose(sform, qform, atol=1e-3):
        return sform, ["its sform and its qform differ; the sform is taken"]
    return (qform if sform is None else sform), []
