"""Screen of a shape prediction in Meshcat: needle, predicted shape and newest slice."""

from collections.abc import Sequence

import numpy as np
from pydrake.geometry import Box, Cylinder, Meshcat, Rgba
from pydrake.math import RigidTransform
from scipy.ndimage import binary_fill_holes

from sonoservo.systems.display.colours import CROSS_SECTION, ESTIMATE, rgba
from sonoservo.systems.display.shape_view import ShapeSight
from sonoservo.systems.display.shapes import circle, tubes
from sonoservo.systems.display.textured_quads import encode_webp, gltf_textured_quads
from sonoservo.systems.display.world.needle_view import RING, NeedleView
from sonoservo.systems.display.world.parts import Film, Rod, set_scene
from sonoservo.systems.signals.confidence import RADIUS_95
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.needle_shape import NeedleShape
from sonoservo.systems.signals.planes import Plane, box_edges
from sonoservo.systems.signals.sweep import SweepGeometry

_TISSUE, _PROBE = Rgba(0.55, 0.35, 0.30), Rgba(0.85, 0.87, 0.9)
_LAYERS = ("tissue", "probe", "cross_section", "needle", "predicted", "tube", "slice")
_ROD = 1.5e-3  # Radius of the drawn path in m, above that of the needle, which would hide it
_SEGMENTS = 20
_NEEDLE_LENGTH = 0.2  # Length of the needles in the paper, in m
_HANDLE, _AHEAD = 0.09, 0.015  # Lengths of the drawn probe behind and ahead of its slice, in m
_ROUND = 0.03  # Radius in m up to which an array lies around an endocavity probe; others are flat
_FIELD_OF_VIEW_DEG = 30.0
_FILM_PERIOD = 0.2  # Smallest time between two pictures kept for the replay, in s


class ShapeWorld:
    """Draws a needle, its predicted shape with the tube of its uncertainty, and the newest slice.

    The true needle is blue. The predicted shape is orange, as estimates are, and reaches from the
    first slice to the full `depth` in m; at each depth, the tube around it contains the needle with
    a probability of 95 %. A ring marks the newest cross-section, and the probe, of a sweep's
    geometry, is drawn at each slice. The phantom has (3,) extents in m.
    """

    def __init__(
        self,
        *,
        meshcat: Meshcat,
        tissue_size: Sequence[float],
        depth: float,
        geometry: SweepGeometry,
        path: str = "",
    ) -> None:
        self._meshcat, self._path = meshcat, path
        self._size = np.array(tissue_size)
        self._geometry = geometry
        self._depths = np.linspace(0, depth, _SEGMENTS + 1)

    def start(self) -> None:
        """Draw what stands still, and hide what is not there yet."""
        meshcat, path = self._meshcat, self._path
        for layer in _LAYERS:
            meshcat.Delete(f"{path}/{layer}")
        self._aim()
        # Edges only: a browser may hide a translucent object that lies inside another one.
        edges = box_edges(self._size * [-0.5, -0.5, -1], self._size * [0.5, 0.5, 0])
        meshcat.SetObject(f"{path}/tissue", tubes(edges, 0.25e-3), _TISSUE)
        ring = tubes([circle(RING)], 5e-4)
        meshcat.SetObject(f"{path}/cross_section", ring, rgba(CROSS_SECTION))
        meshcat.SetProperty(f"{path}/cross_section", "visible", False)
        self._draw_probe()
        self._needle: NeedleView | None = None  # until its radius is known
        self._predicted, self._tube = (
            Rod(
                meshcat=meshcat, path=f"{path}/{name}", radius=_ROD, colour=colour,
                segments=_SEGMENTS,
            )
            for name, colour in (
                ("predicted", rgba(ESTIMATE)),
                ("tube", rgba(ESTIMATE, 0.35)),
            )
        )  # fmt: skip
        self._film = Film(meshcat=meshcat, path=f"{path}/slice", frames=400, period=_FILM_PERIOD)

    def _aim(self) -> None:
        """Place the camera so that the whole box is in view, from the side of the needle."""
        middle = self._size * [0.0, 0.0, -0.5]
        # Room for the box's diagonal, and for a window that is higher than it is wide.
        reach = 0.8 * np.linalg.norm(self._size) / np.tan(np.deg2rad(_FIELD_OF_VIEW_DEG / 2))
        sight = np.array([0.80, -0.62, 0.45])
        camera = middle + reach * sight / np.linalg.norm(sight)
        set_scene(self._meshcat, camera.tolist(), middle.tolist(), _FIELD_OF_VIEW_DEG)

    def _draw_probe(self) -> None:
        """Draw the probe: a rod with the array around its axis, or a flat head above its slice."""
        radius, body = self._geometry.array_radius, f"{self._path}/probe/body"
        if radius <= _ROUND:
            shape: Cylinder | Box = Cylinder(radius, _HANDLE + _AHEAD)
            middle = [0.0, -radius, 0.5 * (_AHEAD - _HANDLE)]
        else:
            last = self._geometry.lines - 1
            width = 2 * abs(self._geometry.position(0, last, 0, 1)[0])
            shape, middle = Box(1.1 * width, 0.5 * _HANDLE, _AHEAD), [0.0, -0.25 * _HANDLE, 0.0]
        self._meshcat.SetObject(body, shape, _PROBE)
        self._meshcat.SetTransform(body, RigidTransform(middle))
        self._meshcat.SetProperty(f"{self._path}/probe", "visible", False)

    def show(self, seen: ShapeSight) -> None:
        """Draw what is there now."""
        time, found, image = seen.time, seen.found, seen.image
        if self._needle is None:
            self._needle = NeedleView(
                meshcat=self._meshcat, path=f"{self._path}/needle",
                length=_NEEDLE_LENGTH, radius=seen.needle.radius,
            )  # fmt: skip
        self._needle.draw(seen.needle, seen.X_WT, time)
        if isinstance(seen.shape, NeedleShape):
            polyline = seen.shape.positions(self._depths)
            middles = 0.5 * (self._depths[1:] + self._depths[:-1])
            self._predicted.show(polyline, time)
            self._tube.show(polyline, time, radii=_ROD + RADIUS_95 * seen.shape.std(middles))
        path = f"{self._path}/cross_section"
        self._meshcat.SetProperty(path, "visible", isinstance(found, CrossSection), time)
        if isinstance(image, ImageSlice):
            if isinstance(found, CrossSection):
                X = RigidTransform(image.X_WP.rotation(), found.position)
                self._meshcat.SetTransform(path, X, time)
            self._meshcat.SetTransform(f"{self._path}/probe", image.X_WP, time)
            self._meshcat.SetProperty(f"{self._path}/probe", "visible", True, time)
            self._draw_slice(image, time)

    def _draw_slice(self, image: ImageSlice, time: float) -> None:
        shape = np.array(image.intensities.shape)
        middle = image.position(0.5 * (shape - 1))
        X_WS = image.X_WP @ RigidTransform([*middle, 0.0])
        plane = Plane(X_WS, *(shape * image.spacing))
        grey = image.intensities.T
        # Black speckle inside the picture must not become a hole.
        opacity = np.where(binary_fill_holes(grey > 0), np.uint8(255), np.uint8(0))
        gltf = gltf_textured_quads([plane], [encode_webp(np.stack([grey, opacity], axis=-1))])
        self._film.show(gltf, time)
