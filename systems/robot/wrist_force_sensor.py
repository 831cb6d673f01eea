"""Leaf system that simulates a force sensor between flange and probe."""

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.tree import JointIndex
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.signals.requirements import require_not_negative, require_positive


class WristForceSensor(LeafSystem):
    """Simulates a six-axis force sensor at the wrist.

    .. pydrake_system::

        name: WristForceSensor
        input_ports:
        - reaction_forces
        output_ports:
        - wrist_force

    `wrist_force` is the SpatialForce, in N m and N, that the arm applies to the probe at the
    sensor. Its axes are parallel to those of the probe frame P. Like a real sensor, it also
    measures the weight and the inertia of everything mounted on it. `reaction_forces` is the
    plant's list of joint reactions.

    Parameters
    ----------
    wrist
        Index of the joint that contains the sensor.
    force_noise, torque_noise
        Standard deviations of the noise of a force, in N, and of a torque, in N m.
    period
        Sampling period in s. The noise is constant within a period.
    seed
        Seed of the noise. Equal seeds and times give equal noise.
    """

    def __init__(
        self,
        *,
        wrist: JointIndex,
        force_noise: float,
        torque_noise: float,
        period: float,
        seed: int,
    ):
        require_not_negative(force_noise=force_noise, torque_noise=torque_noise, seed=seed)
        require_positive(period=period)
        super().__init__()
        self._wrist = int(wrist)
        self._deviation = np.repeat([torque_noise, force_noise], 3)
        self._period = period
        self._random = np.random.Generator(np.random.Philox(key=seed))
        self._random_state = self._random.bit_generator.state
        self.DeclareAbstractInputPort("reaction_forces", Value[list[SpatialForce]]())
        self.DeclareAbstractOutputPort(
            "wrist_force",
            lambda: Value(SpatialForce.Zero()),
            self._calc_wrist_force,
            prerequisites_of_calc={self.all_input_ports_ticket(), self.time_ticket()},
        )

    def _calc_wrist_force(self, context: Context, output: Value) -> None:
        reaction = self.GetInputPort("reaction_forces").Eval(context)[self._wrist]
        output.set_value(reaction + SpatialForce(self._noise(context.get_time())))

    def _noise(self, time: float) -> NDArray[np.float64]:
        # The noise depends on the sample's number, so the sensor is repeatable without a state.
        self._random_state["state"]["counter"][0] = round(time / self._period)
        self._random.bit_generator.state = self._random_state
        return self._deviation * self._random.standard_normal(6)
