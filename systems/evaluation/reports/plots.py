"""Plots of a run."""

import io
from collections.abc import Iterator, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydrake.math import RotationMatrix

from sonoservo.systems.evaluation.run_errors import estimate_errors, features, in_frame
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.signals.needle_estimate import TrackingMode

Floats = NDArray[np.float64]

# Okabe and Ito's colours stay distinguishable for colour-blind readers.
BLUE, ORANGE, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
_SHADES = {
    TrackingMode.SEARCHING: "#E6E6E6",
    TrackingMode.TRACKING: None,
    TrackingMode.COASTING: "#F6EFB0",
    TrackingMode.LOST: "#F6CFCB",
}


RUN_CAPTION = (
    "The run over time; solid lines show ground truth, dashed lines the tracker's estimate. "
    "a) Errors of the visual servo, which drives all three to zero: x and z of the tip in the "
    "probe's frame, and the angle between needle and image. b) The tip in the probe's frame; Y is "
    "its depth. c) How the probe moved and turned since the start. d) Contact force and its "
    "target. Shaded: the needle was not tracked."
)
ERRORS_CAPTION = (
    "Errors of the estimate after each volume, against ground truth: distance of the estimated "
    "from the true tip, with its parts along and across the needle; angle between the estimated "
    "and the true direction; and how much of the needle was in the tissue and was estimated. The "
    "estimate begins where the needle entered the image, so it is shorter."
)
"""Captions of `plot_run` and `plot_errors`."""


def plot_run(log: RunLog, force_target: float | None = 2.0) -> Figure:
    """Return a figure like Chatelain 2013, fig. 5: features, tip, probe and contact force in N."""
    figure = Figure(figsize=(9, 11), layout="constrained")
    feature, tip, probe, force = figure.subplots(
        4, 1, sharex=True, gridspec_kw={"height_ratios": [3, 2, 3, 2]}
    )
    true = features(log.X_WP, log.needle_tip, log.needle_entry)
    estimated = features(log.measured_X_WP, log.estimate_tip, log.estimate_entry)
    angle = feature.twinx()
    _lines(feature, log.time, 1e3 * true[:, :2], ["x", "z"], [BLUE, GREEN])
    _lines(feature, log.time, 1e3 * estimated[:, :2], ["x", "z"], [BLUE, GREEN], dashed=True)
    _lines(angle, log.time, np.degrees(true[:, 2:]), [r"$\theta$ (right)"], [ORANGE])
    _lines(
        angle, log.time, np.degrees(estimated[:, 2:]), [r"$\theta$ (right)"], [ORANGE], dashed=True
    )
    _label(feature, "a) Feature error", "mm", angle, "deg")
    _centre(feature, angle)
    feature.axhline(0, color="0.4", linewidth=0.8, zorder=0)

    for X_WP, p_WTip, dashed in (
        (log.X_WP, log.needle_tip, False),
        (log.measured_X_WP, log.estimate_tip, True),
    ):
        p_PTip = in_frame(X_WP, p_WTip)
        _lines(tip, log.time, 1e3 * p_PTip, ["X", "Y", "Z"], [BLUE, PURPLE, GREEN], dashed)
    _label(tip, "b) Tip in the probe's frame", "mm")

    turn = probe.twinx()
    moved, turned = _motion(log.X_WP)
    _lines(probe, log.time, 1e3 * moved, ["x", "y", "z"], [BLUE, PURPLE, GREEN])
    names = [rf"$\theta u_{axis}$ (right)" for axis in "xyz"]
    _lines(turn, log.time, np.degrees(turned), names, [BLUE, PURPLE, GREEN], dotted=True)
    _label(probe, "c) Motion of the probe since the start, in its first frame", "mm", turn, "deg")

    _lines(force, log.time, log.contact_force[:, np.newaxis], ["contact force"], [BLUE])
    if force_target is not None:
        force.axhline(force_target, color="0.4", linewidth=0.8, linestyle="--", label="target")
    _label(force, "d) Force", "N")
    force.set_xlabel("time (s)")
    _finish(figure, [feature, tip, probe, force], log.time, log.estimate_mode)
    return figure


def plot_errors(log: RunLog) -> Figure:
    """Return a figure of the estimate's errors after each volume, and of the inserted length."""
    figure = Figure(figsize=(9, 7), layout="constrained")
    tip, axis, depth = figure.subplots(3, 1, sharex=True)
    errors, time = estimate_errors(log), log.volume_estimate_time
    parts = np.stack([errors.tip, errors.axial, errors.lateral], axis=1)
    _lines(tip, time, 1e3 * parts, ["distance", "along it, + beyond the tip", "across it"],
           [BLUE, ORANGE, GREEN], marker=".")  # fmt: skip
    _label(tip, "Error of the estimated tip", "mm")
    _lines(axis, time, np.degrees(errors.axis[:, np.newaxis]), ["angle"], [BLUE], marker=".")
    _label(axis, "Error of the estimated direction", "deg")
    axis.set_ylim(bottom=0)
    estimated = np.linalg.norm(log.estimate_tip - log.estimate_entry, axis=1)
    _lines(depth, log.time, 1e3 * log.inserted_length[:, np.newaxis], ["in the tissue"], [BLUE])
    _lines(depth, log.time, 1e3 * estimated[:, np.newaxis], ["estimate, entry to tip"], [ORANGE])
    _label(depth, "Length of the needle", "mm")
    depth.set_xlabel("time (s)")
    _finish(figure, [tip, axis, depth], log.time, log.estimate_mode)
    return figure


def png(figure: Figure, dpi: float = 110) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def _lines(
    axes: Axes, time: Floats, columns: Floats, names: list[str], colours: list[str],
    dashed: bool = False, dotted: bool = False, marker: str = "",
) -> None:  # fmt: skip
    for column, name, colour in zip(columns.T, names, colours, strict=True):
        axes.plot(
            time,
            column,
            color=colour,
            label=f"{name}, estimate" if dashed else name,
            linestyle="--" if dashed else ":" if dotted else "-",
            linewidth=1.1 if dashed else 1.6,
            marker=marker,
            markersize=5,
        )


def _label(
    axes: Axes, title: str, unit: str, second: Axes | None = None, second_unit: str = ""
) -> None:
    axes.set_title(title, loc="left", fontsize="medium")
    axes.set_ylabel(unit)
    axes.grid(alpha=0.3)
    handles, names = axes.get_legend_handles_labels()
    if second is not None:
        # The legend stands beside the right axis, so its unit goes into the title.
        second.set_title(f"right: {second_unit}", loc="right", fontsize="medium")
        more = second.get_legend_handles_labels()
        handles, names = handles + more[0], names + more[1]
    axes.legend(handles, names, loc="center left", bbox_to_anchor=(1.08, 0.5), frameon=False)


def _centre(*axes: Axes) -> None:
    """Put zero at the same height on both scales."""
    for each in axes:
        largest = max(map(abs, each.get_ylim()))
        each.set_ylim(-largest, largest)


def _finish(figure: Figure, axes: list[Axes], time: Floats, mode: NDArray[np.str_]) -> None:
    """Shade the phases in which the needle was not tracked, and add a legend of the shades."""
    shown = {}
    for begin, end, name in _phases(time, mode):
        if shade := _SHADES.get(TrackingMode(name)):
            spans = [each.axvspan(begin, end, color=shade, zorder=-1) for each in axes]
            shown[name] = spans[0]
    if shown:
        figure.legend(
            shown.values(), shown.keys(), loc="outside lower center", ncols=4, frameon=False
        )
    if len(time):
        axes[0].set_xlim(time[0], max(time[-1], time[0] + 1e-3))


def _phases(time: Floats, mode: NDArray[np.str_]) -> Iterator[tuple[float, float, str]]:
    """Yield the start, end and mode of each phase in which the mode stays the same."""
    if not len(mode) or not mode[0]:
        return
    starts = np.flatnonzero(np.concatenate([[True], mode[1:] != mode[:-1]]))
    for start, end in zip(starts, [*starts[1:], len(time) - 1], strict=True):
        yield float(time[start]), float(time[end]), str(mode[start])


def _motion(X_WP: Floats) -> tuple[Floats, Floats]:
    """Return translation (m) and rotation vector theta u (rad) since the start, in the first P."""
    if not len(X_WP) or not np.isfinite(X_WP).all():
        return np.full((len(X_WP), 3), np.nan), np.full((len(X_WP), 3), np.nan)
    X_PP = np.linalg.inv(X_WP[0]) @ X_WP
    turns = [RotationMatrix(X[:3, :3]).ToAngleAxis() for X in X_PP]
    return X_PP[:, :3, 3], np.array([turn.angle() * turn.axis() for turn in turns])


COLOURS = (BLUE, ORANGE, GREEN, PURPLE, "#56B4E9", "#000000")
"""Colours of the runs, in turn."""

CAPTION = (
    "The runs over one another: the true errors of the visual servo (x and z of the tip in the "
    "probe's frame, and the angle between needle and image), the distance of the estimated from "
    "the true tip after each volume, and the contact force."
)
"""Caption of `plot_comparison`."""


def plot_comparison(logs: Mapping[str, RunLog]) -> Figure:
    """Return a figure of the servo's errors, the tip's error and the force of several runs."""
    figure = Figure(figsize=(9, 10), layout="constrained")
    x, z, theta, tip, force = figure.subplots(5, 1, sharex=True)
    for number, (name, log) in enumerate(logs.items()):
        style = {"color": COLOURS[number % len(COLOURS)], "linewidth": 1.3, "label": name}
        true = features(log.X_WP, log.needle_tip, log.needle_entry)
        x.plot(log.time, 1e3 * true[:, 0], **style)
        z.plot(log.time, 1e3 * true[:, 1], **style)
        theta.plot(log.time, np.degrees(true[:, 2]), **style)
        tip.plot(log.volume_time, 1e3 * estimate_errors(log).tip, marker=".", **style)
        force.plot(log.time, log.contact_force, **style)
    for axes, title in (
        (x, "x of the tip, mm"),
        (z, "z of the tip, mm"),
        (theta, "angle between needle and image, deg"),
        (tip, "error of the estimated tip, mm"),
        (force, "contact force, N"),
    ):
        axes.set_title(title, loc="left", fontsize="medium")
        axes.grid(alpha=0.3)
    tip.set_ylim(bottom=0)
    force.set_xlabel("time (s)")
    figure.legend(
        *x.get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False
    )
    return figure
