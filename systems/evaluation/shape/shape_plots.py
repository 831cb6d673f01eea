"""Plots of a needle's predicted shape."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sonoservo.systems.evaluation.reports.plots import (
    ORANGE,
    Curve,
    Frame,
    movie_frame,
    plot_overlay,
    title,
)
from sonoservo.systems.evaluation.reports.track_plots import Picture, encode_jpeg
from sonoservo.systems.evaluation.shape.shape_metrics import (
    ShapeLog,
    cross_section_errors,
    plane_of,
)
from sonoservo.systems.signals.confidence import RADIUS_95
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.needle_colours import ESTIMATE, TRUTH
from sonoservo.systems.signals.needle_shape import NeedleShape

Floats = NDArray[np.float64]

SHAPE_CAPTION = (
    "The needle's path over depth: in the plane in which it bends most, and across that plane. The "
    "band holds the predicted needle with a probability of 95 %; left of the dashed line, slices "
    "were used; at a dotted line, the bevel was turned. Below, the error of the tip predicted for "
    "the full depth as the slices arrive, and the bound that the estimate states."
)
OVERLAY_CAPTION = (
    "The runs over one another: the true path in the plane in which the needle bends most "
    "(dotted: the measured one), the error of the tip predicted for the full depth as the slices "
    "arrive, and the error of each cross-section."
)
"""Captions of `plot_shape` and `plot_shape_comparison`."""


def _deflection(log: ShapeLog, p: Floats, u: Floats) -> Floats:
    """Return how far (n, 2 or more) positions lie from the first true one along a direction."""
    return 1e3 * (p[:, :2] @ u - log.true[0, :2] @ u)


def _spread(covariance: Floats, u: Floats) -> Floats:
    """Return (n,) standard deviations in mm along a direction."""
    return 1e3 * np.sqrt(np.einsum("i,mij,j->m", u, covariance, u))


def plot_shape(log: ShapeLog, shape: object) -> Figure:
    """Return a figure like Carriere 2016, fig. 8: measured, true and predicted path, and errors."""
    figure = Figure(figsize=(9, 8), layout="constrained")
    in_plane, across, tip = figure.subplots(
        3, 1, sharex=True, gridspec_kw={"height_ratios": [3, 1.6, 2]}
    )
    plane, depth = plane_of(log.true), 1e3 * log.depth
    for axes, u in ((in_plane, plane), (across, np.array([-plane[1], plane[0]]))):
        if isinstance(shape, NeedleShape):
            mean, covariance = shape.predict(log.depth)
            middle, half = _deflection(log, mean, u), 1.96 * _spread(covariance, u)
            axes.fill_between(
                depth, middle - half, middle + half, color=ORANGE, alpha=0.2, label="95 %"
            )
            axes.plot(depth, middle, color=ORANGE, linewidth=1.6, label="predicted")
            for each in shape.rotations:
                axes.axvline(1e3 * each, color="0.3", linestyle=":", linewidth=1)
            axes.axvline(1e3 * shape.observed, color="0.3", linestyle="--", linewidth=1)
        axes.plot(
            depth, _deflection(log, log.true, u), color="#808080", linewidth=1.2, label="true"
        )
        measured = _deflection(log, log.measured, u)
        axes.plot(depth, measured, ".", color=TRUTH, markersize=3, label="measured", zorder=1)
        axes.grid(alpha=0.3)
    in_plane.set_ylabel("deflection u (mm)")
    across.set_ylabel("across the plane (mm)")
    title(in_plane, "Path of the needle; dashed: last slice used; dotted: bevel turned", "medium")
    in_plane.legend(loc="upper left", frameon=False)
    error = 1e3 * np.linalg.norm(log.tip - log.true[-1, :2], axis=1)
    wide = np.where(np.isfinite(log.tip_covariance), log.tip_covariance, 0.0)
    bound = RADIUS_95 * 1e3 * np.sqrt(np.linalg.eigvalsh(wide)[:, -1])
    tip.plot(depth, error, color=ORANGE, label="error of the predicted tip")
    tip.plot(depth, np.where(np.isfinite(error), bound, np.nan), color=ORANGE, linestyle="--",
             label="95 % bound that the estimate states")  # fmt: skip
    tip.set_yscale("log")
    tip.set_ylabel("mm")
    tip.set_xlabel("depth of the slice (mm)")
    tip.grid(alpha=0.3)
    tip.legend(loc="upper right", frameon=False)
    return figure


def plot_shape_comparison(logs: Mapping[str, ShapeLog]) -> Figure:
    """Return a figure of the paths and errors of several runs."""

    def curves(log: ShapeLog) -> Iterator[Curve]:
        depth, plane = 1e3 * log.depth, plane_of(log.true)
        path, tip, found = (
            "deflection, mm", "error of the predicted tip, mm", "error of the cross-section, mm",
        )  # fmt: skip
        yield path, depth, _deflection(log, log.true, plane), {}
        dotted = {"linestyle": ":", "label": None}
        yield path, depth, _deflection(log, log.measured, plane), dotted
        yield tip, depth, 1e3 * np.linalg.norm(log.tip - log.true[-1, :2], axis=1), {}
        marks = {"marker": ".", "markersize": 3}
        yield found, depth, 1e3 * cross_section_errors(log), marks

    figure = plot_overlay(logs, curves, panels=3, height=8, horizontal="depth of the slice (mm)")
    figure.axes[1].set_yscale("log")
    return figure


_HALF = 10e-3  # half of a picture's width and height, in m


@dataclass(frozen=True, eq=False)
class SlicePicture(Picture):
    """Part of a slice around the needle, with its edges in P."""

    depth: float  # in m


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
    (left, top), (right, bottom) = (
        1e3 * (image.position(each) + shift * image.spacing)
        for each, shift in ((low, -0.5), (high, 0.5))
    )
    return SlicePicture(encode_jpeg(grey), (left, right, bottom, top), depth)


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
    panels = figure.subplots(1, len(shown), squeeze=False)[0]
    for axes, row in zip(panels, sorted(shown), strict=True):
        _draw(axes, log, row, pictures)
        axes.set_title(f"{1e3 * log.depth[row]:.0f} mm: {shown[row]}", loc="left", fontsize=9)
    caption = (
        "Slices across the needle, in the probe's frame, mm. Orange ring: the cross-section that "
        "was found; blue cross: the true one."
    )
    return {caption: figure}


def shape_movie_frames(
    log: ShapeLog, pictures: Sequence[SlicePicture], shape: object
) -> Iterator[Frame]:
    """Yield a picture of each slice beside the needle's path, measured, true and predicted."""
    figure = Figure(figsize=(9.6, 4.2))
    grid = figure.add_gridspec(1, 2, width_ratios=(1, 1.7), left=0.06, right=0.98, bottom=0.13)
    slices, path = (figure.add_subplot(each) for each in grid)
    plane, depth = plane_of(log.true), 1e3 * log.depth
    path.plot(depth, _deflection(log, log.true, plane), color=TRUTH, label="true")
    if isinstance(shape, NeedleShape):
        mean, covariance = shape.predict(log.depth)
        middle, half = _deflection(log, mean, plane), RADIUS_95 * _spread(covariance, plane)
        path.plot(depth, middle, color=ESTIMATE, linestyle="--", label="predicted, with its 95 %")
        path.fill_between(depth, middle - half, middle + half, color=ESTIMATE, alpha=0.2)
    (dots,) = path.plot([], [], ".", color="0.3", markersize=3, label="measured")
    measured = _deflection(log, log.measured, plane)
    path.legend(frameon=False, loc="upper left")
    path.set_xlabel("depth, mm")
    title(path, "deflection, mm", 10)
    for row in range(len(log.depth)):
        slices.clear()
        _draw(slices, log, row, pictures)
        slices.set_title(f"slice at {depth[row]:.0f} mm", loc="left", fontsize=10)
        dots.set_data(depth[: row + 1], measured[: row + 1])
        yield movie_frame(figure)


def _draw(axes: Axes, log: ShapeLog, row: int, pictures: Sequence[SlicePicture]) -> None:
    """Draw the slice of a row of the log, with the measured and the true cross-section."""
    min(pictures, key=lambda each: abs(each.depth - log.depth[row])).draw(axes)
    for position, colour, mark in ((log.true, TRUTH, "+"), (log.measured, ESTIMATE, "o")):
        x, y = 1e3 * position[row, :2]
        axes.plot(x, y, mark, color=colour, markersize=9, fillstyle="none")
