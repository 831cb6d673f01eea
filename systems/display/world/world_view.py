"""The leaf that draws the needle, its estimate and the ultrasound slices in Meshcat."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.display.colours import (
    MODE_COLOURS,
    SECTOR,
    STOPPED,
    UNCERTAINTY,
    ink,
    rgba,
)
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
from sonoservo.systems.signals.guard_status import GuardStatus
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.planes import sample_plane, slice_planes
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.requirements import require, require_not_negative, require_positive
from sonoservo.systems.signals.search_advice import search_words
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.signals.volume import Volume

_LAYERS = (
    "needle", "estimate", "uncertainty", "sector", "slices", "screen", "phase", "force", "legend"
)  # fmt: skip
_WAITING = "waiting for the first volume"
_BESIDE = 0.045
"""Distance from the middle of the probe's face to the force's arrow, in m: clear of the housing."""


@dataclass(kw_only=True)
class WorldViewParameters:
    """Parameters of the world view.

    Parameters
    ----------
    publish_period
        Time between two pictures, in s.
    pixel
        Pixel size of the slices, in m.
    film_frames
        Maximum number of pairs of slices kept for a replay, about 15 KB each; 0 keeps none.
    film_period
        Minimum time between two kept pairs of slices, in s. It limits the size of the replay.
    needle_length
        Length of the whole needle, in m. The part that is not in the tissue is drawn outside it.
    camera, camera_target
        Initial position of the camera and the point at the centre of its view, in W, in m.
    field_of_view_deg
        Field of view of the camera, from the lower edge of the view to the upper one, in deg.
    screen_position
        Centre of the screen that shows the slices upright, in W, in m. The tracking mode stands
        above it and the legend below it. By default, all three are clear of the open controls on a
        page that is at least 1280 pixels wide and at least 1.6 times as wide as it is high.
    screen_size
        Width and height of the screen, in m.
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
        """Pose of the screen, which faces the camera: X to the right, Y down."""
        R = facing(self.camera, self.camera_target)
        return RigidTransform(R, np.array(self.screen_position))


class WorldView(LeafSystem):
    """Draws the needle, its estimate and slices through the needle in Meshcat.

    .. pydrake_system::

        name: WorldView
        input_ports:
        - X_WP
        - X_WT
        - needle (optional)
        - estimate (optional)
        - volume (optional)
        - contact_force (optional)
        - guard (optional)

    Each layer has a path of its own and, under "Open Controls" in the page, a checkbox that hides
    it:

    - ``needle``: the true `needle` (a Needle in T), steel with a green hub
    - ``estimate``: the estimated needle, red while tracking, yellow while coasting and light blue
      when lost
    - ``uncertainty``: the 95 % confidence ellipsoid of the tip, true to scale
    - ``sector``: the outline of the sweep, which moves with the probe
    - ``slices``: two slices of each new `volume` at the pose of its acquisition: one along the
      needle and the beam, one along the needle across the beam (Chatelain 2013, fig. 3)
    - ``screen``: both slices upright, with the probe at the top
    - ``phase``: the tracking mode, in the estimate's colour, and why no needle is found; or, while
      the `guard` (a GuardStatus) stops the robot, the reason for that
    - ``force``: the `contact_force` in N with which the probe presses, as an arrow at its face
    - ``legend``: the meaning of the colours

    Drake's MeshcatVisualizer draws the arm, the probe and the phantom. Slices are made only while
    a browser is connected or a film is kept for the replay.

    Parameters
    ----------
    meshcat
        Meshcat to draw in.
    path
        Path of everything that is drawn; by default the layers are at the top of the scene.
    parameters
        Parameters of the view.
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
        for name in ("needle", "estimate", "volume", "guard"):
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
        self._reason = Label(meshcat=meshcat, path=f"{path}/phase/reason", height=0.02, width=width)
        meshcat.SetTransform(f"{path}/phase/reason", RigidTransform([0.0, -0.026, 0.0]))
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
        self._draw_phase(context, estimate)
        self._draw_volume(context, estimate)

    def _connected(self, context: Context, port: str) -> bool:
        return self.GetInputPort(port).HasValue(context)

    def _draw_estimate(self, estimate: NeedleEstimate, time: float) -> None:
        if estimate is self._drawn:
            return
        self._drawn = estimate
        self._estimate.draw(estimate, time)
        none, seen = estimate.curve is None, estimate.volume_time > -np.inf
        self._reason.show(search_words(estimate.reason) if none and seen else "", time)
        if estimate.curve is None:
            self._uncertainty.hide(time)
        else:
            self._uncertainty.show(estimate.curve.tip, estimate.tip_covariance, time)

    def _draw_phase(self, context: Context, estimate: NeedleEstimate | None) -> None:
        time = context.get_time()
        if self._connected(context, "guard"):
            guard = evaluate(self, context, "guard", GuardStatus)
            if guard.stopped:
                self._phase.show(f"stopped: {guard.reason}", time, ink(STOPPED), STOPPED)
                return
        if estimate is not None:
            colour = MODE_COLOURS[estimate.mode]
            seen = estimate.volume_time > -np.inf
            self._phase.show(estimate.mode if seen else _WAITING, time, ink(colour), colour)

    def _draw_volume(self, context: Context, estimate: NeedleEstimate | None) -> None:
        # The slices follow the needle that the tracker found in the volume, so they wait for the
        # tracker. Asking for the volume earlier, or only for its existence, would render it for
        # the display alone.
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
