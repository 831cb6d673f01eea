"""Surface of a needle's tip, in pieces that mirror sound together."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.ultrasound.simulation.axes import frame_along

FACES = {"bevel": 1, "diamond": 3, "blunt": 0}
"""Number of faces of each kind of tip."""

Floats = NDArray[np.float64]


class NeedleTip(NamedTuple):
    """Pieces of a tip's surface in the needle's frame: along the needle, across it, and up."""

    points: Floats
    """(n, 3) positions from the foremost point's place on the axis, in m."""
    normals: Floats
    """(n, 3) outward unit normals."""
    areas: Floats
    """(n,) areas, in m^2."""


def tip_surface(tip: str, bevel: float, radius: float, length: float, spacing: float) -> NeedleTip:
    """Divide the last ``length`` m of a needle into pieces at most ``spacing`` m apart.

    At a roll of 0, the first face looks up; ``bevel`` is the angle between a face and the axis in
    rad.
    """
    count = FACES[tip]
    turns = 2 * np.pi * np.arange(count) / max(count, 1)
    # One face passes through the foremost point of the wall, three meet on the axis.
    start = -radius if count == 1 else 0.0
    slope = np.tan(bevel)

    def inside(behind: Floats, across: Floats, up: Floats, width: float, but: int = -1) -> Floats:
        """Return the share of each piece that lies behind all faces but one."""
        share = np.ones(np.shape(across))
        for number, turn in enumerate(turns):
            if number != but:
                beyond = start + behind * slope - (np.cos(turn) * up + np.sin(turn) * across)
                share = share * np.clip(beyond / width + 0.5, 0, 1)
        return share

    def steps(low: float, high: float) -> tuple[Floats, float]:
        number = max(int(np.ceil((high - low) / spacing)), 1)
        return low + (np.arange(number) + 0.5) * (high - low) / number, (high - low) / number

    behind, ahead = steps(0.0, length)
    angles, turned = steps(0.0, 2 * np.pi * radius)
    s, a = (each.ravel() for each in np.meshgrid(behind, angles / radius))
    around = np.stack([np.zeros(len(s)), np.sin(a), np.cos(a)], axis=1)
    places = radius * around - s[:, np.newaxis] * [1, 0, 0]
    share = inside(s, places[:, 1], places[:, 2], max(ahead * slope, 1e-9))
    parts = [(places, around, share * ahead * turned)]
    across, width = steps(-radius, radius)
    for number, turn in enumerate(turns):
        s, w = (each.ravel() for each in np.meshgrid(behind, across))
        height = start + s * slope
        outwards = np.array([0, np.sin(turn), np.cos(turn)])
        sideways = np.array([0, np.cos(turn), -np.sin(turn)])
        places = np.outer(height, outwards) + np.outer(w, sideways) - np.outer(s, [1, 0, 0])
        half = np.sqrt(np.maximum(radius**2 - height**2, 0)) * (np.abs(height) < radius)
        share = np.clip((half - np.abs(w)) / width + 0.5, 0, 1) * (half > 0)
        share *= inside(s, places[:, 1], places[:, 2], width, number)
        normal = np.sin(bevel) * np.array([1.0, 0, 0]) + np.cos(bevel) * outwards
        areas = share * ahead * width / np.cos(bevel)
        parts.append((places, np.broadcast_to(normal, places.shape), areas))
    if not count:
        a, b = (each.ravel() for each in np.meshgrid(across, across))
        share = np.clip((radius - np.hypot(a, b)) / width + 0.5, 0, 1)
        disc = np.stack([np.zeros(len(a)), a, b], axis=1)
        parts.append((disc, np.broadcast_to([1.0, 0, 0], disc.shape), share * width**2))
    points, normals, areas = (np.concatenate(each) for each in zip(*parts, strict=True))
    kept = areas > 0
    return NeedleTip(points[kept], normals[kept], areas[kept])


def width_left(tip: str, length: float, spacing: float, count: int) -> Floats:
    """Return (count,) widths of a tip, from its end, relative to the diameter.

    Places are ``spacing`` m apart. A bevel is seen from its face or from its back, and a diamond's
    cross-section is a triangle.
    """
    share = (np.arange(count) + 0.5) * spacing / max(length, spacing)
    if tip == "blunt":
        return np.ones(count)
    if tip == "diamond":
        return np.minimum(np.sqrt(3) * share, 1)
    return np.sqrt(1 - np.minimum(2 * share - 1, 0) ** 2)


def tip_axes(direction: Floats, roll: float) -> Floats:
    """Return (3, 3) axes as rows: along a needle, across it and up, turned by its roll in rad."""
    along, across, up = frame_along(direction)
    c, s = np.cos(roll), np.sin(roll)
    return np.array([along, c * across - s * up, c * up + s * across])
