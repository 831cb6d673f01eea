"""Parts of the views in Meshcat, live and in its recording: rods, labels, pictures, camera."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Cylinder, Meshcat, MeshcatCone, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.display.colours import FORCE, rgba
from sonoservo.systems.display.shapes import resample, segment_pose
from sonoservo.systems.display.textured_quads import draw_picture, gltf_mesh, text_image
from sonoservo.systems.signals.confidence import confidence_ellipsoid


class Switch:
    """Shows and hides the object at a path, live and in the recording; hidden at first."""

    def __init__(self, *, meshcat: Meshcat, path: str) -> None:
        self._meshcat, self._path = meshcat, path
        self._visible = False
        self._recorded = False
        meshcat.SetProperty(path, "visible", False)

    def set(self, visible: bool, time: float) -> None:
        """Show or hide the object from a time on, in s."""
        if visible == self._visible:
            return
        if not self._recorded:
            # A track holds its first value before its first key too, so it has to start hidden.
            self._meshcat.get_mutable_recording().SetProperty(0, self._path, "visible", False)
            self._recorded = True
        self._meshcat.SetProperty(self._path, "visible", visible, time)
        self._visible = visible


class Rod:
    """A polyline drawn as a fixed number of cylinders that are posed and stretched.

    Meshcat's recordings keep transforms and properties but add no shapes. A longer polyline is
    resampled. A new rod is hidden.
    """

    def __init__(
        self, *, meshcat: Meshcat, path: str, radius: float, colour: Rgba, segments: int = 1
    ) -> None:
        self._meshcat, self._path, self._segments = meshcat, path, segments
        self._radius, self._used = radius, segments
        for number in range(segments):
            meshcat.SetObject(f"{path}/{number}/unit", Cylinder(radius, 1.0), colour)
        self._switch = Switch(meshcat=meshcat, path=path)

    def show(
        self, polyline: ArrayLike, time: float, radii: NDArray[np.float64] | None = None
    ) -> None:
        """Draw the rod along an (m, 3) polyline in m; (segments,) radii in m replace its own."""
        points = np.asarray(polyline, dtype=float)
        if len(points) > self._segments + 1 or radii is not None:
            points = resample(points, self._segments + 1)
        wide = np.ones(self._segments) if radii is None else radii / self._radius
        used = len(points) - 1
        for number, ends in enumerate(pairwise(points)):
            X, length = segment_pose(*ends)
            self._meshcat.SetTransform(f"{self._path}/{number}", X, time)
            self._stretch(number, wide[number], max(length, 1e-6), time)
        for number in range(used, self._used):
            self._stretch(number, 1e-6, 1e-6, time)
        self._used = used
        self._switch.set(True, time)

    def hide(self, time: float) -> None:
        """Hide the rod from a time on, in s."""
        self._switch.set(False, time)

    def _stretch(self, number: int, width: float, length: float, time: float) -> None:
        scale = [width, width, length]
        self._meshcat.SetProperty(f"{self._path}/{number}/unit", "scale", scale, time)


class Label:
    """A changing line of text.

    Each new text gets a plate of its own (X along the text, -Y up), at most as high and wide as
    given in m, shown while the text holds.
    """

    def __init__(
        self, *, meshcat: Meshcat, path: str, height: float, width: float = np.inf
    ) -> None:
        self._meshcat, self._path = meshcat, path
        self._height, self._width = height, width
        self._plates: dict[str, Switch] = {}
        self._shown = ""

    def show(
        self,
        text: str,
        time: float,
        colour: Sequence[float] = (1, 1, 1),
        background: Sequence[float] = (0, 0, 0),
    ) -> None:
        """Show a text from a time on, in s; an empty one hides the label."""
        if text == self._shown:
            return
        if self._shown:
            self._plates[self._shown].set(False, time)
        if text:
            if text not in self._plates:
                self._plates[text] = self._plate(text, colour, background)
            self._plates[text].set(True, time)
        self._shown = text

    def _plate(self, text: str, colour: Sequence[float], background: Sequence[float]) -> Switch:
        path = f"{self._path}/{text.replace('/', ' ')}"
        image = text_image(text, colour, background)
        rows, columns, _ = image.shape
        height = min(self._height, self._width * rows / columns)
        draw_picture(self._meshcat, path, image, RigidTransform(), height)
        return Switch(meshcat=self._meshcat, path=path)


# Time in s for which pictures that no replay needs are held for pages that have yet to fetch them.
_HELD = 5.0


class Film:
    """A changing picture, shown live and in the recording.

    Recordings cannot add shapes, so each kept picture is a hidden shape of its own, which the
    recording shows from its time to the next one's. At most `frames` are kept, `period` s apart.
    """

    def __init__(self, *, meshcat: Meshcat, path: str, frames: int, period: float) -> None:
        self._meshcat, self._path = meshcat, path
        self._frames, self._period = frames, period
        self._kept = 0
        self._recent: list[float] = []  # time of each picture that is held
        self._newest = -np.inf

    def show(self, gltf: str, time: float) -> None:
        """Draw a glTF document, which contains its own pose.

        A transform in Meshcat would also move the previous picture on a slow page.
        """
        live = f"{self._path}/live"
        mesh = gltf_mesh(gltf)
        self._meshcat.SetObject(live, mesh)
        if self._kept == self._frames or time < self._newest + self._period:
            # Meshcat drops the textures of a replaced object, but a slow page may still ask for
            # them.
            old = (k for k, drawn in enumerate(self._recent) if not time - _HELD < drawn <= time)
            place = next(old, len(self._recent))
            self._recent[place : place + 1] = [time]
            recent = f"{self._path}/recent/{place}"
            self._meshcat.SetObject(recent, mesh)
            self._meshcat.SetProperty(recent, "visible", False)
            return
        path = f"{self._path}/{self._kept}"
        self._meshcat.SetObject(path, mesh)
        self._meshcat.SetProperty(path, "visible", False)
        recording = self._meshcat.get_mutable_recording()
        frame = recording.frame(time)
        # A track holds its first value before its first key, so each shape starts hidden.
        recording.SetProperty(0, live, "visible", False)
        recording.SetProperty(0, path, "visible", False)
        recording.SetProperty(frame, path, "visible", True)
        if self._kept:
            recording.SetProperty(frame, f"{self._path}/{self._kept - 1}", "visible", False)
        self._kept, self._newest = self._kept + 1, time


class EllipsoidView:
    """An ellipsoid of uncertainty in Meshcat, posed and stretched."""

    def __init__(self, *, meshcat: Meshcat, path: str, colour: Rgba) -> None:
        self._meshcat, self._path = meshcat, path
        meshcat.SetObject(f"{path}/unit", Sphere(1.0), colour)
        # It is smaller than the needle's diameter, so the needle would hide it.
        meshcat.SetProperty(f"{path}/unit/<object>", "material.depthTest", False)
        meshcat.SetProperty(f"{path}/unit/<object>", "renderOrder", 1.0)
        self._switch = Switch(meshcat=meshcat, path=path)

    def show(self, centre: ArrayLike, covariance: ArrayLike, time: float) -> None:
        """Show the 95 % ellipsoid of a mean in m and a (3, 3) covariance in m^2, both in W."""
        R, half_axes = confidence_ellipsoid(covariance)
        X = RigidTransform(RotationMatrix(R), np.asarray(centre, dtype=float))
        self._meshcat.SetTransform(self._path, X, time)
        scale = np.maximum(half_axes, 1e-6).tolist()
        self._meshcat.SetProperty(f"{self._path}/unit", "scale", scale, time)
        self._switch.set(True, time)

    def hide(self, time: float) -> None:
        """Hide the ellipsoid from a time on, in s."""
        self._switch.set(False, time)


_METRE_PER_NEWTON = 0.02
_RADIUS, _HEAD = 2e-3, 0.012
_LEAST = 0.05  # Smallest force that is drawn, in N


class ForceArrow:
    """An arrow at the probe's face with the contact force in N beside it."""

    def __init__(self, *, meshcat: Meshcat, path: str, R_WLabel: RotationMatrix) -> None:
        self._meshcat, self._path, self._R_WLabel = meshcat, path, R_WLabel
        self._shaft = Rod(meshcat=meshcat, path=f"{path}/arrow", radius=_RADIUS, colour=rgba(FORCE))
        cone = MeshcatCone(_HEAD, 2.5 * _RADIUS, 2.5 * _RADIUS)
        meshcat.SetObject(f"{path}/arrow/head", cone, rgba(FORCE))
        self._value = Label(meshcat=meshcat, path=f"{path}/value", height=0.016)

    def show(self, force: float, point: ArrayLike, outward: ArrayLike, time: float) -> None:
        """Show a force in N at a point in W, along the body's outward normal, from a time on."""
        if not force > _LEAST:
            self._shaft.hide(time)
            self._value.show("", time)
            return
        point, outward = np.asarray(point, dtype=float), np.asarray(outward, dtype=float)
        neck = point + _HEAD * outward
        tail = neck + _METRE_PER_NEWTON * force * outward
        self._shaft.show([neck, tail], time)
        # Drake's cone has its apex at the origin and widens along Z.
        X_WHead = RigidTransform(RotationMatrix.MakeFromOneVector(outward, 2), point)
        self._meshcat.SetTransform(f"{self._path}/arrow/head", X_WHead, time)
        X_WLabel = RigidTransform(self._R_WLabel, tail + 0.014 * outward)
        self._meshcat.SetTransform(f"{self._path}/value", X_WLabel, time)
        self._value.show(f"{force:.1f} N", time, (0, 0, 0), FORCE)


def set_scene(
    meshcat: Meshcat, camera: Sequence[float], target: Sequence[float], field_of_view_deg: float
) -> None:
    """Hide Meshcat's axes and grid, lighten the background and place the camera."""
    for each in ("/Axes", "/Grid"):
        meshcat.SetProperty(each, "visible", False)
    meshcat.SetProperty("/Background/<object>", "top_color", [0.96, 0.97, 0.98])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.72, 0.74, 0.77])
    meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=field_of_view_deg, aspect=1.5))
    place: Any = (camera, target)  # Drake's stubs want arrays
    meshcat.SetCameraPose(*place)


def facing(camera: Sequence[float], target: Sequence[float]) -> RotationMatrix:
    """Return the rotation of a panel that faces a camera: X right, Y down, Z away from it."""
    away = np.subtract(target, camera)
    right = np.cross(away, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(away):  # it looks straight down or up
        right = np.array([1.0, 0.0, 0.0])
    axes: list[Any] = [each / np.linalg.norm(each) for each in (right, away)]
    return RotationMatrix(np.stack([axes[0], np.cross(axes[1], axes[0]), axes[1]], axis=1))
