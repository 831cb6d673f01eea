"""Tracks a straight needle's direction, tip and velocity from volume to volume."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import Context
from scipy.stats import chi2

from sonoservo.systems.estimation.axis_tip_state import (
    AxisTipState,
    predict_axis_tip,
    start_axis_tip,
    update_axis_tip,
)
from sonoservo.systems.estimation.needle_kalman_filter import (
    NeedleKalmanFilter,
    NeedleKalmanFilterParameters,
)
from sonoservo.systems.estimation.track import NeedleTrack
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.requirements import require, require_not_negative
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement


@dataclass(kw_only=True)
class AxisTipFilterParameters(NeedleKalmanFilterParameters):
    """How the filter starts, what it believes and when it gives up.

    The life of a track is that of Chatelain 2013's filter; the paper says nothing about it, nor
    about the noise.

    Parameters
    ----------
    turning
        Spectral density of the direction's rate, in rad^2/s.
    velocity_gate
        Probability that a true velocity passes the gate on its innovation.
    """

    turning: float = 2e-4
    velocity_gate: float = 0.999

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.order == 2, "order", self.order, "2: the needle is straight")
        frame = self.probe_frame
        require(not frame, "probe_frame", frame, "false: this filter works in the world")
        require_not_negative(turning=self.turning)
        gate = self.velocity_gate
        require(0 < gate < 1, "velocity_gate", gate, "between 0 and 1")


@dataclass(frozen=True, eq=False)
class AxisTipTrack(NeedleTrack):
    """A track whose state is an `AxisTipState`, for whoever knows control points.

    Its ``mean`` and ``covariance`` follow from the eight states: the entry is where it was along
    the needle, and rests.

    Parameters
    ----------
    axis_tip
        The state.
    turning
        Spectral density of the direction's rate, in rad^2/s.
    """

    axis_tip: AxisTipState | None = field(default=None)
    turning: float = 0.0

    def predicted(self, time: float) -> "AxisTipTrack":
        """Return the track at a later time; an earlier one changes nothing."""
        dt = time - self.time
        if self.axis_tip is None or dt <= 0:
            return self
        state = predict_axis_tip(self.axis_tip, dt, self.motion, self.turning)
        return replace(self.at(state, self.curve.entry), time=time)

    def at(self, state: AxisTipState, entry: NDArray[np.float64]) -> "AxisTipTrack":
        """Return the track with another state, its entry as far along the needle as a position."""
        k = state.direction
        length = float((state.tip - entry) @ k)
        J = np.zeros((12, 8))
        J[:3, :2] = -length * state.frame[:2].T
        J[:3, 2:5] = J[3:6, 2:5] = J[9:, 5:] = np.eye(3)
        mean = np.concatenate([state.tip - length * k, state.tip, np.zeros(3), state.velocity])
        covariance = J @ state.covariance @ J.T
        return replace(self, axis_tip=state, mean=mean, covariance=covariance)


class AxisTipFilter(NeedleKalmanFilter):
    """Filters a straight needle's direction, tip and tip velocity (Zhao 2012, section 2.1).

    .. pydrake_system::

        name: AxisTipFilter
        input_ports:
        - volume
        - detection
        - measurement
        - velocity
        output_ports:
        - estimate
        - prediction
        - last_detection
        - last_measurement

    The state is X = (alpha, beta, p_t, v_t), see `AxisTipState`; ``velocity`` a
    `VelocityMeasurement`, or a `NotFound`. Either measurement may be missing. All else is as in
    `NeedleKalmanFilter`.

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
        parameters: AxisTipFilterParameters | None = None,
        period: float,
        offset: float = 0.0,
    ) -> None:
        self._axis_tip_parameters = parameters or AxisTipFilterParameters()
        super().__init__(parameters=self._axis_tip_parameters, period=period, offset=offset)
        self._velocity_gate = float(chi2.ppf(self._axis_tip_parameters.velocity_gate, 3))
        self.DeclareAbstractInputPort("velocity", Value[object]())

    def start_at(self, context: Context, measurement: NeedleMeasurement) -> None:
        """Track a needle that was found otherwise, as if the last volume had shown it."""
        track = replace(self._start(measurement), volume_time=measurement.time)
        context.SetAbstractState(int(self._track), track)

    def _start(self, measurement: NeedleMeasurement) -> NeedleTrack:
        p = self._axis_tip_parameters
        track = AxisTipTrack(
            TrackingMode.TRACKING,
            measurement.time,
            p.motion,
            since=measurement.time,
            turning=p.turning,
        )
        state = start_axis_tip(measurement, p.first_speed_std, p.first_drift_std)
        return track.at(state, measurement.curve.entry)

    def _confirm(
        self, context: Context, predicted: NeedleTrack, measurement: NeedleMeasurement
    ) -> NeedleTrack:
        assert isinstance(predicted, AxisTipTrack)
        track = self._updated(context, predicted, measurement)
        return replace(
            track,
            mode=TrackingMode.TRACKING,
            missed=0,
            since=measurement.time,
            rejected=None,
            reason="",
        )

    def _coast(self, context: Context, predicted: NeedleTrack) -> NeedleTrack:
        assert isinstance(predicted, AxisTipTrack)
        return self._updated(context, predicted, None)

    def _updated(
        self, context: Context, predicted: AxisTipTrack, measurement: NeedleMeasurement | None
    ) -> AxisTipTrack:
        state = predicted.axis_tip
        assert state is not None
        velocity = evaluate(self, context, "velocity", (VelocityMeasurement, NotFound))
        believed = velocity if isinstance(velocity, VelocityMeasurement) else None
        if believed is not None and not self._passes(state, believed):
            believed = None
        state = update_axis_tip(state, measurement, believed)
        return predicted.at(state, predicted.curve.entry)

    def _passes(self, state: AxisTipState, measured: VelocityMeasurement) -> bool:
        innovation = measured.velocity - state.velocity
        S = state.covariance[5:, 5:] + measured.covariance
        return float(innovation @ np.linalg.solve(S, innovation)) <= self._velocity_gate
