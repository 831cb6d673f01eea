"""Labels of a data set's volumes: the needle as acquired, its mask and its description."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.ultrasound.simulation.reaction.deformation import Deformation

_SPACING = 2e-3
"""Largest distance between points of a needle that the tissue bends, in m."""


def needle_as_acquired(volume: Volume, insertion: Insertion) -> Needle:
    """Return the needle in P, as deep as it was when the volume's frames saw its tip."""
    time = volume.time
    for _ in range(4):
        needle = insertion.needle(time).transformed(volume.X_WP.inverse())
        if needle:
            time = float(volume.to_world(needle.tip[np.newaxis])[1][0])
    return needle


def needle_as_imaged(
    needle: Needle,
    X_TP: NDArray[np.float64],
    deformations: Sequence[Deformation] | None,
    acoustic: SweepGeometry,
    geometry: SweepGeometry,
    direction: int,
) -> Needle:
    """Return a needle in P as a sweep shows it, while the tissue moves and slows the sound.

    Each of its points is where the frame that saw it had it, at the depth that follows from the
    speed of sound that the scanner assumes.
    """
    if not needle:
        return needle
    count = max(len(needle.shaft), int(np.ceil(needle.length / _SPACING)) + 1)
    shafts = []
    for number, X in enumerate(X_TP):
        moved = needle if deformations is None else deformations[number].moved_needle(needle)
        p_T = moved.position(np.linspace(0, moved.length, count))
        shafts.append(RigidTransform(X).inverse().multiply(p_T.T).T)
    points, each = np.array(shafts), np.arange(count)
    frame = np.full(count, len(points) // 2)
    for _ in range(4):
        k = acoustic.index(points[frame, each], direction)[0]
        frame = np.clip(np.rint(k), 0, len(points) - 1).astype(int)
    k, j, i = acoustic.index(points[frame, each], direction)
    shaft = geometry.position(k, j, i, direction)
    return Needle(shaft, needle.radius, roll=needle.roll)


def needle_mask(volume: Volume, needle: Needle) -> NDArray[np.bool_]:
    """Return the mask of the seen voxels through which a needle, given in P, passes.

    Their centres lie within the needle's radius of its axis or, because a needle may be thinner
    than the grid, within 0.75 of the largest spacing.
    """
    mask: NDArray[np.bool_] = np.zeros(volume.intensities.shape, dtype=bool)
    radius = max(needle.radius, 0.75 * float(volume.spacing.max()))
    last = np.array(volume.intensities.shape)
    for a, b in zip(needle.shaft[:-1], needle.shaft[1:], strict=True):
        low = (np.minimum(a, b) - radius - volume.origin) / volume.spacing
        high = (np.maximum(a, b) + radius - volume.origin) / volume.spacing
        first = np.clip(np.ceil(low), 0, last).astype(int)
        stop = np.clip(np.floor(high) + 1, first, last).astype(int)
        box = tuple(slice(int(i), int(j)) for i, j in zip(first, stop, strict=True))
        index = np.stack(np.meshgrid(*map(np.arange, first, stop), indexing="ij"), axis=-1)
        p_P, k = volume.position(index) - a, b - a
        along = np.clip(p_P @ k / (k @ k), 0, 1)
        mask[box] |= np.linalg.norm(p_P - along[..., np.newaxis] * k, axis=-1) <= radius
    return mask & volume.seen


def describe_needle(needle: Needle) -> dict[str, Any]:
    """Return the labels of a volume in its own coordinates: LPS in mm, along the axes of P."""
    if not needle:
        return {"needle_lps_mm": [], "tip_lps_mm": None, "radius_mm": 1e3 * needle.radius}
    return {
        "needle_lps_mm": (1e3 * needle.shaft).tolist(),
        "tip_lps_mm": (1e3 * needle.tip).tolist(),
        "radius_mm": 1e3 * needle.radius,
    }
