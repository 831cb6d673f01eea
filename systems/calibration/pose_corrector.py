"""Leaf systems that take the errors out of the poses of volumes and of a probe."""

from dataclasses import dataclass, field

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from sonoservo.systems.calibration.pose_errors import PoseCalibration, PoseErrors
from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate
from sonoservo.systems.signals.requirements import require_not_negative, require_positive
from sonoservo.systems.signals.volume import Volume


@dataclass(frozen=True, eq=False)
class _History(Immutable):
    """Calibration by the volumes so far, the newest one, and the same with corrected poses."""

    calibration: PoseCalibration = field(default_factory=PoseCalibration)
    newest: Volume | None = None
    corrected: Volume | None = None


class PoseCorrector(LeafSystem):
    """Estimates the delay of the poses and the hand-eye error, and takes both out of the volumes.

    .. pydrake_system::

        name: PoseCorrector
        input_ports:
        - volume
        output_ports:
        - volume
        - pose_errors

    The output ``volume`` is the `Volume` at the input with its poses corrected by the errors known
    before it, or the `NotFound` there; until errors are known, it is the input. It is the same
    before and after the event that compares the volume. ``pose_errors`` is a `PoseErrors`, or a
    `NotFound` with the reason why they are unknown. The tissue must stand still while the probe
    moves. Errors that the motion does not show stay near zero.

    Parameters
    ----------
    period, offset
        Period and offset of the event that compares a volume with earlier ones, in s.
    """

    def __init__(self, *, period: float, offset: float = 0.0) -> None:
        super().__init__()
        require_not_negative(offset=offset)
        require_positive(period=period)
        declare_inputs(self, volume=(Volume, NotFound))
        self._history = self.DeclareAbstractState(Value[object](_History()))
        declare_output(self, "volume", (Volume, NotFound), self._calc_volume)
        declare_output(
            self,
            "pose_errors",
            (PoseErrors, NotFound),
            self._calc_errors,
            {self.abstract_state_ticket(self._history)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self._update)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update)

    def _history_in(self, context: Context) -> _History:
        history: _History = context.get_abstract_state(self._history).get_value()
        return history

    def _calc_volume(self, context: Context, output: Value) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        history = self._history_in(context)
        errors = history.calibration.errors
        if history.corrected is not None and volume is history.newest:
            volume = history.corrected
        elif isinstance(volume, Volume) and isinstance(errors, PoseErrors):
            volume = errors.corrected(volume)
        output.set_value(volume)

    def _calc_errors(self, context: Context, output: Value) -> None:
        output.set_value(self._history_in(context).calibration.errors)

    def _update(self, context: Context, state: State) -> EventStatus:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        history = self._history_in(context)
        if not isinstance(volume, Volume) or volume is history.newest:
            return EventStatus.DidNothing()
        corrected: Volume = self.GetOutputPort("volume").Eval(context)
        history = _History(history.calibration.seen(volume), volume, corrected)
        state.get_mutable_abstract_state(self._history).set_value(history)
        return EventStatus.Succeeded()


class HandEyeCorrector(LeafSystem):
    """Outputs the pose of the image where a robot has that of its probe.

    .. pydrake_system::

        name: HandEyeCorrector
        input_ports:
        - X_WP
        - pose_errors
        output_ports:
        - corrected_X_WP

    ``pose_errors`` is the `PoseErrors` of a `PoseCorrector`, or a `NotFound`, with which the pose
    stays as it is. Use it to see in P what was estimated from corrected volumes. The delay is not
    corrected.
    """

    def __init__(self) -> None:
        super().__init__()
        declare_inputs(self, X_WP=RigidTransform, pose_errors=(PoseErrors, NotFound))
        declare_output(self, "corrected_X_WP", RigidTransform, self._calc_pose)

    def _calc_pose(self, context: Context, output: Value) -> None:
        X_WP: RigidTransform = self.GetInputPort("X_WP").Eval(context)
        errors = evaluate(self, context, "pose_errors", (PoseErrors, NotFound))
        output.set_value(X_WP.multiply(errors.X_PI) if isinstance(errors, PoseErrors) else X_WP)
