"""The leaf that draws a needle, its predicted shape and the newest slice in Meshcat."""

from collections.abc import Sequence

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem
from scipy.ndimage import binary_fill_holes

from sonoservo.systems.display.colours import FORCE, MODE_COLOURS, STEEL, rgba
from sonoservo.systems.display.shapes import tubes
from sonoservo.systems.display.textured_quads import encode_webp, gltf_textured_quads
from sonoservo.systems.display.world.film import Film
from sonoservo.systems.display.world.legend import Entry, draw_legend
from sonoservo.systems.display.world.needle_view import NeedleView
from sonoservo.systems.display.world.rod import Rod
from sonoservo.systems.display.world.scene import facing, set_scene
from sonoservo.systems.signals.confidence import RADIUS_95
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.needle_shape import NeedleShape
from sonoservo.systems.signals.planes import Plane, box_edges
from sonoservo.systems.signals.ports import evaluate

_TISSUE = Rgba(0.55, 0.35, 0.30)
_PREDICTED = MODE_COLOURS[TrackingMode.TRACKING]
_TUBE = FORCE
_MEASURED = MODE_COLOURS[TrackingMode.LOST]
_LEGEND: Sequence[Sequence[Entry]] = (
    (("needle, true", "needle", STEEL), ("predicted shape", "line", _PREDICTED)),
    (("95 % around it", "line", _TUBE), ("cross-section", "ellipse", _MEASURED)),
)
_LAYERS = ("tissue", "cross_section", "needle", "predicted", "tube", "slice", "legend")
_CAMERA, _TARGET = (0.11, -0.122, 0.03), (0.01, 0.008, -0.028)
_ROD = 0.75e-3
"""Radius of the predicted needle in m, slightly above that of the true one, which it may hide."""
_SEGMENTS = 20
_NEEDLE_LENGTH = 0.2
"""Length of the needles in the paper, in m."""


class ShapeView(LeafSystem):
    """Draws a needle, its predicted shape with the tube of its uncertainty, and the newest slice.

    .. pydrake_system::

        name: ShapeView
        input_ports:
        - needle
        - X_WT
        - slice
        - cross_section
        - shape

    ``needle`` is the true `Needle` in T, drawn in grey. The predicted shape is red and reaches from
    the first slice to the full depth. At each depth, the tube around it contains the needle with a
    probability of 95 %. A blue ball marks the newest cross-section.

    Parameters
    ----------
    meshcat
        Meshcat to draw in.
    tissue_size
        (3,) extents of the phantom in m.
    depth
        Depth down to which the shape is drawn, in m.
    period, offset
        Period of the pictures and time of the first one, in s: shortly after the estimator's
        events.
    path
        Path of everything that is drawn; by default the layers are at the top of the scene.
    """

    def __init__(
        self,
        *,
        meshcat: Meshcat,
        tissue_size: Sequence[float],
        depth: float,
        period: float,
        offset: float,
        path: str = "",
    ) -> None:
        super().__init__()
        self.set_name("shape_view")
        self._meshcat, self._path = meshcat, path
        self._size, self._period = np.array(tissue_size), period
        self._depths = np.linspace(0, depth, _SEGMENTS + 1)
        self.DeclareAbstractInputPort("X_WT", Value(RigidTransform()))
        for name in ("needle", "slice", "cross_section", "shape"):
            self.DeclareAbstractInputPort(name, Value[object]())
        self._start()
        self.DeclareInitializationPublishEvent(publish=lambda context: self._start())
        self.DeclarePeriodicPublishEvent(period, offset, self._publish)
        self.DeclareForcedPublishEvent(self._publish)

    def _start(self) -> None:
        meshcat, path = self._meshcat, self._path
        for layer in _LAYERS:
            meshcat.Delete(f"{path}/{layer}")
        set_scene(meshcat, _CAMERA, _TARGET, 52.0)
        R_WL = facing(_CAMERA, _TARGET)
        X_WL = RigidTransform(R_WL, np.array(_TARGET)) @ RigidTransform([-0.04, -0.08, 0.0])
        draw_legend(meshcat, f"{path}/legend", X_WL, 0.12, _LEGEND)
        # Edges only: a browser may hide a translucent object that lies inside another one.
        edges = box_edges(self._size * [-0.5, -0.5, -1], self._size * [0.5, 0.5, 0])
        meshcat.SetObject(f"{path}/tissue", tubes(edges, 0.25e-3), _TISSUE)
        meshcat.SetObject(f"{path}/cross_section", Sphere(1.2e-3), rgba(_MEASURED))
        meshcat.SetProperty(f"{path}/cross_section", "visible", False)
        self._needle: NeedleView | None = None  # until its radius is known
        self._predicted = Rod(
            meshcat=meshcat, path=f"{path}/predicted", radius=_ROD, colour=rgba(_PREDICTED),
            segments=_SEGMENTS,
        )  # fmt: skip
        self._tube = Rod(
            meshcat=meshcat,
            path=f"{path}/tube",
            radius=1e-3,
            colour=rgba(_TUBE, 0.35),
            segments=_SEGMENTS,
        )
        self._film = Film(
            meshcat=meshcat, path=f"{path}/slice", frames=400, period=max(0.2, self._period)
        )

    def _publish(self, context: Context) -> None:
        time = context.get_time()
        needle = evaluate(self, context, "needle", Needle)
        if self._needle is None:
            self._needle = NeedleView(
                meshcat=self._meshcat, path=f"{self._path}/needle",
                length=_NEEDLE_LENGTH, radius=needle.radius,
            )  # fmt: skip
        self._needle.draw(needle, evaluate(self, context, "X_WT", RigidTransform), time)
        shape = evaluate(self, context, "shape", (NeedleShape, NotFound))
        if isinstance(shape, NeedleShape):
            polyline = shape.positions(self._depths)
            middles = 0.5 * (self._depths[1:] + self._depths[:-1])
            self._predicted.show(polyline, time)
            width = RADIUS_95 * shape.std(middles) + _ROD
            self._tube.show(polyline, time, radii=np.minimum(width, 0.02))
        found = evaluate(self, context, "cross_section", (CrossSection, NotFound))
        path = f"{self._path}/cross_section"
        self._meshcat.SetProperty(path, "visible", isinstance(found, CrossSection), time)
        if isinstance(found, CrossSection):
            self._meshcat.SetTransform(path, RigidTransform(found.position), time)
        image = evaluate(self, context, "slice", (ImageSlice, NotFound))
        if isinstance(image, ImageSlice):
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
