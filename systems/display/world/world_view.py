"""The leaf that draws the needle, its estimate and the ultrasound slices in Meshcat."""

import numpy as np
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
from sonoservo.systems.display.world.needle_view import EstimateView, NeedleView
from sonoservo.systems.display.world.parts import (
    EllipsoidView,
    Film,
    ForceArrow,
    Label,
    facing,
    set_scene,
)
from sonoservo.systems.signals.guard_status import GuardStatus
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.leaves import declare_looks
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.planes import sample_sector, slice_planes
from sonoservo.systems.signals.ports import declare_inputs, evaluate, evaluate_optional
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.search_reason import SearchReason
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.signals.volume import Volume

_LAYERS = (
    "needle", "estimate", "uncertainty", "sector", "slices", "phase", "force"
)  # fmt: skip
_WAITING = "waiting for the first volume"
_SIGN = 0.35  # Largest width of the tracking mode and its reason, in m
# Distance from the middle of the probe's face to the force's arrow, in m: clear of the housing.
_BESIDE = 0.045


_PERIOD = 3 / 32  # Time between two pictures, in s
_PIXEL = 1e-3  # Pixel size of the slices, in m
# Least time in s between two pairs of slices kept for a replay; it limits the size of the replay.
_FILM_PERIOD = 0.2
# Length of the whole needle in m; the part that is not in the tissue is drawn outside it.
_NEEDLE_LENGTH = 0.15
# Initial places of the camera and of the middle of its view, in W, in m, and the view's height in
# deg: the arm, the needle and the phantom fill the frame.
_CAMERA, _CAMERA_TARGET, _FIELD_OF_VIEW_DEG = (0.98, -0.85, 0.70), (0.33, 0.0, 0.41), 46.0


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

    - ``needle``: the true `needle` (a Needle in T), thicker than it is: blue in the tissue, with
      a white ball at its tip, and steel outside it, with a pink hub
    - ``estimate``: the estimated needle, orange while tracking, pale while coasting and red when
      lost, with a ring around its tip
    - ``uncertainty``: the 95 % confidence ellipsoid of the tip, true to scale
    - ``sector``: the outline of the sweep, which moves with the probe
    - ``slices``: two slices of each new `volume` at the pose of its acquisition: one along the
      needle and the beam, one along the needle across the beam (Chatelain 2013, fig. 3)
    - ``phase``: in the replay only, the tracking mode, in the estimate's colour, and why no needle
      is found; or, while the `guard` (a GuardStatus) stops the robot, the reason for that
    - ``force``: the `contact_force` in N with which the probe presses, as an arrow at its face

    Drake's MeshcatVisualizer draws the arm, the probe and the phantom. Slices are made only while
    a browser is connected or a film is kept for the replay.

    Parameters
    ----------
    meshcat
        Meshcat to draw in.
    path
        Path of everything that is drawn; by default the layers are at the top of the scene.
    film_frames
        Maximum number of pairs of slices kept for a replay, about 15 KB each; 0 keeps none.
    """

    def __init__(self, *, meshcat: Meshcat, path: str = "", film_frames: int = 0) -> None:
        super().__init__()
        require(film_frames >= 0, "film_frames", film_frames, "0 or more")
        self._meshcat, self._path, self._film_frames = meshcat, path, film_frames
        declare_inputs(
            self,
            X_WP=RigidTransform,
            X_WT=RigidTransform,
            needle=Needle,
            estimate=NeedleEstimate,
            volume=(Volume, NotFound),
            guard=GuardStatus,
            contact_force=1,
        )
        self._start()
        declare_looks(self, self._publish, period=_PERIOD, start=self._start)

    def _start(self, context: Context | None = None) -> None:
        meshcat, path = self._meshcat, self._path
        for layer in _LAYERS:
            meshcat.Delete(f"{path}/{layer}")
        set_scene(meshcat, _CAMERA, _CAMERA_TARGET, _FIELD_OF_VIEW_DEG)
        self._film = Film(
            meshcat=meshcat, path=f"{path}/slices", frames=self._film_frames, period=_FILM_PERIOD
        )
        R = facing(_CAMERA, _CAMERA_TARGET)
        self._phase = Label(meshcat=meshcat, path=f"{path}/phase", height=0.03, width=_SIGN)
        self._reason = Label(meshcat=meshcat, path=f"{path}/phase/reason", height=0.03, width=_SIGN)
        meshcat.SetTransform(f"{path}/phase/reason", RigidTransform([0.0, 0.04, 0.0]))
        # Low in the view and before all it shows, where a narrow page has room for it, too.
        away = 0.8 * float(np.linalg.norm(np.subtract(_CAMERA_TARGET, _CAMERA)))
        low = 0.8 * away * np.tan(0.5 * np.deg2rad(_FIELD_OF_VIEW_DEG))
        p_WPhase = _CAMERA + R @ [0.0, low, away]
        meshcat.SetTransform(f"{path}/phase", RigidTransform(R, p_WPhase))
        # The live page has it beside the view.
        meshcat.SetProperty(f"{path}/phase", "visible", False)
        meshcat.get_mutable_recording().SetProperty(0, f"{path}/phase", "visible", True)
        self._needle: NeedleView | None = None  # until its radius is known
        self._estimate = EstimateView(meshcat=meshcat, path=f"{path}/estimate")
        self._uncertainty = EllipsoidView(
            meshcat=meshcat, path=f"{path}/uncertainty/tip", colour=rgba(UNCERTAINTY, 0.75)
        )
        self._force = ForceArrow(meshcat=meshcat, path=f"{path}/force", R_WLabel=R)
        self._right = R.col(0)
        self._drawn: NeedleEstimate | None = None
        self._sector: SweepGeometry | None = None
        self._sliced = -np.inf  # time of the volume whose slices are shown

    def _publish(self, context: Context) -> None:
        time = context.get_time()
        X_WP = evaluate(self, context, "X_WP", RigidTransform)
        X_WT = evaluate(self, context, "X_WT", RigidTransform)
        self._meshcat.SetTransform(f"{self._path}/sector", X_WP, time)
        if (needle := evaluate_optional(self, context, "needle", Needle)) is not None:
            if self._needle is None:
                self._needle = NeedleView(
                    meshcat=self._meshcat, path=f"{self._path}/needle",
                    length=_NEEDLE_LENGTH, radius=needle.radius,
                )  # fmt: skip
            self._needle.draw(needle, X_WT, time)
        force = evaluate_optional(self, context, "contact_force", np.ndarray)
        if force is not None:
            point = X_WP.translation() + _BESIDE * self._right
            self._force.show(float(force[0]), point, X_WT.rotation().col(2), time)
        estimate = evaluate_optional(self, context, "estimate", NeedleEstimate)
        if estimate is not None:
            self._draw_estimate(estimate, time)
        self._draw_phase(context, estimate)
        self._draw_volume(context, estimate)

    def _draw_estimate(self, estimate: NeedleEstimate, time: float) -> None:
        if estimate is self._drawn:
            return
        self._drawn = estimate
        self._estimate.draw(estimate, time)
        none, seen = estimate.curve is None, estimate.volume_time > -np.inf
        reason = SearchReason.of(estimate.reason) if none and seen else None
        self._reason.show(reason.words if reason else "", time)
        if estimate.curve is None:
            self._uncertainty.hide(time)
        else:
            self._uncertainty.show(estimate.curve.tip, estimate.tip_covariance, time)

    def _draw_phase(self, context: Context, estimate: NeedleEstimate | None) -> None:
        time = context.get_time()
        guard = evaluate_optional(self, context, "guard", GuardStatus)
        if guard is not None and guard.stopped:
            self._phase.show(f"stopped: {guard.reason}", time, ink(STOPPED), STOPPED)
        elif estimate is not None:
            colour = MODE_COLOURS[estimate.mode]
            seen = estimate.volume_time > -np.inf
            self._phase.show(estimate.mode if seen else _WAITING, time, ink(colour), colour)

    def _draw_volume(self, context: Context, estimate: NeedleEstimate | None) -> None:
        # The slices follow the needle that the tracker found in the volume, so they wait for the
        # tracker. Asking for the volume earlier, or only for its existence, would render it for
        # the display alone.
        if estimate is not None and estimate.volume_time <= self._sliced:
            return
        volume = evaluate_optional(self, context, "volume", (Volume, NotFound))
        if not isinstance(volume, Volume) or volume.time <= self._sliced:
            return
        self._sliced = volume.time
        geometry = volume.motion.geometry if volume.motion else None
        if geometry is not None and geometry is not self._sector:
            mesh = tubes(sector_edges(geometry), 5e-4)
            self._meshcat.SetObject(f"{self._path}/sector", mesh, rgba(SECTOR))
            self._sector = geometry
        if not self._film_frames and not self._meshcat.GetNumActiveConnections():
            return
        planes = slice_planes(volume, estimate.curve if estimate else None)
        if not planes:
            return
        pictures = [encode_webp(sample_sector(volume, plane, _PIXEL)) for plane in planes]
        in_world = [plane.transformed(volume.X_WP) for plane in planes]
        self._film.show(gltf_textured_quads(in_world, pictures), context.get_time())
