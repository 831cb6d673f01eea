"""Station and controller, without imaging or display."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource
from pydrake.trajectories import PiecewisePolynomial

from sonoservo.diagrams import (
    MakeProbeController,
    MakeStation,
    ProbeControllerParameters,
    StationParameters,
)
from sonoservo.systems.robot.phantom import PhantomMotion
from sonoservo.systems.signals import NeedleCurve, NeedleEstimate, TrackingMode


def test_one_second_of_station_and_controller(benchmark):
    parameters = StationParameters()
    builder = DiagramBuilder()
    station = builder.AddSystem(MakeStation(parameters=parameters))
    controller = builder.AddSystem(MakeProbeController(parameters=ProbeControllerParameters()))
    pose = np.concatenate([parameters.X_WT.translation(), np.zeros(3)])
    motion = builder.AddSystem(PhantomMotion(trajectory=PiecewisePolynomial(pose)))
    curve = NeedleCurve(np.array([[0.44, 0, 0.16], [0.5, 0, 0.155]]))
    estimate = NeedleEstimate(TrackingMode.TRACKING, 1e3, curve, np.zeros((2, 3)), np.eye(12))
    tracker = builder.AddSystem(ConstantValueSource(Value[object](estimate)))
    builder.Connect(motion.get_output_port(), station.GetInputPort("phantom_command"))
    builder.Connect(tracker.get_output_port(), controller.GetInputPort("estimate"))
    builder.Connect(
        controller.GetOutputPort("joint_command"), station.GetInputPort("joint_command")
    )
    for port in ("X_WP", "wrist_force", "joint_state", "external_torque"):
        builder.Connect(station.GetOutputPort(port), controller.GetInputPort(port))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(3)

    benchmark(lambda: simulator.AdvanceTo(simulator.get_context().get_time() + 1))
    force = station.GetOutputPort("contact_force")
    assert force.Eval(station.GetMyContextFromRoot(simulator.get_context()))[0] == pytest.approx(
        2.0, abs=0.1
    )
    benchmark.extra_info["compared_with"] = "real time"
    if benchmark.stats is not None:
        benchmark.extra_info["ratio"] = 1 / benchmark.stats.stats.median
