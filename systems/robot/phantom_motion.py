"""Motion of the phantom during a run."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.trajectories import FunctionHandleTrajectory, PiecewisePolynomial, Trajectory

from sonoservo.systems.signals.requirements import (
    MAX_TIME,
    Bound,
    Bounded,
    Time,
    count_of,
    require,
    within,
)

Direction: TypeAlias = Annotated[
    list[float],
    Bound(
        "three numbers, not all 0",
        lambda value: len(value) == 3 and bool(np.isfinite(value).all()) and any(value),
    ),
]
"""(3,) direction of any length."""


@dataclass(kw_only=True)
class Move(Bounded):
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

    start: Time = 0.0
    duration: Annotated[float, within(1e-3, MAX_TIME, " s")] = 1.0
    translation: Annotated[
        list[Annotated[float, within(-1, 1, " m")]], count_of(3, "lengths in m")
    ] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    rotation_deg: Annotated[list[float], count_of(3, "angles")] = field(
        default_factory=lambda: [0.0, 0.0, 0.0]
    )


@dataclass(kw_only=True)
class Breathing(Bounded):
    """Periodic displacement of the phantom, as by a patient's breath.

    The displacement at time t is peak_to_peak sin^(2 n)(pi rate t) along the direction. It is the
    model of Lujan et al. (1999), which begins at the end of an exhalation.

    Parameters
    ----------
    peak_to_peak
        Greatest displacement, in m; 0 for none.
    rate
        Breaths per second, in Hz.
    direction
        Direction of the displacement in W.
    exponent
        Exponent n from 1 (a sine) to 4; the larger, the longer the rest between breaths.
    """

    peak_to_peak: Annotated[float, within(0, 0.015, " m")] = 0.0
    rate: Annotated[float, within(0.1, 0.5, " Hz")] = 0.25
    direction: Direction = field(default_factory=lambda: [1.0, 0.0, 0.0])
    exponent: Annotated[int, Bound("1, 2, 3 or 4", range(1, 5).__contains__)] = 1

    def displacement(self, time: float) -> NDArray[np.float64]:
        """Return the (3,) displacement in W at a time in s, in m."""
        return self._along(np.sin(np.pi * self.rate * time) ** (2 * self.exponent))

    def velocity(self, time: float) -> NDArray[np.float64]:
        """Return the (3,) rate of the displacement in W at a time in s, in m/s."""
        phase, n = np.pi * self.rate * time, self.exponent
        return self._along(2 * np.pi * n * self.rate * np.sin(phase) ** (2 * n - 1) * np.cos(phase))

    def _along(self, share: float) -> NDArray[np.float64]:
        direction = np.array(self.direction)
        return self.peak_to_peak * share * direction / np.linalg.norm(direction)


@dataclass(kw_only=True)
class PhantomMotionParameters:
    """Parameters of the phantom's motion.

    Parameters
    ----------
    moves
        Displacements in order of time. Each starts at the end of the previous one or later.
    breathing
        Periodic displacement, in addition to the moves.
    """

    moves: list[Move] = field(default_factory=list)
    breathing: Breathing = field(default_factory=Breathing)

    def __post_init__(self) -> None:
        for earlier, later in zip(self.moves, self.moves[1:], strict=False):
            require(
                later.start >= earlier.start + earlier.duration,
                "moves",
                later.start,
                f"a start at or after {earlier.start + earlier.duration} s, "
                "when the previous move ends",
            )


def phantom_trajectory(parameters: PhantomMotionParameters, X_WT: RigidTransform) -> Trajectory:
    """Return the pose X_WT over time: x, y, z in m, and roll, pitch, yaw in rad."""
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
    moved = PiecewisePolynomial.CubicHermite(breaks, samples, np.zeros_like(samples))
    breathing = parameters.breathing
    if breathing.peak_to_peak == 0:
        return moved

    def position(time: float) -> NDArray[np.float64]:
        return moved.value(time)[:, 0] + np.append(breathing.displacement(time), np.zeros(3))

    def rate(time: float, order: int) -> NDArray[np.float64]:
        return moved.EvalDerivative(time)[:, 0] + np.append(breathing.velocity(time), np.zeros(3))

    trajectory = FunctionHandleTrajectory(position, 6, 1, breaks[0], breaks[-1])
    trajectory.set_derivative(rate)
    return trajectory


def next_move(
    moves: Sequence[Move],
    target: ArrayLike,
    time: float,
    *,
    speed: ArrayLike,
    min_duration: float = 0.3,
) -> Move | None:
    """Return the move that brings the phantom to its target, or None if no move is due."""
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
