"""Plots of the study of robustness: success and tip error against each dial."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture

from sonoservo.diagrams.studies.robustness.analysis import Group, Record
from sonoservo.diagrams.studies.robustness.runs import CLINIC, GRADED, TRACKERS
from sonoservo.diagrams.studies.run_group import Value
from sonoservo.diagrams.studies.study_report import StudyFigure
from sonoservo.systems.evaluation.reports.plots import BLUE, GREEN, ORANGE
from sonoservo.systems.evaluation.success import KEPT

Curves = Mapping[str, Sequence[tuple[float, Mapping[str, Group]]]]
Groups = Mapping[str, Mapping[str, Group]]

_LOOKS = {
    kind: (colour, marker, 0.03 * (number - 1))
    for number, (kind, colour, marker) in enumerate(
        zip(TRACKERS, (BLUE, ORANGE, GREEN, "C3", "C4", "C5"), "os^vDP", strict=False)
    )
}
"""Colour, marker and shift along the axis of each tracker, so that equal values stay visible."""

_COLUMNS = 4
_HIGHEST_MM, _WANTED_MM = 6.0, 2.0
"""Upper end of the axis of tip errors, in mm, where larger ones are drawn as open markers, and the
error up to which a run succeeds."""


def study_figures(curves: Curves, groups: Groups) -> list[StudyFigure]:
    """Return all figures for which there are runs."""
    figures = []
    if any(name in GRADED for name in curves):
        figures = [
            StudyFigure(
                name="success",
                caption="Share of runs that succeed (found, kept, and within 2 mm and 2 deg), with "
                "95 % intervals, as one dial is turned and the probe moves as planned. Dotted: "
                "95 %, and the moderate strength.",
                figure=plot_dials(curves, _success, "runs that succeed (%)", 100.0, 100 * KEPT),
            ),
            StudyFigure(
                name="tip_error",
                caption="Tip error from the detection on: median (filled) and 95 % (open, pale) of "
                "the volumes of all runs. A run without a detection counts as one infinite error. "
                "At the upper edge: larger, or infinite. Dotted: 2 mm, and the moderate strength.",
                figure=plot_dials(curves, _median, "tip error (mm)", _HIGHEST_MM, _WANTED_MM, _p95),
            ),
        ]
    closed = {name: trackers for name, trackers in groups.items() if name.startswith("closed")}
    if closed:
        figures.append(
            StudyFigure(
                name="closed_loop",
                caption="Share of runs that succeed while each tracker moves the probe itself, at "
                "moderate strength, with 95 % intervals.",
                figure=plot_closed(closed),
            )
        )
    return figures


def plot_dials(
    curves: Curves,
    figure: Callable[[Group], Value],
    label: str,
    highest: float,
    wanted: float,
    second: Callable[[Group], Value] | None = None,
) -> Picture:
    """Plot a figure of the trackers against the strength of each dial, one panel a dial."""
    names = [name for name in curves if name != "plain"]
    rows = -(-len(names) // _COLUMNS)
    picture = Picture(figsize=(3.1 * _COLUMNS, 0.6 + 2.5 * rows), layout="constrained")
    panels = picture.subplots(rows, _COLUMNS, sharey=True, squeeze=False)
    plain = [(0.0, groups) for _, groups in curves.get("plain", [])]
    for axes, name in zip(panels.flat, names, strict=False):
        curve = [*plain, *curves[name]]
        for tracker in TRACKERS:
            if second:
                _draw(axes, curve, tracker, second, highest, pale=True)
            _draw(axes, curve, tracker, figure, highest)
        moderate = 0.5 if name == CLINIC else 1.0
        axes.axvline(moderate, color="0.6", linestyle=":", linewidth=0.9)
        axes.axhline(wanted, color="0.6", linestyle=":", linewidth=1)
        strengths = [strength for strength, _ in curve]
        axes.set_xticks(strengths, [_tick(name, each) for each in strengths])
        margin = 0.08 * max(strengths[-1], 0.1)
        axes.set_xlim(-margin, strengths[-1] + margin)
        axes.set_ylim(-0.03 * highest, 1.05 * highest)
        axes.set_title(name, fontsize="medium", loc="left")
        axes.set_xlabel("" if name == CLINIC else GRADED[name].unit, fontsize="small")
        axes.grid(alpha=0.25)
    for axes in panels.flat[len(names) :]:
        axes.set_axis_off()
    for axes in panels[:, 0]:
        axes.set_ylabel(label)
    _legend(picture)
    return picture


def plot_closed(groups: Groups) -> Picture:
    """Plot the share of successes in each experiment in the closed loop."""
    names = list(groups)
    picture = Picture(figsize=(9, 1.3 + 0.42 * len(names)), layout="constrained")
    axes = picture.subplots()
    for height, name in enumerate(names):
        for tracker, group in groups[name].items():
            colour, marker, shift = _LOOKS[tracker]
            share = group.share(_succeeds)
            if share.true is None:
                continue
            y = height + 6 * shift
            axes.plot([share.low, share.high], [y, y], color=colour, alpha=0.4, linewidth=2)
            axes.plot(share.true, y, marker, color=colour, markersize=6)
    axes.axvline(100 * KEPT, color="0.6", linestyle=":", linewidth=1)
    axes.set_yticks(range(len(names)), [name.removeprefix("closed loop, ") for name in names])
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlim(-2, 102)
    axes.set_xlabel("runs that succeed (%)")
    axes.grid(axis="x", alpha=0.25)
    _legend(picture)
    return picture


def _legend(picture: Picture) -> None:
    axes = picture.axes[0]
    handles = [
        axes.plot([], [], marker=marker, color=colour, label=tracker)[0]
        for tracker, (colour, marker, _) in _LOOKS.items()
    ]
    picture.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)


def _draw(
    axes: Axes,
    curve: Sequence[tuple[float, Mapping[str, Group]]],
    tracker: str,
    figure: Callable[[Group], Value],
    highest: float,
    pale: bool = False,
) -> None:
    """Draw a figure of a tracker, with its intervals if they are known."""
    colour, marker, shift = _LOOKS[tracker]
    shift *= curve[-1][0]
    points = [(strength + shift, figure(groups[tracker])) for strength, groups in curve]
    known = [(x, each) for x, each in points if each.true is not None]
    x = np.array([each for each, _ in known])
    y = np.array([each.true for _, each in known])
    shown = np.minimum(y, highest)
    alpha = 0.35 if pale else 1.0
    axes.plot(x, shown, color=colour, alpha=alpha, linewidth=1.2, linestyle="--" if pale else "-")
    for each, value, top in zip(x, shown, y > highest, strict=True):
        face = "none" if pale or top else colour
        axes.plot(
            each, value, marker, color=colour, markerfacecolor=face, alpha=alpha, markersize=5
        )
    for each, one in known:
        if pale or one.low is None or one.high is None or not np.isfinite(one.low):
            continue
        ends = np.minimum([one.low, one.high], highest)
        axes.plot([each, each], ends, color=colour, alpha=0.3, linewidth=2)


def _tick(name: str, strength: float) -> str:
    if strength == 0:
        return "off"
    return name if name == CLINIC else GRADED[name].words(strength, unit=False)


def _success(group: Group) -> Value:
    return group.share(_succeeds)


def _succeeds(record: Record) -> bool:
    return record.success


def _median(group: Group) -> Value:
    return group.quantile("tip", 0.5)


def _p95(group: Group) -> Value:
    return group.quantile("tip", 0.95)
