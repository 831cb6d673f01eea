"""Parts of a station that measure: the pose of its probe, its joints, and the torques on them."""

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import OutputPort
from pydrake.systems.primitives import Adder, ConstantVectorSource

from sonoservo.diagrams.assembly import assemble_arm
from sonoservo.systems.robot.arm import load_arm
from sonoservo.systems.robot.errors.calibration import CalibrationParameters, hand_eye_error
from sonoservo.systems.robot.errors.pose_delay import PoseDelay, PoseDelayParameters
from sonoservo.systems.robot.external_torque import ExternalTorque
from sonoservo.systems.robot.forward_kinematics import ForwardKinematics
from sonoservo.systems.signals.ports import DiagramBuilder


def add_offset(
    builder: DiagramBuilder, port: OutputPort, offset: NDArray[np.float64]
) -> OutputPort:
    """Return a port with the values of another one plus a constant, or that port for zero."""
    if not offset.any():
        return port
    adder = builder.AddSystem(Adder(2, len(offset)))
    constant = builder.AddSystem(ConstantVectorSource(offset))
    builder.Connect(port, adder.get_input_port(0))
    builder.Connect(constant.get_output_port(), adder.get_input_port(1))
    return adder.get_output_port()


def add_measured_pose(
    builder: DiagramBuilder,
    true_pose: OutputPort,
    joint_state: OutputPort,
    *,
    arm: str,
    probe: str,
    calibration: CalibrationParameters,
    delay: PoseDelayParameters,
    period: float,
    seed: int,
) -> OutputPort:
    """Add the systems that measure the pose of the probe, and return the port of that pose."""
    measured = true_pose
    if calibration.moves_probe:
        held = assemble_arm(arm, probe, hand_eye_error(calibration, seed))
        kinematics = ForwardKinematics(plant=held.plant, frame=held.frame)
        builder.AddNamedSystem("forward_kinematics", kinematics)
        builder.Connect(joint_state, kinematics.get_input_port())
        measured = kinematics.get_output_port()
    if delay != PoseDelayParameters():
        delayed = PoseDelay(parameters=delay, period=period, seed=seed)
        builder.AddNamedSystem("pose_delay", delayed)
        builder.Connect(measured, delayed.get_input_port())
        measured = delayed.get_output_port()
    return measured


def add_external_torque(
    builder: DiagramBuilder,
    joint_state: OutputPort,
    motor_torque: OutputPort,
    *,
    arm: str,
    probe: str,
    period: float,
    seed: int,
) -> None:
    """Export what estimates the external torques on the joints, if the arm reports them.

    The arguments are those of `add_measured_pose`, and the port of the motors' torques.
    """
    error = load_arm(arm).torque_error
    if not error:
        return
    drives = ExternalTorque(
        plant=assemble_arm(arm, probe).plant,
        error=np.array(error),
        period=period,
        seed=seed,
    )
    builder.AddNamedSystem("external_torque", drives)
    builder.Connect(joint_state, drives.GetInputPort("joint_state"))
    builder.Connect(motor_torque, drives.GetInputPort("motor_torque"))
    builder.ExportOutput(drives.get_output_port(), "external_torque")
