"""Plots of the reproduction of Chatelain 2013: figs. 4 to 6, errors and ablations."""

from collections.abc import Mapping, Sequence
from operator import attrgetter

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sonoservo.diagrams.studies.following.analysis import AS_PUBLISHED, Run, pooled, quantile
from sonoservo.diagrams.studies.study_report import StudyFigure
from sonoservo.systems.evaluation.reports.plots import BLUE, GREEN, ORANGE, PURPLE, plot_run

Floats = NDArray[np.float64]
Groups = Mapping[str, Sequence[Run]]

_COLOURS = (BLUE, ORANGE, GREEN, PURPLE)
_TARGETS = {"tip": (0.7, 1.5), "axis": (0.7, 1.5), "curve": (0.8, 1.5)}
_ERRORS = (
    ("tip", "error of the tip (mm)", 1e3),
    ("axis", "error of the axis (deg)", float(np.rad2deg(1))),
    ("curve", "largest deviation along the curve (mm)", 1e3),
)


def study_figures(groups: Groups, ablations: Sequence[str]) -> list[StudyFigure]:
    """Return all figures of finished runs by experiment; `ablations`: the NAMEs of "fig5, NAME"."""
    figures = []
    if groups.get("fig4"):
        figures.append(
            StudyFigure(
                name="fig4",
                caption="Fig. 4 of the paper: the tip while the probe is still. Top: one run, "
                "true and estimated. Bottom: error over all runs.",
                figure=plot_fig4(groups["fig4"]),
            )
        )
    for name, what in (("fig5", "40 deg misaligned"), ("fig6", "the phantom is moved abruptly")):
        if not groups.get(name):
            continue
        first = groups[name][0]
        seed = first.outcome.case.seed
        figures.append(
            StudyFigure(
                name=name,
                caption=f"Fig. {name[-1]} of the paper: {what}. One run (seed {seed}), true and "
                "estimated.",
                figure=plot_run(first.log, first.scenario.controller.force.force),
            )
        )
        figures.append(
            StudyFigure(
                name=f"{name}_spread",
                caption=f"Fig. {name[-1]}: true feature errors over all runs: median, and from "
                "5 to 95 %.",
                figure=plot_features(groups, name),
            )
        )
    figures.append(
        StudyFigure(
            name="errors",
            caption="Share of volumes with at least 20 mm of the needle in the image whose error "
            "is smaller. Dotted: targets for the median and for 95 %.",
            figure=plot_errors(groups),
        )
    )
    variants = {"all on": groups.get("fig5", [])}
    variants |= {what: groups.get(f"fig5, {what}", []) for what in ablations}
    if sum(map(bool, variants.values())) > 1:
        figures.append(
            StudyFigure(
                name="fig5_ablations",
                caption="Fig. 5 with one part of our method switched off at a time: a point for "
                "each seed, and a bar for the volumes of all seeds.",
                figure=plot_ablations(variants),
            )
        )
    return figures


def plot_fig4(runs: Sequence[Run]) -> Figure:
    """Plot the tip's position in P over the volumes, and its error over runs."""
    figure = Figure(figsize=(9, 7), layout="constrained")
    tip, error = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [3, 2]})
    volumes = runs[0].volumes
    for k, (name, colour) in enumerate(zip("XYZ", (BLUE, PURPLE, GREEN), strict=True)):
        tip.plot(1e3 * volumes.p_PTip[:, k], color=colour, label=name)
        tip.plot(
            1e3 * volumes.p_PTip_estimated[:, k],
            color=colour,
            linestyle="none",
            marker=".",
            markersize=3,
            alpha=0.6,
            label=f"{name}, estimate",
        )
    seed = runs[0].outcome.case.seed
    _finish(tip, f"Tip in the probe's frame (seed {seed})", "mm")
    tip.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    _band(error, [1e3 * run.volumes.tip for run in runs], BLUE, "tip error")
    for limit in _TARGETS["tip"]:
        error.axhline(limit, color="0.4", linestyle=":", linewidth=0.9)
    error.set_ylim(0, 4)
    error.set_xlim(0, max(len(run.volumes.tip) for run in runs))
    _finish(error, f"Error of the tip, {len(runs)} runs: median, 5 to 95 %", "mm")
    error.set_xlabel("volume index")
    return figure


def plot_features(groups: Groups, name: str) -> Figure:
    """Plot true X, Z and Theta over the volumes: median and spread over the runs."""
    figure = Figure(figsize=(9, 8), layout="constrained")
    for axes, k, what, unit, factor in zip(
        figure.subplots(3, 1, sharex=True),
        range(3),
        ("X", "Z", r"$\Theta$"),
        ("mm", "mm", "deg"),
        (1e3, 1e3, np.rad2deg(1)),
        strict=True,
    ):
        variants = {name: "ours", name + AS_PUBLISHED: "as published"}
        for (group, label), colour in zip(variants.items(), (BLUE, ORANGE), strict=True):
            runs = groups.get(group, [])
            if runs:
                columns = [factor * run.volumes.true[:, k] for run in runs]
                _band(axes, columns, colour, f"{label}, {len(runs)} runs")
        axes.axhline(0, color="0.4", linewidth=0.8)
        _finish(axes, what, unit)
    run = groups[name][0]
    log, moves = run.log, run.scenario.phantom_motion.moves
    index = np.arange(len(log.volume_time))
    for move in moves:
        start, stop = np.interp(
            [move.start, move.start + move.duration], log.volume_time, index, right=np.nan
        )
        for axes in figure.axes:
            axes.axvspan(start, stop, color="0.85")
    figure.axes[0].legend(fontsize="small")
    figure.axes[-1].set_xlabel("volume index" + (" (grey: the phantom moves)" if moves else ""))
    return figure


def plot_errors(groups: Groups) -> Figure:
    """Plot the distribution of the errors of tip, axis and curve, with a line per experiment."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    for axes, (error, label, factor) in zip(
        figure.subplots(1, 3, sharey=True), _ERRORS, strict=True
    ):
        for name, colour in zip(("fig4", "fig5", "fig6", "bent"), _COLOURS, strict=True):
            # Omitted for bent needles, whose direction from entry to tip depends on the entry.
            if groups.get(name) and (name, error) != ("bent", "axis"):
                values = pooled(groups[name], 0, attrgetter(error))
                values = np.sort(factor * values)
                share = 100 * np.arange(1, len(values) + 1) / max(len(values), 1)
                axes.step(values, share, where="post", color=colour, label=name)
        for limit, height in zip(_TARGETS[error], (50, 95), strict=True):
            axes.plot(
                [0, limit, limit], [height, height, 0], color="0.4", linestyle=":", linewidth=1
            )
        axes.set_xlim(0, 4)
        axes.set_ylim(0, 101)
        axes.set_xlabel(label)
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("volumes (%)")
    figure.axes[-1].legend(loc="lower right", fontsize="small")
    return figure


def plot_ablations(variants: Groups) -> Figure:
    """Plot errors, losses and time of each variant: all volumes, and each run by itself."""
    rows = {f"{name} ({len(runs)})": runs for name, runs in variants.items() if runs}
    figure = Figure(figsize=(10, 1.2 + 0.42 * len(rows)), layout="constrained")
    panels = figure.subplots(1, 4, sharey=True)
    panels[0].set_yticks(range(len(rows)), rows)
    panels[0].invert_yaxis()
    for axes, (label, name, factor, q) in zip(
        panels,
        (
            ("tip error, 95 % (mm)", "tip", 1e3, 0.95),
            ("axis error, 95 % (deg)", "axis", float(np.rad2deg(1)), 0.95),
            ("not tracked (%)", "tracked", 1.0, None),
            ("tracking a volume (ms)", "track_time", 1e3, 0.5),
        ),
        strict=True,
    ):
        totals = [_figure_of(runs, name, factor, q) for runs in rows.values()]
        singles = [[_figure_of([run], name, factor, q) for run in runs] for runs in rows.values()]
        finite = [x for each in [totals, *singles] for x in each if np.isfinite(x)]
        edge = 1.15 * max([*finite, 1.0])
        axes.barh(range(len(rows)), np.minimum(totals, edge), color=BLUE, alpha=0.35)
        for height, each in enumerate(singles):
            for x in each:
                # Infinite values are drawn at the edge: too many volumes lack an estimate.
                marker = "o" if np.isfinite(x) else ">"
                axes.plot(min(x, edge), height, marker, color=BLUE, markersize=4, clip_on=False)
        axes.set_xlim(0, edge)
        if name == "track_time":
            axes.set_xscale("log")
            axes.set_xlim(1, edge)
        axes.set_xlabel(label)
        axes.grid(axis="x", alpha=0.3)
    return figure


def _figure_of(runs: Sequence[Run], name: str, factor: float, q: float | None) -> float:
    """Return a quantile of a pooled quantity, or, without q, the percentage that is false."""
    values = pooled(runs, 0, attrgetter(name))
    if len(values) == 0:
        return float("nan")
    return factor * (quantile(values, q) or 0.0) if q else 100 * float(np.mean(values == 0))


def _band(axes: Axes, columns: Sequence[Floats], colour: str, label: str) -> None:
    """Draw the median over runs and the range from 5 to 95 % for each volume; NaN is ignored."""
    table = np.full((len(columns), max(map(len, columns))), np.nan)
    for row, column in zip(table, columns, strict=True):
        row[: len(column)] = column
    known = ~np.isnan(table).all(axis=0)
    index = np.flatnonzero(known)
    low, middle, high = np.nanquantile(table[:, known], (0.05, 0.5, 0.95), axis=0, method="nearest")
    axes.fill_between(index, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.plot(index, middle, color=colour, label=label)


def _finish(axes: Axes, title: str, unit: str) -> None:
    axes.set_title(title, loc="left", fontsize="medium")
    axes.set_ylabel(unit)
    axes.grid(alpha=0.3)
