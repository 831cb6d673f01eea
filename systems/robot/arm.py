"""Arm with its probe, described by a YAML file, in any plant."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import ModelDirective
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Frame,
    Joint,
    JointIndex,
    ModelInstanceIndex,
    PdControllerGains,
    RigidBody,
)

from sonoservo.systems.files.model_file import model_file, read_once
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import load_typed, read_yaml
from sonoservo.systems.robot.directives import add_directives, motors, resolve_files
from sonoservo.systems.robot.probe_body import AddProbeBody, ProbeBody
from sonoservo.systems.signals.requirements import Bounded, NotNegative, Positive, require, within


@dataclass(kw_only=True)
class JointServo(Bounded):
    """Gains of the joint servos in their order: stiffnesses in N m/rad, dampings in N m s/rad."""

    p: list[Positive] = field(default_factory=list)
    d: list[NotNegative] = field(default_factory=list)


@dataclass(kw_only=True)
class Arm(Bounded):
    """Description of an arm in a YAML file; `load_arm` reads one.

    Parameters
    ----------
    directives
        Drake model directives that add a model named ``arm`` and weld its base to the world. The
        model's default joint positions are the home posture, near which the arm stays.
    packages
        Folders of the packages that the model's files name in ``package://NAME/...``, by name,
        relative to the YAML file. Meshes may be OBJ, glTF, DAE or STL.
    flange
        Frame of the model that holds the probe.
    servo
        Gains of the joint servos.
    max_speed
        Highest speeds of the joints in rad/s; if empty, those in the model's file are used.
    torque_error
        Standard deviations of the errors of the external torques that the arm reports for its
        joints, in N m; with more than 1 N m, they would tell nothing. If empty, it reports none:
        nothing but the wrist's sensor then tells how hard the probe presses, which limits force and
        depth.
    """

    directives: list[ModelDirective] = field(default_factory=list)
    packages: dict[str, str] = field(default_factory=dict)
    flange: str = "flange"
    servo: JointServo = field(default_factory=JointServo)
    max_speed: list[float] = field(default_factory=list)
    torque_error: list[Annotated[float, within(1e-3, 1.0, " N m")]] = field(default_factory=list)


@dataclass(frozen=True)
class ArmWithProbe:
    """Arm, probe, the weld between them that the wrist sensor measures, and P as calibrated."""

    plant: MultibodyPlant
    model_instance: ModelInstanceIndex
    probe: RigidBody
    wrist: JointIndex
    frame: Frame

    @property
    def home(self) -> NDArray[np.float64]:
        """(n,) joint positions of the home posture, in rad."""
        return self.plant.GetDefaultPositions(self.model_instance)


def load_arm(name: str) -> Arm:
    """Read an arm from YAML by its name in ``models/robots``, or by a path, and check it.

    A ConfigurationError names the file and the field; FileNotFoundError if there is no such file.
    """
    return _read_arm(model_file("robots", name))


@read_once
def _read_arm(path: Path) -> Arm:
    arm = load_typed(Arm, read_yaml(path), str(path))
    resolve_files(arm.directives, path, arm.packages)
    plant = MultibodyPlant(time_step=0)
    try:
        instance = AddArm(plant, arm)
        plant.Finalize()
        _check(plant, instance, arm)
    except ValueError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    return arm


def _joints(plant: MultibodyPlant, instance: ModelInstanceIndex) -> list[Joint]:
    joints = [plant.get_joint(index) for index in plant.GetJointIndices(instance)]
    return [joint for joint in joints if joint.num_velocities() > 0]


def _check(plant: MultibodyPlant, instance: ModelInstanceIndex, arm: Arm) -> None:
    """Raise ValueError if a finalized plant's arm cannot carry a probe."""
    joints = _joints(plant, instance)
    base = plant.get_body(plant.GetBodyIndices(instance)[0])
    if not plant.IsAnchored(base):
        raise ValueError(f"directives: no add_weld joins {base.name()!r}, the base, to the world")
    count = len(joints)
    require(
        count >= 6 and all(joint.num_positions() == 1 for joint in joints),
        "directives",
        [joint.name() for joint in joints],
        "an arm with at least 6 joints of one axis each",
    )
    for field_name, values in (
        ("servo.p", arm.servo.p),
        ("servo.d", arm.servo.d),
        ("max_speed", arm.max_speed or count * [1.0]),
        ("torque_error", arm.torque_error or count * [1.0]),
    ):
        require(len(values) == count, field_name, values, f"{count} numbers, one for each joint")
    order = [motor.joint().position_start() for motor in motors(plant, instance)]
    if order != sorted(order):
        raise ValueError("directives: the model's transmissions are not in the order of its joints")
    if plant.num_velocities() > count:
        raise ValueError("directives: something moves beside the arm; weld it to the world")
    for joint, speed in zip(joints, plant.GetVelocityUpperLimits(), strict=True):
        require(
            speed > 0,
            f"max_speed of {joint.name()}",
            float(speed),
            "above 0 rad/s, or the joint cannot move; the limit is the model's, unless max_speed "
            "is given",
        )
    flange = plant.GetFrameByName(arm.flange, instance).body()
    for joint in joints:
        links = plant.GetBodiesWeldedTo(joint.child_body())
        if flange not in links and not sum(link.default_mass() for link in links) > 0:
            raise ValueError(
                f"directives: {joint.name()} moves {joint.child_body().name()}, which has no mass; "
                "give it an <inertial> in the model's file"
            )
    home, lower, upper = (
        plant.GetDefaultPositions(),
        plant.GetPositionLowerLimits(),
        plant.GetPositionUpperLimits(),
    )
    for joint, q, low, high in zip(joints, home, lower, upper, strict=True):
        require(
            bool(low <= q <= high),
            f"default_joint_positions.{joint.name()}",
            float(q),
            f"within the joint's limits, {low:g} to {high:g} rad",
        )


def AddArm(plant: MultibodyPlant, arm: Arm) -> ModelInstanceIndex:
    """Add an arm without a probe to a plant and return its model instance.

    Joints without a motor get one. ValueError if the directives produce no arm.
    """
    add_directives(plant, arm.directives, arm.packages)
    if not plant.HasModelInstanceNamed("arm"):
        raise ValueError("directives: no add_model adds a model named 'arm'")
    instance = plant.GetModelInstanceByName("arm")
    if not plant.HasFrameNamed(arm.flange, instance):
        links = (plant.get_body(index).name() for index in plant.GetBodyIndices(instance))
        raise ValueError(
            f"flange: the model has no frame {arm.flange!r}; its links are {', '.join(links)}"
        )
    driven = {motor.joint().name() for motor in motors(plant, instance)}
    joints = _joints(plant, instance)
    for joint in joints:
        if joint.name() not in driven:
            plant.AddJointActuator(f"{joint.name()}_motor", joint)
    for joint, speed in zip(joints, arm.max_speed, strict=False):
        joint.set_velocity_limits([-speed], [speed])
    return instance


def AddArmWithProbe(plant: MultibodyPlant, arm: Arm, body: ProbeBody) -> ArmWithProbe:
    """Add an arm, and a probe mounted on its flange, to a plant."""
    instance = AddArm(plant, arm)
    probe = AddProbeBody(plant, body)
    wrist = plant.WeldFrames(
        plant.GetFrameByName(arm.flange, instance),
        plant.GetFrameByName("wrist_sensor", probe),
        body.mount.GetDeterministicValue(),
    )
    link = plant.GetBodyByName("probe", probe)
    return ArmWithProbe(plant, instance, link, wrist.index(), link.body_frame())


def set_servo_gains(arm: ArmWithProbe, servo: JointServo) -> None:
    """Set the servo gains of each of the arm's motors, before the plant is finalized."""
    for motor, p, d in zip(motors(arm.plant, arm.model_instance), servo.p, servo.d, strict=True):
        motor.set_controller_gains(PdControllerGains(p=p, d=d))


def MakeArmPlant(arm: Arm, body: ProbeBody, X_PC: RigidTransform | None = None) -> ArmWithProbe:
    """Return an arm and its probe in a finalized plant of their own, for kinematics.

    X_PC is the pose of the calibrated probe frame in the true one; by default they are the same.
    """
    plant = MultibodyPlant(time_step=0)
    placed = AddArmWithProbe(plant, arm, body)
    if X_PC is not None and not X_PC.IsExactlyIdentity():
        calibrated = FixedOffsetFrame("calibrated_probe", placed.frame, X_PC)
        placed = replace(placed, frame=plant.AddFrame(calibrated))
    plant.Finalize()
    return placed
