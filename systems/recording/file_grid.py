"""Mapping from a file's grid of voxels to a `Volume` in the probe's frame."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.requirements import require

_L, _P, _S = np.eye(3)
# Direction of the sound in LPS: left, right, posterior (back), anterior (front), head, feet.
_DEPTHS = {"L": _L, "R": -_L, "P": _P, "A": -_P, "S": _S, "I": -_S}


@dataclass(frozen=True, eq=False)
class FileGrid(Immutable):
    """Mapping of a file's axes to those of the probe frame P: order and signs, then a rotation.

    An array with left-handed or permuted axes is only viewed differently, never resampled.
    """

    # Y of P is the file's axis closest to the depth. X of P is, of the other two, the axis closest
    # to L (to posterior if the depth is L or R). Z completes a right-handed frame. An array gives
    # the same volume in P however it is stored.

    order: tuple[int, int, int]
    flipped: tuple[bool, bool, bool]
    origin: NDArray[np.float64]
    """(3,) place of the first voxel in P, in m."""
    spacing: NDArray[np.float64]
    """(3,) distances between voxels along the axes of P, in m."""
    X_LP: RigidTransform
    """Pose of P in L, the file's own LPS in m; it holds the grid's orientation."""

    def arrange(self, voxels: NDArray[Any]) -> NDArray[Any]:
        """Return a view of the file's voxels with the index [x, y, z] in P."""
        backwards = tuple(slice(None, None, -1 if flip else 1) for flip in self.flipped)
        return voxels.transpose(self.order)[backwards]


def make_file_grid(
    directions: ArrayLike, origin: ArrayLike, shape: tuple[int, int, int], depth: str = "P"
) -> FileGrid:
    """Return the mapping to P of a grid with (3, 3) steps as columns and (3,) origin, in LPS in mm.

    The depth is the direction of the sound, as an anatomical letter: L, R, P, A, S or I.
    """
    require(depth in _DEPTHS, "depth", depth, f"one of {', '.join(_DEPTHS)}")
    steps = np.asarray(directions, float)
    lengths = np.linalg.norm(steps, axis=0)
    unit = steps / lengths
    depths = _DEPTHS[depth] @ unit
    y = int(np.abs(depths).argmax())
    sideways = (_P if depth in "LR" else _L) @ unit
    x, z = sorted((axis for axis in range(3) if axis != y), key=lambda axis: -abs(sideways[axis]))
    signs = np.ones(3)
    signs[[x, y]] = np.where(np.array([sideways[x], depths[y]]) < 0, -1, 1)
    if np.linalg.det((unit * signs)[:, [x, y, z]]) < 0:
        signs[z] = -1
    order = (x, y, z)
    R_LP = RotationMatrix.ProjectToRotationMatrix((unit * signs)[:, order])
    last = np.where(signs < 0, np.array(shape) - 1, 0)
    first = 1e-3 * (np.asarray(origin, float) + steps @ last)
    return FileGrid(
        order,
        (bool(signs[x] < 0), bool(signs[y] < 0), bool(signs[z] < 0)),
        R_LP.matrix().T @ first,
        1e-3 * lengths[list(order)],
        RigidTransform(R_LP, np.zeros(3)),
    )
