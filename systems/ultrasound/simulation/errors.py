"""Errors of a scanner's clock and motor, and of the connection that its sweeps come by."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform
from pydrake.trajectories import PiecewisePose

from sonoservo.systems.signals.immutable import Immutable, seal
from sonoservo.systems.signals.requirements import (
    Bound,
    Bounded,
    NotNegative,
    within,
)
from sonoservo.systems.signals.sweep import SweepGeometry


@dataclass(kw_only=True)
class ClockParameters(Bounded):
    """Scanner's clock, relative to that of arm and program.

    Parameters
    ----------
    offset
        Time by which the scanner's clock is ahead of the arm's, in s.
    drift
        Rate at which the scanner's clock gains on the arm's, in s/s; 1e-4 is 100 ppm.
    """

    offset: Annotated[float, within(-1, 1, " s")] = 0.0
    drift: Annotated[float, within(-0.01, 0.01)] = 0.0

    @property
    def is_right(self) -> bool:
        """True if the clocks agree."""
        return self.offset == 0 and self.drift == 0

    def stamp(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return what the scanner's clock says at times in s."""
        time = np.asarray(time, float)
        return time + (self.offset + self.drift * time)


def poses_at(
    stamps: NDArray[np.float64], times: ArrayLike, X_WP: Sequence[RigidTransform]
) -> NDArray[np.float64]:
    """Return the (frames, 4, 4) poses that a program gives to frames by their stamps in s.

    They are linear in position and along the shortest turn between the (m,) poses at ascending
    times by the arm's clock, and the nearest one beyond their ends.
    """
    path = PiecewisePose.MakeLinear(np.asarray(times), list(X_WP))
    return np.array([path.GetPose(stamp).GetAsMatrix4() for stamp in stamps])


@dataclass(kw_only=True)
class MotorParameters(Bounded):
    """Differences between the angle at which a frame is acquired and the angle it is shown at.

    Parameters
    ----------
    backlash_deg
        Play of the sweeping motor's gear, by which sweeps to and fro differ, in deg.
    error_deg
        Standard deviation of the sweeping motor's angle at each frame, in deg.
    """

    backlash_deg: NotNegative = 0.0
    error_deg: NotNegative = 0.0


def motor_error(
    parameters: MotorParameters, frames: int, direction: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return (frames,) angles in rad by which the array is ahead towards +Z of its motor.

    It lags behind by half of the play; the motor of a single frame does not move.
    """
    if frames == 1:
        return np.zeros(1)
    lag = -0.5 * direction * parameters.backlash_deg
    return np.deg2rad(lag + parameters.error_deg * rng.standard_normal(frames))


def turned(
    X_TP: NDArray[np.float64], angles: NDArray[np.float64], geometry: SweepGeometry
) -> NDArray[np.float64]:
    """Return (frames, 4, 4) poses of a probe turned about its motor's axis, in rad towards +Z.

    A frame acquired from such a pose is the one that the motor's error makes of it.
    """
    turn = np.tile(np.eye(4), (len(angles), 1, 1))
    turn[:, 1, 1] = turn[:, 2, 2] = cosine = np.cos(angles)
    turn[:, 2, 1] = sine = np.sin(angles)
    turn[:, 1, 2] = -sine
    turn[:, 1, 3] = geometry.motor_radius * (cosine - 1)
    turn[:, 2, 3] = geometry.motor_radius * sine
    return np.asarray(X_TP @ turn)


T = TypeVar("T")

Share: TypeAlias = Annotated[
    float, Bound("a share of at least 0 and below 1", lambda share: 0 <= share < 1)
]

_SLACK = 1e-9


@dataclass(kw_only=True)
class ConnectionParameters(Bounded):
    """Losses and delays between the scanner and the program that takes its sweeps.

    Parameters
    ----------
    lost_frames
        Share of the frames that are lost; each shows the frame before it once more.
    lost_sweeps
        Share of the sweeps that are lost.
    lateness
        Mean time by which a sweep comes late, in s; exponentially distributed.
    """

    lost_frames: Share = 0.0
    lost_sweeps: Share = 0.0
    lateness: NotNegative = 0.0

    def is_lost(self, rng: np.random.Generator) -> bool:
        """Return True if a sweep is lost."""
        return bool(rng.random() < self.lost_sweeps)

    def late(self, rng: np.random.Generator) -> float:
        """Return the time by which a sweep comes late, in s."""
        return float(self.lateness * rng.standard_exponential())


def repeat_lost_frames(
    samples: NDArray[np.uint8], share: float, direction: int, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Return the (frames, lines, samples) samples of a sweep with lost frames.

    In place of a lost frame stands the last one acquired before it, which the frame grabber still
    holds. The first frame of a sweep is never lost.
    """
    lost = rng.random(len(samples)) < share
    order = np.arange(len(samples))
    shown = np.maximum.accumulate(np.where(lost, 0, order))
    if direction < 0:
        shown = len(samples) - 1 - shown[::-1]
    return seal(samples[shown])


@dataclass(frozen=True, eq=False)
class Reception(Immutable, Generic[T]):
    """Sweeps on their way through a program that processes one at a time.

    When the program is done with a sweep, it takes the newest that has arrived, and drops those
    acquired before it. A program with a single thread that always wants the newest picture does so,
    such as `sonoservo track` on a live connection.
    """

    coming: tuple[tuple[float, T], ...] = ()
    """Time of arrival in s and sweep, in the order of acquisition, for those not taken yet."""
    busy: tuple[float, T] | None = None
    """Time in s at which the program is done with its present sweep, and that sweep."""
    processed: T | None = None

    def sent(self, sweep: T, arrival: float) -> "Reception[T]":
        """Return the reception after another sweep was sent, which arrives at a time in s."""
        return Reception((*self.coming, (arrival, sweep)), self.busy, self.processed)

    def at(self, time: float, processing_time: float) -> "Reception[T]":
        """Return the reception at a later time; a sweep takes a processing time; both in s."""
        coming, busy, processed = self.coming, self.busy, self.processed
        if busy is not None and busy[0] <= time + _SLACK:
            processed, busy = busy[1], None
        arrived = [n for n, (arrival, _) in enumerate(coming) if arrival <= time + _SLACK]
        if busy is None and arrived:
            newest = coming[arrived[-1]][1]
            coming = coming[arrived[-1] + 1 :]
            if processing_time > 0:
                busy = (time + processing_time, newest)
            else:
                processed = newest
        return Reception(coming, busy, processed)
