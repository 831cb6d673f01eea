import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialForce
from pydrake.systems.analysis import Simulator

from sonoservo.systems.control.force_controller import (
    ForceController,
    ForceControllerParameters,
    ForceState,
    approach_velocity,
    next_state,
)

DOWN = RigidTransform(RotationMatrix.MakeXRotation(-np.pi / 2))


def test_leaf_steps_the_law():
    parameters = ForceControllerParameters()
    controller = ForceController(parameters=parameters, mass=0.5, time_step=0.005)
    simulator = Simulator(controller)
    context = simulator.get_mutable_context()
    controller.GetInputPort("X_WP").FixValue(context, DOWN)
    # The arm holds the probe's weight, less 1.7 N that the phantom bears.
    wrist_force = SpatialForce(np.zeros(3), [0, 1.7 - 0.5 * 9.81, 0])
    controller.GetInputPort("wrist_force").FixValue(context, wrist_force)

    velocity = controller.GetOutputPort("approach_velocity")
    assert velocity.Eval(context)[0] == parameters.approach_speed
    scale = controller.GetInputPort("approach_scale")
    for factor in (0.25, 1.0):
        scale.FixValue(context, [factor])
        assert velocity.Eval(context)[0] == factor * parameters.approach_speed

    simulator.AdvanceTo(0.0525)
    state = ForceState()
    for _ in range(11):
        state = next_state(state, 1.7, 0.005, parameters)
    assert state.in_contact
    assert velocity.Eval(context)[0] == pytest.approx(approach_velocity(state, parameters))
    assert controller.GetOutputPort("pressing_force").Eval(context)[0] == pytest.approx(state.force)
    simulator.AdvanceTo(3.0)
    assert velocity.Eval(context)[0] == parameters.approach_speed  # wound up
    controller.GetInputPort("held").FixValue(context, [1.0])
    simulator.AdvanceTo(6.0)
    assert velocity.Eval(context)[0] == pytest.approx(0.02 * 0.3, abs=1e-5)


def test_what_is_measured_acts_through_the_state_alone():
    controller = ForceController(parameters=ForceControllerParameters(), mass=0.5, time_step=0.005)
    for number in range(controller.num_output_ports()):
        for name, direct in (
            ("wrist_force", False),
            ("X_WP", False),
            ("force_target", number == 0),
            ("approach_scale", number == 0),
            ("held", False),
        ):
            port = controller.GetInputPort(name).get_index()
            assert controller.HasDirectFeedthrough(port, number) == direct
