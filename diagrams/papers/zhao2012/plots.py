"""Figures like Zhao 2012, figs. 2 to 5, and the velocimeter's bias and spread."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sonoservo.diagrams.papers.zhao2012.runs import ESTIMATORS, QUANTITIES
from sonoservo.diagrams.studies.study_report import StudyFigure

_STYLES = {
    "ransac_sample": {"color": "0.65", "linestyle": ":", "marker": "x"},
    "ransac": {"color": "#D55E00", "linestyle": ":", "marker": "s"},
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
    """Return figures of the root mean square errors of angles and of tips.

    Parameters
    ----------
    experiment
        Name of the experiment: "static" or "dynamic", then the kind of its volumes.
    lengths
        (m,) lengths of the needle, in mm.
    rmse
        (m, estimators, quantities) root mean square errors, in deg and mm.
    names
        Names of the estimators to display.
    """
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


def plot_velocimeter(speeds: NDArray[np.float64], measured: NDArray[np.float64]) -> StudyFigure:
    """Return a figure of the velocimeter's errors along the needle against the true speed.

    Parameters
    ----------
    speeds
        (m,) true speeds, in mm/s.
    measured
        (runs, m) measured speeds along the needle, in mm/s; NaN if nothing was found.
    """
    figure = Figure(figsize=(9, 4), layout="constrained")
    error, found = figure.subplots(1, 2)
    error.axhline(0, color="0.4", linewidth=0.8)
    offsets = np.linspace(-0.08, 0.08, len(measured))[:, np.newaxis]
    error.plot(speeds + offsets, measured - speeds, ".", color="#0072B2", alpha=0.4, markersize=4)
    some = np.isfinite(measured).any(axis=0)
    means = np.nanmean(measured[:, some] - speeds[some], axis=0)
    spreads = np.nanstd(measured[:, some], axis=0)
    error.errorbar(
        speeds[some], means, spreads, color="#D55E00", fmt="o-", capsize=3, label="mean, deviation"
    )
    error.set_xlabel("true speed (mm/s)")
    error.set_ylabel("measured less true speed (mm/s)")
    error.legend(frameon=False)
    found.plot(speeds, 100 * np.isfinite(measured).mean(axis=0), "o-", color="#0072B2")
    found.set_ylim(0, 105)
    found.set_xlabel("true speed (mm/s)")
    found.set_ylabel("found again (%)")
    for panel in (error, found):
        panel.grid(alpha=0.3)
    return StudyFigure(
        name="velocimeter",
        caption="The velocimeter alone, with its search centred 0.1 mm off (standard deviation)",
        figure=figure,
    )
