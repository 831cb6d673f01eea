"""Files of a run's pictures: the slices through the estimated needle of every volume."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.evaluation.reports.track_plots import PlanePicture, VolumePictures
from sonoservo.systems.files.memory import require_memory
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.writing import write_atomically
from sonoservo.systems.signals.needle_estimate import TrackingMode

_FORMAT = 1
_POINTS = 21  # number of points of a needle in a picture


def write_pictures(path: str | Path, pictures: Sequence[VolumePictures]) -> Path:
    """Write the pictures of a run to one `.npz` file, atomically; see `read_pictures`."""
    planes = [plane for each in pictures for plane in each.planes]
    needles = np.full((len(planes), _POINTS, 2), np.nan)
    for needle, plane in zip(needles, planes, strict=True):
        if len(plane.needle):
            needle[:] = plane.needle
    buffer = io.BytesIO()
    np.savez(
        buffer,
        format=np.array(_FORMAT),
        time=np.array([each.time for each in pictures], float),
        mode=np.array([str(each.mode) for each in pictures], str),
        planes=np.array([len(each.planes) for each in pictures], int),
        X_PS=np.array([plane.X_PS.GetAsMatrix4() for plane in planes]).reshape(-1, 4, 4),
        extent=np.array([plane.extent for plane in planes], float).reshape(-1, 4),
        needle=needles,
        length=np.array([len(plane.jpeg) for plane in planes], int),
        jpeg=np.frombuffer(b"".join(plane.jpeg for plane in planes), np.uint8),
    )
    return write_atomically(path, buffer.getvalue())


def read_pictures(path: str | Path) -> list[VolumePictures]:
    """Read the pictures of a run that `write_pictures` wrote."""
    path = Path(path)
    with refusing_failures(path, "not pictures of a run, or damaged"):
        require_memory(2 * path.stat().st_size, str(path), "its pictures")
        with np.load(path, allow_pickle=False) as file:
            kept = {name: file[name] for name in file.files}
        if kept.get("format", np.array(None)).tolist() != _FORMAT:
            raise ConfigurationError(f"{path} is of another version, or has no pictures of a run")
        counts, lengths = kept["planes"], kept["length"]
        if (counts < 0).any() or (lengths < 0).any() or lengths.sum() != len(kept["jpeg"]):
            raise ConfigurationError(f"{path} is damaged: its pictures are not as long as it says")
        ends = np.cumsum(lengths)
        planes = [
            _plane(kept["jpeg"][end - length : end].tobytes(), *rest)
            for end, length, *rest in zip(
                ends, lengths, kept["X_PS"], kept["extent"], kept["needle"], strict=True
            )
        ]
        last = np.cumsum(counts)
        if last[-1:].sum() != len(planes) or not np.isfinite(kept["time"]).all():
            raise ConfigurationError(f"{path} is damaged: volumes and slices do not match")
        return [
            VolumePictures(float(time), TrackingMode(mode), planes[end - count : end])
            for time, mode, count, end in zip(
                kept["time"], kept["mode"].tolist(), counts, last, strict=True
            )
        ]


def _plane(jpeg: bytes, X_PS: np.ndarray, extent: np.ndarray, needle: np.ndarray) -> PlanePicture:
    with Image.open(io.BytesIO(jpeg)) as image:
        image.verify()
    pose = RigidTransform(RotationMatrix(X_PS[:3, :3]), X_PS[:3, 3])
    if not (pose.rotation().IsValid() and np.isfinite(X_PS).all()):
        raise ValueError(f"{X_PS.tolist()} is no pose of a slice")
    left, right, bottom, top = extent.tolist()
    if not (left < right and top < bottom):
        raise ValueError(f"the extent {extent.tolist()} of a slice is empty")
    shown = needle if np.isfinite(needle).all() else np.zeros((0, 2))
    return PlanePicture(jpeg, pose, (left, right, bottom, top), shown)
