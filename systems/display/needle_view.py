"""The needle and the tracker's belief about it, in Meshcat."""

from pydrake.geometry import Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform

from sonoservo.systems.display.image_planes import Plane
from sonoservo.systems.display.rod import Rod, Switch
from sonoservo.systems.display.textured_quads import gltf_mesh, gltf_textured_quads, text_image
from sonoservo.systems.estimation.estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.needle.needle import Needle

_STEEL, _HUB = Rgba(0.62, 0.65, 0.70), Rgba(0.0, 0.62, 0.45)

# Told apart by lightness as well as by hue (after Okabe and Ito), and named by a label.
MODE_COLOURS = {
    TrackingMode.SEARCHING: (0.30, 0.30, 0.30),
    TrackingMode.TRACKING: (0.84, 0.12, 0.05),
    TrackingMode.COASTING: (0.94, 0.84, 0.10),
    TrackingMode.LOST: (0.34, 0.71, 0.91),
}


class NeedleView:
    """A whole needle: what is in the tissue, what is outside, and its hub.

    Parameters
    ----------
    meshcat, path
        Where it is drawn.
    length
        Of the whole needle, in m.
    radius
        In m.
    """

    def __init__(self, *, meshcat: Meshcat, path: str, length: float, radius: float) -> None:
        self._length = length
        self._inside = Rod(
            meshcat=meshcat, path=f"{path}/inside", radius=radius, colour=_STEEL, segments=6
        )
        self._outside = Rod(meshcat=meshcat, path=f"{path}/outside", radius=radius, colour=_STEEL)
        self._hub = Rod(meshcat=meshcat, path=f"{path}/hub", radius=4 * radius, colour=_HUB)

    def draw(self, needle: Needle, X_WT: RigidTransform, time: float) -> None:
        """Draw a needle given in T; hide it while it is not in the tissue."""
        if not needle:
            for rod in (self._inside, self._outside, self._hub):
                rod.hide(time)
            return
        shaft = needle.transformed(X_WT).shaft
        backward = shaft[0] - shaft[1]
        backward = backward / sum(backward**2) ** 0.5
        end = shaft[0] + max(self._length - needle.length, 0.0) * backward
        self._inside.show(shaft, time)
        self._outside.show([shaft[0], end], time)
        self._hub.show([end, end + 0.025 * backward], time)


class EstimateView:
    """An estimated needle with a ball at its tip, and a word that names the tracking mode.

    Parameters
    ----------
    meshcat, path
        Where it is drawn.
    X_WLabel
        Where the word stands: its centre, X along it, -Y upwards.
    """

    def __init__(self, *, meshcat: Meshcat, path: str, X_WLabel: RigidTransform) -> None:
        self._meshcat, self._path = meshcat, path
        self._rods: dict[TrackingMode, Rod] = {}
        self._labels: dict[TrackingMode, Switch] = {}
        for mode, colour in MODE_COLOURS.items():
            image = text_image(mode, colour)
            height = 0.03
            plane = Plane(X_WLabel, height * image.shape[1] / image.shape[0], height)
            gltf = gltf_textured_quads([plane], [image])
            meshcat.SetObject(f"{path}/label/{mode}", gltf_mesh(gltf))
            self._labels[mode] = Switch(meshcat=meshcat, path=f"{path}/label/{mode}")
            if mode != TrackingMode.SEARCHING:
                meshcat.SetObject(f"{path}/{mode}/tip", Sphere(2e-3), Rgba(*colour))
                self._rods[mode] = Rod(
                    meshcat=meshcat, path=f"{path}/{mode}", radius=8e-4, colour=Rgba(*colour),
                    segments=4,
                )  # fmt: skip

    def draw(self, estimate: NeedleEstimate, time: float) -> None:
        """Draw an estimate in the colour of its mode."""
        for mode, rod in self._rods.items():
            if estimate.curve is not None and mode == estimate.mode:
                curve = estimate.curve
                self._meshcat.SetTransform(
                    f"{self._path}/{mode}/tip", RigidTransform(curve.tip), time
                )
                rod.show(curve.position([0.0, 0.25, 0.5, 0.75, 1.0]), time)
            else:
                rod.hide(time)
        for mode, label in self._labels.items():
            label.set(mode == estimate.mode, time)
