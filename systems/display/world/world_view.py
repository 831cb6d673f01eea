"""The leaf that draws the needle, its estimate and the ultrasound slices in Meshcat."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.display.colours import MODE_COLOURS, SECTOR, UNCERTAINTY, ink, rgba
from sonoservo.systems.display.shapes import sector_edges, tubes
from sonoservo.systems.display.textured_quads import encode_webp, gltf_textured_quads
from sonoservo.systems.display.world.ellipsoid import EllipsoidView
from sonoservo.systems.display.world.film import Film
from sonoservo.systems.display.world.force_arrow import ForceArrow
from sonoservo.systems.display.world.label import Label
from sonoservo.systems.display.world.legend import WORLD_LEGEND, draw_legend
from sonoservo.systems.display.world.needle_view import EstimateView, NeedleView
from sonoservo.systems.display.world.scene import set_scene
from sonoservo.systems.display.world.screen import Screen, facing
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.planes import sample_plane, slice_planes
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.requirements import require, require_not_negative, require_positive
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.signals.volume import Volume

_LAYERS = (
    "needle", "estimate", "uncertainty", "sector", "slices", "screen", "phase", "force", "legend"
)  # fmt: skip
_WAITING = "waiting for the first volume"
_BESIDE = 0.045
"""From the middle of the probe's face to the arrow of the force, in m: clear of the housing."""


@dataclass(kw_only=True)
class WorldViewParameters:
    """How the world is shown.

    Parameters
    ----------
    publish_period
        Between two pictures, in s.
    pixel
        Of the slices, in m.
    film_frames
        Most slices kept for a replay, about 15 KB each; 0 where none is wanted.
    film_period
        Least time between slices kept, in s: it bounds the size of the replay.
    needle_length
        Of the whole needle, in m: what is not in the tissue is drawn outside it.
    camera, camera_target
        Where the view begins, in W, in m.
    field_of_view_deg
        Of the camera, from the lower edge of the view to the upper one.
    screen_position
        Of the middle of the screen that shows the slices upright, in W, in m. Above it stands the
        tracking mode, below it the legend. By default all three are clear of the open controls of a
        page that is at least 1.6 times as wide as it is high, and 1280 pixels wide.
    screen_size
        Its width and height, in m.
    """

    publish_period: float = 3 / 32
    pixel: float = 1e-3
    film_frames: int = 0
    film_period: float = 0.2
    needle_length: float = 0.15
    camera: list[float] = field(default_factory=lambda: [0.74, -0.74, 0.52])
    camera_target: list[float] = field(default_factory=lambda: [0.60, 0.0, 0.25])
    field_of_view_deg: float = 36.0
    screen_position: list[float] = field(default_factory=lambda: [0.745, 0.06, 0.28])
    screen_size: list[float] = field(default_factory=lambda: [0.18, 0.215])

    def __post_init__(self) -> None:
        require_positive(
            publish_period=self.publish_period,
            pixel=self.pixel,
            needle_length=self.needle_length,
        )
        require_not_negative(film_frames=self.film_frames, film_period=self.film_period)
        for name in ("screen_position", "camera", "camera_target"):
            require(len(getattr(self, name)) == 3, name, getattr(self, name), "three numbers")
        size = self.screen_size
        require(len(size) == 2 and min(size) > 0, "screen_size", size, "two numbers above 0")
        angle = self.field_of_view_deg
        require(0 < angle < 180, "field_of_view_deg", angle, "between 0 and 180")

    @property
    def X_WScreen(self) -> RigidTransform:
        """Pose of the screen: it shows the camera its face, X to the right, Y down."""
        R = facing(self.camera, self.camera_target)
        return RigidTransform(R, np.array(self.screen_position))


class WorldView(LeafSystem):
    """Draws the needle, what the tracker believes, and slices through the needle in Meshcat.

    .. pydrake_system::

        name: WorldView
        input_ports:
        - X_WP
        - X_WT
        - needle (optional)
        - estimate (optional)
        - volume (optional)
        - contact_force (optional)

    Each layer has a path of its own, and in the page a box under "Open Controls" that switches it
    off:

    - ``needle``: the true `needle` (a Needle in T), steel with a green hub
    - ``estimate``: red while tracking, yellow while coasting, light blue when lost
    - ``uncertainty``: the ellipsoid that holds the tip with 95 %, true to scale
    - ``sector``: the outline of the sweep, which moves with the probe
    - ``slices``: of each new `volume`, where it was acquired: one along needle and beam, one along
      the needle across the beam (Chatelain 2013, fig. 3)
    - ``screen``: both slices upright, the probe at their top
    - ``phase``: what the tracker does, in the estimate's colour
    - ``force``: the `contact_force` in N with which the probe presses, an arrow at its face
    - ``legend``

    Arm, probe and phantom are for Drake's MeshcatVisualizer to draw. Slices are made only while a
    browser is connected, or while a film is kept for the replay.

    Parameters
    ----------
    meshcat
        To draw in.
    path
        Of everything that is drawn; by default the layers are at the top of the scene.
    parameters
        How it is drawn.
    """

    def __init__(
        self,
        *,
        meshcat: Meshcat,
        path: str = "",
        parameters: WorldViewParameters | None = None,
    ) -> None:
        super().__init__()
        self._meshcat, self._path = meshcat, path
        self._parameters = parameters or WorldViewParameters()
        self.DeclareAbstractInputPort("X_WP", Value(RigidTransform()))
        self.DeclareAbstractInputPort("X_WT", Value(RigidTransform()))
        for name in ("needle", "estimate", "volume"):
            self.DeclareAbstractInputPort(name, Value[object]())
        self.DeclareVectorInputPort("contact_force", 1)
        self._start()
        self.DeclareInitializationPublishEvent(publish=lambda context: self._start())
        self.DeclarePeriodicPublishEvent(self._parameters.publish_period, 0.0, self._publish)
        self.DeclareForcedPublishEvent(self._publish)

    def _start(self) -> None:
        meshcat, path, parameters = self._meshcat, self._path, self._parameters
        for layer in _LAYERS:
            meshcat.Delete(f"{path}/{layer}")
        set_scene(
            meshcat, parameters.camera, parameters.camera_target, parameters.field_of_view_deg
        )
        X_WS = parameters.X_WScreen
        width, height = parameters.screen_size
        self._screen = Screen(
            meshcat=meshcat, path=f"{path}/screen", X_WS=X_WS, width=width, height=height,
            frames=parameters.film_frames, period=parameters.film_period,
        )  # fmt: skip
        self._film = Film(
            meshcat=meshcat, path=f"{path}/slices",
            frames=parameters.film_frames, period=parameters.film_period,
        )  # fmt: skip
        self._phase = Label(meshcat=meshcat, path=f"{path}/phase", height=0.03, width=width)
        above, below = [0.0, -0.5 * height - 0.02, 0.0], [0.0, 0.5 * height + 0.005, 0.0]
        meshcat.SetTransform(f"{path}/phase", X_WS @ RigidTransform(above))
        draw_legend(meshcat, f"{path}/legend", X_WS @ RigidTransform(below), width, WORLD_LEGEND)
        self._needle: NeedleView | None = None  # until its radius is known
        self._estimate = EstimateView(meshcat=meshcat, path=f"{path}/estimate")
        self._uncertainty = EllipsoidView(
            meshcat=meshcat, path=f"{path}/uncertainty/tip", colour=rgba(UNCERTAINTY, 0.75)
        )
        self._force = ForceArrow(meshcat=meshcat, path=f"{path}/force", R_WLabel=X_WS.rotation())
        self._right = X_WS.rotation().col(0)
        self._drawn: NeedleEstimate | None = None
        self._sector: SweepGeometry | None = None
        self._sliced = -np.inf  # time of the volume whose slices are shown

    def _publish(self, context: Context) -> None:
        time = context.get_time()
        X_WP = evaluate(self, context, "X_WP", RigidTransform)
        X_WT = evaluate(self, context, "X_WT", RigidTransform)
        self._meshcat.SetTransform(f"{self._path}/sector", X_WP, time)
        if self._connected(context, "needle"):
            needle = evaluate(self, context, "needle", Needle)
            if self._needle is None:
                self._needle = NeedleView(
                    meshcat=self._meshcat, path=f"{self._path}/needle",
                    length=self._parameters.needle_length, radius=needle.radius,
                )  # fmt: skip
            self._needle.draw(needle, X_WT, time)
        if self._connected(context, "contact_force"):
            force = float(evaluate(self, context, "contact_force", np.ndarray)[0])
            point = X_WP.translation() + _BESIDE * self._right
            self._force.show(force, point, X_WT.rotation().col(2), time)
        estimate = None
        if self._connected(context, "estimate"):
            estimate = evaluate(self, context, "estimate", NeedleEstimate)
            self._draw_estimate(estimate, time)
        self._draw_volume(context, estimate)

    def _connected(self, context: Context, port: str) -> bool:
        return self.GetInputPort(port).HasValue(context)

    def _draw_estimate(self, estimate: NeedleEstimate, time: float) -> None:
        if estimate is self._drawn:
            return
        self._drawn = estimate
        self._estimate.draw(estimate, time)
        colour = MODE_COLOURS[estimate.mode]
        seen = estimate.volume_time > -np.inf
        self._phase.show(estimate.mode if seen else _WAITING, time, ink(colour), colour)
        if estimate.curve is None:
            self._uncertainty.hide(time)
        else:
            self._uncertainty.show(estimate.curve.tip, estimate.tip_covariance, time)

    def _draw_volume(self, context: Context, estimate: NeedleEstimate | None) -> None:
        # The slices follow the needle as the tracker saw it in the volume, so they wait for it. To
        # ask for a volume before, or even whether there is one, would make it for us alone.
        if estimate is not None and estimate.volume_time <= self._sliced:
            return
        if not self._connected(context, "volume"):
            return
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        if not isinstance(volume, Volume) or volume.time <= self._sliced:
            return
        self._sliced = volume.time
        geometry = volume.motion.geometry if volume.motion else None
        if geometry is not None and geometry is not self._sector:
            mesh = tubes(sector_edges(geometry), 5e-4)
            self._meshcat.SetObject(f"{self._path}/sector", mesh, rgba(SECTOR))
            self._sector = geometry
        if not self._parameters.film_frames and not self._meshcat.GetNumActiveConnections():
            return
        planes = slice_planes(volume, estimate.curve if estimate else None)
        if not planes:
            return
        pixel, time = self._parameters.pixel, context.get_time()
        pictures = [encode_webp(sample_plane(volume, plane, pixel)) for plane in planes]
        in_world = [plane.transformed(volume.X_WP) for plane in planes]
        self._film.show(gltf_textured_quads(in_world, pictures), time)
        self._screen.show(volume, planes, pictures, time)
