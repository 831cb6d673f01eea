"""Figure of one sweep: a frame as acquired, and slices through the needle."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial import KDTree

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.planes import Plane, slice_planes
from sonoservo.systems.signals.sweep import Sweep
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

_PIXEL = 0.2e-3
_CLEARANCE = 3e-3
"""Distance in m from the true needle's axis to the line around it; it leaves the echo in view."""

_INK, _QUIET, _PAPER, _NEEDLE = "#F2F2F2", "#9AA4AD", "#0E1116", "#FFB000"


@dataclass(frozen=True, eq=False)
class View:
    """Positions in P of the pixels of a picture, in m, and its labels."""

    title: str
    horizontal: str
    vertical: str
    p_P: Floats  # (rows, columns, 3)
    columns: Floats  # coordinates along the horizontal axis, in m
    rows: Floats  # along the vertical axis


def scan_sheet(sweep: Sweep, volume: Volume, needle: Needle, *, caption: str) -> Figure:
    """Return a figure of a frame in its sector, and of three slices with the true needle marked."""
    figure = Figure(figsize=(13, 9.6), facecolor=_PAPER, layout="constrained")
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.12)
    shaft = volume.to_probe(needle.shaft) if needle else np.zeros((0, 3))
    brightest = _brightest(sweep, shaft, needle.radius)
    views = [_frame_view(sweep, brightest), *_slice_views(volume, needle, brightest)]
    axes = figure.subplots(2, 2, gridspec_kw={"width_ratios": [1.12, 1]}).ravel()
    for each, view, letter in zip(axes, views, "abcd", strict=False):
        image = show_view(each, view, sweep, shaft, needle.radius)
        each.set_title(f"{letter})  {view.title}", loc="left", color=_INK, fontsize=11.5)
    for each in axes[len(views) :]:
        each.set_visible(False)
    bar = figure.colorbar(image, ax=axes, shrink=0.5, aspect=32, pad=0.02)
    decibels = np.arange(0, 255 * sweep.decibels_per_level + 1e-9, 10)
    bar.set_ticks(
        255 - decibels / sweep.decibels_per_level, labels=[f"{0 - d:.0f}" for d in decibels]
    )
    bar.set_label("echo amplitude, dB", color=_INK)
    bar.ax.tick_params(colors=_INK)
    bar.outline.set_edgecolor(_QUIET)
    figure.suptitle(caption, color=_INK, fontsize=12.5)
    if len(shaft):
        note = f"dotted: {1e3 * _CLEARANCE:.0f} mm around the true needle"
        figure.supxlabel(note, color=_NEEDLE, fontsize=9.5, x=0.99, ha="right")
    return figure


def show_view(axes: Axes, view: View, sweep: Sweep, shaft: Floats, radius: float) -> AxesImage:
    """Draw a view of a sweep."""
    grey = sweep.sample(view.p_P, outside=np.nan)
    inside = np.isfinite(grey)
    spans = [np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0)]
    rows, columns = (slice(span[0], span[-1] + 1) for span in spans)
    view = replace(
        view, p_P=view.p_P[rows, columns], columns=view.columns[columns], rows=view.rows[rows]
    )
    x, y = 1e3 * view.columns, 1e3 * view.rows
    half = 0.5e3 * _PIXEL
    extent = (x[0] - half, x[-1] + half, y[-1] + half, y[0] - half)
    image = axes.imshow(np.ma.masked_where(~inside, grey)[rows, columns], extent=extent,
                        cmap="gray", vmin=0, vmax=255, interpolation="bilinear")  # fmt: skip
    if len(shaft):
        _outline(axes, view, inside[rows, columns], shaft, radius)
    axes.set_facecolor(_PAPER)
    axes.set_anchor("W")
    axes.set_xlabel(f"{view.horizontal}, mm", color=_QUIET)
    axes.set_ylabel(f"{view.vertical}, mm", color=_QUIET)
    axes.tick_params(colors=_QUIET)
    for side, spine in axes.spines.items():
        spine.set_color(_QUIET)
        spine.set_visible(side in ("left", "bottom"))
    return image


def _points(shaft: Floats, radius: float) -> Floats:
    """Return points along a polyline, a fifth of a radius apart."""
    pieces = [
        np.linspace(a, b, int(np.ceil(np.linalg.norm(b - a) / (0.2 * radius))), endpoint=False)
        for a, b in itertools.pairwise(shaft)
    ]
    return np.concatenate([*pieces, shaft[-1:]])


def _brightest(sweep: Sweep, shaft: Floats, radius: float) -> Floats | None:
    """Return the brightest point on the needle's axis in P; None if none of it was swept."""
    if not len(shaft):
        return None
    points = _points(shaft, radius)
    grey = sweep.sample(points, outside=-1)
    return points[grey.argmax()] if grey.max() >= 0 else None


def _frame_view(sweep: Sweep, brightest: Floats | None) -> View:
    """Return a view of the frame through the needle's brightest point, or else the middle frame."""
    geometry, direction = sweep.geometry, sweep.motion.direction
    frame = geometry.frames // 2
    if brightest is not None:
        k, _, _ = geometry.index(brightest, direction)
        frame = int(np.clip(np.rint(k), 0, geometry.frames - 1))
    j = np.arange(geometry.lines)
    edges = [geometry.position(frame, j, i, direction) for i in (0, geometry.samples - 1)]
    x = np.concatenate(edges)[:, 0]
    rho = np.hypot(np.concatenate(edges)[:, 1] + geometry.motor_radius, np.concatenate(edges)[:, 2])
    columns = np.arange(x.min(), x.max() + _PIXEL, _PIXEL)
    rows = np.arange(rho.min(), rho.max() + _PIXEL, _PIXEL)
    q = rows[:, np.newaxis] + geometry.array_radius - geometry.motor_radius
    line = np.arctan2(columns, q) / geometry.line_pitch + (geometry.lines - 1) / 2
    sample_number = (np.hypot(columns, q) - geometry.array_radius) / geometry.sample_pitch
    p_P = geometry.position(frame, line, sample_number, direction)
    title = f"Frame {frame + 1} of {geometry.frames}, as the array acquires it"
    return View(title, "lateral", "depth", p_P, columns, rows - geometry.motor_radius)


def _slice_views(volume: Volume, needle: Needle, brightest: Floats | None) -> list[View]:
    nowhere = np.zeros(3)
    if brightest is None:
        across, along = slice_planes(volume)
        return [
            _plane_view(across, ("Slice at elevation 0", "lateral", "depth"), nowhere),
            _plane_view(along, ("Slice at lateral 0", "elevation", "depth"), nowhere),
        ]
    size, centre = volume.upper - volume.origin, 0.5 * (volume.upper + volume.origin)
    elevation, depth = np.array([0, 0, 1.0]), np.array([0, 1.0, 0])
    R_PS = RotationMatrix(np.stack([elevation, depth, np.cross(elevation, depth)], axis=1))
    centre[0] = brightest[0]
    beam, cross = slice_planes(volume, needle.curve)
    frames = Plane(RigidTransform(R_PS, centre), width=size[2], height=size[1])
    (tip,) = volume.to_probe(needle.tip[np.newaxis])
    name, axis = "Slice along the needle", "along the needle, from the tip"
    return [
        _plane_view(beam, (f"{name} and the beam", axis, "depth"), tip * [1, 0, 1]),
        _plane_view(cross, (f"{name}, across the beam", axis, "across it"), tip),
        _plane_view(frames, ("Slice across the frames", "elevation", "depth"), nowhere),
    ]


def _plane_view(plane: Plane, texts: tuple[str, str, str], origin: Floats) -> View:
    rows, columns = (int(np.ceil(size / _PIXEL)) for size in (plane.height, plane.width))
    p_P = plane.grid(rows, columns)
    u, v, _ = plane.X_PS.rotation().matrix().T
    return View(*texts, p_P, (p_P[0] - origin) @ u, (p_P[:, 0] - origin) @ v)


def _outline(
    axes: Axes, view: View, inside: NDArray[np.bool_], shaft: Floats, radius: float
) -> None:
    """Draw a line around the needle, and an arrow at its tip if the tip is in the picture."""
    distance, _ = KDTree(_points(shaft, radius)).query(view.p_P)
    x, y = 1e3 * view.columns, 1e3 * view.rows
    distance = np.ma.masked_where(~inside, distance)
    if distance.min() > _CLEARANCE:
        return
    axes.contour(
        x, y, distance, levels=[_CLEARANCE], colors=_NEEDLE, linewidths=0.9, linestyles="dotted"
    )
    away = np.linalg.norm(view.p_P - shaft[-1], axis=-1)
    row, column = np.unravel_index(away.argmin(), away.shape)
    if away[row, column] < radius and inside[row, column]:
        arrow = {"arrowstyle": "->", "color": _NEEDLE, "linewidth": 1.0, "shrinkB": 4}
        axes.annotate("tip", xy=(x[column], y[row]), xytext=(24, -30), textcoords="offset points",
                      color=_NEEDLE, fontsize=9, arrowprops=arrow)  # fmt: skip


_NAMES = ("X, along the array", "Y, along the sound", "Z, from frame to frame")
_VIEWS = ((0, 1), (2, 1), (0, 2))  # axes of P that run to the right and downwards in each picture

_BODY = (("head (S)", (0, 0, 1)), ("left (L)", (1, 0, 0)), ("back (P)", (0, 1, 0)))
"""Directions of the body in LPS."""

_IN_PLANE = 0.6  # part of a direction that lies in a picture, from which it is drawn there


def orientation_sheet(volume: Volume, R_LP: RotationMatrix, *, caption: str = "") -> Figure:
    """Return a figure of the three middle planes of a volume."""
    low, high = 1e3 * volume.origin, 1e3 * volume.upper
    middle, size = [n // 2 for n in volume.intensities.shape], high - low
    widths, highest = [float(size[right]) for right, _ in _VIEWS], float(size[1:].max())
    # All have one scale, with room for their labels.
    inches = 9 / sum(widths)
    height = float(np.clip(inches * highest, 2, 10)) + 1.6
    figure = Figure(figsize=(12, height), layout="constrained")
    panels = figure.subplots(1, 3, width_ratios=widths)
    for axes, (right, down) in zip(panels, _VIEWS, strict=True):
        (other,) = {0, 1, 2} - {right, down}
        cut: NDArray[np.generic] = np.take(volume.intensities, middle[other], axis=other)
        shown = cut.T if right < down else cut
        extent = (low[right], high[right], high[down], low[down])
        axes.imshow(shown, cmap="gray", vmin=0, vmax=255, extent=extent)
        axes.set_xlabel(f"{_NAMES[right]}, mm")
        axes.set_ylabel(f"{_NAMES[down]}, mm")
        if down == 1:
            axes.set_title("probe at the top")
        for name, direction in _BODY:
            part = (R_LP.matrix().T @ np.array(direction, float))[[right, down]]
            if np.linalg.norm(part) < _IN_PLANE:
                continue
            x, y = part / np.linalg.norm(part) * [1, -1]
            arrow = {"arrowstyle": "->", "color": _NEEDLE}
            axes.annotate("", xy=(0.5 + 0.2 * x, 0.5 + 0.3 * y), xytext=(0.5, 0.5),
                          xycoords="axes fraction", arrowprops=arrow)  # fmt: skip
            axes.text(0.5 + 0.22 * x, 0.5 + 0.34 * y, name, color=_NEEDLE, va="center",
                      ha="center" if abs(x) < 0.5 else "left" if x > 0 else "right",
                      transform=axes.transAxes)  # fmt: skip
    if caption:
        figure.supxlabel(caption, fontsize=9)
    return figure
