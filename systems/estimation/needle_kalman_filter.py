"""Tracks the needle's control points from volume to volume."""

from dataclasses import dataclass, field, replace

import numpy as np
from filterpy.kalman import update
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State
from scipy.stats import chi2

from sonoservo.systems.estimation.track import NeedleMotionParameters, NeedleTrack
from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.requirements import require, require_not_negative, require_positive
from sonoservo.systems.signals.volume import Volume


@dataclass(kw_only=True)
class NeedleKalmanFilterParameters:
    """How the filter starts, what it believes and when it gives up. The paper publishes no values.

    Parameters
    ----------
    order
        n of the curve: 2 straight, 3 bent.
    motion
        How the needle may accelerate: Q.
    first_std
        Standard deviation of the control points at a detection, in m.
    first_speed_std, first_drift_std
        Standard deviations of the tip's velocity along the needle, and of every point's in every
        direction, when a track starts, in m/s.
    min_advance
        Of the tip, from the first to the last of detections that follow one another, in m.
    max_detection_jump
        Of the tip between detections that follow one another, in m.
    gate
        Probability that a true measurement passes the gate on the innovation.
    volumes_to_confirm
        Within which a detection must be repeated, and the localizer see the needle.
    volumes_to_lose
        In a row without the needle, after which it is sought everywhere.
    withdrawn_length
        Predicted length at which a needle that is not found counts as withdrawn, in m.
    seconds_to_give_up
        Without the needle, after which a new insertion is awaited.
    filtering
        Whether measurements are filtered; off, each one starts the track anew, so that there is
        neither a velocity to predict with nor a gate on the innovation.
    probe_frame
        Whether the needle's state is kept in the frame of the probe, as in the paper: it is then
        carried along as the probe moves, and its velocity is that in the image, which suits the
        servo without feed-forward only. Off, it is kept in W.
    anywhere
        Whether a needle is sought in the whole volume as long as there is none, so that no
        insertion need be seen.
    """

    order: int = 2
    motion: NeedleMotionParameters = field(default_factory=NeedleMotionParameters)
    first_std: float = 1.0e-3
    first_speed_std: float = 4e-3
    first_drift_std: float = 2e-3
    min_advance: float = 2.5e-3
    max_detection_jump: float = 10e-3
    gate: float = 0.9999
    volumes_to_confirm: int = 4
    volumes_to_lose: int = 4
    withdrawn_length: float = 6e-3
    seconds_to_give_up: float = 10.0
    filtering: bool = True
    probe_frame: bool = False
    anywhere: bool = False

    def __post_init__(self) -> None:
        require(self.order in (2, 3), "order", self.order, "2 or 3")
        require_positive(
            first_std=self.first_std,
            first_speed_std=self.first_speed_std,
            first_drift_std=self.first_drift_std,
            min_advance=self.min_advance,
            max_detection_jump=self.max_detection_jump,
            gate=self.gate,
            withdrawn_length=self.withdrawn_length,
            seconds_to_give_up=self.seconds_to_give_up,
        )
        require(self.gate < 1, "gate", self.gate, "below 1")
        for name in ("volumes_to_confirm", "volumes_to_lose"):
            require(getattr(self, name) >= 1, name, getattr(self, name), "1 or more")


def _track(
    mode: TrackingMode,
    time: float,
    curve: NeedleCurve,
    covariance: NDArray[np.float64],
    parameters: NeedleKalmanFilterParameters,
) -> NeedleTrack:
    """Start a track at a curve whose velocity is not known."""
    size = 3 * curve.order
    u, k = np.linspace(0, 1, curve.order), curve.direction
    P = np.zeros((2 * size, 2 * size))
    P[:size, :size] = covariance
    P[size:, size:] = parameters.first_drift_std**2 * np.eye(
        size
    ) + parameters.first_speed_std**2 * (np.kron(np.outer(u, u), np.outer(k, k)))
    mean = np.concatenate([curve.control_points.ravel(), np.zeros(size)])
    return NeedleTrack(mode, time, parameters.motion, mean, P, since=time)


def start_track(
    track: NeedleTrack, detection: InsertionDetection, parameters: NeedleKalmanFilterParameters
) -> NeedleTrack:
    """Start a track, not yet confirmed, once detections that follow one another have advanced.

    Where the tissue trembles, something bright may seem to change, but it stays where it is. From
    the first detection's tip to the last one's is the needle's direction.
    """
    first, last = track.detections or (detection, detection)
    jump = float(np.linalg.norm(detection.p_WTip - last.p_WTip))
    depths = [np.linalg.norm(each.p_WTip - first.p_WEntry) for each in (first, detection)]
    if jump > parameters.max_detection_jump or depths[1] < depths[0]:
        # Something else moves, or a needle is being withdrawn.
        first = detection
    empty = NeedleTrack(
        TrackingMode.SEARCHING,
        detection.time,
        parameters.motion,
        detections=(first, detection),
        reason="something moved; the needle is not confirmed yet",
    )
    advance = detection.p_WTip - first.p_WTip
    if np.linalg.norm(advance) < parameters.min_advance:
        return empty
    points = first.p_WTip + np.outer(np.linspace(0, 1, parameters.order), advance)
    covariance = parameters.first_std**2 * np.eye(points.size)
    started = _track(
        TrackingMode.SEARCHING, detection.time, NeedleCurve(points), covariance, parameters
    )
    return replace(started, detections=empty.detections)


def restart_track(
    measurement: NeedleMeasurement, parameters: NeedleKalmanFilterParameters
) -> NeedleTrack:
    """Start a track at a measurement: of a needle newly found, or found again."""
    return _track(
        TrackingMode.TRACKING,
        measurement.time,
        measurement.curve,
        measurement.covariance,
        parameters,
    )


def innovation_distance(track: NeedleTrack, measurement: NeedleMeasurement) -> float:
    """Squared Mahalanobis distance of a measurement from the track predicted to its time."""
    assert track.mean is not None
    assert track.covariance is not None
    size = 3 * track.order
    y = measurement.curve.control_points.ravel() - track.mean[:size]
    S = track.covariance[:size, :size] + measurement.covariance
    return float(y @ np.linalg.solve(S, y))


def update_track(track: NeedleTrack, measurement: NeedleMeasurement) -> NeedleTrack:
    """Update the track with a measurement at its time (Chatelain 2013, eqs. 12-14)."""
    C = np.eye(3 * track.order, 6 * track.order)
    mean, covariance = update(
        track.mean,
        track.covariance,
        measurement.curve.control_points.ravel(),
        measurement.covariance,
        C,
    )
    return replace(
        track,
        mode=TrackingMode.TRACKING,
        mean=mean,
        covariance=0.5 * (covariance + covariance.T),
        missed=0,
        since=measurement.time,
        rejected=None,
        reason="",
    )


def _reason(value: Immutable) -> str:
    return value.reason if isinstance(value, NotFound) else ""


class NeedleKalmanFilter(LeafSystem):
    """Filters the needle's control points, and decides whether the needle is being tracked.

    .. pydrake_system::

        name: NeedleKalmanFilter
        input_ports:
        - volume
        - detection
        - measurement
        output_ports:
        - estimate
        - prediction
        - last_detection
        - last_measurement

    The state is X = (p_1 ... p_n, their velocities) in W (Chatelain 2013, eq. 3, where it is in the
    probe's frame, which is a switch), predicted by eqs. 10 and 11 to the time at which the tip was
    acquired, and updated by eqs. 12 to 14.

    A detection starts a track, which stays unconfirmed until the localizer sees the needle. A
    volume without it, or whose innovation fails the gate, is coasted over, while the volume of
    interest grows; after some such volumes the needle is lost and sought in the whole volume; after
    some time, or when it was withdrawn, a new insertion is awaited.

    All outputs depend on the state only. ``prediction`` is the `NeedleTrack` from which the
    localizer predicts; ``last_detection`` and ``last_measurement`` are what the last update used,
    for a log. Updates come with new volumes: an event at which the volume is no newer than the last
    does nothing.

    Parameters
    ----------
    parameters
        Of the filter, in SI units.
    period, offset
        Of the event, in s.
    """

    def __init__(
        self,
        *,
        parameters: NeedleKalmanFilterParameters | None = None,
        period: float,
        offset: float = 0.0,
    ) -> None:
        super().__init__()
        require_positive(period=period)
        require_not_negative(offset=offset)
        self._parameters = parameters or NeedleKalmanFilterParameters()
        self._gate = float(chi2.ppf(self._parameters.gate, 3 * self._parameters.order))
        for name in ("volume", "detection", "measurement"):
            self.DeclareAbstractInputPort(name, Value[object]())
        empty = self._without_needle(0.0, "")
        none = NotFound("no volume has been seen")
        self._track = self.DeclareAbstractState(Value[object](empty))
        self._detection = self.DeclareAbstractState(Value[object](none))
        self._measurement = self.DeclareAbstractState(Value[object](none))
        self.DeclareAbstractOutputPort(
            "estimate",
            lambda: Value[object](),
            self._calc_estimate,
            prerequisites_of_calc={self.abstract_state_ticket(self._track)},
        )
        self.DeclareStateOutputPort("prediction", self._track)
        self.DeclareStateOutputPort("last_detection", self._detection)
        self.DeclareStateOutputPort("last_measurement", self._measurement)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self._update)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update)

    def _calc_estimate(self, context: Context, output: Value) -> None:
        track: NeedleTrack = context.get_abstract_state(self._track).get_value()
        output.set_value(track.estimate)

    def _update(self, context: Context, state: State) -> EventStatus:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        track: NeedleTrack = context.get_abstract_state(self._track).get_value()
        if not isinstance(volume, Volume) or volume.time <= track.volume_time:
            return EventStatus.DidNothing()
        track = track.seen_from(volume.X_WP)
        # Inputs are pulled only where they are wanted: a localizer that nobody asks costs nothing.
        detection: Immutable = NotFound("a needle is being tracked")
        measurement: Immutable = NotFound("no needle has been detected")
        if track.mode == TrackingMode.SEARCHING:
            detection = evaluate(self, context, "detection", (InsertionDetection, NotFound))
        if track or track.mode == TrackingMode.LOST:
            measurement = evaluate(self, context, "measurement", (NeedleMeasurement, NotFound))
        track = replace(
            self._next(context, track, volume.time, detection, measurement),
            volume_time=volume.time,
            X_WP=volume.X_WP if self._parameters.probe_frame else None,
        )
        for index, value in (
            (self._track, track),
            (self._detection, detection),
            (self._measurement, measurement),
        ):
            state.get_mutable_abstract_state(index).set_value(value)
        return EventStatus.Succeeded()

    def _without_needle(self, time: float, reason: str) -> NeedleTrack:
        """Return the track while there is no needle."""
        mode = TrackingMode.LOST if self._parameters.anywhere else TrackingMode.SEARCHING
        return NeedleTrack(mode, time, self._parameters.motion, reason=reason)

    def _start(self, measurement: NeedleMeasurement) -> NeedleTrack:
        """Start a track at a measurement."""
        return restart_track(measurement, self._parameters)

    def _confirm(
        self, context: Context, predicted: NeedleTrack, measurement: NeedleMeasurement
    ) -> NeedleTrack:
        """Update a track predicted to the measurement's time."""
        return update_track(predicted, measurement)

    def _coast(self, context: Context, predicted: NeedleTrack) -> NeedleTrack:
        """Update a predicted track with what there is where there is no measurement: nothing."""
        return predicted

    def _next(
        self,
        context: Context,
        track: NeedleTrack,
        time: float,
        detection: Immutable,
        measurement: Immutable,
    ) -> NeedleTrack:
        """Return the track after a volume."""
        if isinstance(measurement, NeedleMeasurement):
            fresh = track.mode in (TrackingMode.SEARCHING, TrackingMode.LOST)
            if fresh or not self._parameters.filtering:
                return self._start(measurement)
            predicted = track.predicted(measurement.time)
            distance = innovation_distance(predicted, measurement)
            if distance <= self._gate:
                return self._confirm(context, predicted, measurement)
            if track.rejected is not None:
                # Two that agree with each other are right, and the prediction is wrong.
                before = self._start(track.rejected)
                before = before.predicted(measurement.time)
                if innovation_distance(before, measurement) <= self._gate:
                    return self._start(measurement)
            track = replace(track, rejected=measurement)
            reason = f"the measurement lies {np.sqrt(distance):.1f} deviations from the prediction"
        else:
            reason = _reason(measurement)
        return self._missed(context, track, time, detection, reason)

    def _missed(
        self,
        context: Context,
        track: NeedleTrack,
        time: float,
        detection: Immutable,
        reason: str,
    ) -> NeedleTrack:
        """Return the track after a volume that did not confirm it."""
        p = self._parameters
        missed = track.missed + 1
        empty = self._without_needle(time, reason)
        if track.mode == TrackingMode.SEARCHING:
            if isinstance(detection, InsertionDetection):
                return start_track(track, detection, p)
            if track.detections is None or missed >= p.volumes_to_confirm:
                return replace(empty, reason=_reason(detection))
            return replace(track, missed=missed, reason=reason if track else _reason(detection))
        if time - track.since > p.seconds_to_give_up:
            return empty
        if track.mode == TrackingMode.LOST:
            return replace(track, missed=missed, reason=reason)
        predicted = self._coast(context, track.predicted(time))
        if (predicted.curve.tip - predicted.curve.entry) @ track.curve.direction < (
            p.withdrawn_length
        ):
            return replace(empty, reason="the needle was withdrawn")
        mode = TrackingMode.LOST if missed >= p.volumes_to_lose else TrackingMode.COASTING
        return replace(predicted, mode=mode, missed=missed, reason=reason)
