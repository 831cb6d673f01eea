"""View of the probe frame: the sector, the two slices and the needle, on a page of a site."""

import numpy as np
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.display.colours import MODE_COLOURS, rgba
from sonoservo.systems.display.pages.meshcat_page import open_meshcat
from sonoservo.systems.display.pages.site import Site
from sonoservo.systems.display.shapes import sector_edges, tubes
from sonoservo.systems.display.textured_quads import (
    encode_webp,
    gltf_mesh,
    gltf_textured_quads,
)
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.planes import box_edges, sample_sector, slice_planes
from sonoservo.systems.signals.volume import Volume

_PIXEL = 0.5e-3
_NEEDLE, _AXIS, _EDGE = 0.9e-3, 0.4e-3, 0.15e-3  # Radii of the needle, the axes and the edges, in m
_AXES = ((0.94, 0.25, 0.25), (0.25, 0.75, 0.38), (0.31, 0.50, 1.0))
_LENGTH = 0.02  # Length of the axes, in m
# The depth runs down.
_R_WP = RotationMatrix(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]))
# Place of the camera from the volume's centre, in diagonals of the volume.
_CAMERA, _FIELD_OF_VIEW_DEG = np.array([0.5, -0.98, 0.3]), 60.0


class ProbeView:
    """Draws volumes in the probe frame P with Drake's Meshcat, which keeps them for later pages.

    Drake aborts if a Meshcat is used or destroyed on a thread other than its own: the site's.
    """

    def __init__(self, site: Site) -> None:
        self._outline: object = None
        self._meshcat: Meshcat | None = site.ask(lambda: self._open(site))

    def _open(self, site: Site) -> Meshcat:
        meshcat = open_meshcat(site, page="probe", title="Probe", close=self._close)
        for each in ("/Axes", "/Grid"):
            meshcat.SetProperty(each, "visible", False)
        meshcat.SetProperty("/Background/<object>", "top_color", [0.10, 0.12, 0.15])
        meshcat.SetProperty("/Background/<object>", "bottom_color", [0.03, 0.035, 0.045])
        for name, axis, colour in zip("xyz", np.eye(3), _AXES, strict=True):
            ends = np.stack([np.zeros(3), _LENGTH * axis])
            meshcat.SetObject(f"probe/{name}", tubes([ends], _AXIS), rgba(colour))
        return meshcat

    def _close(self) -> None:
        self._meshcat = None

    def show(self, volume: Volume, estimate: NeedleEstimate | None) -> None:
        """Draw a volume's slices through the needle, or else the probe, and the needle."""
        meshcat = self._meshcat
        if meshcat is None:
            return
        curve = estimate.curve if estimate is not None else None
        self._draw_outline(meshcat, volume)
        planes = slice_planes(volume, curve)
        meshcat.SetProperty("probe/slices", "visible", bool(planes))
        if planes:
            pictures = [encode_webp(sample_sector(volume, plane, _PIXEL)) for plane in planes]
            gltf = gltf_textured_quads(planes, pictures)
            meshcat.SetObject("probe/slices", gltf_mesh(gltf))
        meshcat.SetProperty("probe/needle", "visible", curve is not None)
        if curve is not None and estimate is not None:
            points = volume.to_probe(curve.position(np.linspace(0, 1, 21)))
            colour = rgba(MODE_COLOURS[estimate.mode])
            meshcat.SetObject("probe/needle", tubes([points], _NEEDLE), colour)

    def _draw_outline(self, meshcat: Meshcat, volume: Volume) -> None:
        """Draw the edges of the swept sector, or else of the grid, and aim at their middle."""
        low, high = volume.origin, volume.upper
        geometry = volume.motion.geometry if volume.motion else None
        key = geometry, *low, *high
        if key == self._outline:
            return
        self._outline = key
        edges = sector_edges(geometry) if geometry is not None else box_edges(low, high)
        meshcat.SetObject("probe/outline", tubes(edges, _EDGE), Rgba(0.37, 0.45, 0.53))
        meshcat.SetTransform("probe", RigidTransform(_R_WP, _R_WP @ (-0.5 * (low + high))))
        meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=_FIELD_OF_VIEW_DEG))
        meshcat.SetCameraPose(np.linalg.norm(high - low) * _CAMERA, np.zeros(3))
