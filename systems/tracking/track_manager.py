"""Leaf system that tracks the needle from volume to volume."""

from dataclasses import replace
from typing import Any

from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.line_hypotheses import LineHypotheses
from sonoservo.systems.signals.localization_explanation import LocalizationExplanation
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.ports import (
    declare_inputs,
    declare_output,
    declare_state_output,
    evaluate,
)
from sonoservo.systems.signals.requirements import require_not_negative, require_positive
from sonoservo.systems.signals.search_reason import SearchReason
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.lifecycle import Lifecycle
from sonoservo.systems.tracking.track import Track


class TrackManager(LeafSystem):
    """Tracks the needle from volume to volume, and estimates it with a filter.

    .. pydrake_system::

        name: TrackManager
        input_ports:
        - volume
        - detection (optional)
        - lines (optional)
        - measurement
        - velocity (optional)
        - explanation (optional)
        output_ports:
        - estimate
        - prediction
        - last_detection
        - last_measurement
        - explanation

    A line that is probably a needle starts a track, once the needle is localized along it. If a
    volume does not show the needle, or its measurement fails the gate, the track coasts and the
    region of interest grows. After several such volumes the needle is lost, and any line may be
    it. After some time, or once the needle is withdrawn, a new one is awaited; see
    `TrackLifecycle`.

    ``prediction`` is the `NeedlePrediction` for the volume at the input, or a `NotFound`. It
    depends on the state, on the lines, and on that volume's time and pose, never on a measurement
    in it. It is the same before and after the update with that volume. The output ``explanation``
    is the localizer's explanation with the innovation added. All other outputs depend on the state
    only.
    ``last_detection`` and ``last_measurement`` are those of the last update, for a log. An event
    does nothing unless its volume is newer than the last one.

    Parameters
    ----------
    lifecycle
        Rules of a track's life, with the filter that models the needle's motion and its correction.
    period, offset
        Period and offset of the event, in s.
    """

    def __init__(
        self,
        *,
        lifecycle: Lifecycle,
        period: float,
        offset: float = 0.0,
    ) -> None:
        super().__init__()
        require_positive(period=period)
        require_not_negative(offset=offset)
        self._lifecycle = lifecycle
        declare_inputs(
            self,
            volume=(Volume, NotFound),
            detection=(InsertionDetection, NotFound),
            lines=(LineHypotheses, NotFound),
            measurement=(NeedleMeasurement, NotFound),
            velocity=(VelocityMeasurement, NotFound),
            explanation=(LocalizationExplanation, NotFound),
        )
        none = NotFound("no volume has been seen")
        self._track = self.DeclareAbstractState(Value[object](Track.without_needle(0.0)))
        self._prediction = self.DeclareAbstractState(Value[object](none))
        self._detection = self.DeclareAbstractState(Value[object](none))
        self._measurement = self.DeclareAbstractState(Value[object](none))
        track = self.abstract_state_ticket(self._track)
        served = self.abstract_state_ticket(self._prediction)
        volume, lines, explanation = (
            self.input_port_ticket(self.GetInputPort(name).get_index())
            for name in ("volume", "lines", "explanation")
        )
        for port, kind, calculate, prerequisites in (
            ("estimate", NeedleEstimate, self._calc_estimate, {track}),
            (
                "prediction",
                (NeedlePrediction, NotFound),
                self._calc_prediction,
                {track, served, volume, lines},
            ),
            (
                "explanation",
                (LocalizationExplanation, NotFound),
                self._calc_explanation,
                {track, explanation},
            ),
        ):
            declare_output(self, port, kind, calculate, prerequisites)
        declare_state_output(
            self, "last_detection", (InsertionDetection, NotFound), self._detection
        )
        declare_state_output(
            self, "last_measurement", (NeedleMeasurement, NotFound), self._measurement
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self._update)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update)

    def start_at(self, context: Context, measurement: NeedleMeasurement) -> None:
        """Start to track a needle found by other means, as if the last volume had shown it."""
        state = self._lifecycle.needle_filter.start(measurement)
        track = Track.confirmed(state, measurement.time)
        track = replace(track, volume_time=measurement.time)
        track = replace(track, entry=state.curve.entry)
        context.SetAbstractState(int(self._track), track)

    def _calc_estimate(self, context: Context, output: Value) -> None:
        output.set_value(self._track_in(context).estimate)

    def _calc_prediction(self, context: Context, output: Value) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        track = self._track_in(context)
        if not isinstance(volume, Volume):
            output.set_value(volume)
        elif volume.time <= track.volume_time:
            output.set_value(context.get_abstract_state(self._prediction).get_value())
        else:
            lines = self._optional(context, "lines", LineHypotheses)
            output.set_value(self._lifecycle.predict(track, volume.time, volume.X_WP, lines))

    def _calc_explanation(self, context: Context, output: Value) -> None:
        port = self.GetInputPort("explanation")
        if not port.HasValue(context):
            output.set_value(NotFound("no explanation of a localizer is connected"))
            return
        explanation = evaluate(self, context, "explanation", (LocalizationExplanation, NotFound))
        track = self._track_in(context)
        if isinstance(explanation, LocalizationExplanation):
            served = explanation.volume_time == track.volume_time
            explanation = replace(
                explanation,
                innovation=track.innovation if served else None,
                gate=self._lifecycle.gate,
            )
        output.set_value(explanation)

    def _update(self, context: Context, state: State) -> EventStatus:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        track = self._track_in(context)
        if not isinstance(volume, Volume) or volume.time <= track.volume_time:
            return EventStatus.DidNothing()
        prediction: Any = self.GetOutputPort("prediction").Eval(context)
        # Inputs are evaluated only if needed, so an unused localizer costs nothing.
        detection: InsertionDetection | NotFound = NotFound(SearchReason.TRACKED())
        measurement: NeedleMeasurement | NotFound = NotFound(SearchReason.NOT_DETECTED(" detected"))
        velocity: VelocityMeasurement | NotFound = NotFound("the velocity is not measured")
        if track.mode == TrackingMode.SEARCHING:
            detection = self._optional(context, "detection", InsertionDetection)
        if isinstance(prediction, NeedlePrediction):
            measurement = evaluate(self, context, "measurement", (NeedleMeasurement, NotFound))
        elif self.GetInputPort("lines").HasValue(context):
            detection = measurement = prediction
        if track.mode in (TrackingMode.TRACKING, TrackingMode.COASTING):
            velocity = self._optional(context, "velocity", VelocityMeasurement)
        track = self._lifecycle.next(
            track.seen_from(volume.X_WP),
            volume.time,
            detection=detection,
            measurement=measurement,
            velocity=velocity,
            lines=self._optional(context, "lines", LineHypotheses),
        )
        track = replace(
            track,
            volume_time=volume.time,
            X_WP=volume.X_WP if self._lifecycle.probe_frame else None,
        )
        for index, value in (
            (self._track, track),
            (self._prediction, prediction),
            (self._detection, detection),
            (self._measurement, measurement),
        ):
            state.get_mutable_abstract_state(index).set_value(value)
        return EventStatus.Succeeded()

    def _optional(self, context: Context, name: str, kind: type[Any]) -> Any:
        """Return the value of an input port, or a `NotFound` if it is not connected."""
        if not self.GetInputPort(name).HasValue(context):
            return NotFound(f"no {name} is connected")
        return evaluate(self, context, name, (kind, NotFound))

    def _track_in(self, context: Context) -> Track:
        return context.get_abstract_state(self._track).get_value()
