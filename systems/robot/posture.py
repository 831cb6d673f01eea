"""Joint positions of the arm for a wanted pose of the probe."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.solvers import Solve

from sonoservo.systems.robot.arm import MakeArmPlant

ELBOW_UP = np.deg2rad([0.0, -110.0, 190.0, 0.0, 100.0, 180.0])
"""(6,) joint positions in rad: elbow up, the probe pointing down in front of the arm."""

_LEVER = 0.1
_TOLERANCE = 1e-6


def probe_pose(
    *, X_WT: RigidTransform, x: float, y: float, yaw: float, height: float
) -> RigidTransform:
    """Pose X_WP of a probe that looks straight down on the phantom's top.

    Parameters
    ----------
    X_WT
        Pose of the phantom.
    x, y
        Where on the top, in T, in m.
    yaw
        Angle from X_T to X_P about Z_T, in rad; at zero Z_P is Y_T.
    height
        Of the probe's face above the top, in m.
    """
    R_TP = RotationMatrix.MakeZRotation(yaw) @ RotationMatrix.MakeXRotation(-np.pi / 2)
    return X_WT @ RigidTransform(R_TP, [x, y, height])


def solve_posture(
    X_WP: RigidTransform, seed: NDArray[np.float64] = ELBOW_UP
) -> NDArray[np.float64]:
    """Joint positions that put the probe at a pose, within the arm's limits.

    Parameters
    ----------
    X_WP
        Wanted pose of the probe.
    seed
        (6,) joint positions to stay near, in rad.

    Returns
    -------
    (6,) joint positions in rad.

    Raises
    ------
    ValueError
        If the arm cannot reach the pose.
    """
    plant, arm = MakeArmPlant()
    problem = InverseKinematics(plant)
    # Three points say position and orientation, free of the singularity of an angle at zero.
    for point in (np.zeros(3), [_LEVER, 0, 0], [0, _LEVER, 0]):
        p_W = X_WP.multiply(point)
        problem.AddPositionConstraint(
            arm.probe.body_frame(), point, plant.world_frame(), p_W - _TOLERANCE, p_W + _TOLERANCE
        )
    q = problem.q()
    problem.prog().AddQuadraticErrorCost(np.eye(len(q)), seed, q)
    problem.prog().SetInitialGuess(q, seed)
    result = Solve(problem.prog())
    if not result.is_success():
        p = X_WP.translation()
        angles = np.rad2deg(RollPitchYaw(X_WP.rotation()).vector())
        raise ValueError(
            f"the arm cannot reach the probe pose x {p[0]:.3f}, y {p[1]:.3f}, z {p[2]:.3f} m, "
            f"roll {angles[0]:.1f}, pitch {angles[1]:.1f}, yaw {angles[2]:.1f} deg in the world"
        )
    return result.GetSolution(q)


def reachable(poses: Sequence[RigidTransform], seed: NDArray[np.float64] = ELBOW_UP) -> list[bool]:
    """Whether the arm reaches each of the poses X_WP near a posture.

    Parameters
    ----------
    poses
        Poses of the probe.
    seed
        (6,) joint positions to stay near, in rad.
    """

    def solvable(pose: RigidTransform) -> bool:
        try:
            solve_posture(pose, seed)
        except ValueError:
            return False
        return True

    return [solvable(pose) for pose in poses]
