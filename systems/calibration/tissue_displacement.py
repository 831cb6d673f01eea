"""Apparent displacement of tissue between two volumes, by the poses that they carry."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.shape.normalized_cross_correlation import Match, best_match
from sonoservo.systems.signals.acquisition import acquired_from
from sonoservo.systems.signals.immutable import Immutable, Shape
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

# Distance between the samples of a block in m, its edge length in samples, and the largest
# displacement that is looked for, in samples.
_PITCH, _KERNEL, _REACH = 0.7e-3, 15, 6
_APART = 14e-3  # Distance between the centres of neighbouring blocks, in m
_SEEN = 0.98  # Share of a search region that must be seen
_LEAST_CORRELATION = 0.5  # Correlation below which a block counts as changed


@dataclass(frozen=True, eq=False)
class TissueDisplacement(Immutable):
    """(m, 3) centres of blocks in W by the first volume, and displacements in the second, in m."""

    p_W: Annotated[Floats, Shape(None, 3)]
    displacement: Annotated[Floats, Shape(None, 3)]


def displacement_between(first: Volume, second: Volume) -> TissueDisplacement:
    """Measure how far tissue seems to have moved in W between two volumes that overlap there.

    Blocks of the first volume are looked for in the second one. If tissue and poses are right, they
    are found where they were.
    """
    half, axes = _KERNEL // 2, first.X_WP.rotation().matrix()
    p_W = first.to_world(_centres(first))[0]
    p_W = p_W[_is_seen(first, p_W, axes, half) & _is_seen(second, p_W, axes, half + _REACH)]
    centres, displacements = [], []
    for centre in p_W:
        kernel = _block(first, centre, axes, half)
        region = _block(second, centre, axes, half + _REACH)
        if min(np.mean(kernel > 0), np.mean(region > 0)) < _SEEN:
            continue
        match = best_match(region, kernel)
        if not isinstance(match, Match) or match.at_border.any():
            continue
        if match.correlation >= _LEAST_CORRELATION:
            centres.append(centre)
            displacements.append(axes @ (_PITCH * (match.position - _REACH)))
    return TissueDisplacement(np.reshape(centres, (-1, 3)), np.reshape(displacements, (-1, 3)))


def _centres(volume: Volume) -> Floats:
    """Return (n, 3) centres of blocks in P, in m."""
    margin = _PITCH * (_KERNEL // 2)
    low, high = volume.origin + margin, volume.upper - margin
    lines = [np.arange(a, b, _APART) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)


def _is_seen(volume: Volume, p_W: Floats, axes: Floats, half: int) -> NDArray[np.bool_]:
    """Return (m,) flags of the positions in W around which the corners of a block are seen."""
    corners = np.stack(np.meshgrid(*3 * [[-1, 1]], indexing="ij"), axis=-1).reshape(-1, 3)
    points = p_W[:, np.newaxis] + _PITCH * half * corners @ axes.T
    seen = volume.sees(acquired_from(volume, points.reshape(-1, 3)))
    return np.asarray(seen.reshape(-1, len(corners)).all(axis=1))


def _block(volume: Volume, p_W: Floats, axes: Floats, half: int) -> NDArray[np.float32]:
    """Return the levels on a lattice around a point in W."""
    steps = _PITCH * np.arange(-half, half + 1)
    lattice = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)
    ends = acquired_from(volume, p_W + np.array([[0.0, 0.0, 0.0], *axes.T]))
    # Within a block, the motion of the probe during the sweep is an affine map.
    return volume.sample(ends[0] + lattice @ (ends[1:] - ends[0]))
