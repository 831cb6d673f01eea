"""Memory of the volume with which the newest one is compared."""

from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate
from sonoservo.systems.signals.radio_frequency_sweep import RadioFrequencySweep
from sonoservo.systems.signals.requirements import require_not_negative, require_positive
from sonoservo.systems.signals.search_reason import SearchReason
from sonoservo.systems.signals.volume import Volume

Remembered = Volume | RadioFrequencySweep


def _alike(a: Remembered, b: Remembered) -> bool:
    """Return True unless two volumes are known to come from sweeps of opposite directions."""
    return a.motion is None or b.motion is None or a.motion.direction == b.motion.direction


class VolumeMemory(LeafSystem):
    """Outputs an earlier volume with which the present one is compared.

    .. pydrake_system::

        name: VolumeMemory
        input_ports:
        - volume
        output_ports:
        - previous_volume

    A volume is a `Volume` or a `RadioFrequencySweep`. ``previous_volume`` is the newest one that is
    older than the present one, or a `NotFound` if there is none. It is the same before and after
    the event that stores the present volume, so the order of evaluation does not matter. A repeated
    volume is not stored again, and a missing one (`NotFound`) is ignored.

    Parameters
    ----------
    same_direction
        Whether both volumes must come from sweeps in the same direction.
    kinds
        Kinds of volume that may arrive.
    period, offset
        Period and offset of the event that stores a volume, in s.
    """

    def __init__(
        self,
        *,
        same_direction: bool = False,
        kinds: tuple[type, ...] = (Volume, RadioFrequencySweep),
        period: float,
        offset: float = 0.0,
    ) -> None:
        super().__init__()
        require_not_negative(offset=offset)
        require_positive(period=period)
        self._same_direction = same_direction
        declare_inputs(self, volume=(*kinds, NotFound))
        self._volumes = self.DeclareAbstractState(Value[object](()))
        declare_output(self, "previous_volume", (*kinds, NotFound), self._calc_previous_volume)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self._update_volumes)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update_volumes)

    def _calc_previous_volume(self, context: Context, output: Value) -> None:
        volume = evaluate(self, context, "volume", (Volume, RadioFrequencySweep, NotFound))
        held: tuple[Remembered, ...] = context.get_abstract_state(self._volumes).get_value()
        for each in reversed(held):
            if (
                isinstance(volume, Remembered)
                and each.time < volume.time
                and (_alike(each, volume) or not self._same_direction)
            ):
                output.set_value(each)
                return
        output.set_value(NotFound(SearchReason.NOTHING_EARLIER(" to compare with")))

    def _update_volumes(self, context: Context, state: State) -> EventStatus:
        volume = evaluate(self, context, "volume", (Volume, RadioFrequencySweep, NotFound))
        held: tuple[Remembered, ...] = context.get_abstract_state(self._volumes).get_value()
        if not isinstance(volume, Remembered) or (held and volume.time <= held[-1].time):
            return EventStatus.DidNothing()
        # The present volume and later ones need only the newest volume of either direction.
        state.get_mutable_abstract_state(self._volumes).set_value((*held[-2:], volume))
        return EventStatus.Succeeded()
