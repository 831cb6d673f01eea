"""Leaf system that moves the probe along its axis to press with a constant force."""

import math
from dataclasses import replace

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from sonoservo.systems.control.force_law import (
    ForceControllerParameters,
    ForceState,
    approach_velocity,
    next_state,
    pressing_force,
)
from sonoservo.systems.signals.requirements import require_positive


class ForceController(LeafSystem):
    """Presses with a constant force, and approaches the phantom whenever there is no contact.

    .. pydrake_system::

        name: ForceController
        input_ports:
        - wrist_force
        - X_WP
        - force_target (optional)
        - approach_scale (optional)
        - held (optional)
        output_ports:
        - approach_velocity
        - pressing_force

    v_y = K_p (F* - F) + K_i int (F* - F) dt, with F the filtered force of the probe along its Y
    axis, compensated for the probe's weight. `wrist_force` is the SpatialForce of the arm on the
    probe in P, and `X_WP` is a RigidTransform. `force_target` is F* in N and replaces the
    parameter's value, unless it is no number above the force of touch. `approach_scale` is a factor
    on the highest speed towards the phantom. While `held` is not zero, the arm does not follow the
    law, and the integral is zero.
    `approach_velocity` is v_y of P in P, in m/s, and `pressing_force` is F in N.

    Parameters
    ----------
    parameters
        Parameters of the force law.
    mass
        Mass carried by the sensor, in kg.
    time_step
        Period of the updates, in s.
    max_force
        Highest force in N to which `force_target` is cut.
    """

    def __init__(
        self,
        *,
        parameters: ForceControllerParameters,
        mass: float,
        time_step: float,
        max_force: float = math.inf,
    ):
        require_positive(mass=mass, time_step=time_step)
        super().__init__()
        self._parameters, self._max_force = parameters, max_force
        self._mass, self._time_step = mass, time_step
        self._wrist_force = self.DeclareAbstractInputPort("wrist_force", Value(SpatialForce()))
        self._X_WP = self.DeclareAbstractInputPort("X_WP", Value(RigidTransform()))
        self._target = self.DeclareVectorInputPort("force_target", 1)
        self._scale = self.DeclareVectorInputPort("approach_scale", 1)
        self._held = self.DeclareVectorInputPort("held", 1)
        self.DeclareDiscreteState(3)
        state, settings = self.xd_ticket(), {self._target.ticket(), self._scale.ticket()}
        self.DeclareVectorOutputPort(
            "approach_velocity", 1, self._calc_approach_velocity, {state, *settings}
        )
        self.DeclareVectorOutputPort("pressing_force", 1, self._calc_pressing_force, {state})
        self.DeclarePeriodicDiscreteUpdateEvent(time_step, 0, self._update_state)

    def _state(self, context: Context) -> ForceState:
        force, integral, in_contact = context.get_discrete_state(0).value().tolist()
        return ForceState(force, integral, bool(in_contact))

    def _parameters_now(self, context: Context) -> ForceControllerParameters:
        start = self._parameters
        target, scale = self._target, self._scale
        force = target.Eval(context).item() if target.HasValue(context) else start.force
        if not start.touch_force < force < math.inf:
            force = start.force
        force = min(force, self._max_force)
        factor = scale.Eval(context).item() if scale.HasValue(context) else 1.0
        if force == start.force and factor == 1.0:
            return start  # because replacing them costs another validation
        return replace(start, force=force, approach_speed=factor * start.approach_speed)

    def _update_state(self, context: Context, discrete_state: DiscreteValues) -> None:
        wrist_force, X_WP = self._wrist_force.Eval(context), self._X_WP.Eval(context)
        force = pressing_force(wrist_force, X_WP, self._mass)
        state = next_state(
            self._state(context),
            force,
            self._time_step,
            self._parameters_now(context),
            held=self._held.HasValue(context) and bool(self._held.Eval(context)[0]),
        )
        discrete_state.set_value(0, state)

    def _calc_approach_velocity(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, approach_velocity(self._state(context), self._parameters_now(context)))

    def _calc_pressing_force(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._state(context).force)
