"""Motion of the phantom during a run."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.trajectories import PiecewisePolynomial

from sonoservo.systems.signals.requirements import require, require_not_negative, require_positive


@dataclass(kw_only=True)
class Move:
    """One smooth displacement of the phantom, from rest to rest.

    Parameters
    ----------
    start, duration
        Start time and duration, in s.
    translation
        (3,) displacement in W, in m.
    rotation_deg
        (3,) change of roll, pitch and yaw about the rest pose's axes, in deg.
    """

    start: float = 0.0
    duration: float = 1.0
    translation: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    rotation_deg: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def __post_init__(self) -> None:
        require_not_negative(start=self.start)
        require_positive(duration=self.duration)
        require(len(self.translation) == 3, "translation", self.translation, "three lengths in m")
        require(len(self.rotation_deg) == 3, "rotation_deg", self.rotation_deg, "three angles")


@dataclass(kw_only=True)
class PhantomMotionParameters:
    """Parameters of the phantom's motion.

    Parameters
    ----------
    moves
        Displacements in order of time. Each starts at the end of the previous one or later.
    """

    moves: list[Move] = field(default_factory=list)

    def __post_init__(self) -> None:
        for earlier, later in zip(self.moves, self.moves[1:], strict=False):
            require(
                later.start >= earlier.start + earlier.duration,
                "moves",
                later.start,
                f"a start at or after {earlier.start + earlier.duration} s, "
                "when the previous move ends",
            )


def phantom_trajectory(
    parameters: PhantomMotionParameters, X_WT: RigidTransform
) -> PiecewisePolynomial:
    """Return the pose of the phantom over time.

    Parameters
    ----------
    parameters
        Displacements of the phantom.
    X_WT
        Pose at rest.

    Returns
    -------
    (6,) trajectory of X_WT: x, y, z in m, and roll, pitch, yaw in rad. It is cubic during a move,
    from rest to rest, and constant before, between and after the moves.
    """
    breaks = [-1.0]
    pose = np.concatenate([X_WT.translation(), RollPitchYaw(X_WT.rotation()).vector()])
    knots = [pose]
    for move in parameters.moves:
        change = np.concatenate([move.translation, np.deg2rad(move.rotation_deg)])
        for time, knot in ((move.start, pose), (move.start + move.duration, pose + change)):
            # If a move starts at the end of the previous one, the knot exists already.
            if time > breaks[-1]:
                breaks.append(time)
                knots.append(knot)
        pose = pose + change
    breaks.append(breaks[-1] + 1e4)
    knots.append(pose)
    samples = np.array(knots).T
    return PiecewisePolynomial.CubicHermite(breaks, samples, np.zeros_like(samples))


def next_move(
    moves: Sequence[Move],
    target: ArrayLike,
    time: float,
    *,
    speed: ArrayLike,
    min_duration: float = 0.3,
) -> Move | None:
    """Return the move that brings the phantom to its target, or None if no move is due.

    A move under way is not interrupted, so each one goes from rest to rest.

    Parameters
    ----------
    moves
        Moves so far.
    target
        (6,) wanted displacement from the pose at rest: x, y, z in m, and roll, pitch, yaw in deg.
    time
        Present time in s.
    speed
        (6,) highest mean speeds, in m/s and deg/s.
    min_duration
        Shortest duration of a move, in s.
    """
    if moves and time < moves[-1].start + moves[-1].duration:
        return None
    done = np.zeros(6)
    for move in moves:
        done += [*move.translation, *move.rotation_deg]
    change = np.asarray(target, dtype=float) - done
    change[np.abs(change) < 1e-6] = 0.0  # because of rounding
    if not change.any():
        return None
    duration = max(min_duration, float((np.abs(change) / speed).max()))
    translation, rotation_deg = change[:3].tolist(), change[3:].tolist()
    return Move(start=time, duration=duration, translation=translation, rotation_deg=rotation_deg)
