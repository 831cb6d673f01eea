import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialForce
from pydrake.systems.analysis import Simulator

from sonoservo.systems.control import ForceController, ForceControllerParameters
from sonoservo.systems.control.force_controller import (
    ForceState,
    approach_velocity,
    next_state,
    pressing_force,
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


STEP = 0.005


@given(angles=st.tuples(*3 * [st.floats(-3, 3)]), force=st.floats(0, 5), mass=st.floats(0.1, 2))
def test_pressing_force_is_free_of_the_weight_in_any_posture(angles, force, mass):
    R_WP = RollPitchYaw(angles).ToRotationMatrix()
    weight_P = R_WP.inverse().multiply([0, 0, -9.81 * mass])
    contact_P = np.array([0.3, -force, -0.2])
    # At rest the arm bears what weight and contact leave.
    wrist_force = SpatialForce(np.ones(3), -(weight_P + contact_P))
    found = pressing_force(wrist_force, RigidTransform(R_WP, [0.1, 0.2, 0.3]), mass)
    assert found == pytest.approx(force, abs=1e-9)


def test_filter_is_of_first_order():
    parameters = ForceControllerParameters(filter_time=0.02)
    state = ForceState()
    for _ in range(round(0.02 / 1e-5)):
        state = next_state(state, 1.0, 1e-5, parameters)
    assert state.force == pytest.approx(1 - np.exp(-1), abs=1e-3)


def test_contact_has_hysteresis():
    parameters = ForceControllerParameters(filter_time=0.0, touch_force=0.4, release_force=0.2)
    state, seen = ForceState(), []
    for force in (0.3, 0.5, 0.3, 0.1, 0.3):
        state = next_state(state, force, STEP, parameters)
        seen.append(state.in_contact)
    assert seen == [False, True, True, False, False]
    for force in (3.0, 0.1):  # contact begins between release and the wanted force
        with pytest.raises(ValueError, match="touch_force"):
            ForceControllerParameters(touch_force=force)


@pytest.mark.parametrize(
    ("integral", "force", "held", "expected"),
    [
        (0.0, 1.0, False, ForceState(1.0, 0.0, True)),
        (0.0, 1.8, False, ForceState(1.8, 0.1 * 0.2 * STEP, True)),
        (0.1, 0.0, False, ForceState(0.0, 0.0, False)),
        (0.1, 5.0, False, ForceState(5.0, 0.1 - 0.3 * STEP, True)),
        (0.1, 1.0, False, ForceState(1.0, 0.1, True)),
        (0.1, 1.9, True, ForceState(1.9, 0.0, True)),
    ],
)
def test_the_integral_grows_near_the_wanted_force_and_shrinks_at_any(
    integral, force, held, expected
):
    parameters = ForceControllerParameters(filter_time=0.0, integral_gain=0.1, integral_band=0.5)
    state = ForceState(1.5, integral, in_contact=True)
    assert next_state(state, force, STEP, parameters, held=held) == pytest.approx(expected)


def test_velocity_is_proportional_and_limited():
    parameters = ForceControllerParameters(proportional_gain=0.01)
    for force, integral, expected in (
        (1.5, 0.0, 0.005),
        (2.0, 0.003, 0.003),
        (0.5, 0.0, parameters.approach_speed),
        (50.0, 0.0, -parameters.retreat_speed),
    ):
        state = ForceState(force, integral, in_contact=True)
        assert approach_velocity(state, parameters) == pytest.approx(expected)
