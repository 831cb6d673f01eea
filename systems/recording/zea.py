"""Reader and writer of volumes in the HDF5 files of zea, a toolbox for cognitive ultrasound."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures, require_extra
from sonoservo.systems.files.volume_file import SCALE, VolumeFile, check_layout, require_frames
from sonoservo.systems.files.writing import Closing
from sonoservo.systems.recording.valid_frames import matrix_text
from sonoservo.systems.signals.volume import Volume

SUFFIXES = (".hdf5", ".h5")

_MAPS = ("image_sc", "image")
_FARTHEST = 10.0  # Largest place of the probe along an axis, in m; no tracker sees farther
_RAW = ("raw_data", "aligned_data", "beamformed_data", "envelope_data")
# Order of the places of the first and last pixels, in m; z is the depth, y the elevation.
_EXTENT = ("xmin", "xmax", "ymin", "ymax", "zmax", "zmin")
_LAYOUT = (
    f"volumes are data/image/pixels (n, x, z, y), and data/image/extent in m: {', '.join(_EXTENT)}"
)


def open_zea(path: Path, *, frames: bool = False) -> VolumeFile:
    """Open the log-compressed images of a file of zea: ``data/image_sc`` or ``data/image``."""
    h5py = require_extra("h5py", "hdf5", path)
    with refusing_failures(path, "it is no file of zea"):
        file = h5py.File(path, "r")
        pixels, extent = _pixels(path, file["data"])
        count, nx, nz = pixels.shape[:3]
        flat = pixels.ndim == 3
        if flat:
            require_frames(path, frames, f"{count} images")
        shape = (nx, nz, 1 if flat else pixels.shape[3])
        steps, origin, notes = np.ones(3), np.zeros(3), []
        if extent is None:
            notes.append("it states no extent; pixels of 1 mm are taken, the first of them at 0")
        else:
            place = dict(
                zip(_EXTENT, 1e3 * np.asarray(extent, float).reshape(-1, 6)[0], strict=True)
            )
            for axis in "xz" if flat else "xyz":
                least, most = (1e-3 * place[f"{axis}{end}"] for end in ("min", "max"))
                if not most > least:
                    raise ConfigurationError(
                        f"{path}: extent: {axis}max, {most:g} m, is not above {axis}min, {least:g} "
                        f"m; its numbers are {', '.join(_EXTENT)}"
                    )
            low = np.array([place["xmin"], place["zmin"], 0.0 if flat else place["ymin"]])
            high = np.array([place["xmax"], place["zmax"], 1.0 if flat else place["ymax"]])
            steps = (high - low) / np.maximum(np.array(shape) - 1, 1)
            origin = low
        check_layout(path, shape, count, np.diag(steps), frames=frames)
        fields, times = _poses(path, file, count)

    def read(number: int) -> NDArray[Any]:
        return np.asarray(pixels[number]).reshape(shape)

    return VolumeFile(path, shape, count, np.diag(steps), origin, read, times, fields, tuple(notes))


def _pixels(path: Path, data: Any) -> tuple[Any, Any]:
    for name in _MAPS:
        if name not in data:
            continue
        found = data[name]
        if hasattr(found, "shape"):  # older files hold (n, z, x) without an extent
            if found.ndim != 3:
                raise ConfigurationError(
                    f"{path}: data/{name}: {found.shape} is not (n, z, x); {_LAYOUT}"
                )
            return _Turned(found), None
        pixels = found["pixels"] if "pixels" in found else found["values"]
        if pixels.ndim not in (3, 4):
            raise ConfigurationError(
                f"{path}: data/{name}: {pixels.shape} is not (n, x, z, y); {_LAYOUT}"
            )
        return pixels, found["extent"][()] if "extent" in found else None
    held = [name for name in _RAW if name in data]
    what = f"it holds {', '.join(held)}" if held else "it holds none"
    raise ConfigurationError(f"{path}: log-compressed images are needed (image_sc, image); {what}")


class _Turned:
    """Images (n, z, x) as (n, x, z)."""

    def __init__(self, data: Any) -> None:
        self._data = data
        self.shape = (data.shape[0], data.shape[2], data.shape[1])
        self.ndim = 3

    def __getitem__(self, number: int) -> NDArray[Any]:
        return np.asarray(self._data[number]).T


def _samples(path: Path, metadata: Any, name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return numbers of the metadata, of which each image has one, or an array."""
    samples = np.asarray(metadata[name]["samples"][()], float)
    if samples.size != math.prod(shape):
        raise ConfigurationError(
            f"{path}: metadata/{name}/samples: their shape is {samples.shape}; expected {shape}, "
            "with one for each image"
        )
    return samples.reshape(shape)


def _poses(path: Path, file: Any, count: int) -> tuple[dict[str, str], NDArray[np.float64] | None]:
    """Return the fields of the volumes' poses, and the times, if there are any."""
    metadata = file.get("metadata", {})
    fields: dict[str, str] = {}
    times = None
    if "volume_time" in metadata:
        start = metadata["volume_time"].attrs.get("start", 0.0)
        times = float(start) + _samples(path, metadata, "volume_time", (count,))
    if "probe_pose" in metadata:
        matrices = _samples(path, metadata, "probe_pose", (count, 4, 4))
        for k, matrix in enumerate(matrices):
            if np.abs(matrix[:3, 3]).max() > _FARTHEST:
                raise ConfigurationError(
                    f"{path}: metadata/probe_pose/samples: the place of volume {k}, "
                    f"{matrix[:3, 3].tolist()} m, is out of range (+-{_FARTHEST:g} m); is it in mm?"
                )
            matrix[:3, 3] *= 1e3
            fields[f"Seq_Frame{k:04d}_ProbeToReferenceTransform"] = matrix_text(matrix)
    if SCALE in file.attrs:
        fields[SCALE] = repr(float(file.attrs[SCALE]))
    return fields, times


class ZeaWriter(Closing):
    """Writes volumes one by one as a file of zea, with times in s, and poses in m."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() not in SUFFIXES:
            raise ValueError(f"record: {self.path} is not allowed; it must end in .hdf5 or .h5")
        self._h5py = require_extra("h5py", "hdf5", path)
        self._file: Any = None
        self._grid: tuple[Any, ...] = ()

    def append(self, volume: Volume, mask: NDArray[np.bool_] | None = None) -> None:
        """Write a volume on the first one's grid, and perhaps the mask of the needle in it."""
        grid = (volume.intensities.shape, *volume.origin, *volume.spacing, mask is None)
        if self._file is None:
            self._begin(volume, mask)
            self._grid = grid
        if grid != self._grid:
            raise ValueError("volume: its grid is not that of the first one")
        grey = np.rint(volume.intensities).astype(np.uint8)
        self._add("data/image_sc/pixels", grey)
        if mask is not None:
            self._add("data/segmentation/pixels", mask[..., np.newaxis])
        self._add("metadata/volume_time/samples", np.float32(volume.time - self._start))
        self._add("metadata/probe_pose/samples", volume.X_WP.GetAsMatrix4().astype(np.float32))

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _begin(self, volume: Volume, mask: NDArray[np.bool_] | None) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = file = self._h5py.File(self.path, "w")
        file.attrs.update({
            "probe_name": "motorised 3D probe",
            "us_machine": "sonoservo",
            "description": "volumes; x along the array, z depth, y sweep",
            SCALE: volume.decibels_per_level,
        })  # fmt: skip
        low, high = volume.origin, volume.upper
        extent = np.array([low[0], high[0], low[2], high[2], high[1], low[1]], np.float32)
        shape = volume.intensities.shape
        maps: dict[str, tuple[Any, tuple[int, ...]]] = {"image_sc": (np.uint8, shape)}
        if mask is not None:
            maps["segmentation"] = (np.bool_, (*shape, 1))
        for name, (dtype, size) in maps.items():
            group = file.create_group(f"data/{name}")
            group["extent"] = extent
            group.create_dataset(
                "pixels", (0, *size), dtype, maxshape=(None, *size), chunks=(1, *size),
                compression="gzip", compression_opts=1,
            )  # fmt: skip
        if mask is not None:
            file["data/segmentation/labels"] = ["needle"]
        self._start = volume.time
        for name, size in (("volume_time", ()), ("probe_pose", (4, 4))):
            group = file.create_group(f"metadata/{name}")
            group.create_dataset(
                "samples", (0, *size), np.float32, maxshape=(None, *size), chunks=(64, *size)
            )
            group["offset"], group["sampling_frequency"] = np.float32(0), np.float32(0)
        file["metadata/volume_time"].attrs["start"] = volume.time

    def _add(self, name: str, value: Any) -> None:
        data = self._file[name]
        data.resize(len(data) + 1, axis=0)
        data[-1] = value
