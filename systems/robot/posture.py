"""Joint positions of the arm for a wanted pose of the probe."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.solvers import MathematicalProgramResult, Solve

from sonoservo.systems.robot.arm import ArmWithProbe
from sonoservo.systems.signals.body_surface import BodySurface

_LEVER = 0.1
_TOLERANCE = 1e-6
_STARTS = 16


def probe_pose(
    *,
    X_WT: RigidTransform,
    x: float,
    y: float,
    yaw: float,
    height: float,
    surface: BodySurface | None = None,
) -> RigidTransform:
    """Return the pose X_WP of a probe that looks along the normal of the phantom's top."""
    R_TP = RotationMatrix.MakeZRotation(yaw) @ RotationMatrix.MakeXRotation(-np.pi / 2)
    if surface is None or not surface.is_curved:
        return X_WT @ RigidTransform(R_TP, [x, y, height])
    foot = np.array([x, y, surface.height(x, y)])
    normal = surface.normal(foot)
    # The shortest turn from the vertical to the normal.
    half = np.array([1 + normal[2], -normal[1], normal[0], 0.0])
    tilt = RotationMatrix(Quaternion(half / np.linalg.norm(half)))
    return X_WT @ RigidTransform(tilt @ R_TP, foot + height * normal)


def solve_posture(
    arm: ArmWithProbe, X_WP: RigidTransform, near: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Return (n,) joint positions in rad that put the probe at a pose, within the arm's limits."""
    near = arm.home if near is None else near
    result = _solve(arm, X_WP, near, start=near)
    if result.is_success():
        return result.get_x_val()
    # The search is local: from another start it may find what it does not find from here.
    for start in [near, *_other_starts(arm)]:
        # A redundant arm finds its nearest posture more easily from one that reaches the pose.
        any_posture = _solve(arm, X_WP, None, start=start)
        if any_posture.is_success():
            nearest = _solve(arm, X_WP, near, start=any_posture.get_x_val())
            return (nearest if nearest.is_success() else any_posture).get_x_val()
    p = X_WP.translation()
    angles = np.rad2deg(RollPitchYaw(X_WP.rotation()).vector())
    raise ValueError(
        f"the arm cannot reach the probe pose x {p[0]:.3f}, y {p[1]:.3f}, z {p[2]:.3f} m, "
        f"roll {angles[0]:.1f}, pitch {angles[1]:.1f}, yaw {angles[2]:.1f} deg in the world, from "
        f"its default joint positions nor from {_STARTS} others"
    )


def _other_starts(arm: ArmWithProbe) -> NDArray[np.float64]:
    """Return (m, n) joint positions in rad, spread over the arm's limits, the same each time."""
    low, high = arm.plant.GetPositionLowerLimits(), arm.plant.GetPositionUpperLimits()
    reach = np.maximum(low, -np.pi), np.minimum(high, np.pi)
    return np.random.default_rng(0).uniform(*reach, (_STARTS, len(low)))


def _solve(
    arm: ArmWithProbe,
    X_WP: RigidTransform,
    near: NDArray[np.float64] | None,
    start: NDArray[np.float64],
) -> MathematicalProgramResult:
    """Search from a start for the posture nearest to another; None takes any posture."""
    world = arm.plant.world_frame()
    problem = InverseKinematics(arm.plant)
    # Three points determine position and orientation without the singularity of a zero angle.
    for point in (np.zeros(3), [_LEVER, 0, 0], [0, _LEVER, 0]):
        p_W = X_WP.multiply(point)
        problem.AddPositionConstraint(
            arm.probe.body_frame(), point, world, p_W - _TOLERANCE, p_W + _TOLERANCE
        )
    q = problem.q()
    if near is not None:
        problem.prog().AddQuadraticErrorCost(np.eye(len(q)), near, q)
    problem.prog().SetInitialGuess(q, start)
    return Solve(problem.prog())


def reachable(
    arm: ArmWithProbe, poses: Sequence[RigidTransform], near: NDArray[np.float64] | None = None
) -> list[bool]:
    """Return for each pose X_WP of the probe whether the arm can reach it near a posture."""

    def solvable(pose: RigidTransform) -> bool:
        try:
            solve_posture(arm, pose, near)
        except ValueError:
            return False
        return True

    return [solvable(pose) for pose in poses]
