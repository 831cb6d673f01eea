"""Contents of a scanner's monitor: two planes through the needle, scales and readings."""

from typing import Any

import numpy as np
from meshcat import Visualizer
from meshcat.commands import SetObject
from numpy.typing import NDArray
from pydrake.math import RotationMatrix

from sonoservo.systems.control.visual_features import needle_features
from sonoservo.systems.display.colours import MODE_COLOURS
from sonoservo.systems.display.monitor.lettering import PIXELS, line_image, scale_image
from sonoservo.systems.display.monitor.shapes import (
    Colour,
    at_depth,
    lettering,
    lines,
    overlay,
    patch,
    picture,
    rectangle,
    ribbons,
)
from sonoservo.systems.display.monitor.views import View, monitor_views
from sonoservo.systems.display.shapes import sector_edges
from sonoservo.systems.display.textured_quads import encode_png
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.planes import box_edges, sample_plane
from sonoservo.systems.signals.search_advice import search_advice
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

_MIN_PIXEL = 0.5e-3
"""Smallest pixel of the pictures, in m; otherwise a pixel is as large as a voxel."""

# Lengths in M, the screen's frame: see `monitor_views`.
_X_SCENE_M = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
_READINGS = np.array([0.07, -0.48])
_PROBE, _PROBE_SIZE = (0.42, 0.20, 0.5), 0.80  # middle of the volume as it stands in P; diagonal
_R_MP = RotationMatrix.MakeXRotation(-0.40) @ RotationMatrix.MakeYRotation(0.55)
_NEARER, _NEAREST = -0.01, -0.02

_STEPS = (1e-3, 2e-3, 5e-3, 10e-3, 20e-3, 50e-3, 100e-3)  # between the ticks of a scale, in m
_MIN_STEP = 0.035
_LINE, _RING = 0.7e-3, 2.5e-3  # width of the needle's line, radius of the ring at its tip, in m

_BRIGHT, _DIM, _FAINT = (0.92, 0.93, 0.95), (0.60, 0.62, 0.66), (0.25, 0.32, 0.40)

_TITLES = (
    ("lateral plane, Z = 0: depth, mm", "elevation plane, X = 0: depth, mm"),
    ("needle and beam: depth, mm", "needle, across the beam: mm from the middle"),
)
"""Titles of the two pictures, without and with a needle."""

_LAYOUT: dict[str, tuple[list[float], float, Colour]] = {
    "volume": ([0, 0], 0.045, _BRIGHT),
    "time": ([0.34, 0], 0.045, _BRIGHT),
    "mode": ([0.06, 0.08], 0.055, _BRIGHT),
    "tip": ([0, 0.17], 0.065, _BRIGHT),
    "features": ([0, 0.255], 0.032, _DIM),
    "reason": ([0, 0.305], 0.026, _DIM),
    "advice": ([0, 0.340], 0.020, _DIM),
}
"""Upper left corner, size and colour of each reading."""


class MonitorScreen:
    """Draws a scanner's monitor with the package meshcat.

    Parameters
    ----------
    visualizer
        Meshcat visualizer to draw with. The screen is 1.6 wide and 1 high, in the plane Y = 0 of
        its scene, seen along Y.
    """

    def __init__(self, visualizer: Visualizer) -> None:
        self._root = visualizer["monitor"]
        self._root.set_transform(_X_SCENE_M)
        self._drawn: dict[str, object] = {}

    def draw(self, volume: Volume, estimate: NeedleEstimate | None, number: int) -> None:
        """Show a volume.

        Parameters
        ----------
        volume, estimate
            Volume and estimate to show. Without a needle, the slices are the probe's own planes.
        number
            Number of the volume.
        """
        curve = estimate.curve if estimate is not None else None
        self._draw_readings(volume, estimate, number)
        self._draw_probe(volume)
        views = monitor_views(volume, curve)
        for row, name in enumerate(("first", "second")):
            shown = row < len(views)
            for path in (f"screen/{name}", f"probe/{name}"):
                self._set_visible(path, shown)
            if shown:
                self._draw_picture(name, views[row], volume)
                self._draw_needle(name, views[row], volume, estimate)
                self._draw_scales(name, views[row])
                title = _TITLES[curve is not None][row]
                at = np.array(views[row].corner) - [0, 0.04]
                self._write(f"screen/{name}/title", title, at, 0.026, _DIM)

    def _draw_picture(self, name: str, view: View, volume: Volume) -> None:
        """Draw a slice twice: flat on the screen, and at its place in P."""
        pixel = max(_MIN_PIXEL, float(volume.spacing.min()))
        png = encode_png(sample_plane(volume, view.plane, pixel), compression=1)
        size = np.array([view.plane.width, view.plane.height])
        corners = rectangle(-0.5 * size, size)
        p_P = view.plane.X_PS.multiply(corners.T).T
        flat = at_depth(view.on_screen(view.coordinates(p_P)))
        self._put(f"screen/{name}/picture", picture(flat, png))
        self._put(f"probe/{name}/picture", picture(p_P, png))

    def _draw_needle(
        self, name: str, view: View, volume: Volume, estimate: NeedleEstimate | None
    ) -> None:
        """Draw a line along the needle and a ring around its tip, on both pictures of a slice."""
        polylines: list[Floats] = []
        if estimate is not None and estimate.curve is not None:
            points = volume.to_probe(estimate.curve.position(np.linspace(0, 1, 41)))
            needle = view.coordinates(points)
            # The line ends where the ring begins, so that the echo of the tip is not hidden.
            outside = np.linalg.norm(needle - needle[-1], axis=1) >= _RING
            turns = np.linspace(0, 2 * np.pi, 33)
            ring = needle[-1] + _RING * np.stack([np.cos(turns), np.sin(turns)], axis=1)
            polylines = [needle[outside & view.holds(needle)]]
            if view.holds(needle[-1]):
                polylines.append(ring)
        vertices, faces = ribbons(polylines, _LINE)
        for place in ("screen", "probe"):
            path = f"{place}/{name}/needle"
            self._set_visible(path, len(faces) > 0)
            if estimate is not None and len(faces):
                flat = at_depth(view.on_screen(vertices), _NEARER)
                corners = flat if place == "screen" else view.in_probe(vertices)
                self._put(path, overlay(corners, faces, MODE_COLOURS[estimate.mode]))

    def _draw_scales(self, name: str, view: View) -> None:
        step = next((each for each in _STEPS if each * view.scale >= _MIN_STEP), _STEPS[-1])
        size = view.scale * (view.window[1] - view.window[0])
        for axis in (0, 1):
            low, high = view.window[:, axis]
            # A scale that has moved by less than a pixel stays as it is.
            ends = round(PIXELS * view.scale * low), round(PIXELS * view.scale * high), step
            path = f"screen/{name}/{'xy'[axis]}_scale"
            if self._is_new(path, ends):
                image = scale_image(low, high, step, size[axis], upright=axis == 1)
                extent = np.array(image.shape[1::-1]) / PIXELS
                beside = 0.5 * (size - extent)
                beside[1 - axis] = size[1] if axis == 0 else -extent[0]
                corners = rectangle(view.corner + beside, extent, _NEAREST)
                self._put(path, lettering(corners, image, _DIM))

    def _draw_readings(self, volume: Volume, estimate: NeedleEstimate | None, number: int) -> None:
        colour = MODE_COLOURS[estimate.mode] if estimate is not None else _FAINT
        if self._is_new("screen/mode_colour", colour):
            corners = rectangle(_READINGS + np.array([0, 0.092]), [0.04, 0.04])
            self._put("screen/mode_colour", patch(corners, colour))
        for name, text in readings(volume, estimate, number).items():
            at, size, ink = _LAYOUT[name]
            self._write(f"screen/{name}", text, _READINGS + at, size, ink)

    def _draw_probe(self, volume: Volume) -> None:
        """Draw the edges of the swept sector, or else of the grid, and the axes of P."""
        low, high = volume.origin, volume.upper
        geometry = volume.motion.geometry if volume.motion else None
        if not self._is_new("probe", (geometry, *low, *high)):
            return
        X = np.eye(4)
        X[:3, :3] = _PROBE_SIZE / np.linalg.norm(high - low) * _R_MP.matrix()
        X[:3, 3] = _PROBE - X[:3, :3] @ (0.5 * (low + high))
        self._root["probe"].set_transform(X)
        edges = sector_edges(geometry) if geometry is not None else box_edges(low, high)
        self._put("probe/outline", lines(edges, _FAINT))
        axes = np.diag(1.1 * np.maximum(high, 0.0))
        self._put("probe/axes", lines([np.stack([np.zeros(3), axis]) for axis in axes], _DIM))
        for letter, axis in zip("XYZ", axes, strict=True):
            at = (X[:3, :3] @ axis + X[:3, 3])[:2] + np.array([0.008, -0.02])
            self._write(f"screen/axis_{letter}", letter, at, 0.03, _DIM)

    def _write(self, path: str, text: str, at: Floats, size: float, colour: Colour) -> None:
        """Write a line of text, given its upper left corner and its size on the screen."""
        self._set_visible(path, bool(text))
        if text and self._is_new(path, (text, *at)):
            image = line_image(text, round(size * PIXELS))
            corners = rectangle(at, np.array(image.shape[1::-1]) / PIXELS, _NEAREST)
            self._put(path, lettering(corners, image, colour))

    def _put(self, path: str, thing: Any) -> None:
        node = self._root[path]
        node.window.send(SetObject(thing, path=node.path))

    def _set_visible(self, path: str, visible: bool) -> None:
        if self._is_new(f"{path}.visible", visible):
            self._root[path].set_property("visible", visible)

    def _is_new(self, path: str, key: object) -> bool:
        """Return True if a path did not show this so far, and remember that it does now."""
        if self._drawn.get(path) == key:
            return False
        self._drawn[path] = key
        return True


def readings(volume: Volume, estimate: NeedleEstimate | None, number: int) -> dict[str, str]:
    """Return the readings for a volume and the needle in it; a reading without a value is empty.

    The tip's depth is measured from the middle of the probe's face. X, Z and Theta are the features
    that the visual servo drives to zero (`needle_features`).
    """
    said = {
        "volume": f"volume {number}",
        "time": f"{volume.time:.2f} s",
        "mode": str(estimate.mode) if estimate is not None else "no tracker",
        "reason": estimate.reason if estimate is not None else "",
        "advice": "",
        "tip": "",
        "features": "",
    }
    if estimate is not None and estimate.curve is None:
        said["advice"] = search_advice(estimate.reason)
    if estimate is not None and estimate.curve is not None:
        entry, tip = volume.to_probe([estimate.curve.entry, estimate.curve.tip])
        x, z, theta = needle_features(tip, tip - entry) * [1e3, 1e3, np.rad2deg(1)]
        said["tip"] = f"tip depth {1e3 * tip[1]:.1f} mm"
        said["features"] = f"X {x:+z.1f} mm   Z {z:+z.1f} mm   Theta {theta:+z.1f} deg"
    return said
