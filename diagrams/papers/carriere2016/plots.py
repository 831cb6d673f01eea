"""Plots of the reproduction of Carriere 2016."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from sonoservo.systems.evaluation.intervals import proportion_interval, run_interval
from sonoservo.systems.evaluation.shape.shape_metrics import plane_of
from sonoservo.systems.shape.cross_section import variance_image

Results = Mapping[str, Sequence[Mapping[str, Any]]]

# Okabe and Ito's colours stay distinguishable for colour-blind readers.
_COLOURS = {
    "taught": "#D55E00",
    "particle_filter": "#E69F00",
    "least_squares": "#0072B2",
    "as_published": "#808080",
    "published": "#808080",
}
_MEASURED = "#56B4E9"
_NEEDLES = 6


def plot_paths(results: Results) -> Figure:
    """Return a figure like figs. 8 and 9: six needles of each set, one above another."""
    figure = Figure(figsize=(10, 3.4 * len(results)), layout="constrained")
    rows = figure.subplots(len(results), 1, squeeze=False)[:, 0]
    for axes, (name, needles) in zip(rows, results.items(), strict=True):
        for number, needle in enumerate(needles[:_NEEDLES]):
            true, depth = np.array(needle["true"]), 1e3 * np.array(needle["depth"])
            plane = plane_of(np.column_stack([true, depth]))
            measured = np.array(needle["measured"], dtype=float)
            up = 4.0 * number - 1e3 * float(true[0] @ plane)
            labels = ("measured", "predicted") if number == 0 else ("", "")
            axes.plot(depth, up + 1e3 * measured @ plane, ".", color=_MEASURED, markersize=3,
                      label=labels[0])  # fmt: skip
            if "particle_filter" in needle["paths"]:
                path = np.array(needle["paths"]["particle_filter"])
                axes.plot(depth, up + 1e3 * path @ plane, color=_COLOURS["particle_filter"],
                          linewidth=1.3, label=labels[1])  # fmt: skip
        if needles[0]["observe_until"] is not None:
            axes.axvline(
                1e3 * needles[0]["observe_until"], color="0.3", linestyle="--", linewidth=1
            )
        axes.set_title(name, loc="left", fontsize="medium")
        axes.set_ylabel("deflection u (mm)\n4 mm from needle to needle")
        axes.grid(alpha=0.3)
    handles, labels = rows[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, loc="outside lower center", ncols=2)
    rows[-1].set_xlabel("depth v (mm)")
    return figure


def plot_error_against_depth(results: Results, names: Mapping[str, str]) -> Figure:
    """Return a figure like fig. 7: error of the predicted tip against the depth observed."""
    figure = Figure(figsize=(11, 4), layout="constrained")
    columns = figure.subplots(1, len(results), squeeze=False)[0]
    for axes, (name, needles) in zip(columns, results.items(), strict=True):
        end = max(needle["observe_until"] or needle["depth"][-1] for needle in needles)
        step = float(np.median(np.diff(needles[0]["depth"])))
        grid = np.arange(0, end + step / 2, max(step, 1e-3))
        for estimator, label in names.items():
            error, bound = (_by_depth(needles, estimator, key, grid)
                            for key in ("error_mm", "bound_mm"))  # fmt: skip
            known = np.isfinite(error).mean(axis=0) >= 0.5 if len(error) else np.zeros(0, bool)
            if not known.any():
                continue
            depth, colour = 1e3 * grid[known], _COLOURS[estimator]
            low, middle, high = np.nanpercentile(error[:, known], [5, 50, 95], axis=0)
            axes.plot(depth, middle, color=colour, label=label)
            if estimator != "as_published":
                axes.fill_between(depth, low, high, color=colour, alpha=0.15, linewidth=0)
            axes.plot(depth, np.nanmedian(bound[:, known], axis=0), color=colour, linestyle="--",
                      linewidth=1)  # fmt: skip
        axes.set_yscale("log")
        # The bound of the filter as printed falls to zero.
        axes.set_ylim(bottom=1e-2)
        axes.set_title(name, loc="left", fontsize="medium")
        axes.set_xlabel("depth seen (mm)")
        axes.grid(alpha=0.3)
    columns[0].set_ylabel("error of the predicted tip (mm)\ndashed: bound stated")
    handles, labels = columns[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, loc="outside lower center", ncols=3)
    return figure


def _by_depth(
    needles: Sequence[Mapping[str, Any]], estimator: str, key: str, grid: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (needles, depths) values at the last slice up to each depth; NaN before the first."""
    rows = []
    for needle in needles:
        if "by_depth" in needle["methods"].get(estimator, {}):
            table = needle["methods"][estimator]["by_depth"]
            at = np.searchsorted(table["depth"], grid + 1e-9, side="right") - 1
            rows.append(np.where(at >= 0, np.array(table[key])[np.maximum(at, 0)], np.nan))
    return np.array(rows)


def plot_errors(
    results: Results, names: Mapping[str, str], paper: Mapping[str, Mapping[str, float]]
) -> Figure:
    """Return a figure of the errors of all needles, by set and estimator, beside the paper's."""
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    for axes, (key, unit, suffix) in zip(
        figure.subplots(1, 2), (("tip", "mm", "mm"), ("shape", "mm²", "mm2")), strict=True
    ):
        for row, (name, needles) in enumerate(results.items()):
            for column, estimator in enumerate(names):
                values = [
                    needle["methods"][estimator][f"{key}_error_true_{suffix}"]
                    for needle in needles
                    if "by_depth" in needle["methods"].get(estimator, {})
                ]
                if not values:
                    continue
                at = 5 * row + column
                axes.boxplot(
                    [values], positions=[at], widths=0.7, whis=(0, 100),
                    medianprops={"color": _COLOURS[estimator], "linewidth": 2},
                )  # fmt: skip
                axes.plot(at, np.mean(values), "o", color=_COLOURS[estimator], markersize=5,
                          label=names[estimator] if row == 0 else "")  # fmt: skip
            axes.plot([5 * row - 0.5, 5 * row + 3.5], 2 * [paper[name][key]], "k:",
                      label="" if row else "paper's mean, measured path")  # fmt: skip
        axes.set_yscale("log")
        axes.set_ylim(bottom=max(axes.get_ylim()[0], 3e-3))
        axes.set_xticks(5 * np.arange(len(results)) + 1.5, list(results))
        axes.set_ylabel(f"{key} error ({unit})")
        axes.grid(alpha=0.3, axis="y")
    figure.axes[0].legend(frameon=False, fontsize="small")
    figure.supxlabel("Dot: mean; box: quartiles; whiskers: all needles.", fontsize="small")
    return figure


def plot_particles(
    particles: Mapping[str, Any], truth: Mapping[str, float], names: Mapping[str, str]
) -> Figure:
    """Return a figure like fig. 6: R and theta_0 of the particles at three times."""
    figure = Figure(figsize=(9, 3.6 * len(particles)), layout="constrained")
    rows = figure.subplots(len(particles), 3, squeeze=False, sharex=True, sharey=True)
    titles = ("before the first slice", "five slices after 10 mm", "last slice used")
    for axes_row, (estimator, snapshots) in zip(rows, particles.items(), strict=True):
        for axes, title, snapshot in zip(axes_row, titles, snapshots, strict=True):
            radius, angle = np.array(snapshot).T
            axes.plot(1e3 * radius, angle, ".", color=_COLOURS[estimator], markersize=2)
            for sign in (1, -1):
                axes.plot(1e3 * truth["radius_m"], sign * truth["angle_deg"], "k+", markersize=12,
                          alpha=1 if sign > 0 else 0.3)  # fmt: skip
            axes.set_title(f"{names[estimator]}: {title}", fontsize="small")
            axes.grid(alpha=0.3)
        axes_row[0].set_ylabel(r"$\theta_0$ (deg)")
    for axes in rows[-1]:
        axes.set_xlabel("R (mm)")
    return figure


def plot_slice(kept: Mapping[str, Any]) -> Figure:
    """Return a figure like figs. 2 and 3: a slice, and its variance image with the template."""
    intensities = np.array(kept["intensities"], dtype=np.uint8)
    origin, spacing = (1e3 * np.array(kept[name]) for name in ("origin", "spacing"))
    last = origin + spacing * np.array(intensities.shape)
    variance = variance_image(intensities, float(intensities[intensities > 0].mean()))
    figure = Figure(figsize=(9, 5), layout="constrained")
    low = 1e3 * (np.array(kept["centre"]) - 0.5 * np.array(kept["template"]))
    width, height = 1e3 * np.array(kept["template"])
    for axes, picture, title in zip(
        figure.subplots(1, 2),
        (intensities, variance / variance.max()),
        ("slice", "variance image, template"),
        strict=True,
    ):
        axes.imshow(picture.T, cmap="gray", extent=(origin[0], last[0], last[1], origin[1]))
        axes.set_title(title, loc="left", fontsize="medium")
        axes.set_xlabel("x (mm)")
        if picture is not intensities:
            axes.add_patch(Rectangle((low[0], low[1]), width, height, fill=False, color=_MEASURED))
    figure.axes[0].set_ylabel("y (mm)")
    return figure


def plot_departures(results: Results, names: Mapping[str, str]) -> Figure:
    """Return a figure of tip errors and coverage for every departure from the model."""
    experiments = [name for name in results if name not in ("d80", "patient")]
    figure = Figure(figsize=(11, 0.55 * len(experiments) + 1.6), layout="constrained")
    errors, shares = figure.subplots(1, 2, sharey=True)
    for column, (method, label) in enumerate(names.items()):
        for row, name in enumerate(experiments):
            figures = [needle["methods"].get(method, {}) for needle in results[name]]
            figures = [each for each in figures if "tip_error_true_mm" in each]
            if not figures:
                continue
            at, colour = row + 0.16 * (column - 1.5), _COLOURS[method]
            tips = [each["tip_error_true_mm"] for each in figures]
            covered = int(sum(each["covers_tip"] for each in figures))
            share = np.array([*proportion_interval(covered, len(figures))])
            for axes, middle, ends in (
                (errors, float(np.mean(tips)), _ends(tips)),
                (shares, 100 * covered / len(figures), 100 * share),
            ):
                axes.plot(ends, [at, at], color=colour, linewidth=1)
                axes.plot(middle, at, "o", color=colour, markersize=4,
                          label=label if row == 0 else "")  # fmt: skip
    errors.set_xscale("log")
    errors.set_xlabel("tip error, mean (mm)")
    shares.axvspan(90, 99, color="0.9")
    shares.set_xlabel("tips within the stated 95 % (%)")
    errors.set_yticks(range(len(experiments)), experiments)
    errors.invert_yaxis()
    for axes in (errors, shares):
        axes.grid(alpha=0.3)
    handles, labels = errors.get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, loc="outside lower center", ncols=4)
    return figure


def plot_sweeps(needles: Sequence[Mapping[str, Any]]) -> Figure:
    """Return a figure of the published method's true errors against each of its parameters."""
    sweeps = needles[0]["sweeps"]
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    grid = figure.subplots(2, len(sweeps), sharey="row", squeeze=False)
    for row, (quantity, unit) in zip(grid, (("tip", "mm"), ("shape", "mm2")), strict=True):
        for axes, (name, values) in zip(row, sweeps.items(), strict=True):
            for at, value in enumerate(values):
                key = f"{quantity}_error_true_{unit}"
                errors = [needle["sweeps"][name][value][key] for needle in needles]
                errors = [each for each in errors if each is not None]
                if errors:
                    axes.plot([at, at], _ends(errors), color="0.5", linewidth=1)
                    axes.plot(at, np.mean(errors), "o", color="0.3")
            axes.set_xticks(range(len(values)), list(values), fontsize="small")
            axes.set_title(name, loc="left", fontsize="medium")
            axes.grid(alpha=0.3)
        row[0].set_ylabel(f"{quantity} error ({unit.replace('2', '²')})")
    return figure


def _ends(values: Sequence[float]) -> NDArray[np.float64]:
    """Return the ends of the mean's interval, or NaN for few needles, which have none."""
    ends = np.array(run_interval(np.array(values)))
    return np.where(np.isfinite(ends), ends, np.nan)
