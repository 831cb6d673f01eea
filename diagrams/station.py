"""Station: arm with probe, phantom, contact, joint servo and wrist force sensor."""

import copyreg
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.framework import Diagram, OutputPort
from pydrake.systems.primitives import Adder, ConstantVectorSource, Gain

from sonoservo.diagrams.assembly import ARM, PHANTOM, PROBE, assemble_arm, load_probe_body
from sonoservo.models import model_path
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import dump_typed
from sonoservo.systems.robot.arm import AddArmWithProbe, load_arm, set_servo_gains
from sonoservo.systems.robot.body_pose import BodyPose
from sonoservo.systems.robot.contact_force import ContactForce
from sonoservo.systems.robot.errors.calibration import (
    CalibrationParameters,
    hand_eye_error,
    joint_offsets,
)
from sonoservo.systems.robot.errors.pose_delay import PoseDelay, PoseDelayParameters
from sonoservo.systems.robot.errors.sensor_faults import SensorFault, add_sensor_faults
from sonoservo.systems.robot.external_torque import ExternalTorque
from sonoservo.systems.robot.forward_kinematics import ForwardKinematics
from sonoservo.systems.robot.phantom import AddPhantom, load_contact, set_friction
from sonoservo.systems.robot.posture import probe_pose, reachable, solve_posture
from sonoservo.systems.robot.wrist_force_sensor import WristForceSensor, WristSensorParameters
from sonoservo.systems.signals.body_surface import BodySurface
from sonoservo.systems.signals.ports import DiagramBuilder
from sonoservo.systems.signals.requirements import (
    NotNegative,
    Positive,
    check_bounds,
    require,
)
from sonoservo.systems.ultrasound.simulation.tissue import load_tissue

_ALLOWED = {
    "contact_model": ("hydroelastic_with_fallback", "hydroelastic", "point"),
    "discrete_contact_approximation": ("lagged", "similar", "sap"),
    "contact_surface_representation": ("polygon", "triangle"),
}


def _reduced(config: MultibodyPlantConfig) -> tuple[Any, ...]:
    values = {each.name: getattr(config, each.name) for each in config.__fields__}
    return partial(MultibodyPlantConfig, **values), ()


copyreg.pickle(MultibodyPlantConfig, _reduced)  # which Drake cannot do


@dataclass(kw_only=True)
class ProbePlacement:
    """Initial placement of the probe over the phantom, facing it along its surface's normal.

    Parameters
    ----------
    x, y
        Point of the phantom's top below the probe, in T, in m.
    yaw_deg
        Angle from X_T to X_P about the surface's normal, in deg.
    height
        Height of the probe's face above the phantom, along that normal, in m.
    """

    x: float = 0.0
    y: float = 0.0
    yaw_deg: float = 0.0
    height: NotNegative = 0.015

    def __post_init__(self) -> None:
        check_bounds(self)
        for name, value in (("x", self.x), ("y", self.y), ("yaw_deg", self.yaw_deg)):
            require(bool(np.isfinite(value)), name, value, "a number")


@dataclass(kw_only=True)
class StationParameters:
    """Parameters of a station.

    Parameters
    ----------
    arm
        Name of a file in models/robots, or a path.
    plant
        Drake's settings of the plant. ``time_step``, together with the controller's, may be 5 ms,
        at which plant and controller take twice the time and hold the force to 6 instead of 9 mN
        (root mean square), or 1 ms to check forces. The ``contact_model`` "point" makes the plant
        alone three times as fast; the indentation at 2 N is then 1 mm smaller.
    phantom_position
        (3,) position in W of the centre of the phantom's top face, in m, while it is at rest.
    probe
        Initial placement of the probe.
    wrist_sensor
        Noise and errors of the wrist force sensor.
    sensor_faults
        Faults of the wrist force sensor, to test what the robot does then.
    pose_delay
        Delay of the probe's pose.
    calibration
        Errors of the calibration of arm and probe.
    display_period
        Time between pictures sent to Meshcat, in s of the simulation.
    """

    arm: str = ARM
    plant: MultibodyPlantConfig = field(
        default_factory=lambda: MultibodyPlantConfig(time_step=0.01)
    )
    phantom_position: list[float] = field(default_factory=lambda: [0.5, 0.0, 0.2])
    probe: ProbePlacement = field(default_factory=ProbePlacement)
    wrist_sensor: WristSensorParameters = field(default_factory=WristSensorParameters)
    sensor_faults: list[SensorFault] = field(default_factory=list)
    pose_delay: PoseDelayParameters = field(default_factory=PoseDelayParameters)
    calibration: CalibrationParameters = field(default_factory=CalibrationParameters)
    display_period: Positive = 3 / 32

    def __post_init__(self) -> None:
        check_bounds(self)
        step = self.plant.time_step
        require(1e-4 <= step <= 0.02, "plant.time_step", step, "from 0.0001 to 0.02 s")
        for name, allowed in _ALLOWED.items():
            value = getattr(self.plant, name)
            require(value in allowed, f"plant.{name}", value, " or ".join(allowed))
        for name in ("penetration_allowance", "stiction_tolerance"):
            value = getattr(self.plant, name)
            require(value > 0, f"plant.{name}", value, "above 0")
        position = self.phantom_position
        finite = len(position) == 3 and bool(np.isfinite(position).all())
        require(finite, "phantom_position", position, "three coordinates in m")

    def __eq__(self, other: object) -> bool:
        # Drake's settings have no equality.
        return isinstance(other, StationParameters) and dump_typed(self) == dump_typed(other)

    @property
    def X_WT(self) -> RigidTransform:
        """Pose of the phantom at rest."""
        return RigidTransform(self.phantom_position)

    def probe_pose(
        self,
        *,
        x: float | None = None,
        y: float | None = None,
        yaw_deg: float | None = None,
        height: float | None = None,
        surface: BodySurface | None = None,
    ) -> RigidTransform:
        """Return the initial pose X_WP of the probe; arguments override the placement's values.

        The face lies along the phantom's surface, which is level by default.
        """
        start = self.probe
        return probe_pose(
            X_WT=self.X_WT,
            x=start.x if x is None else x,
            y=start.y if y is None else y,
            yaw=np.deg2rad(start.yaw_deg if yaw_deg is None else yaw_deg),
            height=start.height if height is None else height,
            surface=surface,
        )


def start_posture(
    parameters: StationParameters, probe: str = PROBE, surface: BodySurface | None = None
) -> NDArray[np.float64]:
    """Return the (n,) initial joint positions of the arm, in rad."""
    try:
        return solve_posture(
            assemble_arm(parameters.arm, probe), parameters.probe_pose(surface=surface)
        )
    except ConfigurationError:
        raise
    except ValueError as error:
        raise ValueError(
            f"station.arm: {parameters.arm}: {error}; move the base (X_PC of its add_weld), "
            "station.phantom_position or station.probe"
        ) from error


def check_reach(
    parameters: StationParameters,
    poses: Sequence[RigidTransform],
    probe: str = PROBE,
    surface: BodySurface | None = None,
) -> list[bool]:
    """Return, for each pose X_WP of the probe, True if the arm can reach it from its start."""
    near = start_posture(parameters, probe, surface)
    return reachable(assemble_arm(parameters.arm, probe), poses, near)


def MakeStation(
    *,
    parameters: StationParameters,
    probe: str = PROBE,
    phantom: str = PHANTOM,
    seed: int = 0,
    meshcat: Meshcat | None = None,
) -> Diagram:
    """Make the station.

    .. pydrake_system::

        name: station
        input_ports:
        - joint_command
        - phantom_command
        output_ports:
        - X_WP
        - joint_state
        - wrist_force
        - external_torque (if the arm reports it)
        - true_X_WP
        - X_WT
        - contact_force
        - query_object

    `joint_command` holds the desired positions, then velocities, of the arm's n joints, in rad and
    rad/s. `phantom_command` holds x, y, z, roll, pitch, yaw of X_WT and their 6 rates (see
    `PhantomMotion`). Both must be connected.

    The first outputs are what the instruments say. `X_WP` is the probe's pose, a
    RigidTransform, with the errors of calibration and delay. `joint_state` holds n positions and n
    velocities; the zeros of the positions may be calibrated wrongly, as those of `joint_command`
    then are. `wrist_force` is the reading of the sensor (see `WristForceSensor`), and
    `external_torque` what the arm's drives say of the world (see `ExternalTorque`). The others are
    the truth, for scanner, logs and displays only: the poses `true_X_WP` and `X_WT`, and
    `contact_force`, the normal force in N.

    Parameters
    ----------
    parameters
        Parameters of arm, plant and sensors, and initial poses of probe and phantom.
    probe, phantom
        Names of files in models/probes and models/phantoms, or paths.
    seed
        Seed of the errors of sensors and calibration.
    meshcat
        Meshcat in which arm, probe and phantom are drawn, if any.

    Raises
    ------
    ValueError
        If the arm cannot reach the probe's start.
    """
    surface, contact = load_tissue(phantom).surface, load_contact(phantom)
    start = start_posture(parameters, probe, surface)
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(parameters.plant, builder)
    model = load_arm(parameters.arm)
    arm = AddArmWithProbe(plant, model, load_probe_body(probe))
    set_servo_gains(arm, model.servo)
    placed = AddPhantom(plant, scene_graph, surface=surface, contact=contact)
    set_friction(plant, scene_graph, arm.probe, contact.friction)
    Parser(plant).AddModels(str(model_path("bench.sdf")))
    plant.Finalize()
    plant.SetDefaultPositions(arm.model_instance, start)
    for axis, value in zip("xyz", parameters.phantom_position, strict=True):
        plant.GetJointByName(axis, placed.model_instance).set_default_translation(value)

    offsets = np.zeros(2 * len(start))
    offsets[: len(start)] = joint_offsets(parameters.calibration, len(start), seed)
    for name, instance, shift in (
        ("joint_command", arm.model_instance, -offsets),
        ("phantom_command", placed.model_instance, np.zeros(0)),
    ):
        port = plant.get_desired_state_input_port(instance)
        # Drake lets a servo without a command go limp; a gain without an input raises an error.
        command = builder.AddNamedSystem(name, Gain(1.0, port.size()))
        builder.Connect(add_offset(builder, command.get_output_port(), shift), port)
        builder.ExportInput(command.get_input_port(), name)

    poses = {}
    for name, body in (("true_X_WP", arm.probe), ("X_WT", placed.body)):
        frame = plant.GetBodyFrameIdOrThrow(body.index())
        poses[name] = builder.AddNamedSystem(name, BodyPose(frame=frame))
        builder.Connect(plant.get_geometry_pose_output_port(), poses[name].get_input_port())
        builder.ExportOutput(poses[name].get_output_port(), name)
    joint_state = add_offset(builder, plant.get_state_output_port(arm.model_instance), offsets)
    builder.ExportOutput(joint_state, "joint_state")
    true_pose = poses["true_X_WP"].get_output_port()
    measured = add_measured_pose(builder, true_pose, joint_state, parameters, probe, seed)
    builder.ExportOutput(measured, "X_WP")

    sensor = builder.AddNamedSystem(
        "wrist_force_sensor",
        WristForceSensor(
            wrist=arm.wrist,
            parameters=parameters.wrist_sensor,
            period=parameters.plant.time_step,
            seed=seed,
        ),
    )
    builder.Connect(plant.get_reaction_forces_output_port(), sensor.get_input_port())
    reading = add_sensor_faults(
        builder,
        sensor.get_output_port(),
        parameters.sensor_faults,
        period=parameters.plant.time_step,
        noise=parameters.wrist_sensor.force_noise,
    )
    builder.ExportOutput(reading, "wrist_force")

    motor_torque = plant.get_net_actuation_output_port(arm.model_instance)
    add_external_torque(builder, joint_state, motor_torque, parameters, probe, seed)

    pressed = builder.AddNamedSystem("contact_force", ContactForce(surface=surface))
    builder.Connect(
        plant.get_contact_results_output_port(), pressed.GetInputPort("contact_results")
    )
    builder.Connect(poses["X_WT"].get_output_port(), pressed.GetInputPort("X_WT"))
    builder.ExportOutput(pressed.get_output_port(), "contact_force")
    builder.ExportOutput(scene_graph.get_query_output_port(), "query_object")

    if meshcat is not None:
        MeshcatVisualizer.AddToBuilder(
            builder,
            scene_graph,
            meshcat,
            MeshcatVisualizerParams(
                publish_period=parameters.display_period,
                prefix="",  # each model is a layer at the top of the scene
                delete_on_initialization_event=False,  # the scene holds other objects too
            ),
        )
    station = builder.Build()
    station.set_name("station")
    return station


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
    parameters: StationParameters,
    probe: str,
    seed: int,
) -> OutputPort:
    """Add the systems that measure the pose of the probe, and return the port of that pose."""
    measured = true_pose
    if parameters.calibration.moves_probe:
        held = assemble_arm(parameters.arm, probe, hand_eye_error(parameters.calibration, seed))
        kinematics = ForwardKinematics(plant=held.plant, frame=held.frame)
        builder.AddNamedSystem("forward_kinematics", kinematics)
        builder.Connect(joint_state, kinematics.get_input_port())
        measured = kinematics.get_output_port()
    if (delay := parameters.pose_delay) != PoseDelayParameters():
        delayed = PoseDelay(parameters=delay, period=parameters.plant.time_step, seed=seed)
        builder.AddNamedSystem("pose_delay", delayed)
        builder.Connect(measured, delayed.get_input_port())
        measured = delayed.get_output_port()
    return measured


def add_external_torque(
    builder: DiagramBuilder,
    joint_state: OutputPort,
    motor_torque: OutputPort,
    parameters: StationParameters,
    probe: str,
    seed: int,
) -> None:
    """Export what estimates the external torques on the joints, if the arm reports them."""
    error = load_arm(parameters.arm).torque_error
    if not error:
        return
    drives = ExternalTorque(
        plant=assemble_arm(parameters.arm, probe).plant,
        error=np.array(error),
        period=parameters.plant.time_step,
        seed=seed,
    )
    builder.AddNamedSystem("external_torque", drives)
    builder.Connect(joint_state, drives.GetInputPort("joint_state"))
    builder.Connect(motor_torque, drives.GetInputPort("motor_torque"))
    builder.ExportOutput(drives.get_output_port(), "external_torque")
