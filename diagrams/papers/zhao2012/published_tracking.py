"""Zhao 2012's method as published: its RANSAC, its filter and its search window, and no more."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.papers.zhao2012.tracking import Noise, localize_as_published
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.radio_frequency_sweep import RadioFrequencySweep
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.axis_tip_filter import AxisTipState
from sonoservo.systems.tracking.speckle_velocimeter import measure_velocity

Floats = NDArray[np.float64]

_STD = 0.5e-3
"""Standard deviation of tip and rear end in every direction, which gives R, in m; not published."""


def with_input(state: AxisTipState, change: float, dt: float) -> AxisTipState:
    """Return a predicted state with the control input of eq. 1: B maps u to (0, dt u, u)."""
    u = change * state.direction
    length = state.length + dt * change
    return replace(
        state, tip=state.tip + dt * u, tip_velocity=state.tip_velocity + u, length=length
    )


@dataclass(frozen=True, eq=False)
class PublishedResult:
    """Results of the published method after a volume: the curve and its velocity, if any."""

    curve: NeedleCurve | None
    velocity: Floats | None


class PublishedTracking:
    """The published method, called for each volume; ``towards`` as in `Tracking`.

    The search region lies around the known tip, as printed. A best match at its border does not
    count, any other does, and no velocity is gated. The first two volumes give RANSAC's result.
    """

    def __init__(self, towards: Floats, seed: int, noise: Noise | None = None) -> None:
        noise = noise or Noise()
        self._filter = noise.filter(velocity_gate=1 - 1e-12)
        self._velocimeter = noise.velocimeter(min_correlation=1e-6)
        self._towards = towards
        self._rng = np.random.default_rng([seed, 8])
        self._first: NeedleMeasurement | None = None
        self._state: AxisTipState | None = None
        self._sweep: RadioFrequencySweep | None = None

    def __call__(
        self, sweep: RadioFrequencySweep, volume: Volume, change: float | None = None
    ) -> PublishedResult:
        """Track the needle in the next sweep and its volume."""
        found = localize_as_published(volume, self._towards, 1, self._rng)
        measured = None
        if not isinstance(found, NotFound):
            measured = replace(found, covariance=_STD**2 * np.eye(6))
        previous, self._sweep = self._sweep, sweep
        if self._state is None:
            return self._initialize(measured)
        tip = self._state.tip
        speckle: VelocityMeasurement | NotFound = NotFound("there is no earlier sweep")
        if previous is not None:
            speckle = measure_velocity(
                sweep, previous, tip, tip, self._state.direction, self._velocimeter
            )
        dt = volume.time - self._state.time
        state = self._filter.predict(self._state, volume.time)
        if change is not None:
            state = with_input(state, change, dt)
        velocity = speckle if isinstance(speckle, VelocityMeasurement) else None
        self._state = self._filter.update(state, measured, velocity)
        return PublishedResult(self._state.curve, self._state.tip_velocity)

    def _initialize(self, measured: NeedleMeasurement | None) -> PublishedResult:
        """Return RANSAC's result; the second one starts the filter with the tips' difference."""
        if measured is None:
            return PublishedResult(None, None)
        first, self._first = self._first, measured
        if first is not None:
            velocity = (measured.curve.tip - first.curve.tip) / (measured.time - first.time)
            self._state = replace(self._filter.start(measured), tip_velocity=velocity)
        return PublishedResult(measured.curve, None)
