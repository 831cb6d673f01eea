"""View of the probe frame with the package meshcat: the sector, the two slices and the needle."""

from typing import Any

import numpy as np
from meshcat import Visualizer
from meshcat.geometry import (
    Geometry,
    ImageTexture,
    LineBasicMaterial,
    LineSegments,
    Mesh,
    MeshBasicMaterial,
    PngImage,
    PointsGeometry,
    TriangularMeshGeometry,
)
from numpy.typing import NDArray

from sonoservo.systems.display.colours import MODE_COLOURS
from sonoservo.systems.display.shapes import sector_edges, tubes
from sonoservo.systems.display.textured_quads import encode_png
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.planes import box_edges, sample_sector, slice_planes
from sonoservo.systems.signals.volume import Volume

_SIZE = 1.0
"""Length of the volume's diagonal in the view."""

_PIXEL = 0.5e-3
_NEEDLE, _AXIS = 0.9e-3, 0.4e-3
"""Radii of the needle and the axes, in m."""

_AXES = ((0.94, 0.25, 0.25), (0.25, 0.75, 0.38), (0.31, 0.50, 1.0))
_LENGTH = 0.02
"""Length of the axes, in m."""


class ProbeView:
    """Draws volumes in the probe frame P with a `meshcat.Visualizer`."""

    def __init__(self, visualizer: Visualizer) -> None:
        self._root = visualizer["probe"]
        self._outline: object = None

    def draw(self, volume: Volume, estimate: NeedleEstimate | None) -> None:
        """Draw a volume's slices through the needle, or through the probe, and the needle."""
        curve = estimate.curve if estimate is not None else None
        self._draw_outline(volume)
        planes = slice_planes(volume, curve)
        for number in range(2):
            node = self._root[f"slice_{number}"]
            node.set_property("visible", number < len(planes))
            if number < len(planes):
                plane = planes[number]
                png = encode_png(sample_sector(volume, plane, _PIXEL), compression=1)
                texture = ImageTexture(PngImage(png))
                material = MeshBasicMaterial(map=texture, side=2, alphaTest=0.5)
                node.set_object(Mesh(_Rectangle(plane.width, plane.height), material))
                # The picture's first row is at its top, where Y of the slice is least.
                X = plane.X_PS.GetAsMatrix4() @ np.diag([1.0, -1.0, -1.0, 1.0])
                node.set_transform(X)
        node = self._root["needle"]
        node.set_property("visible", curve is not None)
        if curve is not None and estimate is not None:
            points = volume.to_probe(curve.position(np.linspace(0, 1, 21)))
            node.set_object(_tubes([points], _NEEDLE, MODE_COLOURS[estimate.mode]))

    def _draw_outline(self, volume: Volume) -> None:
        """Draw the edges of the swept sector, or else of the grid, and the axes of P."""
        low, high = volume.origin, volume.upper
        geometry = volume.motion.geometry if volume.motion else None
        key = geometry, *low, *high
        if key == self._outline:
            return
        self._outline = key
        X = np.eye(4)
        scale = _SIZE / np.linalg.norm(high - low)
        X[:3, :3] = scale * np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]])  # depth runs down
        X[:3, 3] = -X[:3, :3] @ (0.5 * (low + high))
        self._root.set_transform(X)
        edges = sector_edges(geometry) if geometry is not None else box_edges(low, high)
        ends = np.concatenate([np.stack([each[:-1], each[1:]], axis=1) for each in edges])
        lines = PointsGeometry(ends.reshape(-1, 3).T.astype(np.float32))
        self._root["outline"].set_object(LineSegments(lines, LineBasicMaterial(color=0x5F7488)))
        for axis, colour in zip(np.eye(3), _AXES, strict=True):
            ends = np.stack([np.zeros(3), _LENGTH * axis])
            self._root[f"axis_{np.argmax(axis)}"].set_object(_tubes([ends], _AXIS, colour))


class _Rectangle(Geometry):
    """A rectangle in the X-Y plane around its centre, which the package lacks."""

    def __init__(self, width: float, height: float) -> None:
        super().__init__()
        self._size = {"width": float(width), "height": float(height)}

    def lower(self, object_data: Any) -> dict[str, Any]:
        """Return the geometry in the form that three.js reads."""
        return {"uuid": self.uuid, "type": "PlaneGeometry", **self._size}


def _tubes(
    polylines: list[NDArray[np.float64]], radius: float, colour: tuple[float, float, float]
) -> Any:
    mesh = tubes(polylines, radius)
    vertices = np.array(mesh.vertices())
    faces = np.array(
        [[each.vertex(corner) for corner in range(3)] for each in mesh.triangles()], dtype=np.uint32
    )
    red, green, blue = (round(255 * each) for each in colour)
    material = MeshBasicMaterial(color=red << 16 | green << 8 | blue, side=2)
    return Mesh(TriangularMeshGeometry(vertices, faces), material)
