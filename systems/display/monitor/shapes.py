"""Objects for the package meshcat: triangles, pictures, lines and lettering."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from meshcat.geometry import (
    Geometry,
    ImageTexture,
    LineBasicMaterial,
    LineSegments,
    Mesh,
    MeshBasicMaterial,
    PngImage,
    PointsGeometry,
    pack_numpy_array,
)
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.display.textured_quads import encode_png

Floats = NDArray[np.float64]
Colour = tuple[float, float, float]

_QUAD = np.array([[0, 1, 2], [0, 2, 3]])


class Triangles(Geometry):
    """Triangles, with texture coordinates if they carry a picture.

    Parameters
    ----------
    vertices
        (m, 3) corners.
    faces
        (k, 3) indices of the corners of each triangle.
    texture
        (m, 2) texture coordinates from 0 to 1, from left to right and from bottom to top.
    """

    def __init__(
        self, vertices: Floats, faces: NDArray[np.int64], texture: Floats | None = None
    ) -> None:
        super().__init__()
        self._vertices, self._faces, self._texture = vertices, faces, texture

    def lower(self, object_data: Any) -> dict[str, Any]:
        """Return the geometry in the form that three.js reads."""
        attributes = {"position": pack_numpy_array(self._vertices.T.astype(np.float32))}
        if self._texture is not None:
            attributes["uv"] = pack_numpy_array(self._texture.T.astype(np.float32))
        index = pack_numpy_array(self._faces.T.astype(np.uint32))
        data = {"attributes": attributes, "index": index}
        return {"uuid": self.uuid, "type": "BufferGeometry", "data": data}


def rectangle(corner: ArrayLike, size: ArrayLike, z: float = 0.0) -> Floats:
    """Return a rectangle's (4, 3) corners, clockwise from the upper left. Y runs down."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * np.asarray(size) + np.asarray(corner)
    return at_depth(corners, z)


def at_depth(points: Floats, z: float = 0.0) -> Floats:
    """Return (m, 2) points as (m, 3) points, all at the same Z."""
    return np.column_stack([points, np.full(len(points), z)])


def picture(corners: Floats, image: NDArray[np.uint8] | bytes) -> Mesh:
    """Return an unlit picture on a rectangle; pixels less than half opaque are not drawn.

    Parameters
    ----------
    corners
        (4, 3) corners: upper left, upper right, lower right and lower left.
    image
        Array for `encode_png`, or the contents of a PNG file.
    """
    return _picture(corners, image, alphaTest=0.5)


def lettering(corners: Floats, image: NDArray[np.uint8], colour: Colour) -> Mesh:
    """Return a white picture on a transparent background, coloured; parameters as in `picture`."""
    return _picture(corners, image, color=_hex(colour), transparent=True, depthWrite=False)


def _picture(corners: Floats, image: NDArray[np.uint8] | bytes, **options: object) -> Mesh:
    data = image if isinstance(image, bytes) else encode_png(image, compression=1)
    texture = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
    material = MeshBasicMaterial(map=ImageTexture(PngImage(data)), **options)
    return Mesh(Triangles(corners, _QUAD, texture), material)


def patch(corners: Floats, colour: Colour) -> Mesh:
    """Return a rectangle of one colour."""
    return Mesh(Triangles(corners, _QUAD), MeshBasicMaterial(color=_hex(colour)))


def overlay(vertices: Floats, faces: NDArray[np.int64], colour: Colour) -> Mesh:
    """Return triangles that nothing hides, from (m, 3) corners and (k, 3) indices."""
    material = MeshBasicMaterial(color=_hex(colour), transparent=True, depthTest=False)
    return Mesh(Triangles(vertices, faces), material)


def lines(polylines: Sequence[Floats], colour: Colour) -> LineSegments:
    """Return (m, 3) polylines as lines one pixel wide."""
    ends = [point for polyline in polylines for pair in pairwise(polyline) for point in pair]
    points = PointsGeometry(np.array(ends, np.float32).T)
    return LineSegments(points, LineBasicMaterial(color=_hex(colour)))


def ribbons(
    polylines: Sequence[Floats], width: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return (m, 2) vertices and (k, 3) triangles of flat bands along (n, 2) polylines."""
    pairs = [(each[:-1], each[1:]) for each in polylines if len(each) > 1]
    if not pairs:
        return np.zeros((0, 2)), np.zeros((0, 3), np.int64)
    start, end = (np.concatenate(each) for each in zip(*pairs, strict=True))
    along = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    across = 0.5 * width * np.stack([-along[:, 1], along[:, 0]], axis=1)
    vertices = np.stack([start - across, start + across, end + across, end - across], axis=1)
    faces = _QUAD + 4 * np.arange(len(start))[:, np.newaxis, np.newaxis]
    return vertices.reshape(-1, 2), faces.reshape(-1, 3)


def _hex(colour: Colour) -> int:
    red, green, blue = (round(255 * each) for each in colour)
    return red << 16 | green << 8 | blue
