"""Interface of a track's life: the rules by which a track begins, continues and ends."""

from typing import Any, Protocol

from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.line_hypotheses import LineHypotheses
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.tracking.needle_filter import NeedleFilter
from sonoservo.systems.tracking.track import Track


class Lifecycle(Protocol):
    """Rules of a track's life as pure functions, which a `TrackManager` applies."""

    @property
    def needle_filter(self) -> NeedleFilter[Any]:
        """Filter that starts, predicts and updates the track's state."""

    @property
    def gate(self) -> float | None:
        """Largest Mahalanobis distance of an accepted measurement; None accepts all."""

    @property
    def probe_frame(self) -> bool:
        """Whether the needle's state moves along with the probe between volumes."""

    def predict(
        self,
        track: Track,
        time: float,
        X_WP: RigidTransform,
        lines: LineHypotheses | NotFound,
    ) -> NeedlePrediction | NotFound:
        """Return where to localize the needle in a volume, from the track after the last one."""

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
        """Return the track after a volume, from the one before, seen from the probe's new pose."""
