"""The leaf that draws a needle, its predicted shape and the newest slice in Meshcat."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.geometry import Cylinder, Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem
from scipy.ndimage import binary_fill_holes

from sonoservo.systems.display.colours import FORCE, MODE_COLOURS, STEEL, rgba
from sonoservo.systems.display.shapes import tubes
from sonoservo.systems.display.textured_quads import encode_webp, gltf_textured_quads
from sonoservo.systems.display.world.film import Film
from sonoservo.systems.display.world.label import Label
from sonoservo.systems.display.world.legend import Entry, draw_legend
from sonoservo.systems.display.world.magnified_path import Magnifier
from sonoservo.systems.display.world.needle_view import NeedleView
from sonoservo.systems.display.world.rod import Rod, Switch
from sonoservo.systems.display.world.scene import facing, set_scene
from sonoservo.systems.signals.confidence import RADIUS_95
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.needle_shape import NeedleShape
from sonoservo.systems.signals.planes import Plane, box_edges
from sonoservo.systems.signals.ports import declare_inputs, evaluate

_TISSUE = Rgba(0.55, 0.35, 0.30)
_PROBE = Rgba(0.85, 0.87, 0.9)
_AXIS = Rgba(0.35, 0.35, 0.38)
_PREDICTED = MODE_COLOURS[TrackingMode.TRACKING]
_TUBE = FORCE
_MEASURED = (0.0, 0.35, 0.65)
_SCALE, _LIFT = 5.0, 0.085
"""Magnification of the bend in the upper picture, and its distance above the needle, in m."""

_LEGEND: Sequence[Sequence[Entry]] = (
    (("needle, true", "needle", STEEL), ("predicted shape", "line", _PREDICTED)),
    (("95 % around it", "line", _TUBE), ("cross-section", "ellipse", _MEASURED)),
)
_LAYERS = (
    "tissue", "probe", "cross_section", "needle", "predicted", "tube", "slice", "magnified",
    "numbers", "legend",
)  # fmt: skip
_CAMERA, _TARGET = (0.24, -0.25, 0.13), (-0.01, 0.0, 0.015)
_ROD, _THIN = 1.5e-3, 1.0e-3
"""Radii of the drawn paths in m: to scale, above that of the needle, which would hide them, and
magnified."""
_SEGMENTS = 20
_NEEDLE_LENGTH = 0.2
"""Length of the needles in the paper, in m."""
_HANDLE, _AHEAD = 0.09, 0.015
"""Lengths of the drawn probe behind and ahead of its slice, in m."""
_EVERY = 5.0
"""Distance between slices in mm at which the numbers change; each text is a picture."""
_MARKS = 40
"""Most cross-sections that stay marked in the magnified picture."""


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

    ``needle`` is the true `Needle` in T, drawn in grey. The predicted shape has the colour of
    tracking and reaches from the first slice to the full depth. At each depth, the tube around it
    contains the needle with a probability of 95 %. A ball marks the newest cross-section. The
    probe is drawn at each slice.

    A bend of a few millimetres is hardly seen to scale. Above the tissue stands the same again with
    the deflection from a straight line magnified five times, true at every depth, with all
    cross-sections; and the bend in numbers.

    Parameters
    ----------
    meshcat
        Meshcat to draw in.
    tissue_size
        (3,) extents of the phantom in m.
    depth
        Depth down to which the shape is drawn, in m.
    probe_radius
        Radius of the probe's array, in m, for drawing the probe.
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
        probe_radius: float = 0.01,
        period: float,
        offset: float,
        path: str = "",
    ) -> None:
        super().__init__()
        self.set_name("shape_view")
        self._meshcat, self._path = meshcat, path
        self._size, self._period = np.array(tissue_size), period
        self._probe_radius = probe_radius
        self._depths = np.linspace(0, depth, _SEGMENTS + 1)
        self.DeclareAbstractInputPort("X_WT", Value(RigidTransform()))
        declare_inputs(
            self,
            needle=Needle,
            slice=(ImageSlice, NotFound),
            cross_section=(CrossSection, NotFound),
            shape=(NeedleShape, NotFound),
        )
        self._start()
        self.DeclareInitializationPublishEvent(publish=lambda context: self._start())
        self.DeclarePeriodicPublishEvent(period, offset, self._publish)
        self.DeclareForcedPublishEvent(self._publish)

    def _start(self) -> None:
        meshcat, path = self._meshcat, self._path
        for layer in _LAYERS:
            meshcat.Delete(f"{path}/{layer}")
        set_scene(meshcat, _CAMERA, _TARGET, 37.0)
        R_WL = facing(_CAMERA, _TARGET)
        X_WL = RigidTransform(R_WL, np.array(_TARGET)) @ RigidTransform([-0.085, 0.08, 0.0])
        draw_legend(meshcat, f"{path}/legend", X_WL, 0.14, _LEGEND)
        self._numbers = Label(meshcat=meshcat, path=f"{path}/numbers", height=0.01)
        X_WN = RigidTransform(R_WL, np.array(_TARGET)) @ RigidTransform([0.0, -0.1, 0.0])
        meshcat.SetTransform(f"{path}/numbers", X_WN)
        # Edges only: a browser may hide a translucent object that lies inside another one.
        edges = box_edges(self._size * [-0.5, -0.5, -1], self._size * [0.5, 0.5, 0])
        meshcat.SetObject(f"{path}/tissue", tubes(edges, 0.25e-3), _TISSUE)
        meshcat.SetObject(f"{path}/cross_section", Sphere(1.2e-3), rgba(_MEASURED))
        meshcat.SetProperty(f"{path}/cross_section", "visible", False)
        length = _HANDLE + _AHEAD
        meshcat.SetObject(f"{path}/probe/body", Cylinder(self._probe_radius, length), _PROBE)
        middle = [0.0, -self._probe_radius, 0.5 * (_AHEAD - _HANDLE)]
        meshcat.SetTransform(f"{path}/probe/body", RigidTransform(middle))
        meshcat.SetProperty(f"{path}/probe", "visible", False)
        self._needle: NeedleView | None = None  # until its radius is known
        self._magnifier: Magnifier | None = None  # until the first slice
        self._marked: list[float] = []
        self._said = -np.inf  # depth of the slice at which the numbers were written

        def rod(name: str, colour: Rgba, radius: float = _THIN) -> Rod:
            return Rod(
                meshcat=meshcat, path=f"{path}/{name}", radius=radius, colour=colour,
                segments=_SEGMENTS,
            )  # fmt: skip

        self._predicted = rod("predicted", rgba(_PREDICTED), _ROD)
        self._tube = rod("tube", rgba(_TUBE, 0.35))
        self._big = {
            "axis": rod("magnified/axis", _AXIS, 0.3e-3),
            "needle": rod("magnified/needle", rgba(STEEL)),
            "predicted": rod("magnified/predicted", rgba(_PREDICTED)),
            "tube": rod("magnified/tube", rgba(_TUBE, 0.35)),
        }
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
        X_WT = evaluate(self, context, "X_WT", RigidTransform)
        self._needle.draw(needle, X_WT, time)
        shape = evaluate(self, context, "shape", (NeedleShape, NotFound))
        if isinstance(shape, NeedleShape):
            polyline = shape.positions(self._depths)
            self._predicted.show(polyline, time)
            self._tube.show(polyline, time, radii=_ROD + self._half_width(shape))
        found = evaluate(self, context, "cross_section", (CrossSection, NotFound))
        path = f"{self._path}/cross_section"
        self._meshcat.SetProperty(path, "visible", isinstance(found, CrossSection), time)
        if isinstance(found, CrossSection):
            self._meshcat.SetTransform(path, RigidTransform(found.position), time)
        image = evaluate(self, context, "slice", (ImageSlice, NotFound))
        if isinstance(image, ImageSlice):
            self._meshcat.SetTransform(f"{self._path}/probe", image.X_WP, time)
            self._meshcat.SetProperty(f"{self._path}/probe", "visible", True, time)
            self._draw_slice(image, time)
            if needle:
                self._draw_magnified(needle.transformed(X_WT).shaft, shape, found, image, time)

    def _half_width(self, shape: NeedleShape) -> NDArray[np.float64]:
        middles = 0.5 * (self._depths[1:] + self._depths[:-1])
        return np.minimum(RADIUS_95 * shape.std(middles), 0.02)

    def _draw_magnified(
        self,
        shaft: NDArray[np.float64],
        shape: NeedleShape | NotFound,
        found: CrossSection | NotFound,
        image: ImageSlice,
        time: float,
    ) -> None:
        """Draw the paths with a magnified deflection, and write the bend in numbers."""
        if self._magnifier is None:
            p_I = image.X_WP.inverse().multiply(shaft.T).T
            start = [np.interp(0.0, p_I[:, 2], p_I[:, axis]) for axis in (0, 1)]
            self._magnifier = Magnifier(image.X_WP, start, scale=_SCALE, lift=_LIFT)
            self._first = image.X_WP
        magnified, big = self._magnifier, self._big
        big["axis"].show(magnified.axis(self._depths[[0, -1]]), time)
        inside = shaft[magnified.deflection(shaft)[:, 2] >= -1e-3]
        if len(inside) > 1:
            big["needle"].show(magnified(inside), time)
        if isinstance(found, CrossSection) and len(self._marked) < _MARKS:
            depth = float(magnified.deflection([found.position])[0, 2])
            if not self._marked or depth >= self._marked[-1] + self._depths[-1] / _MARKS:
                mark = f"{self._path}/magnified/marks/{len(self._marked)}"
                self._meshcat.SetObject(mark, Sphere(1.5e-3), rgba(_MEASURED))
                position = magnified([found.position])[0]
                self._meshcat.SetTransform(mark, RigidTransform(position))
                Switch(meshcat=self._meshcat, path=mark).set(True, time)
                self._marked.append(depth)
        bend = 1e3 * float(np.linalg.norm(magnified.deflection(shaft[-1:])[0, :2]))
        text = f"bend {bend:.1f} mm true"
        if isinstance(shape, NeedleShape):
            polyline = shape.positions(self._depths)
            big["predicted"].show(magnified(polyline), time)
            big["tube"].show(
                magnified(polyline), time, radii=_THIN + _SCALE * self._half_width(shape)
            )
            final = 1e3 * float(np.linalg.norm(magnified.deflection(polyline[-1:])[0, :2]))
            sure = 1e3 * RADIUS_95 * float(shape.std(self._depths[-1:])[0])
            end = f"{1e3 * self._depths[-1]:.0f} mm"
            text += f"; predicted at {end}: {final:.1f} mm, 95 % within {sure:.1f} mm"
        depth = 1e3 * float((self._first.inverse() @ image.X_WP).translation()[2])
        if depth >= self._said + _EVERY:
            self._numbers.show(f"above: bend x {_SCALE:g}; slice {depth:.0f} mm, {text}", time)
            self._said = depth

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
