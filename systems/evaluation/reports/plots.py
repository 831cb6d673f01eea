"""Plots of a run, and what all figures share: colours, panels, pictures and movies."""

import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydrake.math import RotationMatrix

from sonoservo.systems.evaluation.run_errors import estimate_errors, features, in_frame
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.signals.needle_colours import TRUTH
from sonoservo.systems.signals.needle_estimate import TrackingMode

Floats = NDArray[np.float64]
Frame = NDArray[np.uint8]

# Okabe and Ito's colours stay distinguishable for colour-blind readers.
BLUE, ORANGE, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
COLOURS = (BLUE, ORANGE, GREEN, PURPLE, TRUTH, "#000000")
"""Colours of the runs, in turn."""

_SHADES = {
    TrackingMode.SEARCHING: "#E6E6E6",
    TrackingMode.COASTING: "#F6EFB0",
    TrackingMode.LOST: "#F6CFCB",
}


RUN_CAPTION = (
    "The run over time; solid lines show ground truth, dashed lines the tracker's estimate. "
    "a) Errors of the visual servo, which drives all three to zero: x and z, the X and Z of b), "
    "and θ, the angle between needle and image. b) The tip in the probe's frame: X lateral, Y its "
    "depth, Z across the image. c) How the probe moved and, dotted, turned since the start: θu has "
    "the direction of the axis of the turn, and its angle as length. d) Contact force and its "
    "target. Shaded: the needle was not tracked."
)
ERRORS_CAPTION = (
    "Errors of the estimate after each volume, against ground truth: distance of the estimated "
    "from the true tip, with its parts along and across the needle; angle between the estimated "
    "and the true direction; and how much of the needle was in the tissue and was estimated. The "
    "estimate begins where the needle entered the image, so it is shorter."
)
CAPTION = (
    "The runs over one another: the true errors of the visual servo (x and z of the tip in the "
    "probe's frame, and the angle between needle and image), the distance of the estimated from "
    "the true tip after each volume, and the contact force."
)
"""Captions of `plot_run`, `plot_errors` and `plot_comparison`."""


def plot_run(log: RunLog, force_target: float | None = 2.0) -> Figure:
    """Return a figure like Chatelain 2013, fig. 5: features, tip, probe and contact force in N."""
    figure = Figure(figsize=(9, 11), layout="constrained")
    feature, tip, probe, force = axes = figure.subplots(
        4, 1, sharex=True, gridspec_kw={"height_ratios": [3, 2, 3, 2]}
    )
    angle, turn = feature.twinx(), probe.twinx()
    for X_WP, p_WTip, p_WEntry, style in (
        (log.X_WP, log.needle_tip, log.needle_entry, "-"),
        (log.measured_X_WP, log.estimate_tip, log.estimate_entry, "--"),
    ):
        errors = features(X_WP, p_WTip, p_WEntry)
        _lines(feature, log.time, 1e3 * errors[:, :2], "xz", [BLUE, GREEN], style)
        _lines(angle, log.time, np.degrees(errors[:, 2:]), [r"$\theta$ (right)"], [ORANGE], style)
        p_PTip = 1e3 * in_frame(X_WP, p_WTip)
        _lines(tip, log.time, p_PTip, "XYZ", [BLUE, PURPLE, GREEN], style)
    _label(feature, "a) Feature error", "mm", angle)
    for each in (feature, angle):  # zero at the same height
        largest = max(map(abs, each.get_ylim()))
        each.set_ylim(-largest, largest)
    feature.axhline(0, color="0.4", linewidth=0.8, zorder=0)
    _label(tip, "b) Tip in the probe's frame", "mm")
    moved, turned = _motion(log.X_WP)
    _lines(probe, log.time, 1e3 * moved, "xyz", [BLUE, PURPLE, GREEN])
    names = [rf"$\theta u_{axis}$ (right)" for axis in "xyz"]
    _lines(turn, log.time, np.degrees(turned), names, [BLUE, PURPLE, GREEN], ":")
    _label(probe, "c) Motion of the probe since the start, in its first frame", "mm", turn)
    _lines(force, log.time, log.contact_force[:, np.newaxis], ["contact force"], [BLUE])
    if force_target is not None:
        force.axhline(force_target, color="0.4", linewidth=0.8, linestyle="--", label="target")
    _label(force, "d) Force", "N")
    _finish(figure, axes, log)
    return figure


def plot_errors(log: RunLog) -> Figure:
    """Return a figure of the estimate's errors after each volume, and of the inserted length."""
    figure = Figure(figsize=(9, 7), layout="constrained")
    tip, axis, depth = axes = figure.subplots(3, 1, sharex=True)
    errors, time = estimate_errors(log), log.volume_estimate_time
    parts = np.stack([errors.tip, errors.axial, errors.lateral], axis=1)
    names = ["distance", "along it, + beyond the tip", "across it"]
    _lines(tip, time, 1e3 * parts, names, [BLUE, ORANGE, GREEN], marker=".")
    _label(tip, "Error of the estimated tip", "mm")
    _lines(axis, time, np.degrees(errors.axis[:, np.newaxis]), ["angle"], [BLUE], marker=".")
    _label(axis, "Error of the estimated direction", "deg")
    axis.set_ylim(bottom=0)
    estimated = np.linalg.norm(log.estimate_tip - log.estimate_entry, axis=1)
    lengths = 1e3 * np.stack([log.inserted_length, estimated], axis=1)
    _lines(depth, log.time, lengths, ["in the tissue", "estimate, entry to tip"], [BLUE, ORANGE])
    _label(depth, "Length of the needle", "mm")
    _finish(figure, axes, log)
    return figure


def _lines(
    axes: Axes, time: Floats, columns: Floats, names: Sequence[str], colours: list[str],
    style: str = "-", marker: str = "",
) -> None:  # fmt: skip
    """Draw a line for each column; a dashed one is an estimate."""
    estimate, width = (", estimate", 1.1) if style == "--" else ("", 1.6)
    for column, name, colour in zip(columns.T, names, colours, strict=True):
        axes.plot(time, column, color=colour, label=name + estimate, linestyle=style,
                  linewidth=width, marker=marker, markersize=5)  # fmt: skip


def _label(axes: Axes, name: str, unit: str, angles: Axes | None = None) -> None:
    """Label axes, and the axes in deg on their right side, if any."""
    title(axes, name, "medium")
    axes.set_ylabel(unit)
    handles, names = axes.get_legend_handles_labels()
    if angles is not None:
        # The legend stands beside the right axis, so its unit goes into the title.
        angles.set_title("right: deg", loc="right", fontsize="medium")
        more = angles.get_legend_handles_labels()
        handles, names = handles + more[0], names + more[1]
    axes.legend(handles, names, loc="center left", bbox_to_anchor=(1.08, 0.5), frameon=False)


def _finish(figure: Figure, axes: Sequence[Axes], log: RunLog) -> None:
    """Shade the phases in which the needle was not tracked, and add a legend of the shades."""
    time, mode, shown = log.time, log.estimate_mode, {}
    axes[-1].set_xlabel("time (s)")
    if len(mode) and mode[0]:
        starts = [0, *(np.flatnonzero(mode[1:] != mode[:-1]) + 1)]
        for start, end in zip(starts, [*starts[1:], len(time) - 1], strict=True):
            if shade := _SHADES.get(TrackingMode(mode[start])):
                place = {"color": shade, "zorder": -1}
                spans = [each.axvspan(time[start], time[end], **place) for each in axes]
                shown[str(mode[start])] = spans[0]
    if shown:
        figure.legend(
            shown.values(), shown.keys(), loc="outside lower center", ncols=4, frameon=False
        )
    if len(time):
        axes[0].set_xlim(time[0], max(time[-1], time[0] + 1e-3))


def _motion(X_WP: Floats) -> tuple[Floats, Floats]:
    """Return translation (m) and rotation vector theta u (rad) since the start, in the first P."""
    if not len(X_WP) or not np.isfinite(X_WP).all():
        return np.full((len(X_WP), 3), np.nan), np.full((len(X_WP), 3), np.nan)
    X_PP = np.linalg.inv(X_WP[0]) @ X_WP
    turns = [RotationMatrix(X[:3, :3]).ToAngleAxis() for X in X_PP]
    return X_PP[:, :3, 3], np.array([turn.angle() * turn.axis() for turn in turns])


def plot_comparison(logs: Mapping[str, RunLog]) -> Figure:
    """Return a figure of the servo's errors, the tip's error and the force of several runs."""

    def curves(log: RunLog) -> Iterator[Curve]:
        x, z, theta = features(log.X_WP, log.needle_tip, log.needle_entry).T
        tip = 1e3 * estimate_errors(log).tip
        for name, time, values, marker in (
            ("x of the tip, mm", log.time, 1e3 * x, ""),
            ("z of the tip, mm", log.time, 1e3 * z, ""),
            ("angle between needle and image, deg", log.time, np.degrees(theta), ""),
            ("error of the estimated tip, mm", log.volume_time, tip, "."),
            ("contact force, N", log.time, log.contact_force, ""),
        ):
            yield name, time, values, {"linewidth": 1.3, "marker": marker}

    figure = plot_overlay(logs, curves, panels=5, height=10, horizontal="time (s)")
    figure.axes[3].set_ylim(bottom=0)
    return figure


Curve = tuple[str, Floats, Floats, dict[str, Any]]  # panel, abscissae, ordinates and style


def plot_overlay(
    logs: Mapping[str, Any],
    curves: Callable[[Any], Iterable[Curve]],
    *,
    panels: int,
    height: float,
    horizontal: str,
) -> Figure:
    """Return a figure of several runs' curves over one another, a colour for each run."""
    figure = Figure(figsize=(9, height), layout="constrained")
    free, named = iter(figure.subplots(panels, 1, sharex=True)), dict[str, Axes]()
    for number, (name, log) in enumerate(logs.items()):
        for panel, x, y, style in curves(log):
            if panel not in named:
                named[panel] = next(free)
                title(named[panel], panel, "medium")
            colour = COLOURS[number % len(COLOURS)]
            named[panel].plot(x, y, **{"color": colour, "label": name, **style})
    figure.axes[-1].set_xlabel(horizontal)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    return figure


def title(axes: Axes, text: str, size: float | str = 9) -> None:
    """Give axes a title above their left edge, and a grid."""
    axes.set_title(text, loc="left", fontsize=size)
    axes.grid(alpha=0.3)


def png(figure: Figure, dpi: float = 110) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def movie_frame(figure: Figure) -> Frame:
    """Return a figure, which keeps its canvas, as a (rows, columns, 3) picture of a movie."""
    if not isinstance(figure.canvas, FigureCanvasAgg):
        FigureCanvasAgg(figure)
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()
