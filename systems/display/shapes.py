"""Polylines as rigid segments and tubes, and the outline of a sweep."""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import SurfaceTriangle, TriangleSurfaceMesh
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.signals.sweep import SweepGeometry


def resample(polyline: ArrayLike, points: int) -> NDArray[np.float64]:
    """Return (points, 3) equally spaced points along an (m, 3) polyline, both ends included."""
    polyline = np.asarray(polyline, dtype=float)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(polyline, axis=0), axis=1))])
    wanted = np.linspace(0, along[-1], points)
    return np.stack([np.interp(wanted, along, axis) for axis in polyline.T], axis=1)


def segment_pose(start: ArrayLike, end: ArrayLike) -> tuple[RigidTransform, float]:
    """Return pose and length of a cylinder between two points, its Z from start to end."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    length = float(np.linalg.norm(end - start))
    axis: Any = (end - start) / length if length > 0 else np.array([0.0, 0.0, 1.0])
    return RigidTransform(RotationMatrix.MakeFromOneVector(axis, 2), 0.5 * (start + end)), length


def sector_edges(geometry: SweepGeometry, points: int = 17) -> list[NDArray[np.float64]]:
    """Return the edges of the swept sector as polylines in P, in m: four rays, eight arcs."""
    # The motor's direction would change them by tenths of a degree.
    frames, lines, samples = (extent - 1 for extent in geometry.shape)
    k, j, i = (np.linspace(0, last, points) for last in (frames, lines, samples))
    edges = []
    for j_end in (0, lines):
        edges += [geometry.position(k, j_end, i_end, 1) for i_end in (0, samples)]
        edges += [geometry.position(k_end, j_end, i[[0, -1]], 1) for k_end in (0, frames)]
    for k_end in (0, frames):
        edges += [geometry.position(k_end, j, i_end, 1) for i_end in (0, samples)]
    return edges


def circle(radius: float) -> NDArray[np.float64]:
    """Return (33, 3) points around the Z axis, the first one again at the end."""
    turns = np.linspace(0, 2 * np.pi, 33)
    return radius * np.stack([np.cos(turns), np.sin(turns), np.zeros(33)], axis=1)


def tubes(polylines: list[NDArray[np.float64]], radius: float) -> TriangleSurfaceMesh:
    """Return triangular tubes around polylines as one mesh; WebGL draws lines only hair-thin."""
    vertices: list[Any] = []
    triangles: list[SurfaceTriangle] = []
    turns = 2 * np.pi * np.arange(3) / 3
    ring = radius * np.stack([np.cos(turns), np.sin(turns), np.zeros(3)])
    for polyline in polylines:
        for start, end in pairwise(polyline):
            X, _ = segment_pose(start, end)
            first = len(vertices)
            vertices += [*(start + (X.rotation() @ ring).T), *(end + (X.rotation() @ ring).T)]
            for a, b in ((0, 1), (1, 2), (2, 0)):
                triangles.append(SurfaceTriangle(first + a, first + b, first + b + 3))
                triangles.append(SurfaceTriangle(first + a, first + b + 3, first + a + 3))
    return TriangleSurfaceMesh(triangles, vertices)
