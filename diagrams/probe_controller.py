"""Controller of the probe: visual servo, force law and differential kinematics."""

from dataclasses import dataclass, field

from pydrake.math import RigidTransform
from pydrake.systems.framework import Diagram, DiagramBuilder

from sonoservo.diagrams.assembly import ARM, PROBE, assemble_arm
from sonoservo.systems.control.controller_schedule import ControllerSettings
from sonoservo.systems.control.differential_kinematics import (
    DifferentialKinematics,
    DifferentialKinematicsParameters,
)
from sonoservo.systems.control.force_controller import ForceController
from sonoservo.systems.control.force_law import ForceControllerParameters
from sonoservo.systems.control.visual_servo import VisualServo, VisualServoParameters
from sonoservo.systems.signals.requirements import require_positive


@dataclass(kw_only=True)
class ProbeControllerParameters:
    """Parameters of the probe's controller.

    Parameters
    ----------
    time_step
        Period of the force law and the joint commands, in s.
    visual_servo, force, kinematics
        Parameters of the three blocks.
    """

    time_step: float = 0.005
    visual_servo: VisualServoParameters = field(default_factory=VisualServoParameters)
    force: ForceControllerParameters = field(default_factory=ForceControllerParameters)
    kinematics: DifferentialKinematicsParameters = field(
        default_factory=DifferentialKinematicsParameters
    )

    def __post_init__(self) -> None:
        require_positive(time_step=self.time_step)

    @property
    def settings(self) -> ControllerSettings:
        """Initial values of the settings that may be changed at run time."""
        return ControllerSettings(self.visual_servo.gain, self.force.force)


def MakeProbeController(
    *,
    parameters: ProbeControllerParameters,
    arm: str = ARM,
    probe: str = PROBE,
    X_PC: RigidTransform | None = None,
    mass_error: float = 0.0,
) -> Diagram:
    """Make the controller of the probe.

    .. pydrake_system::

        name: probe_controller
        input_ports:
        - estimate
        - X_WP
        - wrist_force
        - joint_state
        - gain (optional)
        - force_target (optional)
        output_ports:
        - joint_command
        - planar_velocity
        - approach_velocity
        - pressing_force

    `estimate` is the tracker's NeedleEstimate. The inputs `X_WP`, `wrist_force` and `joint_state`
    and the output `joint_command` match the station's ports of the same names. `gain` (lambda in
    1/s) and `force_target` (in N) override the parameters. The last three outputs are for logs: the
    commands of the servo and of the force law, and the filtered force on which that law acts.

    Parameters
    ----------
    parameters
        Parameters of the controller.
    arm, probe
        Names of files in models/robots and models/probes, or paths.
    X_PC
        Pose of the calibrated probe frame, which the controller takes for P, in the true one; by
        default they are the same.
    mass_error
        Relative error of the probe's mass as the controller knows it.
    """
    held = assemble_arm(arm, probe, X_PC)
    builder = DiagramBuilder()
    servo = builder.AddNamedSystem("visual_servo", VisualServo(parameters=parameters.visual_servo))
    force = builder.AddNamedSystem(
        "force_controller",
        ForceController(
            parameters=parameters.force,
            mass=(1 + mass_error) * held.probe.default_mass(),
            time_step=parameters.time_step,
        ),
    )
    kinematics = builder.AddNamedSystem(
        "differential_kinematics",
        DifferentialKinematics(
            parameters=parameters.kinematics,
            plant=held.plant,
            probe=held.frame,
            time_step=parameters.time_step,
        ),
    )
    for output, block in (("planar_velocity", servo), ("approach_velocity", force)):
        builder.Connect(block.GetOutputPort(output), kinematics.GetInputPort(output))
    builder.ExportInput(servo.GetInputPort("estimate"), "estimate")
    builder.ExportInput(servo.GetInputPort("X_WP"), "X_WP")
    builder.ConnectInput("X_WP", force.GetInputPort("X_WP"))
    builder.ExportInput(force.GetInputPort("wrist_force"), "wrist_force")
    builder.ExportInput(kinematics.GetInputPort("joint_state"), "joint_state")
    builder.ExportInput(servo.GetInputPort("gain"), "gain")
    builder.ExportInput(force.GetInputPort("force_target"), "force_target")
    builder.ExportOutput(kinematics.GetOutputPort("joint_command"), "joint_command")
    builder.ExportOutput(servo.GetOutputPort("planar_velocity"), "planar_velocity")
    for name in ("approach_velocity", "pressing_force"):
        builder.ExportOutput(force.GetOutputPort(name), name)
    controller = builder.Build()
    controller.set_name("probe_controller")
    return controller
