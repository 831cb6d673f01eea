"""Interacting Kalman filters on a needle that moves in four ways, and its end in three."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation
from scipy.special import log_ndtr, ndtr

from sonoservo.systems.signals.immutable import Immutable, Shape, Vector3
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.requirements import Positive, check_bounds, require
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.tracking.needle_motion import (
    NeedleMotionParameters,
    acceleration_density,
    constant_velocity,
)
from sonoservo.systems.tracking.tip import REACH

Floats = NDArray[np.float64]

_AVERAGED = 0.05
"""Share of a measured direction in the average."""


@dataclass(frozen=True, eq=False)
class InteractingState(Immutable):
    """Belief about a needle that moves in four ways, with an end that moves in three.

    With n control points, d = 9n + 2.
    """

    time: float
    """Time for which the state holds, in s."""

    means: Annotated[Floats, Shape(12, "d")]
    """In W: control points from the entry to the end that is seen in m, their velocities in m/s,
    and the repeated error of the measured points, relative to its standard deviation; length of
    needle in m from there to the tip, and the speed in m/s at which it grows. These last two are 0
    unless the end hides."""

    covariances: Annotated[Floats, Shape(12, "d", "d")]
    """Covariances of the means."""

    weights: Annotated[Floats, Shape(12)]
    """Probabilities of the twelve combinations."""

    constant: Annotated[Floats, Shape("3n", "3n")]
    """Covariance of an error that all measurements of the points have in common, in m^2."""

    seen: NeedleMeasurement
    """Last measurement."""

    axis: Vector3
    """Direction of the needle, averaged over seconds."""

    @property
    def _size(self) -> int:
        return self.means.shape[-1] // 3

    @cached_property
    def _needle(self) -> tuple[Floats, Floats]:
        """Most probable (6n,) control points and velocities up to the tip, and their covariance."""
        size, k = self._size, self.axis
        beyond = _beyond(k, size)
        C = np.eye(2 * size, 3 * size + 2)
        C[:size, -2], C[size:, -1] = beyond, beyond
        # The tip is at the end that is seen, or anywhere beyond: not in between, as in the mean.
        kinds = np.tile([[1, 1, 0], [0, 0, 1]], 4)
        totals, x, P = _mixed(kinds * self.weights, self.means, self.covariances)
        means, covariances = x @ C.T, C @ P @ C.T
        # What is not seen goes on along the needle, whose direction is not known exactly.
        aside = np.kron([-1.0, *np.zeros(size // 3 - 2), 1.0], np.eye(3) - np.outer(k, k))
        points = x[:, :size].reshape(2, -1, 3)
        chords = np.sum((points[:, -1] - points[:, 0]) ** 2, axis=1)
        turns = (P[:, -2, -2] + x[:, -2] ** 2) / chords
        tip = slice(size - 3, size)
        covariances[:, tip, tip] += turns[:, np.newaxis, np.newaxis] * (
            aside @ P[:, :size, :size] @ aside.T
        )
        densities = totals / np.sqrt(k @ covariances[:, tip, tip] @ k)
        mean = means[np.argmax(densities)]
        apart = means - mean
        spread = apart[..., np.newaxis] * apart[:, np.newaxis]
        covariance = np.tensordot(totals, covariances + spread, 1)
        covariance[:size, :size] += self.constant
        return mean, covariance

    @cached_property
    def curve(self) -> NeedleCurve:
        """Curve of the control points in W."""
        return NeedleCurve(self._needle[0][: self._size].reshape(-1, 3))

    @property
    def velocity(self) -> Floats:
        """(n, 3) velocities of the control points in W, in m/s."""
        return self._needle[0][self._size :].reshape(-1, 3)

    @property
    def covariance(self) -> Floats:
        """(6n, 6n) covariance of the control points and their velocities, over all motions."""
        return self._needle[1]

    def transformed(self, X: RigidTransform) -> "InteractingState":
        """Return the state moved by a rigid transform, with its velocities rotated."""
        n = self._size // 3
        R = block_diag(np.kron(np.eye(3 * n), X.rotation().matrix()), np.eye(2))
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

    Four Kalman filters as in Chatelain 2013 (eqs. 3-14) interact (Blom and Bar-Shalom 1988): one
    with little acceleration, one with much of it along the needle, one with much of it in every
    direction, and one with very much of it along the needle. A hand rests or pushes evenly most of
    the time, and then the measurements of many volumes count. It starts and stops, tissue that
    breathes carries the needle along, and a hand that jerks, or a patient who does, moves it by
    centimetres within a volume.

    Under each of them, the end that is seen advances, rests or hides. One that advances is the tip.
    One that rests is so because the hand rests, or because the needle's echo fades there: then it
    goes on unseen, and what is not seen grows as the hand pushes.

    Most of a measurement's error is due to the needle's speckle. It repeats itself as long as
    neither probe nor needle moves, and a repetition is no evidence. The repeated part is therefore
    a state of its own, and its correlation between volumes falls with the motion in between.
    Another part, due to the shape of this needle's tip, never changes. The paper publishes no
    values.

    Parameters
    ----------
    kind
        Name of the filter, always "interacting".
    steady, unsteady, carried, jerked
        Spectral densities of the needle's acceleration under each model.
    lasting
        Mean time in s for which a needle moves in one way, and for which its end advances.
    calm
        Mean time in s for which an end rests, and from one jerk to the next.
    unseen_time
        Time in s in which the speed of a tip that is not seen falls to 1/e. A hand that pushes
        stops before long.
    constant, repeated
        Shares of a measurement's variance that never change, and that repeat themselves at the same
        place in the same view.
    place_length, view_length, view_angle_deg
        Motion of the tip in W and of the tip in the probe's frame, in m, and turn of the probe, in
        degrees, that let the correlation of the repeated error fall to exp(-1/2).
    first_speed_std, first_drift_std
        Standard deviations of the tip's velocity along the needle, and of the whole needle's
        velocity in every direction, at the start of a track, in m/s.
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
    jerked: NeedleMotionParameters = field(
        default_factory=lambda: NeedleMotionParameters(insertion=1e-2, body=3e-5)
    )
    lasting: Positive = 2.0
    calm: Positive = 20.0
    unseen_time: Positive = 0.5
    constant: float = 0.25
    repeated: float = 0.65
    place_length: Positive = 1.5e-3
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

    def start(self, measurement: NeedleMeasurement) -> InteractingState:
        """Return the state after a first measurement, with an unknown velocity."""
        curve, R = measurement.curve, measurement.covariance
        size, k = 3 * curve.order, curve.direction
        points, velocities, errors = (slice(i * size, (i + 1) * size) for i in range(3))
        P = np.zeros((3 * size + 2, 3 * size + 2))
        P[points, points] = measurement.total_covariance - self.constant * R
        # A needle drifts as it is: it grows longer only if it advances.
        along, same = np.outer(k, k), np.ones((curve.order, curve.order))
        drifts = np.kron(same, along) + np.kron(np.eye(curve.order), np.eye(3) - along)
        P[velocities, velocities] = self.first_drift_std**2 * drifts
        # The points are known by the measurement only: where its error is, they are not.
        root = np.sqrt(self.repeated) * _root(R)
        P[errors, errors] = np.eye(size)
        P[points, errors], P[errors, points] = -root, -root.T
        advancing, hidden = P.copy(), P.copy()
        beyond = _beyond(k, size)
        advancing[velocities, velocities] += self.first_speed_std**2 * np.outer(beyond, beyond)
        hidden[-2, -2], hidden[-1, -1] = 2 * REACH**2, self.first_speed_std**2
        mean = np.concatenate([curve.control_points.ravel(), np.zeros(2 * size + 2)])
        unseen = measurement.unseen
        return InteractingState(
            measurement.time,
            np.stack([mean] * 12),
            np.stack([advancing, P, hidden] * 4),
            # At first, a hand that pushes is as probable as one that rests.
            np.kron([1, 1, 1, 0], [0.5 * (1 - unseen), 0.5 * (1 - unseen), unseen]) / 3,
            self._constant(measurement, R),
            measurement,
            k,
        )

    def predict(self, state: InteractingState, time: float) -> InteractingState:
        """Return the state at a later time in s (eqs. 10, 11); an earlier time changes nothing."""
        dt = time - state.time
        if dt <= 0:
            return state
        left, jerks = 1 - math.exp(-dt / self.lasting), 1 - math.exp(-dt / self.calm)
        # From one motion to another, by column; a jerk begins from any of the others, and rarely.
        switch = (1 - 1.5 * left) * np.eye(4) + 0.5 * left
        switch[:3, :3] *= 1 - jerks
        switch[:, 3], switch[3] = left / 3, jerks
        switch[3, 3] = 1 - left
        ways = np.kron(switch, np.eye(3))
        weights, x, P = _mixed(ways * state.weights, state.means, state.covariances)
        size, curve = state.means.shape[1] // 3, state.curve
        moving, count = slice(2 * size), len(weights)
        A = np.stack([np.eye(3 * size + 2)] * count)
        Q = np.zeros_like(A)
        motions = (self.steady, self.unsteady, self.carried, self.jerked)
        parts = np.array([[each.insertion, each.body, each.bending] for each in motions])
        # An end that advances moves along the needle, one that rests or hides does not.
        insertion, body, bending = np.repeat(parts, 3, axis=0).T[..., np.newaxis, np.newaxis]
        advancing = np.tile([1.0, 0.0, 0.0], 4)[:, np.newaxis, np.newaxis] * insertion
        density = acceleration_density(curve, advancing, body, bending)
        A[:, moving, moving], Q[:, moving, moving] = constant_velocity(dt, density)
        # A jerk moves what is seen; what is not seen grows as a hand pushes.
        grows = np.minimum(insertion[2::3], self.carried.insertion)
        A[2::3, -2:, -2:], Q[2::3, -2:, -2:] = constant_velocity(dt, grows, fades=self.unseen_time)
        means = (A @ x[..., np.newaxis])[..., 0]
        covariances = A @ P @ A.swapaxes(1, 2) + Q
        weights = weights * _beyond_end(means, covariances) / _beyond_end(x, P)
        return replace(
            state, time=time, means=means, covariances=covariances, weights=weights / weights.sum()
        )

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
        # The measured direction jitters. If the errors were along it, the filter would explain the
        # jitter by an ever larger error along the needle, and the entry would slide away.
        axis = state.axis + (measurement.curve.direction - state.axis) * _AVERAGED
        axis = axis / np.linalg.norm(axis)
        turned = np.kron(np.eye(size // 3), _rotation(measurement.curve.direction, axis))
        R = turned @ measurement.covariance @ turned.T
        came, means, P = self._switched(state, measurement)
        kept = self._correlation(state.seen, measurement)
        fades = np.r_[np.ones(2 * size), np.full(size, kept), 1.0, 1.0]
        renewed = np.diag(np.r_[np.zeros(2 * size), np.full(size, 1 - kept**2), 0.0, 0.0])
        parts = np.eye(size), np.zeros((size, size)), np.sqrt(self.repeated) * _root(R)
        C = np.hstack([*parts, np.zeros((size, 2))])
        # The end may be at any of its places, so each is tried (Bar-Shalom and Tse 1975).
        probabilities, z, wide = map(np.array, zip(*measurement.places, strict=True))
        noise = turned @ wide @ turned.T - (self.constant + self.repeated) * R
        mean = fades * means
        P = np.outer(fades, fades) * P + renewed
        # Under each (way, place): correction, and how well it fits.
        S = (C @ P @ C.T)[:, np.newaxis] + noise
        y = z - (mean @ C.T)[:, np.newaxis]
        inverse, CP = np.linalg.inv(S), (C @ P)[:, np.newaxis]
        gains = CP.swapaxes(-1, -2) @ inverse
        distances = np.einsum("mpi,mpij,mpj->mp", y, inverse, y)
        fits = -0.5 * (distances + np.linalg.slogdet(S)[1])
        found = mean[:, np.newaxis] + (gains @ y[..., np.newaxis])[..., 0]
        corrected = P[:, np.newaxis] - gains @ CP
        weights = came[:, np.newaxis] * probabilities * np.exp(fits - fits.max())
        weights *= _beyond_end(found, corrected) / _beyond_end(mean, P)[:, np.newaxis]
        found, corrected = _not_before_end(found, corrected)
        # States that were far apart before the volume are close now, so they are merged only here.
        weights, means, covariances = (
            each.reshape(12, -1, *each.shape[2:]) for each in (weights, found, corrected)
        )
        weights, means, covariances = _mixed(weights, means, covariances)
        return replace(
            state,
            means=means,
            covariances=0.5 * (covariances + covariances.swapaxes(-1, -2)),
            weights=weights / weights.sum(),
            constant=self._constant(measurement, R),
            seen=measurement,
            axis=axis,
        )

    def _switched(
        self, state: InteractingState, now: NeedleMeasurement
    ) -> tuple[Floats, Floats, Floats]:
        """Return (36,) weights, means and covariances before a measurement, as an end may switch.

        They are ordered by motion, the end's new way and its last one. The farther the tip has
        advanced and the more the view of it has changed, the more probably something new hides it.
        """
        before, dt = state.seen, now.time - state.seen.time
        size, k = 3 * now.curve.order, state.axis
        velocity, beyond = state.velocity, _beyond(k, size)
        advanced, slid = abs((velocity[-1] - velocity[0]) @ k) * dt, 0.0
        if before.X_WP is not None and now.X_WP is not None:
            # What fades by the angle at which sound meets it moves along with the probe.
            X, end = now.X_WP.multiply(before.X_WP.inverse()), before.curve.tip
            turned = X.rotation().ToAngleAxis().angle() * (end - now.X_WP.translation())
            slid = math.hypot((X.multiply(end) - end) @ k, np.linalg.norm(turned))
        renewed = 1 - math.exp(-(advanced + slid) / REACH)
        hides, shows = renewed * now.unseen, renewed * (1 - now.unseen)
        stops, pushes = (1 - math.exp(-dt / time) for time in (self.lasting, self.calm))
        # An end that hides stops while the needle advances. One that stops or starts is the tip,
        # and what hid shows itself where the needle ends.
        same, hide, show = (np.eye(3 * size + 2) for _ in range(3))
        speed = np.r_[-k, np.zeros(size - 6), k]
        hide[:size, size : 2 * size] -= dt * np.outer(beyond, speed)
        hide[size : 2 * size, size : 2 * size] -= np.outer(beyond, speed)
        stop = hide.copy()
        hide[-2:, size : 2 * size] = np.outer([dt, 1.0], speed)
        show[:size, -2], show[size : 2 * size, -1] = beyond, beyond
        show[-2:] = 0
        slides, starts = (np.zeros(3 * size + 2) for _ in range(2))
        slides[:size], slides[-2] = slid * beyond, -slid
        starts[size : 2 * size] = self.first_speed_std * beyond
        # From an end that advances, rests or hides to one that does, by row.
        ways = np.array(
            [[1 - stops, pushes, shows], [stops, 1 - pushes, 0.0], [hides, hides, 1 - shows]]
        )
        ways[:2, :2] *= 1 - hides
        T = np.array([[same, same, show], [stop, same, same], [hide, same, same]])
        drift = np.zeros((3, 3, len(same)))
        drift[0, 1], drift[2, 1:] = starts, slides
        x, P = state.means.reshape(4, 1, 3, -1, 1), state.covariances.reshape(4, 1, 3, *same.shape)
        P = T @ P @ T.swapaxes(-1, -2) + drift[..., np.newaxis] * drift[..., np.newaxis, :]
        came = ways * state.weights.reshape(4, 1, 3)
        return came.ravel(), (T @ x)[..., 0].reshape(36, -1), P.reshape(36, *same.shape)

    def _constant(self, measurement: NeedleMeasurement, R: Floats) -> Floats:
        """Return the covariance of the errors that all measurements share."""
        return self.constant * R + (0 if measurement.common is None else measurement.common)

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


def _beyond(axis: Floats, size: int) -> Floats:
    """Return the (3n,) displacements of control points for 1 m of the last along an axis."""
    return np.outer(np.linspace(0, 1, size // 3), axis).ravel()


def _beyond_end(means: Floats, covariances: Floats) -> Floats:
    """Return (...) probabilities that no tip lies before the end that is seen."""
    return ndtr(means[..., -2] / np.sqrt(np.maximum(covariances[..., -2, -2], 1e-12)))


def _not_before_end(means: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """Return moments of Gaussians without what lies before the end that is seen.

    A tip behind that end is pushed on, and all that is correlated with it (Simon and Simon 2010).
    """
    std = np.sqrt(np.maximum(covariances[..., -2, -2], 1e-12))
    t = means[..., -2] / std
    hazard = np.exp(-0.5 * t**2 - log_ndtr(t)) / math.sqrt(2 * math.pi)
    gain = covariances[..., -2] / std[..., np.newaxis]
    lost = gain[..., np.newaxis] * gain[..., np.newaxis, :]
    return (
        means + hazard[..., np.newaxis] * gain,
        covariances - (hazard * (hazard + t))[..., np.newaxis, np.newaxis] * lost,
    )


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


def _mixed(weights: Floats, means: Floats, covariances: Floats) -> tuple[Any, Any, Any]:
    """Return weight, mean and covariance of mixtures of Gaussians, (..., m) weighted ones each.

    What is impossible has any mean.
    """
    total = weights.sum(axis=-1)
    shares = np.where(total[..., np.newaxis] > 0, weights, 1.0)
    shares = (shares / shares.sum(axis=-1, keepdims=True))[..., np.newaxis, :]
    mean = (shares @ means)[..., 0, :]
    apart = means - mean[..., np.newaxis, :]
    size = means.shape[-1]
    flat = covariances.reshape(*covariances.shape[:-2], size**2)
    P = (shares @ flat)[..., 0, :].reshape(*mean.shape, size)
    P += (apart.swapaxes(-1, -2) * shares) @ apart
    return total, mean, P
