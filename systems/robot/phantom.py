"""Phantom on its moving stage, in any plant."""

from collections.abc import Sequence
from dataclasses import dataclass

from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    Box,
    Cylinder,
    ProximityProperties,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, PdControllerGains, RigidBody
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import Trajectory

from sonoservo.models import model_path
from sonoservo.systems.files.model_file import model_file, read_section
from sonoservo.systems.files.typed_yaml import load_typed
from sonoservo.systems.robot.motors import motors
from sonoservo.systems.signals.requirements import require_not_negative, require_positive

_TRAY, _POST = 0.006, 0.1
"""Heights of the tray and the post on which the phantom stands, in m."""


# Drake treats these gains implicitly, so stiffness costs no stability. The stage is ideal, because
# its motion is the ground truth.
_STAGE_GAINS = PdControllerGains(p=1e7, d=1e5)


@dataclass(kw_only=True)
class PhantomContact:
    """Contact properties of the phantom's surface, calibrated together with the probe's dome.

    Parameters
    ----------
    hydroelastic_modulus
        Scale of the pressure field in Pa, which differs from Young's modulus.
    hunt_crossley_dissipation
        Dissipation in s/m.
    point_contact_stiffness
        Stiffness in N/m for the contact model "point".
    friction
        Coefficient of friction.
    """

    hydroelastic_modulus: float = 67e3
    hunt_crossley_dissipation: float = 1.0
    point_contact_stiffness: float = 600.0
    friction: float = 0.02

    def __post_init__(self) -> None:
        require_positive(
            hydroelastic_modulus=self.hydroelastic_modulus,
            point_contact_stiffness=self.point_contact_stiffness,
        )
        require_not_negative(
            hunt_crossley_dissipation=self.hunt_crossley_dissipation, friction=self.friction
        )


def load_contact(name: str) -> PhantomContact:
    """Read the contact properties of a phantom from YAML.

    Parameters
    ----------
    name
        Name of a file in ``models/phantoms`` ("agar"), or a path.
    """
    path = model_file("phantoms", name)
    content = read_section(path, "contact", ("tissue", "contact"))
    return load_typed(PhantomContact, content, f"{path}: contact")


@dataclass(frozen=True)
class Phantom:
    """Phantom in a plant.

    Parameters
    ----------
    model_instance
        Model instance with the six joints of the stage, actuated in the order x, y, z, roll, pitch,
        yaw.
    body
        Body of the phantom, whose frame is T.
    """

    model_instance: ModelInstanceIndex
    body: RigidBody


def AddPhantom(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    *,
    size: Sequence[float],
    contact: PhantomContact | None = None,
) -> Phantom:
    """Add a phantom on its stage to a plant, with the stage's origin at the origin of W.

    Parameters
    ----------
    plant, scene_graph
        Plant, not yet finalized, and its scene graph.
    size
        (3,) extents of the box along X, Y, Z of T, in m.
    contact
        Contact properties of its surface; those of agar by default.
    """
    contact = contact or PhantomContact()
    (instance,) = Parser(plant).AddModels(str(model_path("phantoms/phantom.sdf")))
    phantom, column = (plant.GetBodyByName(name, instance) for name in ("phantom", "stage_z"))
    x, y, z = size
    surface = ProximityProperties()
    # The resolution hint is required but unused, as a box's mesh follows from its medial axis.
    AddCompliantHydroelasticProperties(1.0, contact.hydroelastic_modulus, surface)
    AddContactMaterial(
        dissipation=contact.hunt_crossley_dissipation,
        point_stiffness=contact.point_contact_stiffness,
        friction=CoulombFriction(contact.friction, contact.friction),
        properties=surface,
    )
    plant.RegisterCollisionGeometry(
        phantom, RigidTransform([0, 0, -z / 2]), Box(x, y, z), "box", surface
    )
    box, tray = plant.GetVisualGeometriesForBody(phantom)
    (post,) = plant.GetVisualGeometriesForBody(column)
    for geometry, shape, centre in (
        (box, Box(x, y, z), -z / 2),
        (tray, Box(x + 0.02, y + 0.02, _TRAY), -z - 0.001 - _TRAY / 2),
        (post, Cylinder(0.03, _POST), -z - _TRAY - _POST / 2),
    ):
        scene_graph.ChangeShape(
            plant.get_source_id(), geometry, shape, RigidTransform([0, 0, centre])
        )
    for motor in motors(plant, instance):
        motor.set_controller_gains(_STAGE_GAINS)
    return Phantom(instance, phantom)


def PhantomMotion(*, trajectory: Trajectory) -> Diagram:
    """Return a system that outputs a station's `phantom_command` from a trajectory.

    .. pydrake_system::

        name: phantom_motion
        output_ports:
        - phantom_command

    Parameters
    ----------
    trajectory
        Pose X_WT over time: x, y, z in m, and roll, pitch, yaw in rad.
    """
    builder = DiagramBuilder()
    source = builder.AddSystem(TrajectorySource(trajectory, output_derivative_order=1))
    builder.ExportOutput(source.get_output_port(), "phantom_command")
    motion = builder.Build()
    motion.set_name("phantom_motion")
    return motion
