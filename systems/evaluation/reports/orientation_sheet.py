"""Picture of a volume that marks the probe's side and the directions of the body."""

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydrake.math import RotationMatrix

from sonoservo.systems.signals.volume import Volume

_NAMES = ("X, along the array", "Y, along the sound", "Z, from frame to frame")
_VIEWS = ((0, 1), (2, 1), (0, 2))  # axes of P that run to the right and downwards in each picture

_BODY = (("up (S)", (0, 0, 1)), ("left (L)", (1, 0, 0)), ("back (P)", (0, 1, 0)))
"""Directions of the body in LPS."""

_INK = "#FFB000"
_IN_PLANE = 0.6  # part of a direction that lies in a picture, from which it is drawn there


def orientation_sheet(volume: Volume, R_LP: RotationMatrix, *, caption: str = "") -> Figure:
    """Return a figure of the three middle planes of a volume."""
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    low, high = 1e3 * volume.origin, 1e3 * volume.upper
    middle = [n // 2 for n in volume.intensities.shape]
    for axes, (right, down) in zip(figure.subplots(1, 3), _VIEWS, strict=True):
        (other,) = {0, 1, 2} - {right, down}
        cut: NDArray[np.generic] = np.take(volume.intensities, middle[other], axis=other)
        shown = cut.T if right < down else cut
        extent = (low[right], high[right], high[down], low[down])
        axes.imshow(shown, cmap="gray", vmin=0, vmax=255, extent=extent)
        axes.set_xlabel(f"{_NAMES[right]}, mm")
        axes.set_ylabel(f"{_NAMES[down]}, mm")
        if down == 1:
            axes.set_title("the probe is here, at the top")
        for name, direction in _BODY:
            part = (R_LP.matrix().T @ np.array(direction, float))[[right, down]]
            if np.linalg.norm(part) < _IN_PLANE:
                continue
            x, y = part / np.linalg.norm(part) * [1, -1]
            arrow = {"arrowstyle": "->", "color": _INK}
            axes.annotate(
                "", xy=(0.5 + 0.3 * x, 0.5 + 0.3 * y), xytext=(0.5, 0.5),
                xycoords="axes fraction", arrowprops=arrow,
            )  # fmt: skip
            axes.text(
                0.5 + 0.38 * x, 0.5 + 0.35 * y, name, color=_INK, transform=axes.transAxes,
                ha="center", va="center",
            )  # fmt: skip
    if caption:
        figure.supxlabel(caption, fontsize=9)
    return figure
