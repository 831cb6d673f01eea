"""Reader of DICOM multi-frame ultrasound: 2D frames, with a table of their poses beside them."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.memory import require_memory
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures, require_extra
from sonoservo.systems.files.volume_file import VolumeFile, check_layout, require_frames
from sonoservo.systems.recording.grey_levels import as_frame, most_channels
from sonoservo.systems.recording.pose_table import read_pose_table

_2D = _TISSUE = 1
_CENTIMETRES = 3  # Codes of a flat region, of tissue in it, and of centimetres as its unit
FIRST_PIXEL = "FirstPixel"
"""Name of the field with the place in the whole picture of a frame's first pixel."""

_VOLUMES = "1.2.840.10008.5.1.4.1.1.6.2"  # Enhanced US Volume Storage


def open_dicom(path: Path, *, frames: bool = False) -> VolumeFile:
    """Open a DICOM file of 2D ultrasound frames, with their poses in ``NAME.csv`` beside it."""
    pydicom = require_extra("pydicom", "dicom", path)
    pixels = require_extra("pydicom.pixels", "dicom", path)
    with refusing_failures(path, "it is no DICOM file"):
        data = pydicom.dcmread(path, stop_before_pixels=True)
        count, rows, columns = (
            int(data.get(name, default))
            for name, default in (("NumberOfFrames", 1), ("Rows", 0), ("Columns", 0))
        )
    if data.get("SOPClassUID", "") == _VOLUMES:
        raise ConfigurationError(
            f"{path}: volumes of DICOM (Enhanced US Volume) are not supported; save them as NRRD, "
            "with 3D Slicer for instance"
        )
    size = rows * columns * int(data.get("SamplesPerPixel", 1)) * int(data.get("BitsAllocated", 8))
    require_memory(size // 8, str(path), f"{rows} x {columns} pixels")
    if data.get("PhotometricInterpretation", "") == "PALETTE COLOR":
        raise ConfigurationError(f"{path}: PhotometricInterpretation: palettes are not supported")
    require_frames(path, frames, f"{count} frames of DICOM")
    fields, notes = read_pose_table(path.with_suffix(".csv"), [str(k) for k in range(count)])
    left, top, right, bottom, spacing, note = _region(data, columns, rows)
    fields[FIRST_PIXEL] = f"{left} {top}"
    slope, shift = (
        float(data.get(f"Rescale{name}", default))
        for name, default in (("Slope", 1), ("Intercept", 0))
    )
    inverted = data.get("PhotometricInterpretation", "") == "MONOCHROME1"
    most = 2 ** int(data.get("BitsStored", 8)) - 1

    def numbers(number: int) -> NDArray[Any]:
        with refusing_failures(path, f"frame {number}"):
            frame = pixels.pixel_array(path, index=number)
        frame = np.swapaxes(frame, 0, 1)[left:right, top:bottom]
        if inverted:
            frame = (most - frame.astype(np.int64)).astype(frame.dtype)
        return frame if (slope, shift) == (1.0, 0.0) else frame * slope + shift

    shape, channels = (right - left, bottom - top, 1), most_channels(numbers, count)
    check_layout(path, shape, count, np.eye(3), frames=True)

    def read(number: int) -> NDArray[Any]:
        return as_frame(numbers(number), channels, f"{path}: frame {number}")

    padding = data.get("PixelPaddingValue", None)
    directions = np.diag([*spacing, 1.0])
    return VolumeFile(
        path, shape, count, directions, np.zeros(3), read, _times(data, count), fields,
        (*notes, *([note] if note else [])), channels, None if padding is None else float(padding),
    )  # fmt: skip


def _region(
    data: Any, columns: int, rows: int
) -> tuple[int, int, int, int, tuple[float, float], str]:
    """Return the ends of the region of tissue in pixels, their size in mm, and a note."""
    for region in data.get("SequenceOfUltrasoundRegions", []):
        tissue = (
            int(region.get("RegionSpatialFormat", 0)) == _2D
            and int(region.get("RegionDataType", _TISSUE)) == _TISSUE
        )
        units = {int(region.get(f"PhysicalUnits{axis}Direction", 0)) for axis in "XY"}
        if tissue and units == {_CENTIMETRES}:
            corners = [
                int(region.get(f"RegionLocation{name}", default))
                for name, default in (
                    ("MinX0", 0), ("MinY0", 0), ("MaxX1", columns - 1), ("MaxY1", rows - 1)
                )
            ]  # fmt: skip
            left, top, right, bottom = corners
            right, bottom = min(right + 1, columns), min(bottom + 1, rows)
            spacing = tuple(10 * abs(float(region[f"PhysicalDelta{axis}"].value)) for axis in "XY")
            size = f"{right - left} x {bottom - top}"
            note = (
                f"its frames are cut to the region of tissue, {size} pixels from {left}, {top} on; "
                "a calibration counts from the first pixel of the whole picture"
            )
            return left, top, right, bottom, (spacing[0], spacing[1]), note
    if "PixelSpacing" in data:  # between rows, and between columns
        down, across = (float(each) for each in data.PixelSpacing)
        return 0, 0, columns, rows, (across, down), ""
    return 0, 0, columns, rows, (1.0, 1.0), "it does not state the size of its pixels"


def _times(data: Any, count: int) -> NDArray[np.float64] | None:
    if "FrameTimeVector" in data:
        steps = np.atleast_1d(np.array(data.FrameTimeVector, float))
        return np.asarray(1e-3 * np.cumsum(steps)) if len(steps) == count else None
    if "FrameTime" in data:
        return np.asarray(1e-3 * float(data.FrameTime) * np.arange(count), np.float64)
    rate = float(data.get("CineRate", 0) or data.get("RecommendedDisplayFrameRate", 0) or 0)
    return np.asarray(np.arange(count) / rate, np.float64) if rate > 0 else None
