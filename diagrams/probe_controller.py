"""Controller of the probe: visual servo, force law, differential kinematics and guard."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Diagram, System

from sonoservo.diagrams.assembly import ARM, PROBE, assemble_arm
from sonoservo.systems.control.controller_schedule import ControllerSettings
from sonoservo.systems.control.differential_kinematics import (
    DifferentialKinematics,
    DifferentialKinematicsParameters,
)
from sonoservo.systems.control.force_controller import ForceController, ForceControllerParameters
from sonoservo.systems.control.guard import Guard
from sonoservo.systems.control.guard_parameters import GuardParameters
from sonoservo.systems.control.visual_servo import VisualServo, VisualServoParameters
from sonoservo.systems.robot.arm import load_arm
from sonoservo.systems.signals.ports import DiagramBuilder
from sonoservo.systems.signals.requirements import check_bounds, require, within

MAX_FORCE = 8.0
"""Highest force that the controller may be asked to hold, in N."""

MAX_FORCE_ALONE = 3.0
"""The same for an arm that reports no torques, whose wrist sensor is the only witness, in N."""

_CEILINGS = {
    "visual_servo.gain": (10.0, "1/s"),
    "visual_servo.max_speed": (0.1, "m/s"),
    "visual_servo.max_angular_speed_deg": (90.0, "deg/s"),
    "force.force": (MAX_FORCE, "N"),
    "force.proportional_gain": (0.1, "m/s/N"),
    "force.integral_gain": (1.0, "m/s/(N s)"),
    "force.filter_time": (0.1, "s"),
    "force.approach_speed": (0.05, "m/s"),
    "force.retreat_speed": (0.1, "m/s"),
    "kinematics.axis_gain": (10.0, "1/s"),
    "kinematics.posture_gain": (10.0, "1/s"),
}
"""Highest values of parameters with which the robot stays safe, and their units."""

_MAX_LEAN_DEG = 60.0
"""Largest angle between the probe's axis and straight down, in deg; the body lies below."""


@dataclass(kw_only=True)
class ProbeControllerParameters:
    """Parameters of the probe's controller.

    Parameters
    ----------
    time_step
        Period of the force law and the joint commands, in s. The guard's limits count on 10 ms.
    visual_servo, force, kinematics
        Parameters of the three blocks.
    guards
        Limits beyond which the robot is stopped.

    Raises
    ------
    ValueError
        If a parameter is above its ceiling, or the probe's axis points away from the body.
    """

    time_step: Annotated[float, within(0.0001, 0.01)] = 0.01
    visual_servo: VisualServoParameters = field(default_factory=VisualServoParameters)
    force: ForceControllerParameters = field(default_factory=ForceControllerParameters)
    kinematics: DifferentialKinematicsParameters = field(
        default_factory=DifferentialKinematicsParameters
    )
    guards: GuardParameters = field(default_factory=GuardParameters)

    def __post_init__(self) -> None:
        check_bounds(self)
        for name, (ceiling, unit) in _CEILINGS.items():
            block, parameter = name.split(".")
            value = getattr(getattr(self, block), parameter)
            require(value <= ceiling, name, value, f"at most {ceiling:g} {unit}")
        highest = 0.8 * self.guards.max_force
        force = self.force.force
        require(
            force <= highest, "force.force", force, f"at most 0.8 guards.max_force, {highest:g} N"
        )
        axis = np.array(self.kinematics.axis)
        lean = np.rad2deg(np.arccos(np.clip(-axis[2] / np.linalg.norm(axis), -1, 1)))
        require(
            bool(lean <= _MAX_LEAN_DEG),
            "kinematics.axis",
            self.kinematics.axis,
            f"a direction towards the body, at most {_MAX_LEAN_DEG:g} deg from straight down "
            "([0, 0, -1])",
        )

    @property
    def settings(self) -> ControllerSettings:
        """Initial values of the settings that may be changed at run time."""
        return ControllerSettings(self.visual_servo.gain, self.force.force)


def MakeProbeController(
    *,
    parameters: ProbeControllerParameters,
    arm: str = ARM,
    probe: str = PROBE,
    surface: Sequence[float] = (),
    X_PC: RigidTransform | None = None,
    mass_error: float = 0.0,
    search: System | None = None,
) -> Diagram:
    """Make the controller of the probe.

    .. pydrake_system::

        name: probe_controller
        input_ports:
        - estimate
        - X_WP
        - wrist_force
        - joint_state
        - external_torque (optional; only if the arm reports it)
        - gain (optional)
        - force_target (optional)
        - confirmation (optional)
        output_ports:
        - joint_command
        - planar_velocity
        - hold_reason
        - approach_velocity
        - pressing_force
        - guard (unless the guard is disabled)

    `estimate` is the tracker's NeedleEstimate. The inputs `X_WP`, `wrist_force` and `joint_state`
    and the output `joint_command` match the station's ports of the same names. `gain` (lambda in
    1/s) and `force_target` (in N) override the parameters. The next three outputs are for logs: the
    commands of the servo and of the force law, and the filtered force on which that law acts.
    `guard` is the `GuardStatus` of the guard, through which all commands go to the arm. It compares
    the wrist's force with `external_torque`, in N m; without that port only half the depth is
    allowed. A change of `confirmation`, one number, lets the robot go on where a person must.

    Parameters
    ----------
    parameters
        Parameters of the controller.
    arm, probe
        Names of files in models/robots and models/probes, or paths.
    surface
        (3,) point on the surface of the body at rest, in W, in m, if the parameters of the guard
        give none. If both are empty, the guard knows no workspace.
    X_PC
        Pose of the calibrated probe frame, which the controller takes for P, in the true one; by
        default they are the same.
    mass_error
        Relative error of the probe's mass as the controller knows it.
    search
        System between servo and kinematics that moves the probe while no needle is followed, with
        the inputs planar_velocity, estimate and X_WP and the output moving_velocity.
    """
    held, torque_error = assemble_arm(arm, probe, X_PC), load_arm(arm).torque_error
    if not torque_error:
        require(
            parameters.force.force <= MAX_FORCE_ALONE,
            "force.force",
            parameters.force.force,
            f"at most {MAX_FORCE_ALONE:g} N, because the arm {arm} reports no torques "
            "(torque_error), and so nothing but the wrist's sensor tells the force",
        )
    mass = (1 + mass_error) * held.probe.default_mass()
    builder = DiagramBuilder()
    servo = builder.AddNamedSystem("visual_servo", VisualServo(parameters=parameters.visual_servo))
    force = builder.AddNamedSystem(
        "force_controller",
        ForceController(
            parameters=parameters.force,
            mass=mass,
            time_step=parameters.time_step,
            max_force=MAX_FORCE if torque_error else MAX_FORCE_ALONE,
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
    builder.ExportInput(servo.GetInputPort("estimate"), "estimate")
    builder.ExportInput(servo.GetInputPort("X_WP"), "X_WP")
    planar_velocity = servo.GetOutputPort("planar_velocity")
    if search is not None:
        builder.AddNamedSystem("search", search)
        builder.Connect(planar_velocity, search.GetInputPort("planar_velocity"))
        for name in ("estimate", "X_WP"):
            builder.ConnectInput(name, search.GetInputPort(name))
        planar_velocity = search.GetOutputPort("moving_velocity")
    builder.Connect(planar_velocity, kinematics.GetInputPort("planar_velocity"))
    builder.Connect(
        force.GetOutputPort("approach_velocity"), kinematics.GetInputPort("approach_velocity")
    )
    builder.ConnectInput("X_WP", force.GetInputPort("X_WP"))
    builder.ExportInput(force.GetInputPort("wrist_force"), "wrist_force")
    builder.ExportInput(kinematics.GetInputPort("joint_state"), "joint_state")
    builder.ExportInput(servo.GetInputPort("gain"), "gain")
    builder.ExportInput(force.GetInputPort("force_target"), "force_target")
    arm_command = kinematics.GetOutputPort("joint_command")
    if parameters.guards.enabled:
        guard = builder.AddNamedSystem(
            "guard",
            Guard(
                parameters=parameters.guards,
                plant=held.plant,
                probe=held.frame,
                mass=mass,
                axis=parameters.kinematics.axis,
                surface=parameters.guards.surface or surface,
                time_step=parameters.time_step,
                torque_error=torque_error,
            ),
        )
        builder.Connect(arm_command, guard.GetInputPort("wanted_command"))
        for name in ("X_WP", "wrist_force", "joint_state"):
            builder.ConnectInput(name, guard.GetInputPort(name))
        arm_command = guard.GetOutputPort("joint_command")
        builder.Connect(arm_command, kinematics.GetInputPort("sent_command"))
        for output, port in (("approach_scale", "approach_scale"), ("acting", "held")):
            builder.Connect(guard.GetOutputPort(output), force.GetInputPort(port))
        builder.ExportOutput(guard.GetOutputPort("guard"), "guard")
        if torque_error:
            builder.ExportInput(guard.GetInputPort("external_torque"), "external_torque")
        builder.ExportInput(guard.GetInputPort("confirmation"), "confirmation")
    builder.ExportOutput(arm_command, "joint_command")
    for name in ("planar_velocity", "hold_reason"):
        builder.ExportOutput(servo.GetOutputPort(name), name)
    for name in ("approach_velocity", "pressing_force"):
        builder.ExportOutput(force.GetOutputPort(name), name)
    controller = builder.Build()
    controller.set_name("probe_controller")
    return controller
