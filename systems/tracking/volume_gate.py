"""Leaf system that keeps implausible volumes from a tracker."""

from dataclasses import dataclass, field, replace

from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate
from sonoservo.systems.signals.requirements import require_not_negative, require_positive
from sonoservo.systems.signals.volume import Volume, VolumeCheck
from sonoservo.systems.tracking.volume_plausibility import (
    VolumePlausibilityParameters,
    implausible,
)


@dataclass(frozen=True, eq=False)
class _History(Immutable):
    """Newest volume judged and the result, the last ones accepted and refused, and the counts.

    The lead is the time in s by which the last one accepted was ahead of the clock.
    """

    judged: Volume | None = None
    result: Volume | NotFound | None = None
    last: Volume | None = None
    refused: Volume | None = None
    lead: float = 0.0
    check: VolumeCheck = field(default_factory=VolumeCheck)


class VolumeGate(LeafSystem):
    """Passes plausible volumes on, and refuses the others with a reason.

    .. pydrake_system::

        name: VolumeGate
        input_ports:
        - volume
        output_ports:
        - volume
        - volume_check

    The output `volume` is the `Volume` at the input, bit for bit, or a `NotFound` with the reason
    why there is none or why it is refused (see `implausible`). It is the same before and after the
    event that counts the volume. `volume_check` is a `VolumeCheck`. A refused volume never counts
    as seen, so tracking goes on with the next good one.

    Parameters
    ----------
    parameters
        Limits within which a volume is plausible.
    period, offset
        Period and offset of the event that counts a volume, in s.
    """

    def __init__(
        self,
        *,
        parameters: VolumePlausibilityParameters | None = None,
        period: float,
        offset: float = 0.0,
    ) -> None:
        super().__init__()
        require_not_negative(offset=offset)
        require_positive(period=period)
        self._parameters = parameters or VolumePlausibilityParameters()
        declare_inputs(self, volume=(Volume, NotFound))
        self._history = self.DeclareAbstractState(Value[object](_History()))
        declare_output(self, "volume", (Volume, NotFound), self._calc_volume)
        declare_output(
            self,
            "volume_check",
            VolumeCheck,
            self._calc_check,
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
        if not isinstance(volume, Volume):
            output.set_value(volume)
        elif volume is history.judged:
            output.set_value(history.result)
        else:
            reason = implausible(
                volume,
                history.last,
                history.refused,
                context.get_time(),
                history.lead,
                self._parameters,
            )
            output.set_value(NotFound(f"a volume is refused: {reason}") if reason else volume)

    def _calc_check(self, context: Context, output: Value) -> None:
        output.set_value(self._history_in(context).check)

    def _update(self, context: Context, state: State) -> EventStatus:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        history = self._history_in(context)
        if not isinstance(volume, Volume) or volume is history.judged:
            return EventStatus.DidNothing()
        result: Volume | NotFound = self.GetOutputPort("volume").Eval(context)
        check = history.check
        if isinstance(result, Volume):
            check = VolumeCheck(check.accepted + 1, check.refused)
            lead = volume.time - context.get_time()
            history = _History(volume, result, volume, None, lead, check)
        else:
            check = VolumeCheck(check.accepted, check.refused + 1, result.reason)
            history = replace(history, judged=volume, result=result, refused=volume, check=check)
        state.get_mutable_abstract_state(self._history).set_value(history)
        return EventStatus.Succeeded()
