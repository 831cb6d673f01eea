"""Memory of volumes for the comparison of the newest with an earlier one."""

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.radio_frequency_sweep import RadioFrequencySweep
from sonoservo.systems.signals.requirements import require_not_negative, require_positive
from sonoservo.systems.signals.volume import Volume

_EARLIER = 4
"""Largest number of volumes that are kept from the ``history``."""

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
        - earlier_volumes

    A volume is a `Volume` or a `RadioFrequencySweep`. ``previous_volume`` is the newest one that is
    at least ``look_back`` older than the present one, or a `NotFound` if there is none.
    ``earlier_volumes`` is a tuple of some that are older still. Both are the same before and after
    the event that stores the present volume, so the order of evaluation does not matter. A repeated
    volume is not stored again, and a missing one (`NotFound`) is ignored.

    Parameters
    ----------
    look_back
        Smallest difference between the volumes' times, in s; 0 gives the previous volume.
    same_direction
        Whether both volumes must come from sweeps in the same direction.
    history
        Time before ``look_back`` from which some earlier volumes are kept, in s.
    period, offset
        Period and offset of the event that stores a volume, in s.
    """

    def __init__(
        self,
        *,
        look_back: float = 0.0,
        same_direction: bool = False,
        history: float = 0.0,
        period: float,
        offset: float = 0.0,
    ) -> None:
        super().__init__()
        require_not_negative(look_back=look_back, history=history, offset=offset)
        require_positive(period=period)
        self._look_back = look_back
        self._same_direction = same_direction
        self._history = history
        self.DeclareAbstractInputPort("volume", Value[object]())
        self._volumes = self.DeclareAbstractState(Value[object](()))
        self._earlier = self.DeclareAbstractState(Value[object](()))
        self.DeclareAbstractOutputPort(
            "previous_volume", lambda: Value[object](), self._calc_previous_volume
        )
        self.DeclareAbstractOutputPort(
            "earlier_volumes", lambda: Value[object](), self._calc_earlier_volumes
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self._update_volumes)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update_volumes)

    def _calc_previous_volume(self, context: Context, output: Value) -> None:
        volume = evaluate(self, context, "volume", (Volume, RadioFrequencySweep, NotFound))
        held: tuple[Remembered, ...] = context.get_abstract_state(self._volumes).get_value()
        for each in reversed(held):
            if (
                isinstance(volume, Remembered)
                and each.time < volume.time
                and each.time <= volume.time - self._look_back
                and (_alike(each, volume) or not self._same_direction)
            ):
                output.set_value(each)
                return
        output.set_value(NotFound("there is no earlier volume to compare with"))

    def _calc_earlier_volumes(self, context: Context, output: Value) -> None:
        volume = evaluate(self, context, "volume", (Volume, RadioFrequencySweep, NotFound))
        held: tuple[Remembered, ...] = context.get_abstract_state(self._earlier).get_value()
        newest = volume.time - self._look_back if isinstance(volume, Remembered) else -np.inf
        output.set_value(
            tuple(each for each in held if newest - self._history <= each.time < newest)
        )

    def _update_volumes(self, context: Context, state: State) -> EventStatus:
        volume = evaluate(self, context, "volume", (Volume, RadioFrequencySweep, NotFound))
        held: tuple[Remembered, ...] = context.get_abstract_state(self._volumes).get_value()
        if not isinstance(volume, Remembered) or (held and volume.time <= held[-1].time):
            return EventStatus.DidNothing()
        held = (*held, volume)
        earlier: tuple[Remembered, ...] = context.get_abstract_state(self._earlier).get_value()
        # Later volumes need only the newest volume of either direction that is old enough.
        while len(held) > 3 and held[2].time <= volume.time - self._look_back:
            if not earlier or held[0].time - earlier[-1].time >= self._history / _EARLIER:
                earlier = (*earlier, held[0])
            held = held[1:]
        oldest = volume.time - self._look_back - self._history
        earlier = tuple(each for each in earlier if each.time >= oldest)
        state.get_mutable_abstract_state(self._earlier).set_value(earlier)
        state.get_mutable_abstract_state(self._volumes).set_value(held)
        return EventStatus.Succeeded()
