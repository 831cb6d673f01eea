"""Curves of several runs over one another."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from sonoservo.systems.evaluation.reports.plots import BLUE, GREEN, ORANGE, PURPLE
from sonoservo.systems.evaluation.run_errors import estimate_errors, features
from sonoservo.systems.evaluation.run_log import RunLog

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
