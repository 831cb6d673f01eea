"""Slices through a volume."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.requirements import Positive
from sonoservo.systems.signals.volume import Volume

Vector = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Plane(Immutable):
    """A rectangle in the probe frame P, or in another one."""

    X_PS: RigidTransform
    """Pose of the rectangle's frame S. Its origin is the centre, X is along the width, Y along the
    height, and Z is the normal."""

    width: Positive
    height: Positive

    def transformed(self, X: RigidTransform) -> "Plane":
        """Return the plane in another frame, in which P has the pose X."""
        return Plane(X @ self.X_PS, self.width, self.height)

    def grid(self, rows: int, columns: int) -> Vector:
        """Return the (rows, columns, 3) pixel centres in P in m; Y of S rises by row."""
        x = self.width * ((np.arange(columns) + 0.5) / columns - 0.5)
        y = self.height * ((np.arange(rows) + 0.5) / rows - 0.5)
        R = self.X_PS.rotation().matrix()
        return (
            self.X_PS.translation()
            + x[np.newaxis, :, np.newaxis] * R[:, 0]
            + y[:, np.newaxis, np.newaxis] * R[:, 1]
        )


def box_edges(low: ArrayLike, high: ArrayLike) -> list[NDArray[np.float64]]:
    """Return the twelve edges of a box, (2, 3) ends each, from its lowest and highest corners."""
    corners = np.where((np.arange(8)[:, np.newaxis] >> np.arange(3)) & 1, high, low)
    return [corners[[i, i | bit]] for i in range(8) for bit in (1, 2, 4) if not i & bit]


def slice_planes(volume: Volume, curve: NeedleCurve | None = None) -> list[Plane]:
    """Return two orthogonal planes that contain the needle's axis (Chatelain 2013, fig. 3).

    The first plane also contains the beam's direction (Y of P). Its width runs across the beam and
    its height along the beam, which puts the probe at the top of its image. The second plane is
    orthogonal to the first one, with its width along the needle. Each rectangle is as large as its
    plane's cut through the volume's grid. A plane that misses the grid is left out.
    Without a curve (in W), the planes are Z = 0 and X = 0 of P, or through the middle of a grid of
    which nobody knows where the array lies.
    """
    across, depth, normal = np.eye(3)
    point, width, height = np.zeros(3), normal, depth
    if volume.motion is None:
        point = 0.5 * (volume.origin + volume.upper)
    if curve is not None:
        entry, point = volume.to_probe([curve.entry, curve.tip])
        along = (point - entry) / max(float(np.linalg.norm(point - entry)), np.finfo(float).tiny)
        level = along - (along @ depth) * depth
        if np.linalg.norm(level) > 1e-6:  # otherwise the needle is along the beam, as the defaults
            across = level / np.linalg.norm(level)
            normal = np.cross(across, depth)
            width, height = along, normal
    planes = _cut(volume, point, across, depth), _cut(volume, point, width, height)
    return [plane for plane in planes if plane is not None]


def _cut(volume: Volume, point: Vector, u: Vector, v: Vector) -> Plane | None:
    """Return the smallest rectangle along u and v around a plane's cut through a volume's grid."""
    normal = np.cross(u, v)
    edges = np.array(box_edges(volume.origin, volume.upper))
    cuts = [
        start + before / (before - behind) * (end - start)
        for (start, end), (before, behind) in zip(edges, (edges - point) @ normal, strict=True)
        if before * behind <= 0 and before != behind
    ]
    if not cuts:
        return None
    low, high = (
        reduce(np.array(cuts) @ np.stack([u, v], axis=1), axis=0) for reduce in (np.min, np.max)
    )
    if (high - low).min() <= 0:
        return None
    centre = point + (0.5 * (low + high) - [point @ u, point @ v]) @ np.stack([u, v])
    R_PS = RotationMatrix(np.stack([u, v, normal], axis=1))
    return Plane(RigidTransform(R_PS, centre), *(high - low))


def sample_plane(volume: Volume, plane: Plane, spacing: float) -> NDArray[np.uint8]:
    """Return the (rows, columns) grey levels of a slice through a volume, trilinear.

    ``spacing`` is the largest one of the pixels, in m. Outside the grid, the grey level is 0, or
    that of the nearest point on its edge if the volume knows its sector.
    """
    return _grey(volume, _pixels(plane, spacing))


def sample_sector(volume: Volume, plane: Plane, spacing: float) -> NDArray[np.uint8]:
    """Return a slice as `sample_plane` does, transparent outside the swept sector.

    It has (rows, columns, 2) grey level and opacity, which is 255 in the sector and 0 outside. If
    the sector is unknown, the whole grid is opaque.
    """
    p_P = _pixels(plane, spacing)
    if volume.motion is not None:
        inside = volume.motion.geometry.contains(p_P)
    else:
        inside = np.isfinite(volume.sample(p_P, outside=np.nan))
    return np.stack([_grey(volume, p_P), np.where(inside, 255, 0).astype(np.uint8)], axis=-1)


def _pixels(plane: Plane, spacing: float) -> Vector:
    rows, columns = (
        max(1, int(np.ceil(size / spacing - 1e-9))) for size in (plane.height, plane.width)
    )
    return plane.grid(rows, columns)


def _grey(volume: Volume, p_P: Vector) -> NDArray[np.uint8]:
    grey = volume.sample(p_P, outside=0.0 if volume.motion is None else None)
    np.rint(grey, out=grey)
    return np.clip(grey, 0, 255, out=grey).astype(np.uint8)
