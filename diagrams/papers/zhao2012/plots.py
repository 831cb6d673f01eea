"""Figures like Zhao 2012, figs. 2 to 5, and the velocimeter's bias and spread."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sonoservo.diagrams.papers.zhao2012.runs import ESTIMATORS, QUANTITIES
from sonoservo.diagrams.studies.study_report import StudyFigure

_STYLES = {
    "ransac_sample": {"color": "0.65", "linestyle": ":", "marker": "x"},
    "ransac": {"color": "#D55E00", "linestyle": ":", "marker": "s"},
    "published": {"color": "#E69F00", "linestyle": "-", "marker": "D"},
    "ours": {"color": "#009E73", "linestyle": "--", "marker": "^"},
    "kalman": {"color": "#CC79A7", "linestyle": "-", "marker": "v"},
    "kalman_velocity": {"color": "#0072B2", "linestyle": "-", "marker": "o"},
}
_LABELS = {
    "alpha": r"$\alpha$ (deg)",
    "beta": r"$\beta$ (deg)",
    "x": "x, along the array (mm)",
    "y": "y, elevation (mm)",
    "z": "z, depth (mm)",
    "tip": "tip (mm)",
}


def plot_rmse(
    experiment: str,
    lengths: NDArray[np.floating[Any]],
    rmse: NDArray[np.floating[Any]],
    names: Mapping[str, str],
) -> list[StudyFigure]:
    """Return figures of the (m, estimators, quantities) errors of angles (deg) and tips (mm)."""
    figures = []
    motion = experiment.split(",")[0]
    numbers = {"static": (2, 3), "dynamic": (4, 5)}[motion]
    for number, part, quantities in zip(
        numbers, ("angles", "tip"), (QUANTITIES[:2], QUANTITIES[2:]), strict=True
    ):
        rows = len(quantities) // 2
        figure = Figure(figsize=(9, 1 + 2.6 * rows), layout="constrained")
        panels = figure.subplots(rows, 2, sharex=True, squeeze=False).ravel()
        for panel, quantity in zip(panels, quantities, strict=True):
            for index, estimator in enumerate(ESTIMATORS):
                values = rmse[:, index, QUANTITIES.index(quantity)]
                style = _STYLES[estimator]
                panel.plot(lengths, values, label=names[estimator], markersize=4, **style)
            panel.set_ylim(bottom=0)
            panel.set_ylabel(f"RMSE of {_LABELS[quantity]}")
            panel.grid(alpha=0.3)
        for panel in panels[-2:]:
            panel.set_xlabel("length of the needle (mm)")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
        name = f"{experiment.replace(', ', '_').replace(' ', '_')}_{part}"
        caption = f"Like fig. {number}: {part}, {experiment}"
        figures.append(StudyFigure(name=name, caption=caption, figure=figure))
    return figures


def plot_speeds(
    errors: Mapping[str, Mapping[str, Sequence[NDArray[np.float64]]]],
) -> StudyFigure:
    """Return a figure of the errors of the speed in mm/s of each run, by experiment and source."""
    shown = {name: found for name, found in errors.items() if found}
    figure = Figure(figsize=(9, 1 + 0.9 * len(shown)), layout="constrained")
    axes = figure.subplots()
    axes.axvline(0, color="0.4", linewidth=0.8)
    for row, found in enumerate(shown.values()):
        for number, (source, runs) in enumerate(found.items()):
            values = np.concatenate(list(runs))
            values = values[np.isfinite(values)]
            if len(values):
                low, middle, high = np.quantile(values, (0.05, 0.5, 0.95))
                height, colour = row + 0.14 * (number - 2), f"C{number}"
                axes.plot([low, high], [height, height], color=colour, linewidth=2)
                label = source if row == 0 else None
                axes.plot(middle, height, "o", color=colour, markersize=5, label=label)
    axes.set_yticks(range(len(shown)), list(shown))
    axes.invert_yaxis()
    axes.set_xlabel("estimated less true speed (mm/s): median, 5 to 95 %")
    axes.grid(axis="x", alpha=0.3)
    figure.legend(loc="outside upper center", ncols=5, frameon=False)
    caption = "Speed of the tip along the needle by source, inside the tracker"
    return StudyFigure(name="speeds", caption=caption, figure=figure)
