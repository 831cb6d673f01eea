"""Pictures of a run's telling moments: detection, loss, largest error and rest."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sonoservo.systems.evaluation.metrics import MetricsParameters, at_rest, judged_volumes
from sonoservo.systems.evaluation.reports.track_plots import PlanePicture, VolumePictures
from sonoservo.systems.evaluation.run_errors import at_times, estimate_errors, in_frame
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.signals.needle_estimate import TrackingMode

Floats = NDArray[np.float64]

ESTIMATE, TRUTH = "#E69F00", "#56B4E9"
"""Colours of the estimated and of the true needle on a picture."""

_BLACK = 12  # grey level up to which a pixel is outside the sector; JPEG leaves some grey there

VIEWS = ("along needle and beam", "along the needle, across the beam")
"""Names of a volume's two slices."""


def plot_key_frames(log: RunLog, pictures: Sequence[VolumePictures]) -> dict[str, Figure]:
    """Return a figure of each telling moment of a run, by its caption."""
    if not pictures or not len(log.volume_time):
        return {}
    times = np.array([each.time for each in pictures])
    figures = {}
    for volume, words in key_volumes(log).items():
        nearest = pictures[int(np.abs(times - log.volume_time[volume]).argmin())]
        shown = int(np.abs(log.volume_time - nearest.time).argmin())  # of a long run, a neighbour
        true = true_needle(log, shown)
        caption = f"At {log.volume_time[volume]:.1f} s: {words}."
        figures[caption] = _key_frame(nearest, true)
    first = next(iter(figures))
    legend = (
        " Each slice is shown as the scanner shows it and, beside it, with the estimated needle "
        "(orange, dashed, a ring at its tip) and the true one (blue, a cross at its tip); mm."
    )
    return {
        caption + (legend if caption == first else ""): each for caption, each in figures.items()
    }


def key_volumes(log: RunLog, parameters: MetricsParameters | None = None) -> dict[int, str]:
    """Return words on each telling volume by number: detection, loss, largest error, rest."""
    parameters = parameters or MetricsParameters()
    judged = judged_volumes(log, parameters)
    if not judged.any():
        visible = at_times(log, log.visible_length, log.volume_true_time)
        shown = int(np.argmax(np.nan_to_num(visible)))
        return {shown: "the volume that shows most of the needle, which was not found"}
    tracked = log.volume_estimate_mode == TrackingMode.TRACKING
    errors = estimate_errors(log)
    moments: dict[int, list[str]] = {int(np.flatnonzero(judged)[0]): ["the needle is found"]}
    lost = np.flatnonzero(judged & (log.volume_estimate_mode == TrackingMode.LOST))
    if len(lost):
        moments.setdefault(int(lost[0]), []).append("the needle is lost")
    tip = np.where(judged, errors.tip, np.nan)
    if np.isfinite(tip).any():
        worst = int(np.nanargmax(tip))
        along, across = abs(errors.axial[worst]), errors.lateral[worst]
        moments.setdefault(worst, []).append(
            f"the largest error of the tip, {1e3 * tip[worst]:.2f} mm "
            f"({1e3 * along:.2f} mm along the needle, {1e3 * across:.2f} mm across it)"
        )
    rests = at_times(log, at_rest(log, parameters).astype(float)[:, np.newaxis], log.volume_time)
    resting = np.flatnonzero(judged & tracked & (rests[:, 0] > 0.5))
    if len(resting):
        moments.setdefault(int(resting[-1]), []).append("the needle is at rest")
    return {volume: ", and ".join(moments[volume]) for volume in sorted(moments)}


def true_needle(log: RunLog, volume: int) -> Floats:
    """Return the (9, 3) points on the true needle in a volume's P, in m; none if it is outside."""
    time = log.volume_estimate_time[[volume]]
    time = np.where(np.isfinite(time), time, log.volume_true_time[[volume]])
    points = at_times(log, log.needle_points, time)[0]
    X_WP = np.broadcast_to(log.volume_true_X_WP[volume], (len(points), 4, 4))
    return in_frame(X_WP, points) if np.isfinite(points).all() else np.zeros((0, 3))


def draw_plane(axes: Axes, picture: PlanePicture, true: Floats | None = None) -> None:
    """Draw a slice, and the needles over it."""
    axes.imshow(picture.grey, cmap="gray", vmin=0, vmax=255, extent=picture.extent)
    if true is not None:
        for points, colour, mark, style in (
            (picture.project(true), TRUTH, "+", "-"),
            (picture.needle, ESTIMATE, "o", (0, (3, 2))),
        ):
            if len(points):
                axes.plot(*points.T, color=colour, linewidth=1, linestyle=style)
                axes.plot(*points[-1], mark, color=colour, markersize=7, fillstyle="none")
    axes.set_xlim(picture.extent[:2])
    axes.set_ylim(picture.extent[2:])
    axes.tick_params(labelsize=7)


def _key_frame(pictures: VolumePictures, true: Floats) -> Figure:
    """Return a figure of a volume's slices, each without and with the needles."""
    bounds = [_bounds(each) for each in pictures.planes]
    widths = [(right - left) / (bottom - top) for left, right, bottom, top in bounds]
    width, left, gap, below, above = 11.0, 0.35, 0.42, 0.3, 0.3  # inches
    height = (width - left - gap * 2 * len(widths)) / max(2 * sum(widths), 1e-9)
    figure = Figure(figsize=(width, height + below + above))
    for number, (picture, view) in enumerate(zip(pictures.planes, VIEWS, strict=False)):
        for shown in (None, true):
            box = (left / width, below / figure.get_figheight(), widths[number] * height / width)
            axes = figure.add_axes((*box, height / figure.get_figheight()))
            draw_plane(axes, picture, shown)
            axes.set_xlim(bounds[number][:2])
            axes.set_ylim(bounds[number][2:])
            axes.set_facecolor("black")
            if shown is None:
                axes.set_title(view, loc="left", fontsize=9)
            left += widths[number] * height + gap
    return figure


def _bounds(picture: PlanePicture) -> tuple[float, float, float, float]:
    """Return the left, right, bottom and top edges in mm of the part of a picture with echoes."""
    grey = picture.grey > _BLACK
    columns, rows = (np.flatnonzero(grey.any(axis=axis)) for axis in (0, 1))
    if not len(columns):
        return picture.extent
    left, right, bottom, top = picture.extent
    x = np.linspace(left, right, grey.shape[1] + 1)
    y = np.linspace(top, bottom, grey.shape[0] + 1)
    return (x[columns[0]], x[columns[-1] + 1], y[rows[-1] + 1], y[rows[0]])
