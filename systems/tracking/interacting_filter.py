"""Interacting Kalman filters on the needle's control points: steady, unsteady and carried along."""

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar

import numpy as np
from filterpy.kalman import predict
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from scipy.spatial.transform import Rotation

from sonoservo.systems.signals.immutable import Immutable, Shape, Vector3
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.requirements import Positive, check_bounds, require
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.tracking.needle_motion import NeedleMotionParameters, constant_velocity

Floats = NDArray[np.float64]

_AVERAGED = 0.05
"""Share of a measured direction in the average."""


@dataclass(frozen=True, eq=False)
class InteractingState(Immutable):
    """Belief of each motion model about X = (p_1 ... p_n, their velocities, repeated error).

    Parameters
    ----------
    time
        Time for which the state holds, in s.
    means, covariances
        (3, 9n) means and (3, 9n, 9n) covariances under each model, in W: control points in m,
        their velocities in m/s, and the repeated error of the measured points, relative to its
        standard deviation.
    weights
        (3,) probabilities of the models.
    constant
        (3n, 3n) covariance of an error that all measurements of the points have in common, in m^2.
    seen
        Last measurement.
    axis
        (3,) direction of the needle, averaged over seconds.
    """

    time: float
    means: Annotated[Floats, Shape(3, "n")]
    covariances: Annotated[Floats, Shape(3, "n", "n")]
    weights: Vector3
    constant: Annotated[Floats, Shape("m", "m")]
    seen: NeedleMeasurement
    axis: Vector3

    @property
    def _size(self) -> int:
        return self.means.shape[-1] // 3

    @property
    def mean(self) -> Floats:
        """(9n,) mean over the models."""
        return np.asarray(self.weights @ self.means)

    @property
    def curve(self) -> NeedleCurve:
        """Curve of the control points in W."""
        return NeedleCurve(self.mean[: self._size].reshape(-1, 3))

    @property
    def velocity(self) -> Floats:
        """(n, 3) velocities of the control points in W, in m/s."""
        return self.mean[self._size : 2 * self._size].reshape(-1, 3)

    @property
    def covariance(self) -> Floats:
        """(6n, 6n) covariance of the control points and their velocities over the models."""
        size = self._size
        _, P = _mixed(self.weights, self.means, self.covariances)
        P[:size, :size] += self.constant
        return np.asarray(P[: 2 * size, : 2 * size])

    def transformed(self, X: RigidTransform) -> "InteractingState":
        """Return the state moved by a rigid transform, with its velocities rotated."""
        n = self._size // 3
        R = np.kron(np.eye(3 * n), X.rotation().matrix())
        means = self.means @ R.T
        means[:, : 3 * n] += np.tile(X.translation(), n)
        points = R[: 3 * n, : 3 * n]
        seen = replace(
            self.seen,
            curve=self.seen.curve.transformed(X),
            covariance=points @ self.seen.covariance @ points.T,
            X_WP=None if self.seen.X_WP is None else X.multiply(self.seen.X_WP),
        )
        return replace(
            self,
            means=means,
            covariances=R @ self.covariances @ R.T,
            constant=points @ self.constant @ points.T,
            seen=seen,
            axis=X.rotation().matrix() @ self.axis,
        )


@dataclass(kw_only=True)
class InteractingFilter:
    """Filter of a needle that moves steadily or not, with errors that repeat themselves.

    Three Kalman filters as in Chatelain 2013 (eqs. 3-14) interact (Blom and Bar-Shalom 1988): one
    with little acceleration, one with much of it along the needle, and one with much of it in every
    direction. A hand rests or pushes evenly most of the time, and then the measurements of many
    volumes count. It starts and stops, and tissue that breathes carries the needle along.

    Most of a measurement's error is due to the needle's speckle. It repeats itself as long as
    neither probe nor needle moves, and a repetition is no evidence. The repeated part is therefore
    a state of its own, and its correlation between volumes falls with the motion in between.
    Another part, due to the shape of this needle's tip, never changes. The paper publishes no
    values.

    Parameters
    ----------
    kind
        Name of the filter, always "interacting".
    steady, unsteady, carried
        Spectral densities of the needle's acceleration under each model.
    steady_time, unsteady_time, carried_time
        Mean time for which a needle moves steadily, unsteadily and with the tissue, in s.
    unseen_time
        Time in s in which the velocity falls to 1/e while the tip is not seen. A hand that pushes
        stops before long.
    constant, repeated
        Shares of a measurement's variance that never change, and that repeat themselves at the same
        place in the same view.
    place_length, view_length, view_angle_deg
        Motion of the tip in W and of the tip in the probe's frame, in m, and turn of the probe, in
        degrees, that let the correlation of the repeated error fall to exp(-1/2).
    first_speed_std, first_drift_std
        Standard deviations of the tip's velocity along the needle, and of every point's velocity in
        every direction, at the start of a track, in m/s.
    """

    orders: ClassVar[tuple[int, ...]] = (2, 3)

    kind: str = "interacting"
    steady: NeedleMotionParameters = field(
        default_factory=lambda: NeedleMotionParameters(insertion=2e-8, body=2e-8, bending=2e-8)
    )
    unsteady: NeedleMotionParameters = field(default_factory=NeedleMotionParameters)
    carried: NeedleMotionParameters = field(
        default_factory=lambda: NeedleMotionParameters(body=3e-5)
    )
    steady_time: Positive = 3.0
    unsteady_time: Positive = 1.0
    carried_time: Positive = 1.0
    unseen_time: Positive = 0.5
    constant: float = 0.25
    repeated: float = 0.65
    place_length: Positive = 3e-3
    view_length: Positive = 0.7e-3
    view_angle_deg: Positive = 2.5
    first_speed_std: Positive = 4e-3
    first_drift_std: Positive = 2e-3

    def __post_init__(self) -> None:
        require(self.kind == "interacting", "kind", self.kind, '"interacting"')
        both = self.constant + self.repeated
        require(min(self.constant, self.repeated) >= 0, "constant", self.constant, "at least 0")
        require(both < 1, "constant + repeated", both, "below 1")
        check_bounds(self)

    @property
    def _times(self) -> Floats:
        return np.array([self.steady_time, self.unsteady_time, self.carried_time])

    def start(self, measurement: NeedleMeasurement) -> InteractingState:
        """Return the state after a first measurement, with an unknown velocity."""
        curve, R = measurement.curve, measurement.covariance
        size = 3 * curve.order
        u, k = np.linspace(0, 1, curve.order), curve.direction
        points, velocities, errors = (slice(i * size, (i + 1) * size) for i in range(3))
        P = np.zeros((3 * size, 3 * size))
        P[points, points] = measurement.total_covariance - self.constant * R
        P[velocities, velocities] = self.first_drift_std**2 * np.eye(
            size
        ) + self.first_speed_std**2 * np.kron(np.outer(u, u), np.outer(k, k))
        # The points are known by the measurement only: where its error is, they are not.
        root = np.sqrt(self.repeated) * _root(R)
        P[errors, errors] = np.eye(size)
        P[points, errors], P[errors, points] = -root, -root.T
        mean = np.concatenate([curve.control_points.ravel(), np.zeros(2 * size)])
        # As many as there are on average: all models are left for each other one alike.
        weights = self._times / self._times.sum()
        return InteractingState(
            measurement.time,
            np.stack([mean] * len(weights)),
            np.stack([P] * len(weights)),
            weights,
            self._constant(measurement, R),
            measurement,
            k,
        )

    def predict(self, state: InteractingState, time: float) -> InteractingState:
        """Return the state at a later time in s (eqs. 10, 11); an earlier time changes nothing."""
        dt = time - state.time
        if dt <= 0:
            return state
        switch = transition(dt, self._times)
        fades = self.unseen_time / max(1 - state.seen.tip_seen, 1e-9)
        weights = state.weights @ switch
        means, covariances = np.empty_like(state.means), np.empty_like(state.covariances)
        size = state.means.shape[1] // 3
        moving, curve = 2 * size, state.curve
        for model, motion in enumerate((self.steady, self.unsteady, self.carried)):
            came_from = state.weights * switch[:, model] / weights[model]
            mean, P = _mixed(came_from, state.means, state.covariances)
            A, Q = np.eye(3 * size), np.zeros((3 * size, 3 * size))
            A[:moving, :moving], Q[:moving, :moving] = constant_velocity(
                dt, motion.density(curve), fades=fades
            )
            means[model], covariances[model] = predict(mean, P, A, Q)
        return replace(state, time=time, means=means, covariances=covariances, weights=weights)

    def update(
        self,
        state: InteractingState,
        measurement: NeedleMeasurement | None,
        velocity: VelocityMeasurement | None,
    ) -> InteractingState:
        """Return the state corrected by the measured control points (eqs. 12 to 14)."""
        if measurement is None:
            return state
        size = 3 * measurement.curve.order
        # The measured direction jitters. Were the errors along it, an ever larger one along the
        # needle would explain that, and the entry would slide away.
        axis = state.axis + (measurement.curve.direction - state.axis) * _AVERAGED
        axis = axis / np.linalg.norm(axis)
        turned = np.kron(np.eye(size // 3), _rotation(measurement.curve.direction, axis))
        R = turned @ measurement.covariance @ turned.T
        kept = self._correlation(state.seen, measurement)
        fades = np.r_[np.ones(2 * size), np.full(size, kept)]
        renewed = np.diag(np.r_[np.zeros(2 * size), np.full(size, 1 - kept**2)])
        C = np.hstack([np.eye(size), np.zeros((size, size)), np.sqrt(self.repeated) * _root(R)])
        # The tip may be at any of its places, so each is tried (Bar-Shalom and Tse 1975).
        probabilities, z, wide = map(np.array, zip(*measurement.places, strict=True))
        noise = turned @ wide @ turned.T - (self.constant + self.repeated) * R
        mean = fades * state.means
        P = np.outer(fades, fades) * state.covariances + renewed
        # Under each (model, place): correction, and how well it fits.
        S = (C @ P @ C.T)[:, np.newaxis] + noise
        y = z - (mean @ C.T)[:, np.newaxis]
        gains = np.linalg.solve(S, (C @ P)[:, np.newaxis]).swapaxes(-1, -2)
        distances = np.einsum("mpi,mpi->mp", y, np.linalg.solve(S, y[..., np.newaxis])[..., 0])
        fits = -0.5 * (distances + np.linalg.slogdet(S)[1])
        weights = probabilities * np.exp(fits - fits.max())
        found = mean[:, np.newaxis] + (gains @ y[..., np.newaxis])[..., 0]
        spreads = P[:, np.newaxis] - gains @ S @ gains.swapaxes(-1, -2)
        weights = np.maximum(weights, 1e-300)
        shares = weights / weights.sum(axis=1, keepdims=True)
        mixed = [_mixed(*each) for each in zip(shares, found, spreads, strict=True)]
        means, covariances = map(np.array, zip(*mixed, strict=True))
        weights *= state.weights[:, np.newaxis] / (state.weights @ weights).sum()
        return replace(
            state,
            means=means,
            covariances=0.5 * (covariances + covariances.swapaxes(-1, -2)),
            weights=weights.sum(axis=1),
            constant=self._constant(measurement, R),
            seen=replace(measurement, tip_seen=min(float(weights[:, 0].sum()), 1.0)),
            axis=axis,
        )

    def _constant(self, measurement: NeedleMeasurement, R: Floats) -> Floats:
        """Return the covariance of the errors that all measurements have in common."""
        k = measurement.curve.direction
        # What is not seen goes on along the needle, whose direction is not known exactly.
        span = np.kron([1.0, *np.zeros(measurement.curve.order - 2), -1.0], np.eye(3))
        turns = span @ R @ span.T / measurement.curve.chord**2
        constant = self.constant * R
        constant[-3:, -3:] += measurement.hidden_std**2 * (np.outer(k, k) + turns)
        return constant

    def _correlation(self, before: NeedleMeasurement, now: NeedleMeasurement) -> float:
        """Return the correlation of the repeated errors of two measurements."""
        if before.X_WP is None or now.X_WP is None:
            return 0.0
        tips = before.curve.tip, now.curve.tip
        poses = before.X_WP, now.X_WP
        seen = [X.inverse().multiply(tip) for X, tip in zip(poses, tips, strict=True)]
        turn = poses[0].rotation().InvertAndCompose(poses[1].rotation()).ToAngleAxis().angle()
        apart = np.array(
            [
                np.linalg.norm(tips[1] - tips[0]) / self.place_length,
                np.linalg.norm(seen[1] - seen[0]) / self.view_length,
                turn / np.deg2rad(self.view_angle_deg),
            ]
        )
        # Ends of different sharpness have different errors.
        stds = [
            np.sqrt(each.curve.direction @ each.covariance[-3:, -3:] @ each.curve.direction)
            for each in (before, now)
        ]
        return float(np.exp(-0.5 * apart @ apart) * min(stds) / max(stds))


def _rotation(start: Floats, end: Floats) -> Floats:
    """Return the (3, 3) smallest rotation that turns one unit vector into another."""
    turn = np.cross(start, end)
    angle = np.arctan2(np.linalg.norm(turn), start @ end)
    axis = turn / max(float(np.linalg.norm(turn)), 1e-12)
    return np.asarray(Rotation.from_rotvec(angle * axis).as_matrix())


def _root(R: Floats) -> Floats:
    """Return the symmetric square root of a covariance, which turns with its frame."""
    values, vectors = np.linalg.eigh(R)
    return np.asarray((vectors * np.sqrt(values.clip(0))) @ vectors.T)


def transition(dt: float, times: Floats) -> Floats:
    """Return the (3, 3) probabilities of going from each of three models to each other.

    A model holds for its mean time of `times` and is left for each other one alike; both times in
    s. The rates' exponential is closed: their eigenvalues are 0, for the share of time spent in
    each model, and -m - d and -m + d, for all that passes.
    """
    a, b, c = (0.5 * dt / float(time) for time in times)
    rates = np.array([[-2 * a, a, a], [b, -2 * b, b], [c, c, -2 * c]])
    m, d = a + b + c, math.sqrt(0.5 * ((a - b) ** 2 + (b - c) ** 2 + (c - a) ** 2))
    lasting = np.broadcast_to(times / times.sum(), (3, 3))
    passing = np.eye(3) - lasting
    # exp(-m) times cosh(d) and sinh(d) / d, without overflow.
    slower = math.exp(d - m)
    cosh = 0.5 * slower * (1 + math.exp(-2 * d))
    sinh = -0.5 * slower * math.expm1(-2 * d) / d if d > 0 else slower
    return np.asarray(lasting + cosh * passing + sinh * (rates + m * passing))


def _mixed(weights: Floats, means: Floats, covariances: Floats) -> tuple[Any, Any]:
    """Return mean and covariance of a mixture of Gaussians."""
    mean = weights @ means
    apart = means - mean
    P = np.einsum("m,mij->ij", weights, covariances) + (apart.T * weights) @ apart
    return mean, P
