"""Slices through a needle, the leaf system that keeps them, and plots of a recording."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.evaluation.reports.plots import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
)
from sonoservo.systems.files.memory import require_memory
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.writing import write_atomically
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.leaves import declare_looks, declare_memory
from sonoservo.systems.signals.needle_colours import ESTIMATE, TRUTH
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.planes import sample_plane, slice_planes
from sonoservo.systems.signals.ports import declare_inputs, evaluate
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

_PIXEL = 0.5e-3  # pixel size of a picture, in m

PLANES_CAPTION = (
    "Volumes at even intervals, cut along the estimated needle: along the beam above, across it "
    "below. Orange: the estimate, with a ring at its tip."
)
TIP_CAPTION = "The estimated tip in the file's own coordinates, and the length of needle in view."
"""Captions of `plot_planes` and `plot_tip`."""


@dataclass(frozen=True, eq=False)
class Picture:
    """Grey levels as JPEG, and their left, right, bottom and top edges in mm."""

    jpeg: bytes
    extent: tuple[float, float, float, float]

    @property
    def grey(self) -> NDArray[np.uint8]:
        """(rows, columns) grey levels from 0 to 255."""
        with Image.open(io.BytesIO(self.jpeg)) as image:
            return np.asarray(image)

    def draw(self, axes: Axes) -> None:
        """Draw the grey levels."""
        axes.imshow(self.grey, cmap="gray", vmin=0, vmax=255, extent=self.extent)
        axes.tick_params(labelsize=7)


def encode_jpeg(grey: NDArray[np.uint8]) -> bytes:
    """Return (rows, columns) grey levels as the bytes of a JPEG file."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(grey)).save(buffer, "JPEG", quality=90)
    return buffer.getvalue()


@dataclass(frozen=True, eq=False)
class PlanePicture(Picture):
    """A slice through a volume, and the needle in it; both with coordinates from its centre.

    It is drawn with coordinates from the origin of P, of which those along the beam are depths.
    """

    X_PS: RigidTransform  # pose in P of the picture's frame: X right, Y down, origin at its centre
    needle: Floats  # (m, 2) points of the estimate, in mm; none without one

    def project(self, p_P: Floats) -> Floats:
        """Return the (m, 2) coordinates in the picture, in mm, of (m, 3) points in P, in m."""
        return 1e3 * self.X_PS.inverse().multiply(p_P.T).T.reshape(-1, 3)[:, :2]

    @property
    def centre(self) -> Floats:
        """(2,) place of the centre as it is drawn, in mm."""
        return -self.project(np.zeros((1, 3)))[0]

    @property
    def down(self) -> str:
        """Name of the coordinate that runs down."""
        return "depth (mm)" if self._along_beam else "across the beam (mm)"

    @property
    def right(self) -> str:
        """Name of the coordinate that runs to the right, also from the origin of P."""
        x, _, z = np.abs(self.X_PS.rotation().matrix()[:, 0]) > 0.999
        if x or z:
            return "lateral (mm)" if x else "elevation (mm)"
        return (
            "towards the tip, square to the beam (mm)"
            if self._along_beam
            else "along the needle (mm)"
        )

    @property
    def _along_beam(self) -> bool:
        return bool(np.isclose(self.X_PS.rotation().matrix()[1, 1], 1))

    def draw(self, axes: Axes, true: Floats | None = None) -> None:
        """Draw the slice with the estimate, and with the true needle in P, in m, if it is given."""
        left, right, bottom, top = np.add(self.extent, np.repeat(self.centre, 2)).tolist()
        Picture(self.jpeg, (left, right, bottom, top)).draw(axes)
        for points, colour, mark, style, in_front in (
            (np.zeros((0, 2)) if true is None else self.project(true), TRUTH, "+", "-", 4),
            (self.needle, ESTIMATE, "o", (0, (3, 2)), 3),
        ):
            if len(points):
                x, y = (points + self.centre).T
                axes.plot(x, y, color=colour, linewidth=0.8, linestyle=style)
                axes.plot(x[-1], y[-1], mark, color=colour, markersize=9, fillstyle="none",
                          zorder=in_front)  # fmt: skip
        axes.set_xlim(left, right)
        axes.set_ylim(bottom, top)


@dataclass(frozen=True, eq=False)
class VolumePictures:
    """The two orthogonal planes through the needle in one volume (`slice_planes`)."""

    time: float
    mode: TrackingMode
    planes: list[PlanePicture]  # along the beam, then across it

    @property
    def views(self) -> tuple[str, str]:
        """Names of the slices."""
        if any(len(each.needle) for each in self.planes):
            return "along needle and beam", "along the needle, across the beam"
        return "lateral plane", "elevation plane"


def picture_planes(volume: Volume, mode: TrackingMode, curve: NeedleCurve | None) -> VolumePictures:
    """Slice a volume along the estimated needle in W, or through its middle if there is none."""
    points = np.zeros((0, 3))
    if curve is not None:
        points = volume.to_probe(curve.position(np.linspace(0, 1, _POINTS)))
    planes = []
    for plane in slice_planes(volume, curve):
        x, y = 500 * np.array([plane.width, plane.height])
        jpeg = encode_jpeg(sample_plane(volume, plane, _PIXEL))
        taken = PlanePicture(jpeg, (-x, x, y, -y), plane.X_PS, np.zeros((0, 2)))
        planes.append(replace(taken, needle=taken.project(points)))
    return VolumePictures(volume.time, mode, planes)


def plot_planes(pictures: list[VolumePictures]) -> Figure:
    """Return a figure with a column per volume: the slice along the beam above that across it."""
    columns = max(len(pictures), 1)
    rows = max([1, *(len(each.planes) for each in pictures)])
    figure = Figure(figsize=(2.6 * columns + 0.8, 2.8 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for column, pictured in enumerate(pictures):
        for empty in axes[len(pictured.planes) :, column]:
            empty.set_visible(False)
        for row, picture in enumerate(pictured.planes):
            picture.draw(axes[row, column])
            axes[row, column].set_ylabel(picture.down, fontsize=7)
        axes[0, column].set_title(f"{pictured.time:.1f} s, {pictured.mode}", fontsize=9)
    return figure


def plot_tip(
    times: Floats, estimates: list[NeedleEstimate], p_LTip: Floats, in_view: Floats
) -> Figure:
    """Return a figure of (n, 3) tips in the file's frame L and of (n,) lengths in view, in m."""
    figure = Figure(figsize=(9, 5), layout="constrained")
    tip, length = figure.subplots(2, 1, sharex=True)
    confirmed = np.array([each.mode == TrackingMode.TRACKING for each in estimates])
    for place, colour, name in zip(1e3 * p_LTip.T, (BLUE, PURPLE, GREEN), "LPS", strict=True):
        tip.plot(times, place, ".-", color=colour, linewidth=1.4, markersize=4, label=name)
        unsure = np.where(confirmed, np.nan, place)
        tip.plot(times, unsure, "o", color=colour, markersize=4, fillstyle="none")
    tip.set_title("Estimated tip in the file's coordinates (circles: not confirmed)", loc="left")
    length.plot(times, 1e3 * in_view, ".-", color=ORANGE, linewidth=1.4, markersize=4)
    margin = 0.02 * (np.ptp(times) or 1.0)
    length.set_xlim(times[0] - margin, times[-1] + margin)
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
        pictures = np.split(kept["jpeg"], np.cumsum(lengths)[:-1]) if len(lengths) else []
        rest = kept["X_PS"], kept["extent"], kept["needle"]
        planes = iter([_plane(jpeg.tobytes(), *each) for jpeg, *each in
                       zip(pictures, *rest, strict=True)])  # fmt: skip
        if counts.sum() != len(pictures) or not np.isfinite(kept["time"]).all():
            raise ConfigurationError(f"{path} is damaged: volumes and slices do not match")
        return [
            VolumePictures(time, TrackingMode(mode), [next(planes) for _ in range(count)])
            for time, mode, count in zip(
                kept["time"].tolist(), kept["mode"].tolist(), counts, strict=True
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
    return PlanePicture(jpeg, (left, right, bottom, top), pose, shown)


_MOST = 400  # number of pictures above which every second one is dropped


class PictureRecorder(LeafSystem):
    """Keeps the two slices through the estimated needle of every new volume.

    .. pydrake_system::

        name: PictureRecorder
        input_ports:
        - volume
        - estimate

    A volume's pictures take 20 KB and 3 ms. Beyond 400, every other one of the older is dropped.

    Parameters
    ----------
    period, offset
        Period of the checks for a new volume and time of the first one, in s.
    """

    def __init__(self, *, period: float, offset: float = 0.0) -> None:
        super().__init__()
        declare_inputs(self, volume=(Volume, NotFound), estimate=NeedleEstimate)
        self._pictures = declare_memory(self, list[VolumePictures])
        declare_looks(
            self, self._look, period=period, offset=offset,
            start=lambda context: self.pictures(context).clear(),
        )  # fmt: skip

    def pictures(self, context: Context) -> list[VolumePictures]:
        """Return the pictures so far, in order of time."""
        return self._pictures(context)

    def _look(self, context: Context) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        estimate = evaluate(self, context, "estimate", NeedleEstimate)
        kept = self.pictures(context)
        if not isinstance(volume, Volume) or (kept and volume.time <= kept[-1].time):
            return
        kept.append(picture_planes(volume, estimate.mode, estimate.curve))
        if len(kept) > _MOST:
            del kept[1 : _MOST // 2 : 2]
