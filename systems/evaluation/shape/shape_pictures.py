"""Pictures of the slices of a run in which a needle's shape is predicted, and its movie."""

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from sonoservo.systems.evaluation.reports.key_frames import ESTIMATE, TRUTH
from sonoservo.systems.evaluation.shape.shape_metrics import (
    ShapeLog,
    cross_section_errors,
    plane_of,
)
from sonoservo.systems.signals.confidence import RADIUS_95
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.needle_shape import NeedleShape

Floats = NDArray[np.float64]

_HALF = 10e-3  # half of a picture's width and height, in m


@dataclass(frozen=True, eq=False)
class SlicePicture:
    """Part of a slice around the needle, as JPEG."""

    depth: float  # in m
    jpeg: bytes
    extent: tuple[float, float, float, float]  # left, right, bottom, top in P, in mm


def picture_slice(image: ImageSlice, depth: float, middle: Floats) -> SlicePicture:
    """Return a picture of a slice around a point."""
    low, high = (
        np.clip(
            np.rint((middle + side - image.origin) / image.spacing).astype(int),
            0,
            np.array(image.intensities.shape) - 1,
        )
        for side in (-_HALF, _HALF)
    )
    grey = image.intensities[low[0] : high[0] + 1, low[1] : high[1] + 1].T
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(grey)).save(buffer, "JPEG", quality=90)
    (left, top), (right, bottom) = (
        1e3 * (image.position(each) + shift * image.spacing)
        for each, shift in ((low, -0.5), (high, 0.5))
    )
    return SlicePicture(depth, buffer.getvalue(), (left, right, bottom, top))


def plot_key_slices(log: ShapeLog, pictures: Sequence[SlicePicture]) -> dict[str, Figure]:
    """Return a figure of four telling slices, by its caption; none without pictures."""
    errors = cross_section_errors(log)
    found = np.flatnonzero(np.isfinite(errors))
    if not pictures or not len(found):
        return {}
    shown = {
        int(found[0]): "first one found",
        int(found[len(found) // 2]): "half way",
        int(np.nanargmax(errors)): f"largest error, {1e3 * np.nanmax(errors):.2f} mm",
        int(found[-1]): "last one found",
    }
    figure = Figure(figsize=(2.75 * len(shown), 3.2), layout="constrained")
    for axes, row in zip(figure.subplots(1, len(shown), squeeze=False)[0], sorted(shown)):  # noqa: B905
        _draw(axes, log, row, pictures)
        axes.set_title(f"{1e3 * log.depth[row]:.0f} mm: {shown[row]}", loc="left", fontsize=9)
    caption = (
        "Slices across the needle, in the probe's frame, mm. Orange ring: the cross-section that "
        "was found; blue cross: the true one."
    )
    return {caption: figure}


def shape_movie_frames(
    log: ShapeLog, pictures: Sequence[SlicePicture], shape: object
) -> Iterator[NDArray[np.uint8]]:
    """Yield a picture of each slice beside the needle's path, measured, true and predicted."""
    figure = Figure(figsize=(9.6, 4.2))
    canvas = FigureCanvasAgg(figure)
    grid = figure.add_gridspec(1, 2, width_ratios=(1, 1.7), left=0.06, right=0.98, bottom=0.13)
    slices, path = (figure.add_subplot(each) for each in grid)
    plane, depth = plane_of(log.true), 1e3 * log.depth
    origin = log.true[0, :2] @ plane
    path.plot(depth, 1e3 * (log.true[:, :2] @ plane - origin), color=TRUTH, label="true")
    if isinstance(shape, NeedleShape):
        mean, covariance = shape.predict(log.depth)
        middle = 1e3 * (mean @ plane - origin)
        half = RADIUS_95 * 1e3 * np.sqrt(np.einsum("i,mij,j->m", plane, covariance, plane))
        path.plot(depth, middle, color=ESTIMATE, linestyle="--", label="predicted, with its 95 %")
        path.fill_between(depth, middle - half, middle + half, color=ESTIMATE, alpha=0.2)
    (dots,) = path.plot([], [], ".", color="0.3", markersize=3, label="measured")
    measured = 1e3 * (log.measured[:, :2] @ plane - origin)
    path.legend(frameon=False, loc="upper left")
    path.set_xlabel("depth, mm")
    path.set_title("deflection, mm", loc="left", fontsize=10)
    path.grid(alpha=0.3)
    for row in range(len(log.depth)):
        slices.clear()
        _draw(slices, log, row, pictures)
        slices.set_title(f"slice at {depth[row]:.0f} mm", loc="left", fontsize=10)
        dots.set_data(depth[: row + 1], measured[: row + 1])
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _draw(axes: Axes, log: ShapeLog, row: int, pictures: Sequence[SlicePicture]) -> None:
    """Draw the slice of a row of the log, with the measured and the true cross-section."""
    taken = min(pictures, key=lambda each: abs(each.depth - log.depth[row]))
    with Image.open(io.BytesIO(taken.jpeg)) as image:
        axes.imshow(np.asarray(image), cmap="gray", vmin=0, vmax=255, extent=taken.extent)
    for position, colour, mark in ((log.true, TRUTH, "+"), (log.measured, ESTIMATE, "o")):
        x, y = 1e3 * position[row, :2]
        axes.plot(x, y, mark, color=colour, markersize=9, fillstyle="none")
    axes.tick_params(labelsize=7)
