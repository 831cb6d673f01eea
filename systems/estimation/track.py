"""Life of a track: initiate, confirm, gate, coast, lose, find again, end.

A `NeedleFilter` models the needle's motion and its correction in between.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from scipy.stats import chi2

from sonoservo.systems.estimation.needle_filter import NeedleFilter, NeedleState
from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.requirements import require, require_positive
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement


@dataclass(kw_only=True)
class TrackParameters:
    """Rules for the start, the gate and the end of a track. The papers publish no values.

    Parameters
    ----------
    first_std
        Standard deviation of the control points at a detection, in m.
    min_advance
        Distance by which the tip must advance from the first to the last of successive detections,
        in m.
    max_detection_jump
        Largest distance of the tip between successive detections, in m.
    gate
        Probability that a true measurement passes the gate on the innovation.
    volumes_to_confirm
        Number of volumes within which a detection must be repeated and the needle be localized.
    volumes_to_lose
        Number of successive volumes without the needle after which it is lost and the whole volume
        is searched.
    withdrawn_length
        Predicted length below which a needle that is not found counts as withdrawn, in m.
    seconds_to_give_up
        Time without the needle after which a new insertion is awaited, in s.
    filtering
        Whether measurements are filtered. If not, each one starts the track anew, without a
        velocity for the prediction and without a gate on the innovation.
    max_approach
        Largest motion of the probe along its axis during a sweep, in m, at which a needle may be
        found anywhere. A probe that lands shows the edge of its contact, which looks like a needle.
    probe_frame
        Whether the needle's state is kept in the probe's frame, as in Chatelain 2013. The state
        then moves along with the probe, and its velocity is that in the image, which suits only the
        servo without feed-forward. If not, the state is kept in W.
    """

    first_std: float = 1.0e-3
    min_advance: float = 2.5e-3
    max_detection_jump: float = 10e-3
    gate: float = 0.9999
    volumes_to_confirm: int = 4
    volumes_to_lose: int = 4
    withdrawn_length: float = 6e-3
    seconds_to_give_up: float = 10.0
    filtering: bool = True
    max_approach: float = 0.5e-3
    probe_frame: bool = False

    def __post_init__(self) -> None:
        require_positive(
            first_std=self.first_std,
            min_advance=self.min_advance,
            max_detection_jump=self.max_detection_jump,
            gate=self.gate,
            withdrawn_length=self.withdrawn_length,
            seconds_to_give_up=self.seconds_to_give_up,
            max_approach=self.max_approach,
        )
        require(self.gate < 1, "gate", self.gate, "below 1")
        for name in ("volumes_to_confirm", "volumes_to_lose"):
            require(getattr(self, name) >= 1, name, getattr(self, name), "1 or more")


@dataclass(frozen=True, eq=False)
class Track(Immutable):
    """Track of a needle that is being followed or awaited; falsy without a state.

    Parameters
    ----------
    mode
        Stage of the track's life. In the searching stage, a state is an unconfirmed candidate.
    time
        Time of the state in s, or of the last change if there is no state.
    state
        State of the filter; None while there is no needle.
    volume_time
        Time of the newest volume seen, in s.
    X_WP
        Pose of the probe with which the needle is assumed to move; None if its state is kept in W.
    missed
        Number of successive volumes that did not confirm the needle.
    since
        Time of the last confirmation, in s.
    detections
        First and last of successive detections; None if there is none.
    rejected
        Last measurement that failed the gate since the last confirmation.
    innovation
        Mahalanobis distance of the last measurement from its prediction; None if none was gated.
    reason
        Reason why the last volume did not confirm the needle.
    """

    mode: TrackingMode
    time: float
    state: NeedleState | None = None
    volume_time: float = -np.inf
    X_WP: RigidTransform | None = None
    missed: int = 0
    since: float = -np.inf
    detections: tuple[InsertionDetection, InsertionDetection] | None = None
    rejected: NeedleMeasurement | None = None
    innovation: float | None = None
    reason: str = ""

    def __bool__(self) -> bool:
        return self.state is not None

    def seen_from(self, X_WP: RigidTransform) -> "Track":
        """Return the track with the probe at ``X_WP``; a state in the probe's frame moves along."""
        if self.X_WP is None:
            return self
        if self.state is None:
            return replace(self, X_WP=X_WP)
        X = X_WP.multiply(self.X_WP.inverse())
        return replace(self, X_WP=X_WP, state=self.state.transformed(X))

    @property
    def estimate(self) -> NeedleEstimate:
        """Estimate of the needle; it contains no curve while the track is unconfirmed."""
        nothing = NeedleEstimate(
            self.mode, self.time, volume_time=self.volume_time, reason=self.reason
        )
        state = self.state
        if state is None or self.mode == TrackingMode.SEARCHING:
            return nothing
        return replace(
            nothing, curve=state.curve, velocity=state.velocity, covariance=state.covariance
        )


def innovation_distance(state: NeedleState, measurement: NeedleMeasurement) -> float:
    """Return the Mahalanobis distance of a measurement from a state predicted to its time."""
    points = state.curve.control_points.ravel()
    y = measurement.curve.control_points.ravel() - points
    S = state.covariance[: len(points), : len(points)] + measurement.covariance
    return float(np.sqrt(y @ np.linalg.solve(S, y)))


@lru_cache
def gate_distance(gate: float, order: int) -> float:
    """Return the Mahalanobis distance that a true measurement exceeds with probability 1 - gate."""
    return float(np.sqrt(chi2.ppf(gate, 3 * order)))


@dataclass(frozen=True, kw_only=True)
class TrackLifecycle:
    """Rules by which a track begins, continues and ends, as pure functions.

    Parameters
    ----------
    order
        Number n of control points of the needle's curve.
    parameters
        Thresholds.
    needle_filter
        Filter that starts, predicts and updates the track's state.
    anywhere
        Whether the whole volume is searched while there is no needle. The insertion then need not
        be seen.
    """

    order: int
    parameters: TrackParameters
    needle_filter: NeedleFilter[Any]
    anywhere: bool = False

    def without_needle(self, time: float, reason: str = "") -> Track:
        """Return the track at a time in s while there is no needle."""
        mode = TrackingMode.LOST if self.anywhere else TrackingMode.SEARCHING
        return Track(mode, time, reason=reason)

    def confirm(self, state: NeedleState, time: float, innovation: float | None = None) -> Track:
        """Return a track that is confirmed by a measurement at a time in s."""
        return Track(TrackingMode.TRACKING, state.time, state, since=time, innovation=innovation)

    def predict(
        self, track: Track, time: float, X_WP: RigidTransform
    ) -> NeedlePrediction | NotFound:
        """Return the prediction for a volume.

        A lost needle is not predicted. Its last curve only tells which of its ends is the tip.

        Parameters
        ----------
        track
            Track after the previous volume.
        time, X_WP
            Time of the volume in s, and pose of the probe.
        """
        lost = track.mode == TrackingMode.LOST
        last = track.seen_from(X_WP).state
        if last is None:
            if lost:
                return NeedlePrediction(self.order, time, everywhere=True)
            return NotFound("no needle has been detected")
        state = last if lost else self.needle_filter.predict(last, time)
        points = 3 * self.order
        return NeedlePrediction(
            self.order,
            state.time,
            state.curve,
            state.velocity,
            state.covariance[:points, :points],
            entry=None if track.mode == TrackingMode.SEARCHING else last.curve.entry,
            missed=track.missed,
            everywhere=lost,
        )

    def next(
        self,
        track: Track,
        time: float,
        *,
        detection: InsertionDetection | NotFound,
        measurement: NeedleMeasurement | NotFound,
        velocity: VelocityMeasurement | NotFound,
    ) -> Track:
        """Return the track after a volume.

        Parameters
        ----------
        track
            Track before the volume, seen from the probe's pose at the volume.
        time
            Time of the volume, in s.
        detection, measurement, velocity
            Results of detector, localizer and velocimeter for the volume.
        """
        speed = velocity if isinstance(velocity, VelocityMeasurement) else None
        if isinstance(measurement, NotFound):
            missed = replace(track, innovation=None)
            return self._miss(missed, time, detection, speed, measurement.reason)
        fresh = track.mode in (TrackingMode.SEARCHING, TrackingMode.LOST)
        if fresh or not self.parameters.filtering:
            return self.confirm(self.needle_filter.start(measurement), measurement.time)
        state = self.needle_filter.predict(track.state, measurement.time)
        distance = innovation_distance(state, measurement)
        if distance <= self.gate:
            state = self.needle_filter.update(state, measurement, speed)
            return self.confirm(state, measurement.time, distance)
        if track.rejected is not None:
            # If two rejected measurements agree with each other, the prediction is wrong.
            before = self.needle_filter.start(track.rejected)
            before = self.needle_filter.predict(before, measurement.time)
            if innovation_distance(before, measurement) <= self.gate:
                state = self.needle_filter.start(measurement)
                return self.confirm(state, measurement.time, distance)
        missed = replace(track, rejected=measurement, innovation=distance)
        reason = f"the measurement is {distance:.1f} standard deviations from the prediction"
        return self._miss(missed, time, detection, speed, reason)

    @property
    def gate(self) -> float:
        """Largest Mahalanobis distance at which a measurement is accepted."""
        return gate_distance(self.parameters.gate, self.order)

    def _miss(
        self,
        track: Track,
        time: float,
        detection: InsertionDetection | NotFound,
        velocity: VelocityMeasurement | None,
        reason: str,
    ) -> Track:
        """Return the track after a volume that did not confirm it."""
        p = self.parameters
        track = replace(track, missed=track.missed + 1)
        if track.mode == TrackingMode.SEARCHING:
            return self._await(track, time, detection, reason)
        if time - track.since > p.seconds_to_give_up:
            return self.without_needle(time, reason)
        if track.mode == TrackingMode.LOST:
            return replace(track, reason=reason)
        assert track.state is not None
        state = self.needle_filter.predict(track.state, time)
        state = self.needle_filter.update(state, None, velocity)
        length = (state.curve.tip - state.curve.entry) @ track.state.curve.direction
        if length < p.withdrawn_length:
            return self.without_needle(time, "the needle was withdrawn")
        mode = TrackingMode.LOST if track.missed >= p.volumes_to_lose else TrackingMode.COASTING
        return replace(track, mode=mode, time=state.time, state=state, reason=reason)

    def _await(
        self, track: Track, time: float, detection: InsertionDetection | NotFound, reason: str
    ) -> Track:
        """Return the track after a volume in which no needle was localized yet."""
        if isinstance(detection, InsertionDetection):
            return self.initiate(track, detection)
        if track.detections is None or track.missed >= self.parameters.volumes_to_confirm:
            return self.without_needle(time, detection.reason)
        return replace(track, reason=reason if track else detection.reason)

    def initiate(self, track: Track, detection: InsertionDetection) -> Track:
        """Start an unconfirmed track once successive detections have advanced.

        If the tissue trembles, something bright may seem to change, but it does not advance. The
        needle points from the first detection's tip to the last one's.
        """
        p = self.parameters
        first, last = track.detections or (detection, detection)
        jump = float(np.linalg.norm(detection.p_WTip - last.p_WTip))
        depths = [np.linalg.norm(each.p_WTip - first.p_WEntry) for each in (first, detection)]
        if jump > p.max_detection_jump or depths[1] < depths[0]:
            # Something else moves, or a needle is being withdrawn.
            first = detection
        started = Track(
            TrackingMode.SEARCHING,
            detection.time,
            detections=(first, detection),
            reason="something moved; the needle is not confirmed yet",
        )
        advance = detection.p_WTip - first.p_WTip
        if np.linalg.norm(advance) < p.min_advance:
            return started
        points = first.p_WTip + np.outer(np.linspace(0, 1, self.order), advance)
        covariance = p.first_std**2 * np.eye(points.size)
        guess = NeedleMeasurement(NeedleCurve(points), covariance, detection.time, 0, 0.0)
        return replace(started, state=self.needle_filter.start(guess), reason="")
