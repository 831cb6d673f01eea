"""Deformation of the tissue at one time: its displacement by the probe and by the needle."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable, Shape
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.requirements import (
    NotNegative,
    Positive,
)
from sonoservo.systems.ultrasound.simulation.kernels.displacement import (
    NO_DISPLACEMENTS,
    Displacements,
    displace_points,
)
from sonoservo.systems.ultrasound.simulation.kernels.needle_push import spaced

_MOST_POINTS = 7
_SPACING = 4e-3
_ROUNDING = 8
_STRAIGHT = 1e-6
"""Distance in m from the chord within which a shaft counts as straight."""
_NO_SHAFT = np.zeros((0, 3))
_NO_SHAFT.flags.writeable = False


@dataclass(frozen=True)
class Indentation(Immutable):
    """Indentation of the tissue's level top by a sphere, deepest at x, y in T, in m."""

    x: float = 0.0
    y: float = 0.0
    depth: NotNegative = 0.0
    """Depth of that point below the undeformed top, in m; 0 for no contact."""
    dome_radius: Positive = 1.0
    """Radius of the sphere, in m."""

    @property
    def radius(self) -> float:
        """Radius of the contact in Hertz's theory, sqrt(depth R), in m."""
        return float(np.sqrt(self.depth * self.dome_radius))


def indentation(X_TP: RigidTransform, dome_radius: float) -> Indentation:
    """Return the indentation by a probe with a dome for a face, whose Y axis points out of it.

    ``dome_radius`` is that of a sphere with the dome's mean curvature at its apex, in m. Hertz's
    contact of an ellipsoid differs little from that of this sphere (Johnson 1985, section 4.2).
    """
    face = X_TP.translation()
    centre = face - dome_radius * X_TP.rotation().matrix()[:, 1]
    depth = max(dome_radius - float(centre[2]), 0.0)
    return Indentation(float(centre[0]), float(centre[1]), depth, dome_radius)


@dataclass(frozen=True, eq=False)
class Deformation(Immutable):
    """Displacement of the tissue in T at one time, in m; see `displacement.indent` and `push`."""

    indentation: Indentation = Indentation()
    shaft: Annotated[NDArray[np.float64], Shape(None, 3)] = field(default_factory=lambda: _NO_SHAFT)
    """Points along the needle that displaces tissue, entry first, before the probe displaces both.
    """
    drag: float = 0.0
    """Displacement of the tissue at the shaft, towards the tip."""
    drag_reach: Positive = 8e-3
    """Distance from the shaft over which the drag falls to 1/e."""
    hole_radius: NotNegative = 0.0
    """Radius of the hole that the tissue leaves to the needle."""

    def moved(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (n, 3) displaced positions of (n, 3) points of the tissue, in T, in m."""
        return displace_points(np.asarray(points, dtype=float), displacements([self]), 0, True)

    def moved_needle(self, needle: Needle) -> Needle:
        """Return a needle in T that the probe displaces with the tissue around it.

        The needle's own push on the tissue does not displace it.
        """
        if not needle or self.indentation.depth == 0:
            return needle
        return moved_needle(needle, displacements([self]), 0, pushed=False)


def moved_needle(
    needle: Needle, field: Displacements, frame: int, *, pushed: bool = True
) -> Needle:
    """Return a needle in T displaced by the field of a frame, by its needle only if ``pushed``."""
    shaft = displace_points(spaced(needle.shaft, _SPACING), field, frame, pushed)
    return Needle(shaft, needle.radius, roll=needle.roll, track=needle.track)


def displacements(deformations: Sequence[Deformation] | None) -> Displacements:
    """Return the fields of the frames' deformations for the kernels.

    Lengths are rounded to 10 nm, so that tissue at rest is the same from one sweep to the next.
    None stands for undeformed tissue.
    """
    if deformations is None:
        return NO_DISPLACEMENTS
    frames = len(deformations)
    pushing = [d for d in deformations if len(d.shaft) and (d.drag != 0 or d.hole_radius > 0)]
    paths = [_thinned(d.shaft) if len(d.shaft) > 1 and pushing else _NO_SHAFT for d in deformations]
    counts = np.array([len(path) for path in paths])
    shafts = np.zeros((frames, max(counts.max(), 1), 3))
    for shaft, path in zip(shafts, paths, strict=True):
        shaft[: len(path)] = np.round(path, _ROUNDING)
    contacts = [d.indentation for d in deformations]
    places = np.array([[c.x, c.y, c.depth, c.radius] for c in contacts]).round(_ROUNDING)
    drags = np.array([d.drag for d in deformations]).round(_ROUNDING)
    hole = max((d.hole_radius for d in pushing), default=0.0)
    return Displacements(
        contacts=places[:, :2].copy(),
        depths=places[:, 2].copy(),
        radii=np.maximum(places[:, 3], 1e-6),
        shafts=shafts,
        counts=counts,
        drags=drags,
        drag_reach=float(deformations[0].drag_reach),
        hole=float(hole**2),
        deepest=float(places[:, 2].max()),
        widest_push=float(np.abs(drags).max() + hole) if pushing else 0.0,
    )


def _thinned(shaft: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a few of a shaft's points, with both ends; only these if it is straight."""
    if len(shaft) == 2:
        return shaft
    along = shaft[-1] - shaft[0]
    length = max(float(np.linalg.norm(along)), 1e-9)
    if np.linalg.norm(np.cross(shaft - shaft[0], along), axis=1).max() < _STRAIGHT * length:
        return shaft[[0, -1]]
    if len(shaft) <= _MOST_POINTS:
        return shaft
    return shaft[np.linspace(0, len(shaft) - 1, _MOST_POINTS).round().astype(int)]
