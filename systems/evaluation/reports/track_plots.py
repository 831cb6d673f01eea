"""Plots of a needle tracked through a recording."""

import io
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from pydrake.math import RigidTransform

from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.planes import sample_plane, slice_planes
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

_PIXEL = 0.5e-3
"""Pixel size of a picture, in m."""

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
    """A slice through a volume, and the needle in it.

    `jpeg`: grey levels, coded as JPEG, because a run keeps the pictures of all its volumes; `X_PS`:
    pose of the picture's frame S in P: X to the right, Y down, origin at the centre; `extent`:
    left, right, bottom and top edges of the picture, in mm from its centre; `needle`: (m, 2) points
    of the estimated needle in the same coordinates; none without an estimate.
    """

    jpeg: bytes
    X_PS: RigidTransform
    extent: tuple[float, float, float, float]
    needle: Floats

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
    """The two orthogonal planes through the needle in one volume (`slice_planes`).

    `time`: time of the volume, in s; `mode`: tracking mode after the volume; `planes`: slice along
    the beam, then the slice across it.
    """

    time: float
    mode: TrackingMode
    planes: list[PlanePicture]


def picture_planes(volume: Volume, mode: TrackingMode, curve: NeedleCurve | None) -> VolumePictures:
    """Slice a volume along the needle, or through its middle if there is none.

    Parameters
    ----------
    volume
        Volume to slice.
    mode
        Tracking mode after the volume.
    curve
        Estimated needle in W.
    """
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
    """Return a figure of the estimated tip and of the needle's length over (n,) times in s.

    The (n, 3) tips are in the file's frame L (LPS) and the (n,) lengths those that the volumes
    show, both in m; NaN without an estimate.
    """
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
