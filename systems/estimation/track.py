"""What a needle tracker knows between two volumes, and how it predicts."""

from dataclasses import dataclass, replace

import numpy as np
from filterpy.kalman import predict
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable, read_only
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.requirements import require_not_negative


@dataclass(kw_only=True)
class NeedleMotionParameters:
    """Spectral densities of the needle's white acceleration, in m^2/s^3.

    Parameters
    ----------
    insertion
        Along the needle, of the tip; a point at abscissa u has u times the tip's acceleration.
    body
        Of the needle as a whole, in every direction: the tissue moves.
    bending
        Of each control point by itself, in every direction.
    """

    insertion: float = 5e-5
    body: float = 2e-6
    bending: float = 2e-7

    def __post_init__(self) -> None:
        require_not_negative(insertion=self.insertion, body=self.body, bending=self.bending)

    def density(self, curve: NeedleCurve) -> NDArray[np.float64]:
        """(3n, 3n) spectral density of the stacked control points' acceleration."""
        n = curve.order
        u = np.linspace(0, 1, n)
        k = curve.direction
        return (
            self.insertion * np.kron(np.outer(u, u), np.outer(k, k))
            + self.body * np.kron(np.ones((n, n)), np.eye(3))
            + self.bending * np.eye(3 * n)
        )


def constant_velocity(
    dt: float, density: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transition A and noise Q of a constant-velocity model (Chatelain 2013, eqs. 8 and 6).

    Parameters
    ----------
    dt
        Time step in s.
    density
        (d, d) spectral density of the white acceleration.

    Returns
    -------
    A, Q
        (2d, 2d) each.
    """
    identity = np.eye(len(density))
    A: NDArray[np.float64] = np.kron(np.array([[1.0, dt], [0.0, 1.0]]), identity)
    Q: NDArray[np.float64] = np.kron(np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]), density)
    return A, Q


@dataclass(frozen=True, eq=False)
class NeedleTrack(Immutable):
    """The state of a needle tracker; the localizer predicts with it. Falsy without a curve.

    Parameters
    ----------
    mode
        What the tracker is doing. While it is searching, a curve is a candidate not yet confirmed.
    time
        The state holds for this time, in s.
    mean
        (6n,) stacked control points and their velocities in W (eq. 3), in m and m/s; None while
        there is no curve.
    covariance
        (6n, 6n) P.
    motion
        How it may accelerate.
    volume_time
        Time of the newest volume seen, in s.
    missed
        Volumes in a row that did not confirm the needle.
    since
        Time of the last confirmation, in s.
    detections
        First and last of the detections that follow one another; None while there is none.
    rejected
        The last measurement that failed the gate since then.
    reason
        Why the last volume did not confirm the needle.
    X_WP
        Pose of the probe with which the needle is thought to move; None where it moves in W.
    """

    mode: TrackingMode
    time: float
    motion: NeedleMotionParameters
    mean: NDArray[np.float64] | None = None
    covariance: NDArray[np.float64] | None = None
    volume_time: float = -np.inf
    missed: int = 0
    since: float = -np.inf
    detections: tuple[InsertionDetection, InsertionDetection] | None = None
    rejected: NeedleMeasurement | None = None
    reason: str = ""
    X_WP: RigidTransform | None = None

    def __post_init__(self) -> None:
        if self.mean is None or self.covariance is None:
            return
        size = len(self.mean)
        object.__setattr__(self, "mean", read_only(self.mean, "mean", (size,)))
        object.__setattr__(
            self, "covariance", read_only(self.covariance, "covariance", (size, size))
        )

    def __bool__(self) -> bool:
        return self.mean is not None

    @property
    def order(self) -> int:
        """Number n of control points."""
        assert self.mean is not None
        return len(self.mean) // 6

    @property
    def curve(self) -> NeedleCurve:
        """The control points in W."""
        assert self.mean is not None
        return NeedleCurve(self.mean[: 3 * self.order].reshape(-1, 3))

    @property
    def velocity(self) -> NDArray[np.float64]:
        """(n, 3) velocities of the control points in W, in m/s."""
        assert self.mean is not None
        return self.mean[3 * self.order :].reshape(-1, 3)

    def predicted(self, time: float) -> "NeedleTrack":
        """Return the track at a later time (eqs. 10 and 11); an earlier one changes nothing."""
        dt = time - self.time
        if self.mean is None or dt <= 0:
            return self
        A, Q = constant_velocity(dt, self.motion.density(self.curve))
        mean, covariance = predict(self.mean, self.covariance, A, Q)
        return replace(self, time=time, mean=mean, covariance=covariance)

    def seen_from(self, X_WP: RigidTransform) -> "NeedleTrack":
        """Return the track now that the probe is at ``X_WP``: carried along if it moves with it."""
        if self.X_WP is None:
            return self
        X = X_WP.multiply(self.X_WP.inverse())
        track = replace(self, X_WP=X_WP)
        if self.mean is None:
            return track
        R = np.kron(np.eye(2 * self.order), X.rotation().matrix())
        mean = R @ self.mean
        mean[: 3 * self.order] += np.tile(X.translation(), self.order)
        return replace(track, mean=mean, covariance=R @ self.covariance @ R.T)

    @property
    def estimate(self) -> NeedleEstimate:
        """What the outside sees."""
        if not self or self.mode == TrackingMode.SEARCHING:
            return NeedleEstimate(
                self.mode, self.time, volume_time=self.volume_time, reason=self.reason
            )
        return NeedleEstimate(
            self.mode,
            self.time,
            self.curve,
            self.velocity,
            self.covariance,
            self.volume_time,
            self.reason,
        )
