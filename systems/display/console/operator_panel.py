"""The leaf that reads an operator's sliders and gamepad in the console."""

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from sonoservo.systems.display.console.controls import Control, Controls
from sonoservo.systems.signals.requirements import require_positive


class OperatorPanel(LeafSystem):
    """Reads the sliders of the console, which its pages, their keys and gamepads move.

    .. pydrake_system::

        name: OperatorPanel
        output_ports:
        - (one for each port that the controls name)

    The outputs are in SI units. Every control sets a target position, not a speed: everything comes
    to rest when the operator lets go, closes the page or loses the connection. Each run begins with
    the sliders at their initial values; `period` is the time between readings, in s.
    """

    def __init__(
        self, *, controls: Sequence[Control], inputs: Controls, period: float = 1 / 32
    ) -> None:
        require_positive(period=period)
        super().__init__()
        self._inputs, self._period = inputs, period
        inputs.offer(controls)
        self._names = [control.name for control in controls]
        self._units = np.array([control.unit for control in controls])
        self.DeclareDiscreteState([control.start for control in controls])
        for port in dict.fromkeys(control.port for control in controls):
            numbers = [n for n, control in enumerate(controls) if control.port == port]

            def calc(context: Context, output: BasicVector, n: list[int] = numbers) -> None:
                values = context.get_discrete_state_vector().value()
                output.SetFromVector((values * self._units)[n])

            self.DeclareVectorOutputPort(
                port, len(numbers), calc, prerequisites_of_calc={self.xd_ticket()}
            )
        self.DeclareInitializationPublishEvent(publish=lambda context: inputs.restart())
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        self._inputs.step(self._period)
        discrete_state.set_value([self._inputs.value(name) for name in self._names])
