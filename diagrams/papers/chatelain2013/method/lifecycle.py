"""Life of a track as published, with nothing added to it."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.line_hypotheses import LineHypotheses
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.requirements import PositiveInt, check_bounds
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.tracking.needle_filter import NeedleFilter, require_order
from sonoservo.systems.tracking.track import Track

_NO_LINES = NotFound("no lines are followed")


@dataclass(frozen=True, kw_only=True)
class PublishedLifecycle:
    """Life of a track as Chatelain 2013, section II describes it.

    One admissible entry point starts the search for the needle around it; a later one replaces it.
    Once the needle is visible with a certain length it is tracked: every measurement corrects the
    filter, without a gate on its innovation. A lost needle is not searched for.
    """

    gate: ClassVar[None] = None
    probe_frame: ClassVar[bool] = True

    order: int
    needle_filter: NeedleFilter[Any]
    volumes_to_end: PositiveInt = 10
    """Number of successive volumes that do not show the needle with `least_length` after which the
    track ends. The paper does not say when. They are many, as the needle may be dim for a moment,
    or leave the region when the phantom is moved."""

    def __post_init__(self) -> None:
        require_order(self.order, self.needle_filter)
        check_bounds(self)

    def predict(
        self,
        track: Track,
        time: float,
        X_WP: RigidTransform,
        lines: LineHypotheses | NotFound = _NO_LINES,
    ) -> NeedlePrediction | NotFound:
        """Return the prediction for a volume (eqs. 10, 11), or the entry around which to look."""
        state = track.seen_from(X_WP).state
        if state is None:
            return NotFound("no needle has been detected")
        searching = track.mode == TrackingMode.SEARCHING
        state = state if searching else self.needle_filter.predict(state, time)
        return track.prediction(state, None if searching else state.curve.entry)

    def next(
        self,
        track: Track,
        time: float,
        *,
        detection: InsertionDetection | NotFound,
        measurement: NeedleMeasurement | NotFound,
        velocity: VelocityMeasurement | NotFound,
        lines: LineHypotheses | NotFound = _NO_LINES,
    ) -> Track:
        """Return the track after a volume; see `Lifecycle.next`."""
        if track.mode == TrackingMode.SEARCHING:
            return self._start(track, time, detection, measurement)
        speed = velocity if isinstance(velocity, VelocityMeasurement) else None
        measured, reason = None, ""
        if isinstance(measurement, NotFound):
            reason = measurement.reason
        else:
            measured, time = measurement, measurement.time
        state = self.needle_filter.predict(track.state, time)
        state = self.needle_filter.update(state, measured, speed)
        if measured is not None:
            return Track.confirmed(state, time)
        missed = track.missed + 1
        if missed >= self.volumes_to_end:
            return Track.without_needle(time, reason)
        mode = TrackingMode.COASTING
        return replace(track, mode=mode, time=time, state=state, missed=missed, reason=reason)

    def _start(
        self,
        track: Track,
        time: float,
        detection: InsertionDetection | NotFound,
        measurement: NeedleMeasurement | NotFound,
    ) -> Track:
        """Return the track after a volume in which no needle was tracked yet."""
        if isinstance(measurement, NeedleMeasurement):
            return Track.confirmed(self.needle_filter.start(measurement), measurement.time)
        if isinstance(detection, NotFound):
            reason = measurement.reason if track else detection.reason
            return replace(track, time=time, reason=reason)
        # From the entry point to the median; they coincide if the median lies on the face itself.
        inward = detection.p_WMedian - detection.p_WEntry
        inward = inward if np.linalg.norm(inward) > 1e-6 else np.array([0.0, 0.0, -1e-3])
        points = detection.p_WEntry + np.outer(np.linspace(0, 1, self.order), inward)
        guess = NeedleMeasurement(
            NeedleCurve(points), 1e-6 * np.eye(3 * self.order), detection.time, 0, 0.0
        )
        return Track(
            TrackingMode.SEARCHING,
            time,
            self.needle_filter.start(guess),
            reason="an entry was detected; the needle is not long enough yet",
        )
