"""The leaf that draws the needle, its estimate and the ultrasound slices in Meshcat."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.display.film import Film
from sonoservo.systems.display.image_planes import sample_plane, slice_planes
from sonoservo.systems.display.needle_view import EstimateView, NeedleView
from sonoservo.systems.display.screen import Screen
from sonoservo.systems.display.shapes import sector_edges, tubes
from sonoservo.systems.display.textured_quads import gltf_textured_quads
from sonoservo.systems.estimation.estimate import NeedleEstimate
from sonoservo.systems.needle.needle import Needle
from sonoservo.systems.ultrasound.sweep import SweepGeometry
from sonoservo.systems.ultrasound.volume import Volume
from sonoservo.systems.values import (
    NotFound,
    evaluate,
    require,
    require_not_negative,
    require_positive,
)

_SECTOR = Rgba(0.0, 0.45, 0.70)


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
        Most slices kept for a replay, about 60 KB each; 0 where none is wanted.
    film_period
        Least time between slices kept, in s: it bounds the size of the replay, to about 15 MB a
        minute.
    needle_length
        Of the whole needle, in m: what is not in the tissue is drawn outside it.
    screen_position
        Of the screen that shows the slices upright, and the tracking mode above, in W, in m.
    screen_scale
        Of the slices on the screen; 1 is life-size.
    camera, camera_target
        Where the view begins, in W, in m.
    """

    publish_period: float = 1 / 32
    pixel: float = 1e-3
    film_frames: int = 0
    film_period: float = 0.2
    needle_length: float = 0.15
    screen_position: list[float] = field(default_factory=lambda: [0.60, 0.30, 0.33])
    screen_scale: float = 1.5
    camera: list[float] = field(default_factory=lambda: [0.80, -0.40, 0.52])
    camera_target: list[float] = field(default_factory=lambda: [0.47, 0.03, 0.28])

    def __post_init__(self) -> None:
        require_positive(
            publish_period=self.publish_period,
            pixel=self.pixel,
            needle_length=self.needle_length,
            screen_scale=self.screen_scale,
        )
        require_not_negative(film_frames=self.film_frames, film_period=self.film_period)
        for name in ("screen_position", "camera", "camera_target"):
            require(len(getattr(self, name)) == 3, name, getattr(self, name), "three numbers")


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

    The true `needle` (a Needle in T) is steel with a green hub; the `estimate` is red while
    tracking, yellow while coasting, light blue when lost, and a word names the mode. The outline of
    the sweep moves with the probe; the slices of each new `volume` stay where it was acquired: one
    along needle and beam, one along the needle across the beam (Chatelain 2013, fig. 3). A screen
    shows both upright, the probe at their top, and the `contact_force` in N. Arm, probe and phantom
    are for Drake's MeshcatVisualizer to draw.

    Slices are drawn only while a browser is connected, or while a film is kept for the replay.

    Parameters
    ----------
    meshcat
        To draw in.
    path
        Of everything that is drawn.
    parameters
        How it is drawn.
    """

    def __init__(
        self,
        *,
        meshcat: Meshcat,
        path: str = "ultrasound",
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
        meshcat.Delete(path)
        for each in ("/Axes", "/Grid"):
            meshcat.SetProperty(each, "visible", False)
        camera: Any = parameters.camera
        target: Any = parameters.camera_target
        meshcat.SetCameraPose(camera, target)
        self._needle: NeedleView | None = None  # until its radius is known
        self._screen = Screen(
            meshcat=meshcat, path=f"{path}/screen", position=parameters.screen_position,
            camera=parameters.camera, scale=parameters.screen_scale,
        )  # fmt: skip
        self._estimate = EstimateView(
            meshcat=meshcat, path=f"{path}/estimate", X_WLabel=self._screen.X_WLabel
        )
        self._film = Film(
            meshcat=meshcat, path=f"{path}/slices",
            frames=parameters.film_frames, period=parameters.film_period,
        )  # fmt: skip
        self._sector: SweepGeometry | None = None
        self._sliced = -np.inf  # time of the volume whose slices are shown

    def _publish(self, context: Context) -> None:
        time = context.get_time()
        X_WP = evaluate(self, context, "X_WP", RigidTransform)
        self._meshcat.SetTransform(f"{self._path}/sector", X_WP, time)
        if self._connected(context, "needle"):
            needle = evaluate(self, context, "needle", Needle)
            if self._needle is None:
                self._needle = NeedleView(
                    meshcat=self._meshcat, path=f"{self._path}/needle",
                    length=self._parameters.needle_length, radius=needle.radius,
                )  # fmt: skip
            self._needle.draw(needle, evaluate(self, context, "X_WT", RigidTransform), time)
        estimate = None
        if self._connected(context, "estimate"):
            estimate = evaluate(self, context, "estimate", NeedleEstimate)
            self._estimate.draw(estimate, time)
        if self._connected(context, "contact_force"):
            force = evaluate(self, context, "contact_force", np.ndarray)[0]
            self._screen.show_force(float(force), time)
        self._draw_volume(context, estimate)

    def _connected(self, context: Context, port: str) -> bool:
        return self.GetInputPort(port).HasValue(context)

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
            mesh = tubes(sector_edges(geometry), 3e-4)
            self._meshcat.SetObject(f"{self._path}/sector", mesh, _SECTOR)
            self._sector = geometry
        if not self._parameters.film_frames and not self._meshcat.GetNumActiveConnections():
            return
        planes = slice_planes(volume, estimate.curve if estimate else None)
        images = [sample_plane(volume, plane, self._parameters.pixel) for plane in planes]
        if planes:
            pictures = self._screen.pictures(planes, volume.X_WP)
            gltf = gltf_textured_quads([*planes, *pictures], [*images, *images])
            self._film.show(gltf, volume.X_WP, context.get_time())
