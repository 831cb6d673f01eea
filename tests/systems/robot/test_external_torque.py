import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from sonoservo.diagrams import (
    MakeStation,
    ProbePlacement,
    StationParameters,
    assemble_arm,
    start_posture,
)
from sonoservo.systems.robot import load_arm


@pytest.mark.parametrize(("arm", "step"), [("viper_s850", 0.01), ("lbr_iiwa_14", 0.005)])
def test_the_torques_are_those_of_the_contact_while_the_arm_moves(arm, step):
    """The true contact force, which is no input, is the referee."""
    parameters = StationParameters(
        arm=arm, plant=MultibodyPlantConfig(time_step=step), probe=ProbePlacement(height=0.0)
    )
    held, error = assemble_arm(arm), load_arm(arm).torque_error
    q, plant = start_posture(parameters), held.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    J = plant.CalcJacobianSpatialVelocity(
        context, JacobianWrtVariable.kV, held.frame, np.zeros(3), plant.world_frame(), held.frame
    )
    down = np.linalg.pinv(J) @ [0, 0, 0, 0, 0.01, 0]  # 10 mm into the body, in 0.3 s, and back
    knots = np.stack([q, q, q + down, q], axis=1)
    path = PiecewisePolynomial.CubicHermite([0, 0.2, 0.5, 0.7], knots, np.zeros_like(knots))
    builder = DiagramBuilder()
    station = builder.AddSystem(MakeStation(parameters=parameters))
    for port, trajectory in (
        ("joint_command", path),
        ("phantom_command", PiecewisePolynomial(np.r_[parameters.X_WT.translation(), np.zeros(3)])),
    ):
        source = builder.AddSystem(TrajectorySource(trajectory, 1))
        builder.Connect(source.get_output_port(), station.GetInputPort(port))
    logs = [
        LogVectorOutput(station.GetOutputPort(name), builder, step)
        for name in ("contact_force", "external_torque")
    ]
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.7)
    force, torque = (log.FindLog(simulator.get_context()).data()[:, 5:] for log in logs)
    expected = -np.outer(J[4], force[0])
    difference = (torque - expected) / np.reshape(error, (-1, 1))
    assert force.max() > 8
    assert np.abs(difference.mean(axis=1)).max() < 0.6
    assert difference.std() == pytest.approx(1.0, abs=0.35)
