"""Plots of a needle tracked through a recording."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.files.memory import require_memory
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.writing import write_atomically
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.planes import sample_plane, slice_planes
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

_PIXEL = 0.5e-3  # pixel size of a picture, in m

_NEEDLE = "#D55E00"
_COLOURS = ("#0072B2", "#CC79A7", "#009E73")

PLANES_CAPTION = (
    "Volumes at even intervals, cut along the estimated needle: along the beam above, across it "
    "below. Orange: the estimate, with a ring at its tip."
)
TIP_CAPTION = "The estimated tip in the file's own coordinates, and the length of needle in view."
"""Captions of `plot_planes` and `plot_tip`."""


@dataclass(frozen=True, eq=False)
class PlanePicture:
    """A slice through a volume as JPEG, and the needle in it."""

    jpeg: bytes
    X_PS: RigidTransform  # pose in P of the picture's frame: X right, Y down, origin at its centre
    extent: tuple[float, float, float, float]  # left, right, bottom, top in mm from its centre
    needle: Floats  # (m, 2) points of the estimate, in mm; none without one

    @property
    def grey(self) -> NDArray[np.uint8]:
        """(rows, columns) grey levels from 0 to 255."""
        with Image.open(io.BytesIO(self.jpeg)) as image:
            return np.asarray(image)

    def project(self, p_P: Floats) -> Floats:
        """Return the (m, 2) coordinates in the picture, in mm, of (m, 3) points in P, in m."""
        return 1e3 * self.X_PS.inverse().multiply(p_P.T).T.reshape(-1, 3)[:, :2]


@dataclass(frozen=True, eq=False)
class VolumePictures:
    """The two orthogonal planes through the needle in one volume (`slice_planes`)."""

    time: float
    mode: TrackingMode
    planes: list[PlanePicture]  # along the beam, then across it


def picture_planes(volume: Volume, mode: TrackingMode, curve: NeedleCurve | None) -> VolumePictures:
    """Slice a volume along the estimated needle in W, or through its middle if there is none."""
    points = np.zeros((0, 3))
    if curve is not None:
        points = volume.to_probe(curve.position(np.linspace(0, 1, 21)))
    planes = []
    for plane in slice_planes(volume, curve):
        half = 500 * np.array([plane.width, plane.height])
        extent = (-half[0], half[0], half[1], -half[1])
        buffer = io.BytesIO()
        grey = sample_plane(volume, plane, _PIXEL)
        Image.fromarray(grey).save(buffer, "JPEG", quality=90)
        taken = PlanePicture(buffer.getvalue(), plane.X_PS, extent, np.zeros((0, 2)))
        planes.append(replace(taken, needle=taken.project(points)))
    return VolumePictures(volume.time, mode, planes)


def plot_planes(pictures: list[VolumePictures]) -> Figure:
    """Return a figure with a column per volume: the slice along the beam above that across it."""
    columns = max(len(pictures), 1)
    figure = Figure(figsize=(2.6 * columns + 0.8, 5.6), layout="constrained")
    axes = figure.subplots(2, columns, squeeze=False)
    for column, pictured in enumerate(pictures):
        for row, picture in enumerate(pictured.planes):
            each = axes[row, column]
            each.imshow(picture.grey, cmap="gray", vmin=0, vmax=255, extent=picture.extent)
            if len(picture.needle):
                each.plot(*picture.needle.T, color=_NEEDLE, linewidth=1, linestyle=(0, (3, 2)))
                each.plot(
                    *picture.needle[-1], marker="o", markersize=5, color=_NEEDLE, fillstyle="none"
                )
            each.set_xlim(picture.extent[:2])
            each.set_ylim(picture.extent[2:])
            each.tick_params(labelsize=7)
        axes[0, column].set_title(f"{pictured.time:.1f} s, {pictured.mode}", fontsize=9)
    for row, name in enumerate(("along the beam, mm", "across the beam, mm")):
        axes[row, 0].set_ylabel(name, fontsize=9)
    return figure


def plot_tip(
    times: Floats, estimates: list[NeedleEstimate], p_LTip: Floats, in_view: Floats
) -> Figure:
    """Return a figure of (n, 3) tips in the file's frame L and of (n,) lengths in view, in m."""
    figure = Figure(figsize=(9, 5), layout="constrained")
    tip, length = figure.subplots(2, 1, sharex=True)
    confirmed = np.array([each.mode == TrackingMode.TRACKING for each in estimates])
    for axis, colour, name in zip(range(3), _COLOURS, "LPS", strict=True):
        tip.plot(times, 1e3 * p_LTip[:, axis], color=colour, linewidth=1.4, label=name)
        unsure = np.where(confirmed, np.nan, 1e3 * p_LTip[:, axis])
        tip.plot(times, unsure, "o", color=colour, markersize=4, fillstyle="none")
    tip.set_title("Estimated tip in the file's coordinates (circles: not confirmed)", loc="left")
    length.plot(times, 1e3 * in_view, color=_NEEDLE, linewidth=1.4)
    length.set_title("Length in view", loc="left")
    for each in (tip, length):
        each.set_ylabel("mm")
        each.grid(alpha=0.3)
    tip.legend(frameon=False, ncols=3)
    length.set_xlabel("time (s)")
    return figure


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
