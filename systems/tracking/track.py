"""Track of a needle at one time."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.tissue_record import TissueRecord
from sonoservo.systems.tracking.needle_filter import NeedleState

SUREST = 0.999
"""Largest probability of a needle: something that is not modelled may look like one."""


@dataclass(frozen=True, eq=False)
class Track(Immutable):
    """Track of a needle that is being followed or awaited; falsy without a state."""

    mode: TrackingMode
    """Stage of the track's life. In the searching stage, a state is an unconfirmed candidate."""
    time: float
    """Time of the state in s, or of the last change if there is no state."""
    state: NeedleState | None = None
    volume_time: float = -np.inf
    """Time of the newest volume seen, in s."""
    X_WP: RigidTransform | None = None
    """Pose of the probe with which the needle is assumed to move; None if its state is kept in W.
    """
    missed: int = 0
    """Number of successive volumes that did not confirm the needle."""
    since: float = -np.inf
    """Time of the last confirmation, in s."""
    rejected: NeedleMeasurement | None = None
    """Last measurement that failed the gate since the last confirmation."""
    entry: NDArray[np.float64] | None = None
    """(3,) entry when the needle was found, in the state's frame, in m; None if none is followed. A
    filter's own entry would slide along the needle if it were measured by itself."""
    tissue: TissueRecord | None = None
    """Tissue along the needle from before it came, told by distances from that entry."""
    innovation: float | None = None
    """Mahalanobis distance of the last measurement from its prediction; None if none was gated."""
    probability: float = 0.0
    reason: str = ""
    """Reason why the last volume did not confirm the needle."""
    search: "Track | None" = None
    """Track of the search that goes on if a line at rest turns out to be no needle; None once it is
    one for sure."""

    def __bool__(self) -> bool:
        return self.state is not None

    @classmethod
    def without_needle(cls, time: float, reason: str = "") -> Self:
        """Return the track at a time in s while there is no needle."""
        return cls(TrackingMode.SEARCHING, time, reason=reason)

    @classmethod
    def confirmed(
        cls,
        state: NeedleState,
        time: float,
        innovation: float | None = None,
        probability: float = SUREST,
    ) -> Self:
        """Return a track that is confirmed by a measurement at a time in s."""
        return cls(
            TrackingMode.TRACKING,
            state.time,
            state,
            since=time,
            innovation=innovation,
            probability=probability,
        )

    def prediction(self, state: NeedleState, entry: NDArray[np.float64] | None) -> NeedlePrediction:
        """Return the prediction for a volume, given a predicted state and a known (3,) entry."""
        points = 3 * state.curve.order
        return NeedlePrediction(
            state.curve.order,
            state.time,
            state.curve,
            state.velocity,
            state.covariance[:points, :points],
            entry=entry,
            tissue=self.tissue,
            missed=self.missed,
        )

    def seen_from(self, X_WP: RigidTransform) -> "Track":
        """Return the track with the probe at ``X_WP``; a state in the probe's frame moves along."""
        if self.X_WP is None:
            return self
        X = X_WP.multiply(self.X_WP.inverse())
        state = self.state and self.state.transformed(X)
        entry = None if self.entry is None else X.multiply(self.entry)
        search = self.search and self.search.seen_from(X_WP)
        return replace(self, X_WP=X_WP, entry=entry, state=state, search=search)

    @property
    def estimate(self) -> NeedleEstimate:
        """Estimate of the needle; it contains no curve while the track is unconfirmed."""
        nothing = NeedleEstimate(
            self.mode, self.time, volume_time=self.volume_time, reason=self.reason, X_WP=self.X_WP
        )
        state = self.state
        if state is None or self.mode == TrackingMode.SEARCHING:
            return nothing
        return replace(
            nothing,
            curve=state.curve,
            velocity=state.velocity,
            covariance=state.covariance,
            probability=self.probability,
        )
