"""Life of a track: initiate, confirm, gate, coast, lose, find again, end.

A `NeedleFilter` models the needle's motion and its correction in between.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.math import RigidTransform

from sonoservo.systems.estimation.innovation_gate import gate_distance, innovation_distance
from sonoservo.systems.estimation.needle_filter import NeedleFilter, NeedleState, require_order
from sonoservo.systems.estimation.needle_motion import has_turned, was_pushed
from sonoservo.systems.estimation.track import Track
from sonoservo.systems.estimation.track_parameters import TrackParameters
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement

_WITHDRAWN = "the needle was withdrawn"
"""Reason why the track of a needle that came out ends."""


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
        Whether the whole volume is searched while there is no needle, and one that rests is taken.
        If not, a needle must be seen to come until what is followed surely is one, and again after
        it was withdrawn.
    """

    order: int
    parameters: TrackParameters
    needle_filter: NeedleFilter[Any]
    anywhere: bool = False

    def __post_init__(self) -> None:
        require_order(self.order, self.needle_filter)

    @property
    def probe_frame(self) -> bool:
        """Whether the needle's state moves along with the probe between volumes."""
        return self.parameters.probe_frame

    @property
    def max_approach(self) -> float:
        """Largest motion of the probe along its axis at which a needle may be found, in m."""
        return self.parameters.max_approach

    @property
    def remembers(self) -> bool:
        """Whether tracks keep earlier volumes, which a new needle must not be in."""
        return not self.anywhere

    def without_needle(self, time: float, reason: str = "", searched: float = -np.inf) -> Track:
        """Return the track at a time in s while there is no needle.

        ``searched`` is the time in s at which the whole volume was last searched for one.
        """
        mode = TrackingMode.LOST if self.anywhere else TrackingMode.SEARCHING
        return Track(mode, time, searched=searched, reason=reason)

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
        track = track.seen_from(X_WP)
        everywhere = self._is_searched_everywhere(track, time)
        must_come = not (self.anywhere or track.grown)
        last = track.candidate or track.state
        if last is None:
            if everywhere:
                return NeedlePrediction(
                    self.order, time, everywhere=True, earlier=track.earlier, must_come=must_come
                )
            return NotFound("no needle has been detected")
        state = last if everywhere else self.needle_filter.predict(last, time)
        points = 3 * self.order
        known = track.mode != TrackingMode.SEARCHING or track.candidate is not None
        resting = track.candidate is None and track.entry is not None
        return NeedlePrediction(
            self.order,
            state.time,
            state.curve,
            state.velocity,
            state.covariance[:points, :points],
            entry=(track.entry if resting else last.curve.entry) if known else None,
            missed=0 if track.candidate else track.missed,
            tip_unseen=max(time - track.tip_seen, 0.0),
            everywhere=everywhere,
            earlier=track.earlier,
            must_come=must_come,
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
        """Return the track after a volume; see `Lifecycle.next`."""
        after = self._aged(track, self._next(track, time, detection, measurement, velocity))
        if after.state is None or after.mode == TrackingMode.SEARCHING:
            return replace(after, entry=None)
        found = track.mode in (TrackingMode.SEARCHING, TrackingMode.LOST)
        anew = found or (after.innovation or 0.0) > self.gate
        if track.entry is None or (anew and after.mode == TrackingMode.TRACKING):
            return replace(after, entry=after.state.curve.entry)
        return replace(after, entry=track.entry)

    def _aged(self, before: Track, track: Track) -> Track:
        """Return a track with the length that it reached, or its end if it is too short for long.

        What is found somewhere may be a structure that looks like the end of a needle, or a ghost.
        A needle grows.
        """
        if track.state is None and track.reason == _WITHDRAWN:
            # The next needle must come, and what showed this one tells nothing about it.
            return track
        track = replace(track, grown=before.grown, earlier=before.earlier)
        if track.state is None or track.mode == TrackingMode.SEARCHING:
            return track
        began, longest = min(before.began, track.time), before.longest
        first, grown = before.first, before.grown
        if track.mode == TrackingMode.TRACKING:
            longest = max(longest, track.state.curve.chord)
            found = before.mode == TrackingMode.LOST
            if first is None or found or has_turned(first.curve, track.state.curve):
                first = track.state
            grown = grown or self._is_sure(first, track.state)
        long_enough = longest >= self.parameters.grown_length
        if not long_enough and track.time - began > self.parameters.seconds_to_grow:
            ended = self.without_needle(track.time, "what was found did not grow", track.searched)
            return replace(ended, grown=before.grown, earlier=before.earlier)
        return replace(
            track,
            began=began,
            longest=longest,
            first=first,
            grown=grown,
            tip_seen=max(before.tip_seen, track.tip_seen),
        )

    def _is_sure(self, first: NeedleState, now: NeedleState) -> bool:
        """Return True if what is followed surely is a needle; see ``sure_length``."""
        p = self.parameters
        grew = now.curve.chord - first.curve.chord >= p.grown_length
        stayed = now.time - first.time >= p.seconds_to_be_sure
        return now.curve.chord >= p.sure_length and (grew or stayed)

    def _next(
        self,
        track: Track,
        time: float,
        detection: InsertionDetection | NotFound,
        measurement: NeedleMeasurement | NotFound,
        velocity: VelocityMeasurement | NotFound,
    ) -> Track:
        """Return the track after a volume, without the place of its entry."""
        everywhere = self._is_searched_everywhere(track, time)
        track = replace(track, searched=time if everywhere else track.searched)
        speed = velocity if isinstance(velocity, VelocityMeasurement) else None
        if isinstance(measurement, NotFound):
            missed = replace(track, innovation=None, candidate=None, seen=0)
            return self._miss(missed, time, detection, speed, measurement.reason)
        if everywhere or track.candidate is not None:
            return self._found(track, time, measurement)
        if track.mode == TrackingMode.SEARCHING or not self.parameters.filtering:
            return self._confirmed(self.needle_filter.start(measurement), measurement)
        assert track.state is not None
        if measurement.curve.direction @ track.state.curve.direction < 0:
            # Its tip has come out past its entry.
            return self.without_needle(time, _WITHDRAWN, track.searched)
        state = self.needle_filter.predict(track.state, measurement.time)
        distance = innovation_distance(state, measurement)
        if distance <= self.gate:
            state = self.needle_filter.update(state, measurement, speed)
            return self._confirmed(state, measurement, distance)
        jumps = measurement.curve.control_points - state.curve.control_points
        if np.linalg.norm(jumps, axis=1).max() <= self.parameters.max_jump:
            state = self.needle_filter.start(measurement)
            return self._confirmed(state, measurement, distance)
        if track.rejected is not None:
            # If two rejected measurements agree with each other, the prediction is wrong.
            before = self.needle_filter.start(track.rejected)
            before = self.needle_filter.predict(before, measurement.time)
            if innovation_distance(before, measurement) <= self.gate:
                state = self.needle_filter.start(measurement)
                return self._confirmed(state, measurement, distance)
        missed = replace(track, rejected=measurement, innovation=distance)
        reason = f"the measurement is {distance:.1f} standard deviations from the prediction"
        return self._miss(missed, time, detection, speed, reason)

    def _confirmed(
        self, state: NeedleState, measurement: NeedleMeasurement, innovation: float | None = None
    ) -> Track:
        """Return a track that is confirmed by a measurement, whose tip may not have been seen."""
        track = self.confirm(state, measurement.time, innovation)
        return replace(track, tip_seen=measurement.time) if measurement.tip_seen else track

    def _is_searched_everywhere(self, track: Track, time: float) -> bool:
        """Return True if a needle may be anywhere: it is lost, or none is seen to move for long."""
        if track.candidate is not None:
            return False
        period = self.parameters.seconds_between_searches
        waited = period > 0 and time - track.searched >= period
        awaited = track.mode == TrackingMode.SEARCHING and track.state is None
        return track.mode == TrackingMode.LOST or (awaited and waited)

    def _found(self, track: Track, time: float, measurement: NeedleMeasurement) -> Track:
        """Return the track after a volume that shows a needle which is not followed yet."""
        state, seen = self.needle_filter.start(measurement), 1
        if track.candidate is not None:
            expected = self.needle_filter.predict(track.candidate, measurement.time)
            agrees = innovation_distance(expected, measurement) <= self.gate
            if agrees:
                state = self.needle_filter.update(expected, measurement, None)
            seconds = measurement.time - track.candidate.time
            if agrees or was_pushed(
                track.candidate.curve, measurement.curve, seconds, self.parameters.max_jump
            ):
                seen = track.seen + 1
        if seen >= self.parameters.volumes_to_follow:
            return self._confirmed(state, measurement)
        reason = "a needle was found; it is not confirmed yet"
        track = self._miss(track, time, NotFound(reason), None, reason)
        return replace(track, candidate=state, seen=seen)

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
            reason = _WITHDRAWN if self._is_leaving(track.state) else reason
            return self.without_needle(time, reason, track.searched)
        if track.mode == TrackingMode.LOST:
            return replace(track, reason=reason)
        assert track.state is not None
        state = self.needle_filter.predict(track.state, time)
        state = self.needle_filter.update(state, None, velocity)
        length = (state.curve.tip - state.curve.entry) @ track.state.curve.direction
        if length < p.withdrawn_length:
            return self.without_needle(time, _WITHDRAWN, track.searched)
        # No robot goes after a needle that was last seen to come out.
        lost = self._is_leaving(state) or track.missed >= p.volumes_to_lose
        mode = TrackingMode.LOST if lost else TrackingMode.COASTING
        return replace(track, mode=mode, time=state.time, state=state, reason=reason)

    def _is_leaving(self, state: NeedleState | None) -> bool:
        """Return True if a needle came out of the tissue fast when it was last seen."""
        v = (
            0.0
            if state is None
            else (state.velocity[-1] - state.velocity[0]) @ state.curve.direction
        )
        return bool(v < -self.parameters.withdrawal_speed)

    def _await(
        self, track: Track, time: float, detection: InsertionDetection | NotFound, reason: str
    ) -> Track:
        """Return the track after a volume in which no needle was localized yet."""
        expired = track.missed >= self.parameters.volumes_to_confirm
        if isinstance(detection, InsertionDetection):
            # What is never confirmed may not keep the whole volume from being searched.
            begun = self.without_needle(time, searched=track.searched) if expired else track
            return replace(self.initiate(begun, detection), missed=begun.missed if begun else 0)
        if track.detections is None or expired:
            return self.without_needle(time, detection.reason, track.searched)
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
            searched=track.searched,
            reason="something moved; the needle is not confirmed yet",
        )
        advance = detection.p_WTip - first.p_WTip
        if np.linalg.norm(advance) < p.min_advance:
            return started
        points = first.p_WTip + np.outer(np.linspace(0, 1, self.order), advance)
        covariance = p.first_std**2 * np.eye(points.size)
        guess = NeedleMeasurement(NeedleCurve(points), covariance, detection.time, 0, 0.0)
        return replace(started, state=self.needle_filter.start(guess), reason="")
