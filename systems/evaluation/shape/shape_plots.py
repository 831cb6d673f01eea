"""Plots of a needle's predicted shape."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from sonoservo.systems.evaluation.reports.plots import COLOURS
from sonoservo.systems.evaluation.shape.shape_metrics import (
    ShapeLog,
    cross_section_errors,
    plane_of,
)
from sonoservo.systems.signals.confidence import RADIUS_95
from sonoservo.systems.signals.needle_shape import NeedleShape

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
