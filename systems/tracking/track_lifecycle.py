"""Life of a track: find, confirm, gate, coast, lose, find again, end.

A `NeedleFilter` models the needle's motion and its correction in between.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from scipy.special import expit

from sonoservo.systems.signals.confidence import squared_distance
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.line_hypotheses import LINE_CLASSES, LineHypotheses
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.search_reason import SearchReason
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.tracking.needle_filter import NeedleFilter, NeedleState, require_order
from sonoservo.systems.tracking.needle_line import lie_along
from sonoservo.systems.tracking.search_region import found_again
from sonoservo.systems.tracking.track import SUREST, Track
from sonoservo.systems.tracking.track_parameters import TrackParameters

_DETECTED, _CLUTTER = 0.6, 0.2
"""Probabilities that a volume confirms a needle which is there, and one which is not: a line that
once looked like a needle does so again."""

_REASONS = {
    "needle": SearchReason.UNCERTAIN(" yet"),
    "resting": SearchReason.THERE_BEFORE(" before"),
    "riding": SearchReason.RIDES(" with the probe"),
    "appeared": SearchReason.APPEARED(" at once"),
    "nothing": SearchReason.NO_LINE(" stands out as a needle does"),
}
"""Reason why there is no needle, by the class of the line that is most like one."""


@dataclass(frozen=True, kw_only=True)
class TrackLifecycle:
    """Rules by which a track begins, continues and ends, as pure functions."""

    order: int
    parameters: TrackParameters
    needle_filter: NeedleFilter[Any]
    anywhere: bool = False
    """Whether a line at rest is taken for a needle by its looks alone. If not, a needle must be
    seen to move."""

    def __post_init__(self) -> None:
        require_order(self.order, self.needle_filter)

    @property
    def probe_frame(self) -> bool:
        """Whether the needle's state moves along with the probe between volumes."""
        return self.parameters.probe_frame

    @property
    def gate(self) -> float:
        """Largest Mahalanobis distance at which a measurement is accepted."""
        return gate_distance(self.parameters.gate, self.order)

    def predict(
        self,
        track: Track,
        time: float,
        X_WP: RigidTransform,
        lines: LineHypotheses | NotFound,
    ) -> NeedlePrediction | NotFound:
        """Return where to localize the needle: around its prediction, or along a line found.

        See `Lifecycle.predict`.
        """
        track = track.seen_from(X_WP)
        if track.mode in (TrackingMode.TRACKING, TrackingMode.COASTING):
            assert track.state is not None
            return track.prediction(self.needle_filter.predict(track.state, time), track.entry)
        found = self.most_probable(track, lines)
        if isinstance(found, NotFound):
            return found
        ends, _ = found
        n = self.order
        curve = NeedleCurve(np.linspace(ends[0], ends[1], n))
        none = np.zeros((n, 3)), np.zeros((3 * n, 3 * n))
        return NeedlePrediction(n, time, curve, *none, found=True)

    def most_probable(
        self, track: Track, lines: LineHypotheses | NotFound
    ) -> tuple[NDArray[np.float64], float] | NotFound:
        """Return the (2, 3) ends in W of the line that is the needle, and the probability of that.

        A line is a needle if it moves like one. A lost one, or with `anywhere` any, may rest: then
        its looks in several volumes decide, and how well it agrees with the last track.
        """
        if isinstance(lines, NotFound):
            return lines
        if not lines:
            return NotFound(SearchReason.NO_BRIGHT_LINE(" is seen"))
        best = int(lines.probabilities.argmax())
        if lines.probabilities[best] >= self.parameters.act:
            return lines.ends[best], float(lines.probabilities[best])
        # There was a needle, or the user says that there is one: a line at rest is it if that is
        # more probable than not.
        last = None if track.state is None else track.state.curve
        choice = lines.ends[best], 0.5
        if last is not None or self.anywhere:
            for n in np.flatnonzero(lines.looked >= self.parameters.volumes_to_follow):
                odds, ends = float(lines.looks[n]), lines.ends[n]
                if last is not None:
                    odds, ends = found_again(odds, ends, last)
                if expit(odds) > choice[1]:
                    choice = ends, float(expit(odds))
        if choice[1] > 0.5:
            return choice
        kind = int(lines.classes[best].argmax())
        sure = lines.classes[best, kind] >= self.parameters.act
        return NotFound(_REASONS[LINE_CLASSES[kind] if sure else "needle"])

    def next(
        self,
        track: Track,
        time: float,
        *,
        detection: InsertionDetection | NotFound,
        measurement: NeedleMeasurement | NotFound,
        velocity: VelocityMeasurement | NotFound,
        lines: LineHypotheses | NotFound,
    ) -> Track:
        """Return the track after a volume; see `Lifecycle.next`."""
        speed = velocity if isinstance(velocity, VelocityMeasurement) else None
        if isinstance(measurement, NotFound):
            return self._miss(replace(track, innovation=None), time, speed, measurement.reason)
        if track.mode not in (TrackingMode.TRACKING, TrackingMode.COASTING):
            found = self.most_probable(track, lines)
            probability = SUREST if isinstance(found, NotFound) else min(found[1], SUREST)
            state = self.needle_filter.start(measurement)
            begun = replace(Track.without_needle(time), search=track)
            return self._confirmed(state, measurement, probability, begun)
        assert track.state is not None
        probability = _bayes(track.probability, _DETECTED / _CLUTTER)
        if track.search is not None:
            # That the same line is seen again is no evidence; only how it looks is.
            found = self.most_probable(track.search, lines)
            if isinstance(found, NotFound):
                return self._miss(track.search, time, None, found.reason)
            ends, probability = found[0], min(found[1], SUREST)
            seen = measurement.curve.control_points[[0, -1]]
            if not lie_along(ends[np.newaxis], seen[np.newaxis])[0, 0]:
                return self._miss(track.search, time, None, SearchReason.UNCERTAIN(" any more"))
        if not self.parameters.filtering:
            state = self.needle_filter.start(measurement)
            return self._confirmed(state, measurement, probability, track)
        if measurement.curve.direction @ track.state.curve.direction < 0:
            # Its tip has come out past its entry.
            return Track.without_needle(time, SearchReason.WITHDRAWN())
        state = self.needle_filter.predict(track.state, measurement.time)
        distance = innovation_distance(state, measurement)
        if distance <= self.gate:
            state = self.needle_filter.update(state, measurement, speed)
            return self._confirmed(state, measurement, probability, track, distance)
        if track.rejected is not None:
            # If two rejected measurements agree with each other, the prediction is wrong.
            before = self.needle_filter.start(track.rejected)
            before = self.needle_filter.predict(before, measurement.time)
            if innovation_distance(before, measurement) <= self.gate:
                state = self.needle_filter.start(measurement)
                moved = replace(track, entry=None, tissue=None)
                return self._confirmed(state, measurement, probability, moved, distance)
        missed = replace(track, rejected=measurement, innovation=distance)
        off = f" {distance:.1f} standard deviations from the prediction"
        return self._miss(missed, time, speed, SearchReason.OFF_PREDICTION(off))

    def _confirmed(
        self,
        state: NeedleState,
        measurement: NeedleMeasurement,
        probability: float,
        before: Track,
        innovation: float | None = None,
    ) -> Track:
        """Return a track that a measurement confirms, which continues one before.

        As long as its line may not be the needle, it can go back to its search.
        """
        return replace(
            Track.confirmed(state, measurement.time, innovation, probability),
            entry=state.curve.entry if before.entry is None else before.entry,
            tissue=measurement.tissue,
            search=before.search if probability < self.parameters.act else None,
        )

    def _miss(
        self, track: Track, time: float, velocity: VelocityMeasurement | None, reason: str
    ) -> Track:
        """Return the track after a volume that did not confirm it."""
        p = self.parameters
        last = track.state
        if last is None:
            return Track.without_needle(time, reason)
        missed = track.missed + 1
        track = replace(
            track,
            missed=missed,
            probability=_bayes(track.probability, (1 - _DETECTED) / (1 - _CLUTTER)),
        )
        if time - track.since > p.seconds_to_give_up:
            leaving = self._is_leaving(last)
            return Track.without_needle(time, SearchReason.WITHDRAWN() if leaving else reason)
        if track.mode == TrackingMode.LOST:
            return replace(track, reason=reason)
        state = self.needle_filter.predict(last, time)
        state = self.needle_filter.update(state, None, velocity)
        length = (state.curve.tip - state.curve.entry) @ last.curve.direction
        if length < p.withdrawn_length:
            return Track.without_needle(time, SearchReason.WITHDRAWN())
        # No robot goes after a needle that was last seen to come out.
        lost = self._is_leaving(state) or missed >= p.volumes_to_lose
        if lost and track.search is not None:
            return self._miss(track.search, time, None, reason)
        mode = TrackingMode.LOST if lost else TrackingMode.COASTING
        return replace(track, mode=mode, time=state.time, state=state, reason=reason)

    def _is_leaving(self, state: NeedleState) -> bool:
        """Return True if a needle came out of the tissue fast when it was last seen."""
        v = (state.velocity[-1] - state.velocity[0]) @ state.curve.direction
        return bool(v < -self.parameters.withdrawal_speed)


def _bayes(probability: float, ratio: float) -> float:
    """Return a probability after evidence with a likelihood ratio."""
    odds = ratio * probability / max(1 - probability, 1e-12)
    return min(odds / (1 + odds), SUREST) if math.isfinite(odds) else SUREST


def innovation_distance(state: NeedleState, measurement: NeedleMeasurement) -> float:
    """Return the Mahalanobis distance of a measurement from a state predicted to its time.

    Of the places where the tip may be, the nearest counts.
    """
    points = state.curve.control_points.ravel()
    P = state.covariance[: len(points), : len(points)]
    away = [(z - points, P + R) for _, z, R in measurement.places]
    return float(np.sqrt(min(y @ np.linalg.solve(S, y) for y, S in away)))


@lru_cache
def gate_distance(gate: float, order: int) -> float:
    """Return the Mahalanobis distance that a true measurement exceeds with probability 1 - gate."""
    return float(np.sqrt(squared_distance(gate, 3 * order)))
