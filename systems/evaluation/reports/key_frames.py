"""Pictures of a run's telling moments: detection, loss, largest error and rest."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sonoservo.systems.evaluation.metrics import at_rest, judged_volumes
from sonoservo.systems.evaluation.reports.track_plots import PlanePicture, VolumePictures
from sonoservo.systems.evaluation.run_errors import at_times, estimate_errors, in_frame
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.signals.needle_estimate import TrackingMode

Floats = NDArray[np.float64]

_BLACK = 12  # grey level up to which a pixel is outside the sector; JPEG leaves some grey there

_LEGEND = (
    " The estimated needle is orange and dashed, with a ring at its tip, and the true one blue, "
    "with a cross at its tip."
)


def plot_key_frames(log: RunLog, pictures: Sequence[VolumePictures]) -> dict[str, Figure]:
    """Return a figure of each telling moment of a run, by its caption."""
    if not pictures or not len(log.volume_time):
        return {}
    times = np.array([each.time for each in pictures])
    figures: dict[str, Figure] = {}
    for volume, words in key_volumes(log).items():
        nearest = pictures[int(np.abs(times - log.volume_time[volume]).argmin())]
        shown = int(np.abs(log.volume_time - nearest.time).argmin())  # of a long run, a neighbour
        caption = f"At {log.volume_time[volume]:.1f} s: {words}."
        legend = "" if figures else _LEGEND
        figures[caption + legend] = _key_frame(nearest, true_needle(log, shown))
    return figures


def key_volumes(log: RunLog) -> dict[int, str]:
    """Return words on each telling volume by number: detection, loss, largest error, rest."""
    judged = judged_volumes(log)
    if not judged.any():
        visible = np.nan_to_num(at_times(log, log.visible_length, log.volume_true_time))
        if not visible.any():
            return {len(visible) - 1: "the last volume; none shows a needle"}
        most = "the volume that shows most of the needle, which was not found"
        return {int(np.argmax(visible)): most}
    moments: dict[int, list[str]] = {}

    def tell(volumes: NDArray[np.intp], number: int, words: str) -> None:
        if len(volumes):
            moments.setdefault(int(volumes[number]), []).append(words)

    tell(np.flatnonzero(judged), 0, "the needle is found")
    lost = log.volume_estimate_mode == TrackingMode.LOST
    tell(np.flatnonzero(judged & lost), 0, "the needle is lost")
    errors = estimate_errors(log)
    tip = np.where(judged, errors.tip, np.nan)
    if np.isfinite(tip).any():
        worst = int(np.nanargmax(tip))
        along, across = abs(errors.axial[worst]), errors.lateral[worst]
        parts = f"{1e3 * along:.2f} mm along the needle, {1e3 * across:.2f} mm across it"
        words = f"the largest error of the tip, {1e3 * tip[worst]:.2f} mm ({parts})"
        tell(np.array([worst]), 0, words)
    rests = at_times(log, at_rest(log).astype(float)[:, np.newaxis], log.volume_time)
    tracked = log.volume_estimate_mode == TrackingMode.TRACKING
    tell(np.flatnonzero(judged & tracked & (rests[:, 0] > 0.5)), -1, "the needle is at rest")
    return {volume: ", and ".join(moments[volume]) for volume in sorted(moments)}


def true_needle(log: RunLog, volume: int) -> Floats:
    """Return the (9, 3) points on the true needle in a volume's P, in m; none if it is outside."""
    time = log.volume_estimate_time[[volume]]
    time = np.where(np.isfinite(time), time, log.volume_true_time[[volume]])
    points = at_times(log, log.needle_points, time)[0]
    X_WP = np.broadcast_to(log.volume_true_X_WP[volume], (len(points), 4, 4))
    return in_frame(X_WP, points) if np.isfinite(points).all() else np.zeros((0, 3))


def _key_frame(pictures: VolumePictures, true: Floats) -> Figure:
    """Return a figure of a volume's slices with the needles."""
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    bounds = [_bounds(each) for each in pictures.planes]
    shapes = [(right - left) / (bottom - top) for left, right, bottom, top in bounds]
    grid = figure.add_gridspec(1, max(len(bounds), 1), width_ratios=shapes or None)
    for number, (picture, view) in enumerate(zip(pictures.planes, pictures.views, strict=False)):
        axes = figure.add_subplot(grid[number])
        picture.draw(axes, true)
        axes.set_title(view, loc="left", fontsize=9)
        axes.set_xlim(bounds[number][:2])
        axes.set_ylim(bounds[number][2:])
        axes.set_facecolor("black")
        axes.set_xlabel(picture.right, fontsize=9)
        axes.set_ylabel(picture.down, fontsize=9)
    return figure


def _bounds(picture: PlanePicture) -> tuple[float, float, float, float]:
    """Return the left, right, bottom and top edges in mm of the part of a picture with echoes."""
    left, right, bottom, top = np.add(picture.extent, np.repeat(picture.centre, 2)).tolist()
    grey = picture.grey > _BLACK
    columns, rows = (np.flatnonzero(grey.any(axis=axis)) for axis in (0, 1))
    if not len(columns):
        return left, right, bottom, top
    x = np.linspace(left, right, grey.shape[1] + 1)
    y = np.linspace(top, bottom, grey.shape[0] + 1)
    return (x[columns[0]], x[columns[-1] + 1], y[rows[-1] + 1], y[rows[0]])
