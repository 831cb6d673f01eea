"""Leaf system that simulates a force sensor between flange and probe."""

import math
from dataclasses import dataclass
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.tree import JointIndex
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.signals.ports import declare_output
from sonoservo.systems.signals.requirements import (
    Bound,
    Bounded,
    NotNegative,
    require_not_negative,
    require_positive,
)

Finite: TypeAlias = Annotated[float, Bound("a number", math.isfinite)]
"""Number of any size."""


@dataclass(kw_only=True)
class WristSensorParameters(Bounded):
    """Noise and errors of the wrist force sensor.

    Parameters
    ----------
    force_noise, torque_noise
        Standard deviation of the wrist sensor's samples, in N and N m.
    force_bias, torque_bias
        Constant error of each of the wrist sensor's components, in N and N m.
    force_drift, torque_drift
        Rate at which the error of each of the wrist sensor's components grows, in N/s and N m/s.
    """

    force_noise: NotNegative = 0.02
    torque_noise: NotNegative = 0.001
    force_bias: Finite = 0.0
    torque_bias: Finite = 0.0
    force_drift: Finite = 0.0
    torque_drift: Finite = 0.0


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
    measures the weight and the inertia of everything mounted on it. Noise and a bias, which grows
    linearly with time, are added. `reaction_forces` is the plant's list of joint reactions.

    Parameters
    ----------
    wrist
        Index of the joint that contains the sensor.
    parameters
        Noise and errors.
    period
        Sampling period in s. The noise is constant within a period.
    seed
        Seed of the noise. Equal seeds and times give equal noise.
    """

    def __init__(
        self,
        *,
        wrist: JointIndex,
        parameters: WristSensorParameters,
        period: float,
        seed: int,
    ):
        require_not_negative(seed=seed)
        require_positive(period=period)
        super().__init__()
        self._wrist = int(wrist)
        self._deviation = np.repeat([parameters.torque_noise, parameters.force_noise], 3)
        self._bias = np.repeat([parameters.torque_bias, parameters.force_bias], 3)
        self._drift = np.repeat([parameters.torque_drift, parameters.force_drift], 3)
        self._period = period
        self._random = np.random.Generator(np.random.Philox(key=seed))
        self._random_state = self._random.bit_generator.state
        self._reaction_forces = self.DeclareAbstractInputPort(
            "reaction_forces", Value[list[SpatialForce]]()
        )
        tickets = self.all_input_ports_ticket(), self.time_ticket()
        declare_output(self, "wrist_force", SpatialForce, self._calc_wrist_force, tickets)

    def _calc_wrist_force(self, context: Context, output: Value) -> None:
        reaction = self._reaction_forces.Eval(context)[self._wrist]
        time = context.get_time()
        error = self._noise(time) + self._bias + self._drift * time
        output.set_value(reaction + SpatialForce(error))

    def _noise(self, time: float) -> NDArray[np.float64]:
        # The noise depends on the sample's number, so the sensor is repeatable without a state.
        self._random_state["state"]["counter"][0] = round(time / self._period)
        self._random.bit_generator.state = self._random_state
        return self._deviation * self._random.standard_normal(6)
