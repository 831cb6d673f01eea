"""Figure of a tracker's search in one volume, beside ground truth."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from pydrake.math import RigidTransform

from sonoservo.systems.evaluation.explanation.explained_volume import AFTER, BEFORE, ExplainedVolume
from sonoservo.systems.evaluation.log import Array
from sonoservo.systems.signals.confidence import squared_distance
from sonoservo.systems.signals.line_hypotheses import LINE_CLASSES
from sonoservo.systems.signals.needle_colours import ESTIMATE, LINE_COLOURS, TRUTH
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import TrackingMode

PREDICTED, MEASURED = "#00C08B", "#D779A7"
LINE = "#F0E442"
_QUIET = "0.45"
_ACROSS = {"beam": "along", "cross": "across"}
_SIDE = {"beam": "lateral", "cross": "elevation"}
_OTHER = {"beam": "elevation", "cross": "lateral"}
_BESIDE = 0.3  # time in s by which marks reach beyond their volume's
_MARGIN = 8.0  # margin in mm around the lines drawn in a slice


def plot_explanation(
    explained: ExplainedVolume,
    *,
    kept: Sequence[ExplainedVolume] = (),
    needle: Array | None = None,
    tip_error: float = np.nan,
) -> Figure:
    """Return a figure of a tracker's search in a volume: slices, profile along the axis, gate."""
    needle = np.zeros((0, 3)) if needle is None else needle
    figure = Figure(figsize=(15, 9.5), layout="constrained")
    grid = figure.subplots(2, 2, width_ratios=[1.35, 1])
    slices = list(grid[:, 0])
    for axes, name in zip(slices, ("beam", "cross"), strict=True):
        _draw_slice(axes, explained, name, needle)
    if len(explained.candidates) and slices[0].collections:
        weights = slices[0].collections[0]
        figure.colorbar(
            weights, ax=slices, location="left", shrink=0.5, aspect=40, label="candidate's weight"
        )
    if len(explained.line_numbers) and not len(explained.profile):
        _draw_classes(grid[0, 1], explained)
    else:
        _draw_profile(grid[0, 1], explained, needle)
    if np.isfinite(explained.history).any():
        _draw_history(grid[1, 1], explained, needle)
    else:
        _draw_gate(grid[1, 1], explained, kept or [explained])
    entries: dict[str, Any] = {}
    for axes in slices:
        handles, labels = axes.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    if entries:
        dark = {"facecolor": "0.3", "labelcolor": "white", "fancybox": False}
        figure.legend(entries.values(), entries.keys(), loc="outside lower left", ncols=5, **dark)
    figure.suptitle(describe(explained, tip_error), fontsize=12.5, wrap=True)
    return figure


def describe(explained: ExplainedVolume, tip_error: float = np.nan) -> str:
    """Return a text of one or two lines about the result; parameters as in `plot_explanation`."""
    before, after = str(explained.mode_before), str(explained.mode_after)
    changed = bool(before) and before != after
    mode = f"{before} → {after}" if changed else after
    confirmed = after == TrackingMode.TRACKING
    nothing = "the needle was confirmed" if confirmed else "the needle is yet to be confirmed"
    facts = []
    if not changed and explained.occasion not in (BEFORE, AFTER):
        facts.append(str(explained.occasion))
    if np.isfinite(tip_error):
        facts.append(f"estimated tip {1e3 * tip_error:.1f} mm from the true one")
    if np.isfinite(explained.innovation):
        facts.append(f"innovation {explained.innovation:.1f}, gate {explained.gate:.1f}")
    if explained.leaves:
        facts.append("the needle extends beyond the region searched, so its tip was not seen")
    if np.isfinite(explained.tip_seen):
        facts.append(f"its tip is seen with a probability of {100 * explained.tip_seen:.0f} %")
    if len(explained.attempt_reasons) > 1:
        facts.append(f"{len(explained.attempt_reasons)} searches, the deciding one shown")
    title = f"{float(explained.volume_time):.2f} s, {mode}: {str(explained.reason) or nothing}"
    return "\n".join([title, *filter(None, ["; ".join(facts)])])


def _draw_slice(axes: Axes, explained: ExplainedVolume, name: str, needle: Array) -> None:
    """Draw the slice "beam" or "cross", with the search projected onto it."""
    levels, X_PS, size = (
        getattr(explained, f"{name}_{each}") for each in ("slice", "X_PS", "size")
    )
    through = str(explained.sliced)
    curve = "line most like a needle" if through == "line" else f"{through} needle"
    words = f"Slice {_ACROSS[name]} the beam, through the {curve}"
    words = f"Slice at {_OTHER[name]} 0" if through == "none" else words
    axes.set_title(words, loc="left", fontsize=11)
    if not levels.size:
        axes.text(0.5, 0.5, "the slice misses the volume", ha="center", transform=axes.transAxes)
        axes.set_axis_off()
        return
    # Depth is measured in P; the other axes start at the tip of the curve in the slice.
    upright = abs(X_PS[1, 1]) > 1 - 1e-9
    origin = explained.slice_origin * ([1, 0, 1] if upright else [1, 1, 1])

    def project(p_P: Array) -> Array:
        return 1e3 * (p_P - origin) @ X_PS[:3, :2]

    def show(p_W: Array) -> Array:
        return project(explained.to_probe(p_W))

    (x, y), half = project(X_PS[:3, 3]), 500 * size
    extent = (x - half[0], x + half[0], y + half[1], y - half[1])
    axes.imshow(levels, cmap="gray", vmin=0, vmax=255, extent=extent)
    corners = np.zeros((0, 2))
    if len(explained.region):
        corners = _outline(show(_reaching(explained)), 1e3 * float(explained.region_radius))
        axes.fill(*corners.T, fill=False, edgecolor=PREDICTED, linewidth=1.0,
                  label="region searched")  # fmt: skip
    if len(explained.candidates):
        at, order = show(explained.candidates), np.argsort(explained.weights)
        axes.scatter(*at[order].T, c=explained.weights[order], s=5, cmap="plasma", vmin=0, vmax=1,
                     linewidths=0, alpha=0.55, label="candidates")  # fmt: skip
        axes.scatter(*at[explained.inliers].T, s=5, marker="o", facecolors="none", alpha=0.6,
                     edgecolors="white", linewidths=0.35, label="consensus inliers")  # fmt: skip
    if len(explained.profile):
        fitted = show(explained.profile)
        axes.plot(*fitted.T, color=MEASURED, linestyle=":", linewidth=1.2, label="fitted axis")
    most_probable = explained.line_ends[0] if through == "line" else np.zeros((0, 3))
    lines = [
        (show(_curve(points)), colour, style, label)
        for points, colour, style, label in (
            (explained.before, ESTIMATE, ":", "estimate before"),
            (explained.after, ESTIMATE, "-", "estimate after"),
            (explained.predicted, PREDICTED, "-.", "predicted needle"),
            (explained.measured, MEASURED, "-", "measured needle"),
            (most_probable, LINE, "-", "most probable line"),
        )
        if len(points)
    ]
    for line, colour, style, label in lines:
        axes.plot(*line.T, color=colour, linestyle=style, linewidth=1.3, label=label)
        axes.plot(*line[-1], marker="o", color=colour, markersize=4)
    if len(explained.measured):
        _draw_tip(axes, explained, X_PS[:3, :2].T, show(explained.measured[-1:])[0])
    true = project(needle)
    if len(needle):
        axes.plot(*true.T, color=TRUTH, linestyle="--", linewidth=1.5, label="true needle")
        axes.plot(*true[-1], marker="x", color=TRUTH, markersize=8, markeredgewidth=1.8)
    drawn = np.concatenate([corners, *(line for line, *_ in lines), true])
    left, right, bottom, top = extent
    if through != "none" and len(drawn):
        low, high = drawn.min(axis=0) - _MARGIN, drawn.max(axis=0) + _MARGIN
        left, right = max(left, low[0]), min(right, high[0])
        top, bottom = max(top, low[1]), min(bottom, high[1])
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    tip = f"along the {curve}, mm from its tip"
    axes.set_xlabel(f"{_SIDE[name]}, mm" if through == "none" else tip)
    axes.set_ylabel("depth, mm" if upright else "across the needle, mm")


def _draw_tip(axes: Axes, explained: ExplainedVolume, R_SP: Array, tip: Array) -> None:
    """Draw the 95 % confidence ellipse of the measured tip."""
    R_SW = R_SP @ RigidTransform(explained.X_WP).rotation().matrix().T
    values, vectors = np.linalg.eigh(R_SW @ explained.measured_tip_covariance @ R_SW.T)
    width, height = 2e3 * np.sqrt(squared_distance(0.95, 2) * values[::-1])
    angle = np.degrees(np.arctan2(vectors[1, -1], vectors[0, -1]))
    style = {"edgecolor": MEASURED, "linewidth": 1.5, "label": "measured tip, 95 %"}
    axes.add_patch(Ellipse((tip[0], tip[1]), width, height, angle=angle, fill=False, **style))


def _draw_profile(axes: Axes, explained: ExplainedVolume, needle: Array) -> None:
    """Draw the intensity along the axis."""
    axes.set_title("Intensity along the fitted axis", loc="left", fontsize=11)
    if not len(explained.profile):
        axes.text(0.5, 0.5, "no axis was found", ha="center", transform=axes.transAxes)
        axes.set_axis_off()
        return
    first = explained.profile_a[0]
    a = 1e3 * (explained.profile_a - first)
    unseen = ~explained.profile_seen
    level = np.where(unseen, np.nan, explained.profile_level)
    background = np.where(unseen, np.nan, explained.profile_background)
    axes.plot(a, level, color="0.1", linewidth=1.3, label="level")
    axes.plot(a, background, color=_QUIET, linewidth=1.0, label="background")
    if np.isfinite(explained.contrast):
        axes.plot(
            a, background + explained.contrast, color=_QUIET, linestyle="--", linewidth=1.0,
            label=f"threshold: {float(explained.contrast):.0f} dB over it",
        )  # fmt: skip
    if np.isfinite(explained.profile_before).any():
        axes.plot(
            a, background + explained.profile_before, color=ESTIMATE, linestyle=":", linewidth=1.6,
            label="before the needle came",
        )  # fmt: skip
    axes.fill_between(
        a, 0, 1, where=unseen, transform=axes.get_xaxis_transform(), color="0.9", linewidth=0,
        label="unseen" if unseen.any() else None,
    )  # fmt: skip
    if np.isfinite(explained.tip):
        start, tip = 1e3 * (np.array([explained.start, explained.tip]) - first)
        axes.axvspan(start, tip, color=MEASURED, alpha=0.12, label="taken for the needle")
        axes.axvline(tip, color=MEASURED, linewidth=1.4, label="tip found")
    edges = [a[0], a[-1]]
    if len(explained.predicted):
        at = _abscissa(a, 1e3 * explained.profile, 1e3 * explained.predicted[-1])
        axes.axvline(at, color=PREDICTED, linestyle="-.", linewidth=1.4, label="tip predicted")
        edges.append(at + 1)
    if len(needle):
        at = _abscissa(a, 1e3 * explained.to_probe(explained.profile), 1e3 * needle[-1])
        axes.axvline(at, color=TRUTH, linestyle="--", linewidth=1.6, label="true tip")
        edges.append(at + 1)
    axes.set_xlim(min(edges), max(edges))
    axes.set_xlabel("distance along the axis, mm")
    axes.set_ylabel("echo, dB")
    axes.grid(alpha=0.3)
    bottom, top = axes.get_ylim()
    axes.set_ylim(bottom, top + 0.3 * (top - bottom))
    axes.legend(fontsize=8, ncols=3, loc="upper center")


def _draw_classes(axes: Axes, explained: ExplainedVolume) -> None:
    """Draw what each of the most probable lines is by its motion alone, and say how it looks."""
    axes.set_title("Lines most like a needle: what they are by their motion alone", loc="left",
                   fontsize=11)  # fmt: skip
    names = [
        f"line {number:.0f}: needle {100 * probability:.0f} %\nlooks: log odds {looks:+.1f}"
        for number, probability, looks in zip(
            explained.line_numbers, explained.line_probabilities, explained.line_looks, strict=True
        )
    ]
    left = np.zeros(len(names))
    colours = {**LINE_COLOURS, "nothing": "0.93"}
    for each, share in zip(LINE_CLASSES, explained.line_classes.T, strict=True):
        axes.barh(names, share, left=left, color=colours[each], label=each)
        left = left + share
    axes.invert_yaxis()
    axes.set_xlim(0, 1)
    axes.set_ylim(len(names) - 0.4, -1.2)
    axes.set_xlabel(
        "probability by motion alone\n"
        "(the percentage at the left also weighs the looks and the lines nearby)"
    )
    axes.legend(fontsize=8, ncols=5, loc="upper center")


def _draw_history(axes: Axes, explained: ExplainedVolume, needle: Array) -> None:
    """Draw the contrasts along the most probable line, volume by volume: a needle advances."""
    number, probability = explained.line_numbers[0], explained.line_probabilities[0]
    axes.set_title(
        f"What was seen along line {number:.0f}, needle with {100 * probability:.0f} %",
        loc="left", fontsize=11,
    )  # fmt: skip
    times, a, history = explained.history_times, 1e3 * explained.history_a, explained.history
    now = times[-1]
    if len(times) == 1:  # the cells of a single volume would have no width
        times, history = (
            np.array([now - _BESIDE / 2, now + _BESIDE / 2]),
            np.repeat(history, 2, axis=0),
        )
    shown = axes.pcolormesh(
        times, a, history.T, cmap="cividis", vmin=-6, vmax=12, shading="nearest"
    )
    axes.set_facecolor("0.8")
    axes.figure.colorbar(shown, ax=axes, label="contrast, dB; grey: not seen")
    ends = explained.line_ends[0]
    length = 1e3 * float(np.linalg.norm(ends[1] - ends[0]))
    edges = [0.0, length]
    axes.hlines(edges, now - _BESIDE, now + _BESIDE, color=LINE, linewidth=2,
                label="ends in this volume")  # fmt: skip
    if len(needle):
        first, last = 1e3 * explained.to_probe(ends)
        k = (last - first) / np.linalg.norm(last - first)
        away = 1e3 * needle[-1] - first
        at = float(away @ k)
        axes.plot(now, at, marker="x", color=TRUTH, markersize=9, markeredgewidth=2,
                  linestyle="", label=f"true tip, {np.linalg.norm(away - at * k):.0f} mm "
                  "beside the line")  # fmt: skip
        edges.append(at)
    axes.set_ylim(min(edges) - 20, max(edges) + 20)
    axes.set_xlabel("time of the volumes remembered, s")
    axes.set_ylabel("along the line, mm from its outer end")
    axes.legend(fontsize=8, loc="upper left")


def _draw_gate(axes: Axes, explained: ExplainedVolume, kept: Sequence[ExplainedVolume]) -> None:
    """Draw the distances of measurements from their predictions, and the gate."""
    axes.set_title("Measurement against prediction", loc="left", fontsize=11)
    now = float(explained.volume_time)
    near = [each for each in kept if abs(each.volume_time - now) < 5]
    times, distance = (
        np.array([float(getattr(each, name)) for each in near])
        for name in ("volume_time", "innovation")
    )
    gate, nothing = float(explained.gate), times[np.isnan(distance)]
    axes.plot(times, distance, "o", color="0.3", markersize=5, label="measurement")
    axes.plot(nothing, 0 * nothing, "|", color="0.3", markersize=9, label="none compared")
    if np.isfinite(gate):
        axes.axhline(gate, color=MEASURED, linestyle="--", linewidth=1.3, label=f"gate {gate:.1f}")
    axes.axvline(now, color=PREDICTED, linewidth=6, alpha=0.3, label="this volume")
    axes.set_ylim(bottom=0, top=1.15 * max(np.nanmax([0, *distance]), gate if gate > 0 else 1))
    axes.set_xlabel("time of the kept volumes, s")
    axes.set_ylabel("Mahalanobis distance")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="best")


def _curve(points: Array) -> Array:
    """Return points along a curve, given its control points."""
    return NeedleCurve(points).position(np.linspace(0, 1, 31))


def _reaching(explained: ExplainedVolume) -> Array:
    """Return points along the region's axis, from one end of the region to the other."""
    curve = NeedleCurve(explained.region)
    chord = max(curve.chord, 1e-6)
    first = -float(explained.region_before) / chord
    last = 1 + float(explained.region_beyond) / chord
    return curve.position(np.linspace(first, last, 31))


def _outline(line: Array, radius: float) -> Array:
    """Return the outline of a band of a given radius around a line in a plane."""
    forward = np.gradient(line, axis=0)
    length = np.linalg.norm(forward, axis=1, keepdims=True)
    aside = radius * np.stack([-forward[:, 1], forward[:, 0]], axis=1) / np.maximum(length, 1e-9)
    return np.concatenate([line + aside, (line - aside)[::-1]])


def _abscissa(a: Array, points: Array, point: Array) -> float:
    """Return the abscissa of a point's projection onto a polyline, extended beyond its ends."""
    number = int(np.linalg.norm(points - point, axis=1).argmin())
    tangent = np.gradient(points, a, axis=0)[number]
    return float(a[number] + (point - points[number]) @ tangent)
