"""Plots of a needle's predicted shape."""

import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from sonoservo.systems.evaluation.reports.key_frames import ESTIMATE, TRUTH
from sonoservo.systems.evaluation.reports.plots import COLOURS
from sonoservo.systems.evaluation.shape.shape_metrics import (
    ShapeLog,
    cross_section_errors,
    plane_of,
)
from sonoservo.systems.signals.confidence import RADIUS_95
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.needle_shape import NeedleShape

Floats = NDArray[np.float64]


_GREY, _BLUE, _RED = "#808080", "#56B4E9", "#D55E00"

SHAPE_CAPTION = (
    "The needle's path over depth: in the plane in which it bends most, and across that plane. The "
    "band holds the predicted needle with a probability of 95 %; left of the dashed line, slices "
    "were used; at a dotted line, the bevel was turned. Below, the error of the tip predicted for "
    "the full depth as the slices arrive, and the bound that the estimate states."
)
"""Caption of `plot_shape`."""


def plot_shape(log: ShapeLog, shape: object) -> Figure:
    """Return a figure like Carriere 2016, fig. 8: measured, true and predicted path, and errors."""
    figure = Figure(figsize=(9, 8), layout="constrained")
    in_plane, across, tip = figure.subplots(
        3, 1, sharex=True, gridspec_kw={"height_ratios": [3, 1.6, 2]}
    )
    plane = plane_of(log.true)
    depth = 1e3 * log.depth
    for axes, direction in ((in_plane, plane), (across, np.array([-plane[1], plane[0]]))):
        origin = log.true[0, :2] @ direction
        true = 1e3 * (log.true[:, :2] @ direction - origin)
        measured = 1e3 * (log.measured[:, :2] @ direction - origin)
        if isinstance(shape, NeedleShape):
            mean, covariance = shape.predict(log.depth)
            predicted = 1e3 * (mean @ direction - origin)
            spread = 1.96e3 * np.sqrt(np.einsum("i,mij,j->m", direction, covariance, direction))
            band = (predicted - spread, predicted + spread)
            axes.fill_between(depth, *band, color=_RED, alpha=0.2, label="95 %")
            axes.plot(depth, predicted, color=_RED, linewidth=1.6, label="predicted")
            for each in shape.rotations:
                axes.axvline(1e3 * each, color="0.3", linestyle=":", linewidth=1)
            axes.axvline(1e3 * shape.observed, color="0.3", linestyle="--", linewidth=1)
        axes.plot(depth, true, color=_GREY, linewidth=1.2, label="true")
        axes.plot(depth, measured, ".", color=_BLUE, markersize=3, label="measured", zorder=1)
        axes.grid(alpha=0.3)
    in_plane.set_ylabel("deflection u (mm)")
    across.set_ylabel("across the plane (mm)")
    in_plane.set_title(
        "Path of the needle; dashed: last slice used; dotted: bevel turned", loc="left",
        fontsize="medium",
    )  # fmt: skip
    in_plane.legend(loc="upper left", frameon=False)
    error = 1e3 * np.linalg.norm(log.tip - log.true[-1, :2], axis=1)
    wide = np.where(np.isfinite(log.tip_covariance), log.tip_covariance, 0.0)
    std = 1e3 * np.sqrt(np.linalg.eigvalsh(wide)[:, -1])
    tip.plot(depth, error, color=_RED, label="error of the predicted tip")
    tip.plot(depth, np.where(np.isfinite(error), RADIUS_95 * std, np.nan), color=_RED,
             linestyle="--", label="95 % bound that the estimate states")  # fmt: skip
    tip.set_yscale("log")
    tip.set_ylabel("mm")
    tip.set_xlabel("depth of the slice (mm)")
    tip.grid(alpha=0.3)
    tip.legend(loc="upper right", frameon=False)
    return figure


OVERLAY_CAPTION = (
    "The runs over one another: the true path in the plane in which the needle bends most "
    "(dotted: the measured one), the error of the tip predicted for the full depth as the slices "
    "arrive, and the error of each cross-section."
)
"""Caption of `plot_shape_comparison`."""


def plot_shape_comparison(logs: Mapping[str, ShapeLog]) -> Figure:
    """Return a figure of the paths and errors of several runs."""
    figure = Figure(figsize=(9, 8), layout="constrained")
    path, tip, found = figure.subplots(3, 1, sharex=True)
    for number, (name, log) in enumerate(logs.items()):
        colour, depth = COLOURS[number % len(COLOURS)], 1e3 * log.depth
        plane, origin = plane_of(log.true), log.true[0, :2]
        path.plot(depth, 1e3 * ((log.true[:, :2] - origin) @ plane), color=colour, label=name)
        path.plot(depth, 1e3 * ((log.measured[:, :2] - origin) @ plane), ":", color=colour)
        error = np.linalg.norm(log.tip - log.true[-1, :2], axis=1)
        tip.semilogy(depth, 1e3 * error, color=colour)
        found.plot(depth, 1e3 * cross_section_errors(log), ".-", markersize=3, color=colour)
    for axes, title in (
        (path, "deflection, mm"),
        (tip, "error of the predicted tip, mm"),
        (found, "error of the cross-section, mm"),
    ):
        axes.set_title(title, loc="left", fontsize="medium")
        axes.grid(alpha=0.3)
    found.set_xlabel("depth of the slice (mm)")
    figure.legend(*path.get_legend_handles_labels(), loc="outside upper center", ncols=3,
                  frameon=False)  # fmt: skip
    return figure


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
