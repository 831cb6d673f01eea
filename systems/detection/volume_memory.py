"""Remembers volumes, to compare the newest with an earlier one."""

from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from sonoservo.systems.ultrasound.volume import Volume
from sonoservo.systems.values import (
    NotFound,
    evaluate,
    require,
    require_not_negative,
    require_positive,
)


class VolumeMemory(LeafSystem):
    """Gives the volume that came ``interval`` volumes before the present one.

    .. pydrake_system::

        name: VolumeMemory
        input_ports:
        - volume
        output_ports:
        - previous_volume

    The output is the same before and after the event that stores the present volume, so that it
    does not matter when a block is evaluated. A repeated volume is not stored again, a missing one
    (`NotFound`) is passed over.

    Parameters
    ----------
    interval
        1 gives the previous volume; 2 the one before it, which a motorised probe acquired with the
        same direction of sweep.
    period, offset
        Of the event that stores, in s.
    """

    def __init__(self, *, interval: int = 1, period: float, offset: float = 0.0) -> None:
        super().__init__()
        require(interval >= 1, "interval", interval, "at least 1")
        require_positive(period=period)
        require_not_negative(offset=offset)
        self._interval = interval
        self.DeclareAbstractInputPort("volume", Value[object]())
        self._volumes = self.DeclareAbstractState(Value[object](()))
        self.DeclareAbstractOutputPort(
            "previous_volume", lambda: Value[object](), self._calc_previous_volume
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self._update_volumes)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update_volumes)

    def _calc_previous_volume(self, context: Context, output: Value) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        held: tuple[Volume, ...] = context.get_abstract_state(self._volumes).get_value()
        if isinstance(volume, Volume):
            held = tuple(each for each in held if each.time < volume.time)
        if len(held) < self._interval:
            output.set_value(NotFound("there is no earlier volume to compare with"))
        else:
            output.set_value(held[-self._interval])

    def _update_volumes(self, context: Context, state: State) -> EventStatus:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        held: tuple[Volume, ...] = context.get_abstract_state(self._volumes).get_value()
        if not isinstance(volume, Volume) or (held and volume.time <= held[-1].time):
            return EventStatus.DidNothing()
        # One more than the interval: the newest is the present volume itself.
        held = (*held, volume)[-self._interval - 1 :]
        state.get_mutable_abstract_state(self._volumes).set_value(held)
        return EventStatus.Succeeded()
