"""The station: arm with probe, phantom, contact, joint servo and wrist force sensor."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Gain

from sonoservo.models import model_path
from sonoservo.systems.robot.arm import AddArmWithProbe
from sonoservo.systems.robot.body_pose import BodyPose
from sonoservo.systems.robot.contact_force import ContactForce
from sonoservo.systems.robot.phantom import AddPhantom
from sonoservo.systems.robot.posture import probe_pose, reachable, solve_posture
from sonoservo.systems.robot.wrist_force_sensor import WristForceSensor
from sonoservo.systems.signals.requirements import require, require_not_negative, require_positive

_CONTACT_MODELS = ("hydroelastic_with_fallback", "hydroelastic", "point")

# Implicit, so stiffness costs no stability. The stage's axes are ideal: it carries the truth.
_ARM_GAINS = 3 * [PdControllerGains(p=2e5, d=2e3)] + 3 * [PdControllerGains(p=4e4, d=4e2)]
_STAGE_GAINS = 6 * [PdControllerGains(p=1e7, d=1e5)]


@dataclass(kw_only=True)
class ProbePlacement:
    """Where over the phantom the probe starts, looking straight down.

    Parameters
    ----------
    x, y
        Over which point of the phantom's top, in T, in m.
    yaw_deg
        Angle from X_T to X_P about the vertical, in deg.
    height
        Of the probe's face above the phantom, in m.
    """

    x: float = 0.0
    y: float = 0.0
    yaw_deg: float = 0.0
    height: float = 0.015

    def __post_init__(self) -> None:
        require_not_negative(height=self.height)
        for name, value in (("x", self.x), ("y", self.y), ("yaw_deg", self.yaw_deg)):
            require(bool(np.isfinite(value)), name, value, "a number")


@dataclass(kw_only=True)
class StationParameters:
    """What a station is made of.

    Parameters
    ----------
    time_step
        Of the plant, in s. With the controller's it may be 10 ms for studies: twice as fast, and
        the force is held as well; or 1 ms to check forces.
    contact_model
        As in Drake: hydroelastic_with_fallback, hydroelastic, or point (for the plant alone three
        times faster, and 1 mm shallower at 2 N).
    phantom_position
        (3,) position in W of the centre of the phantom's top face, in m, while it is at rest.
    probe
        Where it starts.
    force_noise, torque_noise
        Standard deviation of the wrist force sensor's samples, in N and N m.
    display_period
        Time between pictures sent to Meshcat, in s of the simulation.
    """

    time_step: float = 0.005
    contact_model: str = "hydroelastic_with_fallback"
    phantom_position: list[float] = field(default_factory=lambda: [0.5, 0.0, 0.2])
    probe: ProbePlacement = field(default_factory=ProbePlacement)
    force_noise: float = 0.02
    torque_noise: float = 0.001
    display_period: float = 3 / 32

    def __post_init__(self) -> None:
        require_positive(time_step=self.time_step, display_period=self.display_period)
        require(self.time_step <= 0.02, "time_step", self.time_step, "at most 0.02 s")
        require_not_negative(force_noise=self.force_noise, torque_noise=self.torque_noise)
        position = self.phantom_position
        finite = len(position) == 3 and bool(np.isfinite(position).all())
        require(finite, "phantom_position", position, "three coordinates in m")
        allowed = " or ".join(_CONTACT_MODELS)
        require(self.contact_model in _CONTACT_MODELS, "contact_model", self.contact_model, allowed)

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
    ) -> RigidTransform:
        """Pose X_WP of the probe at its start; what is given takes the place of the start's."""
        start = self.probe
        return probe_pose(
            X_WT=self.X_WT,
            x=start.x if x is None else x,
            y=start.y if y is None else y,
            yaw=np.deg2rad(start.yaw_deg if yaw_deg is None else yaw_deg),
            height=start.height if height is None else height,
        )


def start_posture(parameters: StationParameters) -> NDArray[np.float64]:
    """(6,) joint positions of the arm at the start, in rad.

    Raises
    ------
    ValueError
        If the arm cannot reach the start.
    """
    return solve_posture(parameters.probe_pose())


def check_reach(parameters: StationParameters, poses: Sequence[RigidTransform]) -> list[bool]:
    """Whether the arm, from its start, reaches each of the poses X_WP of the probe.

    Raises
    ------
    ValueError
        If the arm cannot reach the start.
    """
    return reachable(poses, start_posture(parameters))


def MakeStation(
    *,
    parameters: StationParameters,
    phantom_size: Sequence[float] = (0.24, 0.16, 0.08),
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
        - X_WT
        - joint_state
        - wrist_force
        - contact_force
        - query_object

    `joint_command` is the arm's 6 wanted joint positions and 6 velocities, in rad and rad/s;
    `phantom_command` is x, y, z, roll, pitch, yaw of X_WT and their 6 rates (see `PhantomMotion`).
    Both must be connected. `X_WP` and `X_WT` are RigidTransforms, `joint_state` has 6 positions
    and 6 velocities; `wrist_force` is what the sensor reads (see `WristForceSensor`);
    `contact_force` is the true normal force in N, for logs only.

    Parameters
    ----------
    parameters
        What it is made of.
    phantom_size
        (3,) extents of the phantom along X, Y, Z of T, in m.
    seed
        Of the sensor's noise.
    meshcat
        Where to draw arm, probe and phantom, if anywhere.

    Raises
    ------
    ValueError
        If the arm cannot reach the probe's start.
    """
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(
        time_step=parameters.time_step,
        contact_model=parameters.contact_model,
        discrete_contact_approximation="lagged",
    )
    plant, scene_graph = AddMultibodyPlant(config, builder)
    arm = AddArmWithProbe(plant)
    phantom = AddPhantom(plant, scene_graph, size=phantom_size)
    Parser(plant).AddModels(str(model_path("bench.sdf")))
    # The names of what is seen, in the page's controls too.
    plant.RenameModelInstance(arm.model_instance, "arm")
    plant.RenameModelInstance(arm.probe.model_instance(), "probe")
    plant.RenameModelInstance(phantom.model_instance, "phantom")
    _add_joint_servos(plant)
    plant.Finalize()
    plant.SetDefaultPositions(arm.model_instance, start_posture(parameters))
    for axis, value in zip("xyz", parameters.phantom_position, strict=True):
        plant.GetJointByName(axis, phantom.model_instance).set_default_translation(value)

    for name, instance in (
        ("joint_command", arm.model_instance),
        ("phantom_command", phantom.model_instance),
    ):
        # Drake lets a servo with no command go limp; a gain with no input says so instead.
        command = builder.AddNamedSystem(name, Gain(1.0, 12))
        builder.Connect(command.get_output_port(), plant.get_desired_state_input_port(instance))
        builder.ExportInput(command.get_input_port(), name)

    poses = {}
    for name, body in (("X_WP", arm.probe), ("X_WT", phantom.body)):
        poses[name] = builder.AddNamedSystem(name, BodyPose(body=body.index()))
        builder.Connect(plant.get_body_poses_output_port(), poses[name].get_input_port())
        builder.ExportOutput(poses[name].get_output_port(), name)
    builder.ExportOutput(plant.get_state_output_port(arm.model_instance), "joint_state")

    sensor = builder.AddNamedSystem(
        "wrist_force_sensor",
        WristForceSensor(
            wrist=arm.wrist,
            force_noise=parameters.force_noise,
            torque_noise=parameters.torque_noise,
            period=parameters.time_step,
            seed=seed,
        ),
    )
    builder.Connect(plant.get_reaction_forces_output_port(), sensor.get_input_port())
    builder.ExportOutput(sensor.get_output_port(), "wrist_force")

    contact = builder.AddNamedSystem("contact_force", ContactForce())
    builder.Connect(
        plant.get_contact_results_output_port(), contact.GetInputPort("contact_results")
    )
    builder.Connect(poses["X_WT"].get_output_port(), contact.GetInputPort("X_WT"))
    builder.ExportOutput(contact.get_output_port(), "contact_force")
    builder.ExportOutput(scene_graph.get_query_output_port(), "query_object")

    if meshcat is not None:
        MeshcatVisualizer.AddToBuilder(
            builder,
            scene_graph,
            meshcat,
            MeshcatVisualizerParams(
                publish_period=parameters.display_period,
                prefix="",  # each model is a layer at the top of the scene
                delete_on_initialization_event=False,  # there are others' things, too
            ),
        )
    station = builder.Build()
    station.set_name("station")
    return station


def _add_joint_servos(plant: MultibodyPlant) -> None:
    """Give the six motors of the arm and those of the stage a stiff, implicit servo."""
    actuators = plant.GetJointActuatorIndices()
    for index, gains in zip(actuators, _ARM_GAINS + _STAGE_GAINS, strict=True):
        plant.get_joint_actuator(index).set_controller_gains(gains)
