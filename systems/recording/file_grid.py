"""From a file's grid of voxels to a `Volume` in the probe's frame, and back."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.requirements import require

_L, _P, _S = np.eye(3)
_DEPTHS = {"L": _L, "R": -_L, "P": _P, "A": -_P, "S": _S, "I": -_S}
"""Where the sound goes, in LPS: to the left, right, back (posterior), front, head, feet."""


@dataclass(frozen=True, eq=False)
class FileGrid(Immutable):
    """How a file's axes become those of the probe frame P: by order and sign, then by a rotation.

    Of the file's axes, Y of P is the one that comes closest to the depth, X of the others the one
    that comes closest to L (to P, if the depth is L or R), and P is right-handed. So an array with
    left-handed or permuted axes is only looked at differently, never resampled, and however it is
    stored it is the same volume in P. How the grid is turned in space goes into the pose X_LP.

    Parameters
    ----------
    order
        Of the file's axes that become X, Y, Z.
    flipped
        Which of these run backwards.
    origin, spacing
        (3,) of the volume in P, in m.
    X_LP
        Pose of P in L, the file's own coordinates: LPS, but in m.
    """

    order: tuple[int, int, int]
    flipped: tuple[bool, bool, bool]
    origin: NDArray[np.float64]
    spacing: NDArray[np.float64]
    X_LP: RigidTransform

    def arrange(self, voxels: NDArray[Any]) -> NDArray[Any]:
        """Return a view of the file's voxels, index [x, y, z] in P."""
        backwards = tuple(slice(None, None, -1 if flip else 1) for flip in self.flipped)
        return voxels.transpose(self.order)[backwards]


def make_file_grid(
    directions: ArrayLike, origin: ArrayLike, shape: tuple[int, int, int], depth: str = "P"
) -> FileGrid:
    """Find how a file's grid lies in the probe frame.

    Parameters
    ----------
    directions
        (3, 3) steps along the file's axes, as columns, in mm, in LPS; at right angles.
    origin
        (3,) of the first voxel in mm, in LPS.
    shape
        Voxels along the file's axes.
    depth
        Where the sound goes, as a letter of the body: "L", "R", "P", "A", "S" or "I".

    Raises
    ------
    ValueError
        If ``depth`` is something else.
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
